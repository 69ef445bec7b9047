# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What the dates of a series allow to be measured."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.time import Time

from astro_scc.epochs.positions import readable_angle
from astro_scc.epochs.validation import as_beams

# Displacements that can be distinguished from zero, as the paper has it (Sect. 2.2),
# and those between which pairs of epochs work best, in beams.
SMALLEST_SHIFT = 0.2
GOOD_SHIFTS = (0.3, 1.5)
# Resolution of images without a beam, in pixels.
PIXELS_RESOLVED = 3.0


@dataclass(frozen=True)
class IntervalPlan:
    """
    What the dates of a series allow to be measured.

    With b the resolution (geometric mean of the beam's axes, median over
    the epochs), T the span of the series, dt the median interval between
    consecutive epochs and L the shorter side of the images:

    - ``slowest = 0.2 b / T``: what moves less than a fifth of a beam from
      the first to the last epoch cannot be told from what stands still.
    - ``fastest = L / (2 dt)``: what crosses half of the image between
      consecutive epochs is in one of them only.
    - ``consecutive = (0.3, 1.5) b / dt``: speeds for which consecutive
      epochs are the best pairs; slower features hardly move between them,
      faster ones change before they can be recognised.

    Attributes
    ----------
    n_epochs : int
    span : `~astropy.units.Quantity`
    shortest, median, longest : `~astropy.units.Quantity`
        Intervals between consecutive epochs of different date.
    resolution : `~astropy.units.Quantity`
    slowest, fastest : `~astropy.units.Quantity`
        ``fastest`` is None where the size of the images is not known.
    consecutive : `~astropy.units.Quantity`, shape (2,)
    """

    n_epochs: int
    span: u.Quantity
    shortest: u.Quantity
    median: u.Quantity
    longest: u.Quantity
    resolution: u.Quantity
    slowest: u.Quantity
    fastest: u.Quantity | None
    consecutive: u.Quantity

    def baseline(self, speed):
        """
        Return the shortest and longest interval between epochs that suit a speed.

        ``(0.3, 1.5) b / speed``, so that pairs of epochs are between a third
        of a beam and one and a half beams of motion apart, and no longer than the
        series.  A ValueError if the speed is not positive, or too slow for the series.
        """
        speed = u.Quantity(speed).to(self.slowest.unit)
        if not speed > 0:
            raise ValueError(f"speed must be positive, got {speed}")
        wanted = (np.array(GOOD_SHIFTS) * self.resolution / speed).to(self.span.unit)
        # Rounding must not refuse the slowest speed that the plan names.
        if wanted[0] > self.span * (1 + 1e-9):
            raise ValueError(
                f"at {speed:.3g} nothing moves {GOOD_SHIFTS[0]} of a beam in the "
                f"{self.span:.3g} of the series"
            )
        return np.minimum(wanted, self.span)

    def motion(self, speed):
        """
        Return how far a feature moves at the median interval, in beams.

        0.3 to 1.5 are good, see `baseline` for other pairs.
        """
        return (u.Quantity(speed) * self.median / self.resolution).to_value(u.one)

    def lines(self):
        """Return the plan as sentences."""
        low, high = self.consecutive
        leaves = ""
        if self.fastest is not None:
            leaves = f"; faster than {self.fastest:.3g} leaves the image"
        lines = [
            f"{self.n_epochs} epochs over {self.span:.3g}, "
            f"{self.shortest.value:.3g} to {self.longest:.3g} apart, "
            f"median {self.median:.3g}; resolution {readable_angle(self.resolution)}.",
            f"Slower than {self.slowest:.2g} cannot be distinguished from standing "
            f"still{leaves}.",
            f"Consecutive epochs suit speeds of {low.value:.2g} to {high:.2g}.",
        ]
        if self.n_epochs > 2:
            lines.append(
                "Slower features show in pairs of epochs that are further apart, which "
                "are used for them."
            )
        return lines

    def __str__(self):
        return "\n".join(self.lines())


def plan_intervals(cube, beam=None, *, extent=None):
    """
    Return what the dates of a series allow to be measured.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube` or `~astropy.time.Time`
        At least two epochs of different date.
    beam : beam, sequence of beams or `~astropy.units.Quantity`, optional
        Or the resolution itself.  By default the beams of the cube, or
        three pixels where it has none.
    extent : `~astropy.units.Quantity`, optional
        Shorter side of the images, by default that of the cube.

    Returns
    -------
    `IntervalPlan`

    Raises
    ------
    ValueError
        If there are fewer than two dates, or dates come without a beam.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.time import Time
    >>> from astro_scc.epochs import Beam, plan_intervals
    >>> times = Time(["2000-01-01", "2000-07-01", "2001-01-01", "2002-01-01"])
    >>> plan = plan_intervals(times, Beam(1 * u.mas, 0.5 * u.mas))
    >>> plan.slowest.round(3), plan.consecutive.round(2)
    (<Quantity 0.071 mas / yr>, <Quantity [0.42, 2.11] mas / yr>)
    >>> plan.motion(1 * u.mas / u.yr).round(2)
    np.float64(0.71)
    >>> plan.baseline(1 * u.mas / u.yr).round(2)
    <Quantity [0.21, 1.06] yr>
    """
    times = cube if isinstance(cube, Time) else cube.times
    days = np.unique(np.atleast_1d((times - np.atleast_1d(times)[0]).jd))
    if days.size < 2:
        raise ValueError("velocities need at least two epochs of different date")
    resolution = _resolution(cube, beam)
    if extent is None and not isinstance(cube, Time):
        sides = np.hypot(*cube.pixel_matrix.value) * cube.shape[:0:-1] * u.mas
        extent = sides.min()
    gaps = np.diff(days) * u.day
    median = np.median(gaps)
    span = (days[-1] - days[0]) * u.day
    time = _time_unit(span)
    speed = (u.mas if resolution < 0.1 * u.arcsec else u.arcsec) / time
    return IntervalPlan(
        n_epochs=int(np.size(times)),
        span=span.to(time),
        shortest=gaps.min().to(time),
        median=median.to(time),
        longest=gaps.max().to(time),
        resolution=resolution.to(u.mas),
        slowest=(SMALLEST_SHIFT * resolution / span).to(speed),
        fastest=None if extent is None else (extent / (2 * median)).to(speed),
        consecutive=(np.array(GOOD_SHIFTS) * resolution / median).to(speed),
    )


def _time_unit(span):
    if span > 0.1 * u.yr:
        return u.yr
    return u.day if span > 2 * u.day else u.hour


def _resolution(cube, beam):
    if beam is None and isinstance(cube, Time):
        raise ValueError("dates alone need a beam, or the resolution as an angle")
    if beam is None and cube.beams is None:
        return PIXELS_RESOLVED * cube.pixel_scale
    beam = cube.beams if beam is None else beam
    if isinstance(beam, u.Quantity) and not hasattr(beam, "major"):
        return beam
    beams = as_beams(beam, 1 if hasattr(beam, "major") else len(beam))
    return np.median(u.Quantity([np.sqrt(b.major * b.minor) for b in beams]))
