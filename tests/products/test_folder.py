# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Folders that are complete or not there, tables, maps and regions for others."""

import os
import re
import signal
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.cosmology import Planck18
from astropy.io import fits
from astropy.table import QTable
from astropy.wcs import WCS
from regions import Regions

from astro_scc.decomposition import SSPs
from astro_scc.measurement.tables import citations_of
from astro_scc.products import (
    ssp_regions,
    ssp_segmentation,
    write_epoch_regions,
    write_products,
    write_ssp_regions,
)
from astro_scc.products.folder import product_folder
from astro_scc.writing import versions

SETTINGS = {"scales": [2], "max_speed": "36 mas / yr"}
NEW = {"one.txt": "new", "images": False, "images/a.fits": "new"}


@pytest.fixture(scope="module")
def result(sky_result, with_cube):
    """As of a jet to the west, whose epochs have a history."""
    meta = {"object": "Größe", "history": ["simulated: here"]}
    made = with_cube(sky_result, replace(sky_result.cube, meta=meta))
    return replace(made, position_angle=270 * u.deg)


@pytest.fixture(scope="module")
def streams(result):
    return result.components_in_c(redshift=0.158, cosmology=Planck18)


@pytest.fixture(scope="module")
def written(result, streams, tmp_path_factory):
    folder = tmp_path_factory.mktemp("out")
    how = {"configuration": SETTINGS, "text": "# Größe\nscales = [2]\n"}
    paths = write_products(result, streams, folder, **how)
    assert all(path.is_file() for path in paths)
    names = "streams components spectrum features positions sensitivity epochs ssps"
    kept = [f"{name}.ecsv" for name in names.split()]
    kept += ["citations.bib", "config.toml", "scc.fits"]
    assert [path.name for path in paths if path.parent == folder] == kept
    return folder


def tree(folder):
    """The text of all files, and the folders."""
    every = {str(path.relative_to(folder)): path for path in folder.rglob("*")}
    return {name: p.is_file() and p.read_text() for name, p in every.items()}


def fill(target, error=None, **options):
    before = target.exists()
    with product_folder(target, **options) as folder:
        # It appears when it is complete.
        (folder / "one.txt").write_text("new")
        (folder / "images").mkdir()
        (folder / "images" / "a.fits").write_text("new")
        assert target.exists() == before
        if error:
            raise error


def test_a_folder_is_made_with_its_parents_and_filled_again_if_asked(tmp_path):
    target = tmp_path / "a" / "b"
    fill(target)
    assert tree(target) == NEW
    with pytest.raises(OSError, match="not empty; choose another folder, or --overwr"):
        fill(target)
    (target / "pages").mkdir()
    for name in "mine.txt one.txt old.txt images/mine.fits pages/mine.fits".split():
        (target / name).write_text("old")
    fill(target, overwrite=True, stale=("one.txt", "old.txt", "older.txt", "pages"))
    assert tree(target) == NEW | {"mine.txt": "old", "images/mine.fits": "old"}


@pytest.mark.parametrize(
    ("error", "before"), [(ValueError, {}), (KeyboardInterrupt, {"one.txt": "old"})]
)
def test_an_error_changes_nothing(tmp_path, error, before):
    for name, text in before.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(error):
        fill(tmp_path if before else tmp_path / "a" / "b", error(), overwrite=True)
    assert tree(tmp_path) == before


@pytest.mark.parametrize(
    ("place", "error", "words"),
    [
        ("file", None, "file: is a file; choose another folder"),
        ("file/a/b", None, "b: cannot be made or used: Not a directory"),
        ("out", OSError(28, "No space left"), "out: cannot be written: No space left;"),
        ("out", FileNotFoundError(2, "none", "x.fits"), "^.Errno 2. none: 'x.fits'$"),
        ("out", None, "out: cannot be made: another run has written"),
    ],
)
def test_what_the_disk_refuses(tmp_path, place, error, words):
    (tmp_path / "file").write_text("mine")

    def make():
        with product_folder(tmp_path / place):
            if error:
                raise error
            # Another run was quicker.
            (tmp_path / "out" / "other").mkdir(parents=True)

    with pytest.raises(OSError, match=words):
        make()
    left = {"out": False, "out/other": False} if "another run" in words else {}
    assert tree(tmp_path) == {"file": "mine"} | left


def test_an_interrupt_while_files_are_moved_comes_too_late(tmp_path, monkeypatch):
    # A job in the background ignores interrupts.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    real = os.replace

    def replace(old, new):
        os.kill(os.getpid(), signal.SIGINT)
        real(old, new)

    monkeypatch.setattr("astro_scc.products.folder.os.replace", replace)
    fill(tmp_path, overwrite=True)
    assert tree(tmp_path) == NEW
    assert signal.signal(signal.SIGINT, before) is signal.default_int_handler


def test_tables_are_the_ones_of_the_result(written, result, streams):
    own = (written / name for name in ("streams.ecsv", "components.ecsv"))
    assert len({path.read_text() for path in own}) == 1
    every = {"streams": streams, "spectrum": result.spectrum}
    for name, own in (every | {"features": result.features}).items():
        table = QTable.read(written / f"{name}.ecsv")
        for column in own.colnames:
            one, other = (getattr(k, "isot", k) for k in (table[column], own[column]))
            np.testing.assert_array_equal(np.asarray(one), np.asarray(other))
            assert getattr(one, "unit", None) == getattr(other, "unit", None)
    meta, ratio = table.meta, (table["beta_app"] / table["pm"]).value
    np.testing.assert_allclose(ratio, (streams["beta_app"] / streams["pm"])[0].value)
    assert meta["configuration"] == SETTINGS
    assert (meta["seed"], meta["n_trials"], meta["redshift"]) == (1, 200, 0.158)
    assert meta["history"] == ["simulated: here"]
    assert meta["cosmology"]["name"] == "Planck18"


