# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What files hold, which images do not belong, and the speeds that dates allow."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from zlib import crc32

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time

from astro_scc.decomposition.wavelet import measure_noise
from astro_scc.epochs.tables import LISTS, NO_IMAGE, first_names
from astro_scc.images import fits, grid, headers, pixels, positions, series
from astro_scc.images.dates import as_times, date_labels, without_order
from astro_scc.images.positions import readable_angle
from astro_scc.intervals import median_interval

POLARISED = "Q", "U", "V", "RL", "LR", "XY", "YX"
#: What to do with an image that is slightly different.
OTHER_CHANNEL = "leave it out if it shows something else"
#: What to do with an image that does not belong to the others.
UNCHECKED = "leave it out (in Python, check=False reads it)"
#: What to do with an image without a beam.
NO_BEAM = (
    f"{fits.CORRECT_BEAM}, give one of all (--beam, in Python beams=), or leave it out "
    "(check=False reads all without beams)"
)

#: Columns of numbers of `inspect_epochs`, with their units; None is that of the images.
UNITS = "pixel major minor pa peak noise peak_east peak_north frequency".split()
UNITS = dict.fromkeys(UNITS, u.mas)
UNITS |= {"pa": u.deg, "peak": None, "noise": None, "frequency": u.GHz}
#: The row of a file of which nothing is known.
UNKNOWN = {"file": "", "date": None, "nx": 0, "ny": 0} | dict.fromkeys(UNITS, np.nan)
UNKNOWN |= {"object": "", "frequency": UNKNOWN.pop("frequency")}
# Displacements in beams with which pairs of epochs work best.
GOOD_SHIFTS = (0.3, 1.5)


def inspect_epochs(paths: Path | str | Sequence[Path | str]) -> QTable:
    """
    Return facts about each file and its problems; no file is refused.

    Parameters
    ----------
    paths : str, path-like, or sequence of them
        Files or patterns.

    Returns
    -------
    `~astropy.table.QTable`
        One row per file, sorted by date, with undated files last: ``file``,
        ``date`` (masked where missing), ``nx``, ``ny``, ``pixel``,
        ``major``, ``minor``, ``pa``, ``peak``, ``noise``, ``peak_east`` and
        ``peak_north`` (offset of the brightest pixel from the reference
        pixel, or from the middle if that lies far away or the image is not
        flat around it), ``object``, ``frequency`` and ``problem``, empty if there is
        none.  Unknown numbers are NaN or 0.

    Raises
    ------
    FileNotFoundError
        If nothing matches a pattern.

    Examples
    --------
    >>> from astro_scc.epochs import inspect_epochs
    >>> table = inspect_epochs("../shared/data/quirks/*.fits")
    >>> print(table["problem"][-1].split(";")[0])
    no date of observation
    """
    files = fits.find_files(paths, missing_ok=True)
    rows = [UNKNOWN | _row_of(path, k) for path in files for k in _frames(path)]
    rows.sort(key=lambda row: (row["date"] is None, row["date"] or 0))
    read = [row for row in rows if "plane" in row]
    planes = [row["plane"] for row in read]
    unit = planes[0].unit if read else u.dimensionless_unscaled
    notes = without_order([row["problem"] for row in read])
    for row, plane, found in zip(read, planes, notes, strict=True):
        row["problem"] = found
        factor = plane.unit.to(unit) if unit.is_equivalent(plane.unit) else np.nan
        row |= {"peak": row["peak"] * factor, "noise": row["noise"] * factor}
    if read:
        peaks = np.array([row["peak"] for row in read])
        for index, what, *_ in (*problems(planes, peaks), *_warned(planes)):
            read[index]["problem"].append(what)
    columns = {name: [row[name] for row in rows] for name in UNKNOWN}
    for name, usual in UNITS.items():
        columns[name] = u.Quantity(columns[name], usual or unit)
    columns["problem"] = ["; ".join(row["problem"]) for row in rows]
    mjd = [np.nan if date is None else date.mjd for date in columns["date"]]
    dates = Time(np.ma.masked_invalid(mjd), format="mjd", scale="utc")
    columns["date"] = Time(dates, format="iso")
    # Of images that are not flat around their reference pixel, it is the middle.
    origin = " or ".join(sorted({row["origin"] for row in read}, reverse=True))
    return QTable(columns, meta={"origin": origin})


