# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""How the main speed depends on epochs, intervals, scales, places and features."""

from dataclasses import replace

import astropy.units as u
import numpy as np
from scipy.special import stdtr, stdtrit

from astro_scc.measurement.axes import alignment_errors, projection_of
from astro_scc.measurement.tables import build_table
from astro_scc.quantities import with_error
from astro_scc.stacking import dispersion
from astro_scc.stacking.errors import (
    alignment_response,
    feature_weights,
    velocity_of,
)
from astro_scc.stacking.search_settings import DEFAULT
from astro_scc.units import (
    PM_UNIT,
    in_speed_unit,
    offset_unit,
    round_to_errors,
)

#: Share of a distribution below one standard deviation above its mean.
ONE_SIGMA = 0.8413
#: Every column: unit or type, and meaning.
COLUMNS = {
    "choice": (str, "what the speed is measured from"),
    "n_features": (int, "number of features that contribute"),
    "pm": (PM_UNIT, "speed along the first component"),
    "pm_err": (PM_UNIT, "standard error of pm"),
    "change": (PM_UNIT, "difference from the speed as measured"),
    "change_err": (PM_UNIT, "standard error of change, of data that partly are common"),
    "change_sigma": (float, "change / change_err"),
    "p_value": (float, "p-value of change, for all rows and epochs together"),
    "significant": (
        bool,
        "change larger than the error of the speed, p_value <= alpha",
    ),
}


def sensitivity_table(result):
    """
    Return the speed of the first component with other choices of the data.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`

    Returns
    -------
    `~astropy.table.QTable`
        See `SCCResult.sensitivity`.
    """
    streams, alpha = result.search.streams, result.meta["settings"]["alpha"]
    if streams and streams[0].kind == "moving":
        table = _table_of(_Main.of(result), alpha)
    else:
        table = build_table([], COLUMNS)
        table.meta["note"] = "nothing moves significantly"
    return round_to_errors(in_speed_unit(table, result.cube.speed_unit))


def _table_of(main, alpha):
    """Return the table of the speed of a first component."""
    rows = [main.row(choice, use) for choice, use in _choices(main)]
    # Two parts that make up the whole are one test; the worst epoch is another.
    n_tests = len(rows) // 2 + 1
    rows = [row for row in [*rows, _worst_epoch(main)] if row is not None]
    measured = main.row("as measured", [True] * len(main.lines))
    for row in rows:
        row["p_value"] = min(1.0, n_tests * row["p_value"])
        large = abs(row["change"]) > measured["pm_err"]
        row["significant"] = large and row["p_value"] <= alpha
    measured |= {"change": 0.0, "change_err": 0.0, "change_sigma": 0.0, "p_value": 1.0}
    measured["significant"] = False
    return build_table([measured, *rows], COLUMNS)


def sensitivity_line(table):
    """
    Return a sentence on the choices that change the speed by more than its error.

    Parameters
    ----------
    table : `~astropy.table.QTable`
        See `SCCResult.sensitivity`.

    Returns
    -------
    str
        Without a full stop; empty if there are none.
    """
    parts = [
        f"{with_error(row['pm'].value, row['pm_err'].value, '+-')} {row['pm'].unit} "
        f"({row['choice']})"
        for row in table[table["significant"]]
    ]
    what = "The main speed changes by more than its error: "
    return what + ", ".join(parts) if parts else ""