def test_maps_satisfy_the_standard(written, result):
    with fits.open(written / "scc.fits") as hdus:
        hdus.verify("exception")
        names = "COEFFICIENT ZSCORE DIAGRAM INTERVALS FEATURES".split()
        assert [hdu.name for hdu in hdus] == names
        for k, values in enumerate((result.coefficient, result.z_score)):
            np.testing.assert_array_equal(hdus[k].data, values)
            wcs = WCS(hdus[k].header)
            assert [str(unit) for unit in wcs.wcs.cunit] == ["mas / yr"] * 2
            v1, v2 = wcs.pixel_to_world_values(*np.indices(values.T.shape))
            np.testing.assert_allclose(v1[:, 0], result.grid.v1, atol=1e-9)
            np.testing.assert_allclose(v2[0], result.grid.v2, atol=1e-9)
            header = hdus[0].header
    assert (header["SEED"], header["NTRIALS"], header["NEPOCHS"]) == (1, 200, 8)
    assert (header["OBJECT"], header["JETPA"]) == ("Gr??e", 270)
    assert list(header["HISTORY"]) == ["simulated: here"]
    assert {"scales = [2]", "# Gr??e"} <= {*header["COMMENT"]}


PAPERS = ["mertens2016", "mertens2015", "astro_scc"]


def cited(text):
    """The keys of the entries, whose braces are balanced."""
    assert text.count("{") == text.count("}")
    return re.findall(r"^@\w+{(\w+),", text, re.MULTILINE)


def test_what_a_result_rests_on(result, streams, written):
    assert cited(result.citations()) == PAPERS
    text = result.citations(streams)
    assert cited(text) == [*PAPERS, "cosmology"]
    assert "Planck18: Planck Collaboration 2018" in text
    assert f"version = {{{versions()['astro_scc']}}}" in text
    assert (written / "citations.bib").read_text(encoding="utf-8") == text


@pytest.mark.parametrize(
    ("history", "meta", "keys", "said"),
    [
        (["components from a.txt (MOJAVE)"], {}, [*PAPERS, "lister2021"], ""),
        ([], {}, PAPERS, "% Cite the survey or the observers of the images, too."),
        ([], {"cosmology": None}, PAPERS, "Om0 = 0.27, as in mertens2016."),
        ([], {"cosmology": "H0=70,Om0=0.3"}, PAPERS, "H0 = 70 km/s/Mpc, Om0 = 0.3."),
    ],
)
def test_citations_are_of_what_was_used(history, meta, keys, said):
    text = citations_of(history, meta)
    assert cited(text) == keys
    assert said in text


def indices(ssps, epoch, scale):
    return np.flatnonzero((ssps.epoch == epoch) & (ssps.scale == scale))


def test_outlines_hold_the_pixels(matched, tmp_path):
    ssps, cube, path = matched.ssps, matched.cube, tmp_path / "ssps.reg"
    here = indices(ssps, 2, 1)
    assert write_ssp_regions(SSPs.empty(), cube, 2, path) == 0
    assert len(Regions.read(path, format="ds9")) == 0
    how = {"scales": [1], "overwrite": True}
    assert write_ssp_regions(ssps, cube, 2, path, **how) == len(here) > 3
    read = Regions.read(path, format="ds9")
    for index, region in zip(here, read, strict=True):
        assert region.meta["text"] in (str(index), index)
        mask = region.to_pixel(cube.wcs).to_mask(mode="center")
        inside = np.flatnonzero(mask.to_image(cube.shape[1:]) > 0)
        assert np.array_equal(inside, np.sort(ssps.pixels_of(index)))


def test_segmentation(matched):
    image = ssp_segmentation(matched.ssps, matched.cube, -1, 2)
    here = indices(matched.ssps, len(matched.cube) - 1, 2)
    y, x = np.round([matched.ssps.y, matched.ssps.x])[:, here].astype(int)
    assert np.array_equal(image.data[y, x], here + 1)
    assert np.array_equal(image.labels, here + 1)
    assert ssp_segmentation(SSPs.empty(), matched.cube, 0, 1).n_labels == 0
    assert np.array_equal(image.areas, matched.ssps.n_pixels[here])


def test_what_is_refused(matched):
    for frame, words in (("sky", "frame must be"), ("epoch", "was not read from")):
        with pytest.raises(ValueError, match=words):
            ssp_regions(SSPs.empty(), matched.cube, 0, frame=frame)


def test_a_file_for_every_epoch(matched, tmp_path):
    ssps, cube = matched.ssps, matched.cube
    labels = ["jet.fits", "../../up.fits", "-", "a" * 99, *cube.labels[4:]]
    named = replace(cube, labels=labels)
    paths = write_epoch_regions(ssps, named, tmp_path, scales=[3])
    names = [path.name for path in paths[:4]]
    assert names == ["00_jet.reg", "01_up.reg", "02_-.reg", f"03_{'a' * 60}.reg"]
    assert sorted((tmp_path / "ssp_regions").iterdir()) == paths
    for i, path in enumerate(paths):
        read = Regions.read(path)
        assert [int(region.meta["text"]) for region in read] == [*indices(ssps, i, 3)]
