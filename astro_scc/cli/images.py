# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The commands on images: simulate and restore make them, inspect looks at them."""

import math
import re
import warnings
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import astropy.units as u
import numpy as np

from astro_scc import EpochCube, simulation
from astro_scc.cli.inputs import draw_seed, prepare, table_name
from astro_scc.cli.program import COMMANDS, option_name
from astro_scc.columns import table_lines
from astro_scc.epochs import inspection, lists, restoring
from astro_scc.epochs.registration import MISALIGNED, core_positions
from astro_scc.epochs.serialize import write_epochs
from astro_scc.epochs.tables import source_list
from astro_scc.exceptions import AstroSccWarning
from astro_scc.images import fits, positions
from astro_scc.images.beam import different_beam, parse_beam
from astro_scc.images.dates import date_labels
from astro_scc.paper.stack import baseline_pairs
from astro_scc.plan import searched_speeds
from astro_scc.products.folder import product_folder
from astro_scc.quantities import named, one_quantity, to_time
from astro_scc.settings import Settings, check_setting
from astro_scc.units import unit_name

#: Options of the jet "jet", and their other names in `simulate_jet`.
(FLOW,) = COMMANDS["simulate"]["groups"].values()
PARAMETERS = {"motion": "speed", "features": "n_features", "epochs": "n_epochs"}


def simulate(args, reporter):
    """Simulate a jet whose velocities are known according to the arguments."""
    given = {}
    for name in (*FLOW, "dense", "epochs"):
        value = getattr(args, name)
        if value is None or value is False:
            continue
        whose = {"dense": "two-fluid", "epochs": args.jet}.get(name, "jet")
        if args.jet != whose:
            raise ValueError(f"{option_name(name)} is for {whose}, not for {args.jet}")
        given[PARAMETERS.get(name, name)] = value
    seed = draw_seed(check_setting("seed", args.seed))
    with product_folder(args.output, overwrite=args.overwrite) as part:
        try:
            make = getattr(simulation, f"simulate_{args.jet.replace('-', '_')}")
            jet = make(rng=seed, **given)
        except ValueError as error:
            raise ValueError(_of_option(str(error))) from None
        jet.truth.meta["seed"] = seed
        *images, _ = simulation.write_simulation(jet, part)
    _say(reporter, args, len(images), " and truth.ecsv", f" (seed {seed})")


def _say(reporter, args, n_epochs, what, more):
    """Say what has been written, and how it is measured."""
    folder, epochs = Path(args.output), "epoch" if n_epochs == 1 else "epochs"
    said = f"{n_epochs} {epochs}{what} in {folder}{more}"
    if n_epochs > 1:
        said += f"; next:\n  astro-scc measure {folder}/*.fits -o {folder}-measured"
    reporter.say(said)


def _of_option(message):
    """Return a message on a parameter of a jet with the option that sets it."""
    found = re.match(r"(?:flow '(\w+)': )?(\w*)", message)
    flow, name = found.groups()
    options = {parameter: option for option, parameter in PARAMETERS.items()}
    name = "standing" if flow == "standing" else options.get(name, name)
    known = name in (*FLOW, "epochs")
    return f"{option_name(name)}{message[found.end() :]}" if known else message


# -- images of components ------------------------------------------------------------


def restore(args, reporter):
    """Make images from lists of components according to the arguments."""
    if args.list:
        reporter.say(*_sources(args.tables))
        return
    needed = {"-o": args.output, "--pixel": args.pixel}
    if missing := [option for option, value in needed.items() if value is None]:
        options = " and ".join(missing)
        raise ValueError(f"{options} must be given to make images (--list makes none)")
    how = images_of(args, args.tables)
    found = lists.read_components(
        args.tables, source=args.source, origin=args.origin, beams=how["beam"]
    )
    if not found.beams:
        raise ValueError(f"{args.tables[0]}: {restoring.NO_BEAM}")
    cube = write_images(found, args.output, how, overwrite=args.overwrite)
    first, last = cube.times.isot[[0, -1]]
    ny, nx = cube.shape[1:]
    what = (
        f", {first[:10]} to {last[:10]}, {nx} x {ny} pixels of "
        f"{how['pixel_scale'].to(u.mas):.4g}, beam {found.beams[0]},"
    )
    drawn = "" if how["noise"] is None else f" (seed of the noise {how['seed']})"
    _say(reporter, args, len(cube), what, drawn)


