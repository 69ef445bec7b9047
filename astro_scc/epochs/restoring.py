# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images of model components, and noise correlated by a restoring beam."""

from __future__ import annotations

from collections.abc import Sequence

import astropy.units as u
import numpy as np
import scipy

from astro_scc.epochs.lists import ComponentList, read_components
from astro_scc.exceptions import warn
from astro_scc.images import headers, positions, series
from astro_scc.images.beam import FWHM_TO_SIGMA, Beam
from astro_scc.images.grid import gaussian_transfer
from astro_scc.quantities import Seed, random_generator

# East is left and north is up: (x, y) = FLIP (east, north) / pixel.
FLIP = np.diag([-1.0, 1.0])
#: What is wrong with components that cannot be restored.
NO_BEAM = (
    "is a list of components without a beam to restore it with; give --beam "
    "'1.0 mas 0.5 mas -7 deg' (beams= in Python)"
)


def restore(
    cls: type[series.Series], components: ComponentList, *, beam: Beam | Sequence[Beam],
    pixel_scale: u.Quantity, shape: tuple[int, int] | None = None,
    reference_pixel: tuple[float, float] | None = None, noise: u.Quantity | None = None,
    rng: Seed | None = None,
) -> series.Series:  # fmt: skip
    """
    Return images of model components, restored with a beam.

    A Gaussian component of covariance ``C`` and flux density ``S`` appears
    in a beam of covariance ``B`` as a Gaussian of covariance ``B + C`` and
    peak ``S sqrt(det B / det(B + C))`` per beam; it is evaluated at the
    pixel centres.

    Parameters
    ----------
    components : `ComponentList`
    beam : beam or sequence of beams
        One beam for all epochs, or one for each: a `Beam`, or anything with the
        attributes ``major``, ``minor`` and ``pa``.
    pixel_scale : `~astropy.units.Quantity`
        Side of a pixel.
    shape : tuple of int, optional
        Shape (ny, nx) of the images.  By default they hold all components
        and a margin of four major axes of the largest beam around them.
    reference_pixel : tuple of float, optional
        (x, y) of the origin of the components, counted from 0, in images of a given
        ``shape``; by default the middle.
    noise : `~astropy.units.Quantity`, optional
        Root mean square of the beam-correlated noise to add, a flux density per
        beam; scalar or one for each epoch.
    rng : `numpy.random.Generator`, seed or None, optional
        Passed to `numpy.random.default_rng`; one generator is spawned for
        each epoch.

    Returns
    -------
    `EpochCube`

    Raises
    ------
    ValueError
        If the number of beams or noise levels is not that of the epochs, a
        size is not positive, or the images would be too large.
    TypeError
        If a unit does not fit.

    Warns
    -----
    EpochWarning
        If components lie outside images of the given shape.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.time import Time
    >>> from astro_scc.epochs import Beam, ComponentList, restore
    >>> components = ComponentList(
    ...     times=Time(["2006-01-01", "2006-07-01"]),
    ...     epoch=[0, 1],
    ...     flux=[1, 1] * u.Jy,
    ...     east=[0.0, 0.4] * u.mas,
    ...     north=[0.0, 0.2] * u.mas,
    ... )
    >>> cube = restore(components, beam=Beam(1 * u.mas, 0.5 * u.mas, -7 * u.deg),
    ...                pixel_scale=0.1 * u.mas)
    >>> cube.shape, round(float(cube.data[0].max()), 3)
    ((2, 83, 85), 1.0)
    """
    n_epochs, unit = components.n_epochs, u.Jy / u.beam
    beams = series.as_beams(beam, n_epochs)
    noise = series.as_noise(noise, n_epochs, unit)
    scale = _side(pixel_scale, beams)
    x, y = -components.east.value / scale, components.north.value / scale
    if shape is None:
        if reference_pixel is not None:
            raise ValueError("reference_pixel needs a shape; give both, or neither")
        border = 4 * max(beam.major.value for beam in beams) / scale
        shape, reference_pixel = _grid(x, y, components.major.value / scale + border)
    shape = series.as_shape(shape)
    if reference_pixel is None:
        reference_pixel = (shape[1] - 1) / 2, (shape[0] - 1) / 2
    x, y = x + reference_pixel[0], y + reference_pixel[1]
    _warn_of_components_outside(x, y, shape)
    flux = (components.flux / u.beam).to_value(unit)
    sizes, data = _covariances(components) / scale**2, np.zeros((n_epochs, *shape))
    for i, noise_rng in enumerate(random_generator(rng).spawn(n_epochs)):
        here, blur = components.epoch == i, in_pixels(beams[i], pixel_scale)
        total = sizes[here] + blur
        peak = flux[here] * np.sqrt(np.linalg.det(blur) / np.linalg.det(total))
        add_gaussians(data[i], x[here], y[here], peak, total)
        if noise is not None:
            rms, grid = noise[i].value, {"pixel_scale": pixel_scale, "rng": noise_rng}
            data[i] += correlated_noise(shape, rms=rms, beam=beams[i], **grid)
    meta = components.meta
    facts = {name: meta[name] for name in headers.KEYWORDS["facts"] if name in meta}
    return cls.from_arrays(
        data, components.times, pixel_scale=pixel_scale, beams=beams, noise=noise,
        reference_pixel=reference_pixel, position=meta.get("position"), unit=unit,
        labels=components.labels, epoch_meta=[facts] * n_epochs,
        meta={**meta, "history": [_step(components, noise)]},
    )  # fmt: skip


