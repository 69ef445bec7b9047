# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Lists of components that are given where images are expected."""

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.time import Time

from astro_scc import EpochCube
from astro_scc.epochs import Beam, ComponentList, inspect_epochs, read_components
from astro_scc.exceptions import EpochWarning
from astro_scc.images.beam import parse_beam

BEAM = Beam(1.0 * u.mas, 0.5 * u.mas, -7 * u.deg)
RESTORED = "lists of components were restored with the beam 1 x 0.5 mas at -7.0 deg"


@pytest.fixture
def models(tmp_path):
    """Difmap models of a core and a feature that moves by 0.5 mas."""
    for k, date in enumerate(("2006-03-09", "2006-09-09")):
        text = f"1.0v 0.0v 0v 0.2v 1 0 1\n0.3v {2 + 0.5 * k}v 45v 0.5v 1 0 1\n"
        (tmp_path / f"source_{date}.mod").write_text(text)
    return sorted(tmp_path.glob("*.mod"))


def cc_file(path, *, image=False, **changes):
    """An AIPS CC table, with the header of the image and perhaps the image."""
    header = {"OBJECT": "3C1", "DATE-OBS": "2006-03-09", "BMAJ": 1e-3 / 3600}
    header |= {"BMIN": 0.5e-3 / 3600, "BPA": -7.0}
    columns = {"FLUX": [1.0, 0.3], "DELTAX": [0, 2], "DELTAY": [0, 2]}
    columns = [
        fits.Column(
            name, "E", unit="JY" if name == "FLUX" else "DEGREES",
            array=np.array(values) * (1 if name == "FLUX" else 1e-3 / 3600),
        )
        for name, values in columns.items()
    ]  # fmt: skip
    primary = fits.PrimaryHDU(np.eye(8) if image else None)
    primary.header.update({k: v for k, v in (header | changes).items() if v})
    table = fits.BinTableHDU.from_columns(columns, name="AIPS CC")
    fits.HDUList([primary, table]).writeto(path)
    return path


def test_difmap_models_are_restored(models):
    with pytest.warns(EpochWarning, match=RESTORED) as caught:
        cube = EpochCube.read(models, beams=BEAM)
    assert "pixels of 0.1 mas and noise of 0.0" in str(caught[0].message)
    assert cube.times.isot[1][:10] == "2006-09-09"
    assert cube.beams == (BEAM, BEAM)
    assert np.allclose(cube.data[0].max(), 0.9, atol=0.1)
    # The faintest component, of 0.15 to 0.3 Jy a beam, is ten times the noise.
    assert np.all((cube.noise > 0.015 * cube.unit) & (cube.noise < 0.03 * cube.unit))
    assert np.all(abs(cube.measured_noise / cube.noise - 1) < 0.2)
    with pytest.warns(EpochWarning, match=RESTORED):
        again = EpochCube.read(models[::-1], beams=[BEAM, BEAM])
    assert np.array_equal(again.data, cube.data)


def test_dates_may_be_given(models, tmp_path):
    path = models[0].rename(tmp_path / "model.mod")
    with pytest.raises(ValueError, match=r"model.mod: no date .* or give dates"):
        EpochCube.read(path, beams=BEAM)
    with pytest.warns(EpochWarning, match=RESTORED):
        cube = EpochCube.read(path, beams=BEAM, times="2006-03-09")
    assert cube.times.isot[0][:10] == "2006-03-09"


def test_without_a_beam(models):
    reason = r"09.mod: is a list of components without a beam .*; give --beam '1.0 mas"
    with pytest.raises(ValueError, match=reason):
        EpochCube.read(models)


def test_aips_table_without_an_image(tmp_path):
    path = cc_file(tmp_path / "cc.fits")
    with pytest.warns(EpochWarning, match=RESTORED):
        cube = EpochCube.read(path)
    assert cube.beams == (BEAM,)
    assert cube.meta["object"] == "3C1"
    bare = cc_file(tmp_path / "bare.fits", BMAJ=None, BMIN=None, BPA=None)
    with pytest.raises(ValueError, match=r"bare.fits: .* without a beam"):
        EpochCube.read(bare)
    undated = cc_file(tmp_path / "undated.fits", **{"DATE-OBS": None})
    with pytest.raises(ValueError, match="undated.fits: no DATE-OBS in the header;"):
        EpochCube.read(undated)


