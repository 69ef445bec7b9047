# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A page with linked panels that shows which features make a velocity."""

import re
from importlib import import_module, resources
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.wcs import WCS

from astro_scc.epochs.positions import sky_columns
from astro_scc.partial import replace_when_complete
from astro_scc.quantities import with_error
from astro_scc.stacking.dispersion import error_of_speed
from astro_scc.units import PM_UNIT, offset_unit, speed_unit, time_unit, unit_name
from astro_scc.visualization import drawing, style, velocity

#: Pixels of the images of all epochs, a byte each, and the largest number of features:
#: with them a page stays below 5 MB, of which 2 MB are the library.
PIXELS, FEATURES = 2_200_000, 1000
#: Number of columns of the diagram, which is resampled to equal intervals.
COLUMNS = 240
#: Markers of the components in turn, so that colour is not all that tells them apart.
MARKERS = ("circle", "square", "triangle", "diamond", "inverted_triangle", "hex")
DASHES = {"moving": "solid", "stationary": "dashed", "not significant": "dotted"}
#: Milliseconds for which each of two epochs is shown; the accessibility guidelines
#: WCAG 2.3.1 allow at most three flashes a second.
BLINK = 600
#: Height of a panel in CSS pixels; opacity of what is not selected.
HEIGHT, FADED = 400, 0.07
YEAR = u.yr.to(u.ms)


def load_bokeh():
    """Return ``bokeh.models``; an ImportError says how to install bokeh."""
    try:
        return import_module("bokeh.models")
    except ImportError:
        raise ImportError(
            "explore needs bokeh; install it: pip install 'astro_scc[explore]'"
        ) from None


def write_explore(path, components, features, ssps, hdus, *, cube=None, notes=()):
    """
    Write a page with linked panels of velocities, images, times and features.

    Parameters
    ----------
    path : path
        The HTML file, which is replaced if it exists.
    components, features, ssps : `~astropy.table.QTable`
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
    ImportError
        If bokeh is not installed.
    OSError
        If the file cannot be written.
    """
    load_bokeh()
    from bokeh.embed import file_html
    from bokeh.resources import INLINE

    page = Page(components, features, ssps, hdus, cube)
    document = page.document()
    name = hdus[0].header.get("OBJECT", "")
    template = resources.files("astro_scc.visualization").joinpath("explore.html")
    title = f"{name}: features and velocities" if name else "Features and velocities"
    text = file_html(
        document,
        INLINE,
        title,
        template=template.read_text(encoding="utf-8"),
        template_variables={
            "notes": [*notes, *page.notes],
            "has_images": cube is not None,
        },
    )
    path = Path(path)
    with replace_when_complete(path, overwrite=True) as part:
        part.write_text(text, encoding="utf-8")
    return path