def _side(pixel_scale, beams):
    """Return the side of a pixel in mas, which the beams must be wider than."""
    if not beams:
        raise ValueError("restore needs a beam; give one, or one for each epoch")
    scale = positions.pixel_side(pixel_scale).to_value(u.mas)
    narrow = min(beam.minor.value for beam in beams)
    if scale > narrow:
        raise ValueError(
            f"a pixel of {scale:g} mas is larger than the beam of {narrow:g} mas; give "
            "a fifth of the beam or less"
        )
    return scale


def _warn_of_components_outside(x, y, shape):
    outside = (x < -0.5) | (x > shape[1] - 0.5) | (y < -0.5) | (y > shape[0] - 0.5)
    if outside.any():
        warn(
            f"{np.count_nonzero(outside)} of {len(x)} components lie outside "
            f"the images of shape {shape}; give a larger shape, or none"
        )


def _step(components, noise):
    """Return a line of the history."""
    added = "" if noise is None else ", noise added"
    n_epochs = components.n_epochs
    line = f"restored {len(components)} components at {n_epochs} epochs{added}"
    if name := components.meta.get("position_from"):
        line += f", at the position that the name {name} tells, to some arcmin"
    return line


def restore_files(cls, files, *, times=None, beams=None):
    """
    Return images of the components in files, with pixels and noise that suit them.

    A pixel is a fifth of the narrowest beam.  Models have no noise, but without any
    every ripple of an image would be significant: the faintest peak at the place of a
    component, in the median over the epochs, is taken for ten times the noise.  It is
    then found in nearly every epoch, and its place is uncertain by a twentieth of the
    beam, FWHM / (2 SNR).  The images are the same whenever the files are read.

    ``times`` and ``beams`` are those of `~astro_scc.epochs.read_components`, by which
    the files are read.  What the images have is said in a warning.
    """
    components = read_components(files, dates=times, beams=beams)
    if not components.beams:
        raise ValueError(f"{files[0]}: {NO_BEAM}")
    options = suited(components)
    first, *others = components.beams
    differ = " and others" * any(beam != first for beam in others)
    warn(
        f"lists of components were restored with the beam {first}{differ}, pixels of "
        f"{options['pixel_scale']:.3g} and noise of {options['noise']:.2g}; make "
        "images with astro-scc restore to choose these"
    )
    return restore(cls, components, **options, rng=0)


def suited(components, pixels=5, snr=10):
    """
    Return the options of `restore` that suit components, see `restore_files`.

    There are so many ``pixels`` in the narrowest beam, and the faintest component is
    ``snr`` times the noise.
    """
    pixel = min(beam.minor for beam in components.beams) / pixels
    options = {"beam": components.beams, "pixel_scale": pixel}
    cube = restore(series.ImageSeries, components, **options)
    x0, y0 = cube.reference_pixel
    x = np.rint(x0 - (components.east / pixel).to_value(u.one)).astype(int)
    y = np.rint(y0 + (components.north / pixel).to_value(u.one)).astype(int)
    peaks = np.where(cube.data > 0, cube.data, np.inf)[components.epoch, y, x]
    faintest = np.full(len(cube), np.inf)
    np.minimum.at(faintest, components.epoch, peaks)
    for i in np.flatnonzero(np.isinf(faintest)):
        raise ValueError(f"{cube.labels[i]}: no component is positive; leave it out")
    return options | {"noise": np.median(faintest) / snr * cube.unit}


def typical_beam(lists):
    """Return a circular beam that separates half of the components of an epoch."""
    nearest = []
    for components in lists:
        places = np.stack([components.east, components.north], axis=1).to_value(u.mas)
        for epoch in range(components.n_epochs):
            here = places[components.epoch == epoch]
            if len(here) > 1:
                # The nearest of all is the component itself.
                distance, _ = scipy.spatial.cKDTree(here).query(here, k=2)
                nearest += distance[:, 1].tolist()
    size = np.median(nearest) if nearest else 0.0
    if not size > 0:
        raise ValueError("no epoch of the table has two components apart; give --beam")
    size = float(f"{size:.2g}") * u.mas
    return Beam(size, size, 0 * u.deg)


def in_pixels(beam, pixel_scale):
    """Return the covariance of a beam over (x, y) in square pixels."""
    scale = positions.pixel_side(pixel_scale).to_value(u.mas)
    return FLIP @ beam.covariance.value @ FLIP / scale**2


