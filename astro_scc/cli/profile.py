# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc profile``: velocities in bins of distance from the core."""

from dataclasses import asdict
from pathlib import Path

from astro_scc.cli.arguments import (
    add_config,
    add_epochs,
    add_output,
    add_votable,
)
from astro_scc.cli.measure import add_measurement
from astro_scc.cli.settings import draw_seed, settings_of, workers_of
from astro_scc.cli.summary import profile_lines, scale_lines

__all__ = ["add_parser", "run"]

EPILOG = """\
examples:
  astro-scc profile 3c120/*.fits -o out --align core --bins "0.5 1.5 2.5 3.5 mas" \\
      --position-angle "-112 deg" --max-speed "5 mas/yr" --redshift 0.033
  astro-scc profile m87/*.fits -o out --bins "1 2 4 8 mas" --position-angle ridge \\
      --distance "16.7 Mpc"
  astro-scc profile *.fits -o out --bins "1 2 3 4 5 mas" --window "2 mas"

Matches are made once, for all images; each bin is a stack of those of its patterns.
The folder gets profile.ecsv, a row for each bin and component with p_fdr, which is
adjusted for all bins, and in its header the acceleration of the whole stretch;
scales.ecsv, the speeds of the finest scale and of the others beside one another;
profile.png, velocity_maps.png and position_angles.png; and config.toml.  With
--position-angle ridge, distances are along the ridge line.
"""
REMARKS = (
    "What determined this profile.  To do it again, in the folder it was done in,",
    "with the path of this file: astro-scc profile --config FILE -o FOLDER",
)
PRODUCTS = (
    "profile.ecsv",
    "scales.ecsv",
    "profile.png",
    "velocity_maps.png",
    "position_angles.png",
    "config.toml",
    "profile.vot",
)


def add_parser(commands):
    """Add the command to the program's parser."""
    parser = commands.add_parser(
        "profile",
        help="measure the velocities in bins of distance from the core",
        description="Measure the velocities in bins of distance from the core.",
        epilog=EPILOG,
    )
    add_epochs(parser)
    add_output(parser, what="the table and figures of the profile")
    add_config(parser)
    add_votable(parser, "profile.vot")
    group = parser.add_argument_group("distances")
    group.add_argument(
        "--bins",
        metavar='"0.5 1.5 2.5 mas"',
        help="limits of the bins, distances from the core; needed here or in --config",
    )
    group.add_argument(
        "--window",
        metavar='"2 mas"',
        help="windows of this width about each of the --bins, instead of bins between",
    )
    add_measurement(parser)
    return parser


def run(args, reporter):
    """
    Measure a profile, as the arguments say.

    Parameters
    ----------
    args : `argparse.Namespace`
    reporter : `~astro_scc.cli.reporter.Reporter`
    """
    from astro_scc.config import read_epochs
    from astro_scc.flow.profile import bins_of
    from astro_scc.measurement import product_folder, write_votable

    config = settings_of(args, reporter)
    if "bins" not in config:
        raise ValueError('--bins is missing: give limits such as "0.5 1.5 2.5 mas"')
    n_workers = workers_of(args)
    bins_of(config["bins"], window=config.get("window"))
    with product_folder(
        args.output, overwrite=args.overwrite, stale=PRODUCTS
    ) as folder:
        cube, config, _ = read_epochs(config, note=reporter.note)
        components, lines = _measure(cube, config, folder, reporter, n_workers)
        if args.votable:
            write_votable(components, folder / "profile.vot")
    for line in [*profile_lines(components), "", *lines]:
        reporter.say(line)
    reporter.say(f"\nProfile: {Path(args.output) / 'profile.ecsv'}")


def _measure(cube, config, folder, reporter, n_workers):
    from astro_scc import StackedCrossCorrelation
    from astro_scc.config import (
        distance_of,
        format_config,
        plain_settings,
        settings_as_used,
    )
    from astro_scc.flow import (
        measure_acceleration,
        measure_profile,
        write_profile,
    )
    from astro_scc.measurement import select_ssps, versions

    scc = StackedCrossCorrelation.from_settings(config)
    how = distance_of(config)
    region = config.get("region")
    cube.region_mask(region)
    config = settings_as_used(scc, config, seed=draw_seed())
    matched = scc.match(
        cube, region=region, n_workers=n_workers, progress_bar=reporter.progress
    )
    ridge = None
    if scc.position_angle == "ridge":
        _, ridge = scc.displacements(matched)
    profile = measure_profile(
        scc,
        matched,
        config["bins"],
        window=config.get("window"),
        ridge=ridge,
        n_trials=config["n_trials"],
        rng=config["seed"],
        progress_bar=reporter.progress,
    )
    components = profile.components_in_c(**how) if how else profile.components
    bins = profile.bins
    whole = scc.stack(
        select_ssps(matched, r_min=bins.min(), r_max=bins.max()),
        n_trials=config["n_trials"],
        rng=config["seed"],
    )
    acceleration = measure_acceleration(whole)
    components.meta["acceleration"] = asdict(acceleration)
    lines = [str(acceleration)]
    if (of_scales := _of_scales(whole)) is not None:
        of_scales.write(folder / "scales.ecsv", format="ascii.ecsv")
        lines += scale_lines(of_scales)
    text = format_config(config, versions=versions(), remarks=REMARKS)
    write_profile(
        profile, components, folder, configuration=plain_settings(config), text=text
    )
    return components, lines


def _of_scales(result):
    """Speeds of the finest scale and of the others, if there are and have any."""
    from astro_scc.flow import compare_speeds, scale_groups
    from astro_scc.kinematics import SkyFrame

    scales = sorted(set(result.matched.ssps.scale.tolist()))
    if len(scales) < 2 or isinstance(result.frame, SkyFrame):
        return None
    groups = {"finest": scales[:1], "coarser": scales[1:]}
    return compare_speeds(result, scale_groups(result.matched, groups))
