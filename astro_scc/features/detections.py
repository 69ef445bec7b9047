# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Detections of all epochs, from which features are made."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import astropy.units as u
import numpy as np
from numpy.typing import ArrayLike

from astro_scc.decomposition.wavelet import scale_size
from astro_scc.features.gaussians import fit_gaussians
from astro_scc.images.beam import beam_covariance, beam_fwhm, position_errors
from astro_scc.images.positions import ssp_offsets
from astro_scc.parallel import in_order, progress

#: Distance from the origin within which the core lies if the epochs are not aligned,
#: and its scatter if they are, in beams.
FARTHEST_CORE, ALIGNED = 0.7, 0.08
#: SSPs that are nearer to each other, in sizes of the larger one, are one pattern.
APART = 0.7


@dataclass(frozen=True, eq=False)
class Detections:
    """
    Compact emission in the images of all epochs, ordered by epoch.

    Attributes
    ----------
    epoch : `~numpy.ndarray` of int, shape (n,)
    place, place_error : `~numpy.ndarray`, shape (n, 2)
        Offsets from the core on two axes, in mas, with standard errors.
    flux : `~numpy.ndarray`, shape (n,)
        Positive, in the unit of `pixel_flux`.
    size : `~numpy.ndarray`, shape (n,)
        Full width at half maximum, in mas.
    years : `~numpy.ndarray`, shape (n_epochs,)
        Dates in order.
    beam : `~numpy.ndarray`, shape (2, 2)
        Covariance of the beam on the two axes, in mas^2.
    number : `~numpy.ndarray` of int, shape (n,)
        Number of each within its epoch.
    group : `~numpy.ndarray` of int, shape (n,)
        Of alternatives in an epoch: detections of one number may be parts of the one
        with its negative; zero for others.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.features.detections import Detections
    >>> d = Detections(
    ...     epoch=np.arange(3), place=np.array([[1.0, 0.0], [1.5, 0.0], [2.0, 0.0]]),
    ...     place_error=np.full((3, 2), 0.01), flux=np.ones(3), size=np.zeros(3),
    ...     years=np.array([2000.0, 2001.0, 2002.0]), beam=np.eye(2) / 5.545,
    ...     number=np.zeros(3, dtype=int), group=np.zeros(3, dtype=int))
    >>> d.in_beams[:, 0].round(2), d.time
    (array([1. , 1.5, 2. ]), array([2000., 2001., 2002.]))
    """

    epoch: np.ndarray
    place: np.ndarray
    place_error: np.ndarray
    flux: np.ndarray
    size: np.ndarray
    years: np.ndarray
    beam: np.ndarray
    number: np.ndarray
    group: np.ndarray

    def __len__(self) -> int:
        return len(self.epoch)

    def select(self, keep: ArrayLike) -> Detections:
        """
        Return some of the detections.

        Parameters
        ----------
        keep : array_like of bool, shape (n,), or of int

        Returns
        -------
        `Detections`
        """
        each = [f.name for f in fields(self) if f.name not in ("years", "beam")]
        return replace(self, **{name: getattr(self, name)[keep] for name in each})

    @property
    def time(self) -> np.ndarray:
        """Date of each, in years."""
        return self.years[self.epoch]

    def velocity(self, which: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the slope of a straight line through some detections.

        Parameters
        ----------
        which : array_like of int, shape (n,)

        Returns
        -------
        velocity, variance : `~numpy.ndarray`, shape (2,)
            In mas/yr, and the formal variance.
        """
        time = self.time[which] - self.time[which].mean()
        response = time / (time @ time)
        velocity = response @ self.place[which]
        return velocity, response**2 @ self.place_error[which] ** 2

    @property
    def fwhm(self) -> float:
        """Geometric mean of the beam's full widths at half maximum, in mas."""
        return float(np.sqrt(8 * np.log(2)) * np.linalg.det(self.beam) ** 0.25)

    @property
    def major(self) -> float:
        """Full width at half maximum of the beam's major axis, in mas."""
        return float(np.sqrt(8 * np.log(2) * np.linalg.eigvalsh(self.beam)[-1]))

    @cached_property
    def in_beams(self) -> np.ndarray:
        """Places in full widths of the beam along its axes, shape (n, 2)."""
        return self.to_beams(self.place)

    def to_beams(self, offset: ArrayLike) -> np.ndarray:
        """
        Return offsets in full widths of the beam along its axes.

        Parameters
        ----------
        offset : array_like, shape (..., 2)
            In mas.

        Returns
        -------
        `~numpy.ndarray`, shape (..., 2)
            Its length is that of the offset in full widths of the beam along it.
        """
        variance, axes = np.linalg.eigh(self.beam)
        return offset @ axes / np.sqrt(8 * np.log(2) * variance)

    def core(self, radius: float) -> np.ndarray:
        """
        Return which detections are the core.

        Parameters
        ----------
        radius : float
            Largest distance from the origin in beams.

        Returns
        -------
        `~numpy.ndarray` of bool, shape (n,)
            The nearest to the origin of each epoch, if it is as near as that.
        """
        distance = np.hypot(*self.in_beams.T)
        order = np.lexsort((distance, self.epoch))
        first = order[np.unique(self.epoch[order], return_index=True)[1]]
        core = np.zeros(len(self), dtype=bool)
        core[first] = distance[first] <= radius
        return core

    def parts(self, k: int) -> np.ndarray:
        """
        Return the detections that may be parts of one.

        Parameters
        ----------
        k : int
            Number of a detection.

        Returns
        -------
        `~numpy.ndarray` of int
            Empty if it has none.
        """
        same = (self.epoch == self.epoch[k]) & (self.group == -self.group[k])
        return np.flatnonzero(same & (self.group > 0))

    def elongation(self, k: int) -> np.ndarray:
        """
        Return how far the parts of a detection are apart, and in which direction.

        Parameters
        ----------
        k : int
            Number of a detection with parts.

        Returns
        -------
        `~numpy.ndarray`, shape (2, 2)
            Twice the scatter of the parts along its axis, in beams, times the square of
            the unit vector along the axis.
        """
        parts = self.parts(k)
        share = self.flux[parts] / self.flux[parts].sum()
        off = self.in_beams[parts] - share @ self.in_beams[parts]
        variance, axes = np.linalg.eigh((share * off.T) @ off)
        return 2 * np.sqrt(variance[-1]) * np.outer(axes[:, -1], axes[:, -1])

    def chosen(self, whole: ArrayLike) -> Detections:
        """
        Return the detections without alternatives.

        Parameters
        ----------
        whole : array_like of bool, shape (n,)
            Which of the detections with parts replace them.

        Returns
        -------
        `Detections`
        """
        left = np.zeros(len(self), dtype=bool)
        for k in np.flatnonzero(self.group < 0).tolist():
            parts = self.parts(k)
            left[parts if whole[k] or len(parts) == 0 else k] = True
        return self.select(~left)

    def aligned(self) -> Detections:
        """
        Return the detections with offsets from the core of their own epoch.

        This is done if the core is seen in at least nine of ten epochs and scatters
        more than epochs do that are aligned on it; epochs without it are left out.
        Otherwise the detections stay as they are: the fitted place of a core then
        varies with what emerges from it rather than with the alignment.

        Returns
        -------
        `Detections`
        """
        core = self.core(FARTHEST_CORE)
        seen, place = self.epoch[core], self.place[core]
        scatter = np.sqrt((self.in_beams[core] ** 2).mean()) if len(seen) else 0.0
        if scatter <= ALIGNED or len(seen) < 0.9 * len(self.years):
            return self
        offset = np.zeros((len(self.years), 2))
        offset[seen] = place
        shifted = replace(self, place=self.place - offset[self.epoch])
        return shifted.select(np.isin(self.epoch, seen))


#: Ratio of the errors of positions to those of noise: in CLEANed images, blended
#: components are off by about twice the formal errors (``benchmarks/features.py``).
CLEANED = 2.0


def rank_in_group(key):
    """Return the rank of each entry of a sorted key >= 0 among equal ones, from 0."""
    first = np.flatnonzero(np.diff(key, prepend=-1))
    return np.arange(len(key)) - np.repeat(first, np.diff(first, append=len(key)))


def gaussians_of(cube, *, n_workers=1, progress_bar=False):
    """
    Return the components of Gaussian models of all images as detections.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
        With beams.
    n_workers : int, str or `dask.distributed.Client`, optional
        The unit of work is an epoch.
    progress_bar : bool, optional

    Returns
    -------
    `Detections`
        The brightest of each epoch first.
    """
    # From (y, x) in pixels to offsets on the two axes.
    matrix, every = cube.pixel_matrix.value[:, ::-1], np.arange(len(cube))
    beams = beam_covariance(cube, every, every)
    inverse, noise = np.linalg.inv(matrix), cube.noise_rms().value
    work = zip(cube.data, cube.mask, inverse @ beams @ inverse.T, noise, strict=True)
    models = []
    with progress(len(cube), "Fitting", show=progress_bar) as done:
        for model in in_order(_fit, work, n_workers):
            models.append(model)
            done(1)
    found = np.concatenate(models)
    y, x, y_err, x_err, flux, size = (
        found[name].copy() for name in ("y", "x", "y_err", "x_err", "flux", "size")
    )
    epoch = np.repeat(every, [len(model) for model in models])
    pixels = 2 * np.pi * np.sqrt(np.linalg.det(beams)) / cube.pixel_scale.value**2
    flux *= (pixels * pixel_flux(cube).value)[epoch]
    x0, y0 = cube.reference_pixel
    errors = np.stack([y_err, x_err], axis=1)
    return Detections(
        epoch=epoch, place=np.stack([y - y0, x - x0], axis=1) @ matrix.T,
        place_error=CLEANED * np.sqrt(errors**2 @ (matrix**2).T), flux=flux,
        size=size * cube.pixel_scale.value, years=_years(cube), beam=beams.mean(axis=0),
        number=rank_in_group(epoch), group=found["group"].copy(),
    )  # fmt: skip


def _fit(image_mask_beam_rms):
    """Fit one image, given as the arguments of one task."""
    image, mask, covariance, rms = image_mask_beam_rms
    return fit_gaussians(image, covariance, rms, mask=mask)


def ssps_of(cube, ssps):
    """
    Return SSPs that are patterns of their own as detections.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs; each pattern is that of the finest of its scales.

    Returns
    -------
    `Detections`
        With errors of the positions from the signal-to-noise ratio.  Without beams
        the resolution is that of the finest scale.
    """
    keep = np.zeros(len(ssps), dtype=bool)
    for k in np.lexsort((-ssps.snr, ssps.scale)).tolist():
        same = np.flatnonzero(keep & (ssps.epoch == ssps.epoch[k]))
        off = np.hypot(ssps.y[same] - ssps.y[k], ssps.x[same] - ssps.x[k])
        keep[k] = not (off <= APART * scale_size(ssps.scale[k])).any()
    finest = np.full(len(cube), ssps.scale.min() if len(ssps) else 0)
    beams = beam_covariance(cube, np.arange(len(cube)), finest)
    kept = ssps.select(keep)
    widths = beam_fwhm(cube, kept.epoch, kept.scale, np.eye(2))
    return Detections(
        epoch=kept.epoch, place=np.stack(ssp_offsets(kept, cube), axis=1),
        place_error=position_errors(kept.snr, widths, 0.0),
        flux=kept.flux * pixel_flux(cube).value[kept.epoch], size=np.zeros(len(kept)),
        years=_years(cube), beam=beams.mean(axis=0), number=rank_in_group(kept.epoch),
        group=np.zeros(len(kept), dtype=int),
    )  # fmt: skip


def pixel_flux(cube):
    """
    Return the flux in a pixel of unit brightness at each epoch, shape (n_epochs,).

    It is in Jy for images in Jy/beam, Jy/pix and Jy/sr, and in K mas2 for images in K;
    other values count as those of whole pixels.
    """
    unit, area = u.Unit(cube.unit), cube.pixel_scale**2
    per = dict(zip(unit.bases, unit.powers, strict=True))
    if u.beam in per and cube.beams is not None:
        beams = [np.sqrt(np.linalg.det(b.covariance.value)) for b in cube.beams]
        return area.value / (2 * np.pi * np.array(beams)) * unit * u.beam
    flux = 1 * unit
    if u.beam in per or u.pix in per:
        flux = flux * u.pix
    elif unit.is_equivalent(u.K):
        flux = flux * area
    else:
        for base, power in per.items():
            if (base**-power).is_equivalent(u.sr):
                flux = flux * area.to(base**-power)
    return np.full(len(cube), flux.value) * flux.unit


def _years(cube):
    """Return the dates as Julian years."""
    return cube.times[0].jyear + cube.years.to_value(u.yr)
