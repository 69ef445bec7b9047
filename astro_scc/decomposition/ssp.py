# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Significant structural patterns (SSPs): their catalogue."""

from dataclasses import dataclass, fields, replace

import numpy as np

__all__ = ["SSPs", "require_ssps"]


@dataclass(frozen=True, eq=False, repr=False)
class SSPs:
    """
    The significant structural patterns of one or more images on all scales.

    Attributes
    ----------
    scale : `~numpy.ndarray`, shape (n,)
        Scale number.
    y, x : `~numpy.ndarray`, shape (n,)
        Maximum of the plane, sub-pixel.
    y_centroid, x_centroid : `~numpy.ndarray`, shape (n,)
        Mean position of the pixels weighted by the plane.
    peak : `~numpy.ndarray`, shape (n,)
        Largest wavelet coefficient.
    flux : `~numpy.ndarray`, shape (n,)
        Sum of the wavelet coefficients.
    snr : `~numpy.ndarray`, shape (n,)
        ``peak`` over the noise of the plane there.
    bbox : `~numpy.ndarray` of int, shape (n, 4)
        Bounding box ``y0, x0, y1, x1``, ends excluded.
    starts : `~numpy.ndarray` of int, shape (n + 1,)
        Where the pixels of each SSP begin in ``pixels``.
    pixels : `~numpy.ndarray` of int, shape (starts[-1],)
        Indices into the flattened image of the pixels of all SSPs.
    epoch : `~numpy.ndarray` of int, shape (n,)
        Index of the image that the SSP is seen in.

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
    epoch: np.ndarray

    def __len__(self):
        return len(self.scale)

    def __repr__(self):
        counts = ", ".join(
            f"{number} on scale {scale:g}"
            for scale, number in zip(
                *np.unique(self.scale, return_counts=True), strict=True
            )
        )
        return f"<SSPs: {counts or 'none'}>"

    @property
    def n_pixels(self):
        """Number of pixels of each SSP, shape (n,)."""
        return np.diff(self.starts)

    def pixels_of(self, index):
        """
        Indices into the flattened image of the pixels of one SSP.

        Parameters
        ----------
        index : int

        Returns
        -------
        `~numpy.ndarray` of int
        """
        return self.pixels[self.starts[index] : self.starts[index + 1]]

    @classmethod
    def empty(cls):
        """A catalogue without SSPs."""
        return cls(
            *(np.empty(0) for _ in range(8)),
            bbox=np.empty((0, 4), dtype=int),
            starts=np.zeros(1, dtype=int),
            pixels=np.empty(0, dtype=np.int32),
            epoch=np.empty(0, dtype=int),
        )

    @classmethod
    def concatenate(cls, catalogues):
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
        shifts = np.cumsum([0] + [c.starts[-1] for c in catalogues[:-1]])
        joined = {
            f.name: np.concatenate([getattr(c, f.name) for c in catalogues])
            for f in fields(cls)
            if f.name != "starts"
        }
        starts = [c.starts[1:] + s for c, s in zip(catalogues, shifts, strict=True)]
        return cls(**joined, starts=np.concatenate([[0], *starts]))

    @classmethod
    def of_epochs(cls, decompositions):
        """
        The SSPs of all epochs as one catalogue, numbered by ``epoch``.

        Parameters
        ----------
        decompositions : sequence of `Decomposition`

        Returns
        -------
        `SSPs`
        """
        return cls.concatenate(
            [
                replace(d.ssps, epoch=np.full(len(d.ssps), epoch))
                for epoch, d in enumerate(decompositions)
            ]
        )


def require_ssps(ssps, scales):
    """
    Refuse epochs that show no SSP at all.

    Parameters
    ----------
    ssps : `SSPs`
        Of all epochs.
    scales : sequence of float
        Where they were looked for.

    Raises
    ------
    ValueError
        If there is none.
    """
    if len(ssps) == 0:
        raise ValueError(
            "no significant pattern (SSP) in any epoch on scale "
            f"{', '.join(f'{scale:g}' for scale in scales)}: try other scales, or a "
            "lower detection; if the images have no empty sky, give their noise and "
            "noise='propagated'"
        )
