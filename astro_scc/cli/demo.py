# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc demo``: the whole way, on a jet that it simulates."""

from pathlib import Path

from astro_scc.cli import measure
from astro_scc.cli.arguments import add_output
from astro_scc.cli.simulate import simulated
from astro_scc.cli.summary import component_lines, table_lines

__all__ = ["add_parser", "run"]

SEED = 1
# Pixels of the jet that are measured, x from 0 (Mertens & Lobanov 2016, Sect. 2.4).
FIRST, LAST = 60, 160


def add_parser(commands):
    """Add the command to the program's parser."""
    parser = commands.add_parser(
        "demo",
        help="simulate the two-fluid jet of the paper and measure it",
        description="Simulate the two-fluid jet of Mertens & Lobanov (2016), a slow "
        "sheath around a\nfast spine, measure it and write the report.  Nothing is "
        "needed for it.",
        epilog="The folder gets what astro-scc measure writes, the images in epochs "
        "and the\nregion in region.reg.",
    )
    add_output(
        parser, what="images and report", required=False, default="astro_scc_demo"
    )
    return parser


def run(args, reporter):
    """
    Simulate a jet, measure it and compare.

    Parameters
    ----------
    args : `argparse.Namespace`
    reporter : `~astro_scc.cli.reporter.Reporter`
    """
    from astro_scc.config import parse_setting, read_epochs
    from astro_scc.measurement import product_folder
    from astro_scc.simulation import write_simulation

    output = Path(args.output)
    jet = simulated("two-fluid", seed=SEED)
    with product_folder(
        output, overwrite=args.overwrite, stale=measure.STALE
    ) as folder:
        *files, _ = write_simulation(jet, folder / "epochs")
        _write_region(folder / "region.reg", jet.cube.shape[1:])
        settings = {
            "epochs": [str(output / "epochs" / path.name) for path in files],
            "scales": "1,2,3",
            "max_speed": "36 mas/yr",
            "position_angle": "270 deg",
            "seed": SEED,
        }
        config = {name: parse_setting(name, v) for name, v in settings.items()}
        cube, config, _ = read_epochs(config, files=files, note=reporter.note)
        config["region"] = str(output / "region.reg")
        components = measure.measure(
            cube,
            config,
            folder,
            reporter,
            output=output,
            region=folder / "region.reg",
        )
    for line in (*_truth_lines(jet), "", "Measured:", *component_lines(components)):
        reporter.say(line)
    reporter.say(f"\nReport: {output / 'report.html'}")


def _write_region(path, shape):
    """The jet between two columns, as a DS9 region in pixels from 1."""
    from regions import PixCoord, RectanglePixelRegion, Regions

    centre = PixCoord((FIRST + LAST) / 2, (shape[0] - 1) / 2)
    box = RectanglePixelRegion(centre, LAST - FIRST + 1, shape[0])
    Regions([box]).write(path, format="ds9", precision=12)


def _truth_lines(jet):
    """What was put in."""
    import math

    import astropy.units as u

    head = ["stream", "proper motion (mas / yr)", "PA (deg)"]
    rows = []
    for name in dict.fromkeys(jet.truth["group"]):
        own = jet.truth[jet.truth["group"] == name]
        east, north = (
            own[f"pm_{axis}"].mean().to_value(u.mas / u.yr)
            for axis in ("east", "north")
        )
        angle = math.degrees(math.atan2(east, north)) % 360
        rows.append([str(name), f"{math.hypot(east, north):.2f}", f"{angle:.0f}"])
    return ["Simulated:", *table_lines(head, rows)]
