# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Draw images and their SSPs in offsets from the reference pixel."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np

from astro_scc.decomposition import scale_size
from astro_scc.epochs.positions import axis_words
from astro_scc.units import offset_unit, unit_name
from astro_scc.visualization import style

#: Colour of masked pixels, which is not among the greys of the image.
MASKED = "#BFDFF2"
#: Brightness up to which the asinh stretch is linear, in units of the noise.
LINEAR_NOISE = 3.0
#: Lowest contour of a mean image, in its noise; of more contours than these each is
#: four times the one before, of fewer twice.
LOWEST, MOST_CONTOURS = 5.0, 8
#: Share of the SSPs' weight that lies beyond each side of a zoomed figure.
EDGE = 0.015


# -- limits, units and colours -----------------------------------------------------


@dataclass(frozen=True, eq=False)
class View:
    """
    The part of a cube's images that is shown, with its unit and colours.

    ``points`` are the SSPs, see `ssp_points`; ``limits`` are offsets in mas, shape
    (2, 2), east, then north; ``norm`` maps brightness to colour.
    """

    cube: object
    points: dict | None
    limits: np.ndarray
    unit: u.UnitBase
    norm: object

    @classmethod
    def of(cls, cube, ssps, image, *, zoom=True, unit=None, **colors):
        """Return the view of one or more images and SSPs."""
        points = ssp_points(cube, ssps)
        limits = image_limits(cube, points if zoom else None)
        unit = offset_unit(lengths(limits).max(), unit)
        return cls(cube, points, limits, unit, plotting_norm(cube, image, **colors))

    @property
    def factor(self):
        """Factor that converts mas to the unit of the offsets."""
        return u.mas.to(self.unit)


def lengths(limits):
    """Return the east-west and north-south length of a range of offsets, in mas."""
    return limits[:, 1] - limits[:, 0]


