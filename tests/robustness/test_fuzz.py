# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Readers of damaged files, see ``tools/fuzz.py``."""

import gzip
import re
import sys

import pytest

from astro_scc.alignment.align import offsets_from_table
from astro_scc.epochs import EpochCube, read_components

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


# -- what was found ------------------------------------------------------------------


def test_a_header_of_ecsv_without_names(tmp_path):
    path = tmp_path / "cores.ecsv"
    path.write_text("# %ECSV 1.0\n# ---\n# datatype:\n# - {nam: epoch}\nepoch\n1\n")
    with pytest.raises(ValueError, match=r"cores.ecsv: is neither CSV nor ECSV"):
        offsets_from_table(path, None, [])


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


def test_axes_without_end_in_any_header(fuzz, tmp_path):
    """Astropy would count to their number."""
    sound = fuzz.sources(tmp_path)
    own, axes = rb"NAXIS   = {20}\d", b"NAXIS   = 99999999999999999999"
    for kind in ("image", "cube", "AIPS components"):
        suffix, content, reader = sound[kind]
        for match in re.finditer(own, content):
            path = tmp_path / f"bad{suffix}"
            path.write_bytes(content[: match.start()] + axes + content[match.end() :])
            assert fuzz.read(path, reader) == "refused"
    packed = tmp_path / "bad.fits.gz"
    packed.write_bytes(gzip.compress(re.sub(own, axes, sound["image"][1])))
    with pytest.raises(OSError, match="bad.fits.gz: is broken, it claims 9999"):
        EpochCube.read(packed)


def test_a_region_without_end(inputs, tmp_path):
    cube = EpochCube.read(inputs.series(tmp_path, n=2))
    path = tmp_path / "r.reg"
    path.write_text("image\ncircle(6,4,1e400)\n")
    with pytest.raises(ValueError, match="r.reg: a CirclePixelRegion has no inside on"):
        cube.region_mask(path)
