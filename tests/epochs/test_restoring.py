# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.time import Time
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.components.restoring import add_gaussians
from astro_scc.epochs import Beam, ComponentList, read_components, restore, write_epochs
from astro_scc.exceptions import EpochWarning

PIXEL = 0.1 * u.mas
BEAM = Beam(1 * u.mas, 0.5 * u.mas, -7 * u.deg)


def components(**changes):
    columns = {
        "times": Time(["2006-01-01", "2006-07-01"]),
        "epoch": [0, 0, 1],
        "flux": [1.0, 0.5, 0.8] * u.Jy,
        "east": [0.0, 2.0, 0.4] * u.mas,
        "north": [0.0, 1.0, 0.2] * u.mas,
        "major": [0.0, 0.8, 0.3] * u.mas,
        "minor": [0.0, 0.4, 0.3] * u.mas,
        "pa": [0.0, 60.0, 0.0] * u.deg,
    }
    return ComponentList(**{**columns, **changes})


def one(**changes):
    """One component at the origin."""
    columns = {
        "times": Time(["2006-01-01"]),
        "epoch": [0],
        "flux": [2.0] * u.Jy,
        "east": [0.0] * u.mas,
        "north": [0.0] * u.mas,
    }
    return ComponentList(**{**columns, **changes})


def moments(image):
    y, x = np.indices(image.shape)
    total = image.sum()
    mx, my = (image * x).sum() / total, (image * y).sum() / total
    dx, dy = x - mx, y - my
    return (
        mx,
        my,
        np.array(
            [
                [(image * dx * dx).sum(), (image * dx * dy).sum()],
                [(image * dx * dy).sum(), (image * dy * dy).sum()],
            ]
        )
        / total,
    )


def literal_sum(image, x, y, peak, covariance):
    """Every Gaussian at every pixel."""
    yy, xx = np.indices(image.shape)
    for x0, y0, p, c in zip(x, y, peak, covariance, strict=True):
        d = np.stack([xx - x0, yy - y0], axis=-1)
        image = image + p * np.exp(
            -0.5 * np.einsum("...i,ij,...j->...", d, np.linalg.inv(c), d)
        )
    return image


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_boxes_equal_the_literal_sum(data):
    n = data.draw(st.integers(0, 4))
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    x, y = rng.uniform(-30, 60, n), rng.uniform(-30, 50, n)
    peak = rng.normal(size=n)
    angle = rng.uniform(0, np.pi, n)
    width, ratio = rng.uniform(0.3, 12, n), rng.uniform(0.02, 1, n)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turn = np.moveaxis(turn, -1, 0)
    diagonal = np.zeros((n, 2, 2))
    diagonal[:, 0, 0], diagonal[:, 1, 1] = width**2, (width * ratio) ** 2
    covariance = turn @ diagonal @ np.swapaxes(turn, 1, 2)
    shape = (21, 34)
    fast = add_gaussians(np.zeros(shape), x, y, peak, covariance)
    slow = literal_sum(np.zeros(shape), x, y, peak, covariance)
    np.testing.assert_allclose(fast, slow, rtol=1e-9, atol=1e-9)


def test_point_is_the_beam():
    cube = restore(one(), beam=BEAM, pixel_scale=PIXEL)
    image = cube.data[0]
    x, y = cube.wcs.wcs.crpix - 1
    assert image[int(y), int(x)] == pytest.approx(2.0)
    mx, my, covariance = moments(image)
    assert (mx, my) == pytest.approx((x, y), abs=1e-6)
    flip = np.diag([-1, 1])
    expected = flip @ (BEAM.covariance / PIXEL**2).to_value(u.one) @ flip
    np.testing.assert_allclose(covariance, expected, atol=1e-4)
    assert cube.unit == u.Jy / u.beam
    assert cube.beams == (BEAM,)
    assert cube.noise is None


def test_flux_is_kept_and_covariances_add():
    source = one(major=[0.9] * u.mas, minor=[0.3] * u.mas, pa=[40] * u.deg)
    cube = restore(source, beam=BEAM, pixel_scale=PIXEL)
    pixels_a_beam = (BEAM.area / PIXEL**2).to_value(u.one)
    assert cube.data[0].sum() / pixels_a_beam == pytest.approx(2.0, rel=1e-6)
    own = Beam(0.9 * u.mas, 0.3 * u.mas, 40 * u.deg).covariance
    flip = np.diag([-1, 1])
    expected = flip @ ((BEAM.covariance + own) / PIXEL**2).to_value(u.one) @ flip
    _, _, covariance = moments(cube.data[0])
    np.testing.assert_allclose(covariance, expected, rtol=1e-4, atol=1e-3)


