# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What files hold, what is wrong with them, and what their dates allow."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.time import Time

from astro_scc.epochs.assembly import find_files
from astro_scc.epochs.consistency import find_odd, find_same_dates, looks_like_mask
from astro_scc.epochs.description import readable_angle
from astro_scc.epochs.fits import read_image
from astro_scc.epochs.headers import header_beam, header_facts, observing_time
from astro_scc.epochs.statistics import measure_noise

__all__ = ["IntervalPlan", "inspect_epochs", "plan_intervals"]

# Displacements that can be told from none, as the paper has it (Sect. 2.2),
# and those between which pairs of epochs work best, in beams.
SMALLEST_SHIFT = 0.2
GOOD_SHIFTS = (0.3, 1.5)
# Resolution of images without a beam, in pixels.
PIXELS_RESOLVED = 3.0


def inspect_epochs(paths, *, hdu=None):
    """
    Facts of each file, and what is wrong with it; no file is refused.

    Parameters
    ----------
    paths : str, path-like, or sequence of them
        Files or patterns.
    hdu : int or str, optional
        The extension that holds the image, by default the first image.

    Returns
    -------
    `~astropy.table.QTable`
        One row a file, sorted by date, files without one last: ``file``,
        ``date`` (masked where missing), ``nx``, ``ny``, ``pixel``,
        ``major``, ``minor``, ``pa``, ``peak``, ``noise``, ``peak_east``,
        ``peak_north`` (the brightest pixel from the reference pixel),
        ``object``, ``frequency`` and ``problem``, empty where there is
        none.  Numbers that are not known are NaN or 0.

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
    from astropy.table import QTable

    files = find_files(paths, missing_ok=True)
    rows = [_inspect(path, hdu) for path in files]
    dated = [row for row in rows if row["date"] is not None]
    dated.sort(key=lambda row: row["date"])
    rows = dated + [row for row in rows if row["date"] is None]
    _compare(rows)

    known = [row["date"] is not None for row in rows]
    mjd = [row["date"].mjd if k else 0.0 for row, k in zip(rows, known, strict=True)]
    date = Time(mjd, format="mjd", scale="utc")
    date.format = "iso"
    if not all(known):
        date[~np.array(known)] = np.ma.masked
    unit = next((row["unit"] for row in rows if row["unit"] is not None), None)
    unit = u.dimensionless_unscaled if unit is None else unit

    def column(name, unit=None):
        values = [row[name] for row in rows]
        return values if unit is None else u.Quantity(values, unit)

    table = QTable({"file": [str(row["path"]) for row in rows]})
    table["date"] = date
    for name in ("nx", "ny"):
        table[name] = column(name)
    table["pixel"] = column("pixel", u.mas)
    table["major"] = column("major", u.mas)
    table["minor"] = column("minor", u.mas)
    table["pa"] = column("pa", u.deg)
    for name in ("peak", "noise"):
        table[name] = u.Quantity([_in_unit(row, name, unit) for row in rows], unit)
    table["peak_east"] = column("peak_east", u.mas)
    table["peak_north"] = column("peak_north", u.mas)
    table["object"] = column("object")
    table["frequency"] = column("frequency", u.GHz)
    table["problem"] = ["; ".join(row["problems"]) for row in rows]
    return table


def _blank(path):
    numbers = "pixel major minor pa peak noise peak_east peak_north frequency".split()
    return {
        "path": path,
        "date": None,
        "nx": 0,
        "ny": 0,
        "object": "",
        "unit": None,
        "facts": {},
        "wcs": None,
        "problems": [],
        **dict.fromkeys(numbers, np.nan),
    }


def _inspect(path, hdu):
    row = _blank(path)
    try:
        image, notes = read_image(path, hdu=hdu)
    except (OSError, ValueError) as error:
        row["problems"].append(str(error).removeprefix(f"{path}: "))
        return row
    row["problems"] += notes
    row["facts"] = header_facts(image.meta)
    row["object"] = row["facts"].get("object", "")
    row["frequency"] = row["facts"].get("frequency", np.nan) / 1e9
    row["ny"], row["nx"] = image.shape
    row["wcs"] = image.wcs
    row["unit"] = image.unit
    matrix = image.wcs.pixel_scale_matrix * u.deg.to(u.mas)
    row["pixel"] = np.sqrt(np.abs(np.linalg.det(matrix)))
    try:
        row["date"] = observing_time(image.meta)
        if row["date"] is None:
            row["problems"].append("no date of observation")
    except ValueError as error:
        row["problems"].append(str(error))
    beam = header_beam(image.meta)
    if beam is not None:
        row["major"] = beam.major.to_value(u.mas)
        row["minor"] = beam.minor.to_value(u.mas)
        row["pa"] = beam.pa.to_value(u.deg)
    if looks_like_mask(image.data):
        row["problems"].append("no more than two different values, a mask")
    values = np.where(np.isfinite(image.data), image.data, -np.inf)
    y, x = np.unravel_index(np.argmax(values), values.shape)
    row["peak"] = float(values[y, x])
    row["peak_east"], row["peak_north"] = matrix @ ([x, y] - image.wcs.wcs.crpix + 1)
    row["noise"] = measure_noise(image.data, mask=image.mask)
    return row


def _in_unit(row, name, unit):
    """The number in the unit of the table, NaN if it cannot be."""
    if row["unit"] is None or not row["unit"].is_equivalent(unit):
        return np.nan
    return row["unit"].to(unit, row[name])


def _compare(rows):
    """Add what is wrong with files beside one another."""
    read = [row for row in rows if row["wcs"] is not None]
    odd = find_odd(
        [row["facts"] for row in read],
        [row["wcs"].wcs.crval for row in read],
        [row["pixel"] * max(row["nx"], row["ny"]) * u.mas.to(u.deg) for row in read],
    )
    for i, what, _ in odd:
        read[i]["problems"].append(what)
    dated = [row for row in read if row["date"] is not None]
    if dated:
        for i, k in find_same_dates(Time([row["date"] for row in dated])):
            dated[k]["problems"].append(f"of the date of {dated[i]['path'].name}")
    if not read:
        return
    for row in read[1:]:
        first = read[0]
        if not row["unit"].is_equivalent(first["unit"]):
            row["problems"].append(
                f"its unit is {row['unit'].to_string() or 'none'}, that of others is "
                f"{first['unit'].to_string() or 'none'}"
            )
    beams = np.isfinite([row["major"] for row in read])
    if beams.any() and not beams.all():
        for row, has in zip(read, beams, strict=True):
            if not has:
                row["problems"].append("no beam where others have one")
    usual = _commonest([_grid(row) for row in read])
    for row in read:
        if _grid(row) != usual:
            nx, ny, pixel = usual
            row["problems"].append(
                f"on another grid than most ({nx} x {ny} of {pixel}), resampled"
            )


def _grid(row):
    return row["nx"], row["ny"], readable_angle(row["pixel"] * u.mas)


def _commonest(values):
    return max(values, key=values.count)


@dataclass(frozen=True)
class IntervalPlan:
    """
    What the dates of a series allow to be measured.

    With b the resolution (geometric mean of the beam's axes, median over
    the epochs), T the span of the series, dt the median interval between
    consecutive epochs and L the shorter side of the images:

    - ``slowest = 0.2 b / T``: what moves less than a fifth of a beam from
      the first to the last epoch cannot be told from what stands still.
    - ``fastest = L / (2 dt)``: what crosses half of the image between
      consecutive epochs is in one of them only.
    - ``consecutive = (0.3, 1.5) b / dt``: speeds for which consecutive
      epochs are the best pairs; slower features hardly move between them,
      faster ones change before they can be recognised.

    Attributes
    ----------
    n_epochs : int
    span : `~astropy.units.Quantity`
    shortest, median, longest : `~astropy.units.Quantity`
        Intervals between consecutive epochs of different date.
    resolution : `~astropy.units.Quantity`
    slowest, fastest : `~astropy.units.Quantity`
        ``fastest`` is None where the size of the images is not known.
    consecutive : `~astropy.units.Quantity`, shape (2,)
    """

    n_epochs: int
    span: u.Quantity
    shortest: u.Quantity
    median: u.Quantity
    longest: u.Quantity
    resolution: u.Quantity
    slowest: u.Quantity
    fastest: u.Quantity | None
    consecutive: u.Quantity

    def baseline(self, speed):
        """
        Intervals between epochs that suit a speed.

        ``(0.3, 1.5) b / speed``, so that pairs of epochs are between a third
        of a beam and one and a half beams of motion apart.

        Parameters
        ----------
        speed : `~astropy.units.Quantity`
            Expected speed, an angle per time.

        Returns
        -------
        `~astropy.units.Quantity`, shape (2,)
            Shortest and longest interval, for the option ``baseline``, no
            longer than the series.

        Raises
        ------
        ValueError
            If the speed is not positive, or too slow for the series.
        """
        speed = u.Quantity(speed).to(self.slowest.unit)
        if not speed > 0:
            raise ValueError(f"speed must be positive, got {speed}")
        wanted = (np.array(GOOD_SHIFTS) * self.resolution / speed).to(self.span.unit)
        # Rounding must not refuse the slowest speed that the plan names.
        if wanted[0] > self.span * (1 + 1e-9):
            raise ValueError(
                f"at {speed:.3g} nothing moves {GOOD_SHIFTS[0]} of a beam in the "
                f"{self.span:.3g} of the series"
            )
        return np.minimum(wanted, self.span)

    def lines(self):
        """
        The plan as sentences.

        Returns
        -------
        list of str
        """
        unit = self.span.unit
        low, high = self.consecutive
        lines = [
            f"{self.n_epochs} epochs over {self.span:.3g}, "
            f"{self.shortest.value:.3g} to {self.longest:.3g} apart, "
            f"median {self.median:.3g}; resolution {readable_angle(self.resolution)}.",
            f"Slower than {self.slowest:.2g} cannot be told from standing still"
            + (
                f"; faster than {self.fastest:.3g} leaves the image."
                if self.fastest is not None
                else "."
            ),
            f"Consecutive epochs suit speeds of {low.value:.2g} to {high:.2g}.",
        ]
        slow = np.sqrt(low * self.slowest)
        if self.n_epochs > 2 and self.slowest < slow < low:
            first, last = self.baseline(slow)
            lines.append(
                f"For slower features pair epochs that are further apart: at "
                f'{slow:.2g}, --baseline "{first.value:.2g} {unit} '
                f'{last.value:.2g} {unit}".'
            )
        return lines

    def __str__(self):
        return "\n".join(self.lines())


def plan_intervals(cube, beam=None, *, extent=None):
    """
    What the dates of a series allow to be measured.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube` or `~astropy.time.Time`
        At least two epochs of different date.
    beam : beam, sequence of beams or `~astropy.units.Quantity`, optional
        Or the resolution itself.  By default the beams of the cube, or
        three pixels where it has none.
    extent : `~astropy.units.Quantity`, optional
        Shorter side of the images, by default that of the cube.

    Returns
    -------
    `IntervalPlan`

    Raises
    ------
    ValueError
        If there are fewer than two dates, or dates come without a beam.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.time import Time
    >>> from astro_scc.epochs import Beam, plan_intervals
    >>> times = Time(["2000-01-01", "2000-07-01", "2001-01-01", "2002-01-01"])
    >>> plan = plan_intervals(times, Beam(1 * u.mas, 0.5 * u.mas))
    >>> plan.slowest.round(3), plan.consecutive.round(2)
    (<Quantity 0.071 mas / yr>, <Quantity [0.42, 2.11] mas / yr>)
    >>> plan.baseline(1 * u.mas / u.yr).round(2)
    <Quantity [0.21, 1.06] yr>
    """
    times = cube if isinstance(cube, Time) else cube.times
    days = np.unique(np.atleast_1d((times - np.atleast_1d(times)[0]).jd))
    if days.size < 2:
        raise ValueError("velocities need at least two epochs of different date")
    resolution = _resolution(cube, beam)
    if extent is None and not isinstance(cube, Time):
        sides = np.hypot(*cube.pixel_matrix.value) * cube.shape[:0:-1] * u.mas
        extent = sides.min()
    gaps = np.diff(days) * u.day
    median = np.median(gaps)
    span = (days[-1] - days[0]) * u.day
    time = _time_unit(span)
    speed = (u.mas if resolution < 0.1 * u.arcsec else u.arcsec) / time
    return IntervalPlan(
        n_epochs=int(np.size(times)),
        span=span.to(time),
        shortest=gaps.min().to(time),
        median=median.to(time),
        longest=gaps.max().to(time),
        resolution=resolution.to(u.mas),
        slowest=(SMALLEST_SHIFT * resolution / span).to(speed),
        fastest=None if extent is None else (extent / (2 * median)).to(speed),
        consecutive=(np.array(GOOD_SHIFTS) * resolution / median).to(speed),
    )


def _time_unit(span):
    if span > 0.1 * u.yr:
        return u.yr
    return u.day if span > 2 * u.day else u.hour


def _resolution(cube, beam):
    from astro_scc.epochs.validation import as_beam

    if beam is None and not isinstance(cube, Time):
        if cube.beams is None:
            return PIXELS_RESOLVED * cube.pixel_scale
        beam = cube.beams
    if beam is None:
        raise ValueError("dates alone need a beam, or the resolution as an angle")
    if isinstance(beam, u.Quantity) and not hasattr(beam, "major"):
        return beam
    beams = [beam] if hasattr(beam, "major") else beam
    sizes = [np.sqrt(b.major * b.minor) for b in map(as_beam, beams)]
    return np.median(u.Quantity(sizes))
