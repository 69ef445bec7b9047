# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Conversion between cubes and NDCubes, including NDCubes of other packages."""

import warnings
from collections.abc import Mapping

import astropy.units as u
import numpy as np
from astropy.nddata import StdDevUncertainty
from astropy.time import Time
from astropy.wcs import WCS
from scipy.linalg import block_diag

from astro_scc.epochs import EpochCube
from astro_scc.epochs.headers import read_header
from astro_scc.epochs.serialize import without_dates
from astro_scc.epochs.validation import UNEVEN, fits_wcs, uncertainty_noise
from astro_scc.exceptions import EpochWarning
from astro_scc.interchange.files import optional

__doctest_requires__ = {("from_ndcube", "to_ndcube"): ["ndcube"]}

#: Name of the WCS axis that counts the epochs.
AXIS = "EPOCH"
#: Fields of each epoch that `to_ndcube` keeps.
EACH = ("labels", "beams", "epoch_meta")


def to_ndcube(cube):
    """
    Return a cube as NDCube of (epoch, latitude, longitude).

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`

    Returns
    -------
    `ndcube.NDCube`
        The third axis of its WCS is the index of the epoch, and the dates are
        the extra coordinate ``time``.  The noise is its uncertainty; its meta
        has the labels, beams and facts of all epochs, in which `from_ndcube`
        finds those of an epoch by its index.

    Raises
    ------
    ImportError
        If ndcube is not installed.

    Examples
    --------
    >>> from astro_scc.interchange import to_ndcube
    >>> from astro_scc.simulation import simulate_static
    >>> to_ndcube(simulate_static(n_epochs=2, rng=1).cube).shape
    (2, 128, 256)
    """
    ndcube = optional("ndcube", "to_ndcube", "ndcube")
    noise = cube.noise
    if noise is not None:
        every = np.broadcast_to(noise.value[:, None, None], cube.shape)
        noise = StdDevUncertainty(every, unit=cube.unit, copy=False)
    made = ndcube.NDCube(
        cube.data.copy(),
        wcs=_with_epochs(cube.wcs),
        uncertainty=noise,
        unit=cube.unit,
        mask=cube.mask.copy(),
        meta={**cube.meta, **{name: getattr(cube, name) for name in EACH}},
    )
    made.extra_coords.add("time", (0,), cube.times)
    return made


def _with_epochs(celestial):
    """Return a WCS with the index of the epoch, from 0, as third axis."""
    header = without_dates(celestial.to_header())
    header.update({"WCSAXES": 3, "CTYPE3": AXIS})
    wcs = WCS(header)
    # A header rounds numbers, so they are set directly.
    wcs.wcs.crval = [*celestial.wcs.crval, 0.0]
    wcs.wcs.crpix = [*celestial.wcs.crpix, 1.0]
    wcs.wcs.cdelt = [1.0, 1.0, 1.0]
    wcs.wcs.pc = block_diag(celestial.pixel_scale_matrix, 1.0)
    wcs.wcs.set()
    return wcs


