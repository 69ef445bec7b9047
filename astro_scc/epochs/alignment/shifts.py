# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Epochs laid on one another, by shifts."""

import os
import warnings
from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.table import Table

from astro_scc.epochs.alignment.core import core_positions
from astro_scc.epochs.alignment.registration import displacement
from astro_scc.epochs.alignment.shift_tables import offsets_from_table
from astro_scc.epochs.grids.cutout import region_mask
from astro_scc.epochs.grids.resampling import (
    WHOLE_PIXEL,
    grid_step,
    moved_wcs,
    resample,
    shift_image,
)
from astro_scc.exceptions import MeasurementWarning

__all__ = ["align"]


@dataclass(frozen=True)
class Offsets:
    """
    Where each epoch lies, in pixels (x, y) from where it ought to.

    ``covariance`` is of shape (n, 2, 2), NaN where errors are not known,
    and ``turned`` marks epochs whose grid differs by more than a shift.
    """

    pixels: np.ndarray
    covariance: np.ndarray
    what: str
    turned: np.ndarray | None = None


def align(
    cube,
    method="core",
    *,
    table=None,
    reference=None,
    region=None,
    jet_pa=None,
    max_shift=None,
):
    """
    Shift the epochs so that they lie on one another.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    method : {"core", "correlate", "table", "wcs", "none"}, optional
        "core"
            The core of each epoch, as `~astro_scc.epochs.core_positions`
            measures it, comes to the reference pixel.
        "correlate"
            Every epoch is registered on a reference image, by masked
            cross-correlation and least squares.  What moves together in
            all of the region, the velocity sought included, is taken out:
            choose a region that stands still.
        "table"
            The positions of a table come to the reference pixel.
        "wcs"
            Absolute coordinates (``cube.epoch_wcs``) are trusted.  Those of
            VLBI images jump by more than jets move.
        "none"
            Reference pixels stay on one another.

        The path of a table stands for "table" with that table.
    table : path-like or `~astropy.table.Table`, optional
        For "table".  CSV or ECSV with a date and the offsets of the core
        from the reference pixel, see
        `~astro_scc.epochs.alignment.shift_tables.offsets_from_table`.
    reference : int or array_like, shape (ny, nx), optional
        For "correlate": an epoch, or an image, by default the mean of the
        aligned epochs, found by iteration.
    region : optional
        For "correlate": pixels to compare, as `~astro_scc.epochs.region_mask`
        takes it.
    jet_pa : `~astropy.units.Quantity`, optional
        For "core": position angle of the jet at the core.
    max_shift : `~astropy.units.Quantity`, optional
        Shifts beyond it are not believed: "core" and "correlate" do not look
        farther, and any that is larger is an error.

    Returns
    -------
    `~astro_scc.epochs.EpochCube`
        ``meta["alignment"]`` has a dict for each epoch: ``epoch``, ``date``,
        ``method``, and how far the image was moved, ``shift_east_mas``,
        ``shift_north_mas``, with ``shift_east_err_mas`` and
        ``shift_north_err_mas`` (None if unknown).  Further alignments are
        appended.  ``epoch_wcs`` moves along.

    Raises
    ------
    ValueError
        If the method or the combination of options makes no sense, an epoch
        cannot be measured, its shift exceeds ``max_shift`` or takes it off
        the grid; and as the function of the method does.

    Warns
    -----
    MeasurementWarning
        If the core is blended with the jet.

    Notes
    -----
    Shifts by whole pixels copy the pixels.  Others interpolate with cubic
    splines: pixels that come from outside the image, or next to bad ones,
    are masked, and noise that varies from pixel to pixel is smoothed, so
    that ``noise`` is None, to be measured anew.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astropy.table import Table
        >>> from astro_scc.epochs import EpochCube
    >>> images = np.zeros((2, 9, 9))
    >>> images[0, 4, 4] = images[1, 5, 6] = 1
    >>> cube = EpochCube.from_arrays(
    ...     images, ["2000-01-01", "2001-01-01"], pixel_scale=0.1 * u.mas
    ... )
    >>> table = Table({
    ...     "date": ["2000-01-01", "2001-01-01"],
    ...     "east": [0, -0.2] * u.mas,
    ...     "north": [0, 0.1] * u.mas,
    ... })
    >>> aligned = align(cube, "table", table=table)
    >>> aligned.data[:, 4, 4]
    array([1., 1.])
    >>> aligned.meta["alignment"][1]["shift_east_mas"]
    0.2
    """
    if isinstance(method, Table | os.PathLike) or (
        isinstance(method, str) and method not in METHODS and os.path.isfile(method)
    ):
        if table is not None:
            raise ValueError("give one table, as method or as table")
        method, table = "table", method
    if not isinstance(method, str) or method not in METHODS:
        raise ValueError(
            f"align method {method!r} is none of {', '.join(METHODS)}, nor a file"
        )
    options = {
        "table": table,
        "reference": reference,
        "region": region,
        "jet_pa": jet_pa,
        "max_shift": max_shift,
    }
    options = {name: value for name, value in options.items() if value is not None}
    measure, known = METHODS[method]
    strange = set(options) - {*known, "max_shift"}
    if strange:
        raise ValueError(
            f"align method {method!r} has no option {', '.join(sorted(strange))}"
        )
    if method == "none":
        return cube.with_step("aligned by reference pixels (no shifts)")
    if "max_shift" in options and not u.Quantity(max_shift).to_value(u.mas) > 0:
        raise ValueError(f"max_shift={max_shift} must be positive")
    if "max_shift" not in known:
        options.pop("max_shift", None)
    offsets = measure(cube, **options)
    _check_size(cube, offsets, max_shift)
    return _move(cube, method, offsets)


