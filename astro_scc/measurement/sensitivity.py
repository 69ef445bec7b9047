# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""How the main speed depends on epochs, intervals, scales, places and features."""

from dataclasses import dataclass, replace

import astropy.units as u
import numpy as np
from scipy.special import stdtr, stdtrit

from astro_scc.measurement.axes import alignment_errors, projection_of
from astro_scc.measurement.tables import build_table
from astro_scc.quantities import with_error
from astro_scc.stacking import Feature, Stream, dispersion
from astro_scc.stacking.errors import alignment_response, velocity_of
from astro_scc.stacking.search_settings import DEFAULT
from astro_scc.units import (
    PM_UNIT,
    in_easy_units,
    offset_unit,
    round_to_errors,
    time_unit,
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
    if not streams or streams[0].kind != "moving":
        table = build_table([], COLUMNS)
        table.meta["note"] = "nothing moves significantly"
        return table
    return _table_of(_Main.of(result), alpha)


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
    names = "change", "change_err", "change_sigma", "significant"
    measured |= dict.fromkeys(names, 0.0) | {"p_value": 1.0}
    return round_to_errors(build_table([measured, *rows], COLUMNS))


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
    own = in_easy_units(table)[table["significant"]]
    if len(own) == 0:
        return ""
    parts = [
        f"{with_error(row['pm'].value, row['pm_err'].value, '+-')} {row['pm'].unit} "
        f"({row['choice']})"
        for row in own
    ]
    return f"The main speed changes by more than its error: {', '.join(parts)}"


@dataclass(frozen=True, eq=False)
class _Line:
    """The SSPs to which the straight line of a feature was fitted."""

    feature: Feature
    used: np.ndarray
    years: np.ndarray
    epoch: np.ndarray
    place: np.ndarray

    @classmethod
    def of(cls, feature, samples):
        """Return the line of a feature, without the SSPs near standing features."""
        epoch = samples.epoch[feature.ssp]
        years = samples.years[epoch]
        used = feature.response != 0
        # At the mean date, an SSP does not affect the speed of the whole line.
        used |= np.isclose(years, years[used].mean(), atol=1e-6)
        place = samples.position[feature.ssp, 0]
        return cls(feature, used, years, epoch, place)

    @property
    def sigma(self):
        """Standard error of a position, in beams."""
        return self.feature.error / np.linalg.norm(self.feature.response)

    def refitted(self, use):
        """
        Return the feature with the speed that some pairs of its epochs give.

        The slope of a straight line is ``sum(d * t) / sum(t**2)`` over all pairs
        of epochs, with their displacements d and intervals t.

        Parameters
        ----------
        use : bool or `~numpy.ndarray` of bool, shape (n, n)
            The pairs that are used.

        Returns
        -------
        `~astro_scc.stacking.Feature` or None
            None if no pair is left.
        """
        interval = self.years[:, None] - self.years
        interval = interval * (use & _both(self.used))
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


@dataclass(frozen=True, eq=False)
class _Main:
    """The first component: its stream, and the lines of its features."""

    stream: Stream
    lines: list
    beam: np.ndarray
    misaligned: np.ndarray
    epoch: np.ndarray
    scale: np.ndarray
    peak: np.ndarray
    dates: list
    sense: float

    @classmethod
    def of(cls, result):
        """Return the first component of a result."""
        stream, cube, ssps = result.search.streams[0], result.cube, result.matched.ssps
        project = projection_of(result)
        samples = project(stream.angle)
        dates = cube.times.strftime("%Y-%m-%d")
        if len(set(dates)) < len(dates):
            dates = cube.times.strftime("%Y-%m-%d %H:%M")
        error = result.meta["settings"].get("alignment_error")
        return cls(
            stream=stream,
            lines=[_Line.of(feature, samples) for feature in stream.features],
            beam=project.beam(stream.angle),
            misaligned=alignment_errors(cube, error),
            epoch=ssps.epoch,
            scale=np.array([ssps.scale[f.ssp[0]] for f in stream.features]),
            peak=np.array([np.mean(ssps.peak[f.ssp]) for f in stream.features]),
            dates=list(dates),
            sense=float(np.sign(stream.along.mean)),
        )

    @property
    def place(self):
        """Distance of each feature from the reference pixel, in mas."""
        return np.array([abs(f.place) for f in self.stream.features]) * self.beam[0]

    def row(self, choice, use):
        """
        Return the speed that some pairs of epochs of each feature give.

        Parameters
        ----------
        choice : str
        use : sequence of bool or `~numpy.ndarray`
            For each feature, the pairs that are used, see `_Line.refitted`.

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
        change = speed - old
        ratio = change / deviation if deviation > 0 else 0.0
        return {
            "choice": choice,
            "n_features": len(left),
            "pm": self.sense * speed,
            "pm_err": error,
            "change": self.sense * change,
            # Half the width of the 68% interval, as in other errors.
            "change_err": deviation * stdtrit(freedom, ONE_SIGMA),
            "change_sigma": self.sense * ratio / stdtrit(freedom, ONE_SIGMA),
            "p_value": 2 * stdtr(freedom, -abs(ratio)),
        }

    def _speed(self, stream):
        """Return the speed of a stream along itself, and its error, in mas/yr."""
        velocity = velocity_of(stream, self.beam, self.misaligned, self.epoch)
        along = np.array([np.cos(stream.angle), np.sin(stream.angle)])
        return along @ velocity.value, np.sqrt(along @ velocity.covariance @ along)

    def _deviation(self, stream, new):
        """
        Return the standard deviation of the change of a speed by chance, in mas/yr.

        The change is a sum over the features' own speeds, which have a dispersion,
        and over the positions of their SSPs.  What both speeds have in common
        cancels.  The degrees of freedom are returned as well, by Satterthwaite
        (1946, Biometrics Bull. 2, 110).
        """
        n, settings, main = len(new), DEFAULT, self.stream.along
        before, after = _weights(self.stream), iter(_weights(stream))
        of_speeds, of_places, degrees = 0.0, 0.0, 0
        scatter = dispersion.variance_with_prior(n, main.mean, main.dispersion)
        for line, feature, old in zip(self.lines, new, before, strict=True):
            weight = 0.0 if feature is None else next(after)
            response = -old * line.feature.response
            if feature is not None:
                response = response + weight * feature.response
            core = settings.core_bias * line.feature.speed
            of_speeds += (weight - old) ** 2 * (scatter + core**2)
            error = settings.error_inflation * line.sigma * np.linalg.norm(response)
            of_places += error**2
            degrees += max(line.used.sum() - 2, 0) + settings.prior_freedom
        responses = [
            alignment_response(s, self.epoch, len(self.misaligned))
            for s in (stream, self.stream)
        ]
        along = np.array([np.cos(stream.angle), np.sin(stream.angle)])
        misaligned = (responses[0] - responses[1]) ** 2 @ self.misaligned**2 @ along**2
        total = of_speeds + of_places
        freedom = total**2 / (of_speeds**2 / n + of_places**2 / degrees or 1.0)
        return np.sqrt(total * self.beam[0] ** 2 + misaligned), max(freedom, 1.0)


def _weights(stream):
    """Return the weights of the features of a stream in their mean speed."""
    _, error = dispersion.feature_speeds(stream.features)
    weight = 1 / (error**2 + np.nan_to_num(stream.along.dispersion) ** 2)
    return weight / weight.sum()


def _choices(main):
    """Yield choices in words, with the pairs of epochs of each line that they leave."""
    lines, n = main.lines, len(main.lines)
    apart = [np.abs(line.years[:, None] - line.years) for line in lines]
    used = [
        a[np.triu(_both(line.used), 1)] for a, line in zip(apart, lines, strict=True)
    ]
    limit = np.median(np.concatenate(used))
    unit = time_unit(limit)
    shown = f"{(limit * u.yr).to_value(unit):.2g} {unit}"
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
    order = np.argsort(main.place, kind="stable")
    inner = np.isin(np.arange(n), order[: n // 2])
    border = main.place[order[n // 2 - 1 : n // 2 + 1]].mean() * u.mas
    unit = offset_unit(border.value)
    border = f"{border.to_value(unit):.3g} {unit}"
    yield f"inner half, up to {border}", inner
    yield f"outer half, from {border}", ~inner
    faint = np.isin(np.arange(n), np.argsort(main.peak, kind="stable")[: n // 2])
    yield "without the brighter half of features", faint
    yield "without the fainter half of features", ~faint


def _both(chosen):
    """Return the pairs of which both are chosen."""
    return chosen & chosen[:, None]


def _worst_epoch(main):
    """Return the row of the epoch without which the speed changes most, or None."""
    rows = []
    for k in np.unique(np.concatenate([line.epoch for line in main.lines])):
        choice = f"without {main.dates[k]}, the epoch that matters most"
        row = main.row(choice, [_both(line.epoch != k) for line in main.lines])
        if row is not None:
            rows.append(row)
    if not rows:
        return None
    worst = max(rows, key=lambda row: abs(row["change"]))
    return worst | {"p_value": len(rows) * worst["p_value"]}
