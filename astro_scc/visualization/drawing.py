# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Draw images and their SSPs in offsets from the reference pixel."""

import astropy.units as u
import numpy as np

from astro_scc.decomposition import SSPs
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.images.positions import axis_words, ssp_offsets
from astro_scc.units import offset_unit, unit_name
from astro_scc.visualization import style

#: Colour of masked pixels, which is not among the greys of the image.
MASKED = "#BFDFF2"
#: Brightness up to which the asinh stretch is linear, in units of the noise.
LINEAR_NOISE = 3.0
#: Lowest contour of a mean image, in its noise; each is twice the one before.
LOWEST = 3.0
#: Share of the width and height of a figure that counts as a corner.
CORNER = 0.25
#: Share of the SSPs' weight that lies beyond each side of a zoomed figure.
EDGE = 0.015


# -- limits, units and colours -----------------------------------------------------


class View:
    """
    The part of a cube's images that is shown, with its unit and colours.

    Parameters
    ----------
    cube : `~astro_scc.EpochCube`
    ssps : see `ssp_points`
    image : `numpy.ma.MaskedArray`
        One or more images, which decide on the colours.
    zoom : bool, optional
        Show only the part with SSPs.
    edge : float, optional
        Share of the SSPs' weight that may lie beyond each side.
    unit : `~astropy.units.Unit`, optional
        Unit of the offsets.
    **colors
        See `plotting_norm`.

    Attributes
    ----------
    points : dict or None
        See `ssp_points`.
    place : `~numpy.ndarray`, shape (2, n)
        Offsets of the points in the unit: east, then north.
    limits : `~numpy.ndarray`, shape (2, 2)
        Offsets that are shown, in the unit: east, then north.
    factor : float
        Converts mas to the unit.
    """

    def __init__(self, cube, ssps, image, *, zoom=True, edge=EDGE, unit=None, **colors):
        self.cube, self.points = cube, ssp_points(cube, ssps)
        limits = image_limits(cube, self.points if zoom else None, edge)
        self.unit = offset_unit(np.ptp(limits, axis=1).max(), unit)
        self.factor = u.mas.to(self.unit)
        self.limits = limits * self.factor
        self.place = None if ssps is None else self.points["place"] * self.factor
        self.norm = plotting_norm(cube, image, **colors)
        self.words = axis_words(cube)
        self.to_the_left = self.words[2]
        self.labels = axis_labels("Offset", self.words, self.unit)

    def add_colorbar(self, drawn, **place):
        """Add the bar of an image's brightness, with ticks that are easy to read."""
        unit = unit_name(self.cube.unit)
        label = f"Brightness ({unit})" if unit else "Brightness"
        bar = drawn.figure.colorbar(drawn, label=label, **place)
        if (ticks := ticks_of(self.norm)) is not None:
            bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
            bar.minorticks_off()


