# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc inspect``: what files hold, before anything is measured."""

import math

from astro_scc.cli.options import add_setting
from astro_scc.cli.summary import misalignment_text, table_lines
from astro_scc.quantities import named, one_quantity

#: Speeds that are explained when none is given.
N_SPEEDS = 4
#: In years; so much intervals are wrong by that are given in days.
DAY = 1e-3


HELP = "say what images hold, what is wrong and what can be measured"
DESCRIPTION = """\
One line per epoch, then what is wrong, and which speeds the dates allow to be
measured, with which pairs of epochs.  Nothing is measured and nothing is written."""
EPILOG = """\
examples:
  astro-scc inspect 3c273/*.fits
  astro-scc inspect 3c273/*.fits --speed "0.9 mas/yr\""""


def add_arguments(parser):
    """Add the arguments of the command."""
    add_setting(parser, "epochs")
    parser.add_argument(
        "--speed",
        metavar='"2 mas/yr"',
        help="say what this proper motion is between epochs, and which pairs suit it; "
        "default some between the slowest and the fastest that can be measured well",
    )


def run(args, reporter):
    """Look at files, as the arguments say."""
    from pathlib import Path

    from astro_scc.epochs import inspect_epochs
    from astro_scc.epochs.fits import find_files
    from astro_scc.epochs.serialize import is_cube_file

    if not args.epochs:
        raise ValueError("no epochs were given; name the FITS files")
    speed = args.speed
    if speed is not None:
        speed = named("--speed", one_quantity, speed, "an angle per time", "2 mas/yr")
    files = find_files(args.epochs, missing_ok=True)
    cube, refusal = _cube(files)
    if len(files) == 1 and files[0].exists() and is_cube_file(files[0]):
        if cube is None:
            raise ValueError(refusal)
        names, unit, problems = list(cube.labels), cube.unit, []
        rows = [_epoch_cells(cube, i) for i in range(len(cube))]
    else:
        table = inspect_epochs(files)
        names = [Path(row["file"]).name for row in table]
        unit = table["noise"].unit
        problems = [
            f"{row['file']}: {row['problem']}" for row in table if row["problem"]
        ]
        if not any(table["nx"]):
            more = f" (and {len(table) - 1} more like it)" if len(table) > 1 else ""
            raise ValueError(f"{problems[0]}{more}")
        rows = [_file_cells(*pair) for pair in zip(names, table, strict=True)]
    cores, of_core = _cores(cube)
    for name, row in zip(names, rows, strict=True):
        row.append(cores.get(name, "-"))
    head = ["epoch", "date", "pixels", "pixel", "beam", f"noise ({unit})", "peak"]
    for line in table_lines([*head, "core"], rows):
        reporter.say(line)
    reporter.say("peak and core: (east, north) from the reference pixel in mas")
    if refusal:
        problems.append(f"as one series: {refusal}")
    reporter.say("\n" + ("Problems:" if problems else "No problems."))
    for problem in problems:
        reporter.say(f"  {problem}")
    if cube is not None:
        reporter.say()
        for line in [*_plan(cube, speed), *_alignment(cube, of_core)]:
            reporter.say(line)


def _cube(files):
    """The files as a cube, or None and why they are none."""
    import warnings

    from astro_scc import EpochCube
    from astro_scc.exceptions import AstroSccWarning

    with warnings.catch_warnings():
        # They are among the problems.
        warnings.simplefilter("ignore", AstroSccWarning)
        try:
            return EpochCube.read(files), None
        except (ValueError, OSError, MemoryError) as error:
            return None, str(error)


def _cores(cube):
    """Offset of the core of each epoch as text, by label, and its scatter in beams."""
    import numpy as np

    from astro_scc.epochs.registration import core_positions

    if cube is None or cube.beams is None:
        return {}, 0.0
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
    from astro_scc.epochs.misalignment import LARGEST

    scatter = cube.misalignment
    lines = ["", misalignment_text(scatter)]
    if max(scatter or 0, of_core) < LARGEST:
        return lines
    if of_core >= LARGEST:
        lines.append(f"The core as it is fitted scatters by {of_core:.2f} beams.")
    return [
        *lines,
        "Images that are not aligned can make a stationary jet appear to move: measure "
        "with --align core",
        "or a table of core positions, unless they are known to be aligned.",
    ]


