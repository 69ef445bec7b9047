# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Simulate the two-fluid jet of the paper and measure it."""

import math
from dataclasses import replace
from pathlib import Path

from astro_scc.cli.inputs import read_epochs
from astro_scc.cli.measure import STALE, measure, write_measurement
from astro_scc.cli.summary import component_lines, table_lines
from astro_scc.measurement.products import product_folder
from astro_scc.settings import Settings
from astro_scc.simulation import simulate_two_fluid, write_simulation

SEED, N_TRIALS = 1, 1000
# Columns of the jet that are measured, from 0 (Mertens & Lobanov 2016, Sect. 2.4).
FIRST, LAST = 60, 160


def run(args, reporter):
    """Simulate a jet, measure it, and print both results."""
    output = Path(args.output)
    jet = simulate_two_fluid(rng=SEED)
    jet.truth.meta["seed"] = SEED
    with product_folder(output, overwrite=args.overwrite, stale=STALE) as folder:
        *files, _ = write_simulation(jet, folder / "epochs")
        region = folder / "region.reg"
        _write_region(region, jet.cube.shape[1:])
        settings = Settings(
            epochs=[str(path) for path in files],
            scales="1,2,3",
            max_speed="36 mas/yr",
            position_angle="270 deg",
            n_trials=N_TRIALS,
            seed=SEED,
        )
        cube, settings, *_ = read_epochs(settings, note=reporter.note)
        # Where they will be when the folder is complete.
        paths = [str(output / path.relative_to(folder)) for path in (region, *files)]
        settings = replace(settings, region=paths[0], epochs=paths[1:])
        result = measure(cube, settings, reporter, region=region)
        components = write_measurement(
            result, settings, folder, output=output, warnings=reporter.warnings
        )
    reporter.say(
        *_truth_lines(jet),
        "\nMeasured:",
        *component_lines(components, result.features),
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
