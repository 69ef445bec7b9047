# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Knots are longer than wide, beams of headers are off, and units are arbitrary."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time
from scipy.ndimage import gaussian_filter

from astro_scc.epochs import Beam, EpochCube
from astro_scc.features import find_features
from astro_scc.features.detections import gaussians_of, pixel_flux
from astro_scc.features.gaussians import fit_gaussians

FWHM = np.sqrt(8 * np.log(2))
BEAM, STEP, CORE = 6.0, 2.0, (30.0, 40.0)
#: Offsets along the jet and across it in pixels, and fluxes.
KNOTS = [(14, -3, 0.5), (32, 4, 0.35), (50, -4, 0.3), (69, 2, 0.25), (88, -2, 0.2)]


def images(widths=(BEAM, BEAM), noise=1e-3, n_epochs=7):
    """Return images of a core and of knots with full widths along y and x."""
    rng, (y, x) = np.random.default_rng(4), np.indices((80, 150), dtype=float)
    wy, wx = np.array(widths) / FWHM
    found = []
    for k in range(n_epochs):
        error = gaussian_filter(rng.normal(size=y.shape), BEAM / FWHM)
        image = noise * error / error.std()
        for dx, dy, flux in [(-STEP * k, 0, 1.0), *KNOTS]:
            x0, y0 = CORE[0] + dx + STEP * k, CORE[1] + dy
            own = flux * (1 if flux == 1 else rng.normal(1, 0.1))
            image += own * np.exp(-(((x - x0) / wx) ** 2 + ((y - y0) / wy) ** 2) / 2)
        found.append(image)
    return np.array(found)


def cube_of(data, interval=1 * u.yr, pixel=0.1 * u.mas, beam=BEAM):
    times = Time("1960-01-01T00:00:00", scale="utc") + np.arange(len(data)) * interval
    return EpochCube.from_arrays(
        data, Time(times, format="isot"), pixel_scale=pixel, reference_pixel=CORE,
        unit=u.Jy / u.beam, beams=Beam(beam * pixel, beam * pixel),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("widths", "noise"),
    [((1, 1.15), 1e-4), ((1, 1.4), 5e-3), ((1.4, 1), 1e-3), ((1, 2), 1e-3)],
)
def test_an_elongated_knot_is_one_feature(widths, noise):
    features = find_features(cube_of(images(BEAM * np.array(widths), noise)))
    assert features.secure.sum() == len(KNOTS)
    for motion, secure in zip(features.motions, features.secure, strict=True):
        off = abs(motion.speed - 0.1 * STEP)
        assert not secure or off < max(0.01 * STEP, 2 * motion.speed_err)


@pytest.mark.parametrize("ratio", [0.96, 1.04])
def test_a_beam_that_is_off_makes_no_features(ratio):
    features = find_features(cube_of(images(noise=2e-4), beam=ratio * BEAM))
    assert features.secure.sum() == len(KNOTS)


def gaussian(y0, x0, covariance, peak=1.0):
    offset = np.indices((80, 90)) - np.array([y0, x0])[:, None, None]
    inverse = np.linalg.inv(covariance)
    return peak * np.exp(-np.einsum("iyx,ij,jyx->yx", offset, inverse, offset) / 2)


def test_an_ellipse_is_found_with_its_place_and_flux():
    beam = np.array([[16.0, 2.0], [2.0, 9.0]])
    covariance = beam + np.array([[6.0, -8.0], [-8.0, 14.0]])
    found = fit_gaussians(gaussian(40.3, 45.6, covariance), beam, 1e-3)
    (k,) = np.flatnonzero(found["group"] <= 0)
    assert found["y"][k] == pytest.approx(40.3, abs=1e-3)
    assert found["x"][k] == pytest.approx(45.6, abs=1e-3)
    assert found["peak"][k] == pytest.approx(1, rel=1e-3)
    ratio = np.linalg.det(covariance) / np.linalg.det(beam)
    assert found["flux"][k] == pytest.approx(np.sqrt(ratio), rel=1e-3)
    assert found["size"][k] == pytest.approx(FWHM * np.sqrt(10), rel=1e-3)


