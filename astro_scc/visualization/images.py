# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Figures of images with their SSPs, in offsets, and a figure of their dates."""

from copy import copy

import astropy.units as u
import numpy as np

from astro_scc.decomposition import SSPs
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.images.dates import date_labels
from astro_scc.images.positions import axis_words, ssp_offsets
from astro_scc.images.series import epoch_index
from astro_scc.units import offset_unit, unit_name
from astro_scc.visualization import style

#: Colour of masked pixels, which is not among the greys of the image.
MASKED = "#BFDFF2"
LEGEND = {"fontsize": "small", "frameon": False, "columnspacing": 1.0}
LEGEND |= {"handletextpad": 0.3, "borderaxespad": 0.2, "ncols": 9}


# -- limits, units and colours -----------------------------------------------------


class View:
    """
    The part of a cube's images that is shown, with its unit and colours.

    ``points`` are those of `ssp_points`, of whose weight the share ``edge`` may lie
    beyond each side; without an edge the whole image is shown.  ``limits`` are the
    offsets (east, then north) in the unit, to which ``factor`` converts mas, and
    ``image`` has one or more images, which decide on the colours of the ``norm``.
    """

    def __init__(self, cube, points, image, norm, edge=0.015, unit=None):
        self.cube, self.points = cube, points
        limits = image_limits(cube, None if edge is None else points, edge)
        self.unit = offset_unit(np.ptp(limits, axis=1).max(), unit)
        self.factor = u.mas.to(self.unit)
        self.limits = limits * self.factor
        if not hasattr(norm, "autoscale_None"):
            raise TypeError(f"norm must be one of matplotlib.colors, got {norm!r}")
        # Limits that it lacks are those of this image.
        self.norm = copy(norm)
        self.norm.autoscale_None(image.compressed())
        *words, self.to_the_left = axis_words(cube)
        self.labels = axis_labels("Offset", words, self.unit)

    @property
    def to_offsets(self):
        """The transform of pixels to offsets in the unit."""
        from matplotlib.transforms import Affine2D

        matrix, to_offset = self.cube.pixel_matrix.to_value(self.unit), np.eye(3)
        to_offset[:2] = np.c_[matrix, -matrix @ self.cube.reference_pixel]
        return Affine2D(to_offset)

    def add_colorbar(self, drawn, **place):
        """Add the bar of an image's brightness, with ticks that are easy to read."""
        unit = unit_name(self.cube.unit)
        label = f"Brightness ({unit})" if unit else "Brightness"
        bar = drawn.figure.colorbar(drawn, label=label, **place)
        if (ticks := ticks_of(self.norm)) is not None:
            bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
            bar.minorticks_off()


def image_limits(cube, points=None, edge=0.015):
    """
    Return the range of offsets to show, shape (2, 2) in mas: east, then north.

    It is the whole image or, given the points of `ssp_points`, the range of the
    points with a margin, without the outermost, which may be noise at the edges: a
    share of their weight, ``edge``, is beyond each side.
    """
    _, ny, nx = cube.shape
    x, y = np.meshgrid([-0.5, nx - 0.5], [-0.5, ny - 0.5])
    corners = (axis.value for axis in cube.pixel_to_offset(x, y))
    whole = np.array([[axis.min(), axis.max()] for axis in corners])
    if points is None or points["place"].size == 0:
        return whole
    weights = {"weights": points["weight"], "method": "inverted_cdf"}
    near = np.quantile(points["place"], [edge, 1 - edge], axis=1, **weights).T
    margin = 12 * cube.pixel_scale.value
    if cube.beams is not None:
        margin = max(margin, 2.0 * max(beam.major.value for beam in cube.beams))
    near += [-margin, margin]
    # A narrow strip shows nothing, so the width is at least a third of the length.
    short = np.maximum(np.ptp(near, axis=1).max() / 3 - np.ptp(near, axis=1), 0)
    near += short[:, None] * [-0.5, 0.5]
    return np.clip(near, whole[:, :1], whole[:, 1:])


def plotting_norm(cube, image, epochs=slice(None)):
    """
    Return the norm that maps brightness to colour, for the noise of the epochs.

    It is linear up to three times the noise, and logarithmic above.
    """
    from matplotlib.colors import AsinhNorm, Normalize

    noise = cube.noise_rms().value[epochs]
    noise = noise[np.isfinite(noise) & (noise > 0)]
    top = float(image.max())
    noise = np.median(noise) if len(noise) else abs(top) / 1e3
    bottom = max(float(image.min()), -noise)
    if not top > bottom:
        bottom, top = bottom - 0.5, bottom + 0.5
    if noise == 0:
        return Normalize(bottom, top)
    return AsinhNorm(3 * noise, vmin=bottom, vmax=top)


