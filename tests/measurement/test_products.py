# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Folders that are complete or not there, tables and maps that others can read."""

import subprocess
import sys
import warnings
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.cosmology import Planck18
from astropy.io import fits
from astropy.table import QTable
from astropy.wcs import WCS

from astro_scc import StackedCrossCorrelation
from astro_scc.exceptions import MeasurementWarning
from astro_scc.kinematics.cosmology import to_cosmology
from astro_scc.measurement import products, write_products
from astro_scc.measurement.products import product_folder, velocity_hdus
from astro_scc.simulation import simulate_two_fluid
from astro_scc.writing import _machine


@pytest.fixture(scope="module")
def cube():
    return simulate_two_fluid(n_epochs=5, rng=1).cube


def measured(cube, **settings):
    options = {"scales": [2], "max_speed": 36 * u.mas / u.yr, **settings}
    return StackedCrossCorrelation(**options)(cube, n_trials=20, rng=1)


@pytest.fixture(scope="module")
def result(cube):
    return measured(cube, position_angle=270 * u.deg)


@pytest.fixture
def written(result, tmp_path):
    components = result.components_in_c(redshift=0.158, cosmology=Planck18)
    configuration = {"scales": [2], "max_speed": "36 mas / yr"}
    write_products(
        result,
        components,
        tmp_path,
        configuration=configuration,
        text="# Größe\nscales = [2]\n",
    )
    return tmp_path


# -- folders -----------------------------------------------------------------------


def hidden(folder):
    return [path for path in folder.rglob("*") if "partial" in path.name]


def test_a_folder_appears_when_it_is_complete(tmp_path):
    target = tmp_path / "a" / "b"
    with product_folder(target) as folder:
        (folder / "one.txt").write_text("1")
        assert not target.exists()
    assert [path.name for path in target.iterdir()] == ["one.txt"]
    assert not hidden(tmp_path)
    # Others may read it as they may read any new folder.
    plain = tmp_path / "plain"
    plain.mkdir()
    assert target.stat().st_mode == plain.stat().st_mode


def fill_in_vain(target, error, **options):
    with product_folder(target, **options) as folder:
        (folder / "one.txt").write_text("new")
        raise error


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_nothing_is_left_after_an_error(tmp_path, error):
    with pytest.raises(error):
        fill_in_vain(tmp_path / "a" / "b", error)
    assert not list(tmp_path.iterdir())


def test_an_empty_folder_is_filled(tmp_path):
    with product_folder(tmp_path) as folder:
        (folder / "one.txt").write_text("1")
    assert [path.name for path in tmp_path.iterdir()] == ["one.txt"]


def test_a_folder_with_files_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with (
        pytest.raises(OSError, match="not empty; choose another folder, or --overwr"),
        product_folder(tmp_path),
    ):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_overwriting_replaces_files_and_takes_stale_ones_away(tmp_path):
    for name in ("mine.txt", "one.txt", "old.txt"):
        (tmp_path / name).write_text("old")
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "mine.fits").write_text("old")
    stale = ("one.txt", "old.txt", "older.txt")
    with product_folder(tmp_path, overwrite=True, stale=stale) as folder:
        (folder / "one.txt").write_text("new")
        (folder / "images").mkdir()
        (folder / "images" / "a.fits").write_text("new")
        assert (tmp_path / "one.txt").read_text() == "old"
    files = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file()}
    assert files == {"mine.txt", "one.txt", "images/mine.fits", "images/a.fits"}
    assert (tmp_path / "one.txt").read_text() == "new"


