# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Show what images hold, what is wrong and what can be measured."""

import math
import warnings
from contextlib import suppress
from pathlib import Path

import astropy.units as u
import numpy as np

from astro_scc import EpochCube
from astro_scc.alignment.registration import MISALIGNED, core_positions
from astro_scc.cli.inputs import prepare
from astro_scc.columns import table_lines
from astro_scc.components.tables import kind_of
from astro_scc.epochs import inspect_epochs, plan_intervals
from astro_scc.exceptions import AstroSccWarning
from astro_scc.images.beam import different_beam, parse_beam
from astro_scc.images.fits import find_files
from astro_scc.images.positions import readable_angle
from astro_scc.quantities import named, one_quantity
from astro_scc.report.answer import misalignment_text
from astro_scc.settings import Settings
from astro_scc.stacking.velocities import baseline_pairs

#: Number of speeds that are explained when none is given.
N_SPEEDS = 4


def inspect(args, reporter):
    """Inspect files according to the arguments."""
    if not args.epochs:
        raise ValueError("no epochs were given; name the FITS files")
    if (speed := args.speed) is not None:
        speed = named("--speed", one_quantity, speed, "an angle per time", "2 mas/yr")
    files = find_files(args.epochs, missing_ok=True)
    beam = None if args.beam is None else named("--beam", parse_beam, args.beam)
    cube, refusal, remarks = _cube(files, beam)
    names, facts, problems = _facts(files, cube, refusal)
    known = "; ".join(problems)
    # Of the same problem the first words are the same.
    problems += [
        text
        for text in remarks
        if " ".join(text.split(": ")[-1].split()[:3]) not in known
    ]
    cores, of_core = ({}, 0.0) if cube is None else _cores(cube)
    unit = facts["noise"].unit
    rows = [
        _cells(name, row, unit) | {"core": cores.get(name, "-")}
        for name, row in zip(names, facts, strict=True)
    ]
    reporter.say(
        *table_lines(rows),
        "peak and core: (east, north) from the reference pixel in mas",
        "\n" + ("Problems:" if problems else "No problems."),
        *(f"  {problem}" for problem in problems),
    )
    if cube is not None:
        lines = *_plan(cube, speed), *_alignment(cube, of_core), *_choices(cube)
        reporter.say("", *lines)


def _facts(files, cube, refusal):
    """Return the names of the epochs, facts of `inspect_epochs`, and the problems."""
    if {kind_of(file) for file in files} in ({"cube"}, {"components"}):
        if cube is None:
            raise ValueError(refusal)
        return cube.labels, _facts_of_cube(cube), []
    facts = inspect_epochs(files)
    problems = [f"{row['file']}: {row['problem']}" for row in facts if row["problem"]]
    if not any(facts["nx"]):
        more = f" (and {len(facts) - 1} more like it)" if len(facts) > 1 else ""
        raise ValueError(f"{problems[0]}{more}")
    if refusal:
        problems.append(f"as one series: {refusal}")
    return [Path(file).name for file in facts["file"]], facts, problems


def _cube(files, beam):
    """Return the files as a cube or None, why they are none or None, and warnings."""
    cube = refusal = None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", AstroSccWarning)
        try:
            cube = EpochCube.read(files, beams=beam)
        except (ValueError, OSError, MemoryError) as error:
            refusal = str(error)
    texts = (str(w.message) for w in caught if issubclass(w.category, AstroSccWarning))
    restored = {kind_of(file) for file in files} == {"components"}
    return cube, refusal, [] if restored else list(texts)


def _cores(cube):
    """Return the core's offset at each epoch as text, and its scatter in beams."""
    try:
        found = core_positions(cube)
    except ValueError:
        return {}, 0.0
    east, north = found["east"].value, found["north"].value
    width = np.mean([np.sqrt(b.major * b.minor).value for b in cube.beams])
    cores = dict(zip(cube.labels, map(_offset, east, north), strict=True))
    return cores, max(east.std(), north.std()) / width