def test_an_image_beside_an_aips_table_is_the_image(tmp_path):
    path = cc_file(tmp_path / "image.fits", image=True)
    with pytest.raises(ValueError, match="image.fits: .*coordinates"):
        EpochCube.read(path)


def test_beams_of_components(models, tmp_path):
    own = read_components(models[0], beams=BEAM)
    assert own.beams == (BEAM,)
    both = read_components(models, beams=[BEAM, Beam(2 * u.mas, 1 * u.mas)])
    assert both.beams == (BEAM, Beam(2 * u.mas, 1 * u.mas))
    assert both.select(after="2006-06-01").beams == both.beams[1:]
    assert "beam" not in both.to_table().meta
    own.to_table().write(tmp_path / "a.ecsv", format="ascii.ecsv")
    assert read_components(tmp_path / "a.ecsv").beams == (BEAM,)
    assert read_components(models).beams == ()
    # Dates are sorted with what belongs to them.
    unsorted = ComponentList(
        times=Time(["2007-01-01", "2006-01-01"]), epoch=[0, 1], flux=[1, 2] * u.Jy,
        east=[0, 0] * u.mas, north=[0, 0] * u.mas, beams=both.beams,
    )  # fmt: skip
    assert unsorted.beams == both.beams[::-1]


def test_a_table_with_a_wrong_beam(models, tmp_path):
    table = read_components(models[0], beams=BEAM).to_table()
    table.meta["beam"] = "1 mas 0.5 mas"
    table.write(tmp_path / "a.ecsv", format="ascii.ecsv")
    with pytest.raises(ValueError, match="a.ecsv, beam in its meta: is no beam: has"):
        read_components(tmp_path / "a.ecsv")


def test_no_component_is_positive(models):
    models[1].write_text("-0.1v 1v 0v 0.2v 1 0 1\n")
    with pytest.raises(ValueError, match=r"09-09.mod: no component is positive; leave"):
        EpochCube.read(models, beams=BEAM)


def test_lists_among_images(models, tmp_path, make_fits):
    image = make_fits()
    with pytest.raises(ValueError, match=r"09.mod: is a list of components and no im"):
        EpochCube.read([image, *models])
    with pytest.raises(ValueError, match=r"a.fits: no AIPS CC table .* leave it out"):
        EpochCube.read([*models, image], beams=BEAM)
    problems = inspect_epochs([image, *models])["problem"]
    assert sum("give lists alone to astro-scc measure" in p for p in problems) == 2


def test_visibilities(tmp_path):
    path = tmp_path / "a.uvf"
    data = fits.GroupData(
        np.ones((5, 1, 1, 1, 1, 1, 3), "f4"), bitpix=-32, parnames=["UU", "VV"],
        pardata=[np.ones(5)] * 2,
    )  # fmt: skip
    fits.GroupsHDU(data).writeto(path)
    idi = fits.BinTableHDU.from_columns([fits.Column("FLUX", "E")], name="UV_DATA")
    fits.HDUList([fits.PrimaryHDU(), idi]).writeto(tmp_path / "a.idifits")
    for own in (path, tmp_path / "a.idifits"):
        with pytest.raises(OSError, match="holds visibilities and no image; make an"):
            EpochCube.read(own)


def test_beams_as_text():
    assert parse_beam("1.0 mas 0.5 mas -7 deg") == BEAM
    assert parse_beam("0.8 mas") == Beam(0.8 * u.mas, 0.8 * u.mas)
    for text in ("1", "1 mas 0.5 mas", "1 1 1 1 mas", "1 mas 2 mas 0 deg"):
        with pytest.raises(ValueError, match="is no beam: .*; give major axis, minor"):
            parse_beam(text)
