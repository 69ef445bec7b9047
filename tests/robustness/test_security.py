# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Files of strangers and damaged ones: nothing in them is run."""

import re
import sys

import numpy as np
import pytest
from astropy.io import fits

from astro_scc.alignment.align import offsets_from_table
from astro_scc.cli import main
from astro_scc.cli.program import Reporter
from astro_scc.epochs import EpochCube, write_epochs

HOSTILE = (
    "../../evil", "/etc/passwd", "..", ".", "a/../../b", "CON", "x\\..\\y", "$HOME",
    "`id`", "%00", "~root", "<script>alert(1)</script>", "{{7*7}}", "-rf",
)  # fmt: skip


def test_objects_name_files_of_their_folder_only(inputs, tmp_path):
    cube = EpochCube.read(inputs.series(tmp_path, n=2))
    folder = tmp_path / "a" / "b" / "out"
    folder.mkdir(parents=True)
    before = set(tmp_path.rglob("*"))
    for name in HOSTILE:
        cube.meta["object"] = name
        for prefix in (None, name):
            for path in write_epochs(cube, folder, prefix=prefix, overwrite=True):
                assert path.parent == folder
                assert re.fullmatch(r"[\w+.-]+", path.name)
    assert all(path.parent == folder for path in set(tmp_path.rglob("*")) - before)


@pytest.mark.slow
def test_nothing_is_written_beside_the_products(inputs, tmp_path):
    """With every name that a header has, and a page that runs nothing of them."""
    names = "OBJECT", "TELESCOP", "OBSERVER", "FILTER", "LABEL"
    hostile = dict.fromkeys(names, "../<script>alert(1)</script>{{7*7}}")
    paths, out = inputs.series(tmp_path, lambda i: hostile), tmp_path / "out"
    before = set(tmp_path.rglob("*"))
    assert main(["measure", *map(str, paths), "-o", str(out), *inputs.QUICK]) == 0
    assert all(out in (p, *p.parents) for p in set(tmp_path.rglob("*")) - before)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "../&lt;script&gt;alert(1)&lt;/script&gt;{{7*7}}" in page
    assert "<script" not in page


BAD = "!!python/object/apply:os.mkdir [{path}]"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"unit: {BAD}", "bad.fits: cannot be read as astro_scc Epoch"),
        ("unit: !!python/name:os.system", "bad.fits: cannot be read as astro_scc Epo"),
        ("'!class': os.PathLike", r"bad.fits: .* its \w+ is of another version"),
        ("'!class': astro_scc.images.fits.Path", r"its \w+ is of another version"),
    ],
)
def test_files_make_dataclasses_of_this_package_only(inputs, tmp_path, text, words):
    EpochCube.read(inputs.series(tmp_path, n=2)).write(tmp_path / "cube.fits")
    text = text.format(path=tmp_path / "made")
    with fits.open(tmp_path / "cube.fits") as hdus:
        content = np.frombuffer(f"{text}\n".encode(), np.uint8)
        hdus["META"] = fits.ImageHDU(content, name="META")
        hdus.writeto(tmp_path / "bad.fits")
    with pytest.raises(OSError, match=words):
        EpochCube.read(tmp_path / "bad.fits")
    assert not (tmp_path / "made").exists()


def test_yaml_in_tables_makes_no_objects(tmp_path):
    (tmp_path / "t.ecsv").write_text(
        f"# %ECSV 1.0\n# ---\n# datatype:\n# - {{name: epoch, datatype: string}}\n"
        f"# meta: {{a: {BAD.format(path=tmp_path / 'made')}}}\nepoch\n2001-01-01\n"
    )
    with pytest.raises(ValueError, match=r"t.ecsv: is neither CSV nor ECSV"):
        offsets_from_table(tmp_path / "t.ecsv", None, [])
    assert not (tmp_path / "made").exists()


def test_codes_for_the_terminal_are_letters(capsys):
    reporter = Reporter("astro-scc test")
    reporter.say("a\x1b[2Jb\x07\n\tc")
    reporter.warn("\x9b31m")
    reporter.error("\x1b]0;title")
    out, err = capsys.readouterr()
    assert out == "a\\x1b[2Jb\\x07\n\tc\n"
    assert err == "warning: \\x9b31m\nastro-scc test: error: \\x1b]0;title\n"


def test_sound_files_are_read(tool, tmp_path):
    fuzz = tool("fuzz")
    for suffix, content, reader in fuzz.sources(tmp_path).values():
        path = tmp_path / f"sound{suffix}"
        path.write_bytes(content)
        assert fuzz.read(path, reader) == "read"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits are of Linux")
def test_damaged_files_are_read_or_refused(tool):
    fuzz = tool("fuzz")
    with fuzz.limits():
        counts, faults = fuzz.fuzz(270, seed=2, seconds=8)
    assert faults == []
    # The damage is neither harmless nor the end of everything.
    whole = counts.total()
    assert 0.05 * whole < sum(n for (_, what), n in counts.items() if what == "read")
