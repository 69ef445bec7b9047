# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images from component lists."""

import warnings

import astropy.units as u
import numpy as np

from astro_scc.epochs.beam import FWHM_TO_SIGMA
from astro_scc.epochs.components.gaussians import add_gaussians
from astro_scc.epochs.components.noise import correlated_noise
from astro_scc.epochs.cube import EpochCube
from astro_scc.epochs.positions import offset_wcs
from astro_scc.epochs.validation import as_beams
from astro_scc.exceptions import EpochWarning

__all__ = ["restore"]

# East is to the left, north up: (x, y) = FLIP (east, north) / pixel.
FLIP = np.diag([-1.0, 1.0])
MAX_SIDE = 20000


def restore(
    components,
    *,
    beam,
    pixel_scale,
    shape=None,
    reference_pixel=None,
    noise=None,
    rng=None,
    position=None,
    unit=u.Jy / u.beam,
    margin=4.0,
):
    """
    Images of component lists, as seen with a beam.

    A Gaussian component of covariance ``C`` and flux density ``S`` appears
    in a beam of covariance ``B`` as a Gaussian of covariance ``B + C`` and
    peak ``S sqrt(det B / det(B + C))`` per beam; it is evaluated at the
    pixel centres.

    Parameters
    ----------
    components : `ComponentList`
    beam : beam or sequence of beams
        One for all epochs, or one for each: `Beam`, or anything with the
        attributes ``major``, ``minor`` and ``pa``.
    pixel_scale : `~astropy.units.Quantity`
        Side of a pixel.
    shape : tuple of int, optional
        Shape (ny, nx) of the images.  By default they hold all components
        with ``margin`` beams around them.
    reference_pixel : tuple of float, optional
        (x, y) of the origin of the components, counted from 0.  By default
        the components are in the middle of the image.
    noise : `~astropy.units.Quantity`, optional
        Root mean square of the beam-correlated noise to add, in units like
        ``unit``; scalar or one for each epoch.
    rng : `numpy.random.Generator`, seed or None, optional
        Passed to `numpy.random.default_rng`; one generator is spawned for
        each epoch.
    position : `~astropy.coordinates.SkyCoord`, optional
        Celestial position of the origin, by default that of the components'
        meta.
    unit : `~astropy.units.Unit`, optional
        Unit of the images, flux density per beam.
    margin : float, optional
        In major axes of the largest beam.

    Returns
    -------
    `EpochCube`

    Raises
    ------
    ValueError
        If the numbers of beams or noise levels are not those of the epochs,
        a size is not positive, or the images would be absurdly large.
    `~astropy.units.UnitConversionError`
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
    n_epochs = components.n_epochs
    beams = as_beams(beam, n_epochs)
    if not beams:
        raise ValueError("restore needs a beam; give one, or one for each epoch")
    levels = _noise_levels(noise, n_epochs, unit)
    scale = u.Quantity(pixel_scale).to_value(u.mas)
    if not (np.isfinite(scale) and scale > 0):
        raise ValueError(f"pixel_scale must be positive, got {pixel_scale}")

    x = -components.east.to_value(u.mas) / scale
    y = components.north.to_value(u.mas) / scale
    size = components.major.to_value(u.mas) / scale
    border = margin * max(b.major.to_value(u.mas) for b in beams) / scale
    shape, reference_pixel = _grid(x, y, size + border, shape, reference_pixel)
    x, y = x + reference_pixel[0], y + reference_pixel[1]
    outside = (x < -0.5) | (x > shape[1] - 0.5) | (y < -0.5) | (y > shape[0] - 0.5)
    if outside.any():
        warnings.warn(
            f"{np.count_nonzero(outside)} of {len(components)} components lie outside "
            f"the images of shape {shape}; give a larger shape, or none",
            EpochWarning,
            stacklevel=2,
        )

    own = _covariances(components) / scale**2
    flux = (components.flux / u.beam).to_value(unit)
    data = np.zeros((n_epochs, *shape))
    for i, noise_rng in enumerate(np.random.default_rng(rng).spawn(n_epochs)):
        here = components.epoch == i
        blur = FLIP @ beams[i].covariance.to_value(u.mas**2) @ FLIP / scale**2
        total = own[here] + blur
        peak = flux[here] * np.sqrt(np.linalg.det(blur) / np.linalg.det(total))
        add_gaussians(data[i], x[here], y[here], peak, total)
        if levels is not None:
            data[i] += correlated_noise(
                shape,
                rms=levels[i],
                beam=beams[i],
                pixel_scale=pixel_scale,
                rng=noise_rng,
            )

    facts = {
        key: components.meta[key]
        for key in ("object", "telescope", "frequency", "filter", "stokes")
        if key in components.meta
    }
    line = f"restored {len(components)} components at {n_epochs} epochs"
    if levels is not None:
        line += ", noise added"
    if position is None:
        position = components.meta.get("position")
    return EpochCube(
        data=data,
        times=components.times,
        wcs=offset_wcs(pixel_scale, reference_pixel, position),
        unit=unit,
        beams=beams,
        noise=None if levels is None else levels * unit,
        labels=components.labels,
        epoch_meta=tuple(dict(facts) for _ in range(n_epochs)),
        meta={**components.meta, "history": [line]},
    )


def _noise_levels(noise, n_epochs, unit):
    if noise is None:
        return None
    levels = u.Quantity(noise).to_value(unit)
    if np.ndim(levels) > 1 or np.size(levels) not in (1, n_epochs):
        raise ValueError(
            f"{np.size(levels)} noise levels for {n_epochs} epochs; give one, or one "
            "for each epoch"
        )
    return np.broadcast_to(levels, n_epochs).astype(float)


def _grid(x, y, border, shape, reference_pixel):
    """Shape and reference pixel that hold all (x, y), which count from it."""
    left, right = (np.floor((x - border).min()), np.ceil((x + border).max()))
    bottom, top = (np.floor((y - border).min()), np.ceil((y + border).max()))
    if shape is None:
        if reference_pixel is None:
            reference_pixel = -left, -bottom
        shape = (
            int(np.ceil(top + reference_pixel[1])) + 1,
            int(np.ceil(right + reference_pixel[0])) + 1,
        )
        if max(shape) > MAX_SIDE:
            raise ValueError(
                f"the components need images of {shape[1]} x {shape[0]} pixels; give "
                "larger pixels, or a shape"
            )
    shape = tuple(int(n) for n in shape)
    if len(shape) != 2 or min(shape) < 1:
        raise ValueError(f"shape must be (ny, nx), both positive, got {shape}")
    if reference_pixel is None:
        reference_pixel = (
            np.round((shape[1] - 1 - left - right) / 2),
            np.round((shape[0] - 1 - bottom - top) / 2),
        )
    return shape, tuple(float(p) for p in reference_pixel)


def _covariances(components):
    """Covariances of the components over (x, y) in mas^2, shape (n, 2, 2)."""
    pa = components.pa.to_value(u.rad)
    along = np.stack([-np.sin(pa), np.cos(pa)], axis=-1)
    across = np.stack([-np.cos(pa), -np.sin(pa)], axis=-1)
    major, minor = (
        (FWHM_TO_SIGMA * axis.to_value(u.mas)) ** 2
        for axis in (components.major, components.minor)
    )
    return (
        major[:, None, None] * along[:, :, None] * along[:, None, :]
        + minor[:, None, None] * across[:, :, None] * across[:, None, :]
    )