def _alignment(cube, of_core):
    """Return how well the epochs are aligned, and what to do about it."""
    scatter = cube.misalignment
    lines = ["", misalignment_text(scatter)]
    if max(scatter or 0, of_core) < MISALIGNED:
        return lines
    if of_core >= MISALIGNED:
        lines += [
            f"The core as it is fitted scatters by {of_core:.2f} beams: either the "
            "epochs are not aligned,",
            "or what was fitted is not the core.  Look at the images.",
        ]
    return [
        *lines,
        "Images that are not aligned can make a stationary jet appear to move: align "
        "them on the core,",
        "if there is one, or by a table of its positions, unless they are aligned.",
    ]


def _choices(cube):
    """Return what a measurement without options takes, as lines."""
    _, _, chosen = prepare(cube, Settings())
    if different_beam(cube.beams) is not None:
        chosen.insert(0, "--common-beam: the beams differ")
    head = "\nWithout options, astro-scc measure takes:"
    return [head, *(f"  {choice}" for choice in chosen)]


def _offset(east, north):
    return f"{east:+.2f} {north:+.2f}"


def _cells(name, row, unit):
    """Return a row of `inspect_epochs` as text under the headings of the table."""
    names = ("date", "pixels", "pixel", "beam", f"noise ({unit})", "peak")
    cells = {"epoch": name} | dict.fromkeys(names, "-")
    if not row["nx"]:
        return cells
    if not np.any(row["date"].mask):
        cells["date"] = str(row["date"].isot)[:10]
    cells["pixels"] = f"{row['nx']} x {row['ny']}"
    cells["pixel"] = readable_angle(row["pixel"])
    if "major" in row.colnames and np.isfinite(row["major"]):
        angle = readable_angle(row["major"]).split()[1]
        axes = (f"{row[axis].to_value(angle):.3g}" for axis in ("major", "minor"))
        cells["beam"] = f"{' x '.join(axes)} {angle} at {row['pa'].value:.0f} deg"
    if np.isfinite(row["noise"]):
        cells[names[4]] = f"{row['noise'].value:.2g}"
    cells["peak"] = _offset(row["peak_east"].value, row["peak_north"].value)
    return cells


def _facts_of_cube(cube):
    """Return for the epochs of a cube what `inspect_epochs` returns for files."""
    table, images = cube.epochs, zip(cube.data, cube.mask, strict=True)
    table["ny"], table["nx"] = cube.shape[1:]
    table["pixel"] = cube.pixel_scale
    peaks = [np.argmax(np.where(bad, -np.inf, image)) for image, bad in images]
    y, x = np.unravel_index(peaks, cube.shape[1:])
    table["peak_east"], table["peak_north"] = cube.pixel_to_offset(x, y)
    return table


def _plan(cube, speed):
    """Return lines on the speeds that can be measured with the dates."""
    try:
        plan = plan_intervals(cube)
    except ValueError as error:
        return [f"{error}."]
    rows, unit = [], plan.slowest.unit
    if speed is None:
        slow, high = plan.slowest.value, plan.consecutive[1].value
        speeds = np.geomspace(1.5 * slow, max(high, 2 * slow), N_SPEEDS) * unit
    else:
        speeds = [speed.to(unit)]
    for value in speeds:
        pairs, text = 0, "too slow for this series"
        with suppress(ValueError):
            first, last = plan.baseline(value)
            limits = u.Quantity([first, last]).to_value(u.yr)
            pairs = len(baseline_pairs(cube.years.value, *limits).first)
            text = f'"{_rounded(first, math.floor)} {_rounded(last, math.ceil)}"'
        rows.append(
            {
                f"speed ({unit})": f"{value.value:.2g}",
                "beams in the median interval": f"{plan.motion(value):.2g}",
                "--baseline for it alone": text,
                "pairs": str(pairs),
            }
        )
    return [*plan.lines(), "", *table_lines(rows)]


def _rounded(interval, how):
    """Return an interval with two digits, rounded by a function."""
    step = 10 ** (math.floor(math.log10(interval.value)) - 1)
    # Rounding errors must not change a number that is already round.
    return f"{how(round(interval.value / step, 6)) * step:.2g} {interval.unit}"