def _offset(east, north):
    return f"{east:+.2f} {north:+.2f}"


def _file_cells(name, row):
    """One row of `inspect_epochs` as text."""
    import numpy as np

    from astro_scc.epochs.positions import readable_angle

    if not row["nx"]:
        return [name, *"------"]
    known = np.isfinite(row["major"])
    return [
        name,
        "-" if np.any(row["date"].mask) else str(row["date"].isot)[:10],
        f"{row['nx']} x {row['ny']}",
        readable_angle(row["pixel"]),
        _beam(row["major"], row["minor"], row["pa"]) if known else "-",
        f"{row['noise'].value:.2g}" if np.isfinite(row["noise"]) else "-",
        _offset(row["peak_east"].value, row["peak_north"].value),
    ]


def _epoch_cells(cube, i):
    """One epoch of a cube as text."""
    import numpy as np

    from astro_scc.epochs.positions import readable_angle

    ny, nx = cube.shape[1:]
    beam = "-"
    if cube.beams is not None:
        own = cube.beams[i]
        beam = _beam(own.major, own.minor, own.pa)
    image = np.where(cube.mask[i], -np.inf, cube.data[i])
    y, x = np.unravel_index(np.argmax(image), image.shape)
    return [
        cube.labels[i],
        cube.times[i].isot[:10],
        f"{nx} x {ny}",
        readable_angle(cube.pixel_scale),
        beam,
        f"{cube.noise_rms()[i].value:.2g}",
        _offset(*(v.value for v in cube.pixel_to_offset(x, y))),
    ]


def _beam(major, minor, pa):
    from astro_scc.epochs.positions import readable_angle

    unit = readable_angle(major).split()[1]
    return (
        f"{major.to_value(unit):.3g} x {minor.to_value(unit):.3g} {unit} "
        f"at {pa.value:.0f} deg"
    )


def _plan(cube, speed):
    """What the dates allow."""
    from astro_scc.epochs import plan_intervals

    try:
        plan = plan_intervals(cube)
    except ValueError as error:
        return [f"{error}."]
    return [*plan.lines(), "", *_speed_lines(cube, plan, speed)]


def _speed_lines(cube, plan, speed):
    """How far features of some speeds move, and the pairs of epochs that suit them."""
    import numpy as np

    if speed is None:
        slow, high = plan.slowest.value, plan.consecutive[1].value
        speeds = np.geomspace(1.5 * slow, max(high, 2 * slow), N_SPEEDS)
        speeds = speeds * plan.slowest.unit
    else:
        speeds = [speed.to(plan.slowest.unit)]
    rows = []
    for value in speeds:
        cells = [f"{value.value:.2g}", f"{plan.motion(value):.2g}"]
        try:
            first, last = plan.baseline(value)
        except ValueError:
            rows.append([*cells, "too slow for this series", "0"])
            continue
        text = f'"{_rounded(first, math.floor)} {_rounded(last, math.ceil)}"'
        rows.append([*cells, text, str(_n_pairs(cube, first, last))])
    head = [f"speed ({plan.slowest.unit})", "beams in the median interval"]
    return table_lines([*head, "--baseline for it alone", "pairs"], rows)


def _rounded(interval, how):
    """Return an interval with two digits, rounded by a function."""
    step = 10 ** (math.floor(math.log10(interval.value)) - 1)
    # A number that is round already has a rounding error.
    return f"{how(round(interval.value / step, 6)) * step:.2g} {interval.unit}"


def _n_pairs(cube, first, last):
    import numpy as np

    years = cube.years.value
    apart = np.abs(years[:, None] - years[None, :])[np.triu_indices(len(years), 1)]
    first, last = first.to_value("yr"), last.to_value("yr")
    return int(np.sum((apart >= first - DAY) & (apart <= last + DAY)))