class _Line:
    """The SSPs to which the straight line of a feature was fitted."""

    def __init__(self, feature, samples):
        self.feature, self.epoch = feature, samples.epoch[feature.ssp]
        self.years = samples.years[self.epoch]
        self.place = samples.position[feature.ssp, 0]
        used = feature.response != 0
        # At the mean date, an SSP does not affect the speed of the whole line.
        self.used = used | np.isclose(self.years, self.years[used].mean(), atol=1e-6)
        #: Time between all pairs of epochs of the feature, shape (n, n).
        self.intervals = self.years[:, None] - self.years
        #: Standard error of a position, in beams.
        self.sigma = feature.error / np.linalg.norm(feature.response)

    def refitted(self, use):
        """
        Return the feature with the speed that some pairs of its epochs give.

        The slope of a straight line is ``sum(d * t) / sum(t**2)`` over all pairs
        of epochs, with their displacements d and intervals t.

        Parameters
        ----------
        use : bool or `~numpy.ndarray` of bool, shape (n, n)
            The pairs of epochs that are used.

        Returns
        -------
        `~astro_scc.stacking.Feature` or None
            None if no pair of epochs is left.
        """
        interval = self.intervals * (use & _both(self.used))
        total = (interval**2).sum() / 2
        if total == 0:
            return None
        response = interval.sum(axis=1) / total
        return replace(
            self.feature,
            speed=float(response @ self.place),
            error=float(self.sigma * np.linalg.norm(response)),
            response=response,
        )


class _Main:
    """The first component: its stream, and the lines of its features."""

    def __init__(self, stream, samples, beam, misaligned, ssps, dates, time=u.yr):
        self.stream, self.beam, self.misaligned = stream, beam, misaligned
        self.epoch, self.dates, self.time = ssps.epoch, list(dates), time
        self.lines = [_Line(feature, samples) for feature in stream.features]
        self.scale = np.array([ssps.scale[f.ssp[0]] for f in stream.features])
        self.peak = np.array([np.mean(ssps.peak[f.ssp]) for f in stream.features])
        #: Unit vector along the stream on the axes of the frame.
        self.axis = np.array([np.cos(stream.angle), np.sin(stream.angle)])

    @classmethod
    def of(cls, result):
        """Return the first component of a result."""
        stream, times = result.search.streams[0], result.cube.times
        project, dates = projection_of(result), times.strftime("%Y-%m-%d")
        if len(set(dates)) < len(dates):
            dates = times.strftime("%Y-%m-%d %H:%M")
        error = result.meta["settings"].get("alignment_error")
        misaligned, ssps = alignment_errors(result.cube, error), result.matched.ssps
        of = project(stream.angle), project.beam(stream.angle)
        time = result.cube.speed_unit.bases[1]
        return cls(stream, *of, misaligned, ssps, dates, time)

    def row(self, choice, use):
        """
        Return the speed that some pairs of epochs of each feature give.

        Parameters
        ----------
        choice : str
        use : sequence of bool or `~numpy.ndarray`
            For each feature, the pairs of epochs that are used, see
            `_Line.refitted`.

        Returns
        -------
        dict or None
            None if no feature is left.
        """
        new = [k.refitted(own) for k, own in zip(self.lines, use, strict=True)]
        left = tuple(feature for feature in new if feature is not None)
        if not left:
            return None
        along = dispersion.random_effects(*dispersion.feature_speeds(left))
        stream = replace(self.stream, features=left, along=along)
        (old, _), (speed, error) = map(self._speed, (self.stream, stream))
        deviation, freedom = self._deviation(stream, new)
        ratio = (speed - old) / deviation if deviation > 0 else 0.0
        sense = np.sign(self.stream.along.mean)
        # Half the width of the 68% interval, as in other errors.
        one_sigma = stdtrit(freedom, ONE_SIGMA)
        return {
            "choice": choice,
            "n_features": len(left),
            "pm": sense * speed,
            "pm_err": error,
            "change": sense * (speed - old),
            "change_err": deviation * one_sigma,
            "change_sigma": sense * ratio / one_sigma,
            "p_value": 2 * stdtr(freedom, -abs(ratio)),
        }

    def _speed(self, stream):
        """Return the speed of a stream along itself, and its error, in mas/yr."""
        velocity = velocity_of(stream, self.beam, self.misaligned, self.epoch)
        error = np.sqrt(self.axis @ velocity.covariance @ self.axis)
        return self.axis @ velocity.value, error

    def _deviation(self, stream, new):
        """
        Return the standard deviation of the change of a speed by chance, in mas/yr.

        The change is a sum over the features' own speeds, which have a dispersion,
        and over the positions of their SSPs.  What both speeds have in common
        cancels.  The degrees of freedom are returned as well, by Satterthwaite
        (1946, Biometrics Bull. 2, 110).
        """
        n, settings, main = len(new), DEFAULT, self.stream.along
        before, after = feature_weights(self.stream), iter(feature_weights(stream))
        of_speeds, of_places, degrees = 0.0, 0.0, 0
        scatter = dispersion.variance_with_prior(n, main.mean, main.dispersion)
        for line, feature, old in zip(self.lines, new, before, strict=True):
            weight, response = 0.0, -old * line.feature.response
            if feature is not None:
                weight = next(after)
                response = response + weight * feature.response
            core = settings.core_bias * line.feature.speed
            of_speeds += (weight - old) ** 2 * (scatter + core**2)
            error = settings.error_inflation * line.sigma * np.linalg.norm(response)
            of_places += error**2
            degrees += max(line.used.sum() - 2, 0) + settings.prior_freedom
        of = self.epoch, len(self.misaligned)
        shift = alignment_response(stream, *of) - alignment_response(self.stream, *of)
        misaligned = shift**2 @ self.misaligned**2
        total = of_speeds + of_places
        freedom = total**2 / (of_speeds**2 / n + of_places**2 / degrees or 1.0)
        variance = total * self.beam[0] ** 2 + misaligned @ self.axis**2
        return np.sqrt(variance), max(freedom, 1.0)


