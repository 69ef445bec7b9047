# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc measure``: from images to velocities."""

import argparse
from pathlib import Path

from astro_scc.cli.arguments import (
    add_output,
    add_selection,
    draw_seed,
    select_epochs,
    settings_of,
)
from astro_scc.cli.summary import component_lines

__all__ = [
    "add_measurement",
    "add_parser",
    "distance_of",
    "measure",
    "measurer_of",
    "read",
    "run",
    "settings_as_used",
]

EPILOG = """\
examples:
  astro-scc measure 3c273/*.fits -o out --align core --max-speed "2 mas/yr" \\
      --redshift 0.158
  astro-scc measure *.fits -o out --align cores.ecsv --region jet.reg \\
      --position-angle "-112 deg" --baseline "0.1 yr 0.6 yr" --redshift 0.033
  astro-scc measure m87/*.fits -o out --scales "0.2 mas, 0.4 mas" \\
      --distance "16.7 Mpc"
  astro-scc measure --config out/config.toml -o again

The folder gets components.ecsv, ssps.ecsv, scc.fits, report.html with its figures,
and config.toml: with it, and the same images, the same tables come out to the bit.
Every option of a measurement may stand in a configuration file, with _ for -, and
some that have no option: target, min_overlap, wavelet, detection, segmentation,
noise, level, nulls, alignment_error,
small_displacement_correction (see the documentation).  What the
command line says comes before what the file says.
"""
REMARKS = (
    "What determined this measurement.  To do it again, in the folder it was done in,",
    "with the path of this file: astro-scc measure --config FILE -o FOLDER",
)
# Files of an earlier measurement that must not stand beside a new one.
PRODUCTS = (
    "components.ecsv",
    "ssps.ecsv",
    "scc.fits",
    "config.toml",
    "report.html",
    "velocity_map.png",
    "significance.png",
    "members.png",
    "epochs.png",
    "intervals.png",
)


