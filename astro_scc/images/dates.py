# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""When an image was taken, by the keywords of its header."""

import re
import warnings
from contextlib import suppress
from dataclasses import dataclass, replace

import astropy.units as u
import numpy as np
from astropy.time import Time, TimeDelta

from astro_scc.images.cards import get
from astro_scc.quantities import parse_date

#: Keywords of dates as text and as (modified) Julian dates: of the start of the
#: exposure, of its middle and of its end, the first ones before the others.
STARTS = "DATE-OBS", "DATE_OBS", "DATE-BEG", "DATE_BEG"
MIDDLES = "DATE-AVG", "DATE_AVG", "DATE-MID", "DATEMID", "T_OBS"
DAYS = ("MJD-OBS", "MJD_OBS", "MJD-BEG", "EXPSTART", "MJD", "JD", "JD-OBS")
MIDDLE_DAYS = "MJD-AVG", "MJD_AVG", "MJD-MID", "EXPMID"
ENDS, END_DAYS = ("DATE-END", "DATE_END"), ("MJD-END", "EXPEND")
#: Keywords of the time of the day, text or seconds, beside a date without it.
CLOCKS = (
    *("TIME-OBS", "TIME_OBS", "UT", "UTC-OBS", "UTC_OBS", "UT-OBS", "UTC", "UTSTART"),
    *("UTC-STR", "UT-STR", "TIME-BEG", "TM-START", "UTIME", "UTCSTART", "TIME"),
)
#: Keywords of the duration of the exposure in seconds.
EXPOSURES = "EXPTIME", "XPOSURE", "EXPOSURE", "TEXPTIME", "EXP_TIME", "EXPOS"
#: Time scales by their names in headers; dates of others are in UTC.
SCALES = {name.upper(): name for name in ("tai", "tt", "tdb", "tcb", "tcg", "ut1")}
SCALES |= {"IAT": "tai", "GPS": "tai", "TDT": "tt", "ET": "tt"}
SCALES |= dict.fromkeys(("UTC", "UT", "GMT", "Z"), "utc")
#: Units of time in comments of cards, in seconds.
WORDS = {
    r"(?i)\[h|\bho?u?rs?\b": 3600.0,
    r"(?i)\[min|\bmin(ute)?s?\b": 60.0,
    r"(?i)\[ms|\bms(ec)?\b|\bmillisec": 1e-3,
    r"(?i)\[s|\bsec": 1.0,
}
#: Hours of a day.
HOURS = 24
#: Days by which dates with a time of the day may differ and be of one exposure, or of
#: one night by the clock of the place.
LONGEST = 0.9
#: GPS time is behind atomic time.
GPS = 19 * u.s
#: Smallest Julian date that is no modified one.
FIRST_JD = 2.4e6
#: Units of time axes beside those that astropy knows.
UNITS = {"": "s", "sec": "s", "secs": "s", "seconds": "s", "a": "yr", "days": "d"}
#: Names of axes of time.
AXES = "TIME", "UTC", "UT", "TAI", "IAT", "TT", "TDT", "TDB", "MJD", "JD", "GPS"
#: Names of columns of times.
COLUMNS = "TIME", "MJD", "JD", "DATE-OBS", "DATE_OBS", "DATE", "TIME-OBS"
_CLOCK = re.compile(
    r"(\d{1,2})[: H-](\d{1,2})(?:[: M-](\d{1,2})(\.\d*)?)?[MS]?$"
    r"|(\d\d)(\d\d)(\d\d)(\.\d*)?$"
)
_SUFFIX = re.compile(r"[ _](UTC|UT|TAI|TT|TDB)$")


@dataclass(frozen=True)
class Found:
    """
    A date of a header: its Time, how precise it is, and of which keyword.

    ``precision`` is in seconds, that of a whole day if there is no time of the day.
    """

    time: Time
    precision: float
    keyword: str
    middle: bool = False

    @property
    def day_only(self):
        """Whether nothing but the day is known."""
        return self.precision >= u.day.to(u.s)


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
    for keyword in (*STARTS, *MIDDLES):
        if isinstance(value := get(header, keyword), Time):
            return value, ""
    scale = _scale_of(header)
    starts, problem = _texts(header, STARTS, scale)
    starts += _days(header, DAYS, scale)
    middles, other = _texts(header, MIDDLES, scale, middle=True)
    middles += _days(header, MIDDLE_DAYS, scale, middle=True)
    every = [*starts, *middles]
    if not every:
        if problem or other:
            raise ValueError(problem or other)
        return None, ""
    first = every[0]
    if first.day_only and not first.middle:
        starts[:1] = [first, *_with_clock(header, first)]
    exposure = _exposure(header)
    agreed = [one for one in starts if _agrees(one, first)]
    begin = min(agreed, key=_precision, default=None)
    remark = _contradictions(starts, first) or _unknown_scale(scale)
    if first.day_only and not first.middle:
        remark = remark or _hours_or_seconds(header)
    if start:
        return (None if begin is None else _in_utc(begin.time)), remark
    half = _half_exposure(header, begin, exposure, scale)
    if (begin or first).day_only:
        middles += _before_end(header, exposure, scale)
    middle = min(
        (one for one in middles if _follows(one, begin or first, exposure)),
        key=_precision,
        default=None,
    )
    if middle is not None and (begin is None or _better(middle, begin)):
        return _in_utc(middle.time), remark
    return _in_utc((begin or first).time + half), remark


