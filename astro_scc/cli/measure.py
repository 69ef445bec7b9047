# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The commands on one series: measure, profile, demo, explore, track and explain."""

import math
import shlex
from dataclasses import replace
from pathlib import Path

import astropy.units as u
from astropy.io import fits

from astro_scc import StackedCrossCorrelation
from astro_scc.cli import inputs
from astro_scc.cli.program import one_line
from astro_scc.columns import table_lines
from astro_scc.epochs.registration import warn_of_misalignment
from astro_scc.exceptions import MeasurementWarning, warn
from astro_scc.explain import explain_feature
from astro_scc.features import find_features
from astro_scc.flow import compare_scales, measure_profile
from astro_scc.flow.profile import bins_of, write_profile
from astro_scc.kinematics.cosmology import beta_per_pm
from astro_scc.patterns import decompose_epochs
from astro_scc.products import write_epoch_regions, write_products
from astro_scc.products.folder import product_folder, write_files, write_tables
from astro_scc.products.publication import with_published, write_publication
from astro_scc.quantities import finite_quantities, named, to_time
from astro_scc.report import answer, write_report
from astro_scc.report.page import PRODUCTS, flow_lines
from astro_scc.settings import Settings, read_config, refuse_other_method
from astro_scc.streams.members import BEYOND_CHANCE
from astro_scc.units import in_speed_unit
from astro_scc.visualization import FIGURES, style, tracks
from astro_scc.writing import versions

#: Products of an earlier measurement that must not remain beside new ones.
STALE = (
    *PRODUCTS,
    *(f"{kind}.{form}" for kind in FIGURES for form in ("png", "pdf")),
    *("report.html", "ssp_regions", "explore.html"),
)
PROFILE = (
    "profile.ecsv scales.ecsv profile.png position_angles.png config.toml "
    "citations.bib publication"
).split()
TRACKED = (
    "features.ecsv positions.ecsv citations.bib publication separation.png tracks.png "
    "separation.pdf tracks.pdf"
).split()
#: Seed and trials of the demo, and the columns of the jet that it measures, from 0
#: (Mertens & Lobanov 2016, Sect. 2.4).
DEMO_SEED, N_TRIALS = 1, 1000
FIRST, LAST = 60, 160


def measure(args, reporter):
    """Measure according to the arguments."""
    settings = inputs.settings_of(args, reporter, n_trials=1000)
    output, as_in_paper = inputs.output_of(args, settings), settings.method == "paper"
    refuse_other_method(settings.method, vars(args))
    with product_folder(output, overwrite=args.overwrite, stale=STALE) as folder:
        epochs = inputs.read_epochs(
            settings, args, note=reporter.note, moving=not as_in_paper
        )
        inputs.refuse_others(output, settings, "profile.ecsv")
        result, page = _measured(epochs, reporter), {"pdf": args.pdf}
        if not as_in_paper:
            # Nobody reads them otherwise.
            told = not (reporter.quiet and args.no_report)
            flow = flow_lines(result) if told else []
            page |= {"all_figures": args.all_figures, "flow": flow}
        streams = write_measurement(
            result, epochs, folder, output=output, report=not args.no_report,
            warnings=reporter.warnings, compare=args.compare, **page,
        )  # fmt: skip
        if args.ds9_regions:
            write_epoch_regions(result.decomposed.ssps, epochs.cube, folder)
    where = f"\nTables and maps: {output}"
    if as_in_paper:
        lines = answer.paper_lines(streams, result.level)
    else:
        found = result.features, result.tracked_features
        features = with_published(*found, epochs.published)
        lines = answer.stream_lines(streams, features)
        lines += answer.published_lines(features) + flow
        where = where if args.no_report else f"\nReport: {output / 'report.html'}"
    reporter.say(*lines, *epochs.found, where)


def _measured(epochs, reporter):
    """Return the measurement of epochs."""
    settings = epochs.settings
    given = {"n_trials": settings.n_trials, "rng": settings.seed}
    given |= {"n_workers": epochs.n_workers, "progress_bar": reporter.progress}
    scc = StackedCrossCorrelation.from_settings(settings)
    return scc(epochs.cube, region=settings.region, **given)


