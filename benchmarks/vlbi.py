# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Observe simulated jets with the VLBA: visibilities and CLEAN images.

Other benchmarks import this module.  Stations are those of Napier (1995, IEEE Proc. 82,
658), u and v of the baselines are from Thompson, Moran & Swenson (2017, Sect. 4.1).
"""

from dataclasses import replace
from itertools import combinations

import astropy.units as u
import numpy as np
from astropy.constants import c
from astropy.coordinates import EarthLocation

from astro_scc.epochs.restoring import add_gaussians, in_pixels
from astro_scc.images.beam import FWHM_TO_SIGMA, Beam, beam_of
from astro_scc.simulation.jets import SimulatedJet

#: North latitude and west longitude in degrees, elevation in m.
STATIONS = {
    "SC": (17.7566, 64.5836, 16),
    "HN": (42.9336, 71.9866, 296),
    "NL": (41.7714, 91.5741, 222),
    "FD": (30.6350, 103.9448, 1606),
    "LA": (35.7751, 106.2456, 1962),
    "PT": (34.3010, 108.1192, 2365),
    "KP": (31.9563, 111.6124, 1902),
    "OV": (37.2317, 118.2770, 1196),
    "BR": (48.1312, 119.6833, 250),
    "MK": (19.8014, 155.4555, 3763),
}
#: Lowest elevation at which a station observes, in degrees.
LOWEST = 10.0
#: CLEAN: fraction of the peak that is subtracted; half width of the window around
#: the jet, in beams; and threshold, in root mean squares of the noise.
LOOP_GAIN, WINDOW, STOP = 0.1, 3.0, 3.0


def observe(
    jet: SimulatedJet, *, declination: u.Quantity = 20 * u.deg,
    frequency: u.Quantity = 15.4 * u.GHz, n_scans: int = 8, gain_error: float = 0.005,
    beam: Beam | None = None, n_iterations: int = 2000,
    rng: np.random.Generator | int | None = None,
) -> SimulatedJet:  # fmt: skip
    """
    Observe a simulated jet with the VLBA, and image it with CLEAN.

    Every epoch has scans at hour angles of its own, within about five hours of
    transit at the middle of the array.  The visibilities of the Gaussian
    features are analytic.  They get errors of the antennas' gains, and the
    thermal noise that gives the image the noise of the simulation.  The
    naturally weighted dirty image is CLEANed (Hoegbom 1974) along the jet and
    restored with a Gaussian beam.

    Parameters
    ----------
    jet : `SimulatedJet`
    declination : `~astropy.units.Quantity`, optional
        Declination of the source, which sets the coverage and so the beam.
    frequency : `~astropy.units.Quantity`, optional
    n_scans : int, optional
        Number of scans at each epoch; each has two times five minutes apart.
    gain_error : float, optional
        Standard deviation, in real and imaginary part, of the errors of the
        antennas' gains that self-calibration leaves in each scan.
    beam : `~astro_scc.epochs.Beam`, optional
        Beam with which all epochs are restored; by default, a Gaussian fitted
        to the main lobe of each epoch's dirty beam.
    n_iterations : int, optional
        Most CLEAN components of an epoch; CLEAN ends earlier at three times
        the noise.
    rng : `numpy.random.Generator`, seed or None, optional
        Passed to `numpy.random.default_rng`.

    Returns
    -------
    `SimulatedJet`
        The same jet with new images.

    Raises
    ------
    ValueError
        If fewer than three baselines see the source, or an option is outside
        its range.

    Examples
    --------
    >>> from vlbi import observe
    >>> from astro_scc.simulation import simulate_jet
    >>> jet = observe(simulate_jet(n_epochs=2, shape=(64, 160), rng=1), rng=1)
    >>> jet.cube.shape
    (2, 64, 160)
    """
    if not (n_scans >= 1 and n_iterations >= 0 and gain_error >= 0):
        raise ValueError(
            "n_scans must be at least 1, n_iterations and gain_error zero or "
            f"positive; got {n_scans}, {n_iterations}, {gain_error}"
        )
    setup = jet.simulation
    scale = setup.pixel_scale.to_value(u.rad)
    y, x = np.ogrid[: setup.shape[0], : setup.shape[1]]
    east = -(x.ravel() - setup.extent[0]) * scale
    north = (y.ravel() - setup.axis) * scale
    window = _window(setup, x, y)
    images, beams = [], []
    rngs = np.random.default_rng(rng).spawn(len(jet.cube))
    for i, (noise, own_rng) in enumerate(zip(setup.noise, rngs, strict=True)):
        features = jet.truth[jet.truth["epoch"] == i]
        uv, (first, second, scan) = _coverage(declination, frequency, n_scans, own_rng)
        visibility = _visibilities(features, setup, uv)
        gains = 1 + gain_error * _complex_normal(own_rng, (len(STATIONS), n_scans))
        visibility *= gains[first, scan] * gains[second, scan].conj()
        visibility += noise * np.sqrt(len(uv)) * _complex_normal(own_rng, len(uv))
        image = _transform(visibility, uv, east, north)
        psf = _dirty_beam(uv, scale, setup.shape)
        model = _clean(image, psf, window, STOP * noise, n_iterations)
        beams.append(beam or _fitted_beam(psf, setup.pixel_scale))
        at_y, at_x = np.nonzero(model)
        shapes = [in_pixels(beams[i], setup.pixel_scale)] * len(at_x)
        images.append(add_gaussians(image, at_x, at_y, model[at_y, at_x], shapes))
    line = f"observed with {len(STATIONS)} antennas"
    data = np.array(images)
    fields = {"data": data, "mask": ~np.isfinite(data), "noise": None, "beams": beams}
    return replace(jet, cube=jet.cube.with_step(line, **fields))


def _complex_normal(rng, shape):
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def _coverage(declination, frequency, n_scans, rng):
    """
    Return the spatial frequencies of all baselines and times.

    Returns
    -------
    uv : `numpy.ndarray`, shape (n, 2)
    antennas : `numpy.ndarray` of int, shape (3, n)
        First and second antenna, and scan.
    """
    latitude, west, height = np.array(list(STATIONS.values())).T
    where = EarthLocation.from_geodetic(-west * u.deg, latitude * u.deg, height * u.m)
    stations = np.array([axis.to_value(u.m) for axis in where.geocentric])
    dec = declination.to_value(u.rad)
    # Hour angles of the scans at Greenwich: the middle of the array is 112 deg west.
    scans = np.radians(15 * np.linspace(-5, 5, n_scans)) + np.radians(112)
    scans = scans + rng.uniform(-0.5, 0.5, n_scans) * np.radians(150 / n_scans)
    times = (scans[:, None] + np.radians(15 / 12) * np.arange(2)).ravel()
    # Unit vectors towards the source and along u and v (Thompson et al., Eq. 4.1).
    zero, sin, cos = 0 * times, np.sin(times), np.cos(times)
    source = np.array([np.cos(dec) * cos, -np.cos(dec) * sin, zero + np.sin(dec)])
    along_v = [-np.sin(dec) * cos, np.sin(dec) * sin, zero + np.cos(dec)]
    along = np.array([[sin, cos, zero], along_v])
    up = stations / np.linalg.norm(stations, axis=0)
    seen = np.degrees(np.arcsin(up.T @ source)) > LOWEST
    pairs = np.array(list(combinations(range(len(STATIONS)), 2))).T
    wavelength = (c / frequency).to_value(u.m)
    baseline = (stations[:, pairs[1]] - stations[:, pairs[0]]) / wavelength
    uv = np.einsum("aij,ik->kja", along, baseline)
    good = seen[pairs[0]] & seen[pairs[1]]
    if good.sum() < 3:
        raise ValueError(
            "fewer than three baselines of the VLBA see a source at declination "
            f"{declination}"
        )
    pair, time = np.nonzero(good)
    return uv[good], np.array([*pairs[:, pair], time // 2])


def _visibilities(features, setup, uv):
    """Return the visibilities, the sum of S exp(-2 pi i (u l + v m)) of Gaussians."""
    scale = setup.pixel_scale.to_value(u.rad)
    x, y = features["x"].value - setup.extent[0], features["y"].value - setup.axis
    sigma = FWHM_TO_SIGMA * features["fwhm"].to_value(u.rad)
    phase = uv @ (np.array([-x, y]) * scale)
    size = np.sum(uv**2, axis=1)[:, None] * sigma**2
    return np.exp(-2j * np.pi * phase - 2 * np.pi**2 * size) @ features["flux"].value


def _transform(visibility, uv, east, north):
    """Return the image at the offsets: the mean of V exp(2 pi i (u l + v m))."""
    columns = np.exp(2j * np.pi * np.outer(uv[:, 0], east)) * visibility[:, None]
    rows = np.exp(2j * np.pi * np.outer(north, uv[:, 1]))
    # The real part of the product, as real products are faster.
    image = rows.real @ columns.real - rows.imag @ columns.imag
    return image / len(uv)


def _dirty_beam(uv, scale, shape):
    """Return the response to a point source, shape (2 ny - 1, 2 nx - 1), centred."""
    ny, nx = shape
    half = _transform(
        np.ones(len(uv)), uv, -np.arange(1 - nx, nx) * scale, np.arange(ny) * scale
    )
    return np.concatenate([half[:0:-1, ::-1], half])


def _window(setup, x, y):
    """Return the pixels near the jet where CLEAN searches for components."""
    angle = setup.position_angle.to_value(u.rad)
    x, y = x - setup.extent[0], y - setup.axis
    along = -x * np.sin(angle) + y * np.cos(angle)
    across = x * np.cos(angle) + y * np.sin(angle)
    margin = WINDOW * setup.beam_length
    length = setup.extent[1] - setup.extent[0]
    inside = (along > -margin) & (along < length + margin)
    return np.flatnonzero(inside & (np.abs(across) < margin))


def _clean(image, psf, window, stop, n_iterations):
    """Return the CLEAN components of an image, and leave residuals in the image."""
    ny, nx = image.shape
    model = np.zeros_like(image)
    flat = image.reshape(-1)
    for _ in range(n_iterations):
        inside = flat[window]
        at = np.argmax(np.abs(inside))
        if abs(inside[at]) <= stop:
            break
        y, x = divmod(window[at], nx)
        taken = LOOP_GAIN * inside[at]
        model[y, x] += taken
        image -= taken * psf[ny - 1 - y : 2 * ny - 1 - y, nx - 1 - x : 2 * nx - 1 - x]
    return model


def _fitted_beam(psf, pixel_scale):
    """Fit a Gaussian beam: a parabola to the logarithm of the main lobe."""
    from skimage.measure import label

    middle = tuple(n // 2 for n in psf.shape)
    lobe = label(psf > 0.5, connectivity=1)
    y, x = np.nonzero(lobe == lobe[middle])
    level = -np.log(psf[y, x])
    y, x = y - middle[0], x - middle[1]
    # East is in the direction of smaller x.
    terms = np.stack([0.5 * x * x, -x * y, 0.5 * y * y], axis=1)
    a, b, d = np.linalg.lstsq(terms, level, rcond=None)[0]
    return beam_of(np.linalg.inv([[a, b], [b, d]]), pixel_scale)