class Page:
    """
    The panels of the page, and the two sources of data that they share.

    Each row of ``features`` is a feature, each row of ``points`` one at an epoch.
    """

    def __init__(self, components, features, ssps, hdus, cube):
        self.models = load_bokeh()
        self.components, self.hdus, self.cube, self.notes = components, hdus, cube, []
        self.kinds = style.component_kinds(components)
        seen = QTable.read(hdus["FEATURES"])
        if len(features) > FEATURES:
            longest = np.argsort(-features["n_epochs"], kind="stable")[:FEATURES]
            n = f"{FEATURES} of {len(features)}"
            self.notes.append(f"the {n} features that were seen in most epochs")
            features = features[np.sort(longest)]
            seen = seen[np.isin(seen["feature"], features["feature"])]
        self.table, self.seen = features, seen
        #: Row in the table of each point.
        self.row = np.searchsorted(features["feature"], seen["feature"])
        speeds = [t["pm"].to_value(PM_UNIT) for t in (components, features)]
        self.pm_unit = speed_unit(np.abs(np.concatenate(speeds)).max(initial=0.0))
        #: Offsets in mas, shape (2, n).
        self.place = drawing.ssp_place(ssps)[:, seen["ssp"]]
        self.sky_unit = offset_unit(np.abs(self.place).max(initial=0.0) or 1.0)
        # Outward is positive, as in the figures.
        distance = seen["distance"].to_value(u.mas)
        total = np.bincount(self.row, distance, len(features))
        self.sign = np.where(total < 0, -1.0, 1.0)
        self.length = offset_unit(np.abs(distance).max(initial=0.0) or 1.0)
        self.features = self.models.ColumnDataSource(self._feature_columns())
        self.points = self.models.ColumnDataSource(self._point_columns())
        self.here = None
        if cube is not None:
            self.dates = drawing.epoch_names(cube.times)
            self.points.data["date"] = [self.dates[k] for k in seen["epoch"]]
            self.here = self.models.GroupFilter(column_name="date", group=self.dates[0])

    # -- data ----------------------------------------------------------------------

    def _look(self, numbers):
        """Return columns for the look of what belongs to components."""
        kinds = dict(zip(self.components["component"], self.kinds, strict=True))
        return {
            "color": [style.component_color(int(n)) for n in numbers],
            "marker": [MARKERS[(int(n) - 1) % len(MARKERS)] for n in numbers],
            "label": [f"{n}: {kinds[n]}" for n in numbers],
        }

    def _feature_columns(self):
        table, speed = self.table, self.table["pm"].to_value(self.length / u.yr)
        points = self._point_columns()
        # Speeds are positive along the first component.
        towards = -1.0 if np.any(self._slopes()[:1] < 0) else 1.0
        columns = {name: [] for name in ("xs", "ys", "ts", "ds", "lt", "ld", "ry")}
        for k, sign in enumerate(self.sign):
            own = self.row == k
            x, y, t, d = (points[name][own] for name in "xytd")
            years = (t - t[0]) / YEAR
            # Positions near a standing feature are not of the line.
            middle = np.median(sign * d - speed[k] * years)
            line = sign * (middle + speed[k] * years[[0, -1]])
            ray = towards * speed[k] * years[[0, -1]]
            parts = x, y, t, d, t[[0, -1]], line, ray
            for name, values in zip(columns, parts, strict=True):
                columns[name].append(np.round(values, 5).tolist())
        for name in ("pm", "pm_err", "pm_transverse", "pm_axis1", "pm_axis2"):
            columns[name] = table[name].to_value(self.pm_unit)
        columns["error"] = error_of_speed(columns["pm"], columns["pm_err"])
        for name in ("feature", "component", "scale", "n_epochs"):
            columns[name] = np.asarray(table[name])
        longest = max((t[-1] - t[0] for t in columns["ts"]), default=0.0)
        digits = 10 if longest > YEAR / 12 else 16
        for name in ("first", "last"):
            columns[name] = [str(day)[:digits].replace("T", " ") for day in table[name]]
        columns["distance"] = np.abs(table["distance"].to_value(self.length))
        return columns | self._look(table["component"])

    def _point_columns(self):
        x, y = (self.place * u.mas).to_value(self.sky_unit)
        time = np.array(self.seen["date"], "datetime64[ms]").astype(float)
        distance = self.sign[self.row] * self.seen["distance"].to_value(self.length)
        columns = {"row": self.row, "x": x, "y": y, "t": time, "d": distance}
        return columns | self._look(self.seen["component"])

    def _slopes(self):
        """Return the speeds of the components along the displacement, in mas/yr."""
        angle = self.hdus["DIAGRAM"].header.get("DISPPA")
        slopes = self.components["pm_parallel"].to_value(PM_UNIT)
        if angle is not None:
            sky = [self.components[k] for k in sky_columns(self.components)]
            east, north = (v.to_value(PM_UNIT) for v in sky)
            angle = np.radians(angle)
            slopes = east * np.sin(angle) + north * np.cos(angle)
        return np.where(np.array(self.kinds) == "stationary", 0.0, slopes)

    def _rows(self):
        """Return the rows of the features of each component."""
        own = np.asarray(self.table["component"])
        return [np.flatnonzero(own == n).tolist() for n in self.components["component"]]

    def _words(self):
        """Return where longitude and latitude increase, as the columns describe it."""
        about = (self.components[k].info for k in sky_columns(self.components))
        return [re.sub(r"^.* to (the )?", "", i.description or "") for i in about]

    # -- parts of panels -----------------------------------------------------------

    def _figure(self, x_label, y_label, *, on_sky=False, **options):
        from bokeh.plotting import figure

        if on_sky or options.get("match_aspect"):
            left = on_sky and not self._words()[0].startswith("solar")
            follow = self.models.DataRange1d
            options |= {"x_range": follow(flipped=left), "y_range": follow()}
        plot = figure(
            height=HEIGHT, sizing_mode="stretch_width", tools="pan,wheel_zoom,reset",
            x_axis_label=x_label, y_axis_label=y_label, toolbar_location="right",
            **options,
        )  # fmt: skip
        plot.toolbar.logo = None
        plot.axis.axis_label_text_font_style = "normal"
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
        if self.here is not None:
            view = self.models.CDSView(filter=self.here)
            now = self._dots(plot, x, y, 12, view=view)
            for glyph in (now.glyph, now.selection_glyph):
                glyph.update(fill_alpha=0.25, line_alpha=1, line_width=2)

    def _tools(self, plot, hovered, boxed=None):
        """Let a box select, and say what is under the pointer."""
        unit = unit_name(self.pm_unit)
        tips = [
            ("feature", "@feature of component @component, scale @scale"),
            ("seen", "@n_epochs times, @first to @last"),
            ("speed", f"@pm{{0.000}} ± @pm_err{{0.000}} {unit}"),
        ]
        plot.add_tools(self.models.HoverTool(renderers=[hovered], tooltips=tips))
        if boxed is not None:
            box = self.models.BoxSelectTool(renderers=[boxed])
            plot.add_tools(box)
            plot.toolbar.active_drag = box

    def _call(self, function, **objects):
        """Return a callback to a function of the page's script."""
        call = f"explore.{function}({', '.join(objects)})"
        return self.models.CustomJS(args=objects, code=call)

    # -- panels --------------------------------------------------------------------

    def document(self):
        """Return the document with all panels."""
        from bokeh.document import Document

        features, points, document = self.features, self.points, Document()
        both = {"features": features, "points": points}
        # Equal indices are no change, so the two do not call each other for ever.
        points.selected.js_on_change("indices", self._call("toFeatures", **both))
        features.selected.js_on_change("indices", self._call("toPoints", **both))
        text, unit = self.models.Div(), unit_name(self.pm_unit)
        summary = self._call("summary", features=features, text=text, unit=unit)
        features.selected.js_on_change("indices", summary)
        document.js_on_event("document_ready", summary)
        panels = {
            "choose": self._choose(text),
            "velocity": self._velocity(),
            "sky": self._sky(),
            "diagram": self._diagram(),
            "time": self._time(),
            "table": self._features_table(),
        }
        for name, panel in panels.items():
            panel.name = name
            document.add_root(panel)
        return document

    def _choose(self, text):
        """Return a button for each component, and the text on what is selected."""
        models, choices = self.models, {"all features": []}
        rows = zip(self.components, self.kinds, self._rows(), strict=True)
        for row, kind, own in rows:
            pm, error = (row[k].to_value(self.pm_unit) for k in ("pm", "pm_err"))
            speed = with_error(pm, error if np.isfinite(error) else 0.0)
            label = f"{row['component']}: {kind}, {speed} {unit_name(self.pm_unit)}"
            choices[label] = own
        buttons = [
            models.Button(label=label, disabled=bool(k) and not own)
            for k, (label, own) in enumerate(choices.items())
        ]
        for button, own in zip(buttons, choices.values(), strict=True):
            args = {"selected": self.features.selected, "rows": own}
            code = "selected.indices = rows"
            button.js_on_event("button_click", models.CustomJS(args=args, code=code))
        wide = {"sizing_mode": "stretch_width"}
        buttons = models.Row(*buttons, stylesheets=[":host {flex-wrap: wrap}"], **wide)
        return models.Column(buttons, text, **wide)

    def _velocity(self):
        models, header, unit = self.models, self.hdus[0].header, unit_name(self.pm_unit)
        axes = [header[f"CNAME{k}"] for k in (1, 2)]
        labels = [f"{velocity.AXIS_LABELS.get(axis, axis)} ({unit})" for axis in axes]
        names, on_sky = ("pm_parallel", "pm_transverse"), axes[0] in ("east", "lon")
        if on_sky:
            names = sky_columns(self.components)
            labels = drawing.axis_labels("Proper motion", self._words(), self.pm_unit)
        plot = self._figure(*labels, on_sky=on_sky, match_aspect=True)
        data = np.round(np.nan_to_num(self.hdus[0].data), 3).astype(np.float32)
        highest = float(data.max()) if data.max() > 0 else 1.0
        mapper = models.LinearColorMapper("Cividis256", low=0.0, high=highest)
        corners = np.array([[-0.5, -0.5], np.array(data.shape[::-1]) - 0.5])
        corners = WCS(header).wcs_pix2world(corners, 0) * PM_UNIT
        (x, y), (right, top) = corners.to_value(self.pm_unit)
        plot.image([data], x=x, y=y, dw=right - x, dh=top - y, color_mapper=mapper)
        label = velocity.MAP_LABELS["coefficient"]
        bar = models.ColorBar(color_mapper=mapper, height=8, title=label)
        bar.title_text_font_style = "normal"
        plot.add_layout(bar, "above")
        rest = plot.scatter([0], [0], marker="cross", size=12, line_color="white")
        dots = self._dots(plot, "pm_axis1", "pm_axis2", 8, self.features)
        for glyph in (dots.glyph, dots.selection_glyph):
            glyph.update(line_color="white", line_width=0.8)
        columns = {"rows": self._rows(), "dash": [DASHES[k] for k in self.kinds]}
        columns["number"] = [str(n) for n in self.components["component"]]
        for field, width, name in zip(("v1", "v2"), "wh", names, strict=True):
            columns[field] = self.components[name].to_value(self.pm_unit)
            error = self.components[f"{name}_err"].to_value(self.pm_unit)
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
        for axis in (plot.x_range, plot.y_range):
            axis.update(renderers=[rest, dots, circles], range_padding=0.3)
        plot.add_tools(models.TapTool(renderers=[circles]))
        tapped = self._call("peak", peaks=peaks, features=self.features)
        peaks.selected.js_on_change("indices", tapped)
        self._tools(plot, dots, dots)
        return plot

    def _sky(self):
        """Return the images with the features, and the sliders."""
        models = self.models
        labels = drawing.axis_labels("Offset", self._words(), self.sky_unit)
        plot = self._figure(*labels, on_sky=True, match_aspect=True)
        plot.x_range.range_padding = plot.y_range.range_padding = 0.02
        image = self._draw_images(plot) if self.here is not None else None
        paths = self._lines(plot, "xs", "ys")
        dots = self._dots(plot, "x", "y", 3)
        self._now(plot, "x", "y")
        self._tools(plot, paths, dots)
        plot.x_range.renderers = plot.y_range.renderers = [image or dots]
        if image is None:
            return plot
        wide = {"sizing_mode": "stretch_width"}
        ends = {"Epoch": self.dates[0], "Other epoch": self.dates[-1]}
        first, second = (
            models.CategoricalSlider(title=k, categories=self.dates, value=date, **wide)
            for k, date in ends.items()
        )
        first.js_link("value", self.here, "group")
        toggle = models.Toggle(label="blink", width=80, align="center")
        what = {"toggle": toggle, "first": first, "second": second, "interval": BLINK}
        toggle.js_on_change("active", self._call("blink", **what))
        sliders = models.Row(models.Column(first, second, **wide), toggle, **wide)
        return models.Column(plot, sliders, **wide)

    def _draw_images(self, plot):
        near = None
        if len(self.seen):
            ends = np.stack([self.place.min(axis=1), self.place.max(axis=1)], axis=1)
            near = {"place": ends, "weight": np.ones(2)}
        limits = drawing.image_limits(self.cube, near)
        planes, sides, n_bins = drawing.image_planes(self.cube, limits, PIXELS)
        if n_bins > 1:
            self.notes.append(f"the images are binned by {n_bins} x {n_bins} pixels")
        sides = (sides * u.mas).to_value(self.sky_unit)
        (x, y), (width, height) = sides[:, 0], np.diff(sides)[:, 0]
        greys = [f"#{v:02x}{v:02x}{v:02x}" for v in range(255, 0, -1)]
        mapper = self.models.LinearColorMapper(
            [drawing.MASKED, *greys], low=0, high=255
        )
        images = {"image": list(planes), "date": self.dates}
        return plot.image(
            "image", x=x, y=y, dw=width, dh=height, color_mapper=mapper,
            source=self.models.ColumnDataSource(images),
            view=self.models.CDSView(filter=self.here),
        )  # fmt: skip

    def _diagram(self):
        from matplotlib import colormaps
        from matplotlib.colors import to_hex

        hdu, bins = self.hdus["DIAGRAM"], self.hdus["INTERVALS"].data
        used = bins["n_pairs"] > 0
        years, excess = bins["interval"][used].astype(float), hdu.data[:, used]
        half, slopes = hdu.header["CDELT2"] * len(excess) / 2, self._slopes()
        longest = drawing.longest_interval(years, slopes, self.kinds, half)
        time = time_unit(longest)
        right, top = longest * u.yr.to(time), half * u.mas.to(self.length)
        ranged = self.models.Range1d
        plot = self._figure(
            f"Interval between epochs ({unit_name(time)})",
            f"Displacement ({unit_name(self.length)})",
            x_range=ranged(0, right), y_range=ranged(-top, top),
        )  # fmt: skip
        level = drawing.diagram_levels(years, excess, longest, COLUMNS)
        colors = [to_hex(c) for c in colormaps["RdBu_r"](np.linspace(0, 1, 255))]
        mapper = self.models.LinearColorMapper(colors, low=-127, high=127)
        size = {"dw": right, "dh": 2 * top}
        plot.image([level], x=0, y=-top, color_mapper=mapper, **size)
        life = np.array([t[-1] - t[0] for t in self.features.data["ts"]]) / YEAR
        self.features.data["rx"] = [[0, v] for v in life * u.yr.to(time)]
        lines = self._lines(plot, "rx", "ry")
        for number, slope, kind in zip(
            self.components["component"], slopes, self.kinds, strict=True
        ):
            end = min(longest, half / abs(slope)) if slope else longest
            x, y = end * u.yr.to(time), slope * end * u.mas.to(self.length)
            look = {"line_color": "black", "line_dash": DASHES[kind]}
            plot.line([0, x], [0, y], line_width=2.5, **look)
            x, y = [0.88 * x], [0.88 * y]
            plot.scatter(x, y, size=19, fill_color="white", line_color="black")
            middle = {"text_align": "center", "text_baseline": "middle"}
            plot.text(x, y, [str(number)], text_font_size="13px", **middle)
        self._tools(plot, lines)
        return plot

    def _time(self):
        label = f"Distance ({unit_name(self.length)})"
        plot = self._figure("Date", label, x_axis_type="datetime")
        self._lines(plot, "ts", "ds", 0.8)
        lines = self._lines(plot, "lt", "ld", 1.6, 0.7)
        dots = self._dots(plot, "t", "d", 5, legend_group="label")
        self._now(plot, "t", "d")
        self._tools(plot, lines, dots)
        if len(self.seen):
            plot.add_layout(plot.legend[0], "above")
            plot.legend.orientation = "horizontal"
        return plot

    def _features_table(self):
        models = self.models
        speed, length = unit_name(self.pm_unit), unit_name(self.length)
        shown = (
            ("feature", "feature", "0", 55),
            ("component", "component", "0", 80),
            ("scale", "scale", "0.[0]", 45),
            ("n_epochs", "epochs", "0", 55),
            ("first", "first", None, 95),
            ("last", "last", None, 95),
            ("distance", f"distance ({length})", "0.00", 115),
            ("pm", f"pm ({speed})", "0.000", 110),
            ("pm_err", "error", "0.000", 60),
            ("pm_transverse", "across", "0.000", 60),
        )
        columns = []
        for field, title, form, width in shown:
            columns.append(models.TableColumn(field=field, title=title, width=width))
            if form is not None:
                columns[-1].formatter = models.NumberFormatter(format=form)
        return models.DataTable(
            source=self.features, columns=columns, sizing_mode="stretch_width",
            height=260, index_position=None, reorderable=False, selectable="checkbox",
        )  # fmt: skip