def from_ndcube(ndcube, *, times=None, beams=None):
    """
    Return a cube from an NDCube of epochs, which may be sliced or rebinned.

    Parameters
    ----------
    ndcube : `ndcube.NDCube` or `ndcube.NDCubeSequence`
        It has two celestial axes, and one of the epochs if there are several;
        each item of a sequence is an epoch.  Its WCS is a FITS WCS, possibly
        sliced or resampled.
    times : `~astropy.time.Time` or sequence, optional
        By default the coordinate of type Time, or the date in the meta.
    beams : beam or sequence of beams, optional
        By default the beams that `to_ndcube` has kept, or ``BMAJ``, ``BMIN``
        and ``BPA`` in the meta, as in a FITS header.

    Returns
    -------
    `~astro_scc.epochs.EpochCube`
        The uncertainty becomes the noise.

    Raises
    ------
    ValueError
        If axes or dates cannot be found, or epochs with different dates or
        beams were averaged.

    Examples
    --------
    >>> from astro_scc.interchange import from_ndcube, to_ndcube
    >>> from astro_scc.simulation import simulate_static
    >>> made = to_ndcube(simulate_static(n_epochs=3, rng=1).cube)
    >>> from_ndcube(made[1:, 20:100].rebin((1, 2, 2)))
    <EpochCube 2 epochs 2000-01-31 to 2000-03-01, 128 x 40 pixels of 0.2 mas, ...>
    """
    if isinstance(ndcube.data, list | tuple):
        return EpochCube.from_ccddata(ndcube.data, times=times, beams=beams)
    try:
        wcs, size, kept = fits_wcs(ndcube.wcs)
        celestial = {wcs.wcs.lng, wcs.wcs.lat}
        others = [int(axis) for axis in np.flatnonzero(kept) if axis not in celestial]
        fits = wcs.has_celestial and kept[[*celestial]].all() and len(others) < 2
    except TypeError:
        fits = False
    if not fits:
        raise ValueError(
            "an NDCube must have two celestial axes, one of the epochs, and a FITS "
            "WCS; EpochCube.from_arrays takes what has none"
        )

    # Array axes are in the reverse order of WCS axes.
    axis = int(np.sum(kept[others[0] :])) - 1 if others else None

    def planes(values):
        values = np.broadcast_to(values, ndcube.data.shape)
        return values[None] if axis is None else np.moveaxis(values, axis, 0)

    data = planes(np.asarray(ndcube.data))
    mask = planes(False if ndcube.mask is None else ndcube.mask) | ~np.isfinite(data)
    noise = None if ndcube.uncertainty is None else _noise(ndcube, planes, mask)
    averaged = bool(others and size[others[0]] != 1)
    meta = dict(ndcube.meta) if isinstance(ndcube.meta, Mapping) else {}
    if AXIS in wcs.wcs.ctype and set(EACH) <= meta.keys():
        first = 1 - wcs.wcs.crpix[list(wcs.wcs.ctype).index(AXIS)]
        own = _own(meta, round(first), len(data), averaged, beams)
    else:
        record = read_header(meta)
        if beams is None and record.beam_problem:
            raise ValueError(f"the NDCube: {record.beam_problem}; give beams=")
        beams = record.beam if beams is None else beams
        own = {"beams": beams, "epoch_meta": [record.facts] * len(data), "meta": {}}
    own["meta"]["history"] = [*own["meta"].get("history", ()), "from an NDCube"]
    return EpochCube(
        data=data,
        times=_times(ndcube, meta, axis, averaged) if times is None else times,
        wcs=wcs,
        unit=ndcube.unit,
        mask=mask,
        noise=noise,
        **own,
    )


def _noise(ndcube, planes, mask):
    """Return the noise of every epoch; mask pixels without uncertainty, in place."""
    given, unit = ndcube.uncertainty, ndcube.unit or u.dimensionless_unscaled
    noise, uneven = [], False
    for values, bad in zip(planes(np.asarray(given.array)), mask, strict=True):
        uncertainty = type(given)(values, unit=given.unit, copy=False)
        try:
            level, without, even = uncertainty_noise(uncertainty, unit, bad)
        except ValueError as error:
            raise ValueError(f"the NDCube: {error}") from None
        bad |= without
        noise.append(level)
        uneven |= not even
    if uneven:
        warnings.warn(f"the NDCube: {UNEVEN}", EpochWarning, stacklevel=4)
    return u.Quantity(noise)


def _own(meta, first, n, averaged, beams):
    """Return the fields that `to_ndcube` has kept for n epochs from the first one."""
    kept = {"meta": {key: value for key, value in meta.items() if key not in EACH}}
    every = meta["beams"]
    if not averaged:
        kept |= {key: meta[key] and meta[key][first : first + n] for key in EACH}
    elif every is not None:
        if beams is None and any(beam != every[0] for beam in every):
            raise ValueError(
                "epochs of the NDCube were averaged, of which the beams differ; call "
                "to_common_beam() before to_ndcube(), or give beams="
            )
        kept["beams"] = every[0]
    return kept if beams is None else kept | {"beams": beams}


def _times(ndcube, meta, axis, averaged):
    """Return the coordinate of type Time, or else the date of a single epoch."""
    if axis is None:
        found = [v for v in ndcube.global_coords.values() if isinstance(v, Time)]
        found.append(read_header(meta).time)
        if found[0] is not None:
            return found[0]
    for coordinates in (ndcube.wcs, ndcube.extra_coords) if axis is not None else ():
        try:
            found = ndcube.axis_world_coords(axis, wcs=coordinates)
        except (AttributeError, TypeError, ValueError):
            continue
        found = [values for values in found if isinstance(values, Time)]
        if found and averaged and coordinates is ndcube.extra_coords:
            raise ValueError(
                "epochs of the NDCube were averaged, of which ndcube keeps the first "
                "date only; give times="
            )
        if found:
            return found[0]
    raise ValueError("the NDCube has no coordinate of type Time; give times=")
