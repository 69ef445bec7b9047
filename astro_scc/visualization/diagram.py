# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The displacement-interval diagram, with the rays of the streams."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from astro_scc.epochs.positions import axis_words
from astro_scc.quantities import with_error
from astro_scc.units import PM_UNIT, offset_unit, speed_unit, time_unit, unit_name
from astro_scc.visualization import style
from astro_scc.visualization.style import BLACK, KINDS
from astro_scc.visualization.velocity import on_sky

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from astro_scc.measurement import SCCResult

#: Intervals are shown up to this many times the one after which the slowest
#: moving stream leaves the diagram, and at least this number of intervals.
BEYOND = 1.3
FEWEST_INTERVALS = 4
#: Fraction of the diagram that is within the range of the colours.
UNSATURATED = 0.995
#: Size in inches, at which letters can be read in one column of a journal.
SIZE = (6.0, 4.2)


def plot_diagram(
    result: SCCResult, *, ax: Axes | None = None, components: QTable | None = None,
    unit: u.UnitBase | str | None = None, colorbar: bool = True,
) -> Figure:  # fmt: skip
    """
    Draw the displacement-interval diagram with the rays of the streams.

    In red areas, more patterns match than in permuted epochs.  What moves at a
    constant speed lies on a ray from the origin; what stands still lies at zero
    displacement.  Thin lines on both sides of a ray are one dispersion of the
    speeds away.  Intervals are shown until the slowest moving stream leaves the
    diagram.  A second axis shows the displacement in beams.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    ax : `matplotlib.axes.Axes`, optional
        Axes to draw on instead of a new figure.
    components : `~astropy.table.QTable`, optional
        The components whose rays are drawn, by default ``result.components``.
    unit : `~astropy.units.Unit`, optional
        Unit of the displacement, by default one that is easy to read.
    colorbar : bool, optional

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the unit is not an angle.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.visualization import plot_diagram
    >>> scc = StackedCrossCorrelation(scales=[1, 2], max_speed=36 * u.mas / u.yr)
    >>> result = scc(simulate_two_fluid(n_epochs=5, rng=1).cube, n_trials=50, rng=1)
    >>> figure = plot_diagram(result)
    >>> figure.axes[0].get_xlabel()
    'Interval between epochs (yr)'
    """
    image = result.diagram()
    components = result.components if components is None else components
    kinds = style.component_kinds(components)
    numbers = np.asarray(components["component"], dtype=int)
    velocities = [result.velocities[number - 1] for number in numbers]
    # The speed of a stationary component is zero within its errors.
    slopes = [
        0.0 if kind == "stationary" else float(image.meta["direction"] @ velocity.value)
        for kind, velocity in zip(kinds, velocities, strict=True)
    ]
    _, displacement = image.wcs.pixel_to_world_values(0, np.arange(len(image.data)))
    unit = offset_unit(displacement[-1], unit)
    seen = image.meta["n_pairs"] > 0
    years, excess = image.meta["interval"].to_value(u.yr)[seen], image.data[:, seen]
    longest = longest_interval(years, slopes, kinds, displacement[-1])
    time = time_unit(longest)
    highest = np.quantile(np.abs(excess[:, years <= longest]), UNSATURATED) or 1.0
    figure, ax = style.figure_and_axes(ax, SIZE)
    drawn = ax.pcolormesh(
        (edges(years) * u.yr).to_value(time),
        (edges(displacement) * u.mas).to_value(unit), excess, cmap="RdBu_r",
        vmin=-highest, vmax=highest, rasterized=True, gid="excess",
    )  # fmt: skip
    ax.axhline(0, color=style.GREY, linewidth=0.6)
    ax.set_xlim(0, (longest * u.yr).to_value(time))
    top = (displacement[-1] * u.mas).to_value(unit)
    ax.set_ylim(-top, top)
    factor = PM_UNIT.to(unit / time)
    for number, kind, slope, velocity, text in zip(
        numbers, kinds, slopes, velocities, _texts(components, kinds), strict=True
    ):
        spread = 0.0 if kind == "stationary" else np.nan_to_num(velocity.dispersion)
        _draw_ray(ax, slope * factor, spread * factor, KINDS[kind].line, number, text)
    if kinds:
        corner = "lower right" if slopes[0] >= 0 else "upper right"
        ax.legend(loc=corner, fontsize="small", framealpha=0.85)
    ax.set_xlabel(f"Interval between epochs ({unit_name(time)})")
    ax.set_ylabel(f"{_direction(result, image)} ({unit_name(unit)})")
    beam = image.meta["beam"].to_value(unit)
    beams = ax.secondary_yaxis(
        "right", functions=(lambda v: v / beam, lambda v: v * beam)
    )
    beams.set_ylabel("Displacement (beams)")
    if colorbar:
        above = ax.inset_axes((0.0, 1.03, 1.0, 0.035))
        figure.colorbar(
            drawn, cax=above, orientation="horizontal", ticklocation="top",
            extend="both", label="Matches per pair of epochs, beyond chance",
        )  # fmt: skip
    return figure