def _check_size(cube, offsets, max_shift):
    if max_shift is None:
        return
    size = np.hypot(*(cube.pixel_matrix @ offsets.pixels.T))
    worst = int(np.argmax(size))
    if size[worst] > max_shift:
        raise ValueError(
            f"{cube.labels[worst]}: its shift of {size[worst].to(u.mas):.3g} exceeds "
            f"max_shift={max_shift}; leave the epoch out or give a larger one"
        )


def _move(cube, method, offsets):
    """The cube with every epoch moved against its offset."""
    shifts = -offsets.pixels
    data, mask = np.empty(cube.shape), np.empty(cube.shape, dtype=bool)
    for i, shift in enumerate(shifts):
        if offsets.turned is not None and offsets.turned[i]:
            data[[i]], mask[[i]] = resample(
                cube.data[[i]],
                cube.mask[[i]],
                cube.epoch_wcs[i],
                cube.wcs,
                shape=cube.shape[1:],
            )
        else:
            data[i], mask[i] = shift_image(cube.data[i], cube.mask[i], shift)
        if mask[i].all():
            raise ValueError(
                f"{cube.labels[i]}: its shift of {shift.round(1).tolist()} pixels "
                "(x, y) takes it off the grid; leave the epoch out"
            )
    if method == "wcs":
        epoch_wcs = tuple(cube.wcs.deepcopy() for _ in shifts)
    else:
        epoch_wcs = cube.epoch_wcs and tuple(
            moved_wcs(own, shift)
            for own, shift in zip(cube.epoch_wcs, shifts, strict=True)
        )
    whole = np.all(np.abs(shifts - np.rint(shifts)) < WHOLE_PIXEL)
    whole = whole and not np.any(offsets.turned)
    records = _records(cube, method, offsets)
    east, north = (
        np.array([r[f"shift_{k}_mas"] for r in records]) for k in ("east", "north")
    )
    largest = int(np.argmax(np.hypot(east, north)))
    line = (
        f"aligned on {offsets.what}: shifts of {np.sqrt(np.mean(east**2)):.3g} mas "
        f"(east) and {np.sqrt(np.mean(north**2)):.3g} mas (north) rms, largest "
        f"({east[largest]:+.3g}, {north[largest]:+.3g}) mas for {cube.labels[largest]}"
    )
    return cube.with_step(
        line,
        data=data,
        mask=mask,
        epoch_wcs=epoch_wcs,
        noise=cube.noise if whole else None,
        meta={
            **cube.meta,
            "alignment": [*cube.meta.get("alignment", ()), *records],
        },
    )


def _records(cube, method, offsets):
    matrix = cube.pixel_matrix.to_value(u.mas)
    shift = -offsets.pixels @ matrix.T + 0.0
    variance = np.einsum("ij,njk,ik->ni", matrix, offsets.covariance, matrix)
    error = [[float(e) if np.isfinite(e) else None for e in r] for r in variance**0.5]
    return [
        {
            "epoch": cube.labels[i],
            "date": cube.times[i].isot[:10],
            "method": method,
            "shift_east_mas": float(shift[i, 0].round(9)),
            "shift_north_mas": float(shift[i, 1].round(9)),
            "shift_east_err_mas": error[i][0],
            "shift_north_err_mas": error[i][1],
        }
        for i in range(len(cube))
    ]


def _from_sky(cube, offsets, errors, what):
    """Offsets (n, 2) and errors in mas as pixels."""
    inverse = np.linalg.inv(cube.pixel_matrix.to_value(u.mas))
    variances = errors[:, :, None] ** 2 * np.eye(2)
    return Offsets(offsets @ inverse.T, inverse @ variances @ inverse.T, what)