def _sources(tables):
    """Return the sources of tables as lines."""
    heads, rows = ("source", "also", "epochs", "first", "last"), []
    for path in fits.find_files(tables):
        for name, others, dates in source_list(path):
            days = dates[0][:10], dates[-1][:10]
            row = name, ", ".join(others) or "-", str(len(dates)), *days
            rows.append(dict(zip(heads, row, strict=True)))
    return table_lines(rows)


def images_of(args, tables):
    """Return how images of tables are restored, from the arguments."""
    after, before, seed = (
        check_setting(name, getattr(args, name)) for name in ("after", "before", "seed")
    )
    return {
        "beam": _beam(args),
        "pixel_scale": _quantity(args, "pixel", "one number", "0.1 mas"),
        "noise": _quantity(args, "noise", "one number", "0.3 mJy/beam"),
        "after": after and to_time(after),
        "before": before and to_time(before),
        "seed": draw_seed(seed),
        "tables": table_name(tables[0]) if len(tables) == 1 else f"{len(tables)} files",
    }


def _beam(args):
    beam = check_setting("beam", args.beam)
    return beam and parse_beam(beam)


def _quantity(args, name, *kind):
    """Return the quantity that an option gives, if it is given."""
    value = getattr(args, name)
    if value is not None:
        return named(option_name(name), one_quantity, value, *kind)
    return None


def write_images(components, folder, how, *, overwrite=False):
    """Restore images of components into a folder, see `images_of`, and return them."""
    pixel, noise, seed = (how[k] for k in ("pixel_scale", "noise", "seed"))
    with product_folder(folder, overwrite=overwrite) as part:
        chosen = components.select(after=how["after"], before=how["before"])
        grid = {"beam": chosen.beams, "pixel_scale": pixel}
        cube = EpochCube.from_components(chosen, noise=noise, rng=seed, **grid)
        cube = cube.with_step(f"components from {how['tables']}")
        if noise is not None:
            cube = cube.with_step(f"noise of {noise} with the seed {seed}")
        write_epochs(cube, part)
    return cube


def restored(task):
    """Restore the images of a source, and return why that is not possible, or None."""
    components, target, how = task
    try:
        if how["pixel_scale"] is None or how["noise"] is None:
            given = {k: v for k, v in how.items() if v is not None}
            how = how | restoring.suited(components) | given
        write_images(components, target, how)
    except ValueError as error:
        return str(error)
    return None


def components_of(args, reporter):
    """Return the components of each source with a beam, and how to restore images."""
    how = images_of(args, [args.survey])
    options, found = {"origin": args.origin, "beams": how["beam"]}, {}
    for name in args.source.split(",") if args.source else (None,):
        found |= lists.read_sources(args.survey, source=name, **options)
    if not all(components.beams for components in found.values()):
        # That of the whole table, so that no source depends on which others are chosen.
        every = lists.read_sources(args.survey, **options) if args.source else found
        how["beam"] = beam = restoring.typical_beam(every.values())
        found = {k: replace(v, beams=[beam] * len(v.times)) for k, v in found.items()}
        reporter.note(
            f"{args.survey} has no beam: images are restored with one of "
            f"{beam.major:.2g}, the median distance of neighbours in an epoch (--beam)"
        )
    kinds = {"pixels": how["pixel_scale"], "noise": how["noise"]}
    if left := [kind for kind, value in kinds.items() if value is None]:
        reporter.note(
            f"images get {' and '.join(left)} that suit their components: a fifth of "
            "the beam, and a tenth of the faintest peak (--pixel, --noise)"
        )
    return found, how