def test_overwriting_that_fails_changes_nothing(tmp_path):
    (tmp_path / "one.txt").write_text("old")
    with pytest.raises(ValueError, match="no"):
        fill_in_vain(tmp_path, ValueError("no"), overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["one.txt"]
    assert (tmp_path / "one.txt").read_text() == "old"


@pytest.mark.parametrize("exists", [True, False])
def test_what_a_killed_run_left_is_taken_away(tmp_path, exists):
    pytest.importorskip("fcntl")
    out = tmp_path / "out"
    end = f"{_machine()}-0123abcd"
    left = [tmp_path / f".out.partial-{end}", tmp_path / f".other.partial-{end}"]
    left += [out / f".partial-{end}"] * exists
    for folder in left:
        folder.mkdir(parents=True)
        (folder / "half").write_text("x")
    with product_folder(out) as folder:
        (folder / "a.txt").write_text("a")
    assert sorted(p.name for p in tmp_path.iterdir()) == [left[1].name, "out"]
    assert [p.name for p in out.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("exists", [True, False])
@pytest.mark.parametrize("overwrite", [True, False])
def test_a_second_run_at_once_is_refused(tmp_path, monkeypatch, exists, overwrite):
    pytest.importorskip("fcntl")
    monkeypatch.setattr("astro_scc.writing.PATIENCE", 0.01)
    out = tmp_path / "deep" / "out"
    if exists:
        out.mkdir(parents=True)
    with product_folder(out) as first:
        (first / "a.txt").write_text("first")
        with (
            pytest.raises(OSError, match="out: another run is at work for this folder"),
            product_folder(out, overwrite=overwrite),
        ):
            pass
    assert [(p.name, p.read_text()) for p in out.iterdir()] == [("a.txt", "first")]


def test_two_runs_that_begin_in_one_moment(tmp_path, monkeypatch):
    """The second looks before the first has made its folder, and looks again."""
    pytest.importorskip("fcntl")
    monkeypatch.setattr("astro_scc.writing.PATIENCE", 0.01)
    out, real, looked = tmp_path / "out", products.writing.remove_left, []

    def look(parent, prefix):
        looked.append(prefix)
        return [] if len(looked) <= 2 else real(parent, prefix)

    with product_folder(out):
        monkeypatch.setattr(products.writing, "remove_left", look)
        with (
            pytest.raises(OSError, match="out: another run is at work for this folder"),
            product_folder(out),
        ):
            pass
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_what_may_be_a_run_elsewhere_is_told(tmp_path):
    left = tmp_path / ".out.partial-01234567-0123abcd"
    left.mkdir()
    line = rf"{left}: is of another run, which goes on or was killed; delete it"
    with (
        pytest.warns(MeasurementWarning, match=line) as said,
        product_folder(tmp_path / "out") as folder,
    ):
        (folder / "a.txt").write_text("a")
    assert [warning.filename for warning in said] == [__file__]
    assert left.is_dir()


def test_another_run_was_quicker(tmp_path):
    out = tmp_path / "out"

    def other():
        out.mkdir()
        (out / "a.txt").write_text("other")

    with (
        pytest.raises(OSError, match="out: cannot be made: another run has written"),
        product_folder(out),
    ):
        other()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert (out / "a.txt").read_text() == "other"


def test_a_file_is_no_folder(tmp_path):
    path = tmp_path / "out"
    path.write_text("mine")
    for overwrite in (False, True):
        with (
            pytest.raises(OSError, match="out: is a file; choose another folder"),
            product_folder(path, overwrite=overwrite),
        ):
            pass
    with (
        pytest.raises(OSError, match=r"b: cannot be made or used: Not a directory"),
        product_folder(path / "a" / "b"),
    ):
        pass
    assert path.read_text() == "mine"


def test_a_folder_that_cannot_be_written_to(tmp_path, monkeypatch):
    def refuse(self, *args, **kwargs):
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr("pathlib.Path.mkdir", refuse)
    with (
        pytest.raises(OSError, match=r"out: cannot be made or used: Permission denied"),
        product_folder(tmp_path / "out"),
    ):
        pass
    assert not list(tmp_path.iterdir())


# -- tables ------------------------------------------------------------------------


@pytest.mark.slow
def test_tables_are_read_without_this_package(written):
    # Nor is astropy.cosmology imported, which registers the YAML of cosmologies.
    code = (
        "from astropy.table import QTable\n"
        f"table = QTable.read({str(written / 'components.ecsv')!r})\n"
        "print(table['pm'].unit, table.meta['cosmology']['name'])\n"
        "import sys; assert 'astro_scc' not in sys.modules\n"
        f"print(QTable.read({str(written / 'ssps.ecsv')!r})['east'].unit)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == ["mas / yr Planck18", "mas"]


def cosmologies_agree(plain, cosmology):
    z = [0.01, 0.158, 2]
    same = to_cosmology(plain).comoving_transverse_distance(z)
    return np.array_equal(same, cosmology.comoving_transverse_distance(z))


def test_tables_are_the_ones_of_the_result(written, result):
    table = QTable.read(written / "components.ecsv")
    expected = result.components_in_c(redshift=0.158, cosmology=Planck18)
    assert table.colnames == expected.colnames
    for name in expected.colnames:
        np.testing.assert_array_equal(table[name], expected[name])
        assert table[name].unit == expected[name].unit
    meta = table.meta
    assert meta["configuration"] == {"scales": [2], "max_speed": "36 mas / yr"}
    assert "settings" not in meta
    assert (meta["seed"], meta["n_trials"], meta["redshift"]) == (1, 20, 0.158)
    assert meta["jet_position_angle"] == 270 * u.deg
    assert {"astro_scc", "numpy", "astropy"} <= set(meta["versions"])
    assert meta["history"] == ["simulated: two-fluid"]
    assert cosmologies_agree(meta["cosmology"], Planck18)
    ssps = QTable.read(written / "ssps.ecsv")
    assert len(ssps) == len(result.ssps)
    assert ssps.meta["configuration"] == meta["configuration"]


def test_a_table_without_components_keeps_its_columns(cube, tmp_path):
    scc = StackedCrossCorrelation(scales=[2], detection=1e6, segmentation=1e6)
    result = scc.stack(scc.match(cube), n_trials=20, rng=1)
    components = result.components_in_c(distance=16.7 * u.Mpc)
    assert len(components) == 0
    paths = write_products(result, components, tmp_path)
    assert [path.name for path in paths if path.parent == tmp_path] == [
        "components.ecsv",
        "features.ecsv",
        "positions.ecsv",
        "sensitivity.ecsv",
        "epochs.ecsv",
        "ssps.ecsv",
        "scc.fits",
    ]
    table = QTable.read(paths[0])
    assert len(table) == 0
    assert table.colnames == components.colnames
    for name in table.colnames:
        assert table[name].unit == components[name].unit
        assert table[name].dtype.kind == components[name].dtype.kind
    assert table.meta["distance"] == 16.7 * u.Mpc
    assert table.meta["settings"]["detection"] == 1e6


# -- maps --------------------------------------------------------------------------


def test_maps_satisfy_the_standard(written, result):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with fits.open(written / "scc.fits") as hdus:
            hdus.verify("exception")
            names = "COEFFICIENT ZSCORE DIAGRAM INTERVALS FEATURES".split()
            assert [hdu.name for hdu in hdus] == names
            for hdu, values in zip(
                hdus[:2], (result.coefficient, result.z_score), strict=True
            ):
                np.testing.assert_array_equal(hdu.data, values)
                wcs = WCS(hdu.header)
                assert [str(unit) for unit in wcs.wcs.cunit] == ["mas / yr"] * 2
                assert hdu.header["CUNIT1"] == "mas yr-1"
                v1, v2 = wcs.pixel_to_world_values(*np.indices(values.T.shape))
                np.testing.assert_allclose(v1[:, 0], result.grid.v1, atol=1e-9)
                np.testing.assert_allclose(v2[0], result.grid.v2, atol=1e-9)
            header = hdus[0].header
            assert "LATPOLE" not in header
            assert "MJDREF" not in header


def test_the_header_says_what_was_done(written):
    header = fits.getheader(written / "scc.fits")
    assert (header["SEED"], header["NTRIALS"], header["NEPOCHS"]) == (1, 20, 5)
    assert header["OBJECT"] == "two-fluid"
    assert header["DATE-BEG"].startswith("2000-01-01")
    assert header["DATE-END"].startswith("2000-04-30")
    assert header["JETPA"] == 270
    assert header["CREATOR"].startswith("astro_scc ")
    assert any(header[key].startswith("numpy ") for key in header["VERS*"])
    assert list(header["HISTORY"]) == ["simulated: two-fluid"]
    assert "scales = [2]" in list(header["COMMENT"])
    assert "# Gr??e" in list(header["COMMENT"])
    assert "DATE" not in header


@pytest.mark.parametrize(
    ("angle", "names", "types"),
    [
        (None, ["east", "north"], ["EAST", "NORTH"]),
        ("radial", ["radial", "transverse"], ["RADIAL", "TRANSVER"]),
    ],
)
def test_axes_have_names(cube, angle, names, types):
    header = velocity_hdus(measured(cube, position_angle=angle))[1].header
    assert [header["CNAME1"], header["CNAME2"]] == names
    assert [header["CTYPE1"], header["CTYPE2"]] == types


def test_the_same_measurement_gives_the_same_bytes(result, tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        for path in write_products(
            result, result.components, tmp_path / name, text="seed = 1\n"
        ):
            assert path.is_file()
    for path in filter(Path.is_file, (tmp_path / "a").rglob("*")):
        other = tmp_path / "b" / path.relative_to(tmp_path / "a")
        assert path.read_bytes() == other.read_bytes()