def _choices(main):
    """Yield choices in words, with the pairs of epochs of each line that they leave."""
    lines, n = main.lines, len(main.lines)
    apart = [np.abs(line.intervals) for line in lines]
    used = [np.triu(_both(line.used), 1) for line in lines]
    limit = np.median(np.concatenate([a[k] for a, k in zip(apart, used, strict=True)]))
    shown = f"{(limit * u.yr).to_value(main.time):.2g} {main.time}"
    yield f"intervals shorter than {shown}", [a < limit for a in apart]
    yield f"intervals of {shown} or more", [a >= limit for a in apart]
    middle = len(main.dates) // 2
    date = main.dates[middle]
    yield f"epochs before {date}", [_both(k.epoch < middle) for k in lines]
    yield f"epochs from {date} on", [_both(k.epoch >= middle) for k in lines]
    if n < 2:
        return
    scales = np.unique(main.scale)
    if len(scales) > 1:
        # The division with the most even numbers of features.
        finer = [np.sum(main.scale < s) for s in scales[1:]]
        first = scales[1 + np.argmin(np.abs(np.array(finer) - n / 2))]
        for name, of in (("fine", np.less), ("coarse", np.greater_equal)):
            numbers = ", ".join(f"{s:g}" for s in scales[of(scales, first)])
            yield f"{name} scales only ({numbers})", of(main.scale, first)
    # Distances from the reference pixel, in mas.
    place = np.abs([f.place for f in main.stream.features]) * main.beam[0]
    border = np.sort(place)[n // 2 - 1 : n // 2 + 1].mean() * u.mas
    unit = offset_unit(border.value)
    border = f"{border.to_value(unit):.3g} {unit}"
    yield f"inner half, up to {border}", _lower_half(place)
    yield f"outer half, from {border}", ~_lower_half(place)
    yield "without the brighter half of features", _lower_half(main.peak)
    yield "without the fainter half of features", ~_lower_half(main.peak)


def _lower_half(values):
    """Return which values are in the lower half of all."""
    half = np.argsort(values, kind="stable")[: len(values) // 2]
    return np.isin(np.arange(len(values)), half)


def _both(chosen):
    """Return the pairs of epochs of which both are chosen."""
    return chosen & chosen[:, None]


def _worst_epoch(main):
    """Return the row of the epoch without which the speed changes most, or None."""
    rows = [
        main.row(
            f"without {main.dates[k]}, the epoch that matters most",
            [_both(line.epoch != k) for line in main.lines],
        )
        for k in np.unique(np.concatenate([line.epoch for line in main.lines]))
    ]
    rows = [row for row in rows if row is not None]
    worst = max(rows, key=lambda row: abs(row["change"]), default=None)
    return worst and worst | {"p_value": len(rows) * worst["p_value"]}