INTEGRAL = 18 * np.pi  # of the Gaussian, in pixels of 0.01 mas2
FLUXES = [
    ("Jy / beam", 2 * np.log(2) * u.Jy), ("Jy / pix", INTEGRAL * u.Jy),
    ("Jy / arcsec2", 1e-8 * INTEGRAL * u.Jy), ("adu", INTEGRAL * u.adu),
    ("Jy / mas2", 0.01 * INTEGRAL * u.Jy), ("K", 0.01 * INTEGRAL * u.K * u.mas**2),
    ("MJy / sr", 0.01 * INTEGRAL * u.MJy * u.mas.to(u.rad) ** 2),
]  # fmt: skip


@pytest.mark.parametrize(("unit", "flux"), FLUXES)
def test_fluxes_are_integrals(unit, flux):
    cube = EpochCube.from_arrays(
        [gaussian(40.3, 45.6, 9 * np.eye(2))] * 2, ["2000-01-01", "2001-01-01"],
        pixel_scale=0.1 * u.mas, unit=unit, noise=1e-3 * u.Unit(unit),
        beams=[Beam(0.6 * u.mas, 0.6 * u.mas), Beam(0.3 * u.mas, 0.3 * u.mas)],
    )  # fmt: skip
    found = gaussians_of(cube).flux * pixel_flux(cube).unit
    assert found.unit == flux.unit
    ratio = 4 if "beam" in unit else 1
    assert found.value == pytest.approx(flux.value * np.array([1, ratio]), rel=1e-3)
    without = pixel_flux(replace(cube, beams=None))
    assert without.unit == ("Jy pix / beam" if "beam" in unit else flux.unit)


@pytest.mark.parametrize("apart", [0.6, 0.8, 1.2])
def test_two_bright_points_stay_two(apart):
    beam = 9 * np.eye(2)
    image = sum(
        gaussian(40, 45 + dx * apart * 3 * FWHM, beam, peak)
        for dx, peak in ((-0.5, 1.0), (0.5, 0.6))
    )
    found = fit_gaussians(image, beam, 1e-3)
    assert np.sum(found["group"] >= 0) == 2


@pytest.fixture(scope="module")
def data():
    return images()


@pytest.fixture(scope="module")
def usual(data):
    return find_features(cube_of(data))


UNITS = [
    (0.1 * u.s, 1 * u.uas, 1.0),
    (1 * u.day, 1 * u.arcsec, 1e6),
    (10 * u.yr, 1 * u.uas, 1e-9),
]


@pytest.mark.filterwarnings("ignore:.*dubious year")
@pytest.mark.parametrize(("interval", "pixel", "brightness"), UNITS)
def test_units_change_nothing_else(data, usual, interval, pixel, brightness):
    found = find_features(cube_of(brightness * data, interval, pixel))
    years, mas = interval.to_value(u.yr), pixel.to_value(u.mas) / 0.1
    assert found.number.tolist() == usual.number.tolist()
    assert found.secure.tolist() == usual.secure.tolist() == [True] * len(KNOTS)
    np.testing.assert_allclose(found.p_false, usual.p_false, rtol=1e-3)
    for new, old in zip(found.motions, usual.motions, strict=True):
        for name, unit in (("place", mas), ("velocity", mas / years)):
            was, error = (getattr(old, name + err) for err in ("", "_err"))
            now, its = (getattr(new, name + err) / unit for err in ("", "_err"))
            np.testing.assert_allclose(now, was, rtol=0, atol=0.01 * error.min())
            np.testing.assert_allclose(its, error, rtol=1e-3)
    flux = found.detections.flux / brightness
    np.testing.assert_allclose(flux, usual.detections.flux, rtol=1e-4)
