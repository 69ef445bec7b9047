# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A page with linked panels that shows which features make a velocity."""

import re
from importlib import resources
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.wcs import WCS

from astro_scc.images.positions import sky_columns
from astro_scc.streams.members import PRIOR, SCATTER
from astro_scc.units import PM_UNIT, offset_unit, unit_name
from astro_scc.visualization import images, style, velocity
from astro_scc.writing import replace_when_complete

try:
    import bokeh.models as models
    from bokeh.document import Document
    from bokeh.embed import file_html
    from bokeh.palettes import Greys256, RdBu11, interp_palette
    from bokeh.plotting import figure
    from bokeh.resources import INLINE
except ImportError:
    raise ImportError("explore needs bokeh; pip install bokeh") from None

#: Pixels of the images of all epochs, a byte each: with them a page of up to some
#: thousand features stays below 5 MB, of which 2 MB are the library.
PIXELS = 2_200_000
#: Markers of the streams in turn, so that colour is not all that tells them apart.
MARKERS = ("circle", "square", "triangle", "diamond", "inverted_triangle", "hex")
#: Names of the lines of figures, and those of the kinds of streams.
DASH = {"-": "solid", "--": "dashed", ":": "dotted", "-.": "dotdash"}
DASHES = {kind: DASH[line] for kind, line in style.KIND_LINES.items()}
#: Names of the panels in explore.html.
PANELS = "choose", "velocity", "sky", "diagram", "time", "table"
#: Height of a panel in CSS pixels; opacity of what is not selected.
HEIGHT, FADED = 400, 0.07
YEAR = u.yr.to(u.ms)
WIDE = {"sizing_mode": "stretch_width"}


