# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Which SSPs make which component."""

import astropy.units as u
import numpy as np

from astro_scc.visualization.drawing import (
    columns_of,
    draw_beam,
    draw_image,
    image_limits,
    label_panels,
    longest,
    panels_size,
    plotting_norm,
)
from astro_scc.visualization.patterns import ssp_points
from astro_scc.visualization.style import (
    BLUE,
    PM_UNIT,
    VERMILLION,
    component_kinds,
    new_figure,
    offset_unit,
    outline,
    speed_unit,
    unit_name,
)

__all__ = ["plot_members"]


def plot_members(
    result,
    *,
    figure=None,
    components=None,
    max_panels=4,
    unit=None,
):
    """
    Draw the displacements that make each component on the mean image.

    A panel a component: each arrow goes from an SSP to where its match is in
    the next epoch in which its feature is seen.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    figure : `matplotlib.figure.Figure`, optional
        Drawn on this one instead of a new figure.
    components : `~astropy.table.QTable`, optional
        By default ``result.components``.
    max_panels : int, optional
        Of more components than these, those that count as found come
        first, then the others, each in the order of the table.
    unit : `~astropy.units.Unit`, optional
        Of the offsets.

    Returns
    -------
    `matplotlib.figure.Figure`
        With the mean image alone if there is no component.

    Raises
    ------
    ValueError
        If ``max_panels`` is below 1, or the unit no angle.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.visualization import plot_members
    >>> scc = StackedCrossCorrelation(scales=[1, 2], max_speed=36 * u.mas / u.yr)
    >>> result = scc(simulate_two_fluid(n_epochs=5, rng=1).cube, n_trials=50, rng=1)
    >>> figure = plot_members(result)
    """
    if max_panels < 1:
        raise ValueError(f"max_panels must be at least 1, got {max_panels}")
    components = result.components if components is None else components
    kinds = component_kinds(components)
    order = sorted(range(len(kinds)), key=lambda k: kinds[k] == "not significant")
    panels = [(int(components["component"][k]), kinds[k]) for k in order[:max_panels]]
    cube = result.cube
    points = ssp_points(cube, result.ssps)
    limits = image_limits(cube, points)
    unit = offset_unit(longest(limits), unit)
    mean = cube.mean_image()
    image = np.ma.masked_array(mean.data, mean.mask)
    norm = plotting_norm(cube, image)

    columns = columns_of(max(len(panels), 1), limits, figure)
    rows = -(-max(len(panels), 1) // columns)
    if figure is None:
        figure = new_figure(panels_size(rows, columns, limits, aside=0.6))
    axes = figure.subplots(
        rows, columns, sharex=True, sharey=True, squeeze=False
    ).ravel()
    for ax in axes:
        # Pale, so that the arrows stand out.
        draw_image(ax, cube, image, norm, unit, limits).set_alpha(0.5)
        if cube.beams is not None and all(b == cube.beams[0] for b in cube.beams):
            draw_beam(ax, cube.beams[0], unit, limits)
    for ax, (number, kind) in zip(axes, panels, strict=False):
        _draw_members(ax, result, number, kind, points, unit)
    for ax in axes[len(panels) :]:
        ax.set_axis_off() if panels else ax.set_title("no component")
    label_panels(figure, cube, unit)
    return figure


def _draw_members(ax, result, number, kind, points, unit):
    member, d = result.members(number), result.displacements
    n_ssp = len(np.unique(d.ssp[member]))
    member = member[d.target[member] > d.reference[member]]
    member = member[np.argsort(d.target[member], kind="stable")]
    owner, first = np.unique(d.ssp[member], return_index=True)
    member = member[first]
    east, north = points["east"][owner], points["north"][owner]
    axes = np.broadcast_to(result.frame.matrix(east, north), (len(owner), 2, 2))
    # Orthogonal, so its transpose leads back to the sky.
    motion = np.einsum(
        "nai,na->ni", axes, np.stack([d.d1[member], d.d2[member]], axis=-1)
    )
    factor = u.mas.to(unit)
    color = VERMILLION if kind != "not significant" else BLUE
    ax.quiver(
        east * factor,
        north * factor,
        motion[:, 0] * factor,
        motion[:, 1] * factor,
        angles="xy",
        scale_units="xy",
        scale=1,
        color=color,
        width=0.0035,
        headwidth=4,
        headlength=5,
        minlength=0.5,
        alpha=0.75,
    )
    speed = result.components["pm"][number - 1]
    speed = speed.to(speed_unit(speed.to_value(PM_UNIT)))
    ax.text(
        0.02,
        0.95,
        f"{number}: {speed.value:.3g} {unit_name(speed.unit)}, {n_ssp} SSPs"
        + (", not significant" if kind == "not significant" else ""),
        transform=ax.transAxes,
        va="top",
        fontsize="small",
        path_effects=outline(),
    )