def test_positions_through_the_wcs():
    position = SkyCoord("12h29m06.7s", "2d03m08.6s")
    cube = restore(components(), beam=BEAM, pixel_scale=PIXEL, position=position)
    image = cube.data[1]
    sky = cube.wcs.pixel_to_world(*moments(image)[:2])
    east, north = position.spherical_offsets_to(sky)
    assert east.to_value(u.mas) == pytest.approx(0.4, abs=1e-3)
    assert north.to_value(u.mas) == pytest.approx(0.2, abs=1e-3)


def test_grid_holds_everything_within_the_margin():
    cube = restore(components(), beam=BEAM, pixel_scale=PIXEL, margin=4)
    x, y = cube.wcs.wcs.crpix - 1
    ny, nx = cube.shape[1:]
    assert x - 20 >= 40
    assert nx - 1 - x >= 40
    assert y >= 40
    assert ny - 1 - y - 10 >= 40
    edge = np.concatenate(
        [cube.data[:, [0, -1]].ravel(), cube.data[:, :, [0, -1]].flat]
    )
    assert np.abs(edge).max() < 1e-12


def test_given_grid():
    cube = restore(
        components(),
        beam=BEAM,
        pixel_scale=PIXEL,
        shape=(64, 80),
        reference_pixel=(50, 20),
    )
    assert cube.shape == (2, 64, 80)
    assert tuple(cube.wcs.wcs.crpix) == (51, 21)
    centred = restore(one(), beam=BEAM, pixel_scale=PIXEL, shape=(65, 81))
    assert tuple(centred.wcs.wcs.crpix) == (41, 33)
    beside = restore(one(), beam=BEAM, pixel_scale=PIXEL, reference_pixel=(200, 10))
    assert tuple(beside.wcs.wcs.crpix) == (201, 11)
    assert beside.data[0, 10, 200] == pytest.approx(2.0)


def test_components_outside_are_told():
    with pytest.warns(EpochWarning, match="1 of 3 components lie outside"):
        restore(
            components(),
            beam=BEAM,
            pixel_scale=PIXEL,
            shape=(40, 20),
            reference_pixel=(5, 20),
        )


def test_a_beam_for_each_epoch():
    beams = [BEAM, Beam(2 * u.mas, 1 * u.mas)]
    cube = restore(components(), beam=beams, pixel_scale=PIXEL)
    assert cube.beams == tuple(beams)
    alone = restore(
        components().select(after="2006-03-01"),
        beam=beams[1],
        pixel_scale=PIXEL,
        shape=cube.shape[1:],
        reference_pixel=cube.wcs.wcs.crpix - 1,
    )
    np.testing.assert_array_equal(cube.data[1], alone.data[0])


def test_noise_and_seeds():
    options = {"beam": BEAM, "pixel_scale": PIXEL, "noise": 3 * u.mJy / u.beam}
    clean = restore(components(), beam=BEAM, pixel_scale=PIXEL)
    noisy = restore(components(), rng=1, **options)
    residual = noisy.data - clean.data
    assert residual.std() == pytest.approx(3e-3, rel=0.2)
    assert abs(np.corrcoef(residual[0].ravel(), residual[1].ravel())[0, 1]) < 0.2
    assert noisy.noise.to_value(u.mJy / u.beam) == pytest.approx([3, 3])
    again = restore(components(), rng=np.random.default_rng(1), **options)
    np.testing.assert_array_equal(noisy.data, again.data)
    each = restore(components(), rng=1, **{**options, "noise": [3, 0] * u.mJy / u.beam})
    np.testing.assert_array_equal(each.data[0], noisy.data[0])
    np.testing.assert_array_equal(each.data[1], clean.data[1])


def test_units_of_the_image():
    cube = restore(one(), beam=BEAM, pixel_scale=PIXEL, unit=u.mJy / u.beam)
    assert cube.data.max() == pytest.approx(2000)
    with pytest.raises(u.UnitConversionError):
        restore(one(), beam=BEAM, pixel_scale=PIXEL, unit=u.Jy)
    with pytest.raises(TypeError, match="noise must be a Quantity in Jy / beam"):
        restore(one(), beam=BEAM, pixel_scale=PIXEL, noise=1 * u.mas)


