# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Where the flow is seen, and the wavelet planes of all epochs along it."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np
import scipy

from astro_scc.decomposition.wavelet import (
    MAD_TO_SIGMA,
    plane_noise,
    scale_size,
    wavelet_planes,
)
from astro_scc.grid.lines import FlowGrid
from astro_scc.spectrum.planes import REACH, FlowPlanes, flow_planes

#: Margin around the grid, in sizes of the largest scale.
MARGIN = 10


def default_scales(beam_px, largest=0.55, number=3):
    """Return a number of scales up to a part of the beam, whose size is in pixels."""
    last = max(0, int(np.floor(np.log2(largest * beam_px) + 1e-9)))
    return tuple(range(max(0, last - number + 1), last + 1))


def seen_flow(cube, beam, *, core, threshold=5.0, least=1.2):
    """
    Return the pixels in which the flow is seen.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    beam : float
        In mas.
    core : bool
        Whether the core at the reference pixel is left out.
    threshold : float, optional
        Faintest mean of the brightest quarter of epochs, in noises of an epoch.
    least : float, optional
        Distance from the core from which the flow is looked at, in beams.

    Returns
    -------
    `~numpy.ndarray` of bool, shape (ny, nx)
    """
    n, rms = len(cube), float(np.median(cube.noise_rms().value))
    few = max(2, n // 4)
    images = np.where(cube.mask, -np.inf, cube.data)
    top = np.partition(images, n - few, axis=0)[n - few :].mean(axis=0)
    seen = top > threshold * rms
    if core:
        east, north = (offset.to_value(u.mas) for offset in cube.offsets())
        seen &= np.hypot(east, north) > least * beam
    return seen


def has_core(cube, beam):
    """Return whether the brightest point of the mean image is the reference pixel."""
    if cube.beams is None:
        return False
    image = np.nan_to_num(np.asarray(cube.mean_image().data, dtype=float), nan=-np.inf)
    y, x = np.unravel_index(image.argmax(), image.shape)
    place = [v.to_value(u.mas) for v in cube.pixel_to_offset(x, y)]
    return bool(np.hypot(*place) < beam)


@dataclass(frozen=True, eq=False, repr=False)
class SampledPlanes:
    """Wavelet planes of all epochs on a grid along the flow, see ``flow_planes``."""

    planes: np.ndarray
    valid: np.ndarray
    mask: np.ndarray
    noise: np.ndarray
    grid: FlowGrid
    years: np.ndarray
    scales: tuple[float, ...]
    sizes: list[float]
    reach: float

    def changes(self, normalise: str = "local") -> FlowPlanes:
        """Return what changes in the planes, normalised."""
        grid = self.grid
        return flow_planes(
            self.planes, self.valid, self.mask, self.noise, along=grid.along,
            across=grid.across, years=self.years, scales=self.scales, sizes=self.sizes,
            weight=None if np.ptp(grid.weight) == 0 else grid.weight,
            normalise=normalise, reach=self.reach,
        )  # fmt: skip


def sample_planes(cube, grid, scales, seen, *, kernel="b1", order=3, reach=REACH):
    """
    Decompose all epochs on a grid along the flow.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    grid : ``FlowGrid``
    scales : sequence of float
        Numbers of the wavelet scales.
    seen : `~numpy.ndarray` of bool, shape (ny, nx)
    kernel
        Of the wavelets.
    order : int, optional
        Of the splines between pixels.
    reach : float, optional
        Largest displacement of diagrams, in beams.

    Returns
    -------
    ``SampledPlanes``
    """
    ny, nx = cube.shape[1:]
    inside = (grid.x > -0.5) & (grid.y > -0.5)
    inside &= (grid.x < nx - 0.5) & (grid.y < ny - 0.5)
    margin = int(MARGIN * max(scale_size(scale) for scale in scales)) + 2
    box = tuple(
        slice(max(0, int(v[inside].min()) - margin), int(v[inside].max()) + margin + 1)
        for v in (grid.y, grid.x)
    )
    where = np.array([grid.y - box[0].start, grid.x - box[1].start])
    where = np.where(inside, where, -1e6)
    n, shape = len(cube), (len(scales), len(cube), *grid.x.shape)
    planes = np.empty(shape, np.float32)
    valid = np.empty((n, *grid.x.shape), dtype=bool)
    sky, noise = ~seen[box], np.empty((n, len(scales)))
    for k in range(n):
        missing = cube.mask[k][box]
        masked = missing if missing.any() else None
        image = np.where(missing, 0.0, cube.data[k][box])
        found = wavelet_planes(image, scales, kernel=kernel, mask=masked)
        noise[k] = [
            _noise(plane, scale, sky & ~missing, masked)
            for plane, scale in zip(found, scales, strict=True)
        ]
        for j, plane in enumerate(found):
            planes[j, k] = scipy.ndimage.map_coordinates(
                plane, where, order=order, mode="constant"
            )
        valid[k] = inside
        if masked is not None:
            weight = scipy.ndimage.map_coordinates(
                missing.astype(float), where, order=1, cval=1.0
            )
            valid[k] &= weight < 0.5
    mask = scipy.ndimage.map_coordinates(seen[box].astype(float), where, order=1) > 0.5
    side = cube.pixel_scale.to_value(u.mas) / grid.beam
    side /= grid.along[1] - grid.along[0]
    return SampledPlanes(
        planes, valid, mask, np.sqrt((noise**2).mean(axis=0)), grid,
        cube.years.to_value(u.yr), tuple(scales),
        [side * scale_size(scale) for scale in scales], reach,
    )  # fmt: skip


def sample_mask(mask, grid):
    """Return the weight of the points of a grid inside a region."""
    where = np.array([grid.y, grid.x])
    return scipy.ndimage.map_coordinates(
        np.asarray(mask, float), where, order=1, mode="constant"
    )


def _noise(plane, scale, sky, mask):
    """Return the noise of a plane where no flow is seen, or as it is found in it."""
    if sky.mean() < 0.1:
        return plane_noise(plane, scale, mask=mask)
    return MAD_TO_SIGMA * float(np.median(np.abs(plane[sky])))
