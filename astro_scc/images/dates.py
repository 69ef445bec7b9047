# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""When images were taken: by the keywords of headers, as given, and in words."""

import re
import warnings
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import product

import astropy.units as u
import numpy as np
from astropy.time import Time, TimeDelta

from astro_scc.exceptions import refusing, warn
from astro_scc.images.headers import KEYWORDS, axis_numbers, get
from astro_scc.quantities import parse_date, without_doubt

#: Keywords of dates, times and durations, and words about them.
WORDS = KEYWORDS["dates"]
#: Time scales by their names in headers.
SCALES = {name: scale for scale, names in WORDS["scales"].items() for name in names}
#: Seconds and hours of a day.
DAY, HOURS = 86400.0, 24
#: Smallest Julian date that is no modified one, and days after it, or of a modified
#: one, of which no image can be.
FIRST_JD, FUTURE = 2.4e6, 4e5
UNKNOWN_SCALE = (
    "its time scale TIMESYS = {} is not known and taken for UTC; correct its dates, "
    "and TIMESYS, if they are local"
)
EITHER_ORDER = (
    "its date is taken for day/month/year, as FITS had it, and may be month/day/year; "
    "write it as 2006-03-09"
)
_EITHER = re.compile(r"\s*(0?[1-9]|1[0-2])/(0?[1-9]|1[0-2])/(\d\d){1,2}\b")
_CLOCK = re.compile(
    r"(\d{1,2})[: H-](\d{1,2})(?:[: M-](\d{1,2})(\.\d*)?)?[MS]?$"
    r"|(\d\d)(\d\d)(\d\d)(\.\d*)?$"
)


@dataclass(frozen=True, order=True)
class Found:
    """
    A date of a header: its Time, how precise it is, and of which keyword.

    ``precision`` is in seconds, that of a whole day if there is no time of the day.
    Dates are in the order of their precision.
    """

    precision: float
    time: Time = field(compare=False)
    keyword: str = field(compare=False)

    @property
    def day_only(self):
        """Whether nothing but the day is known."""
        return self.precision >= DAY


def observing_time(header, *, start=False):
    """
    Return the date (UTC) at the middle of the exposure, and a remark on doubts.

    The most precise date that agrees with the first one on the day counts: the middle
    of the exposure (``DATE-AVG``, ``MJD-AVG``, ``T_OBS``), else its start
    (``DATE-OBS``, with ``TIME-OBS``, ``UT`` or others if it has the day alone,
    ``DATE-BEG``, ``MJD-OBS``, ``EXPSTART``) and half of the exposure, which is added
    where the time of the day is known.  Midnight counts as a day alone.  ``DATE``, at
    which a file was written, does not count.  With ``start`` it is the start.

    Without a date it is None; dates that cannot be read raise a ValueError.
    """
    for keyword in (*WORDS["start"], *WORDS["middle"]):
        if isinstance(value := get(header, keyword), Time):
            return value, ""
    scale = _scale_of(header)
    starts, problem = _dates(header, WORDS["start"], scale)
    middles, other = _dates(header, WORDS["middle"], scale)
    if not (starts or middles):
        if problem or other:
            raise ValueError(problem or other)
        return None, ""
    first, doubt = [*starts, *middles][0], ""
    if first.day_only and starts:
        starts[1:1], doubt = _with_clock(header, first)
    begin = min((one for one in starts if _agrees(one, first)), default=None)
    unknown = "" if scale in SCALES else UNKNOWN_SCALE.format(scale)
    if _EITHER.match(get(header, first.keyword, kind=str)):
        unknown = EITHER_ORDER
    remark = _contradictions(starts, first) or unknown or doubt
    if start:
        return (None if begin is None else _in_utc(begin.time)), remark
    known = begin or first
    exposure = 0.0
    for keyword in WORDS["exposure"]:
        if not exposure > 0 and (value := get(header, keyword, kind=float)):
            # Its comment may say another unit.
            exposure = max(value, 0.0) * _unit_of(header, keyword, 1.0)
    ends = _dates(header, WORDS["end"], scale)[0]
    if known.day_only:
        half = TimeDelta(exposure / 2, format="sec")
        clocked = (one for one in ends if not one.day_only)
        middles += [replace(one, time=one.time - half) for one in clocked]
    middles = [one for one in middles if _follows(one, known, exposure)]
    middle = min(middles, default=None)
    # It is more precise than the start, or than their gap.
    if middle is not None and (
        begin is None or middle.precision <= max(begin.precision, _gap(middle, begin))
    ):
        return _in_utc(middle.time), remark
    half = TimeDelta(_lasted(begin, ends, exposure) / 2, format="sec")
    return _in_utc(known.time + half), remark