def ticks_of(norm):
    """Return zero and larger powers of ten as ticks of an asinh norm, else None."""
    width = getattr(norm, "linear_width", np.inf)
    if norm.vmax < 30 * width:
        return None
    powers = 10.0 ** np.arange(np.ceil(np.log10(2 * width)), np.log10(norm.vmax))
    return [0.0, *powers.tolist()]


def edges(middle):
    """Return the edges of cells, halfway between their middles."""
    if len(middle) == 1:
        return middle[0] * np.array([0.9, 1.1])
    half = np.diff(middle) / 2
    first, last = middle[0] - half[0], middle[-1] + half[-1]
    return np.concatenate([[first], middle[:-1] + half, [last]])


# -- images ------------------------------------------------------------------------


def draw_image(ax, view, image, epoch=None, corner=None, look=None):
    """Draw an image, and the beam of an epoch in an empty corner; set the limits."""
    import matplotlib

    look = style.look_of("image", look or {}, cmap="Greys")
    for name in ("vmin", "vmax"):
        # A norm takes its limits from itself.
        setattr(view.norm, name, look.pop(name, getattr(view.norm, name)))
    look["cmap"] = matplotlib.colormaps.get_cmap(look["cmap"]).with_extremes(bad=MASKED)
    place = view.to_offsets + ax.transData
    drawn = ax.imshow(image, origin="lower", norm=view.norm, transform=place, **look)
    ax.set(xlim=view.limits[0, :: -1 if view.to_the_left else 1], ylim=view.limits[1])
    ax.set_aspect("equal")
    draw_beam(ax, view, epoch, corner or empty_corners(view, image)[0])
    return drawn


def empty_corners(view, image):
    """
    Return the corners, (right, top) each 0 or 1, those with the least light first.

    Those with noise alone are alike: left before right, and bottom before top.
    """
    # A quarter of the width and height counts as a corner.
    sides = np.linspace(0, 0.25, 12)
    light = {}
    noise = 6 * np.median(view.cube.noise_rms().value)
    low, size = view.limits[:, :1], np.ptp(view.limits, axis=1, keepdims=True)
    for right, top in np.ndindex(2, 2):
        ends = right != view.to_the_left, top
        east, north = low + size * [1 - sides if end else sides for end in ends]
        x, y = view.cube.offset_to_pixel(east * view.unit, north[:, None] * view.unit)
        pixels = tuple(np.rint([y, x]).astype(int))
        pixels = np.ravel_multi_index(pixels, image.shape, mode="clip")
        light[right, top] = max(noise, np.ma.filled(image, 0.0).flat[pixels].max())
    return sorted(light, key=light.get)


def draw_beam(ax, view, epoch, corner):
    """Draw the beam of an epoch, if there is one, in a corner."""
    from matplotlib.patches import Ellipse

    if epoch is None or view.cube.beams is None:
        return
    beam = view.cube.beams[epoch]
    half = beam.fwhm_along([90, 0] * u.deg).to_value(view.unit) / 2
    half += 0.03 * np.ptp(view.limits, axis=1).min()
    side = np.array([corner[0] != view.to_the_left, corner[1]], dtype=int)
    ax.add_patch(Ellipse(
        view.limits[[0, 1], side] + half * (1 - 2 * side),
        width=beam.minor.to_value(view.unit), height=beam.major.to_value(view.unit),
        # matplotlib's angle and the position angle have opposite senses.
        angle=-beam.pa.to_value(u.deg), facecolor="white", edgecolor=style.BLACK,
        hatch="////", linewidth=0.8, zorder=4, gid="beam",
    ))  # fmt: skip


def axis_labels(what, words, unit):
    """Return the labels of two axes on the sky, of which the words give the names."""
    if what == "Offset" and list(words[:2]) == ["east", "north"]:
        return [f"Relative {name} ({unit_name(unit)})" for name in ("R.A.", "Decl.")]
    names = (word if " " in word else f"the {word}" for word in words[:2])
    return [f"{what} to {name} ({unit_name(unit)})" for name in names]