def image_limits(cube, points=None, edge=EDGE):
    """
    Return the range of offsets to show, shape (2, 2) in mas: east, then north.

    It is the whole image or, given the points of `ssp_points`, the range of the
    points with a margin, without the outermost, which may be noise at the edges.
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


def plotting_norm(
    cube, image, epochs=slice(None), stretch="asinh", vmin=None, vmax=None
):
    """Return the norm that maps brightness to colour, for the noise of the epochs."""
    from matplotlib.colors import AsinhNorm, LogNorm, Normalize

    if stretch not in ("asinh", "log", "linear"):
        raise ValueError(f"unknown stretch {stretch!r}: use 'asinh', 'log' or 'linear'")
    noise = cube.noise_rms().value[epochs]
    noise = noise[np.isfinite(noise) & (noise > 0)]
    top = float(image.max()) if vmax is None else vmax
    noise = np.median(noise) if len(noise) else abs(top) / 1e3
    if stretch == "log":
        low = noise if vmin is None else vmin
        low = low if low > 0 else 1e-3
        return LogNorm(low, top if top > low else 10 * low, clip=True)
    bottom = max(float(image.min()), -noise) if vmin is None else vmin
    if not top > bottom:
        bottom, top = bottom - 0.5, bottom + 0.5
    if stretch == "linear" or noise == 0:
        return Normalize(bottom, top)
    return AsinhNorm(LINEAR_NOISE * noise, vmin=bottom, vmax=top)


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


def draw_image(ax, view, image, epoch=None, corner=None):
    """Draw an image, and the beam of an epoch in an empty corner; set the limits."""
    import matplotlib

    greys = matplotlib.colormaps["Greys"].with_extremes(bad=MASKED)
    drawn = ax.imshow(
        image, origin="lower", norm=view.norm, cmap=greys,
        transform=_to_offsets(view) + ax.transData,
    )  # fmt: skip
    ax.set(xlim=view.limits[0, :: -1 if view.to_the_left else 1], ylim=view.limits[1])
    ax.set_aspect("equal")
    draw_beam(ax, view, epoch, corner or empty_corners(view, image)[0])
    return drawn


def empty_corners(view, image):
    """
    Return the corners, (right, top) each 0 or 1, those with the least light first.

    Those with noise alone are alike: left before right, and bottom before top.
    """
    sides = np.linspace(0, CORNER, 12)
    light = {}
    noise = 2 * LOWEST * np.median(view.cube.noise_rms().value)
    for right, top in ((0, 0), (0, 1), (1, 0), (1, 1)):
        east = 1 - sides if right != view.to_the_left else sides
        north = 1 - sides if top else sides
        place = [low + (high - low) * f for (low, high), f in
                 zip(view.limits, (east, north), strict=True)]  # fmt: skip
        x, y = view.cube.offset_to_pixel(
            place[0] * view.unit, place[1][:, None] * view.unit
        )
        ny, nx = image.shape
        x = np.clip(np.rint(x).astype(int), 0, nx - 1)
        y = np.clip(np.rint(y).astype(int), 0, ny - 1)
        light[right, top] = max(noise, float(np.ma.filled(image[y, x], 0.0).max()))
    return sorted(light, key=light.get)


def _to_offsets(view):
    """Return the transform of pixels to offsets in the unit of the view."""
    from matplotlib.transforms import Affine2D

    matrix = view.cube.pixel_matrix.to_value(view.unit)
    to_offset = np.eye(3)
    to_offset[:2] = np.c_[matrix, -matrix @ view.cube.reference_pixel]
    return Affine2D(to_offset)


def draw_beam(ax, view, epoch, corner):
    """Draw the beam of an epoch, if there is one, in a corner."""
    from matplotlib.patches import Ellipse

    if epoch is None or view.cube.beams is None:
        return
    beam = view.cube.beams[epoch]
    half = beam.fwhm_along([90, 0] * u.deg).to_value(view.unit) / 2
    half += 0.03 * np.ptp(view.limits, axis=1).min()
    east, top = corner[0] != view.to_the_left, corner[1]
    ellipse = Ellipse(
        (
            view.limits[0, int(east)] + (-half[0] if east else half[0]),
            view.limits[1, top] + (-half[1] if top else half[1]),
        ),
        width=beam.minor.to_value(view.unit), height=beam.major.to_value(view.unit),
        # matplotlib's angle and the position angle have opposite senses.
        angle=-beam.pa.to_value(u.deg), facecolor="white", edgecolor=style.BLACK,
        hatch="////", linewidth=0.8, zorder=4, gid="beam",
    )  # fmt: skip
    ax.add_patch(ellipse)


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
    widths = [
        min(page[0] / columns, page[1] / -(-n // columns) * aspect)
        for columns in range(1, n + 1)
    ]
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
    style.label_all(figure, *view.labels)
    return figure, grid.flat[:n]


def mean_image_panels(cube, ssps, n, *, figure, unit, **zoom):
    """Return a view, and a figure and its axes with the mean image in pale colours."""
    mean = cube.mean_image()
    image = np.ma.masked_array(mean.data, mean.mask)
    view = View(cube, ssps, image, unit=unit, **zoom)
    figure, axes = image_panels(view, n, figure)
    common = cube.beams is not None and all(b == cube.beams[0] for b in cube.beams)
    for ax in axes:
        draw_image(ax, view, image, 0 if common else None).set_alpha(0.5)
    return view, figure, axes


def draw_contours(ax, view):
    """Draw contours of the image on axes, a mean, from three times its noise on."""
    image, cube = ax.images[0].get_array(), view.cube
    lowest = LOWEST * np.median(cube.noise_rms().value) / np.sqrt(len(cube))
    peak = float(image.max()) / lowest if lowest > 0 else 0.0
    if not peak > 1:
        return
    ax.contour(
        np.ma.filled(image, np.nan), colors=style.GREY, linewidths=0.4,
        levels=lowest * 2.0 ** np.arange(np.log2(peak)),
        transform=_to_offsets(view) + ax.transData,
    )  # fmt: skip


def panel_text(ax, text, corner=(0, 1)):
    """Write text into a corner of a panel, by default the upper left one."""
    right, top = corner
    ax.text(
        0.97 if right else 0.03, 0.96 if top else 0.04, text, transform=ax.transAxes,
        ha="right" if right else "left", va="top" if top else "bottom",
        fontsize="small", path_effects=style.outline(),
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
    from scipy.ndimage import map_coordinates, uniform_filter

    step = cube.pixel_scale.value
    n_bins = np.sqrt(len(cube) * np.prod(np.ptp(limits, axis=1) / step) / most)
    n_bins = max(1, int(np.ceil(n_bins)))
    step *= n_bins
    n = np.maximum(np.ptp(limits, axis=1) // step, 1)
    east, north = (
        (low + step * (np.arange(k) + 0.5)) * u.mas
        for low, k in zip(limits[:, 0], n, strict=True)
    )
    pixels = cube.offset_to_pixel(east, north[:, None])[::-1]
    norm = plotting_norm(cube, np.ma.masked_array(cube.data, cube.mask))
    planes = np.zeros((len(cube), len(north), len(east)), np.uint8)
    for plane, image, hidden in zip(planes, cube.data, cube.mask, strict=True):
        image = uniform_filter(np.where(hidden, 0.0, image), n_bins)
        level = norm(map_coordinates(image, pixels, order=0))
        known = map_coordinates((~hidden).astype(np.uint8), pixels, order=0)
        plane[:] = known * np.clip(np.round(1 + 254 * level), 1, 255)
    return planes, limits[:, :1] + step * n[:, None] * [0, 1], n_bins


def epoch_names(times):
    """Return the shortest date of each epoch that no other epoch has."""
    dates = [date.replace("T", " ") for date in times.isot]
    names = [f"{date} ({k})" for k, date in enumerate(dates)]
    for length in (23, 19, 16, 10):
        short = [date[:length] for date in dates]
        own = [short.count(name) == 1 for name in short]
        names = np.where(own, short, names).tolist()
    return names


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
    SSPs are ``used``, and a ``weight`` that is small for SSPs close to the noise.
    """
    if ssps is None:
        return None
    used = np.ones(len(ssps), bool)
    if isinstance(ssps, SSPs):
        place = np.stack(ssp_offsets(ssps, cube))
        epoch, scale, snr = ssps.epoch, ssps.scale, ssps.snr
    else:
        place = sky_place(ssps)
        epoch, scale, snr = (np.asarray(ssps[n]) for n in ("epoch", "scale", "snr"))
        if "in_region" in ssps.colnames:
            used = np.asarray(ssps["in_region"], bool)
    weight = 0.05 + np.log(snr / snr.min(initial=np.inf))
    points = {"place": place, "epoch": epoch, "scale": scale}
    return points | {"used": used, "weight": weight}


