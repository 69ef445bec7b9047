# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The segmented wavelet decomposition: significant structural patterns of images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import scipy
import skimage
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from astro_scc.decomposition import wavelet
from astro_scc.decomposition.wavelet import scale_kernel, scale_size, wavelet_planes
from astro_scc.quantities import NOISES, check_choice, named

#: Values beside a maximum count as this share of it or more: at the corners of 3 x 3
#: pixels, that of a Gaussian with a standard deviation of one pixel.
FAINT = 0.1


@dataclass(frozen=True, eq=False, repr=False)
class SSPs:
    """
    The significant structural patterns of one or more images on all scales.

    Attributes
    ----------
    scale : `~numpy.ndarray`, shape (n,)
        Scale number.
    y, x : `~numpy.ndarray`, shape (n,)
        Position of the maximum of the plane, sub-pixel.
    y_centroid, x_centroid : `~numpy.ndarray`, shape (n,)
        Mean position of the pixels, weighted by the plane.
    peak : `~numpy.ndarray`, shape (n,)
        Largest wavelet coefficient.
    flux : `~numpy.ndarray`, shape (n,)
        Sum of the wavelet coefficients.
    snr : `~numpy.ndarray`, shape (n,)
        ``peak`` divided by the noise of the plane there.
    bbox : `~numpy.ndarray` of int, shape (n, 4)
        Bounding box ``y0, x0, y1, x1``, ends excluded.
    starts : `~numpy.ndarray` of int, shape (n + 1,)
        Start of the pixels of each SSP in ``pixels``.
    pixels : `~numpy.ndarray` of int, shape (starts[-1],)
        Indices into the flattened image of the pixels of all SSPs.
    values : `~numpy.ndarray`, shape (starts[-1],)
        Wavelet coefficients of these pixels in single precision.
    epoch : `~numpy.ndarray` of int, shape (n,)
        Index of the image that shows the SSP.

    Examples
    --------
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> images = simulate_two_fluid(n_epochs=2, rng=1).cube.data
    >>> ssps = SSPs.of_epochs([Decomposer(scales=[2])(image) for image in images])
    >>> sorted(set(ssps.epoch.tolist())), bool((ssps.snr >= 4).all())
    ([0, 1], True)
    """

    scale: np.ndarray
    y: np.ndarray
    x: np.ndarray
    y_centroid: np.ndarray
    x_centroid: np.ndarray
    peak: np.ndarray
    flux: np.ndarray
    snr: np.ndarray
    bbox: np.ndarray
    starts: np.ndarray
    pixels: np.ndarray
    values: np.ndarray
    epoch: np.ndarray

    def __len__(self) -> int:
        return len(self.scale)

    def __repr__(self):
        scales = zip(*np.unique(self.scale, return_counts=True), strict=True)
        counts = ", ".join(f"{number} on scale {scale:g}" for scale, number in scales)
        return f"<SSPs: {counts or 'none'}>"

    @property
    def n_pixels(self) -> np.ndarray:
        """Number of pixels of each SSP, shape (n,)."""
        return np.diff(self.starts)

    def pixels_of(self, index: int) -> np.ndarray:
        """
        Return the indices into the flattened image of the pixels of one SSP.

        Parameters
        ----------
        index : int

        Returns
        -------
        `~numpy.ndarray` of int
        """
        return self.pixels[self.starts[index] : self.starts[index + 1]]

    def select(self, keep: np.ndarray) -> SSPs:
        """
        Return the SSPs for which ``keep``, of shape (n,), is true.

        Parameters
        ----------
        keep : `~numpy.ndarray` of bool, shape (n,)

        Returns
        -------
        `SSPs`
        """
        kept, inside = {}, np.repeat(keep, self.n_pixels)
        for name in [f.name for f in fields(self) if f.name != "starts"]:
            which = inside if name in ("pixels", "values") else keep
            kept[name] = getattr(self, name)[which]
        return SSPs(**kept, starts=_starts(self.n_pixels[keep]))

    @classmethod
    def empty(cls) -> SSPs:
        """Return a catalogue without SSPs."""
        return cls(
            *np.empty((8, 0)), bbox=np.empty((0, 4), dtype=int),
            starts=np.zeros(1, dtype=int), pixels=np.empty(0, dtype=np.int32),
            values=np.empty(0, dtype=np.float32), epoch=np.empty(0, dtype=int),
        )  # fmt: skip

    @classmethod
    def concatenate(cls, catalogues: Sequence[SSPs]) -> SSPs:
        """
        Join catalogues, of several scales or of several epochs.

        Parameters
        ----------
        catalogues : sequence of `SSPs`

        Returns
        -------
        `SSPs`
        """
        catalogues = [cls.empty(), *catalogues]
        names = [f.name for f in fields(cls)]
        joined = {k: np.concatenate([getattr(c, k) for c in catalogues]) for k in names}
        joined["starts"] = _starts(np.concatenate([c.n_pixels for c in catalogues]))
        return cls(**joined)

    @classmethod
    def of_epochs(cls, decompositions: Sequence[Decomposition]) -> SSPs:
        """
        Join the SSPs of all decompositions, numbered by ``epoch``.

        Parameters
        ----------
        decompositions : sequence of ``Decomposition``

        Returns
        -------
        `SSPs`
        """
        each = [d.ssps for d in decompositions]
        epoch = np.repeat(np.arange(len(each)), [len(ssps) for ssps in each])
        return replace(cls.concatenate(each), epoch=epoch)


