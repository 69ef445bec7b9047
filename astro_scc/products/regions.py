# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""SSPs as regions on the sky and as segmentation images."""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from skimage.measure import find_contours

from astro_scc.decomposition import SSPs
from astro_scc.epochs import EpochCube
from astro_scc.images.series import epoch_index
from astro_scc.writing import replace_when_complete

if TYPE_CHECKING:
    from photutils.segmentation import SegmentationImage
    from regions import Regions

#: Folder of the regions of all epochs.
REGIONS = "ssp_regions"
#: One colour per scale, by its name in DS9.
COLORS = ("cyan", "orange", "green", "magenta", "yellow", "red")
#: Decimal places of degrees and arcsec, for errors below a nanoarcsecond.
DIGITS = 13


def ssp_regions(
    ssps: SSPs, cube: EpochCube, epoch: int, *, scales: ArrayLike | None = None,
    frame: str = "cube",
) -> Regions:  # fmt: skip
    """
    Return the SSPs of an epoch as regions on the sky.

    They are polygons around the centres of the pixels of each SSP; holes are not cut
    out.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs, for example ``result.decomposed.ssps``.
    cube : `~astro_scc.epochs.EpochCube`
    epoch : int
        Index of the epoch.
    scales : sequence of float, optional
        By default all scales.
    frame : {"cube", "epoch"}
        The coordinates of the cube, as in the files of
        `~astro_scc.epochs.write_epochs`, or those that the epoch's own file
        gives to these pixels.  They differ if epochs are aligned on the core,
        and in most VLBI images.

    Returns
    -------
    `regions.Regions`
        Each is a `~regions.PolygonSkyRegion`.  Its text is its number in ``ssps``,
        its colour shows the scale.

    Raises
    ------
    IndexError
        If there is no such epoch.
    ValueError
        If the frame is unknown, or if the coordinates of the epoch's own file are
        wanted but the cube was not read from files.

    Examples
    --------
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.products import ssp_regions
    >>> from astro_scc.simulation import simulate_static
    >>> cube = simulate_static(n_epochs=2, rng=1).cube
    >>> ssps = SSPs.of_epochs([Decomposer(scales=[2])(image) for image in cube.data])
    >>> found = ssp_regions(ssps, cube, 0)
    >>> len(found) == (ssps.epoch == 0).sum().item(), found[0].meta["text"]
    (True, '0')
    """
    # It imports matplotlib.
    from regions import Regions

    if frame not in ("cube", "epoch"):
        raise ValueError(f"frame must be 'cube' or 'epoch', got {frame!r}")
    if frame == "epoch" and cube.epoch_wcs is None:
        raise ValueError("the cube was not read from files; there is no frame 'epoch'")
    wcs = cube.wcs if frame == "cube" else cube.epoch_wcs[epoch]
    colors = {s: COLORS[k % len(COLORS)] for k, s in enumerate(np.unique(ssps.scale))}
    found = Regions([])
    for index in _chosen(ssps, cube, epoch, scales):
        region = _outline(ssps, index, cube, wcs)
        region.meta["text"] = str(index)
        region.visual["color"] = colors[ssps.scale[index]]
        found.append(region)
    return found


def write_ssp_regions(
    ssps: SSPs, cube: EpochCube, epoch: int, path: Path | str, *,
    overwrite: bool = False, **options: Any,
) -> int:  # fmt: skip
    """
    Write the SSPs of an epoch as regions for DS9, CARTA and others.

    Parameters
    ----------
    ssps, cube, epoch
        As in `ssp_regions`.
    path : path
        A file, commonly ``.reg``.
    overwrite : bool, optional
    **options
        ``scales`` and ``frame`` of `ssp_regions`.

    Returns
    -------
    int
        The number of regions.

    Raises
    ------
    OSError
        If the file exists and ``overwrite`` is False, or cannot be written.

    Notes
    -----
    On scales of mas, regions need more digits than `regions` writes by
    default: positions and sizes are accurate to a nanoarcsecond.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.products import write_ssp_regions
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=2, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    >>> matched = scc.match(cube)
    >>> n = write_ssp_regions(matched.ssps, cube, 0, "epoch_0.reg")
    >>> n == int((matched.ssps.epoch == 0).sum())
    True
    """
    found = ssp_regions(ssps, cube, epoch, **options)
    # For an empty list, regions writes nothing at all.
    text = "# Region file format: DS9 version 4.1\nglobal color=green\nicrs\n"
    if len(found):
        text = found.serialize(format="ds9", precision=DIGITS)
    with replace_when_complete(os.fspath(path), overwrite=overwrite) as part:
        part.write_text(text, encoding="ascii")
    return len(found)