def kind_of(path):
    """Return what a file holds: a "cube", a list of "components", or else "images"."""
    if path.suffix.lower() in LISTS:
        return "components"
    # What is wrong with a file is said where it is read.
    with suppress(Exception), fits.opened(path) as hdus:
        if hdus[0].header.get("CREATOR") == fits.CUBE_CREATOR:
            return "cube"
        image = any(hdu.is_image and len(hdu.shape) >= 2 for hdu in hdus)
        listed = any(hdu.name.strip().startswith("AIPS CC") for hdu in hdus)
        if listed and not image and not pixels.is_visibilities(hdus):
            return "components"
    return "images"


def _frames(path):
    """Return the numbers of the images of a file, of which `_row_of` says faults."""
    with suppress(OSError, ValueError):
        return fits.frames_of(path)
    return [None]


def _row_of(path, frame):
    """Return what is known of an image, with its `Plane` if it can be read."""
    row = {"file": fits.labelled(path, frame)}
    try:
        plane = fits.read_plane(path, frame=frame)
        plane.take_uncertainty()
    except (OSError, ValueError) as error:
        listed = kind_of(path) == "components"
        problem = NO_IMAGE if listed else str(error).removeprefix(f"{path}: ")
        return row | {"problem": [problem]}
    row["problem"] = plane.notes
    if plane.time is None:
        row["problem"].append(plane.date_problem or "no date of observation")
    if fits.looks_like_mask(plane.data):
        row["problem"].append("no more than two different values, a mask")
    row["date"], (row["ny"], row["nx"]) = plane.time, plane.shape
    row["object"] = plane.facts.get("object", "")
    row["frequency"] = plane.facts.get("frequency", np.nan) / 1e9
    wcs = flat = plane.wcs
    if positions.is_far(wcs, plane.shape) or not positions.is_flat(wcs, plane.shape):
        middle = positions.tangent_wcs(wcs, [(n - 1) / 2 for n in plane.shape[::-1]])
        flat = middle if np.all(np.isfinite(middle.pixel_scale_matrix)) else wcs
    row["origin"] = "the reference pixel" if flat is wcs else "the middle"
    matrix = flat.pixel_scale_matrix * u.deg.to(u.mas)
    row["pixel"] = np.sqrt(np.abs(np.linalg.det(matrix)))
    if plane.beam is not None:
        row |= {k: getattr(plane.beam, k).value for k in ("major", "minor", "pa")}
    top = np.argmax(np.where(plane.mask, -np.inf, plane.data))
    y, x = np.unravel_index(top, plane.data.shape)
    row["peak"] = float(plane.data[y, x])
    row["peak_east"], row["peak_north"] = matrix @ ([x, y] - flat.wcs.crpix + 1)
    row["noise"] = measure_noise(plane.data, plane.mask)
    # Only the facts are kept, as there may be many large files.
    plane.data = plane.mask = None
    return row | {"plane": plane}


@dataclass(frozen=True)
class IntervalPlan:
    """
    The speeds that the dates of a series allow to be measured.

    With the resolution b (geometric mean of the beam's axes, median over
    the epochs), the span T of the series, the median interval dt between
    consecutive epochs and the shorter side L of the images:

    - ``slowest = b / T``, or that of consecutive epochs if those are slower: what is
      slower moves less than a beam from the first to the last epoch.
    - ``fastest = L / (2 dt)``: a feature that crosses half of the image
      between consecutive epochs is in one of them only.
    - ``consecutive = (0.3, 1.5) b / dt``: speeds for which consecutive
      epochs are the best pairs; slower features hardly move between them,
      faster ones change before they can be recognised.

    ``shortest``, ``median`` and ``longest`` are intervals between consecutive epochs
    of different date; the median leaves out those inside of pairs and campaigns of
    epochs that are close together, if there are many.
    """

    n_epochs: int
    span: u.Quantity
    shortest: u.Quantity
    median: u.Quantity
    longest: u.Quantity
    resolution: u.Quantity
    slowest: u.Quantity
    fastest: u.Quantity
    consecutive: u.Quantity

    def baseline(self, speed):
        """
        Return the shortest and longest interval between epochs that suit a speed.

        They are ``(0.3, 1.5) b / speed``, in which a feature moves 0.3 to 1.5 beams,
        but no longer than the series.  A speed that is not positive, or too slow for
        the series, raises a ValueError.
        """
        speed = u.Quantity(speed).to(self.slowest.unit)
        if not speed > 0:
            raise ValueError(f"speed must be positive, got {speed}")
        wanted = (np.array(GOOD_SHIFTS) * self.resolution / speed).to(self.span.unit)
        # The slowest allowed speed must not be refused by rounding errors.
        if wanted[0] > self.span * (1 + 1e-9):
            raise ValueError(
                f"at {speed:.3g} nothing moves {GOOD_SHIFTS[0]} of a beam in the "
                f"{self.span:.3g} of the series"
            )
        return np.minimum(wanted, self.span)

    def motion(self, speed):
        """
        Return how far a feature moves in the median interval, in beams.

        Values of 0.3 to 1.5 are good; for others see `baseline`.
        """
        return (u.Quantity(speed) * self.median / self.resolution).to_value(u.one)

    def __str__(self):
        low, high = self.consecutive
        lines = [
            f"{self.n_epochs} epochs over {self.span:.3g}, "
            f"{self.shortest.value:.3g} to {self.longest:.3g} apart, "
            f"median {self.median:.3g}; resolution {readable_angle(self.resolution)}.",
            f"What is slower than {self.slowest:.2g} moves by less than a beam, what "
            f"is faster than {self.fastest:.3g} leaves the image by the next epoch.",
            f"Consecutive epochs suit speeds of {low.value:.2g} to {high:.2g}, up to "
            f"{(self.resolution / self.median).to(high.unit):.2g} without ambiguity.",
            "Slower features show in pairs of epochs that are further apart, which "
            "are used for them.",
        ]
        return "\n".join(lines if self.n_epochs > 2 else lines[:3])