def _grid(x, y, border, most=20000):
    """Return a shape and reference pixel for all (x, y), counted from that pixel."""
    low = np.floor([(x - border).min(), (y - border).min()])
    high = np.ceil([(x + border).max(), (y + border).max()])
    nx, ny = high - low + 1
    if max(nx, ny) > most:
        raise ValueError(
            f"the components need images of {nx:g} x {ny:g} pixels; give larger "
            "pixels, or a shape"
        )
    return (int(ny), int(nx)), tuple((-low).tolist())


def _covariances(components):
    """Return the covariances over (x, y) in mas^2, shape (n, 2, 2)."""
    sin, cos = np.sin(components.pa).value, np.cos(components.pa).value
    axes = np.array([[-sin, cos], [-cos, -sin]])
    fwhm = np.stack([components.major.value, components.minor.value])
    return np.einsum("ain,ajn,an->nij", axes, axes, (FWHM_TO_SIGMA * fwhm) ** 2)


def add_gaussians(image, x, y, peak, covariance, reach=7.0):
    """
    Add elliptical Gaussians to an image (ny, nx), in place, and return it.

    Their centres ``x`` and ``y`` are counted from 0, ``peak`` is the value there,
    and ``covariance``, shape (n, 2, 2), is over (x, y) in square pixels.  Each
    Gaussian is evaluated at the pixel centres of a box that has the half side ``reach``
    in standard deviations, as far as it lies in the image: 2e-11 of the peak is left
    out by default.
    """
    ny, nx = image.shape
    for x0, y0, p, c in zip(x, y, peak, np.asarray(covariance), strict=True):
        reach_x, reach_y = reach * np.sqrt(np.diag(c))
        columns, rows = _pixels(x0, reach_x, nx), _pixels(y0, reach_y, ny)
        if p == 0 or not columns.size or not rows.size:
            continue
        dx, dy = columns - x0, (rows - y0)[:, None]
        (a, b), (_, d) = np.linalg.inv(c)
        if b == 0:
            box = p * np.exp(-0.5 * d * dy**2) * np.exp(-0.5 * a * dx**2)
        else:
            box = p * np.exp(-0.5 * (a * dx**2 + 2 * b * dx * dy + d * dy**2))
        image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += box
    return image


def _pixels(centre, reach, n):
    """Return those of n pixels that are within reach of a centre."""
    start = max(int(np.ceil(centre - reach)), 0)
    return np.arange(start, min(int(np.floor(centre + reach)) + 1, n))


def correlated_noise(
    shape: tuple[int, int], *, rms: float | u.Quantity, beam: Beam,
    pixel_scale: u.Quantity, rng: Seed | None = None,
) -> np.ndarray:  # fmt: skip
    """
    Return Gaussian noise that is correlated by a beam.

    White noise is convolved with the beam, so its autocorrelation is the beam
    convolved with itself.  It is divided by the theoretical gain of that
    convolution, so that the expected root mean square is ``rms`` for any beam,
    while that of one image scatters about it.

    Parameters
    ----------
    shape : tuple of int
        Shape (ny, nx) of the image.
    rms : float or `~astropy.units.Quantity`
        Root mean square of the noise.
    beam : `~astro_scc.epochs.Beam`
    pixel_scale : `~astropy.units.Quantity`
        Side of a pixel.  East is towards smaller x and north towards larger y.
    rng : `numpy.random.Generator`, seed or None, optional
        Passed to `numpy.random.default_rng`.

    Returns
    -------
    `numpy.ndarray` or `~astropy.units.Quantity`, shape (ny, nx)
        In the unit of ``rms``.

    Raises
    ------
    ValueError
        If ``pixel_scale`` is not positive.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.images.beam import Beam
    >>> from astro_scc.epochs.restoring import correlated_noise
    >>> beam = Beam(1 * u.mas, 0.5 * u.mas)
    >>> noise = correlated_noise((64, 128), rms=0.3 * u.mJy / u.beam, beam=beam,
    ...                          pixel_scale=0.1 * u.mas, rng=1)
    >>> noise.shape, noise.unit
    ((64, 128), Unit("mJy / beam"))
    """
    covariance = in_pixels(beam, pixel_scale)
    # By six deviations, the noise of opposite edges is independent to exp(-(6 / 2)^2).
    padding = int(np.ceil(6 * np.sqrt(np.trace(covariance))))
    padded = tuple(scipy.fft.next_fast_len(n + padding, real=True) for n in shape)
    transfer = gaussian_transfer(covariance, padded)
    # A kernel h gives unit white noise the variance sum h^2.
    gain = np.linalg.norm(scipy.fft.irfft2(transfer, s=padded))
    white = random_generator(rng).standard_normal(padded)
    noise = scipy.fft.irfft2(scipy.fft.rfft2(white) * transfer, s=padded)
    return rms * (noise[: shape[0], : shape[1]] / gain)
