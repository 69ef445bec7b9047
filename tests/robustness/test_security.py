# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Files of strangers: names in them are data, and nothing in them is run."""

import re

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


@pytest.mark.parametrize("name", HOSTILE)
def test_objects_name_files_of_their_folder_only(inputs, tmp_path, name):
    folder = tmp_path / "a" / "b" / "out"
    cube = EpochCube.read(inputs.series(_made(tmp_path / "in"), n=2))
    before = set(tmp_path.rglob("*"))
    for prefix in (None, name):
        cube.meta["object"] = name
        for path in write_epochs(cube, folder, prefix=prefix, overwrite=True):
            assert path.parent == folder
            assert re.fullmatch(r"[\w+.-]+", path.name)
            assert path.is_file()
    for path in set(tmp_path.rglob("*")) - before:
        assert folder in (path, *path.parents) or path in folder.parents


def _made(folder):
    folder.mkdir()
    return folder


@pytest.mark.slow
def test_nothing_is_written_beside_the_products(inputs, tmp_path, capsys):
    """With every name that a header has, and a page that runs nothing of them."""
    paths = inputs.series(
        _made(tmp_path / "in"),
        lambda i: dict.fromkeys(
            ("OBJECT", "TELESCOP", "OBSERVER", "FILTER", "LABEL"),
            "../<script>alert(1)</script>{{7*7}}",
        ),
    )
    before = set(tmp_path.rglob("*"))
    argv = ["measure", *map(str, paths), "-o", str(tmp_path / "out"), *inputs.QUICK]
    assert main(argv) == 0
    out = tmp_path / "out"
    assert all(out in (p, *p.parents) for p in set(tmp_path.rglob("*")) - before)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "../&lt;script&gt;alert(1)&lt;/script&gt;{{7*7}}" in page
    assert "<script" not in page


@pytest.mark.parametrize(
    "code", ["!!python/object/apply:os.mkdir [{path}]", "!!python/name:os.system"]
)
def test_yaml_in_files_makes_no_objects(inputs, tmp_path, code):
    bad = code.format(path=tmp_path / "made")
    cube = EpochCube.read(inputs.series(tmp_path, n=2))
    cube.write(tmp_path / "cube.fits")
    with fits.open(tmp_path / "cube.fits") as hdus:
        text = f"unit: {bad}\n".encode()
        hdus["META"] = fits.ImageHDU(np.frombuffer(text, np.uint8), name="META")
        hdus.writeto(tmp_path / "bad.fits")
    with pytest.raises(OSError, match=r"bad.fits: is no complete astro_scc Epoch"):
        EpochCube.read(tmp_path / "bad.fits")
    (tmp_path / "t.ecsv").write_text(
        f"# %ECSV 1.0\n# ---\n# datatype:\n# - {{name: epoch, datatype: string}}\n"
        f"# meta: {{a: {bad}}}\nepoch\n2001-01-01\n"
    )
    with pytest.raises(ValueError, match=r"t.ecsv: is neither CSV nor ECSV"):
        offsets_from_table(tmp_path / "t.ecsv", None, [])
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize(
    "name", ["os.PathLike", "astro_scc.cli.main", "astro_scc.images.fits.Path", "x"]
)
def test_files_make_dataclasses_of_this_package_only(inputs, tmp_path, name):
    EpochCube.read(inputs.series(tmp_path, n=2)).write(tmp_path / "cube.fits")
    with fits.open(tmp_path / "cube.fits") as hdus:
        text = f"'!class': {name}\n".encode()
        hdus["META"] = fits.ImageHDU(np.frombuffer(text, np.uint8), name="META")
        hdus.writeto(tmp_path / "bad.fits")
    with pytest.raises(OSError, match=r"bad.fits: .* its \w+ is of another version"):
        EpochCube.read(tmp_path / "bad.fits")


def test_codes_for_the_terminal_are_letters(capsys):
    reporter = Reporter("astro-scc test")
    reporter.say("a\x1b[2Jb\x07\n\tc")
    reporter.warn("\x9b31m")
    reporter.error("\x1b]0;title")
    out, err = capsys.readouterr()
    assert out == "a\\x1b[2Jb\\x07\n\tc\n"
    assert err == "warning: \\x9b31m\nastro-scc test: error: \\x1b]0;title\n"