def test_facts_and_history():
    facts = {"object": "3C 273", "redshift": 0.158, "frequency": 15.4e9}
    cube = restore(one(meta=facts), beam=BEAM, pixel_scale=PIXEL)
    assert cube.epoch_meta[0] == {"object": "3C 273", "frequency": 15.4e9}
    assert cube.meta["redshift"] == 0.158
    assert "restored 1 components" in cube.meta["history"][0]
    assert cube.labels == ("2006-01-01",)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"beam": [BEAM]}, "2 epochs need 2 beams, got 1"),
        ({"beam": None}, "needs a beam; give one"),
        ({"beam": []}, "needs a beam; give one"),
        ({"noise": [1, 2, 3] * u.mJy / u.beam}, "2 epochs need 2 noises"),
        ({"noise": -1 * u.mJy / u.beam}, "noise must be finite and not negative"),
        ({"pixel_scale": 0 * u.mas}, "pixel_scale = .* must be finite and above 0"),
        ({"shape": (0, 5)}, "shape must be"),
        ({"shape": (5,)}, "shape must be"),
        ({"pixel_scale": 1e-5 * u.mas}, "give larger pixels"),
    ],
)
def test_bad_options(options, message):
    with pytest.raises(ValueError, match=message):
        restore(components(), **{"beam": BEAM, "pixel_scale": PIXEL, **options})


def test_restores_what_aips_restored(shared_data):
    for path in sorted((shared_data / "0506+056").glob("*.fits")):
        image, header = fits.getdata(path).squeeze(), fits.getheader(path)
        cube = restore(
            read_components(path),
            beam=Beam(*(header[k] * u.deg for k in ("BMAJ", "BMIN", "BPA"))),
            pixel_scale=header["CDELT2"] * u.deg,
            shape=image.shape,
            reference_pixel=(header["CRPIX1"] - 1, header["CRPIX2"] - 1),
        )
        # What remains is the residual image: 0.14 mJy, and no source.
        residual = image - cube.data[0]
        assert residual.std() < 2e-4
        assert np.abs(residual).max() < 0.01 * image.max()


def test_3c273_in_seconds(shared_data):
    source = read_components(shared_data / "mojave_xviii" / "1226+023.ecsv")
    cube = restore(source, beam=BEAM, pixel_scale=PIXEL)
    assert len(cube) == 105
    # The core stands at the reference pixel.
    x, y = np.round(cube.wcs.wcs.crpix - 1).astype(int)
    first = source.epoch == 0
    core = np.flatnonzero(first & (source.feature == 0))[0]
    assert cube.data[0, y, x] > 0.5 * source.flux[core].value


# One FITS image an epoch ------------------------------------------------------


def test_written_epochs(tmp_path):
    facts = {"object": "3C 273", "frequency": 15.4e9}
    cube = restore(
        components(meta=facts),
        beam=BEAM,
        pixel_scale=PIXEL,
        noise=1 * u.mJy / u.beam,
        rng=1,
    )
    paths = write_epochs(cube, tmp_path / "new" / "folder")
    assert [p.name for p in paths] == [
        "3C_273_00_2006-01-01.fits",
        "3C_273_01_2006-07-01.fits",
    ]
    assert sorted((tmp_path / "new" / "folder").iterdir()) == sorted(paths)
    with fits.open(paths[1]) as hdus:
        header, image = hdus[0].header, hdus[0].data
        np.testing.assert_allclose(image, cube.data[1], atol=1e-6)
    assert header["DATE-OBS"].startswith("2006-07-01")
    assert header["BUNIT"] == "JY/BEAM"
    assert header["OBJECT"] == "3C 273"
    assert header["CTYPE1"] == "RA---SIN"
    assert header["CRPIX1"] == cube.wcs.wcs.crpix[0]
    assert header["BMAJ"] * u.deg.to(u.mas) == pytest.approx(1.0)
    assert header["NOISE"] == pytest.approx(1e-3)
    assert "restored" in str(header["HISTORY"])


def test_written_masks_are_nan(tmp_path):
    cube = restore(one(), beam=BEAM, pixel_scale=PIXEL, unit=u.mJy / u.beam)
    data = cube.data.copy()
    data[0, 3, 4] = np.nan
    cube = cube.with_step("blanked", data=data, mask=np.isnan(data))
    (path,) = write_epochs(cube, tmp_path, prefix="a b/c")
    assert path.name == "a_b_c_00_2006-01-01.fits"
    image = fits.getdata(path)
    assert np.isnan(image[3, 4])
    assert np.isnan(image).sum() == 1
    assert u.Unit(fits.getheader(path)["BUNIT"]) == u.mJy / u.beam


def test_existing_files_stay(tmp_path):
    cube = restore(one(), beam=BEAM, pixel_scale=PIXEL)
    (path,) = write_epochs(cube, tmp_path)
    assert path.name.startswith("epoch_00")
    with pytest.raises(OSError, match="exists; choose"):
        write_epochs(cube, tmp_path)
    assert write_epochs(cube, tmp_path, overwrite=True) == [path]
    assert list(tmp_path.iterdir()) == [path]