def _texts(components, kinds):
    """Return the number and the speed, or kind, of each component."""
    unit = speed_unit(components["pm"].to_value(PM_UNIT).max(initial=0.0))
    texts = []
    for row, kind in zip(components, kinds, strict=True):
        value, error = row["pm"].to_value(unit), row["pm_err"].to_value(unit)
        text = with_error(value, error if math.isfinite(error) else 0.0)
        text = f"{text} {unit_name(unit)}"
        text = {"moving": text, "stationary": kind}.get(kind, f"{text},\n{kind}")
        texts.append(f"{int(row['component'])}: {text}")
    return texts


def longest_interval(years, slopes, kinds, reach):
    """Return the longest interval that is shown, in years."""
    last = edges(years)[-1]
    for shown in ("moving", "not significant"):
        own = [abs(v) for v, kind in zip(slopes, kinds, strict=True) if kind == shown]
        if any(own):
            longest = BEYOND * reach / min(v for v in own if v > 0)
            # A fast stream alone would leave a single column.
            return min(max(longest, edges(years)[: FEWEST_INTERVALS + 1][-1]), last)
    return last


def edges(middle):
    """Return the edges of cells, halfway between their middles."""
    if len(middle) == 1:
        return middle[0] * np.array([0.9, 1.1])
    half = np.diff(middle) / 2
    first, last = middle[0] - half[0], middle[-1] + half[-1]
    return np.concatenate([[first], middle[:-1] + half, [last]])


def diagram_levels(years, excess, longest, n):
    """
    Return a diagram as levels from -127 to 127 at n equal intervals up to the longest.

    The shortest intervals, which no two epochs have, are zero.
    """
    column = np.searchsorted(edges(years), (np.arange(n) + 0.5) / n * longest) - 1
    highest = np.quantile(np.abs(excess[:, years <= longest]), UNSATURATED) or 1.0
    level = np.round(127 * np.clip(excess / highest, -1, 1)).astype(np.int8)
    level = level[:, column.clip(0, len(years) - 1)]
    return np.where(column < 0, np.int8(0), level)


def _draw_ray(ax, slope, spread, line, number, text):
    (_, right), (_, top) = ax.get_xlim(), ax.get_ylim()
    ax.axline(
        (0, 0), slope=slope, linestyle=line, color=BLACK, linewidth=1.4,
        path_effects=style.outline(2.6), label=text, gid="ray",
    )  # fmt: skip
    if spread > 0:
        for other in (slope - spread, slope + spread):
            ax.axline(
                (0, 0), slope=other, color=BLACK, linewidth=0.6, alpha=0.7,
                gid="dispersion",
            )  # fmt: skip
    # The number lies on the ray, before it leaves the axes.
    x = 0.88 * min(right, top / abs(slope) if slope else right)
    ax.text(
        x, slope * x, number, ha="center", va="center", fontsize="small",
        bbox={"boxstyle": "circle,pad=0.2", "facecolor": "white", "linewidth": 0.6},
        gid="number",
    )  # fmt: skip


def _direction(result, image):
    """Return the label of the displacement, with its direction."""
    if not on_sky(result):
        jet = result.frame.axis_names[0] == "parallel"
        return f"Displacement {'along the jet' if jet else 'outward'}"
    angle = image.meta["position_angle"].to_value(u.deg)
    axis, _, to_the_left = axis_words(result.cube)
    if to_the_left:
        return f"Displacement towards PA {angle:.0f}°"
    return f"Displacement {angle:.0f}° from north to {axis}"
