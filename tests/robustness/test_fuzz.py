# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Readers of damaged files, see ``tools/fuzz.py``."""

import sys

import pytest

from astro_scc.epochs import read_components

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="limits of time and memory are of Linux"
)


def test_sound_files_are_read(fuzz, tmp_path):
    for suffix, content, reader in fuzz.sources(tmp_path).values():
        path = tmp_path / f"sound{suffix}"
        path.write_bytes(content)
        assert fuzz.read(path, reader) == "read"


@pytest.mark.slow
def test_damaged_files_are_read_or_refused(fuzz):
    with fuzz.limits():
        counts, faults = fuzz.fuzz(270, seed=2, seconds=8)
    assert faults == []
    # The damage is neither harmless nor the end of everything.
    whole = counts.total()
    assert 0.05 * whole < sum(n for (_, what), n in counts.items() if what == "read")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"NAXIS1  ", b"NOXIS1  ", "cc.fits: not a readable FITS file: "),
        (b"AIPS CC", b"AIPS \xffC", "cc.fits: no AIPS CC table in the file"),
        (b"'2001-01-01'", b"'2001-01-01 ", "cc.fits: no DATE-OBS in the header"),
    ],
)
def test_broken_cards_of_clean_components(fuzz, tmp_path, old, new, message):
    content = fuzz.sources(tmp_path)["AIPS components"][1]
    path = tmp_path / "cc.fits"
    path.write_bytes(content.replace(old, new))
    with pytest.raises((OSError, ValueError), match=message):
        read_components(path)
