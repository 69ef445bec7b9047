# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Draw the displacement-interval diagram with the rays of the streams."""

import astropy.units as u
import numpy as np

from astro_scc.images.positions import axis_words, sky_columns
from astro_scc.units import PM_UNIT, offset_unit, unit_name
from astro_scc.visualization import style
from astro_scc.visualization.drawing import edges
from astro_scc.visualization.style import BLACK, GREY, KINDS
from astro_scc.visualization.velocity import on_sky, speed_text

#: Intervals are shown up to this many times the one after which the slowest
#: moving stream leaves the diagram, and at least this number of intervals.
BEYOND = 1.3
FEWEST_INTERVALS = 4
#: Fraction of the diagram that is within the range of the colours.
UNSATURATED = 0.995


def plot_diagram(result, *, ax=None, components=None, unit=None, colorbar=True):
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
    """
    image = result.diagram()
    components, kinds = style.marked(result, components)
    slopes = ray_slopes(components, kinds, image.meta["position_angle"])
    _, displacement = image.wcs.pixel_to_world_values(0, np.arange(len(image.data)))
    unit = offset_unit(displacement[-1], unit)
    seen = image.meta["n_pairs"] > 0
    years, excess = image.meta["interval"].to_value(u.yr)[seen], image.data[:, seen]
    longest = longest_interval(years, slopes, kinds, displacement[-1])
    speed_in = result.cube.speed_unit
    time = speed_in.bases[1]
    highest = highest_excess(years, excess, longest)
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, 4.2))
    drawn = ax.pcolormesh(
        u.yr.to(time, edges(years)),
        u.mas.to(unit, edges(displacement)), excess, cmap="RdBu_r",
        vmin=-highest, vmax=highest, rasterized=True, gid="excess",
    )  # fmt: skip
    ax.axhline(0, color=GREY, linewidth=0.6)
    top = u.mas.to(unit, displacement[-1])
    ax.set(xlim=(0, u.yr.to(time, longest)), ylim=(-top, top))
    factor = PM_UNIT.to(unit / time)
    for row, kind, slope in zip(components, kinds, slopes, strict=True):
        label = f"{row['component']}: {speed_text(row, kind)}"
        spread = np.nan_to_num(row["dispersion"].to_value(PM_UNIT))
        spread = 0.0 if kind == "stationary" else spread
        _draw_ray(ax, slope * factor, spread * factor, kind, label)
    if kinds:
        corner = "lower right" if slopes[0] >= 0 else "upper right"
        ax.legend(loc=corner, fontsize="small", framealpha=0.85)
    ax.set_xlabel(f"Interval between epochs ({unit_name(time)})")
    ax.set_ylabel(f"{_direction(result, image)} ({unit_name(unit)})")
    beam = image.meta["beam"].to_value(unit)
    in_beams = (lambda v: v / beam, lambda v: v * beam)
    ax.secondary_yaxis("right", functions=in_beams).set_ylabel("Displacement (beams)")
    if colorbar:
        above = ax.inset_axes((0.0, 1.03, 1.0, 0.035))
        figure.colorbar(
            drawn, cax=above, orientation="horizontal", ticklocation="top",
            extend="both", label="Matches per pattern and beam, beyond chance",
        )  # fmt: skip
    return figure


def _draw_ray(ax, slope, spread, kind, label):
    (_, right), (_, top) = ax.get_xlim(), ax.get_ylim()
    ray = {"linestyle": KINDS[kind].line, "label": label, "gid": "ray"}
    outlined = {"linewidth": 1.4, "path_effects": style.outline(2.6)}
    ax.axline((0, 0), slope=slope, color=BLACK, **ray, **outlined)
    thin = {"linewidth": 0.6, "alpha": 0.7, "gid": "dispersion"}
    for other in (slope - spread, slope + spread) if spread > 0 else ():
        ax.axline((0, 0), slope=other, color=BLACK, **thin)
    # The number lies on the ray, before it leaves the axes.
    x = 0.88 * min(right, top / abs(slope) if slope else right)
    ax.text(
        x, slope * x, label.partition(":")[0], ha="center", va="center",
        fontsize="small", gid="number",
        bbox={"boxstyle": "circle,pad=0.2", "facecolor": "white", "linewidth": 0.6},
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


def ray_slopes(components, kinds, angle):
    """
    Return the slopes of the components' rays in the diagram.

    Parameters
    ----------
    components : `~astropy.table.QTable`
    kinds : sequence of str
    angle : `~astropy.units.Quantity`, float or None
        Position angle of the displacement, in degrees; None if it is along the jet.

    Returns
    -------
    `~numpy.ndarray`
        In mas/yr.  That of a stationary component is zero, as is its speed within its
        errors.
    """
    slopes = components["pm_parallel"].to_value(PM_UNIT)
    if angle is not None:
        sky = (components[name].to_value(PM_UNIT) for name in sky_columns(components))
        angle = u.Quantity(angle, u.deg).to_value(u.rad)
        slopes = np.array([np.sin(angle), np.cos(angle)]) @ [*sky]
    return np.where(np.array(kinds) == "stationary", 0.0, slopes)


def longest_interval(years, slopes, kinds, reach):
    """Return the longest interval that is shown, in years."""
    last = edges(years)[-1]
    for shown in ("moving", "not confirmed", "not significant"):
        own = [abs(v) for v, kind in zip(slopes, kinds, strict=True) if kind == shown]
        if any(own):
            longest = BEYOND * reach / min(v for v in own if v > 0)
            # A fast stream alone would leave a single column.
            return min(max(longest, edges(years)[: FEWEST_INTERVALS + 1][-1]), last)
    return last


def highest_excess(years, excess, longest):
    """Return the end of the range of the colours."""
    return np.quantile(np.abs(excess[:, years <= longest]), UNSATURATED) or 1.0


def diagram_levels(years, excess, longest, n):
    """
    Return a diagram as levels from -127 to 127 at n equal intervals up to the longest.

    The shortest intervals, which no two epochs have, are zero.
    """
    column = np.searchsorted(edges(years), (np.arange(n) + 0.5) / n * longest) - 1
    level = np.clip(excess / highest_excess(years, excess, longest), -1, 1)[:, column]
    return np.where(column < 0, 0, np.round(127 * level)).astype(np.int8)