def plan_intervals(cube: series.ImageSeries) -> IntervalPlan:
    """
    Return the speeds that the dates of a series allow to be measured.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
        At least two epochs of different date.  The resolution is that of its beams,
        or three pixels if it has none.

    Returns
    -------
    ``IntervalPlan``

    Raises
    ------
    ValueError
        If there are fewer than two dates.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc.epochs import Beam, EpochCube, plan_intervals
    >>> times = ["2000-01-01", "2000-07-01", "2001-01-01", "2002-01-01"]
    >>> beam = Beam(1 * u.mas, 0.5 * u.mas)
    >>> cube = EpochCube.from_arrays(
    ...     np.ones((4, 80, 80)), times, pixel_scale=0.1 * u.mas, beams=beam
    ... )
    >>> plan = plan_intervals(cube)
    >>> plan.slowest.round(3), plan.consecutive.round(2)
    (<Quantity 0.353 mas / yr>, <Quantity [0.42, 2.11] mas / yr>)
    >>> plan.motion(1 * u.mas / u.yr).round(2)
    np.float64(0.71)
    >>> plan.baseline(1 * u.mas / u.yr).round(2)
    <Quantity [0.21, 1.06] yr>
    """
    days = np.unique((cube.times - cube.times[0]).jd) * u.day
    if days.size < 2:
        raise ValueError("velocities need at least two epochs of different date")
    width = cube.resolution
    sides = np.hypot(*cube.pixel_matrix.value) * cube.shape[:0:-1] * u.mas
    gaps, span = np.diff(days), days[-1] - days[0]
    median = median_interval(days)
    speed = cube.speed_unit
    time = speed.bases[1]
    return IntervalPlan(
        n_epochs=len(cube),
        span=span.to(time),
        shortest=gaps.min().to(time),
        median=median.to(time),
        longest=gaps.max().to(time),
        resolution=width.to(u.mas),
        slowest=(min(1 / span, GOOD_SHIFTS[0] / median) * width).to(speed),
        fastest=(sides.min() / (2 * median)).to(speed),
        consecutive=(np.array(GOOD_SHIFTS) * width / median).to(speed),
    )