# -- what images hold, what is wrong and what can be measured ------------------------


def inspect(args, reporter):
    """Inspect files according to the arguments."""
    if not args.epochs:
        raise ValueError("no epochs were given; name the FITS files")
    speed = _quantity(args, "speed", "an angle per time", "2 mas/yr")
    files = fits.find_files(args.epochs, missing_ok=True)
    kinds = {inspection.kind_of(file) for file in files}
    cube, refusal, remarks = _read(files, _beam(args))
    if kinds in ({"cube"}, {"components"}):
        if cube is None:
            raise ValueError(refusal)
        names, facts, problems = cube.labels, _facts_of_cube(cube), []
    else:
        facts = inspection.inspect_epochs(files)
        names = [Path(file).name for file in facts["file"]]
        problems = _problems(facts, refusal)
    if kinds != {"components"}:
        # Of the same problem the first words are the same.
        known = "; ".join(problems)
        words = {text: " ".join(text.split(": ")[-1].split()[:3]) for text in remarks}
        problems += [text for text in remarks if words[text] not in known]
    angle = positions.readable_angle(np.nanmin(facts["pixel"])).split()[1]
    origin = facts.meta.get("origin") or "the reference pixel"
    cores, of_core = ({}, 0.0) if cube is None else _cores(cube, angle)
    rows = [
        _cells(name, date, row, facts["noise"].unit, angle)
        | {"core": cores.get(name, "-")}
        for name, date, row in zip(names, _dates(facts), facts, strict=True)
    ]
    offsets = f"peak and core: (east, north) from {origin} in {angle}"
    head = "\nProblems:" if problems else "\nNo problems."
    reporter.say(*table_lines(rows), offsets, head, *(f"  {k}" for k in problems))
    if cube is not None:
        lines = *_plan(cube, speed), *_alignment(cube, of_core), *_choices(cube)
        reporter.say("", *lines)


def _problems(facts, refusal):
    """Return what is wrong with files; raise it if none of them is an image."""
    found = [f"{row['file']}: {row['problem']}" for row in facts if row["problem"]]
    if not any(facts["nx"]):
        more = f" (and {len(facts) - 1} more like it)" if len(facts) > 1 else ""
        raise ValueError(f"{found[0]}{more}")
    return [*found, f"as one series: {refusal}"] if refusal else found


def _read(files, beam):
    """Return the files as a cube or None, why they are none, and the warnings."""
    cube = refusal = None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", AstroSccWarning)
        try:
            cube = EpochCube.read(files, beams=beam)
        except (ValueError, OSError, MemoryError) as error:
            refusal = str(error)
    said = [str(w.message) for w in caught if issubclass(w.category, AstroSccWarning)]
    return cube, refusal, said


def _facts_of_cube(cube):
    """Return for the epochs of a cube what `inspect_epochs` returns for files."""
    table, images = cube.epochs, zip(cube.data, cube.mask, strict=True)
    table["ny"], table["nx"] = cube.shape[1:]
    table["pixel"] = cube.pixel_scale
    peaks = [np.argmax(np.where(bad, -np.inf, image)) for image, bad in images]
    y, x = np.unravel_index(peaks, cube.shape[1:])
    table["peak_east"], table["peak_north"] = cube.pixel_to_offset(x, y)
    return table


def _dates(facts):
    """Return the dates as text, with the time of day where days do not suffice."""
    known = ~np.broadcast_to(facts["date"].mask, len(facts))
    texts = np.full(len(facts), "-", dtype=object)
    if known.any():
        texts[known] = date_labels(facts["date"][known])
    return texts.tolist()