def ssp_segmentation(
    ssps: SSPs, cube: EpochCube, epoch: int, scale: float
) -> SegmentationImage:
    """
    Return the SSPs of one scale of an epoch as a photutils segmentation image.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    cube : `~astro_scc.epochs.EpochCube`
    epoch : int
        Index of the epoch.
    scale : float

    Returns
    -------
    `photutils.segmentation.SegmentationImage`
        Labels are 1 + the number in ``ssps``, which is also the column
        ``ssp`` of the tables.

    Raises
    ------
    IndexError
        If there is no such epoch.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.products import ssp_segmentation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=2, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    >>> matched = scc.match(cube)
    >>> image = ssp_segmentation(matched.ssps, cube, 0, scale=2)
    >>> image.shape, image.n_labels == int((matched.ssps.epoch == 0).sum())
    ((128, 256), True)
    """
    from photutils.segmentation import SegmentationImage

    labels = np.zeros(cube.shape[1:], dtype=np.int32)
    for index in _chosen(ssps, cube, epoch, [scale]):
        labels.flat[ssps.pixels_of(index)] = index + 1
    return SegmentationImage(labels)


def _chosen(ssps, cube, epoch, scales):
    here = ssps.epoch == epoch_index(epoch, len(cube))
    if scales is not None:
        here &= np.isin(ssps.scale, list(scales))
    return np.flatnonzero(here)


def _outline(ssps, index, cube, wcs):
    from regions import PolygonSkyRegion

    _, _, nx = cube.shape
    y0, x0, y1, x1 = ssps.bbox[index]
    row, column = np.divmod(ssps.pixels_of(index), nx)
    inside = np.zeros((y1 - y0 + 2, x1 - x0 + 2))
    inside[row - y0 + 1, column - x0 + 1] = 1
    contours = find_contours(inside, 0.5, fully_connected="high")
    # The longest contour is the outer one; the others surround holes.
    y, x = max(contours, key=len)[:-1].T
    return PolygonSkyRegion(wcs.pixel_to_world(x + x0 - 1, y + y0 - 1))


def write_epoch_regions(
    ssps: SSPs, cube: EpochCube, directory: Path | str, **options: Any
) -> list[Path]:
    """
    Write the SSPs of every epoch as regions for DS9, one file per epoch.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs, for example ``result.decomposed.ssps``.
    cube : `~astro_scc.epochs.EpochCube`
    directory : path
        Its folder ``ssp_regions`` is made if needed; files of the same names
        are replaced.
    **options
        ``scales`` of `ssp_regions`.

    Returns
    -------
    list of `~pathlib.Path`
        Named by the number and the name of each epoch: ``00_first.reg``.

    Raises
    ------
    OSError
        If a file cannot be written.

    Notes
    -----
    The coordinates are those of the epoch's own file, which DS9 can show below
    the regions, or those of the cube if it was not read from files.

    Examples
    --------
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.products import write_epoch_regions
    >>> from astro_scc.simulation import simulate_static
    >>> cube = simulate_static(n_epochs=2, rng=1).cube
    >>> ssps = SSPs.of_epochs([Decomposer(scales=[2])(image) for image in cube.data])
    >>> paths = write_epoch_regions(ssps, cube, ".")
    >>> [path.as_posix() for path in paths]
    ['ssp_regions/00_2000-01-01.reg', 'ssp_regions/01_2000-01-31.reg']
    """
    folder = Path(directory, REGIONS)
    folder.mkdir(exist_ok=True)
    frame = "cube" if cube.epoch_wcs is None else "epoch"
    digits = max(2, len(str(len(cube) - 1)))
    paths = []
    for i, label in enumerate(cube.labels):
        paths.append(folder / f"{i:0{digits}d}_{_plain(label)}.reg")
        write_ssp_regions(
            ssps, cube, i, paths[-1], frame=frame, overwrite=True, **options
        )
    return paths


def _plain(label):
    """Return a label in the characters of a file name."""
    stem = PurePath(label).name.removesuffix(".fits")
    return re.sub(r"[^A-Za-z0-9+._-]+", "_", stem)[:60].strip("._") or "epoch"