def problems(planes, peaks, scale=100, first=1880):
    """
    Return the images that do not belong to the others.

    Of each, these are its index, what is odd about it, what to do, and whether it is
    refused.  It is of another unit, object, band or polarisation, of the date of
    another one, or has no beam where others have one.  Another name for the same place,
    a mirror image, a date before the ``first`` photograph of a nebula, and a peak (in
    ``peaks``) that differs by a factor ``scale``, which is hardly variability, need
    only a warning.
    """
    # What is of another object may be of the same date.
    found = [*_strangers(planes), *_same_dates(planes)]
    east = [np.linalg.det(plane.wcs.pixel_scale_matrix) > 0 for plane in planes]
    bright = peaks[np.isfinite(peaks) & (peaks > 0)]
    # Of two, either may be the odd one.
    usual = np.median(bright) if len(bright) > 2 else np.nan
    now, unit = Time.now().jyear, planes[0].unit
    some_have_beams = any(plane.beam is not None for plane in planes)
    for i, plane in enumerate(planes):
        odd = []
        # ERFA warns of years whose leap seconds are unknown.
        with warnings.catch_warnings(action="ignore"):
            year = now if plane.time is None else plane.time.jyear
            if not first < year < now + 1 / 365:
                date = plane.time.to_value("iso", subfmt="date")
                what = f"is of {date}, when no image can have been taken"
                odd.append((what, "correct its date, or leave it out"))
        if east[i] != (2 * sum(east) > len(east)):
            what = f"east is to the {'right' if east[i] else 'left'}, unlike in most"
            odd.append((what, "correct the sign of CDELT1 unless it is a mirror image"))
        ratio = float(peaks[i] / usual)
        if ratio > 0 and scale < max(ratio, 1 / ratio) < np.inf:
            what = f"its peak is {ratio:.2g} times that of most images"
            odd.append((what, "correct its unit or scale"))
        found += [(i, *words, False) for words in odd]
        if not plane.unit.is_equivalent(unit):
            mine, other = (one.to_string() or "none" for one in (plane.unit, unit))
            what = f"its unit is {mine}, that of others is {other}"
            found.append((i, what, "give all one unit, or leave it out", True))
        if some_have_beams and plane.beam is None:
            found.append((i, "no beam where other epochs have one", NO_BEAM, True))
    return sorted(found, key=itemgetter(0))


def far_away(planes, part=0.05):
    """
    Yield the images whose reference pixels are far from that of the first one.

    The farthest comes first.  A larger ``part`` of the image exceeds the scatter of
    VLBI positions.
    """
    first = planes[0]
    apart = [positions.apart_by_reference(plane.wcs, first.wcs) for plane in planes]
    far = [
        int(k)
        for k in np.argsort(apart)[::-1]
        if apart[k] > part * max(first.extent, planes[k].extent)
    ]
    for k in far:
        most = f"{'up to ' if len(far) > 1 else ''}{apart[far[0]] * 3600:.4g} arcsec"
        what = (
            f"its reference pixel and that of {Path(first.name).name} are {most} apart "
            "on the sky and are taken for one place"
        )
        advice = (
            "use frame='absolute' (--align wcs) where the coordinates are to be trusted"
        )
        yield k, what, advice, False


def _warned(planes):
    """Yield images of which reading warns when it lays them on one grid."""
    yield from far_away(planes)
    some_have_noise = any(plane.noise is not None for plane in planes)
    every = [plane.wcs for plane in planes]
    frames = positions.on_one_sky(every, every[0], "offset")
    k = grid.finest([(p.shape, wcs) for p, wcs in zip(planes, frames, strict=True)])
    name = Path(planes[k].name).name
    for i, (plane, frame) in enumerate(zip(planes, frames, strict=True)):
        if grid.whole_step(frame, frames[k], plane.shape) is None:
            yield i, f"on another grid than {name}, the finest, and resampled"
        if some_have_noise and plane.noise is None:
            yield i, "no noise where other epochs have one"


def _same_dates(planes, part=1e-3):
    """
    Yield images of the date of another one, or of its pixels at nearly its date.

    In a ``part`` of a series, two images with the same pixels are of one exposure.
    """
    dated = [i for i, plane in enumerate(planes) if plane.time is not None]
    if not dated:
        return
    times = as_times([planes[i].time for i in dated], len(dated))
    order = times.argsort()
    gaps = np.diff((times - times[0]).sec[order])
    for k in np.flatnonzero(gaps <= part * gaps.sum()):
        one, other = (dated[order[n]] for n in (k, k + 1))
        mine, its = planes[one].data, planes[other].data
        # Of images that are inspected, the pixels are not kept.
        same = mine is not None and np.array_equal(mine, its, equal_nan=True)
        if gaps[k] > 0 and not same:
            continue
        date = date_labels(times[[order[k]]], clock=True)[0]
        what = f"is of {date}, as is {Path(planes[one].name).name}"
        advice = (
            "leave one out, or average them: two images of the same data share their "
            "noise, and would pass for structure (in Python, check=False reads both)"
        )
        yield other, what, advice, True


def repeated(cube):
    """Return lines about the images with the pixels of an earlier one."""
    known, copies = {}, {}
    for i, image in enumerate(cube.data):
        first = known.setdefault(crc32(np.ascontiguousarray(image)), i)
        if first != i and np.array_equal(image, cube.data[first], equal_nan=True):
            copies.setdefault(cube.labels[first], []).append(cube.labels[i])
    return [
        f"{headers.some(labels)}: has the same pixels as {first}, of another date; "
        "leave one out, or correct its date"
        for first, labels in copies.items()
    ]