def _scale_of(header):
    """Return the time scale of a header, TT for ``TT(TAI)``."""
    scale = (get(header, "TIMESYS", kind=str) or "UTC").upper()
    return scale.partition("(")[0].strip()


def _unknown_scale(scale):
    """Return a remark on a time scale that is not known."""
    if scale in SCALES:
        return ""
    return (
        f"its time scale TIMESYS = {scale} is not known and taken for UTC; correct its "
        "dates, and TIMESYS, if they are local"
    )


def _contradictions(starts, first):
    """Return a remark on dates that are of other days than the first one."""
    others = "; ".join(
        f"{one.keyword} is of {one.time.isot[:10]}"
        for one in starts
        # Of a day alone, the other may be of its last second or of another scale.
        if abs((one.time - first.time).jd)
        > (1.5 if one.day_only or first.day_only else LONGEST)
    )
    if not others:
        return ""
    return (
        f"its {first.keyword} is of {first.time.isot[:10]}, which is taken, and "
        f"{others}; correct the header if that is wrong"
    )


def _exposure(header):
    """Return the exposure in seconds, also where its comment says another unit."""
    for keyword in EXPOSURES:
        if value := get(header, keyword, kind=float):
            return value * _unit_of(header, keyword, 1.0)
    return 0.0


def _unit_of(header, keyword, default):
    """Return the seconds of a unit of time that the comment of a card names."""
    comment = ""
    with suppress(AttributeError, KeyError):
        comment = str(header.comments[keyword])
    return next((s for word, s in WORDS.items() if re.search(word, comment)), default)


def _precision(found):
    return found.precision


def _better(middle, begin):
    """Return whether the middle is more precise than the start, or than their gap."""
    if middle.precision <= begin.precision:
        return True
    return middle.precision < abs((middle.time - begin.time).to_value(u.s))


def _agrees(one, first):
    """Return whether two dates of the start may be of the same instant."""
    gap = abs((one.time - first.time).to_value(u.s))
    if first.day_only or one.day_only:
        return one.time.isot[:10] == first.time.isot[:10] or (
            _in_utc(one.time).isot[:10] == _in_utc(first.time).isot[:10]
        )
    return gap <= first.precision + one.precision


def _follows(middle, begin, exposure):
    """Return whether a middle of an exposure may be that of its start."""
    gap = (middle.time - begin.time).to_value(u.s)
    day = u.day.to(u.s)
    if middle.day_only:
        return begin.day_only and 0 <= gap < day
    # A day that is given in UTC may begin later in other scales.
    return -min(begin.precision, 100.0) <= gap <= max(day, exposure)


def _half_exposure(header, begin, exposure, scale):
    """Return half of the exposure, none if the time of its start is not known."""
    if begin is None or begin.day_only:
        return TimeDelta(0, format="sec")
    later = [one for one in _ends(header, scale) if one.time > begin.time]
    if later:
        # Exposures leave out the pauses.
        end = min(later, key=_precision)
        exposure = max(exposure, (end.time - begin.time).to_value(u.s))
    elif exposure > u.day.to(u.s):
        # It is the sum of many, of which the dates are not known.
        exposure = 0.0
    return TimeDelta(max(exposure, 0.0) / 2, format="sec")


def _ends(header, scale):
    """Return the dates of the end of the exposure that have the time of the day."""
    ends = _texts(header, ENDS, scale)[0] + _days(header, END_DAYS, scale)
    return [one for one in ends if not one.day_only]


def _before_end(header, exposure, scale):
    """Return half of the exposure before its end."""
    half = TimeDelta(exposure / 2, format="sec")
    return [
        replace(one, time=one.time - half, middle=True) for one in _ends(header, scale)
    ]