def draw_ssps(ax, view, ssps, epoch, size=1.0):
    """Draw the SSPs of an epoch, with labels for all scales of the cube."""
    if ssps is None:
        return
    hollow = {"linestyle": "", "marker": "o", "markerfacecolor": "none"}
    points = view.points
    colors = style.scale_colors(points["scale"])
    for rank, (scale, color) in enumerate(colors.items()):
        here = (points["epoch"] == epoch) & (points["scale"] == scale)
        label = _scale_label(view, scale, rank == 0, rank == len(colors) - 1)
        if isinstance(ssps, SSPs):
            line = {"color": color, "linewidth": 0.7 + 0.4 * rank, "label": label}
            _draw_outlines(ax, view, ssps, np.flatnonzero(here), **line)
            continue
        for used, alpha in ((True, 1.0), (False, 0.3)):
            ax.plot(
                *view.place[:, here & (points["used"] == used)],
                markersize=(4.0 + 3.0 * rank) * size, markeredgecolor=color,
                markeredgewidth=1.1, alpha=alpha, gid=f"ssps {scale:g}",
                label=label if used else None, **hollow,
            )  # fmt: skip
    if not np.all(points["used"]):
        pale = {"alpha": 0.4, "mec": style.GREY, "label": "not used"}
        ax.plot([], [], ms=6.25 * size, **pale, **hollow)


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
    edges = []
    for axis, back in enumerate(np.eye(2)):
        end = np.argwhere(np.diff(label, axis=axis))[:, ::-1] - 0.5
        edges.append(np.stack([end - back, end], axis=1))
    offsets = view.cube.pixel_to_offset(*np.moveaxis(np.concatenate(edges), -1, 0))
    lines = np.stack(offsets, axis=-1).to_value(view.unit)
    ax.add_collection(LineCollection(lines, gid="outlines", **line), autolim=False)