def _scale_of(header):
    """Return the time scale of a header, TT for ``TT(TAI)``."""
    scale = (get(header, "TIMESYS", kind=str) or "UTC").upper()
    return scale.partition("(")[0].strip()


def _contradictions(starts, first, longest=0.9):
    """
    Return a remark on dates that are of other days than the first one.

    Those with a time of the day may differ by the ``longest`` days, and be of one
    exposure, or of one night by the clock of the place.
    """
    others = "; ".join(
        f"{one.keyword} is of {one.time.isot[:10]}"
        for one in starts
        # Of a day alone, the other may be of its last second or of another scale.
        if one is not first
        and abs((one.time - first.time).jd)
        > (1.5 if one.day_only or first.day_only else longest)
    )
    if not others:
        return ""
    return (
        f"its {first.keyword} is of {first.time.isot[:10]}, which is taken, and "
        f"{others}; correct the header if that is wrong"
    )


def _unit_of(header, keyword, default):
    """Return the seconds of a unit of time that the comment of a card names."""
    comment = ""
    with suppress(AttributeError, KeyError):
        comment = str(header.comments[keyword])
    units = WORDS["seconds"].items()
    return next((s for word, s in units if re.search(word, comment)), default)


def _agrees(one, first):
    """Return whether two dates of the start may be of the same instant."""
    if first.day_only and not one.day_only and one.time == first.time + 1 * u.day:
        # Of the day that ends at 24:00.
        return True
    if first.day_only or one.day_only:
        return one.time.isot[:10] == first.time.isot[:10] or (
            _in_utc(one.time).isot[:10] == _in_utc(first.time).isot[:10]
        )
    return _gap(one, first) <= first.precision + one.precision


def _gap(one, other):
    """Return the seconds between two dates."""
    return abs((one.time - other.time).to_value(u.s))


def _follows(middle, begin, exposure):
    """Return whether a middle of an exposure may be that of its start."""
    gap = (middle.time - begin.time).to_value(u.s)
    if middle.day_only:
        return begin.day_only and 0 <= gap < DAY
    # A day that is given in UTC may begin later in other scales.
    return -min(begin.precision, 100.0) <= gap <= max(DAY, exposure)


def _lasted(begin, ends, exposure):
    """Return the seconds from a start to the end, 0 if they are less than is known."""
    if begin is None:
        return 0.0
    end = min((one for one in ends if one.time > begin.time), default=None)
    lasted = 0.0 if end is None else (end.time - begin.time).to_value(u.s)
    if begin.day_only or (end and end.day_only):
        # Days alone, and midnights, tell of longer ones.
        return lasted if lasted > DAY else 0.0
    if end is not None:
        # Exposures leave out the pauses.
        return max(exposure, lasted)
    # A longer one is the sum of many, of which the dates are not known.
    return exposure if exposure <= DAY else 0.0


def _dates(header, keywords, scale):
    """Return the dates of some keywords, and why one could not be read."""
    found, problem = [], ""
    for keyword in keywords:
        if keyword.startswith(tuple(WORDS["julian"])):
            day = get(header, keyword, kind=float) or 0
            form = "jd" if day > FIRST_JD else "mjd"
            if day <= 0 or (form == "mjd" and keyword.startswith("JD")):
                continue
            if day - FIRST_JD * (form == "jd") > FUTURE:
                words = f"{day:.10g} is no (modified) Julian date; write JD - 2400000.5"
                problem = problem or f"{keyword}: {words}"
                continue
            time = Time(day, format=form, scale=SCALES.get(scale, "utc"))
            precision = DAY * _last_digit(repr(day))
            found.append(Found(precision, _in_scale(time, scale), keyword))
        elif (text := get(header, keyword, kind=str)) is not None:
            try:
                found.append(Found(*_of_text(text, scale), keyword))
            except ValueError as error:
                problem = problem or f"{keyword}: {error}"
    return found, problem


