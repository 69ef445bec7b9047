# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""How an image is drawn in offsets from its reference pixel."""

import astropy.units as u
import numpy as np

from astro_scc.epochs.positions import axis_words
from astro_scc.visualization.style import (
    BLACK,
    HEIGHT,
    WIDTH,
    unit_name,
)

__all__ = []

#: Ground of masked pixels, a colour that the greys of the image do not have.
MASKED = "#BFDFF2"
#: Brightness up to which the asinh stretch is linear, in units of the noise.
LINEAR_NOISE = 3.0
#: Share of the weight of the SSPs beyond each side of a figure that shows them.
EDGE = 0.015


def draw_image(ax, cube, values, norm, unit, limits):
    """Draw an image of the cube's grid in offsets, and set the limits."""
    import matplotlib
    from matplotlib.transforms import Affine2D

    matrix = cube.pixel_matrix.to_value(unit)
    to_offset = np.eye(3)
    to_offset[:2, :2] = matrix
    to_offset[:2, 2] = -matrix @ cube.reference_pixel
    drawn = ax.imshow(
        values,
        origin="lower",
        norm=norm,
        cmap=matplotlib.colormaps["Greys"].with_extremes(bad=MASKED),
        transform=Affine2D(to_offset) + ax.transData,
    )
    (east0, east1), (north0, north1) = (limits * u.mas).to_value(unit)
    _, _, to_the_left = axis_words(cube)
    ax.set_xlim((east1, east0) if to_the_left else (east0, east1))
    ax.set_ylim(north0, north1)
    ax.set_aspect("equal")
    return drawn


def draw_beam(ax, beam, unit, limits):
    """Draw the beam in the lower left corner."""
    from matplotlib.patches import Ellipse

    (_, east1), (north0, _) = (limits * u.mas).to_value(unit)
    half = beam.fwhm_along([90, 0] * u.deg).to_value(unit) / 2
    margin = 0.03 * (limits[:, 1] - limits[:, 0]).min() * u.mas.to(unit)
    ellipse = Ellipse(
        (east1 - half[0] - margin, north0 + half[1] + margin),
        width=beam.minor.to_value(unit),
        height=beam.major.to_value(unit),
        # Counted from the second axis towards the first, north through east.
        angle=-beam.pa.to_value(u.deg),
        facecolor="white",
        edgecolor=BLACK,
        hatch="////",
        linewidth=0.8,
        zorder=4,
        gid="beam",
    )
    return ax.add_patch(ellipse)


def label_offsets(ax, cube, unit):
    """Name the two axes of an image."""
    across, up = offset_labels(cube, unit)
    ax.set_xlabel(across)
    ax.set_ylabel(up)


def offset_labels(cube, unit):
    """What the two axes of an image are called."""
    names = (n if " " in n else f"the {n}" for n in axis_words(cube)[:2])
    return tuple(f"Offset to {name} ({unit_name(unit)})" for name in names)


def label_panels(figure, cube, unit):
    """Name the axes that all panels share."""
    across, up = offset_labels(cube, unit)
    figure.supxlabel(across, fontsize="medium")
    figure.supylabel(up, fontsize="medium")


def panels_size(rows, columns, limits, *, aside, above=0.0):
    """Size of a figure of panels, with room for labels aside and above."""
    width, height = lengths(limits)
    panel = (WIDTH - aside) / columns * height / width
    panel = min(panel, (HEIGHT - 0.7 - above) / rows - 0.06)
    return (
        float(max(columns * panel * width / height + aside, WIDTH / 2)),
        float(max(rows * (panel + 0.06) + 0.7 + above, 2.4)),
    )