def _strangers(planes):
    """Yield images of another object, filter, polarisation or band."""
    names, stokes, known = (
        [plane.facts.get(fact) for plane in planes]
        for fact in ("object", "stokes", "frequency")
    )
    names = [str(name or "").strip() for name in names]
    unnamed = "", "UNKNOWN", "NONE", "N/A"
    names = [None if name.upper() in unnamed else name for name in names]
    # Of names of one source, one stands for all.
    same = first_names(filter(None, names))
    names = [name and same[name] for name in names]
    for i, mine, others in _minority(names):
        one, other = planes[i], planes[names.index(others)]
        apart = positions.apart_by_reference(one.wcs, other.wcs)
        same = bool(apart < max(one.extent, other.extent))
        where = "at the same place" if same else "somewhere else"
        what = f"shows {mine}, {where}, where others show {others}"
        advice = "leave it out if it is another object" if same else UNCHECKED
        yield i, what, advice, not same
    intensity = [s if s in POLARISED else s and "I" for s in stokes]
    hands = [None if s in POLARISED else s for s in stokes]
    kinds = [("Stokes", intensity, UNCHECKED)]
    for fact, row in headers.KEYWORDS["facts"].items():
        if "named" in row:
            # Spacecraft see the Sun from several sides.
            slight = fact in ("channel", "observatory")
            advice = OTHER_CHANNEL if slight else UNCHECKED
            values = [plane.facts.get(fact) for plane in planes]
            kinds.append((row["named"], values, advice))
    for what, values, advice in (*kinds, ("Stokes", hands, OTHER_CHANNEL)):
        refused = advice == UNCHECKED
        odd = _minority(values)
        # What is slight is told of one value.
        same = [one for one in odd if refused or _key(one[1]) == _key(odd[0][1])]
        for i, mine, others in same:
            yield i, f"is of {what} {mine}, others are of {others}", advice, refused
    yield from _other_frequencies(planes, known)


def _other_frequencies(planes, known, band=0.1, channel=1e-3):
    """
    Yield images of another band, and the first of another channel in the band.

    A ``band`` is in ln(frequency): those of VLBI are a few per cent wide and 30% apart.
    Of another ``channel`` is what differs by more, or by more than a channel's width.
    """
    known = np.array([value or np.nan for value in known], dtype=float)
    ratio = np.abs(np.log(known[:, None] / known))
    near = ratio < band
    usual = int(np.argmax(near.sum(axis=1)))
    for i in np.flatnonzero(~near[usual] & ~np.isnan(known)):
        mine, others = (f"{known[k] / 1e9:.4g}" for k in (i, usual))
        yield int(i), f"is at {mine} GHz, others are at {others}", UNCHECKED, True
    widths = [plane.bandwidth or 0.0 for plane in planes]
    # A width that is no more than rounding is none.
    width = min((w for w in widths if w > channel**2 * known[usual]), default=np.inf)
    limit = min(channel, width / known[usual]) * (1 - channel)
    alike = ratio < limit
    usual = int(np.argmax(alike.sum(axis=1)))
    odd = np.flatnonzero(near[usual] & ~alike[usual])
    if len(odd):
        mine, others = (f"{known[k] / 1e9:.7g}" for k in (odd[0], usual))
        more = f", as are {len(odd) - 1} more" if len(odd) > 1 else ""
        what = f"is at {mine} GHz{more}, others are at {others}, in the same band"
        yield int(odd[0]), what, OTHER_CHANNEL, False


def _key(text):
    """Return a name or wavelength without what may be written in several ways."""
    with suppress(TypeError, ValueError, u.UnitConversionError):
        return f"{u.Quantity(text).to_value(u.m):.6g}"
    # A hyphen behind a letter is none of the signs of a position.
    return re.sub(r"[\s_]|(?<=[A-Z])-", "", text.upper())


def _minority(values):
    """Return the entries that differ from the most common value (first of equals)."""
    keys = [v and _key(v) for v in values]
    count = Counter(key for key in keys if key)
    if len(count) < 2:
        return []
    usual = count.most_common(1)[0][0]
    name = values[keys.index(usual)]
    return [(i, values[i], name) for i, key in enumerate(keys) if key and key != usual]