def _last_digit(text):
    """Return what one of the last digit of a number is that is not zero."""
    return 10.0 ** -len(text.partition(".")[2].rstrip("0"))


def _of_text(text, scale):
    """Return the precision of a date that is text, in seconds, and its Time."""
    plain = text.strip()
    if suffix := re.search(r"[ _](UTC|UT|TAI|TT|TDB)$", plain.upper()):
        plain, scale = plain[: suffix.start()], suffix[1]
    elif re.search(r"(Z|\+00:?00)$", plain.upper()):
        scale = "UTC"
    # The Sun's observatories write 2011.02.15_00:00:27.30.
    plain = re.sub(r"^(\d{4})[.](\d\d)[.](\d\d)", r"\1-\2-\3", plain)
    plain = re.sub(r"(?<=\d)_(?=\d\d:)", "T", plain)
    time = _in_scale(parse_date(plain, SCALES.get(scale, "utc")), scale)
    if re.fullmatch(r"\d{4}\.\d+", plain):
        return u.yr.to(u.s) * 10.0 ** -len(plain[5:]), time
    clock = re.search(r"[T ](\d[\d:]*)(\.\d*)?", plain.upper())
    if not clock or not re.search(r"[1-9]", clock[0]):
        # Midnight stands for a day alone.
        return DAY, time
    minutes = clock[1].count(":") < 2
    return (60.0 if minutes else 10.0 ** -len((clock[2] or ".")[1:])), time


def _with_clock(header, day):
    """
    Return the dates of a day alone with its times of the day in other keywords.

    A remark says if one is a number of which the unit is not known.
    """
    found, remark = [], ""
    for keyword in WORDS["clock"]:
        precision, seconds, doubt = _seconds(header, keyword)
        remark = remark or doubt
        if seconds is not None:
            # On the day itself, so that leap seconds do not move it.
            time = day.time + TimeDelta(seconds, format="sec")
            found.append(Found(precision, time, f"{day.keyword} and {keyword}"))
    return found, remark


def _seconds(header, keyword):
    """Return precision and seconds (None if none) of a time of the day, and a doubt."""
    text = get(header, keyword, kind=str) or ""
    # It may have the day, too.
    text = re.split(r"[T_ ](?=\d{1,2}:)", text.upper())[-1]
    text = re.sub(r"(Z| ?UTC?)$", "", text).strip()
    if match := _CLOCK.match(text):
        # Of one of the two forms.
        hours, minutes, seconds, fraction = match.groups()[4 * (match[1] is None) :][:4]
        if int(hours) > HOURS or int(minutes) > 59:
            return DAY, None, ""
        total = 3600 * int(hours) + 60 * int(minutes) + float(seconds or 0)
        precision = 60.0 if seconds is None else 10.0 ** -len((fraction or ".")[1:])
        return precision, total + float(fraction or 0), ""
    number, unit = get(header, keyword, kind=float), _unit_of(header, keyword, 0.0)
    if number is None or not 0 <= number <= DAY:
        return DAY, None, ""
    seconds, doubt = (unit or 1.0) * number, ""
    if 0 < number <= HOURS and not unit:
        what = "left out" if keyword.startswith("UT") else "seconds"
        seconds = None if what == "left out" else seconds
        doubt = f"its {keyword} = {number:g} may be hours or seconds and is {what}; "
        doubt += "write it as HH:MM:SS"
    return (unit or 1.0) * _last_digit(text), seconds, doubt


def _in_scale(time, scale):
    """Return a time that was read in the scale of a name as what it means."""
    # GPS time is behind atomic time.
    return time + 19 * u.s if scale == "GPS" else time


def _in_utc(time):
    with warnings.catch_warnings(action="ignore"):
        return Time(time.utc, format="isot")


def without_order(notes):
    """
    Return advice on images without that on the order of days and months, in lists.

    It stays if that of no image is known, which is that of all.
    """
    if all(EITHER_ORDER in of_image for of_image in notes):
        return notes
    return [[note for note in each if note != EITHER_ORDER] for each in notes]


