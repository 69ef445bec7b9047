# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc measure``: from images to velocities."""

from pathlib import Path

from astro_scc.cli.arguments import (
    add_config,
    add_distance,
    add_epochs,
    add_images,
    add_no_report,
    add_output,
    add_patterns,
    add_trials,
    add_votable,
    add_workers,
)
from astro_scc.cli.resuming import WORK, kept_seed, working_folder
from astro_scc.cli.settings import settings_of, workers_of
from astro_scc.cli.summary import component_lines

__all__ = ["add_measurement", "add_parser", "measure", "run"]

EPILOG = """\
examples:
  astro-scc measure 3c273/*.fits -o out --align core --max-speed "2 mas/yr" \\
      --redshift 0.158
  astro-scc measure *.fits -o out --align cores.ecsv --region jet.reg \\
      --position-angle "-112 deg" --baseline "0.1 yr 0.6 yr" --redshift 0.033
  astro-scc measure m87/*.fits -o out --scales "0.2 mas, 0.4 mas" \\
      --distance "16.7 Mpc"
  astro-scc measure --config out/config.toml -o again

The folder gets components.ecsv, features.ecsv, ssps.ecsv, scc.fits, report.html with
its figures, and config.toml: with it, and the same images, the same tables come out to
the bit.  Every option of a measurement may stand in a configuration file, with _ for
-, and some that have no option: target, min_overlap, wavelet, detection, segmentation,
noise, level, outward, alignment_error,
small_displacement_correction (see the documentation).  What the
command line says comes before what the file says.
"""
REMARKS = (
    "What determined this measurement.  To do it again, in the folder it was done in,",
    "with the path of this file: astro-scc measure --config FILE -o FOLDER",
)
PRODUCTS = (
    "components.ecsv",
    "features.ecsv",
    "ssps.ecsv",
    "scc.fits",
    "config.toml",
    "report.html",
    "diagram.png",
    "velocity_map.png",
    "significance.png",
    "members.png",
    "epochs.png",
    "intervals.png",
)
#: What an earlier measurement left that must not stand beside a new one.
STALE = (*PRODUCTS, "components.vot", "ssps.vot", "ssp_regions")


def add_parser(commands):
    """Add the command to the program's parser."""
    parser = commands.add_parser(
        "measure",
        help="measure the velocities in the images of one jet",
        description="Measure the velocity components in images of one object at many "
        "dates.",
        epilog=EPILOG,
    )
    add_epochs(parser)
    add_output(parser, what="tables, maps and report")
    add_config(parser)
    add_no_report(parser)
    add_votable(parser, "components.vot and ssps.vot")
    parser.add_argument(
        "--ds9-regions",
        action="store_true",
        help="write ssp_regions too, a file an epoch that DS9 and CARTA open, with "
        "the outlines of its patterns",
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help=f"keep the matches in {WORK} of the folder, go on from what an "
        "interrupted run did there, and replace what an earlier one with --resume "
        "wrote",
    )
    add_measurement(parser)
    return parser


def add_measurement(parser):
    """
    Add what says how images are measured.

    Parameters
    ----------
    parser : `argparse.ArgumentParser`
    """
    add_images(parser, verb="measure")
    group = parser.add_argument_group("measurement")
    add_patterns(
        group,
        kappa=0.6,
        speed="1.5 beams in the shorter intervals, four of up to 20 epochs",
    )
    group.add_argument(
        "--position-angle",
        metavar='"65 deg"|fit|ridge|radial',
        help="direction of the jet, north through east: velocities along and across "
        "it instead of east and north; fit for that of the mean image, ridge for "
        "along its ridge line, radial for away from the reference pixel",
    )
    group.add_argument(
        "--baseline",
        metavar='"0.2 yr 1.0 yr"',
        help="compare epochs only that are this far apart in time; by default each "
        "speed has the intervals in which it moves 0.2 to 1 beam",
    )
    group.add_argument(
        "--kernel",
        metavar="0.2",
        help="smallest error of a displacement, in beams; default 0.2",
    )
    add_trials(group, number=1000, what="trials of the significance and of the errors")
    add_distance(parser)
    add_workers(parser)