def _hours_or_seconds(header):
    """Return a remark if a time of the day is a number of which the unit is unknown."""
    for keyword in CLOCKS:
        number = get(header, keyword, kind=float)
        if number is None or not 0 < number <= HOURS or _unit_of(header, keyword, 0.0):
            continue
        what = "is left out" if _is_doubtful(header, keyword, number) else "is seconds"
        return (
            f"its {keyword} = {number:g} may be hours or seconds and {what}; write it "
            "as HH:MM:SS"
        )
    return ""


def _is_doubtful(header, keyword, number):
    """Return whether a number may be hours, which is likely for universal time."""
    likely = 0 < number <= HOURS and keyword.startswith("UT")
    return likely and not _unit_of(header, keyword, 0.0)


def _texts(header, keywords, scale, middle=False):
    """Return the dates that are written as text, and why one could not be read."""
    found, problem = [], ""
    for keyword in keywords:
        if (text := get(header, keyword, kind=str)) is None:
            continue
        try:
            found.append(Found(*_of_text(text, scale), keyword, middle))
        except ValueError as error:
            problem = problem or f"{keyword}: {error}"
    return found, problem


def _of_text(text, scale):
    """Return the Time of a text and its precision in seconds."""
    plain = text.strip()
    if suffix := _SUFFIX.search(plain.upper()):
        plain, scale = plain[: suffix.start()], suffix[1]
    elif re.search(r"(Z|\+00:?00)$", plain.upper()):
        scale = "UTC"
    # The Sun's observatories write 2011.02.15_00:00:27.30.
    plain = re.sub(r"^(\d{4})[.](\d\d)[.](\d\d)", r"\1-\2-\3", plain)
    plain = re.sub(r"(?<=\d)_(?=\d\d:)", "T", plain)
    time = _in_scale(parse_date(plain, SCALES.get(scale, "utc")), scale)
    if re.fullmatch(r"\d{4}\.\d+", plain):
        return time, u.yr.to(u.s) * 10.0 ** -len(plain[5:])
    clock = re.search(r"[T ](\d.*?)(Z|\+.*)?$", plain.upper())
    return time, _of_clock(clock[1].strip() if clock else "")


def _of_clock(clock):
    """Return the precision of a time of the day, that of a day for midnight."""
    if not clock or not re.search(r"[1-9]", clock):
        return u.day.to(u.s)
    _, _, fraction = clock.partition(".")
    return 10.0 ** -len(fraction) if clock.count(":") > 1 else 60.0


def _days(header, keywords, scale, middle=False):
    """Return the dates that are written as (modified) Julian dates."""
    found = []
    for keyword in keywords:
        day = get(header, keyword, kind=float) or 0
        if not day > 0:
            continue
        form = "jd" if day > FIRST_JD else "mjd"
        if form == "mjd" and keyword.startswith("JD"):
            # A part of a Julian date, of which nothing says which.
            continue
        time = Time(day, format=form, scale=SCALES.get(scale, "utc"))
        digits = len(repr(day).partition(".")[2].rstrip("0"))
        precision = u.day.to(u.s) * 10.0**-digits
        found.append(Found(_in_scale(time, scale), precision, keyword, middle))
    return found


def _with_clock(header, day):
    """Return the date of a day alone with its times of the day in other keywords."""
    found = []
    for keyword in CLOCKS:
        seconds, precision = _seconds(header, keyword)
        if seconds is not None:
            # On the day itself, so that leap seconds do not move it.
            time = day.time + TimeDelta(seconds, format="sec")
            found.append(Found(time, precision, f"{day.keyword} and {keyword}"))
    return found


def _seconds(header, keyword):
    """Return a time of the day in seconds, and its precision; None if it is none."""
    text = get(header, keyword, kind=str)
    if text is None:
        return None, 0.0
    # It may have the day, too.
    text = re.split(r"[T_ ](?=\d{1,2}:)", text.upper())[-1]
    text = re.sub(r"(Z| ?UTC?)$", "", text).strip()
    if match := _CLOCK.match(text):
        # Of one of the two forms.
        hours, minutes, seconds, fraction = match.groups()[4 * (match[1] is None) :][:4]
        total = 3600 * int(hours) + 60 * int(minutes) + float(seconds or 0)
        if int(hours) > 24 or int(minutes) > 59:
            return None, 0.0
        digits = len((fraction or ".")[1:])
        precision = 60.0 if seconds is None else 10.0**-digits
        return total + float(fraction or 0), precision
    number = get(header, keyword, kind=float)
    if number is None or not 0 <= number <= u.day.to(u.s):
        return None, 0.0
    if _is_doubtful(header, keyword, number):
        return None, 0.0
    digits = len(text.partition(".")[2].rstrip("0"))
    unit = _unit_of(header, keyword, 1.0)
    return number * unit, unit * 10.0**-digits