def _starts(n_pixels):
    """Return where the pixels of each SSP start, and where the last ones end."""
    return np.concatenate([[0], np.cumsum(n_pixels)])


def require_ssps(ssps, scales):
    """Raise a ValueError if no epoch shows an SSP on the scales."""
    if len(ssps) == 0:
        raise ValueError(
            "no significant pattern (SSP) in any epoch on scale "
            f"{', '.join(f'{scale:g}' for scale in scales)}: try other scales, or a "
            "lower detection; if the images have no empty sky, give their noise and "
            "noise='propagated'"
        )


def gaussian_peak(values):
    """
    Find the maximum of the Gaussian through 3 x 3 values, by least squares of logs.

    ``values`` has the shape (..., 3, 3), and the central one is positive and the
    largest; others count as `FAINT` of it or more.  A parabola would draw narrow peaks
    to whole pixels.  Returns dy and dx from the centre, within half a pixel and zero
    if the surface has no maximum, and the height there, which is never below the
    central value.
    """
    centre = np.asarray(values, dtype=float)[..., 1:2, 1:2]
    v = np.log(np.maximum(values / centre, FAINT))
    column, row = v.sum(axis=-2), v.sum(axis=-1)
    gx = (column[..., 2] - column[..., 0]) / 6
    gy = (row[..., 2] - row[..., 0]) / 6
    hxx = (column[..., 2] - 2 * column[..., 1] + column[..., 0]) / 3
    hyy = (row[..., 2] - 2 * row[..., 1] + row[..., 0]) / 3
    hxy = (v[..., 2, 2] - v[..., 2, 0] - v[..., 0, 2] + v[..., 0, 0]) / 4
    level = (5 * v.sum(axis=(-2, -1)) - 3 * (column[..., 0] + column[..., 2])
             - 3 * (row[..., 0] + row[..., 2])) / 9  # fmt: skip
    determinant = hxx * hyy - hxy**2
    peaked = (determinant > 0) & (hxx < 0)
    safe = np.where(peaked, determinant, 1.0)
    dx = np.where(peaked, (hxy * gy - hyy * gx) / safe, 0.0)
    dy = np.where(peaked, (hxy * gx - hxx * gy) / safe, 0.0)
    inside = (np.abs(dx) <= 0.5) & (np.abs(dy) <= 0.5)
    dx, dy = np.clip(dx, -0.5, 0.5), np.clip(dy, -0.5, 0.5)
    height = np.where(peaked & inside, level + 0.5 * (gx * dx + gy * dy), 0.0)
    return dy, dx, centre[..., 0, 0] * np.exp(np.maximum(height, 0.0))