def image_limits(cube, points=None):
    """
    Return the range of offsets to show, shape (2, 2) in mas: east, then north.

    It is the whole image or, given the points of `ssp_points`, the range of the
    points with a margin, without the outermost, which may be noise at the edges.
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
    # A narrow strip shows nothing, so the width is at least a third of the length.
    short = np.maximum(lengths(near).max() / 3 - lengths(near), 0)
    near += short[:, None] * [-0.5, 0.5]
    low, high = whole.T
    return np.stack([np.maximum(near[:, 0], low), np.minimum(near[:, 1], high)], axis=1)


def _inner_range(values, weight):
    order = np.argsort(values)
    share = np.cumsum(weight[order])
    share = (share - 0.5 * weight[order]) / share[-1]
    return np.interp([EDGE, 1 - EDGE], share, values[order])


def plotting_norm(
    cube, image, epochs=slice(None), stretch="asinh", vmin=None, vmax=None
):
    """Return the norm that maps brightness to colour, for the noise of the epochs."""
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
    """Return zero and larger powers of ten as ticks of an asinh norm, else None."""
    width = getattr(norm, "linear_width", None)
    if width is None or norm.vmax < 30 * width:
        return None
    powers = 10.0 ** np.arange(np.ceil(np.log10(2 * width)), np.log10(norm.vmax))
    return [0.0, *powers.tolist()]


def brightness_label(unit):
    """Return the label of a colour bar."""
    name = unit_name(unit)
    return f"Brightness ({name})" if name else "Brightness"


# -- images ------------------------------------------------------------------------


def draw_image(ax, view, image, beam=None):
    """Draw an image, and the beam in the lower left corner; set the limits."""
    import matplotlib

    cube, unit = view.cube, view.unit
    greys = matplotlib.colormaps["Greys"].with_extremes(bad=MASKED)
    drawn = ax.imshow(
        image, origin="lower", norm=view.norm, cmap=greys,
        transform=_to_offsets(view) + ax.transData,
    )  # fmt: skip
    (east0, east1), (north0, north1) = (view.limits * u.mas).to_value(unit)
    _, _, to_the_left = axis_words(cube)
    ax.set_xlim((east1, east0) if to_the_left else (east0, east1))
    ax.set_ylim(north0, north1)
    ax.set_aspect("equal")
    draw_beam(ax, view, beam)
    return drawn


def _to_offsets(view):
    """Return the transform of pixels to offsets in the unit of the view."""
    from matplotlib.transforms import Affine2D

    matrix = view.cube.pixel_matrix.to_value(view.unit)
    to_offset = np.eye(3)
    to_offset[:2, :2] = matrix
    to_offset[:2, 2] = -matrix @ view.cube.reference_pixel
    return Affine2D(to_offset)


def draw_beam(ax, view, beam):
    """Draw a beam, if there is one, in the lower left corner."""
    from matplotlib.patches import Ellipse

    if beam is None:
        return
    (_, east1), (north0, _) = (view.limits * u.mas).to_value(view.unit)
    half = beam.fwhm_along([90, 0] * u.deg).to_value(view.unit) / 2
    margin = 0.03 * lengths(view.limits).min() * view.factor
    ellipse = Ellipse(
        (east1 - half[0] - margin, north0 + half[1] + margin),
        width=beam.minor.to_value(view.unit), height=beam.major.to_value(view.unit),
        # matplotlib's angle and the position angle have opposite senses.
        angle=-beam.pa.to_value(u.deg), facecolor="white", edgecolor=style.BLACK,
        hatch="////", linewidth=0.8, zorder=4, gid="beam",
    )  # fmt: skip
    ax.add_patch(ellipse)


def offset_labels(cube, unit):
    """Return the labels of the two axes of an image."""
    names = (n if " " in n else f"the {n}" for n in axis_words(cube)[:2])
    return tuple(f"Offset to {name} ({unit_name(unit)})" for name in names)


def image_panels(view, n, figure, *, aside=0.6, above=0.0):
    """
    Return a figure, the given one or a new one, and its axes for n images.

    The number of columns makes the panels as large as possible in the figure or on
    a page; ``aside`` and ``above`` are the room for labels in inches.
    """
    width, height = lengths(view.limits)
    page = (5.0, 8.0) if figure is None else figure.get_size_inches() - [1.2, 1.0]
    sizes = [
        min(page[0] / columns, page[1] / -(-n // columns) * width / height)
        for columns in range(1, n + 1)
    ]
    # Of grids with equal panels, but for rounding, take the one with fewest columns.
    columns = 1 + int(np.argmax(np.round(sizes, 3)))
    rows = -(-n // columns)
    if figure is None:
        panel = (style.WIDTH - aside) / columns * height / width
        panel = min(panel, (style.HEIGHT - 0.7 - above) / rows - 0.06)
        wide = max(columns * panel * width / height + aside, style.WIDTH / 2)
        high = max(rows * (panel + 0.06) + 0.7 + above, 2.4)
        figure = style.new_figure((float(wide), float(high)))
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for ax in grid.flat[n:]:
        ax.set_axis_off()
    for ax in grid.flat[max(n - columns, 0) : n]:
        # Shared axes hide the tick labels of all rows but the last.
        ax.tick_params(labelbottom=True)
    across, up = offset_labels(view.cube, view.unit)
    figure.supxlabel(across, fontsize="medium")
    figure.supylabel(up, fontsize="medium")
    return figure, grid.flat[:n]


def mean_image_panels(cube, ssps, n, *, figure, unit):
    """Return a view, and a figure and its axes with the mean image in pale colours."""
    mean = cube.mean_image()
    image = np.ma.masked_array(mean.data, mean.mask)
    view = View.of(cube, ssps, image, unit=unit)
    figure, axes = image_panels(view, n, figure)
    common = cube.beams is not None and all(b == cube.beams[0] for b in cube.beams)
    for ax in axes:
        drawn = draw_image(ax, view, image, cube.beams[0] if common else None)
        drawn.set_alpha(0.5)
    return view, figure, axes


def draw_contours(ax, view, image):
    """Draw contours of a mean image, from five times its noise on."""
    cube = view.cube
    noise = np.median(u.Quantity(cube.noise_rms()).value) / np.sqrt(len(cube))
    peak = float(image.max()) / (LOWEST * noise) if noise > 0 else 0.0
    if not peak > 1:
        return
    ratio = 2.0 if np.log2(peak) < MOST_CONTOURS else 4.0
    levels = LOWEST * noise * ratio ** np.arange(np.log(peak) / np.log(ratio))
    ax.contour(
        np.ma.filled(image, np.nan), levels=levels, colors=style.GREY, linewidths=0.6,
        transform=_to_offsets(view) + ax.transData,
    )  # fmt: skip


def panel_text(ax, text, x=0.02, y=0.95, color=style.BLACK):
    """Write text in a panel, by default in its upper left corner."""
    ax.text(
        x, y, text, transform=ax.transAxes, va="top", fontsize="small", color=color,
        path_effects=style.outline(),
    )  # fmt: skip


def image_planes(cube, limits, most):
    """
    Return all epochs as grey levels on one grid with axes east and north.

    Parameters
    ----------
    cube : `~astro_scc.EpochCube`
    limits : `~numpy.ndarray`, shape (2, 2)
        Offsets in mas: east, then north.
    most : int
        Largest number of pixels of all epochs; images are binned for it.

    Returns
    -------
    planes : `~numpy.ndarray` of uint8, shape (n_epochs, ny, nx)
        From 1 (faint) to 255; 0 where an image is masked.
    sides : `~numpy.ndarray`, shape (2, 2)
        The limits of the planes.
    n_bins : int
        Side of a pixel of the planes, in pixels of the images.
    """
    from scipy.ndimage import affine_transform, uniform_filter

    step = cube.pixel_scale.value
    n_bins = np.sqrt(len(cube) * np.prod(lengths(limits) / step) / most)
    n_bins = max(1, int(np.ceil(n_bins)))
    step *= n_bins
    n = np.maximum(lengths(limits) // step, 1).astype(int)
    to_pixel = np.linalg.inv(cube.pixel_matrix.value)
    first = to_pixel @ (limits[:, 0] + step / 2) + cube.reference_pixel
    # Axes are (y, x) here, and (x, y) in the matrix.
    grid = {
        "matrix": step * to_pixel[::-1, ::-1], "offset": first[::-1],
        "output_shape": tuple(n[::-1]), "order": 0,
    }  # fmt: skip
    mask = ~np.isfinite(cube.data)
    if cube.mask is not None:
        mask |= cube.mask
    norm = plotting_norm(cube, np.ma.masked_array(cube.data, mask))
    planes = np.zeros((len(cube), *grid["output_shape"]), np.uint8)
    for plane, image, hidden in zip(planes, cube.data, mask, strict=True):
        image = uniform_filter(np.where(hidden, 0.0, image), n_bins)
        level = norm(affine_transform(image, **grid))
        known = affine_transform((~hidden).astype(np.uint8), **grid)
        plane[:] = known * np.clip(np.round(1 + 254 * level), 1, 255)
    return planes, limits[:, :1] + step * n[:, None] * [0, 1], n_bins


def epoch_names(times):
    """Return the shortest dates of epochs that differ from each other."""
    for length in (10, 16, 19, 23):
        names = [date[:length].replace("T", " ") for date in times.isot]
        if len(set(names)) == len(names):
            return names
    return [f"{name} ({k})" for k, name in enumerate(names)]


# -- SSPs --------------------------------------------------------------------------


def ssp_points(cube, ssps):
    """
    Return what is drawn of SSPs as a dictionary of arrays, or None for None.

    It has the positions in mas, ``epoch``, ``scale``, whether SSPs are ``used``, and a
    ``weight`` that is small for SSPs close to the noise.
    """
    if ssps is None:
        return None
    used = np.ones(len(ssps), bool)
    if is_catalogue(ssps):
        east, north = cube.pixel_to_offset(ssps.x, ssps.y)
        epoch, scale, snr = ssps.epoch, ssps.scale, ssps.snr
    else:
        names = "east", "north"
        if "lon_offset" in ssps.colnames:
            names = "lon_offset", "lat_offset"
        east, north = (u.Quantity(ssps[name]) for name in names)
        epoch, scale, snr = (np.asarray(ssps[n]) for n in ("epoch", "scale", "snr"))
        if "in_region" in ssps.colnames:
            used = np.asarray(ssps["in_region"], bool)
    snr = np.asarray(snr, dtype=float)
    return {
        "east": east.to_value(u.mas),
        "north": north.to_value(u.mas),
        "epoch": epoch,
        "scale": np.asarray(scale, dtype=float),
        "used": used,
        "weight": 0.05 + np.log(snr / snr.min(initial=np.inf)),
    }


def is_catalogue(ssps):
    """Return whether SSPs are a catalogue, which knows their pixels, not a table."""
    return hasattr(ssps, "pixels_of")


def draw_ssps(ax, view, ssps, epoch, size=1.0):
    """Draw the SSPs of an epoch; return legend handles for all scales of the cube."""
    from matplotlib.lines import Line2D

    if ssps is None:
        return []
    hollow = {"linestyle": "", "marker": "o", "markerfacecolor": "none"}
    handles = []
    points = view.points
    colors = style.scale_colors(points["scale"])
    for rank, (scale, color) in enumerate(colors.items()):
        here = (points["epoch"] == epoch) & (points["scale"] == scale)
        diameter = (4.0 + 3.0 * rank) * size
        label = _scale_label(view, scale, rank == 0, rank == len(colors) - 1)
        if is_catalogue(ssps):
            line = {"color": color, "linewidth": 0.7 + 0.4 * rank}
            _draw_outlines(ax, view, ssps, np.flatnonzero(here), **line)
            handles.append(Line2D([], [], label=label, **line))
            continue
        for used, alpha in ((True, 1.0), (False, 0.3)):
            some = here & (points["used"] == used)
            ax.plot(
                points["east"][some] * view.factor, points["north"][some] * view.factor,
                markersize=diameter, markeredgecolor=color, markeredgewidth=1.1,
                alpha=alpha, gid=f"ssps {scale:g}", **hollow,
            )  # fmt: skip
        hollow_size = diameter / size * 0.8
        handles.append(Line2D([], [], ms=hollow_size, mec=color, label=label, **hollow))
    if not np.all(points["used"]):
        pale = {"alpha": 0.4, "mec": style.GREY, "label": "not used"}
        handles.append(Line2D([], [], ms=5, **pale, **hollow))
    return handles


def _scale_label(view, scale, first, last):
    """Return the label of a scale: its size, with words if first, a unit if last."""
    size = (scale_size(scale) * view.cube.pixel_scale).to_value(view.unit)
    words = ["SSPs of scale"] * first + [f"{size:.2g}"]
    return " ".join(words + [unit_name(view.unit)] * last)


def _draw_outlines(ax, view, ssps, indices, **line):
    """Draw the outlines of SSPs along the edges of their pixels, each edge once."""
    from matplotlib.collections import LineCollection

    _, ny, nx = view.cube.shape
    label = np.zeros(ny * nx, dtype=int)
    for index in indices:
        label[ssps.pixels_of(index)] = index + 1
    label = np.pad(label.reshape(ny, nx), 1)
    row, column = np.nonzero(label[:, 1:] != label[:, :-1])
    upright = np.stack([[column - 0.5, row - 1.5], [column - 0.5, row - 0.5]])
    row, column = np.nonzero(label[1:] != label[:-1])
    level = np.stack([[column - 1.5, row - 0.5], [column - 0.5, row - 0.5]])
    ends = np.concatenate([upright, level], axis=2)
    lines = np.stack(view.cube.pixel_to_offset(ends[:, 0], ends[:, 1]), axis=-1)
    lines = lines.to_value(view.unit).swapaxes(0, 1)
    ax.add_collection(LineCollection(lines, gid="outlines", **line), autolim=False)
