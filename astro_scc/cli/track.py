# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc track``: from images to features followed from epoch to epoch."""

from astro_scc.cli.arguments import (
    add_config,
    add_distance,
    add_epochs,
    add_images,
    add_output,
    add_patterns,
    add_trials,
    add_votable,
    add_workers,
)
from astro_scc.cli.settings import draw_seed, parse_option, settings_of, workers_of
from astro_scc.cli.summary import speed_lines, table_lines

__all__ = ["add_parser", "run"]

EPILOG = """\
examples:
  astro-scc track 3c120/*.fits -o tracks --align core --max-speed "4 mas/yr" \\
      --redshift 0.033
  astro-scc track *.fits -o tracks --align cores.ecsv --position-angle "-112 deg" \\
      --along "0 4 mas/yr" --across "-1 1 mas/yr" --profile out/profile.ecsv

The folder gets features.ecsv, a row for each feature and epoch, tracks.ecsv, a row for
each feature, track_profile.ecsv, speed against distance, and figures of all three.
A configuration file of astro-scc measure may be given for the settings that both have.
"""
# Files of an earlier run that must not stand beside new ones.
PRODUCTS = (
    "features.ecsv",
    "tracks.ecsv",
    "track_profile.ecsv",
    "features.vot",
    "tracks.vot",
    "separation.png",
    "tracks.png",
    "track_profile.png",
)
#: Settings of a measurement that tracking has no use for.
UNUSED = dict.fromkeys(("baseline", "kernel"))
#: Settings of the tracker alone.
TRACKER = ("along", "across", "tolerance", "max_gap", "max_interval", "min_epochs")
N_TRIALS = 20


def add_parser(commands):
    """Add the command to the program's parser."""
    parser = commands.add_parser(
        "track",
        help="follow single features from epoch to epoch (WISE)",
        description="Follow the features of images of one object at many dates.",
        epilog=EPILOG,
    )
    parser.set_defaults(**UNUSED)
    add_epochs(parser)
    add_output(parser, what="the tables and figures")
    add_config(parser)
    parser.add_argument(
        "--no-figures", action="store_true", help="write the tables alone"
    )
    add_votable(parser, "features.vot and tracks.vot")
    add_images(parser, verb="track")
    _add_tracking(parser.add_argument_group("tracking"))
    add_distance(parser)
    add_workers(parser)
    return parser


def _add_tracking(group):
    add_patterns(group, kappa=0.5, speed="four beams in the median interval")
    group.add_argument(
        "--position-angle",
        metavar='"65 deg"|radial',
        help="direction of the jet, north through east, for --along and --across",
    )
    for name, what in (("along", "along the jet"), ("across", "across it")):
        group.add_argument(
            f"--{name}",
            metavar='"-1 4 mas/yr"',
            help=f"smallest and largest proper motion {what}",
        )
    group.add_argument(
        "--tolerance",
        metavar="0.2",
        help="scatter of displacements about steady motion, in beams; default 0.2",
    )
    group.add_argument(
        "--max-gap",
        metavar="1",
        help="consecutive epochs at which a feature may be missing; default 1",
    )
    group.add_argument(
        "--max-interval",
        metavar='"1 yr"',
        help="longest time between two epochs that are linked",
    )
    group.add_argument(
        "--min-epochs",
        metavar="3",
        help="epochs that make a track at least; default 3",
    )
    add_trials(
        group,
        number=N_TRIALS,
        what="shuffled orders that are linked too, at least 2, to see chance at work",
    )
    group.add_argument(
        "--half-width",
        metavar='"2 mas"',
        help="features this near a distance make the profile there; default 2 mas "
        "(Mertens & Lobanov 2016), or a fifth of the longest distance if less",
    )
    group.add_argument(
        "--profile",
        metavar="FILE.ecsv",
        help="profile of the stack, as of astro-scc profile, for the figure",
    )