def find_ssps(
    plane: np.ndarray, scale: float, noise: float | np.ndarray, *,
    mask: ArrayLike | None = None, detection: float = 4.0, segmentation: float = 3.0,
) -> SSPs:  # fmt: skip
    """
    Find the significant structural patterns of a wavelet plane.

    Local maxima of at least ``detection`` times the noise, about a scale
    apart, are the seeds of a watershed of the negative plane within the
    pixels above ``segmentation`` times the noise (Mertens & Lobanov 2015,
    Sect. 2.1).  A pixel at the edge of the image, or of its valid part, is
    not a maximum, because the image may rise further beyond it.  A pixel
    beside a hole within the image can be one.

    Parameters
    ----------
    plane : `~numpy.ndarray`, shape (ny, nx)
        Wavelet coefficients; only positive ones make SSPs.
    scale : float
        Scale number.
    noise : float or `~numpy.ndarray`, shape (ny, nx)
        Standard deviation of the noise of the plane.
    mask : array_like of bool, shape (ny, nx), optional
        True marks missing pixels, which belong to no SSP.
    detection, segmentation : float
        Thresholds in units of the noise.

    Returns
    -------
    `SSPs`
        Without rows if nothing is significant.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.decomposition.segmentation import find_ssps
    >>> y, x = np.mgrid[:40, :60]
    >>> plane = np.exp(-((x - 20.3) ** 2 + (y - 15) ** 2) / 18)
    >>> ssps = find_ssps(plane, 1, 0.01)
    >>> len(ssps), float(ssps.x_centroid[0].round(1))
    (1, 20.3)
    """
    whole = np.asarray(plane, dtype=float)
    noise = np.broadcast_to(np.asarray(noise, dtype=float), whole.shape)
    significant = whole > segmentation * noise
    if mask is not None:
        significant &= ~np.asarray(mask)
    seen = [np.flatnonzero(significant.any(axis=axis)) for axis in (1, 0)]
    if len(seen[0]) == 0:
        return SSPs.empty()
    margin = round(scale_size(scale)) + 1
    box = tuple(slice(max(at[0] - margin, 0), at[-1] + 1 + margin) for at in seen)
    plane, noise, significant = whole[box], noise[box], significant[box]
    outside = _outside(whole.shape, mask)
    peaks = _maxima(np.where(significant, plane, 0.0), scale, outside, box)
    at = tuple(peaks.T)
    at = tuple(peaks[plane[at] >= detection * noise[at]].T)
    n = len(at[0])
    if n == 0:
        return SSPs.empty()
    markers = np.zeros(plane.shape, dtype=np.int32)
    markers[at] = np.arange(1, n + 1)
    labels = skimage.segmentation.watershed(
        -plane, markers, connectivity=1, mask=significant
    )
    # Beside a missing pixel the curvature is unknown, and the whole pixel is kept.
    known = plane if mask is None else np.where(np.asarray(mask)[box], np.nan, plane)
    around = sliding_window_view(known, (3, 3))[at[0] - 1, at[1] - 1]
    dy, dx, _ = gaussian_peak(around)
    y0, x0 = (side.start for side in box)
    return SSPs(
        scale=np.full(n, float(scale)), y=at[0] + y0 + dy, x=at[1] + x0 + dx,
        peak=plane[at], snr=plane[at] / noise[at], epoch=np.zeros(n, dtype=int),
        **_segments(plane, labels, n, (y0, x0), whole.shape[1]),
    )  # fmt: skip


def _segments(plane, labels, n, corner, width):
    """Return the fields of SSPs that follow from their labels in part of an image."""
    pixels = np.flatnonzero(labels)
    pixels = pixels[np.argsort(labels.flat[pixels], kind="stable")]
    owner, weight = labels.flat[pixels] - 1, plane.flat[pixels]
    places = np.transpose(np.unravel_index(pixels, plane.shape)) + corner
    flux = np.bincount(owner, weight, n)
    y, x = (np.bincount(owner, weight * place, n) / flux for place in places.T)
    boxes = scipy.ndimage.find_objects(labels)
    boxes = [(y.start, x.start, y.stop, x.stop) for y, x in boxes]
    return {
        "flux": flux, "y_centroid": y, "x_centroid": x,
        "pixels": (places @ (width, 1)).astype(np.int32),
        "values": weight.astype(np.float32), "bbox": boxes + np.tile(corner, 2),
        "starts": _starts(np.bincount(owner, minlength=n)),
    }  # fmt: skip


def _outside(shape, mask):
    """
    Return what is outside of an image, which is framed by a pixel.

    Missing pixels that are joined to its edge are, others are holes.
    """
    frame = np.ones(np.add(shape, 2), dtype=bool)
    frame[1:-1, 1:-1] = False if mask is None else mask
    if mask is None or not np.any(mask):
        return frame
    label, _ = scipy.ndimage.label(frame)
    return label == label[0, 0]


