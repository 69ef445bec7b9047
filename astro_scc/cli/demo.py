# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Simulate the two-fluid jet of the paper and measure it.

Simulate the two-fluid jet of Mertens & Lobanov (2016), a slow sheath around a
fast spine, measure it and write the report.  No input is needed.

The folder gets the products of astro-scc measure, the images in epochs/ and
the region in region.reg.
"""

import math
from dataclasses import replace
from pathlib import Path

from astro_scc.cli.inputs import read_epochs
from astro_scc.cli.measure import STALE, measure, write_measurement
from astro_scc.cli.options import add_output
from astro_scc.cli.simulate import simulated
from astro_scc.cli.summary import component_lines, table_lines
from astro_scc.settings import Settings

SEED, N_TRIALS = 1, 1000
# Columns of the jet that are measured, from 0 (Mertens & Lobanov 2016, Sect. 2.4).
FIRST, LAST = 60, 160


def add_arguments(parser):
    """Add the arguments of the command."""
    add_output(parser, "images and report", default="astro_scc_demo")


def run(args, reporter):
    """Simulate a jet, measure it, and print both results."""
    from astro_scc.measurement import product_folder
    from astro_scc.simulation import write_simulation

    output = Path(args.output)
    jet = simulated("two-fluid", seed=SEED)
    with product_folder(output, overwrite=args.overwrite, stale=STALE) as folder:
        *files, _ = write_simulation(jet, folder / "epochs")
        _write_region(folder / "region.reg", jet.cube.shape[1:])
        settings = Settings(
            epochs=[str(output / "epochs" / path.name) for path in files],
            scales="1,2,3",
            max_speed="36 mas/yr",
            position_angle="270 deg",
            n_trials=N_TRIALS,
            seed=SEED,
        )
        cube, settings, _ = read_epochs(settings, files=files, note=reporter.note)
        settings = replace(settings, region=str(output / "region.reg"))
        result = measure(cube, settings, reporter, region=folder / "region.reg")
        components = write_measurement(
            result, settings, folder, output=output, warnings=reporter.warnings
        )
    for line in (
        *_truth_lines(jet),
        "",
        "Measured:",
        *component_lines(components, result.features),
    ):
        reporter.say(line)
    reporter.say(f"\nReport: {output / 'report.html'}")


def _write_region(path, shape):
    """Write the jet between ``FIRST`` and ``LAST`` as a DS9 region."""
    from regions import PixCoord, RectanglePixelRegion, Regions

    centre = PixCoord((FIRST + LAST) / 2, (shape[0] - 1) / 2)
    box = RectanglePixelRegion(centre, LAST - FIRST + 1, shape[0])
    Regions([box]).write(path, format="ds9", precision=12)


def _truth_lines(jet):
    """Return the simulated velocities as lines."""
    head = ["stream", "proper motion (mas / yr)", "PA (deg)"]
    rows = []
    for name in dict.fromkeys(jet.truth["group"]):
        own = jet.truth[jet.truth["group"] == name]
        east, north = (
            own[f"pm_{axis}"].mean().to_value("mas / yr") for axis in ("east", "north")
        )
        angle = math.degrees(math.atan2(east, north)) % 360
        rows.append([str(name), f"{math.hypot(east, north):.2f}", f"{angle:.0f}"])
    return ["Simulated:", *table_lines(head, rows)]
