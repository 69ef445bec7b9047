# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Follow individual features from epoch to epoch (WISE)."""

from dataclasses import fields, replace

import astropy.units as u
import numpy as np
from astropy.table import QTable

from astro_scc import StackedCrossCorrelation
from astro_scc.cli import inputs
from astro_scc.cli.summary import plus_minus, speed_lines, table_lines
from astro_scc.kinematics import apparent_speed
from astro_scc.measurement import decomposing, product_folder, versions, write_votable
from astro_scc.measurement.plan import mean_fwhm, warn_of_none_inside
from astro_scc.measurement.products import plain_meta
from astro_scc.tracking import FeatureTracker, plain_table
from astro_scc.visualization import plot_separation, plot_track_profile, plot_tracks
from astro_scc.visualization.profiles import missing_columns

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


def run(args, reporter):
    """Track features according to the arguments."""
    # The smallest correlation in a measurement's configuration is for stacks.
    settings = inputs.settings_of(
        args, reporter, unused=("kappa",), kappa=KAPPA, n_trials=N_TRIALS
    )
    if settings.along is None and settings.across is None:
        # Ignore velocity axes of a measurement that tracking does not have.
        if args.position_angle is None and isinstance(settings.position_angle, str):
            settings = replace(settings, position_angle=None)
    # Wrong --workers are refused before the images are read.
    inputs.workers_of(args)
    output = inputs.output_of(args, settings)
    known = {own.name: getattr(settings, own.name) for own in fields(FeatureTracker)}
    tracker = FeatureTracker(**{k: v for k, v in known.items() if v is not None})
    stack = None if args.profile is None else inputs.read_table(args.profile)
    if stack is not None and (missing := missing_columns(stack)):
        raise ValueError(f"{args.profile}: is no profile, it has no {missing}")
    made = product_folder(output, overwrite=args.overwrite, stale=PRODUCTS)
    with made as folder:
        epochs = inputs.read_epochs(settings, note=reporter.note, direction=False)
        cube, settings, *_ = epochs
        n_workers = inputs.workers_of(args, cube)
        decomposer = StackedCrossCorrelation.from_settings(settings).decomposer(cube)
        work = cube, decomposer, tracker, settings
        inputs.tell_time(reporter, n_workers, _tracking_time, *work)
        tracking = _track(*work, reporter, n_workers)
        profile = _write(tracking, settings, folder, votable=args.votable)
        if not args.no_figures:
            _draw(tracking, profile, settings, folder, stack)
    reporter.say(
        *_summary(tracking),
        *speed_lines(settings.in_c),
        *epochs.found,
        f"\nTables{'' if args.no_figures else ' and figures'}: {output}",
    )


def _tracking_time(cube, decomposer, tracker, settings):
    """Estimate how long tracking takes, see `~astro_scc.cli.inputs.measuring_time`."""
    scales, pixel = decomposer.scales, cube.pixel_scale
    speeds = [s for s in (tracker.along, tracker.across) if s is not None]
    speeds = speeds or [tracker.speed_limit(cube, scales)]
    steps, years = tracker.max_gap + 1, cube.years
    intervals = years[steps:] - years[:-steps] if len(cube) > steps else np.ptp(years)
    farthest = max(np.abs(s).max() for s in speeds) * np.quantile(intervals, LONG_GAP)
    beams = tracker.tolerance * mean_fwhm(cube, max(scales)) / pixel.to_value("mas")
    reach = (farthest / pixel).to_value("") + beams
    reach = np.minimum(reach, np.array(cube.shape[1:]) - 1)
    orders = settings.n_trials + 1
    number = {"n_targets": steps * orders, "region": settings.region}
    shared, n_ssps = decomposing.matching_time(cube, decomposer, reach, **number)
    alone = LINK * orders * n_ssps + inputs.REPORT + inputs.READ * len(cube)
    what = f"{len(cube)} epochs with about {inputs.rounded(n_ssps)} patterns"
    return shared, alone, what


def _track(cube, decomposer, tracker, settings, reporter, n_workers):
    """Decompose the epochs and link their features."""
    region = settings.region
    inside = None if region is None else cube.region_mask(region)
    how = {"n_workers": n_workers, "progress_bar": reporter.progress}
    decompositions = decomposing.decompose_epochs(cube, decomposer, **how)
    ssps, select = decomposing.ssps_inside(decompositions, cube, inside)
    warn_of_none_inside(ssps, select, region)
    how |= {"n_trials": settings.n_trials, "rng": settings.seed}
    return tracker(cube, decompositions, select=select, **how)


def _write(tracking, settings, folder, *, votable):
    """Write the tables, and return the profile."""
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
    tables = {"features": tracking.features, "tracks": tracks}
    for name, table in (tables | {"track_profile": profile}).items():
        table = QTable(table, copy=False)
        table.meta = meta
        table.write(folder / f"{name}.ecsv", format="ascii.ecsv", overwrite=True)
        if votable and name in tables:
            write_votable(plain_table(table), folder / f"{name}.vot", overwrite=True)
    return profile


def _draw(tracking, profile, settings, folder, stack):
    """Write the figures, with the profile ``stack`` if it is not None."""
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
    tracks = tracking.tracks
    rows = []
    for share in tracking.shares:
        own = tracks["scale"] == share.scale
        rows.append(
            {
                "scale": "all" if share.scale is None else f"{share.scale:g}",
                "tracks": str(len(tracks) if share.scale is None else np.sum(own)),
                "SSPs": str(share.n_ssps),
                "linked": f"{share.share:.2f} ± {share.share_err:.2f}",
                "if permuted": f"{share.permuted:.2f} ± {share.permuted_err:.2f}",
            }
        )
    yield from table_lines(rows)
    ejected = np.sum(~np.asarray(tracks["t_ej"].mask))
    yield f"{len(tracks)} tracks, {ejected} with an ejection epoch"
    if len(tracks):
        speed, unit = tracks["pm"], tracks["pm"].unit
        fastest = tracks[np.argmax(speed)]
        yield (
            f"speeds: median {np.median(speed).value:.3g} {unit}, fastest "
            f"{plus_minus(fastest, 'pm')} {unit} ({fastest['track']})"
        )
