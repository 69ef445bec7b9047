# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The speed of a stream across the direction of the grid."""

import numpy as np

from astro_scc.spectrum.diagram import correlate
from astro_scc.spectrum.permutations import LENGTH, autocorrelation

#: Displacement across the flow at which the diagram is compared, in beams.
ASIDE = 0.4


def transverse_speed(planes, grid, equations, speed, *, region=None):
    """
    Return the speed of a stream across the grid, and its error.

    The diagram is compared at displacements h and -h across the flow.  Along the ray of
    the stream its expectation is ``A R(h - u tau)``, so the difference of both is to
    first order proportional to the transverse speed u and the interval,

    .. math:: D(h) - D(-h) = 2 A \\frac{h}{s^2} R(h)\\, u \\tau ,

    for a Gaussian R with the standard deviation s.

    Parameters
    ----------
    planes : `~astro_scc.spectrum.planes.FlowPlanes`
    grid : `~astro_scc.grid.lines.FlowGrid`
    equations : `~astro_scc.spectrum.equations.Equations`
    speed : float
        Along the grid, in beams/yr.
    region : `~numpy.ndarray`, optional

    Returns
    -------
    speed, error : float
        In beams/yr, the error from the deletion of epochs; NaN if the flow is too
        narrow.
    """
    lag = max(1, round(ASIDE / planes.step))
    if planes.values.shape[3] <= 2 * lag:
        return 0.0, np.nan
    on = correlate(planes, region=region)
    one, other = (correlate(planes, region=region, across=k) for k in (lag, -lag))
    half = on.zero
    sums = []
    for this, that in ((one, other), (other, one)):
        # Negative displacements are those of the opposite side, seen from the other.
        back = that.sums[:, :, :half:-1].transpose(1, 0, 2)
        sums.append(np.concatenate([back, this.sums[:, :, half:]], axis=2))
    years, x, h = on.years, on.displacement, lag * planes.step
    tau = years - years[:, None]
    epochs = np.arange(len(years))
    top = on.sums[epochs, epochs, half].mean()
    aside = (sums[0] + sums[1])[epochs, epochs, half].mean() / 2
    if not 0 < aside < top:
        return 0.0, np.nan
    variance = h**2 / (2 * np.log(top / aside))
    moved = (speed * tau)[..., None]
    own = autocorrelation(on)
    ray = np.interp(x - moved, x, own, left=0, right=0) * np.exp(-np.abs(moved) / LENGTH)
    ray *= on.overlap
    odd = (ray * (sums[0] - sums[1])).sum(axis=2) * tau
    even = (ray * (on.sums - on.sums.mean(axis=(0, 1)))).sum(axis=2) * tau**2
    np.fill_diagonal(even, 0.0)
    gain = 2 * h / variance * aside / top

    def estimate(keep):
        total = even[np.ix_(keep, keep)].sum()
        if not total > 0:
            return np.nan
        return odd[np.ix_(keep, keep)].sum() / (gain * total)

    found = estimate(epochs)
    if not np.isfinite(found):
        return 0.0, np.nan
    parts = np.array([estimate(np.delete(epochs, k)) for k in epochs])
    parts = parts[np.isfinite(parts)]
    n = len(parts)
    error = np.sqrt((n - 1) / max(n, 1) * ((parts - parts.mean()) ** 2).sum())
    return float(found), float(np.hypot(error, 0.05 * abs(speed)))