def _in_scale(time, scale):
    """Return a time that was read in the scale of a name as what it means."""
    if scale == "GPS":
        return time + GPS
    return time


def _in_utc(time):
    with warnings.catch_warnings(action="ignore"):
        return Time(time.utc, format="isot")


# -- axes of time ----------------------------------------------------------------


def time_axis(header):
    """Return the number of the axis of time of a header, None if there is none."""
    for axis in range(1, header.get("NAXIS", 0) + 1):
        name = str(header.get(f"CTYPE{axis}", "")).upper().strip()
        if re.split(r"[-(]", name)[0].strip() in AXES:
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
    unit = get(header, f"CUNIT{axis}", kind=str) or ""
    values = _of_table(header, axis, hdus, n)
    if values is not None:
        values, unit = values[0], values[1] or unit
        if isinstance(values, Time):
            return _in_utc(values)
    elif name.endswith("-TAB"):
        raise ValueError(f"has times in a table on axis {name}, which is not there")
    else:
        start = get(header, f"CRVAL{axis}", kind=float) or 0.0
        step = get(header, f"CDELT{axis}", f"CD{axis}_{axis}", kind=float)
        pixel = get(header, f"CRPIX{axis}", kind=float)
        if n > 1 and not step:
            raise ValueError(f"has no step on axis {name} (CDELT{axis}); write it")
        steps = np.arange(1, n + 1) - (1.0 if pixel is None else pixel)
        values = start + steps * (step or 0.0)
    unit = UNITS.get(unit.strip().lower(), unit.strip())
    if unit == "s" and not get(header, f"CUNIT{axis}", kind=str):
        unit = "d" if name.startswith(("MJD", "JD")) else unit
    try:
        seconds = np.asarray(values, dtype=float) * u.Unit(unit).to(u.s)
    except (TypeError, ValueError, u.UnitsError):
        what = f"has the unit {unit!r} on axis {name}, which is no time; correct it"
        raise ValueError(what) from None
    scale = next((part for part in (name, name[:3]) if part in SCALES), None)
    scale = scale or _scale_of(header)
    return _in_utc(_in_scale(_from_reference(header, name, seconds, scale), scale))


def _from_reference(header, name, seconds, scale):
    """Return times that are given in seconds from the reference of a header."""
    own = SCALES.get(scale, "utc")
    days = seconds / u.day.to(u.s)
    reference = None
    if (day := get(header, "MJDREF", kind=float)) is not None:
        reference = Time(day, format="mjd", scale=own)
    elif parts := get(header, "MJDREFI", kind=float):
        part = get(header, "MJDREFF", kind=float) or 0.0
        reference = Time(parts, part, format="mjd", scale=own)
    elif (day := get(header, "JDREF", kind=float)) is not None:
        reference = Time(day, format="jd", scale=own)
    elif text := get(header, "DATEREF", kind=str):
        reference = Time(_of_text(text, scale)[0], scale=own)
    start = observing_time(header, start=True)[0]
    if reference is None:
        absolute = "jd" if days[0] > FIRST_JD else "mjd"
        near = start is not None and abs(
            Time(days[0], format=absolute, scale=own).mjd - start.mjd
        )
        if name.startswith(("MJD", "JD")) or (near is not False and near < 2):
            return Time(days, format=absolute, scale=own)
        reference = start
    if reference is None:
        raise ValueError(
            f"has times on axis {name} and no date from which they count; write "
            "DATE-OBS or MJDREF to its header"
        )
    with warnings.catch_warnings(action="ignore"):
        # Seconds are those of atomic time.
        return reference.tai + TimeDelta(seconds, format="sec")


def _of_table(header, axis, hdus, n):
    """Return the times in a table and their unit, None if there is none."""
    tables = [h for h in hdus if hasattr(h, "columns")]
    name = get(header, f"PS{axis}_0", kind=str)
    column = get(header, f"PS{axis}_1", kind=str)
    tabled = str(header[f"CTYPE{axis}"]).strip().upper().endswith("-TAB")
    if tabled and name and column:
        tables = [table for table in tables if table.name == name.upper()]
        wanted = [column.upper()]
    else:
        wanted = COLUMNS
    for table in tables:
        names = {own.upper(): own for own in table.columns.names}
        for own in wanted:
            if own not in names:
                continue
            values = np.asarray(table.data[names[own]]).reshape(-1)
            if len(values) != n:
                continue
            if values.dtype.kind in "SU":
                scale = _scale_of(header)
                every = [_of_text(str(text), scale)[0] for text in values]
                return Time(every), ""
            unit = table.columns[names[own]].unit or ""
            if not unit and own in ("MJD", "JD"):
                unit = "d"
            return values.astype(float), unit
    return None
