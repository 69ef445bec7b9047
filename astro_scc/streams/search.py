# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Records of a search for streams: its settings, a stream, and all that was found."""

from dataclasses import dataclass, field

import numpy as np

from astro_scc.intervals import median_interval
from astro_scc.spectrum.diagram import Diagram
from astro_scc.spectrum.equations import RATIO
from astro_scc.spectrum.errors import SpeedErrors
from astro_scc.spectrum.gaussians import StreamFit
from astro_scc.spectrum.maps import VelocityMap
from astro_scc.spectrum.permutations import EVERY, INWARD, MotionTest
from astro_scc.streams.decomposed import DecomposedFlow

#: A pair of numbers that are not known.
UNKNOWN = (np.nan, np.nan)


@dataclass(frozen=True, eq=False)
class MeasuredStream:
    """
    A stream: a velocity of the flow.

    Attributes
    ----------
    kind : {"moving", "not confirmed", "stationary", "not significant"}
    reason : str
        Why it is not moving, or what it rests on, or ''.
    velocity : `~numpy.ndarray`, shape (2,)
        On the axes of the frame, in mas/yr.
    covariance, alignment : `~numpy.ndarray`, shape (2, 2)
        Of the velocity; the second is the part by errors of the alignment.
    source : {"features", "spectrum", ""}
        What the speed is measured from.
    share : float
        Share of the variance that moves.
    dispersion, dispersion_err : float
        In mas/yr.
    p_local, p_global, p_distinct : float
    spectrum, features : (float, float)
        Speed with its error from the velocity spectrum, and from the features.
    members : `~numpy.ndarray` of int
        Its features.
    slowest, fastest : float
        Speeds of its slowest and fastest feature.
    angle : float
        Direction from the first axis of the frame, in radians.
    counter : bool
        Whether it is a stream of the counter-jet.
    """

    kind: str
    reason: str
    velocity: np.ndarray
    covariance: np.ndarray
    alignment: np.ndarray
    source: str = ""
    share: float = np.nan
    dispersion: float = np.nan
    dispersion_err: float = np.nan
    p_local: float = np.nan
    p_global: float = np.nan
    p_distinct: float = np.nan
    spectrum: tuple[float, float] = UNKNOWN
    features: tuple[float, float] = UNKNOWN
    members: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    slowest: float = np.nan
    fastest: float = np.nan
    angle: float = 0.0
    counter: bool = False


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """
    What a search for streams needs to know beside the flow.

    Attributes
    ----------
    n_trials : int
    misaligned : `~numpy.ndarray`, shape (n_epochs, 2), optional
        Standard error of the alignment of each epoch, in mas.
    alpha : float
        Largest ``p_global`` of a stream that moves.
    outward : bool
        Search only speeds away from the core.
    intervals : (float, float)
        Shortest and longest interval that is used, in years.
    whole : bool
        Whether a single stream has the error of few patterns, and the harmonic mean of
        the spectrum where its Gaussian is not well known; parts of a flow have the
        speeds of Gaussians, whose covariance is known, unless their errors are larger.
    """

    n_trials: int
    misaligned: np.ndarray | None = None
    alpha: float = 0.01
    outward: bool = False
    intervals: tuple[float, float] = EVERY
    whole: bool = True

    def inward(self, flow: DecomposedFlow) -> float:
        """Return the weight of speeds towards the core in the test of a flow."""
        if self.outward and flow.directed:
            return 0.0
        return INWARD if flow.directed and flow.outward else 1.0


@dataclass(frozen=True, eq=False, repr=False)
class StreamSearch:
    """
    The streams of a flow, with the spectrum and the test that they follow from.

    Attributes
    ----------
    flow : ``DecomposedFlow``
        Along one direction.
    test : ``MotionTest``
        Along this direction; its ``p_global`` is that of all that were tested.
    diagram : ``Diagram``
        Along this direction.
    speed, spectrum : `~numpy.ndarray`, shape (n_v,)
        Velocity spectrum: speeds in mas/yr, and the share of the variance that moves
        with each.
    intervals : (float, float)
        Shortest and longest interval that is used, in years.
    fit : ``StreamFit`` or None
    errors : ``SpeedErrors`` or None
    velocities : ``VelocityMap``
        In mas/yr on the axes of the frame.
    streams : tuple of `MeasuredStream`
        The slowest that moves first; then what stands still.
    """

    flow: DecomposedFlow
    test: MotionTest
    diagram: Diagram
    speed: np.ndarray
    spectrum: np.ndarray
    intervals: tuple[float, float]
    fit: StreamFit | None = None
    errors: SpeedErrors | None = None
    velocities: VelocityMap | None = None
    streams: tuple[MeasuredStream, ...] = ()

    @property
    def beam(self) -> float:
        """The unit of length, in mas."""
        return self.flow.beam

    @property
    def angle(self) -> float:
        """Direction of the spectrum from the first axis of the frame, in radians."""
        return self.flow.angle

    @property
    def pair(self) -> list[tuple[float, float]] | None:
        """Mean and dispersion of both of two streams, in beams/yr, or None."""
        if self.fit is None or len(self.fit.mean) < 2:
            return None
        return list(zip(self.fit.mean, self.fit.sd, strict=True))

    @property
    def sign(self) -> float:
        """Sign of the speed at which motion is clearest."""
        return float(np.sign(self.test.speed[self.test.best[1]]))

    @property
    def slowest(self) -> float:
        """The slowest speed that was searched, in mas/yr."""
        return self.beam * np.abs(self.test.speed).min()

    @property
    def fastest(self) -> float:
        """The fastest speed that was searched, in mas/yr."""
        return self.beam * np.abs(self.test.speed).max()

    def tested(self, speed: float) -> bool:
        """Return whether the test searched a speed in mas/yr, or its neighbour."""
        return bool(self.slowest / RATIO <= abs(speed) <= self.fastest * RATIO)

    @property
    def unambiguous(self) -> float:
        """The largest speed that the dates do not alias, in mas/yr."""
        return self.beam / median_interval(self.flow.years)