def columns_of(n, limits, figure=None):
    """The number of columns whose panels are largest, in a figure or on a page."""
    page = (5.0, 8.0) if figure is None else figure.get_size_inches() - [1.2, 1.0]
    width, height = lengths(limits)
    sizes = [
        min(page[0] / columns, page[1] / -(-n // columns) * width / height)
        for columns in range(1, n + 1)
    ]
    # Equal but for rounding, the grid with fewer empty places.
    return 1 + int(np.argmax(np.round(sizes, 3)))


def image_limits(cube, points=None):
    """
    Range of offsets to show, shape (2, 2) in mas: east, then north.

    All of the image or, for the points of `ssp_points`, where they are, with a
    margin; the outermost are left out, which may be noise at the edges.
    """
    _, ny, nx = cube.shape
    corners = cube.pixel_to_offset(
        np.array([-0.5, nx - 0.5, -0.5, nx - 0.5]),
        np.array([-0.5, -0.5, ny - 0.5, ny - 0.5]),
    )
    whole = np.array([[axis.value.min(), axis.value.max()] for axis in corners])
    if points is None or len(points["east"]) == 0:
        return whole
    near = np.array(
        [_inner_range(points[axis], points["weight"]) for axis in ("east", "north")]
    )
    margin = 12 * cube.pixel_scale.value
    if cube.beams is not None:
        margin = max(margin, 1.5 * max(beam.major.value for beam in cube.beams))
    near += [-margin, margin]
    # A strip of a few pixels across shows nothing: a third of its length at least.
    short = np.maximum(lengths(near).max() / 3 - lengths(near), 0)
    near += short[:, None] * [-0.5, 0.5]
    return np.stack(
        [np.maximum(near[:, 0], whole[:, 0]), np.minimum(near[:, 1], whole[:, 1])],
        axis=1,
    )


def _inner_range(values, weight):
    order = np.argsort(values)
    share = np.cumsum(weight[order])
    share = (share - 0.5 * weight[order]) / share[-1]
    return np.interp([EDGE, 1 - EDGE], share, values[order])


def plotting_norm(
    cube, image, epochs=slice(None), stretch="asinh", vmin=None, vmax=None
):
    """The norm that turns brightness into colour, for the noise of some epochs."""
    from matplotlib.colors import AsinhNorm, LogNorm, Normalize

    if stretch not in ("asinh", "log", "linear"):
        raise ValueError(f"unknown stretch {stretch!r}: use 'asinh', 'log' or 'linear'")
    noise = u.Quantity(cube.noise_rms()).value[epochs]
    noise = noise[np.isfinite(noise) & (noise > 0)]
    lowest, highest = float(image.min()), float(image.max())
    top = highest if vmax is None else vmax
    noise = np.median(noise) if len(noise) else abs(top) / 1e3
    if stretch == "log":
        low = noise if vmin is None else vmin
        low = low if low > 0 else 1e-3
        return LogNorm(low, top if top > low else 10 * low, clip=True)
    bottom = max(lowest, -noise) if vmin is None else vmin
    if not top > bottom:
        bottom, top = bottom - 0.5, bottom + 0.5
    if stretch == "linear" or noise == 0:
        return Normalize(bottom, top)
    return AsinhNorm(LINEAR_NOISE * noise, vmin=bottom, vmax=top)


def ticks_of(norm):
    """Zero and the powers of ten that are apart from it; None for matplotlib's."""
    width = getattr(norm, "linear_width", None)
    if width is None or norm.vmax < 30 * width:
        return None
    powers = 10.0 ** np.arange(np.ceil(np.log10(2 * width)), np.log10(norm.vmax))
    return [0.0, *powers.tolist()]


def lengths(limits):
    """East-west and north-south length of a range of offsets, in mas."""
    return limits[:, 1] - limits[:, 0]


def longest(limits):
    """The larger of the two lengths, in mas."""
    return lengths(limits).max()


def date_of(cube, index):
    """The date of an epoch, with the time where another epoch has the same."""
    day = cube.times[index].strftime("%Y-%m-%d")
    same = sum(t.strftime("%Y-%m-%d") == day for t in cube.times)
    return day if same == 1 else cube.times[index].strftime("%Y-%m-%d %H:%M")


def brightness_label(unit):
    """Label of a colour bar."""
    name = unit_name(unit)
    return f"Brightness ({name})" if name else "Brightness"