def _cells(name, date, row, unit, offsets):
    """Return a row of `inspect_epochs` as text under the headings of the table."""
    noise = f"noise ({unit})"
    heads = "date", "pixels", "pixel", "beam", noise, "peak"
    cells = {"epoch": name} | dict.fromkeys(heads, "-")
    if not row["nx"]:
        return cells
    cells["date"] = date
    cells["pixels"] = f"{row['nx']} x {row['ny']}"
    cells["pixel"] = positions.readable_angle(row["pixel"])
    if "major" in row.colnames and np.isfinite(row["major"]):
        angle = positions.readable_angle(row["major"]).split()[1]
        axes = (f"{row[axis].to_value(angle):.3g}" for axis in ("major", "minor"))
        cells["beam"] = f"{' x '.join(axes)} {angle} at {row['pa'].value:.0f} deg"
    if np.isfinite(row["noise"]):
        cells[noise] = f"{row['noise'].value:.2g}"
    peak = (row[f"peak_{axis}"].to_value(offsets) for axis in ("east", "north"))
    cells["peak"] = _offset(*peak)
    return cells


def _cores(cube, angle):
    """Return the core's offset at each epoch as text, and its scatter in beams."""
    try:
        found = core_positions(cube)
    except ValueError:
        return {}, 0.0
    offsets = [found[name].to(angle) for name in ("east", "north")]
    texts = map(_offset, *(offset.value for offset in offsets))
    scatter = max(offset.std() for offset in offsets) / cube.resolution
    return dict(zip(cube.labels, texts, strict=True)), scatter.to_value(u.one)


def _offset(east, north):
    return f"{east:+.2f} {north:+.2f}"


def _plan(cube, speed, number=4):
    """Return lines on a speed, or a ``number`` of them, that the dates can measure."""
    try:
        plan = inspection.plan_intervals(cube)
    except ValueError as error:
        return [f"{error}."]
    rows, unit = [], plan.slowest.unit
    if speed is None:
        slow, high = plan.slowest.value, plan.consecutive[1].value
        speeds = np.geomspace(1.5 * slow, max(high, 2 * slow), number) * unit
    else:
        speeds = [speed.to(unit)]
    for value in speeds:
        pairs, text = 0, "too slow for this series"
        with suppress(ValueError):
            first, last = plan.baseline(value)
            limits = u.Quantity([first, last]).to_value(u.yr)
            pairs = len(baseline_pairs(cube.years.value, *limits).first)
            text = f'"{_rounded(first, math.floor)} {_rounded(last, math.ceil)}"'
        row = {f"speed ({unit})": f"{value.value:.2g}"}
        row["beams in the median interval"] = f"{plan.motion(value):.2g}"
        rows.append(row | {"--baseline for it alone": text, "pairs": str(pairs)})
    return [str(plan), "", *table_lines(rows)]


def _rounded(interval, how):
    """Return an interval with two digits, rounded by a function."""
    step = 10 ** (math.floor(math.log10(interval.value)) - 1)
    # Rounding errors must not change a number that is already round.
    return f"{how(round(interval.value / step, 6)) * step:.2g} {interval.unit}"


def _alignment(cube, of_core):
    """Return what the choice of an alignment leaves to be said, as lines."""
    scatter = cube.misalignment
    said = f"What is fitted as the core scatters by {of_core:.2f} beams"
    if scatter is None and of_core >= MISALIGNED:
        return ["", f"{said}: align the epochs on it if it is the core (--align core)."]
    if scatter is not None and scatter < MISALIGNED <= of_core:
        more = "it varies, or is not the core, and the epochs are left as they are."
        return ["", f"{said}, but the rest of the images by {scatter:.2f}:", more]
    return []


def _choices(cube):
    """Return what a measurement without options takes, as lines."""
    cube, _, chosen = prepare(cube, Settings())
    if np.ptp(cube.years) > 0:
        low, high = searched_speeds(cube).value
        unit = unit_name(cube.speed_unit)
        more = "are searched, faster ones with --max-speed"
        chosen.append(f"speeds of {low:.3g} to {high:.3g} {unit} {more}")
    if different_beam(cube.beams) is not None:
        chosen.insert(0, "--common-beam: the beams differ")
    head = "\nWithout options, astro-scc measure takes:"
    return [head, *(f"  {choice}" for choice in chosen)]