def _maxima(plane, scale, outside, box):
    """
    Return the places in a box of local maxima that are not beside the outside.

    The highest stands first.  Of equal ones that are less than a scale apart, the first
    is kept.  ``skimage.feature.peak_local_max`` does the same, but loads 100 modules.
    """
    distance = round(scale_size(scale))
    top = plane == scipy.ndimage.maximum_filter(plane, 2 * distance + 1, mode="nearest")
    peaks = np.argwhere(top & (plane > 0) & (not top.all()))
    height = plane[tuple(peaks.T)]
    order = np.argsort(-height, kind="stable")
    peaks, height, keep = peaks[order], height[order], np.ones(len(peaks), dtype=bool)
    for k in np.flatnonzero(height[1:] == height[:-1]) + 1:
        same = peaks[:k][keep[:k] & (height[:k] == height[k])]
        keep[k] = (np.abs(same - peaks[k]).max(axis=1) >= distance).all()
    peaks = peaks[keep]
    framed = outside[tuple(slice(s.start, s.stop + 2) for s in box)]
    around = sliding_window_view(framed, (3, 3))[tuple(peaks.T)]
    return peaks[~around.any(axis=(1, 2))]


# -- decomposition of images --------------------------------------------------------

#: Relative rounding error of single precision, below which nothing is significant.
ROUNDING = 1e-7


@dataclass(frozen=True, eq=False, repr=False)
class Decomposition:
    """
    An image as wavelet planes, their noise and their SSPs.

    Attributes
    ----------
    scales : tuple of float
        Scale numbers.
    planes : `~numpy.ndarray`, shape (n_scales, ny, nx)
        Wavelet coefficients in single precision; zero where the image is
        missing.
    noise : tuple of float or `~numpy.ndarray`
        Standard deviation of the noise of each plane, a number or a map.
    ssps : `SSPs`
        SSPs of all scales, in the order of ``scales``.
    mask : `~numpy.ndarray` of bool, shape (ny, nx), or None
        Missing pixels.

    Examples
    --------
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> image = simulate_two_fluid(n_epochs=2, rng=1).cube.data[0]
    >>> decomposition = Decomposer(scales=[1, 2])(image)
    >>> decomposition.planes.shape, decomposition.scales
    ((2, 128, 256), (1.0, 2.0))
    """

    scales: tuple[float, ...]
    planes: np.ndarray
    noise: tuple[float | np.ndarray, ...]
    ssps: SSPs
    mask: np.ndarray | None = None

    def __repr__(self):
        ny, nx = self.planes.shape[1:]
        return f"<Decomposition of {nx} x {ny} px: {self.ssps!r}>"