# -- dates that are given ---------------------------------------------------------


def as_times(times, n):
    """Return dates as a Time of shape (n,)."""
    if not isinstance(times, Time):
        given = type(times).__name__
        if isinstance(times, str) or not np.iterable(times):
            times = [times]
        else:
            times = list(times)
            wrong = [type(time).__name__ for time in times if not isinstance(time, str)]
            given += f" of {wrong[0]}" if wrong else ""
        try:
            dates = [parse_date(t) if isinstance(t, str) else Time(t) for t in times]
        except (TypeError, ValueError) as error:
            if all(isinstance(value, str) for value in times):
                raise
            raise TypeError(
                "times must be a Time or strings such as '2006-03-09', got "
                f"{given}; of numbers make Time(numbers, format='mjd' or 'jyear')"
            ) from error
        times = Time(dates, format=None if dates else "jd")
    times = times.reshape(1) if times.isscalar else times
    if times.shape != (n,):
        raise ValueError(f"{n} epochs need {n} times, got shape {times.shape}")
    if np.any(times.mask):
        raise ValueError("every epoch needs a date, times has missing values")
    if times.scale == "local":
        raise ValueError(
            "times are of the scale 'local', which has no relation to others; give "
            "them in UTC, Time(..., scale='utc')"
        )
    return without_doubt(times)


def times_of_column(column):
    """Return numbers that are years or (modified) Julian dates as Time, others not."""
    kind = getattr(getattr(column, "dtype", None), "kind", "")
    if isinstance(column, Time) or kind not in ("f", "i"):
        return column
    values = np.ma.masked_invalid(np.ma.asarray(column, dtype=float))
    low, high = values.min(), values.max()
    kinds = {"jyear": (1800, 2200), "mjd": (1e4, 1e5), "jd": (FIRST_JD, 3e6)}
    for form, (least, most) in kinds.items():
        if least <= low and high < most:
            return Time(values, format=form, scale="utc")
    return column


def given_times(times, n):
    """Return the dates that are given for n images, None for those that are not."""
    if isinstance(times, str) or not np.iterable(times):
        times = [None] * n if times is None else [times]
    times = [t if t is None else as_times(t, 1)[0] for t in times]
    if len(times) != n:
        raise ValueError(f"{len(times)} dates for {n} images; give one for each")
    return times


def warn_of_equal_dates(times):
    """Warn of the first of dates in order that is that of the next."""
    for k in np.flatnonzero(np.diff((times - times[0]).sec) == 0)[:1]:
        warn(f"two images are of {times.isot[k]}; leave one out, or average them")


def date_labels(times, *, clock=False):
    """
    Return dates as short text, with as much of the time of day as tells them apart.

    With ``clock`` that is given unless all are of midnight.
    """
    gaps = np.diff(np.sort((times - times[0]).to_value(u.s)))
    least = gaps[gaps > 0].min(initial=np.inf)
    digits = next((n for n in (0, 3, 6) if 2 * 10.0**-n <= least), 9)
    # Days are not rounded.
    texts, days = (Time(times, format="isot", precision=n).isot for n in (digits, 9))
    # A selection of dates some of which are missing is still masked.
    texts = tuple(getattr(texts, "unmasked", texts).tolist())
    days = tuple(text[:10] for text in getattr(days, "unmasked", days).tolist())
    midnight = all(text[10:].startswith("T00:00:00") for text in texts)
    told_apart = len(set(days)) == len(set(texts))
    return days if told_apart and (not clock or midnight) else texts


# -- axes of time ----------------------------------------------------------------


def time_axis(header):
    """Return the number of the axis of time of a header, None if there is none."""
    for axis in range(1, header.get("NAXIS", 0) + 1):
        name = (get(header, f"CTYPE{axis}", kind=str) or "").upper()
        if re.split(r"[-(]", name)[0].strip() in WORDS["axes"]:
            return axis
    return None