def add_parser(commands):
    """Add the command to the program's parser."""
    parser = commands.add_parser(
        "measure",
        help="measure the velocities in the images of one jet",
        description="Measure the velocity components in images of one object at many "
        "dates.",
        epilog=EPILOG,
    )
    parser.add_argument(
        "epochs",
        metavar="EPOCH.fits",
        nargs="*",
        help="one image a date, or a file that EpochCube.write made",
    )
    add_output(parser, what="tables, maps and report")
    parser.add_argument("--config", metavar="FILE.toml", help="read settings from here")
    parser.add_argument(
        "--no-report", action="store_true", help="write no report.html and figures"
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
    group = parser.add_argument_group("images")
    add_selection(group)
    group.add_argument(
        "--align",
        metavar="none|core|correlate|wcs|TABLE",
        help="lay the epochs on their reference pixels (none, the default), on the "
        "core that is fitted in each, on one another by correlation, on their "
        "absolute coordinates (wcs; not for VLBI), or by a table (CSV or ECSV) of "
        "dates and offsets of the core",
    )
    group.add_argument(
        "--common-beam",
        action=argparse.BooleanOptionalAction,
        help="convolve to the smallest beam that contains all; the default where "
        "beams differ",
    )
    group.add_argument(
        "--region",
        metavar="FILE.reg",
        help="measure patterns inside a DS9 or CRTF region only",
    )

    group = parser.add_argument_group("measurement")
    group.add_argument(
        "--scales",
        metavar="1,2,3",
        help='wavelet scales by number (j is 2^j pixels) or angle, "0.2 mas, 0.4 mas"; '
        "default 1,2,3,4",
    )
    group.add_argument(
        "--max-speed",
        metavar='"2 mas/yr"',
        help="largest proper motion; default four beams in the median interval",
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
        help="pair epochs this far apart in time; default consecutive epochs",
    )
    group.add_argument(
        "--kernel",
        metavar="0.2",
        help="smallest error of a displacement, in beams; default 0.2",
    )
    group.add_argument(
        "--kappa", metavar="0.6", help="smallest correlation of a match; default 0.6"
    )
    group.add_argument(
        "--n-trials",
        metavar="1000",
        help="trials of the significance and of the errors; default 1000",
    )
    group.add_argument(
        "--seed", metavar="N", help="of the trials; drawn and written down by default"
    )

    group = parser.add_argument_group("speeds in units of c")
    group.add_argument("--redshift", metavar="Z", help="of the object")
    group.add_argument(
        "--cosmology",
        metavar='NAME|"H0=71,Om0=0.27"',
        help="for the redshift, as Planck18 or by parameters; default H0=71,Om0=0.27 "
        "(Mertens & Lobanov 2016)",
    )
    group.add_argument(
        "--distance", metavar='"16.7 Mpc"', help="of a near object, without a redshift"
    )

    group = parser.add_argument_group("running")
    group.add_argument(
        "--workers",
        metavar="N",
        type=int,
        default=1,
        help="threads; the numbers do not depend on it; default 1",
    )
    return parser


def run(args, reporter):
    """
    Measure, as the arguments say.

    Parameters
    ----------
    args : `argparse.Namespace`
    reporter : `~astro_scc.cli.reporter.Reporter`
    """
    from astro_scc.measurement import product_folder

    config = settings_of(args, reporter)
    if not config.get("epochs"):
        raise ValueError("no epochs were given; name the FITS files, or a --config")
    if args.workers < 1:
        raise ValueError(f"--workers must be at least 1, got {args.workers}")
    with product_folder(
        args.output, overwrite=args.overwrite, stale=PRODUCTS
    ) as folder:
        cube, config, left_out = read(config, reporter)
        components = measure(
            cube,
            config,
            folder,
            reporter,
            output=args.output,
            left_out=left_out,
            n_workers=args.workers,
            report=not args.no_report,
        )
    for line in component_lines(components):
        reporter.say(line)
    reporter.say(f"\n{_where(args)}")


def _where(args):
    if args.no_report:
        return f"Tables and maps: {Path(args.output)}"
    return f"Report: {Path(args.output) / 'report.html'}"


def read(config, reporter, *, files=None):
    """
    Read the epochs of a configuration.

    Parameters
    ----------
    config : dict
        See `astro_scc.config`.
    reporter : `~astro_scc.cli.reporter.Reporter`
    files : list of path, optional
        Where the epochs are now, if that is not where they will be.

    Returns
    -------
    cube : `~astro_scc.EpochCube`
        With one beam and aligned.
    config : dict
        With the files and the steps that were taken.
    left_out : list of (str, str)
        Epochs that are not in the cube, and why.
    """
    from astro_scc import EpochCube
    from astro_scc.epochs.assembly import find_files

    config = dict(config)
    if files is None:
        files = find_files(config["epochs"])
        config["epochs"] = [str(path) for path in files]
    align = config.setdefault("align", "none")
    frame = "absolute" if align == "wcs" else "offset"
    cube = EpochCube.read(files, frame=frame)
    cube, left_out = select_epochs(cube, config)
    config["common_beam"] = _wants_common_beam(cube, config, reporter)
    if config["common_beam"]:
        cube = cube.to_common_beam()
    return cube.align(align), config, left_out


def _wants_common_beam(cube, config, reporter):
    wanted = config.get("common_beam")
    if wanted is not None:
        return wanted
    if cube.beams is None:
        reporter.note("the epochs have no beams and are left as they are")
        return False
    differ = any(beam != cube.beams[0] for beam in cube.beams)
    if differ:
        reporter.note("the beams differ: convolving to a common one (--no-common-beam)")
    return differ


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
    n_workers : int, optional
    report : bool, optional

    Returns
    -------
    `~astropy.table.QTable`
        The components.
    """
    from astro_scc.config import format_config, plain_settings
    from astro_scc.measurement import versions, write_products

    how = distance_of(config)
    scc = measurer_of(config)
    # A region file that cannot be used is better known before the long part.
    region = region or config.get("region")
    inside = None if region is None else cube.region_mask(region)
    config = settings_as_used(scc, config, cube, seed=draw_seed())
    result = scc(
        cube,
        region=inside,
        n_trials=config["n_trials"],
        rng=config["seed"],
        n_workers=n_workers,
        progress_bar=reporter.progress,
    )
    components = result.components_in_c(**how) if how else result.components
    text = format_config(config, versions=versions(), remarks=REMARKS)
    write_products(
        result, components, folder, configuration=plain_settings(config), text=text
    )
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


def measurer_of(config):
    """
    The measurement with the settings that the configuration has.

    Parameters
    ----------
    config : dict

    Returns
    -------
    `~astro_scc.StackedCrossCorrelation`
    """
    from dataclasses import fields

    from astro_scc import StackedCrossCorrelation

    names = {field.name for field in fields(StackedCrossCorrelation)}
    return StackedCrossCorrelation(
        **{name: value for name, value in config.items() if name in names}
    )


def settings_as_used(scc, config, cube, *, seed):
    """
    All settings of a measurement; what was given stays as it was written.

    Parameters
    ----------
    scc : `~astro_scc.StackedCrossCorrelation`
    config : dict
    cube : `~astro_scc.EpochCube`
    seed : int
        Without one in the configuration.

    Returns
    -------
    dict
    """
    from dataclasses import fields

    return {
        "n_trials": 1000,
        "seed": seed,
        **{field.name: getattr(scc, field.name) for field in fields(scc)},
        **config,
        "max_speed": config.get("max_speed", scc.speed_limit(cube)),
    }


def distance_of(config):
    """
    How to turn proper motions into speeds, the options of `components_in_c`.

    Parameters
    ----------
    config : dict

    Returns
    -------
    dict
    """
    from astro_scc.config import to_cosmology

    if "distance" in config:
        return {"distance": config["distance"]}
    if "redshift" in config:
        return {
            "redshift": config["redshift"],
            "cosmology": to_cosmology(config["cosmology"]),
        }
    return {}
