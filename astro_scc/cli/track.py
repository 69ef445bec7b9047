# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Find the features of a jet and follow each from epoch to epoch."""

from astropy.table import QTable

from astro_scc import StackedCrossCorrelation
from astro_scc.cli import inputs
from astro_scc.cli.summary import feature_lines, speed_lines
from astro_scc.decomposition import SSPs
from astro_scc.epochs.registration import warn_of_misalignment
from astro_scc.exceptions import MeasurementWarning, warn
from astro_scc.features import find_features
from astro_scc.kinematics.cosmology import table_in_c
from astro_scc.measurement import decomposing, product_folder, versions, write_votable
from astro_scc.measurement.products import plain_meta
from astro_scc.visualization import plot_separation, plot_tracks

# Files of an earlier run that must not remain beside new ones.
PRODUCTS = (
    "features.ecsv positions.ecsv features.vot positions.vot separation.png tracks.png"
).split()
#: Dots per inch of the figures.
DPI = 130


def run(args, reporter):
    """Follow features according to the arguments."""
    settings = inputs.settings_of(args, reporter)
    # Wrong --workers are refused before the images are read.
    inputs.workers_of(args)
    output = inputs.output_of(args, settings)
    made = product_folder(output, overwrite=args.overwrite, stale=PRODUCTS)
    with made as folder:
        epochs = inputs.read_epochs(settings, note=reporter.note, features=True)
        cube, settings, *_ = epochs
        n_workers = inputs.workers_of(args, cube)
        features = _find(cube, settings, reporter, n_workers)
        table = _write(features, settings, folder, votable=args.votable)
        if not args.no_figures:
            _draw(features, folder)
    reporter.say(
        *feature_lines(table, most=len(table)),
        *speed_lines(settings.in_c),
        *epochs.found,
        f"\nTables{'' if args.no_figures else ' and figures'}: {output}",
    )


def _find(cube, settings, reporter, n_workers):
    """Return the features of a cube."""
    warn_of_misalignment(cube)
    how = {"n_workers": n_workers, "progress_bar": reporter.progress}
    ssps = None
    if settings.detections == "ssp" or cube.beams is None:
        decomposer = StackedCrossCorrelation.from_settings(settings).decomposer(cube)
        ssps = SSPs.of_epochs(decomposing.decompose_epochs(cube, decomposer, **how))
    features = find_features(
        cube, detections=settings.detections, ssps=ssps, region=settings.region,
        seed=settings.seed, **how,
    )  # fmt: skip
    if len(features.detections) == 0:
        where = "" if settings.region is None else f" in {settings.region}"
        warn(
            f"no emission beside the core was detected in any epoch{where}",
            MeasurementWarning,
        )
    return features


def _write(features, settings, folder, *, votable):
    """Write the tables, and return that of the features."""
    how, table = settings.in_c, features.table
    tables = {
        "features": table_in_c(table, **how) if how else table,
        "positions": features.positions,
    }
    meta = {
        "configuration": settings.to_dict("track"),
        **plain_meta(tables["features"].meta),
        "epochs": list(features.cube.labels),
        "history": list(features.cube.meta.get("history", ())),
        "versions": versions(),
    }
    for name, own in tables.items():
        own = QTable(own, copy=False)
        own.meta = meta
        own.write(folder / f"{name}.ecsv", format="ascii.ecsv", overwrite=True)
        if votable:
            write_votable(own, folder / f"{name}.vot", overwrite=True)
    return tables["features"]


def _draw(features, folder):
    """Write the figures."""
    figures = {"separation": plot_separation, "tracks": plot_tracks}
    for name, plot in figures.items():
        figure = plot(features)
        figure.savefig(folder / f"{name}.png", dpi=DPI, metadata={"Software": None})