def image_panels(view, n, figure, *, aside=0.6, above=0.0):
    """
    Return a figure, the given one or a new one, and its axes for n images.

    The number of columns makes the panels as large as possible in the figure or on
    a page; ``aside`` and ``above`` are the room for labels in inches.
    """
    aspect = np.divide(*np.ptp(view.limits, axis=1))
    page = (5.0, 8.0) if figure is None else figure.get_size_inches() - [1.2, 1.0]
    widths = [min(page[0] / k, page[1] / -(-n // k) * aspect) for k in range(1, n + 1)]
    # Of grids with equal panels, but for rounding, take the one with fewest columns.
    columns = 1 + int(np.argmax(np.round(widths, 3)))
    rows = -(-n // columns)
    if figure is None:
        panel = (style.WIDTH - aside) / columns / aspect
        panel = min(panel, (style.HEIGHT - 0.7 - above) / rows - 0.06)
        wide = max(columns * panel * aspect + aside, style.WIDTH / 2)
        high = max(rows * (panel + 0.06) + 0.7 + above, 2.4)
        figure = style.new_figure((wide, high))
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for ax in grid.flat[n:]:
        ax.set_axis_off()
    for ax in grid.flat[max(n - columns, 0) : n]:
        # Shared axes hide the tick labels of all rows but the last.
        ax.tick_params(labelbottom=True)
    figure.supxlabel(view.labels[0], fontsize="medium")
    figure.supylabel(view.labels[1], fontsize="medium")
    return figure, grid.flat[:n]


def draw_mean_image(cube, points, figure, unit):
    """Return a view, and a figure and its axes with the mean image in pale colours."""
    mean = cube.mean_image()
    image = np.ma.masked_array(mean.data, mean.mask)
    view = View(cube, points, image, plotting_norm(cube, image), 0.0, unit)
    figure, (ax,) = image_panels(view, 1, figure)
    common = cube.beams is not None and all(b == cube.beams[0] for b in cube.beams)
    draw_image(ax, view, image, 0 if common else None).set_alpha(0.5)
    draw_contours(ax, view)
    return view, figure, ax


def draw_contours(ax, view):
    """Draw contours of a mean image from three times its noise on, each twice one."""
    image, cube = ax.images[0].get_array(), view.cube
    lowest = 3 * np.median(cube.noise_rms().value) / np.sqrt(len(cube))
    peak = float(image.max()) / lowest if lowest > 0 else 0.0
    if not peak > 1:
        return
    ax.contour(
        np.ma.filled(image, np.nan), colors=style.GREY, linewidths=0.4,
        levels=lowest * 2.0 ** np.arange(np.log2(peak)),
        transform=view.to_offsets + ax.transData,
    )  # fmt: skip


def image_planes(cube, limits, most):
    """
    Return all epochs as grey levels on one grid with axes east and north.

    The planes (n_epochs, ny, nx) of uint8 go from 1 (faint) to 255, and are 0 where an
    image is masked; with them go their limits in mas, and the side of their pixels in
    pixels of the images, which are binned to ``most`` pixels of all epochs.
    """
    from scipy.ndimage import map_coordinates, uniform_filter

    step = cube.pixel_scale.value
    n_bins = np.sqrt(len(cube) * np.prod(np.ptp(limits, axis=1) / step) / most)
    n_bins = max(1, int(np.ceil(n_bins)))
    step, low = step * n_bins, limits[:, :1]
    n = np.maximum(np.ptp(limits, axis=1, keepdims=True) // step, 1)
    east, north = (k + step * (np.arange(m) + 0.5) for k, m in np.c_[low, n])
    pixels = cube.offset_to_pixel(east * u.mas, north[:, None] * u.mas)[::-1]
    norm = plotting_norm(cube, np.ma.masked_array(cube.data, cube.mask))
    planes = np.zeros((len(cube), len(north), len(east)), np.uint8)
    for plane, image, hidden in zip(planes, cube.data, cube.mask, strict=True):
        image = uniform_filter(np.where(hidden, 0.0, image), n_bins)
        level = norm(map_coordinates(image, pixels, order=0))
        known = map_coordinates((~hidden).astype(np.uint8), pixels, order=0)
        plane[:] = known * np.clip(np.round(1 + 254 * level), 1, 255)
    return planes, low + step * n * [0, 1], n_bins


def epoch_names(times):
    """Return the date of each epoch as text that no other epoch has."""
    dates = [date.replace("T", " ") for date in date_labels(times)]
    twice = {date for date in dates if dates.count(date) > 1}
    return [f"{d} ({k})" if d in twice else d for k, d in enumerate(dates)]


def sky_place(table):
    """Return the offsets of SSPs or features in a table, shape (2, n) in mas."""
    pairs = ("lon_offset", "lat_offset"), ("ra_offset", "dec_offset"), ("east", "north")
    names = next(pair for pair in pairs if pair[0] in table.colnames)
    return np.stack([u.Quantity(table[name]).to_value(u.mas) for name in names])


# -- SSPs --------------------------------------------------------------------------


def ssp_points(cube, ssps):
    """
    Return what is drawn of SSPs as a dictionary of arrays, or None for None.

    It has the ``place``, offsets in mas of shape (2, n), ``epoch``, ``scale``, whether
    SSPs are ``used``, a ``weight`` that is small for SSPs close to the noise, and the
    ``ssps``.
    """
    if ssps is None:
        return None
    used, names = np.ones(len(ssps), bool), ("epoch", "scale", "snr")
    if isinstance(ssps, SSPs):
        place = np.stack(ssp_offsets(ssps, cube))
        points = {name: getattr(ssps, name) for name in names}
    else:
        place = sky_place(ssps)
        points = {name: np.asarray(ssps[name]) for name in names}
        if "in_region" in ssps.colnames:
            used = np.asarray(ssps["in_region"], bool)
    snr = points["snr"]
    weight = 0.05 + np.log(snr / snr.min(initial=np.inf))
    return points | {"ssps": ssps, "place": place, "used": used, "weight": weight}


def draw_ssps(ax, view, epoch, size=1.0):
    """Draw the SSPs of an epoch, with labels for all scales of the cube."""
    if view.points is None:
        return
    hollow = {"linestyle": "", "marker": "o", "markerfacecolor": "none"}
    points = view.points
    scales = np.unique(points["scale"])
    for rank, scale in enumerate(scales):
        color = style.component_color(rank + 1)
        here = (points["epoch"] == epoch) & (points["scale"] == scale)
        extent = (scale_size(scale) * view.cube.pixel_scale).to_value(view.unit)
        words = "" if rank else "SSPs of scale "
        unit = "" if rank < len(scales) - 1 else f" {unit_name(view.unit)}"
        label = f"{words}{extent:.2g}{unit}"
        if isinstance(points["ssps"], SSPs):
            line = {"color": color, "linewidth": 0.7 + 0.4 * rank, "label": label}
            _draw_outlines(ax, view, np.flatnonzero(here), **line)
            continue
        for used, alpha in ((True, 1.0), (False, 0.3)):
            ax.plot(
                *view.factor * points["place"][:, here & (points["used"] == used)],
                markersize=(4.0 + 3.0 * rank) * size, markeredgecolor=color,
                markeredgewidth=1.1, alpha=alpha, gid=f"ssps {scale:g}",
                label=label if used else None, **hollow,
            )  # fmt: skip
    if not np.all(points["used"]):
        pale = {"alpha": 0.4, "mec": style.GREY, "label": "not used"}
        ax.plot([], [], ms=6.25 * size, **pale, **hollow)


def _draw_outlines(ax, view, indices, **line):
    """Draw the outlines of SSPs along the edges of their pixels, each edge once."""
    from matplotlib.collections import LineCollection

    label = np.zeros(view.cube.shape[1:], dtype=int)
    for index in indices:
        label.flat[view.points["ssps"].pixels_of(index)] = index + 1
    label = np.pad(label, 1)
    edges = []
    for axis, back in enumerate(np.eye(2)):
        end = np.argwhere(np.diff(label, axis=axis))[:, ::-1] - 0.5
        edges.append(np.stack([end - back, end], axis=1))
    offsets = view.cube.pixel_to_offset(*np.moveaxis(np.concatenate(edges), -1, 0))
    lines = np.stack(offsets, axis=-1).to_value(view.unit)
    ax.add_collection(LineCollection(lines, gid="outlines", **line), autolim=False)


# -- figures -------------------------------------------------------------------------


def plot_epoch(cube, epoch, ssps=None, *, ax=None, colorbar=True, **look):
    """
    Draw one epoch in offsets from the reference pixel, east to the left.

    Solar images have west to the right.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    epoch : int
        Index of the epoch.
    ssps : `~astropy.table.QTable` or `~astro_scc.decomposition.SSPs`, optional
        The SSPs of all epochs: a table (``result.ssps``) is drawn as
        circles, larger for larger scales and pale if the SSP is outside the
        region that was measured; a catalogue (``result.decomposed.ssps``) is
        drawn as outlines.
    ax : `matplotlib.axes.Axes`, optional
        Axes to draw on instead of a new figure.
    unit : `~astropy.units.Unit`, optional
        Unit of the offsets.
    norm : `matplotlib.colors.Normalize`, optional
        By default linear up to three times the noise and logarithmic above.
    zoom : bool, optional
        Show only the part of the image that holds SSPs, except the outermost,
        which may be noise.
    colorbar : bool, optional
    **look
        Keywords of the image, such as ``cmap``, see `matplotlib.image.AxesImage`.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the unit is not an angle.
    IndexError
        If there is no such epoch.
    """
    index = epoch_index(epoch, len(cube))
    image = np.ma.masked_array(cube.data[index], cube.mask[index])
    view = _view_of(cube, ssps, image, [index], look)
    width, height = np.ptp(view.limits, axis=1)
    height = float(np.clip(4.6 * height / width + 1.0, 2.4, 8.0))
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, height))
    drawn = draw_image(ax, view, image, index, look=look)
    draw_ssps(ax, view, index)
    _label_masked(ax, view, image.mask)
    ax.set(xlabel=view.labels[0], ylabel=view.labels[1])
    handles, _ = ax.get_legend_handles_labels()
    # The date is above the line with the legend.
    ax.set_title(epoch_names(cube.times)[index], pad=22.0 if handles else None)
    if handles:
        place = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0)}
        ax.legend(markerscale=0.8, **place, **LEGEND)
    if colorbar:
        view.add_colorbar(drawn, cax=style.beside(ax))
    return figure


def plot_epochs(cube, ssps=None, *, figure=None, max_panels=12, **look):
    """
    Draw up to ``max_panels`` epochs, evenly selected, with the same colours.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    ssps, **look
        As in `plot_epoch`.
    figure : `matplotlib.figure.Figure`, optional
        Figure to draw on instead of a new one.
    max_panels : int, optional
        Of more epochs, the first, the last and others between them are drawn.

    Returns
    -------
    `matplotlib.figure.Figure`
    """
    if max_panels < 1:
        raise ValueError(f"max_panels must be at least 1, got {max_panels}")
    n = len(cube)
    chosen = np.unique(np.rint(np.linspace(0, n - 1, min(n, max_panels))).astype(int))
    images = np.ma.masked_array(cube.data[chosen], cube.mask[chosen])
    view = _view_of(cube, ssps, images, chosen, look)
    figure, axes = image_panels(view, len(chosen), figure, aside=1.4, above=0.4)
    dates = epoch_names(cube.times)
    of_beam, (right, top), *_ = empty_corners(view, images.max(axis=0))
    at = 0.97 if right else 0.03, 0.96 if top else 0.04
    date = {"ha": "right" if right else "left", "va": "top" if top else "bottom"}
    date |= {"fontsize": "small", "path_effects": style.outline()}
    for ax, index, image in zip(axes, chosen, images, strict=True):
        drawn = draw_image(ax, view, image, index, of_beam, look)
        draw_ssps(ax, view, index, size=0.5)
        ax.text(*at, dates[index], transform=ax.transAxes, **date)
    view.add_colorbar(drawn, ax=figure.axes, pad=0.02, aspect=40)
    _label_masked(ax, view, images.mask.any(axis=0))
    handles, _ = ax.get_legend_handles_labels()
    if handles:
        place = {"loc": "outside upper center", "markerscale": 1.6}
        figure.legend(handles=handles, **place, **LEGEND)
    return figure


def _view_of(cube, ssps, image, epochs, look):
    """Return the view of images, and take its keywords out of those of an image."""
    norm = look.pop("norm", None) or plotting_norm(cube, image, epochs)
    edge = 0.015 if look.pop("zoom", True) else None
    return View(cube, ssp_points(cube, ssps), image, norm, edge, look.pop("unit", None))


def _label_masked(ax, view, mask):
    """Give masked pixels a label for the legend, if any is seen."""
    row, column = np.nonzero(mask)
    offset = u.Quantity(view.cube.pixel_to_offset(column, row)).to_value(view.unit)
    low, high = view.limits.T[..., None]
    if np.any(np.all((offset > low) & (offset < high), axis=0)):
        ax.fill([], [], color=MASKED, label="masked")
