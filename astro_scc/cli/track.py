# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Follow individual features from epoch to epoch (WISE).

Follow the features in images of one object at many dates.

examples:
  astro-scc track 3c120/*.fits -o tracks --align core --max-speed "4 mas/yr" \\
      --redshift 0.033
  astro-scc track *.fits -o tracks --align cores.ecsv --position-angle "-112 deg" \\
      --along "0 4 mas/yr" --across "-1 1 mas/yr" --profile out/profile.ecsv

The folder gets features.ecsv, with a row for each feature and epoch; tracks.ecsv, with
a row for each feature; track_profile.ecsv, speed against distance; and figures of all
three.  A configuration file of astro-scc measure sets what both commands have.
"""

from dataclasses import fields, replace
from pathlib import Path

from astro_scc.cli.inputs import (
    READ,
    REPORT,
    output_of,
    read_epochs,
    rounded,
    say_time,
    settings_of,
    workers_for,
    workers_of,
)
from astro_scc.cli.options import (
    OF_OBJECT,
    add_option,
    add_output,
    add_settings,
    add_switch,
)
from astro_scc.cli.summary import plus_minus, speed_lines, table_lines

# Files of an earlier run that must not remain beside new ones.
PRODUCTS = (
    "features.ecsv tracks.ecsv track_profile.ecsv features.vot tracks.vot "
    "separation.png tracks.png track_profile.png"
).split()
KAPPA, N_TRIALS = 0.5, 20
#: Dots per inch of the figures.
DPI = 130
#: Processor seconds to link an SSP in one order of the epochs
#: (``benchmarks/scaling.py estimate``).
LINK = 2e-4
#: Quantile of the intervals of which the time is estimated.
LONG_GAP = 0.9
#: Number of points of the profile.
N_RADII = 20


def add_arguments(parser):
    """Add the arguments of the command."""
    files = "features.vot and tracks.vot"
    add_output(parser, "the tables and figures", default=OF_OBJECT, votable=files)
    add_switch(parser, "--no-figures", "write only the tables")
    text = "profile of the stack, as of astro-scc profile, for the figure"
    add_option(parser, "--profile", "FILE.ecsv", text)
    add_settings(parser, "track")


def run(args, reporter):
    """Track features according to the arguments."""
    from astro_scc.measurement import product_folder

    # The smallest correlation in a measurement's configuration is for stacks.
    settings = settings_of(
        args, reporter, unused=("kappa",), kappa=KAPPA, n_trials=N_TRIALS
    )
    if settings.along is None and settings.across is None:
        # Ignore velocity axes of a measurement that tracking does not have.
        if args.position_angle is None and isinstance(settings.position_angle, str):
            settings = replace(settings, position_angle=None)
    n_workers, output = workers_of(args), Path(output_of(args, settings))
    tracker = _tracker(settings)
    stack = None if args.profile is None else _stack_profile(args.profile)
    made = product_folder(output, overwrite=args.overwrite, stale=PRODUCTS)
    with made as folder:
        chosen = []
        cube, settings, _ = read_epochs(
            settings, note=reporter.note, chosen=chosen.append
        )
        n_workers = workers_for(cube, n_workers)
        _tell_time(cube, tracker, settings, reporter, n_workers)
        tracking = _track(cube, tracker, settings, reporter, n_workers)
        profile = _write(tracking, settings, folder, votable=args.votable)
        if not args.no_figures:
            _draw(tracking, profile, settings, folder, stack)
    found = [f"Found in the images: {line}" for line in chosen]
    for line in (*_summary(tracking), *speed_lines(settings.in_c), *found):
        reporter.say(line)
    reporter.say(f"\nTables{'' if args.no_figures else ' and figures'}: {output}")


def _tracker(settings):
    """Return the tracker with the settings that are given."""
    from astro_scc.tracking import FeatureTracker

    found = {own.name: getattr(settings, own.name) for own in fields(FeatureTracker)}
    return FeatureTracker(**{k: v for k, v in found.items() if v is not None})


def _stack_profile(path):
    """Return the profile of the stack, and refuse other files."""
    from astropy.table import QTable

    from astro_scc.visualization.profiles import missing_columns

    try:
        table = QTable.read(path, format="ascii.ecsv")
    except FileNotFoundError:
        raise OSError(f"{path}: does not exist") from None
    except Exception as error:
        first = [*str(error).strip().splitlines(), ""][0]
        raise ValueError(f"{path}: is no ECSV table: {first}") from None
    if missing := missing_columns(table):
        raise ValueError(f"{path}: is no profile, it has no {missing}")
    return table


def _tell_time(cube, tracker, settings, reporter, n_workers):
    """Say how long tracking will take, if that is over five minutes."""
    import numpy as np

    from astro_scc import StackedCrossCorrelation
    from astro_scc.measurement.decomposing import matching_time
    from astro_scc.measurement.plan import mean_fwhm

    if reporter.quiet or not isinstance(n_workers, int):
        return
    decomposer = StackedCrossCorrelation.from_settings(settings).decomposer(cube)
    speeds = [s for s in (tracker.along, tracker.across) if s is not None]
    speeds = speeds or [tracker.speed_limit(cube, decomposer.scales)]
    steps, years = tracker.max_gap + 1, cube.years
    intervals = years[steps:] - years[:-steps] if len(cube) > steps else np.ptp(years)
    farthest = max(np.abs(s).max() for s in speeds) * np.quantile(intervals, LONG_GAP)
    reach = (farthest / cube.pixel_scale).to_value("")
    reach += (
        tracker.tolerance
        * mean_fwhm(cube, max(decomposer.scales))
        / (cube.pixel_scale.to_value("mas"))
    )
    orders = settings.n_trials + 1
    shared, n_ssps = matching_time(
        cube,
        decomposer,
        np.minimum(reach, np.array(cube.shape[1:]) - 1),
        region=settings.region,
        n_targets=steps * orders,
    )
    say_time(
        reporter,
        n_workers,
        shared,
        LINK * orders * n_ssps + REPORT + READ * len(cube),
        f"{len(cube)} epochs with about {rounded(n_ssps)} patterns",
    )


def _track(cube, tracker, settings, reporter, n_workers):
    """Decompose the epochs and link their features."""
    from astro_scc import StackedCrossCorrelation
    from astro_scc.measurement.decomposing import decompose_epochs
    from astro_scc.measurement.plan import ssps_inside, warn_of_none_inside

    region = settings.region
    inside = None if region is None else cube.region_mask(region)
    decomposer = StackedCrossCorrelation.from_settings(settings).decomposer(cube)
    decompositions = decompose_epochs(
        cube, decomposer, n_workers=n_workers, progress_bar=reporter.progress
    )
    ssps, select = ssps_inside(decompositions, cube, inside)
    warn_of_none_inside(ssps, select, region)
    return tracker(
        cube,
        decompositions,
        select=select,
        n_trials=settings.n_trials,
        rng=settings.seed,
        n_workers=n_workers,
        progress_bar=reporter.progress,
    )


def _write(tracking, settings, folder, *, votable):
    """Write the tables, and return the profile."""
    import astropy.units as u
    import numpy as np
    from astropy.table import QTable

    from astro_scc.measurement import versions, write_votable
    from astro_scc.measurement.products import plain_meta
    from astro_scc.tracking import plain_table

    how = settings.in_c
    tracks = tracking.tracks_in_c(**how) if how else tracking.tracks
    longest = tracks["r"].to_value(u.mas).max(initial=0.0) * u.mas
    half_width = settings.half_width
    if half_width is None:
        half_width = min(2 * u.mas, longest / 5) if longest > 0 else 2 * u.mas
    radii = np.linspace(0, 1, N_RADII + 1)[1:] if longest > 0 else []
    profile = tracking.profile(radii * longest, half_width=half_width)
    meta = {
        "configuration": settings.to_dict("track"),
        **plain_meta({**tracks.meta, **profile.meta}),
        "versions": versions(),
    }
    for name, table in (
        ("features", tracking.features),
        ("tracks", tracks),
        ("track_profile", profile),
    ):
        table = QTable(table, copy=False)
        table.meta = meta
        table.write(folder / f"{name}.ecsv", format="ascii.ecsv", overwrite=True)
        if votable and name != "track_profile":
            write_votable(plain_table(table), folder / f"{name}.vot", overwrite=True)
    return profile


def _draw(tracking, profile, settings, folder, stack):
    """Write the figures, with the profile ``stack`` if it is not None."""
    import astropy.units as u

    from astro_scc.kinematics import apparent_speed
    from astro_scc.visualization import plot_separation, plot_track_profile, plot_tracks

    how = settings.in_c
    per_pm = float(apparent_speed(1 * u.mas / u.yr, **how)) if how else None
    figures = {
        "separation": plot_separation(tracking),
        "tracks": plot_tracks(tracking),
        "track_profile": plot_track_profile(profile, stack=stack, beta_per_pm=per_pm),
    }
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png", dpi=DPI, metadata={"Software": None})


def _summary(tracking):
    """Yield lines on what was found."""
    import numpy as np

    tracks = tracking.tracks
    ejected = int(np.sum(~np.asarray(tracks["t_ej"].mask)))
    rows = []
    for share in tracking.shares:
        own = np.asarray(tracks["scale"]) == share.scale
        rows.append(
            [
                "all" if share.scale is None else f"{share.scale:g}",
                str(len(tracks) if share.scale is None else int(own.sum())),
                str(share.n_ssps),
                f"{share.share:.2f} ± {share.share_err:.2f}",
                f"{share.permuted:.2f} ± {share.permuted_err:.2f}",
            ]
        )
    yield from table_lines(["scale", "tracks", "SSPs", "linked", "if permuted"], rows)
    yield f"{len(tracks)} tracks, {ejected} with an ejection epoch"
    if len(tracks):
        speed, unit = tracks["pm"], tracks["pm"].unit
        fastest = tracks[np.argmax(speed)]
        yield (
            f"speeds: median {np.median(speed).value:.3g} {unit}, fastest "
            f"{plus_minus(fastest, 'pm')} {unit} ({fastest['track']})"
        )