@dataclass(frozen=True)
class Decomposer:
    """
    Settings of the segmented wavelet decomposition.

    Parameters
    ----------
    scales : sequence of float
        Scale numbers; j means 2^j pixels, j + 1/2 means 1.5 x 2^j.
    kernel : {"b1", "b3"}
        Low-pass filter, linear or cubic spline.
    detection, segmentation : float
        Thresholds of the maxima and of the pixels of SSPs, in sigma.
    noise : {"plane", "local", "propagated"}
        Whether sigma is one number measured in the plane, a map measured in
        it, or follows from the rms of the image and its beam.
    noise_factors : sequence of float, optional
        Factor on the sigma of "plane" and "local" for each scale, if part of
        the apparent noise is structure (`Decomposer.shared_variance`).

    Raises
    ------
    ValueError
        If a setting is not one of the above.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.decomposition import Decomposer
    >>> y, x = np.mgrid[:64, :64]
    >>> image = np.exp(-((x - 30) ** 2 + (y - 32) ** 2) / 20)
    >>> image += np.random.default_rng(0).normal(scale=0.01, size=image.shape)
    >>> Decomposer(scales=[1, 2])(image)
    <Decomposition of 64 x 64 px: <SSPs: 1 on scale 1, 1 on scale 2>>
    """

    scales: Sequence[float] = (1, 2, 3, 4)
    kernel: str = "b1"
    detection: float = 4.0
    segmentation: float = 3.0
    noise: str = "plane"
    noise_factors: Sequence[float] | None = None

    def __post_init__(self):
        scales = tuple(sorted({float(scale) for scale in self.scales}))
        if not scales:
            raise ValueError("at least one wavelet scale is needed")
        if not 0 < self.segmentation <= self.detection:
            raise ValueError(
                "thresholds must satisfy 0 < segmentation <= detection, "
                f"got segmentation {self.segmentation} and detection {self.detection}"
            )
        for scale in scales:
            scale_kernel(scale, self.kernel)
        named("noise", check_choice, self.noise, *NOISES)
        factors = self.noise_factors
        if factors is not None:
            factors = tuple(map(float, factors))
            if len(factors) != len(scales) or not all(0 <= f <= 1 for f in factors):
                n = len(scales)
                raise ValueError(
                    f"noise_factors must be {n} from 0 to 1, got {factors}"
                )
        vars(self).update(scales=scales, noise_factors=factors)

    def __call__(
        self, image: ArrayLike, *, mask: ArrayLike | None = None,
        rms: float | None = None, beam_covariance: ArrayLike | None = None,
    ) -> Decomposition:  # fmt: skip
        """
        Decompose an image.

        Parameters
        ----------
        image : array_like, shape (ny, nx)
        mask : array_like of bool, shape (ny, nx), optional
            True marks missing pixels.
        rms : float, optional
            Noise of the image, for ``noise="propagated"``.
        beam_covariance : array_like, shape (2, 2), optional
            Covariance of the beam over (x, y) in pixels squared, for
            ``noise="propagated"``.

        Returns
        -------
        ``Decomposition``

        Raises
        ------
        ValueError
            If the image is too small for the scales or has no valid pixel,
            the mask has another shape, or ``rms`` is missing.
        """
        planes, missing, floor = self._planes(image, mask)
        if self.noise == "propagated":
            if rms is None or not 0 < rms < np.inf:
                raise ValueError(f"'propagated' needs the rms of the image, got {rms}")
            noise = wavelet.propagated_noise(
                rms, self.scales, beam_covariance=beam_covariance, kernel=self.kernel
            )
        else:
            local = self.noise == "local"
            measure = wavelet.local_noise if local else wavelet.plane_noise
            factors = self.noise_factors or (1.0,) * len(planes)
            each = zip(planes, self.scales, factors, strict=True)
            noise = [f * measure(plane, j, mask=missing) for plane, j, f in each]
        noise = tuple(np.maximum(sigma, floor) for sigma in noise)
        found = [
            find_ssps(plane, j, sigma, mask=missing, detection=self.detection,
                      segmentation=self.segmentation)
            for plane, j, sigma in zip(planes, self.scales, noise, strict=True)
        ]  # fmt: skip
        planes, ssps = planes.astype(np.float32), SSPs.concatenate(found)
        return Decomposition(self.scales, planes, noise, ssps, missing)

    def shared_variance(
        self, images: Sequence[ArrayLike], *,
        masks: Sequence[ArrayLike | None] = (None, None),
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """
        Return the share of variance that two images have in common on each scale.

        The share is the largest correlation of the planes, without bright sources,
        at any displacement.  The standard deviation of the correlation that chance
        gives is returned beside it.

        Parameters
        ----------
        images : pair of array_like, shape (ny, nx)
        masks : pair of array_like of bool, shape (ny, nx), or None

        Returns
        -------
        share, chance : `~numpy.ndarray`, shape (n_scales,)
        """
        (one, mask, _), (other, other_mask, _) = map(self._planes, images, masks)
        found = [
            wavelet.shared_variance([(a, mask), (b, other_mask)], scale)
            for a, b, scale in zip(one, other, self.scales, strict=True)
        ]
        share, chance = np.array(found).T
        return share, chance

    def _planes(self, image, mask):
        """Return the planes, the missing pixels, and the rounding errors."""
        image = np.asarray(image, dtype=float)
        if image.ndim != 2:
            raise ValueError(f"an image has two dimensions, this has {image.ndim}")
        missing = ~np.isfinite(image)
        if mask is not None:
            if np.shape(mask) != image.shape:
                shapes = f"{np.shape(mask)}, the image {image.shape}"
                raise ValueError(f"the mask has shape {shapes}: they must agree")
            missing |= mask
        if missing.all():
            raise ValueError("the image has no valid pixel")
        # An offset would use up the digits of single precision.
        offset = wavelet.median(image[~missing])
        image = np.where(missing, 0.0, image - offset)
        missing = missing if missing.any() else None
        planes = wavelet_planes(image, self.scales, kernel=self.kernel, mask=missing)
        return planes, missing, ROUNDING * max(np.ptp(image), abs(offset))
