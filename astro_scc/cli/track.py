# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The commands track and explain: features followed, and why each is one."""

from pathlib import Path

import astropy.units as u

from astro_scc import StackedCrossCorrelation
from astro_scc.cli import inputs
from astro_scc.epochs.registration import warn_of_misalignment
from astro_scc.exceptions import MeasurementWarning, warn
from astro_scc.explain import explain_feature
from astro_scc.features import find_features
from astro_scc.kinematics.cosmology import beta_per_pm
from astro_scc.patterns import decompose_epochs
from astro_scc.products.folder import product_folder, write_files, write_tables
from astro_scc.products.publication import with_published, write_publication
from astro_scc.quantities import finite_quantities, named, to_time
from astro_scc.report.answer import feature_lines, published_lines, speed_lines
from astro_scc.settings import Settings
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
        features = _find(epochs, reporter, epochs.settings.seed)
        table = _write(features, epochs, folder)
        if not args.no_figures:
            more = {"published": epochs.published}

            def draw(name):
                if name == "tracks":
                    return plot_tracks(features, **more)
                return plot_separation(features, beta_per_pm=beta_per_pm(table), **more)

            files = style.figure_files(("separation", "tracks"), draw, pdf=args.pdf)
            write_files(files, folder)
    lines = *feature_lines(table, most=len(table)), *published_lines(table)
    lines = *lines, *speed_lines(epochs.settings.in_c), *epochs.found
    what = "Tables" if args.no_figures else "Tables and figures"
    reporter.say(*lines, f"\n{what}: {output}")


def _find(epochs, reporter, seed):
    """Return the features of a cube."""
    cube, settings, ssps = epochs.cube, epochs.settings, None
    warn_of_misalignment(cube)
    n_workers, progress_bar = epochs.n_workers, reporter.progress
    if settings.detections == "ssp" or cube.beams is None:
        decomposer = StackedCrossCorrelation.from_settings(settings).decomposer(cube)
        decomposed, _ = decompose_epochs(
            cube, decomposer, n_workers=n_workers, progress_bar=progress_bar
        )
        ssps = decomposed.ssps
    features = find_features(
        cube, detections=settings.detections, ssps=ssps, region=settings.region,
        seed=seed, n_workers=n_workers, progress_bar=progress_bar,
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
    meta = table.meta | {"epochs": list(cube.labels), "versions": versions()}
    tables, _ = write_tables(
        {"features": table, "positions": features.positions}, folder, meta, cube,
        configuration=epochs.settings.to_dict("track"), published=epochs.published,
    )  # fmt: skip
    write_publication(tables, folder)
    return tables["features"]


# -- why one is a feature, or none ---------------------------------------------------


def explain(args, reporter):
    """Explain what became of a feature according to the arguments."""
    subject = _subject(args)
    folder = Path(args.folder)
    advice = "; name a folder that astro-scc measure or track has written"
    table = inputs.read_table(folder / "features.ecsv", advice)
    settings = Settings(**table.meta["configuration"])
    epochs = inputs.read_epochs(settings, args, features=True)
    if args.published is not None:
        rows = epochs.published[epochs.published["published"] == args.published]
        if len(rows) == 0:
            numbers = sorted(set(epochs.published["published"].tolist()))
            raise ValueError(
                f"{args.compare}: has no feature {args.published}; it has "
                f"{', '.join(map(str, numbers))}"
            )
        subject = {"published": rows}
    # A measurement has no seed of its own for the features.
    measured = (folder / "streams.ecsv").is_file()
    features = _find(epochs, reporter, 0 if measured else settings.seed)
    if features.number.tolist() != table["feature"].tolist():
        reporter.warn(
            f"{folder}: its features are not those of the images now; measure again"
        )
    reporter.say(*explain_feature(features, **subject))


def _subject(args):
    """Return the arguments of `explain_feature` that the options name."""
    if args.published is not None and args.compare is None:
        raise ValueError("--published needs --compare, the table that has the feature")
    if (args.at is None) != (args.date is None):
        raise ValueError("--at and --date are given together")
    given = args.feature, args.published, args.at
    if sum(value is not None for value in given) != 1:
        raise ValueError("give one of --feature, --published, and --at with --date")
    if args.at is None:
        return {"feature": args.feature}
    offset = named("--at", _offset, args.at)
    return {"offset": offset, "date": named("--date", to_time, args.date)}


def _offset(value):
    wanted = 'must be an offset to the east and to the north, such as "-3.1 1.2 mas"'
    found = finite_quantities(value, u.mas, wanted)
    if found.size != 2:
        raise ValueError(wanted)
    return found