def axis_times(header, axis, hdus=()):
    """
    Return the date of each pixel of an axis of time, in UTC.

    They are those of a table (``-TAB``, or a column of times of as many rows), or of
    ``CRVAL`` and ``CDELT``, from ``MJDREF``, ``JDREF`` or ``DATEREF``, or else from the
    start of the observation, unless they are Julian dates themselves.  Dates that
    cannot be made raise a ValueError.
    """
    n = header[f"NAXIS{axis}"]
    name = str(header[f"CTYPE{axis}"]).upper().strip()
    given = get(header, f"CUNIT{axis}", kind=str) or ""
    values, unit = _of_table(header, axis, hdus, n)
    if isinstance(values, Time):
        return _in_utc(values)
    if values is None:
        if name.endswith("-TAB"):
            raise ValueError(f"has times in a table on axis {name}, which is not there")
        start, pixel, step = axis_numbers(header, axis)
        step = step or get(header, f"CD{axis}_{axis}", kind=float) or 0.0
        if n > 1 and not step:
            raise ValueError(f"has no step on axis {name} (CDELT{axis}); write it")
        values = (start or 0.0) + (np.arange(1, n + 1) - pixel) * step
    usual = get(header, "TIMEUNIT", kind=str) or "s"
    usual = "d" if name.startswith(("MJD", "JD")) else usual
    unit = (unit or given).strip() or usual
    unit = WORDS["units"].get(unit.lower(), unit)
    wrong = f"has the unit {unit!r} on axis {name}, which is no time; correct it"
    with refusing(wrong, TypeError, ValueError, u.UnitsError):
        seconds = np.asarray(values, dtype=float) * u.Unit(unit).to(u.s)
    scale = _scale_of(header)
    scale = next((part for part in (name, name[:3]) if part in SCALES), scale)
    return _in_utc(_from_reference(header, name, seconds, scale))


def _from_reference(header, name, seconds, scale):
    """Return times that are given in seconds from the reference of a header."""
    known = SCALES.get(scale, "utc")
    reference = observing_time(header, start=True)[0]
    forms = WORDS["references"]
    keyword = next((k for k in forms if get(header, k, kind=float)), None)
    if keyword is not None:
        more = get(header, "MJDREFF", kind=float) if keyword == "MJDREFI" else None
        day, form = get(header, keyword, kind=float), forms[keyword]
        reference = _in_scale(Time(day, more or 0.0, format=form, scale=known), scale)
    elif text := get(header, "DATEREF", kind=str):
        reference = Time(_of_text(text, scale)[1], scale=known)
    else:
        days = seconds / DAY
        form = "jd" if days[0] > FIRST_JD else "mjd"
        found = _in_scale(Time(days, format=form, scale=known), scale)
        # wcslib writes a reference of 0 to every header.
        zero = get(header, "MJDREF", kind=float) == 0
        near = zero if reference is None else abs(found[0].mjd - reference.mjd) < 2
        if near or name.startswith(tuple(WORDS["julian"])):
            return found
    if reference is None:
        raise ValueError(
            f"has times on axis {name} and no date from which they count; write "
            "DATE-OBS or MJDREF to its header"
        )
    with warnings.catch_warnings(action="ignore"):
        # Seconds are those of atomic time.
        return reference.tai + TimeDelta(seconds, format="sec")


def _of_table(header, axis, hdus, n):
    """Return the n times in a table and their unit, None if there is none."""
    tables, wanted = [h for h in hdus if hasattr(h, "columns")], WORDS["columns"]
    name, column = (get(header, f"PS{axis}_{k}", kind=str) for k in (0, 1))
    tabled = str(header[f"CTYPE{axis}"]).strip().upper().endswith("-TAB")
    if tabled and name and column:
        tables = [table for table in tables if table.name == name.upper()]
        wanted = [column.upper()]
    for table, want in product(tables, wanted):
        # Their case does not matter.
        if want not in map(str.upper, table.columns.names):
            continue
        values = np.asarray(table.data[want]).reshape(-1)
        if len(values) != n:
            continue
        if values.dtype.kind in "SU":
            scale = _scale_of(header)
            return Time([_of_text(str(text), scale)[1] for text in values]), ""
        unit = table.columns[want].unit or ""
        return values.astype(float), unit or ("d" if want in ("MJD", "JD") else "")
    return None, ""