def run(args, reporter):
    """
    Measure, as the arguments say.

    Parameters
    ----------
    args : `argparse.Namespace`
    reporter : `~astro_scc.cli.reporter.Reporter`
    """
    from astro_scc.config import read_epochs
    from astro_scc.measurement import product_folder

    config = settings_of(args, reporter)
    n_workers = workers_of(args)
    overwrite, work = args.overwrite, None
    if args.resume:
        work = Path(args.output) / WORK
        overwrite = overwrite or work.is_dir()
        reporter.on_interrupt = (
            "interrupted; the same command goes on from what is done"
        )
    with (
        working_folder(work, args.output, overwrite=overwrite),
        product_folder(
            args.output, overwrite=overwrite or bool(work), stale=STALE
        ) as folder,
    ):
        cube, config, left_out = read_epochs(config, note=reporter.note)
        components = measure(
            cube,
            config,
            folder,
            reporter,
            output=args.output,
            left_out=left_out,
            n_workers=n_workers,
            report=not args.no_report,
            votable=args.votable,
            ds9_regions=args.ds9_regions,
            work=work,
        )
    for line in component_lines(components):
        reporter.say(line)
    reporter.say(f"\n{_where(args)}")


def _where(args):
    if args.no_report:
        return f"Tables and maps: {Path(args.output)}"
    return f"Report: {Path(args.output) / 'report.html'}"


def measure(
    cube,
    config,
    folder,
    reporter,
    *,
    output,
    region=None,
    left_out=(),
    n_workers=1,
    report=True,
    votable=False,
    ds9_regions=False,
    work=None,
):
    """
    Measure a cube and write the products.

    Parameters
    ----------
    cube : `~astro_scc.EpochCube`
    config : dict
        See `astro_scc.config`; it is completed, and written to the folder.
    folder : path
        Where to write.
    reporter : `~astro_scc.cli.reporter.Reporter`
    output : path
        What the folder will be called.
    region : path, optional
        Where the region file is now, if that is not where it will be.
    left_out : list of (str, str), optional
        Epochs that are not in the cube, and why, for the report.
    n_workers : int or str, optional
        See `~astro_scc.StackedCrossCorrelation.match`.
    report, votable, ds9_regions : bool, optional
        What to write beside tables, maps and settings.
    work : `~pathlib.Path`, optional
        Folder where matches and seed are kept.

    Returns
    -------
    `~astropy.table.QTable`
        The components.
    """
    from astro_scc import StackedCrossCorrelation
    from astro_scc.config import (
        distance_of,
        format_config,
        plain_settings,
        settings_as_used,
    )
    from astro_scc.measurement import versions, write_epoch_regions, write_products
    from astro_scc.measurement.products import write_votables

    how = distance_of(config)
    scc = StackedCrossCorrelation.from_settings(config)
    # A region file that cannot be used is better known before the long part.
    region = region or config.get("region")
    cube.region_mask(region)
    config = settings_as_used(scc, config, seed=kept_seed(work))
    result = scc(
        cube,
        region=region,
        n_trials=config["n_trials"],
        rng=config["seed"],
        n_workers=n_workers,
        cache=None if work is None else work / "matches.fits",
        progress_bar=reporter.progress,
    )
    components = result.components_in_c(**how) if how else result.components
    text = format_config(config, versions=versions(), remarks=REMARKS)
    write_products(
        result, components, folder, configuration=plain_settings(config), text=text
    )
    if votable:
        write_votables(result, components, folder)
    if ds9_regions:
        write_epoch_regions(result.matched.ssps, cube, folder)
    if report:
        from astro_scc.report import write_report

        again = Path(output) / "config.toml"
        write_report(
            result,
            components,
            folder,
            title=cube.meta.get("object") or "Velocity components",
            warnings=tuple(reporter.warnings),
            left_out=left_out,
            rerun=f"astro-scc measure --config {again} -o FOLDER",
            config_text=text,
        )
    return components
