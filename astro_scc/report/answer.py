# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What a measurement found and how sure that is, in sentences."""

import math

import numpy as np

from astro_scc.report.words import (
    listed,
    number_word,
    plain_value,
    plural,
    row_text,
    unit_text,
    with_error,
)

__all__ = ["answers", "chances", "edge_remarks", "facts", "headline"]

#: Speeds beyond this part of the largest one that was searched are told.
EDGE = 0.9


def headline(kinds):
    moving, standing = kinds.count("moving"), kinds.count("stationary")
    if moving:
        text = f"{number_word(moving).capitalize()} significant velocity "
        beside = ", beside features that stand still" if standing else ""
        return f"{text}{plural(moving, 'component')}{beside}."
    if standing:
        return "No significant motion: features stand still within their errors."
    return "No significant motion."


def answers(components, kinds):
    """One sentence in two parts for each component that was found."""
    answers = []
    for row, kind in zip(components, kinds, strict=True):
        if kind == "not significant":
            continue
        speed = f"{row_text(row, 'pm')} {unit_text(components['pm'].unit)}"
        if "beta_app" in components.colnames:
            speed += f" = {row_text(row, 'beta_app')} c"
        angle, error = plain_value(row["pm_pa"]), plain_value(row["pm_pa_err"])
        if kind == "stationary":
            more = "stationary: no motion within the errors"
        elif math.isfinite(angle):
            more = f"towards position angle {with_error(angle, max(error, 1))} deg"
        else:
            more = "outward" if plain_value(row["pm_parallel"]) > 0 else "inward"
        if kind == "moving" and plain_value(row["dispersion"]) > 0:
            more += f"; dispersion {row_text(row, 'dispersion')}"
        if kind == "moving":
            more += f"; p_global {plain_value(row['p_global']):.2g}"
        more += (
            f"; {int(row['n_features'])} {plural(int(row['n_features']), 'feature')}, "
            f"{int(row['n_ssp'])} SSPs"
        )
        answers.append((int(row["component"]), speed, more))
    return answers


def chances(result, components, kinds):
    """Sentences on how sure the answer is."""
    if not len(components):
        return []
    level = result.meta["settings"]["level"]
    smallest = max(plain_value(p) for p in components["p_smallest"])
    said = [
        "p_global is the probability that epochs in permuted order show as much at "
        f"any velocity; here it cannot be below {smallest:.2g}."
    ]
    said += _limits(result, components, kinds, level)
    who, more = _numbers(components, kinds, "stationary")
    if who:
        said.append(
            f"{who} of the table, stationary, {'do' if more else 'does'} not move "
            f"within {'their' if more else 'its'} errors: no discovery of a speed."
        )
    who, _ = _numbers(components, kinds, "not significant")
    if who:
        said.append(f"{who} of the table: not significant, {_reasons(components)}.")
    return said + limits(components)


def limits(components):
    """
    Upper limits of the speeds of what is not seen to move, in sentences.

    Parameters
    ----------
    components : `~astropy.table.QTable`

    Returns
    -------
    list of str
    """
    unit = components["pm"].unit
    return [
        f"What row {int(row['component'])} follows, {int(row['n_features'])} "
        f"{plural(int(row['n_features']), 'feature')}, is slower than "
        f"{row['pm_limit'].to_value(unit):.2g} {unit_text(unit)} at 95%."
        for row in components
        if math.isfinite(row["pm_limit"].value)
    ]


def _limits(result, components, kinds, level):
    """Whether epochs or trials are too few for anything to be significant."""
    smallest = [
        plain_value(row["p_smallest"])
        for row, kind in zip(components, kinds, strict=True)
        if kind != "stationary"
    ]
    worst = max(smallest, default=0.0)
    if worst <= level:
        return []
    n = len(result.cube)
    said = f"cannot be below {worst:.2g}"
    if worst <= 2 / math.factorial(min(n, 20)):
        return [
            f"With {n} epochs p_global {said} (2/N!): with so few no component that "
            "moves can be significant; measure more epochs."
        ]
    return [
        f"With {result.meta['n_trials']} trials p_global {said}: with so few no "
        "component can be significant; measure with more."
    ]


def _reasons(components):
    """Why those that are not significant are none."""
    notes = map(str, components["note"])
    return "; ".join(dict.fromkeys(note for note in notes if note != "-"))


def _numbers(components, kinds, kind):
    """The components of a kind as text, and whether they are several."""
    numbers = [
        str(int(number))
        for number, own in zip(components["component"], kinds, strict=True)
        if own == kind
    ]
    if not numbers:
        return "", False
    return f"{plural(len(numbers), 'Component')} {listed(numbers)}", len(numbers) > 1


def edge_remarks(result, components, kinds):
    """What to do about components as fast as anything that was searched."""
    fastest = result.search.permutations.speed.max()
    numbers = [
        str(int(number))
        for number, kind in zip(components["component"], kinds, strict=True)
        if kind == "moving"
        and abs(result.search.streams[int(number) - 1].along.mean) > EDGE * fastest
    ]
    if not numbers:
        return []
    which = f"{plural(len(numbers), 'Component')} {listed(numbers)}"
    verb, what = ("is", "it") if len(numbers) == 1 else ("are", "them")
    return [
        f"{which} {verb} as fast as anything that was searched: measure with a larger "
        f"max_speed before you believe {what}."
    ]


def facts(result):
    cube = result.cube
    dates = cube.times.strftime("%Y-%m-%d")
    inside = np.asarray(result.ssps["in_region"], bool)
    scales = np.unique(np.asarray(result.ssps["scale"], dtype=float))
    where = "" if inside.all() else f", of {len(inside)} in the images"
    n = int(result.search.diagram.n_pairs.sum())
    return [
        f"{len(cube)} epochs, {dates[0]} to {dates[-1]}",
        f"{n} {plural(n, 'pair')} of epochs compared",
        f"{inside.sum()} significant structural patterns (SSPs) compared on "
        f"{len(scales)} {plural(len(scales), 'scale')}{where}",
    ]
