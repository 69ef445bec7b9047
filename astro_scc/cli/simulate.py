# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Simulate images of a jet whose velocities are known.

Simulate images of a jet whose velocities are known: one FITS file per epoch,
and truth.ecsv with the position and the velocity of every feature.

jets:
  two-fluid        a slow sheath around a fast spine
  random-velocity  a new random velocity for every feature at every epoch
  ballistic        features that each keep a random velocity
  static           stationary features
  unrelated        epochs that have nothing in common
  jet              as in surveys: uneven dates, a core, features that scatter in speed

examples:
  astro-scc simulate two-fluid jet --seed 1 --epochs 10
  astro-scc simulate jet jet --motion 0.4 --dispersion 0.2 --vlba
"""

import math
import re
from dataclasses import replace
from pathlib import Path

from astro_scc.cli.arguments import (
    add_option,
    add_output,
    add_overwrite,
    add_setting,
    add_switches,
    option_name,
)
from astro_scc.cli.inputs import draw_seed, read_epochs
from astro_scc.cli.measure import STALE, measure, write_measurement
from astro_scc.cli.summary import component_lines, table_lines
from astro_scc.settings import Settings, check_setting

JETS = ("two-fluid", "random-velocity", "ballistic", "static", "unrelated", "jet")
# Type and help of each option; `PARAMETERS` has their names in simulate_jet.
FLOW = {
    "motion": (float, "mean, in beams per median interval; default 0.6"),
    "dispersion": (float, "of the speeds, over the mean; default 0.1"),
    "distribution": (str, "of the speeds: normal (default), lognormal or uniform"),
    "features": (float, "moving features in view at a time; default 8"),
    "standing": (int, "number of stationary features; default 0"),
    "acceleration": (float, "speed at the jet's end over that at the core; default 1"),
    "flux_variation": (float, "scatter of ln(flux) in time; default 0.35"),
    "alignment_error": (float, "shift of each image, rms in beams; default 0"),
}
PARAMETERS = {"motion": "speed", "features": "n_features", "epochs": "n_epochs"}
#: Seed and trials of the demonstration.
SEED, N_TRIALS = 1, 1000
# Columns of the jet that are measured, from 0 (Mertens & Lobanov 2016, Sect. 2.4).
FIRST, LAST = 60, 160


def add_arguments(parser):
    """Add the arguments of the command."""
    parser.add_argument("jet", choices=JETS, metavar="JET", help="one of those below")
    parser.add_argument("output", metavar="DIR", help="folder for the images")
    add_overwrite(parser)
    add_setting(parser, "seed")
    text = (
        "number of epochs; default 10, 30 days apart, and of a jet 15 at uneven "
        "dates, 0.2 years apart in the median"
    )
    add_option(parser, "--epochs", "N", text, type=int)
    text = "more and brighter features in the two-fluid jet"
    add_switches(parser, dense=text, default=None)
    group = parser.add_argument_group("options of the jet 'jet'")
    for name, (kind, text) in FLOW.items():
        add_option(group, option_name(name), "X", text, type=kind)
    text = "image it from visibilities of the VLBA, with CLEAN"
    add_switches(group, vlba=text, default=None)


def simulated(jet, *, seed, **options):
    """Return a jet by its name on the command line; its truth holds the seed."""
    from astro_scc import simulation

    make = getattr(simulation, f"simulate_{jet.replace('-', '_')}")
    made = make(rng=seed, **options)
    made.truth.meta["seed"] = seed
    return made


def run(args, reporter):
    """Simulate a jet according to the arguments."""
    from astro_scc.measurement import product_folder
    from astro_scc.simulation import observe, write_simulation

    if args.epochs is not None and args.epochs < 1:
        raise ValueError(f"--epochs must be at least 1, got {args.epochs}")
    given = {}
    for name in (*FLOW, "vlba", "dense", "epochs"):
        if (value := getattr(args, name)) is None:
            continue
        whose = {"dense": "two-fluid", "epochs": args.jet}.get(name, "jet")
        if args.jet != whose:
            raise ValueError(f"{option_name(name)} is for {whose}, not for {args.jet}")
        given[PARAMETERS.get(name, name)] = value
    vlba = given.pop("vlba", False)
    seed = draw_seed(check_setting("seed", args.seed))
    folder = Path(args.output)
    with product_folder(folder, overwrite=args.overwrite) as part:
        try:
            jet = simulated(args.jet, seed=seed, **given)
        except ValueError as error:
            raise ValueError(_of_option(str(error))) from None
        if vlba:
            jet = observe(jet, rng=seed)
        *images, _ = write_simulation(jet, part)
    reporter.say(
        f"{len(images)} epochs and truth.ecsv in {folder} (seed {seed}); next:\n"
        f"  astro-scc measure {folder}/*.fits -o {folder}-measured"
    )


def _of_option(message):
    """Return a message on a parameter of a jet with the option that sets it."""
    found = re.fullmatch(r"(?:flow '(\w+)': )?(\w+)(.*)", message)
    flow, name, text = found.groups() if found else (None, "", "")
    options = {parameter: option for option, parameter in PARAMETERS.items()}
    name = "standing" if flow == "standing" else options.get(name, name)
    return f"{option_name(name)}{text}" if name in FLOW else message


class Demo:
    """
    Simulate the two-fluid jet of the paper and measure it.

    Simulate the two-fluid jet of Mertens & Lobanov (2016), a slow sheath around a
    fast spine, measure it and write the report.  No input is needed.

    The folder gets the products of astro-scc measure, the images in epochs/ and
    the region in region.reg.  To run it again, give --overwrite or another
    folder.
    """

    @staticmethod
    def add_arguments(parser):
        """Add the arguments of the command."""
        add_output(parser, "images and report", default="astro_scc_demo")

    @staticmethod
    def run(args, reporter):
        """Simulate a jet, measure it, and print both results."""
        from astro_scc.measurement import product_folder
        from astro_scc.simulation import write_simulation

        output = Path(args.output)
        jet = simulated("two-fluid", seed=SEED)
        with product_folder(output, overwrite=args.overwrite, stale=STALE) as folder:
            *files, _ = write_simulation(jet, folder / "epochs")
            region = folder / "region.reg"
            _write_region(region, jet.cube.shape[1:])
            settings = Settings(
                epochs=[str(output / "epochs" / path.name) for path in files],
                scales="1,2,3",
                max_speed="36 mas/yr",
                position_angle="270 deg",
                n_trials=N_TRIALS,
                seed=SEED,
            )
            cube, settings, *_ = read_epochs(settings, files=files, note=reporter.note)
            settings = replace(settings, region=str(output / region.name))
            result = measure(cube, settings, reporter, region=region)
            components = write_measurement(
                result, settings, folder, output=output, warnings=reporter.warnings
            )
        reporter.say(
            *_truth_lines(jet),
            "\nMeasured:",
            *component_lines(components, result.features, result.sensitivity),
            f"\nReport: {output / 'report.html'}",
        )


def _write_region(path, shape):
    """Write the jet between ``FIRST`` and ``LAST`` as a DS9 region."""
    from regions import PixCoord, RectanglePixelRegion, Regions

    centre = PixCoord((FIRST + LAST) / 2, (shape[0] - 1) / 2)
    box = RectanglePixelRegion(centre, LAST - FIRST + 1, shape[0])
    Regions([box]).write(path, format="ds9", precision=12)


def _truth_lines(jet):
    """Return the simulated velocities as lines."""
    rows = []
    for name in dict.fromkeys(jet.truth["group"]):
        own = jet.truth[jet.truth["group"] == name]
        axes = ("pm_east", "pm_north")
        east, north = (own[axis].mean().to_value("mas / yr") for axis in axes)
        row = {"stream": str(name)}
        row["proper motion (mas / yr)"] = f"{math.hypot(east, north):.2f}"
        row["PA (deg)"] = f"{math.degrees(math.atan2(east, north)) % 360:.0f}"
        rows.append(row)
    return ["Simulated:", *table_lines(rows)]
