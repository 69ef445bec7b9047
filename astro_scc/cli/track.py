# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Find the features of a jet and follow each from epoch to epoch."""

from astro_scc import StackedCrossCorrelation
from astro_scc.alignment.registration import warn_of_misalignment
from astro_scc.cli import inputs
from astro_scc.decomposition import SSPs
from astro_scc.exceptions import MeasurementWarning, warn
from astro_scc.features import find_features
from astro_scc.kinematics.cosmology import beta_per_pm
from astro_scc.patterns import decompose_epochs
from astro_scc.products.folder import product_folder, write_files, write_tables
from astro_scc.products.publication import with_published, write_publication
from astro_scc.report.answer import feature_lines, published_lines, speed_lines
from astro_scc.visualization import style
from astro_scc.visualization.tracks import plot_separation, plot_tracks
from astro_scc.writing import versions

# Files of an earlier run that must not remain beside new ones.
PRODUCTS = (
    "features.ecsv positions.ecsv citations.bib publication separation.png tracks.png "
    "separation.pdf tracks.pdf"
).split()


def track(args, reporter):
    """Follow features according to the arguments."""
    settings = inputs.settings_of(args, reporter)
    output = inputs.output_of(args, settings)
    with product_folder(output, overwrite=args.overwrite, stale=PRODUCTS) as folder:
        epochs = inputs.read_epochs(settings, args, note=reporter.note, features=True)
        features = _find(epochs, reporter)
        table = _write(features, epochs, folder)
        if not args.no_figures:
            more = {"published": epochs.published}

            def draw(name):
                if name == "tracks":
                    return plot_tracks(features, **more)
                return plot_separation(features, beta_per_pm=beta_per_pm(table), **more)

            files = style.figure_files(("separation", "tracks"), draw, pdf=args.pdf)
            write_files(files, folder)
    reporter.say(
        *feature_lines(table, most=len(table)),
        *published_lines(table),
        *speed_lines(epochs.settings.in_c),
        *epochs.found,
        f"\nTables{'' if args.no_figures else ' and figures'}: {output}",
    )


def _find(epochs, reporter):
    """Return the features of a cube."""
    cube, settings, ssps = epochs.cube, epochs.settings, None
    warn_of_misalignment(cube)
    n_workers, progress_bar = epochs.n_workers, reporter.progress
    if settings.detections == "ssp" or cube.beams is None:
        decomposer = StackedCrossCorrelation.from_settings(settings).decomposer(cube)
        decomposed = decompose_epochs(
            cube, decomposer, n_workers=n_workers, progress_bar=progress_bar
        )
        ssps = SSPs.of_epochs(decomposed)
    features = find_features(
        cube, detections=settings.detections, ssps=ssps, region=settings.region,
        seed=settings.seed, n_workers=n_workers, progress_bar=progress_bar,
    )  # fmt: skip
    if len(features.detections) == 0:
        where = "" if settings.region is None else f" in {settings.region}"
        text = f"no emission beside the core was detected in any epoch{where}"
        warn(text, MeasurementWarning)
    return features


def _write(features, epochs, folder):
    """Write the tables, and return that of the features."""
    cube = features.cube
    table = with_published(features.table, features, epochs.published)
    table = inputs.with_speeds_in_c(table, epochs.settings)
    meta = {
        "configuration": epochs.settings.to_dict("track"),
        **table.meta,
        "epochs": list(cube.labels),
        "history": list(cube.meta.get("history", ())),
        "versions": versions(),
    }
    if epochs.published is not None:
        meta["history"].append(f"compared with {epochs.published.meta['survey']}")
    tables = {"features": table, "positions": features.positions}
    tables, _ = write_tables(tables, folder, meta)
    write_publication(tables, folder)
    return tables["features"]
