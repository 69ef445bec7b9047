# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The simulated jets of the paper's tests, and those that must give no velocity."""

from astro_scc.simulation.jets import JetSimulation
from astro_scc.simulation.streams import Stream

__all__ = [
    "simulate_ballistic",
    "simulate_random_velocity",
    "simulate_static",
    "simulate_two_fluid",
    "simulate_unrelated",
]


def simulate_two_fluid(
    *, slow=5.0, fast=20.0, densities=None, dense=False, jitter=2.0, rng=None, **options
):
    """
    A slow sheath around a fast spine, the paper's two-fluid jet.

    Parameters
    ----------
    slow, fast : float or `~astropy.units.Quantity`, optional
        Speeds of the two streams, in pixels per interval or as proper
        motions.
    densities : (float, float), optional
        Features per beam length of the slow and of the fast stream, (1.0,
        0.8) by default, (1.0, 1.2) in a dense jet.
    dense : bool, optional
        A wider sheath (25 instead of 15 pixels on each side of the axis)
        and a spine with more and brighter features.
    jitter : float, optional
        Random walk per epoch and axis, in pixels.
    rng : `numpy.random.Generator`, seed or None, optional
        Passed to `numpy.random.default_rng`.
    **options
        Further parameters of `JetSimulation`: epochs, dates, noise, beams...

    Returns
    -------
    `SimulatedJet`

    Examples
    --------
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> jet = simulate_two_fluid(rng=1)
    >>> jet.cube.shape
    (10, 128, 256)
    """
    slow_density, fast_density = densities or ((1.0, 1.2) if dense else (1.0, 0.8))
    streams = (
        Stream(
            "slow",
            dx=slow,
            density=slow_density,
            half_width=25.0 if dense else 15.0,
            jitter=jitter,
        ),
        Stream(
            "fast",
            dx=fast,
            density=fast_density,
            sigma=4.0,
            peak=(0.8, 1.5) if dense else (0.3, 1.5),
            jitter=jitter,
        ),
    )
    return _run("two-fluid", streams, rng, options)


def simulate_random_velocity(
    *, dx=(0.0, 40.0), dy=(-5.0, 5.0), density=1.8, rng=None, **options
):
    """
    Features that take a new random velocity at every epoch.

    The paper's second test: nothing moves at a common speed.

    Parameters
    ----------
    dx, dy : (float, float), optional
        Limits of the uniform distributions of the motion along and across
        the jet, in pixels per interval.
    density : float, optional
        Features per beam length.
    rng : `numpy.random.Generator`, seed or None, optional
        Passed to `numpy.random.default_rng`.
    **options
        Further parameters of `JetSimulation`: epochs, dates, noise, beams...

    Returns
    -------
    `SimulatedJet`

    Examples
    --------
    >>> from astro_scc.simulation import simulate_random_velocity
    >>> simulate_random_velocity(n_epochs=3, rng=1).cube.shape
    (3, 128, 256)
    """
    stream = Stream(
        "random", dx=dx, dy=dy, motion="random", density=density, half_width=12.0
    )
    return _run("random velocity", (stream,), rng, options)


def simulate_ballistic(
    *, dx=(0.0, 40.0), dy=(-5.0, 5.0), density=1.8, jitter=0.0, rng=None, **options
):
    """
    Features that each keep a random velocity of their own.

    All of them move, none of the velocities is common.

    Parameters
    ----------
    dx, dy : (float, float), optional
        Limits of the uniform distributions of the motion along and across
        the jet, in pixels per interval.
    density : float, optional
        Features per beam length.
    jitter : float, optional
        Random walk per epoch and axis, in pixels.
    rng : `numpy.random.Generator`, seed or None, optional
        Passed to `numpy.random.default_rng`.
    **options
        Further parameters of `JetSimulation`: epochs, dates, noise, beams...

    Returns
    -------
    `SimulatedJet`

    Examples
    --------
    >>> from astro_scc.simulation import simulate_ballistic
    >>> simulate_ballistic(n_epochs=3, rng=1).cube.shape
    (3, 128, 256)
    """
    stream = Stream(
        "ballistic", dx=dx, dy=dy, density=density, half_width=12.0, jitter=jitter
    )
    return _run("ballistic", (stream,), rng, options)


def simulate_static(*, density=1.8, rng=None, **options):
    """
    Features that stand still, under noise that differs at every epoch.

    Parameters
    ----------
    density : float, optional
        Features per beam length.
    rng : `numpy.random.Generator`, seed or None, optional
        Passed to `numpy.random.default_rng`.
    **options
        Further parameters of `JetSimulation`: epochs, dates, noise, beams...

    Returns
    -------
    `SimulatedJet`

    Examples
    --------
    >>> from astro_scc.simulation import simulate_static
    >>> simulate_static(n_epochs=3, rng=1).cube.shape
    (3, 128, 256)
    """
    stream = Stream("static", density=density, half_width=12.0)
    return _run("static", (stream,), rng, options)


def simulate_unrelated(*, density=1.8, rng=None, **options):
    """
    Epochs that have nothing to do with one another.

    Every epoch has features of its own, drawn from the same distributions.

    Parameters
    ----------
    density : float, optional
        Features per beam length.
    rng : `numpy.random.Generator`, seed or None, optional
        Passed to `numpy.random.default_rng`.
    **options
        Further parameters of `JetSimulation`: epochs, dates, noise, beams...

    Returns
    -------
    `SimulatedJet`

    Examples
    --------
    >>> from astro_scc.simulation import simulate_unrelated
    >>> simulate_unrelated(n_epochs=3, rng=1).cube.shape
    (3, 128, 256)
    """
    stream = Stream("unrelated", motion="unrelated", density=density, half_width=12.0)
    return _run("unrelated", (stream,), rng, options)


def _run(name, streams, rng, options):
    return JetSimulation(**{"name": name, **options, "streams": streams}).run(rng=rng)
