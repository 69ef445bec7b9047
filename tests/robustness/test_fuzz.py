# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Readers of damaged files, see ``tools/fuzz.py``."""

import sys

import pytest

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