def write_measurement(
    result, epochs, folder, *, output, report=True, compare=None, command="measure",
    **page
):  # fmt: skip
    """
    Write tables, maps, settings and report, or the paper's figure, of a measurement.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    epochs : `~astro_scc.cli.inputs.Inputs`
        The epochs, the settings and the published features.
    folder : path
        Where to write.
    output : `~pathlib.Path`
        Final path of the folder.
    report : bool, optional
        Write the report, and the tables in the forms of journals and archives.
    compare : str, optional
        The file of the published features.
    command : str, optional
        The one that gives the same results from the settings, "measure" or "profile".
    **page
        Further arguments of `~astro_scc.report.write_report`.

    Returns
    -------
    `~astropy.table.QTable`
        The streams.
    """
    settings, published = epochs.settings, epochs.published
    streams = inputs.with_speeds_in_c(result.streams, settings)
    write_products(
        result, streams, folder, configuration=settings.to_dict(command),
        text=settings.to_toml(command, versions=versions()), published=published,
        archives=report,
    )  # fmt: skip
    if report and settings.method == "paper":
        per_pm = beta_per_pm(streams)
        files = style.figure_files(
            ("paper",), lambda _: result.plot(beta_per_pm=per_pm), pdf=page["pdf"]
        )
        write_files(files, folder)
    elif report:
        rerun = f"astro-scc {command} --config {output / 'config.toml'} -o FOLDER"
        if compare:
            rerun += f" --compare {shlex.quote(compare)}"
        write_report(
            result, folder, streams=streams, rerun=rerun, published=published,
            explore=f"astro-scc explore {output}", left_out=epochs.left_out,
            chosen=epochs.chosen, **page,
        )  # fmt: skip
    return streams


# -- in bins of distance -------------------------------------------------------------


def profile(args, reporter):
    """Measure a profile according to the arguments."""
    settings = inputs.settings_of(args, reporter, n_trials=1000)
    if settings.bins is None:
        raise ValueError('--bins is missing: give limits such as "0.5 1.5 2.5 mas"')
    inputs.refuse_paper(settings)
    # Wrong --bins are refused before the images are read.
    bins_of(settings.bins, window=settings.window)
    output = inputs.output_of(args, settings)
    with product_folder(output, overwrite=args.overwrite, stale=PROFILE) as folder:
        epochs = inputs.read_epochs(settings, args, note=reporter.note, moving=True)
        inputs.refuse_others(output, settings, "streams.ecsv")
        streams, lines = _profile(epochs, folder, reporter)
        write_publication({"profile": streams}, folder)
    lines = [*answer.profile_lines(streams), "", *lines, *epochs.found]
    reporter.say(*lines, f"\nProfile: {output / 'profile.ecsv'}")


def _profile(epochs, folder, reporter):
    """Write the profile; return its streams, and lines on all bins together."""
    cube, settings = epochs.cube, epochs.settings
    scc = StackedCrossCorrelation.from_settings(settings)
    shown = {"progress_bar": reporter.progress}
    decomposed = scc.decompose(
        cube, region=settings.region, n_workers=epochs.n_workers, **shown
    )
    found = measure_profile(
        scc, decomposed, settings.bins, window=settings.window,
        scale_groups=settings.scale_groups, n_trials=settings.n_trials,
        rng=settings.seed, **shown,
    )  # fmt: skip
    streams = inputs.with_speeds_in_c(found.components, settings)
    streams.meta |= cube.facts
    several = len(found.groups) > 1
    lines = [
        f"scales {name}: {line}" if several else str(line)
        for name, line in found.accelerations.items()
    ]
    if several:
        of_scales = in_speed_unit(compare_scales(found), cube.speed_unit)
        of_scales.write(folder / "scales.ecsv", format="ascii.ecsv")
        lines += answer.scale_lines(of_scales)
    write_profile(
        found, streams, folder, configuration=settings.to_dict("profile"),
        text=settings.to_toml("profile", versions=versions()),
    )  # fmt: skip
    return streams, lines


# -- the jet of the paper ------------------------------------------------------------


def demo(args, reporter):
    """Simulate a jet, measure it, and print both results."""
    output = Path(args.output)
    from astro_scc.simulation import simulate_two_fluid, write_simulation

    jet = simulate_two_fluid(rng=DEMO_SEED)
    jet.truth.meta["seed"] = DEMO_SEED
    with product_folder(output, overwrite=args.overwrite, stale=STALE) as folder:
        *files, _ = write_simulation(jet, folder / "epochs")
        region, height = folder / "region.reg", jet.cube.shape[1]
        # Pixels of DS9 count from 1.
        x, y, width = (FIRST + LAST) / 2 + 1, (height + 1) / 2, LAST - FIRST + 1
        box = f"box({x},{y},{width},{height},0)"
        region.write_text(f"image\n{box}\n", encoding="ascii")
        given = {"epochs": [*map(str, files)], "region": str(region), "scales": "1,2,3"}
        given |= {"max_speed": "36 mas/yr", "position_angle": "270 deg"}
        settings = Settings(n_trials=N_TRIALS, seed=DEMO_SEED, **given)
        epochs = inputs.read_epochs(settings, note=reporter.note)
        result = _measured(epochs, reporter)
        # Where they will be when the folder is complete.
        paths = [str(output / path.relative_to(folder)) for path in (region, *files)]
        settings = epochs.settings.changed(region=paths[0], epochs=paths[1:])
        streams = write_measurement(
            result, epochs._replace(settings=settings), folder, output=output,
            warnings=reporter.warnings,
        )  # fmt: skip
    found = answer.stream_lines(streams, result.features)
    report = f"\nReport: {output / 'report.html'}"
    reporter.say(*_truth_lines(jet), "\nMeasured:", *found, report)


