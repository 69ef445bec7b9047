# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The segmented wavelet decomposition of an image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from astro_scc.decomposition import wavelet
from astro_scc.decomposition.segmentation import SSPs, find_ssps
from astro_scc.decomposition.wavelet import scale_kernel, wavelet_planes
from astro_scc.quantities import NOISES, check_choice, named

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
        object.__setattr__(self, "scales", scales)
        if self.noise_factors is not None:
            object.__setattr__(self, "noise_factors", tuple(self.noise_factors))

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
        noise = self._noise(planes, missing, rms, beam_covariance)
        noise = tuple(np.maximum(sigma, floor) for sigma in noise)
        thresholds = {"detection": self.detection, "segmentation": self.segmentation}
        each = zip(planes, self.scales, noise, strict=True)
        found = [find_ssps(*one, mask=missing, **thresholds) for one in each]
        ssps = SSPs.concatenate(found)
        planes = planes.astype(np.float32)
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
        each = [self._planes(*of)[:2] for of in zip(images, masks, strict=True)]
        found = []
        for k, scale in enumerate(self.scales):
            pair = [(planes[k], missing) for planes, missing in each]
            found.append(wavelet.shared_variance(pair, scale))
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
        offset = np.median(image[~missing])
        image = np.where(missing, 0.0, image - offset)
        missing = missing if missing.any() else None
        planes = wavelet_planes(image, self.scales, kernel=self.kernel, mask=missing)
        return planes, missing, ROUNDING * max(np.ptp(image), abs(offset))

    def _noise(self, planes, missing, rms, beam_covariance):
        if self.noise == "propagated":
            if rms is None or not 0 < rms < np.inf:
                raise ValueError(f"'propagated' needs the rms of the image, got {rms}")
            return wavelet.propagated_noise(
                rms, self.scales, beam_covariance=beam_covariance, kernel=self.kernel
            )
        kinds = {"plane": wavelet.plane_noise, "local": wavelet.local_noise}
        factors = self.noise_factors or (1.0,) * len(self.scales)
        return [
            factor * kinds[self.noise](plane, scale, mask=missing)
            for plane, scale, factor in zip(planes, self.scales, factors, strict=True)
        ]