def _by_core(cube, *, jet_pa=None, max_shift=None):
    found = core_positions(cube, jet_pa=jet_pa, max_shift=max_shift)
    n_blended = int(np.sum(found["blended"]))
    if n_blended:
        warnings.warn(
            f"the core is blended with the jet in {n_blended} of {len(cube)} epochs: "
            "its position may be wrong by some hundredths of the beam and more; if "
            "positions from model fits exist, align with a table of them",
            MeasurementWarning,
            stacklevel=3,
        )
    offsets, errors = (
        np.stack([found[name].to_value(u.mas) for name in names], axis=1)
        for names in (("east", "north"), ("east_err", "north_err"))
    )
    return _from_sky(cube, offsets, errors, "the core")


def _by_table(cube, *, table=None):
    if table is None:
        raise ValueError("align method 'table' needs table=, a path or a Table")
    offsets, errors = offsets_from_table(table, cube.times, cube.labels)
    return _from_sky(
        cube, offsets.to_value(u.mas), errors.to_value(u.mas), "positions of a table"
    )


def _by_wcs(cube):
    if not cube.epoch_wcs:
        raise ValueError(
            "the epochs have no absolute coordinates (epoch_wcs); "
            "read them from FITS files, or choose another alignment"
        )
    steps, pure = zip(
        *(grid_step(own, cube.wcs, cube.shape[1:]) for own in cube.epoch_wcs),
        strict=True,
    )
    unknown = np.full((len(cube), 2, 2), np.nan)
    return Offsets(-np.array(steps), unknown, "absolute coordinates", ~np.array(pure))


def _by_correlation(cube, *, reference=None, region=None, max_shift=None):
    inside = region_mask(cube, region)
    scale = cube.pixel_scale.to_value(u.mas)
    if max_shift is None:
        reach = min(cube.shape[1:]) / 4
    else:
        reach = u.Quantity(max_shift).to_value(u.mas) / scale
    image, name = _reference_image(cube, reference)
    iterations = 5 if image is None else 1
    pixels = np.zeros((len(cube), 2))
    covariance = np.zeros((len(cube), 2, 2))
    for k in range(iterations):
        target = _mean_of_moved(cube, -pixels) if image is None else image
        use = inside & np.isfinite(target)
        if not use.any():
            raise ValueError("the reference image has no good pixel in the region")
        before = pixels.copy()
        for i, label in enumerate(cube.labels):
            try:
                pixels[i], covariance[i] = displacement(
                    cube.data[i],
                    cube.mask[i],
                    target,
                    use,
                    reach,
                    start=pixels[i] if k > 1 else None,
                )
            except ValueError as error:
                raise ValueError(f"{label}: {error}; leave it out") from error
        if image is None:
            # Nothing ties the mean down, so the epochs stay where they are
            # on average.
            pixels -= pixels.mean(axis=0)
        if np.abs(pixels - before).max() < 0.01:
            break
    if cube.beams is not None:
        areas = np.array([beam.area.to_value(u.mas**2) for beam in cube.beams])
        covariance *= np.maximum(areas / scale**2 / 2, 1)[:, None, None]
    return Offsets(pixels, covariance, name)


def _reference_image(cube, reference):
    if reference is None:
        return None, "their mean"
    image = np.asarray(reference, dtype=float)
    if image.ndim == 0:
        if reference != int(reference) or not -len(cube) <= reference < len(cube):
            raise ValueError(f"reference={reference} is none of {len(cube)} epochs")
        index = int(reference)
        image = np.where(cube.mask[index], np.nan, cube.data[index])
        return image, cube.labels[index]
    if image.shape != cube.shape[1:]:
        raise ValueError(
            f"reference has shape {image.shape}, the images have {cube.shape[1:]}"
        )
    return image, "a reference image"


def _mean_of_moved(cube, shifts):
    moved = [
        shift_image(*args)[0] for args in zip(cube.data, cube.mask, shifts, strict=True)
    ]
    good = np.isfinite(moved)
    count = good.sum(axis=0)
    total = np.where(good, moved, 0).sum(axis=0)
    # Pixels that only some epochs have would bring steps into the mean.
    return np.where(count == len(cube), total / np.maximum(count, 1), np.nan)


# Name -> the function that measures, and the options that it has.
METHODS = {
    "core": (_by_core, ("jet_pa", "max_shift")),
    "correlate": (_by_correlation, ("reference", "region", "max_shift")),
    "table": (_by_table, ("table",)),
    "wcs": (_by_wcs, ()),
    "none": (None, ()),
}