def write_explore(path, streams, features, hdus, *, cube=None, notes=()):
    """
    Write a page with linked panels of velocities, images, times and features.

    Parameters
    ----------
    path : path
        The HTML file, which is replaced if it exists.
    streams, features : `~astropy.table.QTable`
        As in the products of a measurement.
    hdus : `~astropy.io.fits.HDUList`
        The content of ``scc.fits``.
    cube : `~astro_scc.EpochCube`, optional
        The images; without them, the page has no sliders.
    notes : sequence of str, optional
        What the reader must know, without a full stop.

    Returns
    -------
    `~pathlib.Path`

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    page = Page(streams, features, hdus, cube)
    document = page.document()
    name = hdus[0].header.get("OBJECT", "")
    title = f"{name}: features and velocities" if name else "Features and velocities"
    template = resources.files("astro_scc.visualization").joinpath("explore.html")
    text = file_html(
        document, INLINE, title, template=template.read_text(encoding="utf-8"),
        template_variables={"notes": [*notes, *page.notes], "cube": cube},
    )  # fmt: skip
    path = Path(path)
    with replace_when_complete(path, overwrite=True) as part:
        part.write_text(text, encoding="utf-8")
    return path


class Page:
    """
    The panels of the page, and the two sources of data that they share.

    Each row of ``features`` is a feature, each row of ``points`` one at an epoch.
    """

    def __init__(self, streams, features, hdus, cube):
        self.streams, self.hdus, self.cube, self.notes = streams, hdus, cube, []
        self.kinds = streams["kind"].tolist()
        self.angle = hdus["DIAGRAM"].header.get("DISPPA")
        self.slopes = velocity.ray_slopes(streams, self.kinds, self.angle)
        self.table, self.seen = features, QTable.read(hdus["FEATURES"])
        #: Row in the table of each point.
        self.row = np.searchsorted(features["feature"], self.seen["feature"])
        self.pm_unit = streams["pm"].unit
        #: Where longitude and latitude increase, as the columns describe it.
        about = [streams[k].info.description for k in sky_columns(streams)]
        self.words = [re.sub(r"^.* to (the )?", "", text or "") for text in about]
        #: Offsets in mas, shape (2, n).
        self.place = images.sky_place(self.seen)
        self.length = offset_unit(np.hypot(*self.place).max(initial=0.0) or 1.0)
        #: Rows of the features of each stream.
        of = np.asarray(features["stream"])
        self.rows = [np.flatnonzero(of == n).tolist() for n in streams["stream"]]
        points = self._point_columns()
        self.features = models.ColumnDataSource(self._feature_columns(points))
        self.points = models.ColumnDataSource(points)
        if cube is not None:
            self.dates = images.epoch_names(cube.times)
            self.points.data["date"] = [self.dates[k] for k in self.seen["epoch"]]
            #: Selects what belongs to the epoch that is shown.
            self.here = models.GroupFilter(column_name="date", group=self.dates[0])

    # -- data ----------------------------------------------------------------------

    def _look(self, numbers):
        """Return columns for the look of what belongs to streams."""
        kinds = dict(zip(self.streams["stream"], self.kinds, strict=True))
        return {
            "color": [style.component_color(n) if n else style.GREY for n in numbers],
            "marker": [MARKERS[(n - 1) % len(MARKERS)] if n else "x" for n in numbers],
            "label": [f"{n}: {kinds[n]}" if n else "of no stream" for n in numbers],
        }

    def _feature_columns(self, points):
        table = self.table
        motion = np.stack([table[k].to_value(PM_UNIT) for k in sky_columns(table)])
        # One row of each feature has its velocity on the axes of the map.
        first = self.seen[np.searchsorted(self.row, np.arange(len(table)))]
        if self.angle is None:
            along = first["pm_axis1"].to_value(PM_UNIT)
        else:
            angle = np.radians(self.angle)
            along = np.array([np.sin(angle), np.cos(angle)]) @ motion
        to_length, to_time = u.mas.to(self.length), u.yr.to(self.pm_unit.bases[1])
        columns = {name: [] for name in ("xs", "ys", "ts", "ds", "ld", "rx", "ry")}
        for k, ray in enumerate(along):
            at = self.row == k
            x, y, t, d = (points[name][at] for name in "xytd")
            years = (t - t[0]) / YEAR
            moved = motion[:, k, None] * years
            # Outliers are not of the line.
            start = np.median(self.place[:, at] - moved, axis=1)
            line = np.hypot(*(start[:, None] + moved)) * to_length
            seen = years[[0, -1]]
            parts = x, y, t, d, line, seen * to_time, ray * seen * to_length
            for name, values in zip(columns, parts, strict=True):
                columns[name].append(np.round(values, 5).tolist())
        speeds = {"pm": table, "pm_err": table, "pm_axis1": first, "pm_axis2": first}
        columns |= {k: of[k].to_value(self.pm_unit) for k, of in speeds.items()}
        for name in ("feature", "stream", "n_epochs", "p_false"):
            columns[name] = np.asarray(table[name])
        columns["secure"] = ["yes" if secure else "no" for secure in table["secure"]]
        longest = max((t[-1] - t[0] for t in columns["ts"]), default=0.0)
        digits = 10 if longest > YEAR / 12 else 16
        for name in ("first", "last"):
            columns[name] = [str(day)[:digits].replace("T", " ") for day in table[name]]
        columns["separation"] = table["separation"].to_value(self.length)
        return columns | self._look(table["stream"])

    def _point_columns(self):
        x, y = (self.place * u.mas).to_value(self.length)
        time = np.array(self.seen["date"], "datetime64[ms]").astype(float)
        columns = {"row": self.row, "x": x, "y": y, "t": time, "d": np.hypot(x, y)}
        return columns | self._look(self.table["stream"][self.row])

    # -- parts of panels -----------------------------------------------------------

    def _figure(self, x_label, y_label, *, on_sky=False, **options):
        plot = figure(
            height=HEIGHT, tools="pan,wheel_zoom,reset", toolbar_location="right",
            x_axis_label=x_label, y_axis_label=y_label, **WIDE, **options,
        )  # fmt: skip
        plot.toolbar.logo = None
        plot.axis.axis_label_text_font_style = "normal"
        if on_sky:
            plot.x_range.flipped = not self.words[0].startswith("solar")
        return plot

    def _lines(self, plot, x, y, width=1.2, alpha=0.45):
        return plot.multi_line(
            x, y, source=self.features, line_color="color", line_width=width,
            line_alpha=alpha, nonselection_alpha=FADED, selection_line_alpha=1,
        )  # fmt: skip

    def _dots(self, plot, x, y, size=4, source=None, **more):
        return plot.scatter(
            x, y, source=source or self.points, marker="marker", size=size,
            fill_color="color", line_color="color", alpha=0.7, selection_alpha=1,
            nonselection_alpha=FADED, **more,
        )  # fmt: skip

    def _now(self, plot, x, y):
        """Mark the features at the epoch that is shown."""
        if self.cube is not None:
            now = self._dots(plot, x, y, 12, view=models.CDSView(filter=self.here))
            for glyph in (now.glyph, now.selection_glyph):
                glyph.update(fill_alpha=0.25, line_alpha=1, line_width=2)

    def _tools(self, plot, hovered, boxed=None):
        """Let a box select, and say what is under the pointer."""
        speed = f"@pm{{0.000}} ± @pm_err{{0.000}} {unit_name(self.pm_unit)}"
        tips = [
            ("feature", "@feature of stream @stream"),
            ("seen", "@n_epochs times, @first to @last"),
            ("speed", speed),
            ("secure", "@secure, p_false @p_false{0.00}"),
        ]
        plot.add_tools(models.HoverTool(renderers=[hovered], tooltips=tips))
        if boxed is not None:
            box = models.BoxSelectTool(renderers=[boxed])
            plot.add_tools(box)
            plot.toolbar.active_drag = box

    def _call(self, function, **objects):
        """Return a callback to a function of the page's script."""
        call = f"explore.{function}({', '.join(objects)})"
        return models.CustomJS(args=objects, code=call)

    # -- panels --------------------------------------------------------------------

    def document(self):
        """Return the document with all panels."""
        features, points, document = self.features, self.points, Document()
        both = {"features": features, "points": points}
        # Equal indices are no change, so the two do not call each other for ever.
        points.selected.js_on_change("indices", self._call("toFeatures", **both))
        features.selected.js_on_change("indices", self._call("toPoints", **both))
        text, unit = models.Div(), unit_name(self.pm_unit)
        summary = self._call(
            "summary", features=features, text=text, unit=unit, prior=PRIOR,
            scatter=SCATTER,
        )  # fmt: skip
        features.selected.js_on_change("indices", summary)
        document.js_on_event("document_ready", summary)
        panels = [self._choose(text), self._velocity(), self._sky(), self._diagram()]
        panels += [self._time(), self._features_table()]
        for name, panel in zip(PANELS, panels, strict=True):
            panel.name = name
            document.add_root(panel)
        return document

    def _choose(self, text):
        """Return a button for each stream, and the text on what is selected."""
        buttons = {models.Button(label="all features"): []}
        for row, kind, rows in zip(self.streams, self.kinds, self.rows, strict=True):
            label = f"{row['stream']}: {velocity.speed_text(row, kind)}"
            buttons[models.Button(label=label, disabled=not rows)] = rows
        for button, rows in buttons.items():
            chosen = self._call("choose", features=self.features, rows=rows)
            button.js_on_event("button_click", chosen)
        row = models.Row(*buttons, stylesheets=[":host {flex-wrap: wrap}"], **WIDE)
        return models.Column(row, text, **WIDE)

    def _velocity(self):
        header = self.hdus[0].header
        axes = [header[f"CNAME{k}"] for k in (1, 2)]
        labels = velocity.velocity_labels(axes, self.words, self.pm_unit)
        on_sky = axes[0] in velocity.SKY
        names = velocity.axis_columns(self.streams, on_sky=on_sky)
        plot = self._figure(*labels, on_sky=on_sky, match_aspect=True)
        data = np.round(np.nan_to_num(self.hdus[0].data), 3).astype(np.float32)
        highest = float(data.max()) if data.max() > 0 else 1.0
        mapper = models.LinearColorMapper("Cividis256", low=0.0, high=highest)
        corners = np.array([[-0.5, -0.5], np.array(data.shape[::-1]) - 0.5])
        corners = WCS(header).wcs_pix2world(corners, 0) * PM_UNIT
        (x, y), (right, top) = corners.to_value(self.pm_unit)
        plot.image([data], x=x, y=y, dw=right - x, dh=top - y, color_mapper=mapper)
        look = {"height": 8, "title_text_font_style": "normal"}
        look |= {"title": velocity.EXCESS, "color_mapper": mapper}
        plot.add_layout(models.ColorBar(**look), "above")
        rest = plot.scatter([0], [0], marker="cross", size=12, line_color="white")
        dots = self._dots(plot, "pm_axis1", "pm_axis2", 8, self.features)
        for glyph in (dots.glyph, dots.selection_glyph):
            glyph.update(line_color="white", line_width=0.8)
        peaks, circles = self._draw_peaks(plot, names)
        for axis in (plot.x_range, plot.y_range):
            axis.update(renderers=[rest, dots, circles], range_padding=0.3)
        plot.add_tools(models.TapTool(renderers=[circles]))
        tapped = self._call("peak", peaks=peaks, features=self.features)
        peaks.selected.js_on_change("indices", tapped)
        self._tools(plot, dots, dots)
        return plot

    def _draw_peaks(self, plot, names):
        """Draw the streams with their errors; return their source and symbols."""
        columns = {"rows": self.rows, "dash": [DASHES[kind] for kind in self.kinds]}
        columns["number"] = [str(n) for n in self.streams["stream"]]
        for field, width, name in zip(("v1", "v2"), "wh", names, strict=True):
            columns[field] = self.streams[name].to_value(self.pm_unit)
            error = self.streams[f"{name}_err"].to_value(self.pm_unit)
            columns[width] = 2 * np.nan_to_num(error)
        peaks = models.ColumnDataSource(columns)
        for color, width in (("black", 3.5), ("white", 1.5)):
            line = {"line_color": color, "line_width": width, "line_dash": "dash"}
            line |= {"fill_color": None, "source": peaks}
            plot.ellipse("v1", "v2", width="w", height="h", **line)
            circles = plot.scatter("v1", "v2", size=18, **line)
        plot.text(
            "v1", "v2", "number", source=peaks, x_offset=11, y_offset=-7,
            text_color="white", text_outline_color="black", text_font_style="bold",
            text_font_size="18px",
        )  # fmt: skip
        return peaks, circles

    def _sky(self):
        """Return the images with the features, and the sliders."""
        labels = images.axis_labels("Offset", self.words, self.length)
        plot = self._figure(*labels, on_sky=True, match_aspect=True)
        plot.x_range.range_padding = plot.y_range.range_padding = 0.02
        image = None if self.cube is None else self._draw_images(plot)
        paths = self._lines(plot, "xs", "ys")
        dots = self._dots(plot, "x", "y", 3)
        self._now(plot, "x", "y")
        self._tools(plot, paths, dots)
        plot.x_range.renderers = plot.y_range.renderers = [image or dots]
        if image is None:
            return plot
        first, second = (
            models.CategoricalSlider(title=k, categories=self.dates, value=date, **WIDE)
            for k, date in (("Epoch", self.dates[0]), ("Other epoch", self.dates[-1]))
        )
        first.js_link("value", self.here, "group")
        toggle = models.Toggle(label="blink", width=80, align="center")
        # The guidelines WCAG 2.3.1 allow at most three flashes a second.
        what = {"toggle": toggle, "first": first, "second": second, "interval": 600}
        toggle.js_on_change("active", self._call("blink", **what))
        sliders = models.Row(models.Column(first, second, **WIDE), toggle, **WIDE)
        return models.Column(plot, sliders, **WIDE)

    def _draw_images(self, plot):
        near = {"place": self.place, "weight": np.ones(len(self.seen))}
        limits = images.image_limits(self.cube, near, 0.0)
        planes, sides, n_bins = images.image_planes(self.cube, limits, PIXELS)
        if n_bins > 1:
            self.notes.append(f"the images are binned by {n_bins} x {n_bins} pixels")
        sides = (sides * u.mas).to_value(self.length)
        (x, y), (width, height) = sides[:, 0], np.diff(sides)[:, 0]
        greys = (images.MASKED, *Greys256[:0:-1])
        mapper = models.LinearColorMapper(greys, low=0, high=255)
        source = models.ColumnDataSource({"image": list(planes), "date": self.dates})
        return plot.image(
            "image", x=x, y=y, dw=width, dh=height, color_mapper=mapper,
            source=source, view=models.CDSView(filter=self.here),
        )  # fmt: skip

    def _diagram(self):
        hdu, bins = self.hdus["DIAGRAM"], self.hdus["INTERVALS"].data
        used = bins["n_pairs"] > 0
        years, excess = bins["interval"][used].astype(float), hdu.data[:, used]
        half = hdu.header["CDELT2"] * len(excess) / 2
        longest = velocity.longest_interval(years, self.slopes, self.kinds, half)
        time = self.pm_unit.bases[1]
        right, top = u.yr.to(time, longest), u.mas.to(self.length, half)
        plot = self._figure(
            f"Interval between epochs ({unit_name(time)})",
            f"Displacement ({unit_name(self.length)})",
            x_range=(0, right), y_range=(-top, top),
        )  # fmt: skip
        level = velocity.diagram_levels(years, excess, longest, 240)
        colors = interp_palette(RdBu11, 255)
        mapper = models.LinearColorMapper(colors, low=-127, high=127)
        size = {"dw": right, "dh": 2 * top}
        plot.image([level], x=0, y=-top, color_mapper=mapper, **size)
        lines = self._lines(plot, "rx", "ry")
        middle = {"text_align": "center", "text_baseline": "middle"}
        numbers = self.streams["stream"]
        for number, slope, kind in zip(numbers, self.slopes, self.kinds, strict=True):
            end = min(longest, half / abs(slope)) if slope else longest
            ray = np.array([u.yr.to(time, end), u.mas.to(self.length, slope * end)])
            look = {"line_color": "black", "line_dash": DASHES[kind]}
            plot.line(*np.outer(ray, [0, 1]), line_width=2.5, **look)
            at = 0.88 * ray[:, None]
            plot.scatter(*at, size=19, fill_color="white", line_color="black")
            plot.text(*at, [str(number)], text_font_size="13px", **middle)
        self._tools(plot, lines)
        return plot

    def _time(self):
        label = f"Core separation ({unit_name(self.length)})"
        plot = self._figure("Date", label, x_axis_type="datetime")
        self._lines(plot, "ts", "ds", 0.8)
        lines = self._lines(plot, "ts", "ld", 1.6, 0.7)
        dots = self._dots(plot, "t", "d", 5, legend_group="label")
        self._now(plot, "t", "d")
        self._tools(plot, lines, dots)
        if len(self.seen):
            plot.add_layout(plot.legend[0], "above")
            plot.legend.orientation = "horizontal"
        return plot

    def _features_table(self):
        speed, length = unit_name(self.pm_unit), unit_name(self.length)
        shown = (
            ("feature", "feature", "0", 55), ("stream", "stream", "0", 80),
            ("n_epochs", "epochs", "0", 55), ("first", "first", None, 95),
            ("last", "last", None, 95),
            ("separation", f"separation ({length})", "0.00", 115),
            ("pm", f"pm ({speed})", "0.000", 110), ("pm_err", "error", "0.000", 60),
            ("p_false", "p_false", "0.00", 60), ("secure", "secure", None, 60),
        )  # fmt: skip
        columns = []
        for field, title, form, width in shown:
            columns.append(models.TableColumn(field=field, title=title, width=width))
            if form is not None:
                columns[-1].formatter = models.NumberFormatter(format=form)
        return models.DataTable(
            source=self.features, columns=columns, height=260, index_position=None,
            reorderable=False, selectable="checkbox", **WIDE,
        )  # fmt: skip