def run(args, reporter):
    """
    Track, as the arguments say.

    Parameters
    ----------
    args : `argparse.Namespace`
    reporter : `~astro_scc.cli.reporter.Reporter`
    """
    from astro_scc.cli.track_products import draw_tracks, write_tracks
    from astro_scc.config import read_epochs
    from astro_scc.measurement import product_folder

    config = settings_of(args, reporter)
    n_workers = workers_of(args)
    tracker = _tracker(args, config)
    half_width = args.half_width and parse_option("half_width", args.half_width)
    stack = None if args.profile is None else _stack_profile(args.profile)
    with product_folder(
        args.output, overwrite=args.overwrite, stale=PRODUCTS
    ) as folder:
        cube, config, _ = read_epochs(config, note=reporter.note)
        config = {"n_trials": N_TRIALS, "seed": draw_seed(), **config}
        tracking = _track(cube, tracker, config, reporter, n_workers)
        profile = write_tracks(
            tracking, config, folder, half_width=half_width, votable=args.votable
        )
        if not args.no_figures:
            draw_tracks(tracking, profile, config, folder, stack=stack)
    for line in (*_summary(tracking), *speed_lines(config)):
        reporter.say(line)
    reporter.say(f"\nTables{'' if args.no_figures else ' and figures'}: {args.output}")


def _tracker(args, config):
    """The settings of the tracker, from the command line and the configuration."""
    from astro_scc.tracking import FeatureTracker

    names = ("max_speed", "position_angle", "kappa", "target", "min_overlap",
             "common_beam")  # fmt: skip
    settings = {name: config[name] for name in names if name in config}
    if "kappa" in config and args.kappa is None:
        # That of a measurement is for stacks.
        del settings["kappa"]
    settings |= {
        name: parse_option(name, value)
        for name in TRACKER
        if (value := getattr(args, name)) is not None
    }
    if settings.get("along") is None and settings.get("across") is None:
        # A measurement's axes that need more than tracking has are no matter.
        angle = settings.get("position_angle")
        if args.position_angle is None and isinstance(angle, str):
            del settings["position_angle"]
    return FeatureTracker(**settings)


def _stack_profile(path):
    """The profile of the stack, and that it is one."""
    from astropy.table import QTable

    try:
        table = QTable.read(path, format="ascii.ecsv")
    except FileNotFoundError:
        raise OSError(f"{path}: does not exist") from None
    except Exception as error:
        first = str(error).strip().splitlines()
        raise ValueError(
            f"{path}: is no ECSV table: {first[0] if first else error}"
        ) from None
    wanted = ("r_mid", "pm_parallel", "pm_parallel_err")
    missing = [name for name in wanted if name not in table.colnames]
    if missing:
        raise ValueError(f"{path}: is no profile, it has no {', '.join(missing)}")
    return table


def _track(cube, tracker, config, reporter, n_workers):
    from astro_scc.decomposition import Decomposer
    from astro_scc.measurement.decomposing import allow_for_structure, decompose_epochs
    from astro_scc.measurement.plan import (
        scales_of_pixels,
        ssps_inside,
        warn_of_none_inside,
    )

    names = {"wavelet": "kernel", "detection": "detection", "noise": "noise",
             "segmentation": "segmentation"}  # fmt: skip
    options = {names[name]: config[name] for name in names if name in config}
    scales = scales_of_pixels(config.get("scales", (1, 2, 3, 4)), cube.pixel_scale)
    region = config.get("region")
    inside = None if region is None else cube.region_mask(region)
    decomposer = allow_for_structure(cube, Decomposer(scales=scales, **options))
    decompositions = decompose_epochs(cube, decomposer)
    ssps, select = ssps_inside(decompositions, cube, inside)
    warn_of_none_inside(ssps, select, region)
    return tracker(
        cube,
        decompositions,
        select=select,
        n_trials=config["n_trials"],
        rng=config["seed"],
        n_workers=n_workers,
        progress_bar=reporter.progress,
    )


def _summary(tracking):
    """What was found, as lines."""
    import numpy as np

    tracks = tracking.tracks
    ejected = int(np.sum(~np.asarray(tracks["t_ej"].mask)))
    rows = []
    for share in tracking.shares:
        scale = "all" if share.scale is None else f"{share.scale:g}"
        own = np.asarray(tracks["scale"]) == share.scale
        rows.append(
            [
                scale,
                str(len(tracks) if share.scale is None else int(own.sum())),
                str(share.n_ssps),
                f"{share.share:.2f} ± {share.share_err:.2f}",
                f"{share.shuffled:.2f} ± {share.shuffled_err:.2f}",
            ]
        )
    yield from table_lines(["scale", "tracks", "SSPs", "linked", "if shuffled"], rows)
    yield f"{len(tracks)} tracks, {ejected} with an ejection epoch"