def _truth_lines(jet):
    """Return the simulated velocities as lines."""
    rows = []
    for name in dict.fromkeys(jet.truth["group"]):
        stream = jet.truth[jet.truth["group"] == name]
        motions = (stream[f"pm_{axis}"].mean() for axis in ("east", "north"))
        east, north = (motion.to_value("mas / yr") for motion in motions)
        speed, angle = math.hypot(east, north), math.degrees(math.atan2(east, north))
        row = {"stream": str(name), "proper motion (mas / yr)": f"{speed:.2f}"}
        rows.append(row | {"PA (deg)": f"{angle % 360:.0f}"})
    return ["Simulated:", *table_lines(rows)]


# -- a page of a measurement that is there -------------------------------------------


def explore(args, reporter):
    """Write the page of a measurement according to the arguments."""
    from astro_scc.visualization.explore import write_explore

    folder = Path(args.folder)
    advice = "; name a folder that astro-scc measure has written"
    names = ("streams", "features")
    tables = [inputs.read_table(folder / f"{name}.ecsv", advice) for name in names]
    try:
        hdus = fits.open(folder / "scc.fits")
    except OSError as error:
        what = "does not exist" if error.filename else "is no FITS file"
        raise OSError(f"{folder / 'scc.fits'}: {what}; measure again") from None
    with hdus:
        cube, notes = _images(folder / "config.toml", hdus[0].header, reporter)
        page = folder / "explore.html"
        path = write_explore(page, *tables, hdus, cube=cube, notes=notes)
    reporter.say(f"{path}: {path.stat().st_size / 1e6:.1f} MB")


def _images(config, header, reporter):
    """Return the epochs of a measurement, or None and a note on why there are none."""
    try:
        cube = inputs.read_epochs(Settings(**read_config(config)[0])).cube
        dates = cube.times.utc.isot[[0, -1]].tolist()
        measured = [header[key] for key in ("NEPOCHS", "DATE-BEG", "DATE-END")]
        if [len(cube), *dates] != measured:
            raise ValueError(f"{config}: names other epochs than those measured")
    except (OSError, ValueError) as error:
        note = f"without images: {one_line(error)}"
        reporter.note(note)
        return None, [note]
    return cube, []


# -- features alone, and why one is a feature or none ---------------------------------


def track(args, reporter):
    """Follow features according to the arguments."""
    settings = inputs.settings_of(args, reporter)
    output = inputs.output_of(args, settings)
    with product_folder(output, overwrite=args.overwrite, stale=TRACKED) as folder:
        epochs = inputs.read_epochs(settings, args, note=reporter.note, features=True)
        features = _find(epochs, reporter)
        table = _write(features, epochs, folder)
        if not args.no_figures:
            more = {"separation": {"beta_per_pm": beta_per_pm(table)}, "tracks": {}}

            def draw(name):
                plot = getattr(tracks, f"plot_{name}")
                return plot(features, published=epochs.published, **more[name])

            files = style.figure_files(more, draw, pdf=args.pdf)
            write_files(files, folder)
    lines = answer.feature_lines(table, most=len(table)) + answer.published_lines(table)
    if 0 < features.coverage < BEYOND_CHANCE:
        lines.append(
            f"Secure features are {features.coverage:.1%} of all detections: as many "
            "are found by chance in images that have little in common, which "
            "'astro-scc measure' tests."
        )
    lines += answer.speed_lines(epochs.settings.in_c) + epochs.found
    what = "Tables" if args.no_figures else "Tables and figures"
    reporter.say(*lines, f"\n{what}: {output}")


def _find(epochs, reporter):
    """Return the features of a cube, the same as in a measurement."""
    cube, settings, ssps = epochs.cube, epochs.settings, None
    warn_of_misalignment(cube)
    options = {"n_workers": epochs.n_workers, "progress_bar": reporter.progress}
    if settings.detections == "ssp" or cube.beams is None:
        decomposer = StackedCrossCorrelation.from_settings(settings).decomposer(cube)
        decomposed, _ = decompose_epochs(cube, decomposer, **options)
        ssps = decomposed.ssps
    features = find_features(
        cube, detections=settings.detections, ssps=ssps, region=settings.region,
        **options,
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
    features = _find(epochs, reporter)
    features = replace(features, doubts=table.meta.get("doubts", {}))
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
