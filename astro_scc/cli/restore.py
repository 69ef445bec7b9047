# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc restore``: images from lists of components."""

from pathlib import Path

from astro_scc.cli.inputs import draw_seed, option_of
from astro_scc.cli.options import add_output, add_setting
from astro_scc.quantities import named, one_quantity, parse_quantities, to_time

EPILOG = """\
examples:
  astro-scc restore 1226+023.ecsv -o 3c273 --beam "1.0 mas 0.5 mas -7 deg" \\
      --pixel "0.1 mas" --noise "0.3 mJy/beam" --seed 1 --before 2011-01-01
  astro-scc restore apjac230ft4_mrt.txt --source 1226+023 -o 3c273 --beam "1 mas" \\
      --pixel "0.1 mas"
  astro-scc restore models/*.mod -o images --beam "0.9 0.6 mas -5 deg" \\
      --pixel "0.1 mas"

Tables are ECSV or machine-readable tables as the journal publishes those of a survey,
of the AAS (.txt) or the CDS (.dat, with its ReadMe beside it), with the columns epoch
(or Obs.Y, Obs.M, Obs.D), flux, separation and position_angle; .mod are models of difmap
with the date in the name; .fits have CLEAN components in an AIPS CC table.
"""


HELP = "make images of lists of Gaussian or CLEAN components"
DESCRIPTION = """\
Make images of lists of components, all with one beam: one FITS file per epoch."""


def add_arguments(parser):
    """Add the arguments of the command."""
    parser.add_argument(
        "tables",
        metavar="TABLE.ecsv|MODEL.mod",
        nargs="+",
        help="a table of many epochs, or one file per epoch",
    )
    add_output(parser, "the images")
    parser.add_argument(
        "--beam",
        metavar='"1.0 mas 0.5 mas -7 deg"',
        required=True,
        help="major axis, minor axis (full widths at half maximum) and position angle; "
        "one axis is a circle",
    )
    parser.add_argument(
        "--pixel", metavar='"0.1 mas"', required=True, help="side of a pixel"
    )
    parser.add_argument(
        "--noise",
        metavar='"0.3 mJy/beam"',
        help="rms of the noise to add, correlated by the beam; default none",
    )
    for name in ("seed", "after", "before"):
        add_setting(parser, name)
    parser.add_argument(
        "--source",
        metavar="NAME",
        help="source to take from a table of many; a wrong or missing one is refused "
        "with the names that there are",
    )
    parser.add_argument(
        "--origin",
        choices=("core", "map"),
        help="what is at the reference pixel, the core (feature 0) or the centre of "
        "the map; default the core in tables that refer to it",
    )


def run(args, reporter):
    """Restore, as the arguments say."""
    import astropy.units as u

    from astro_scc.epochs import read_components, restore, write_epochs
    from astro_scc.measurement import product_folder

    beam = _beam(args.beam)
    pixel = _quantity("--pixel", args.pixel, "0.1 mas")
    noise = args.noise
    if noise is not None:
        noise = _quantity("--noise", noise, "0.3 mJy/beam")
    dates = {name: option_of(args, name) for name in ("after", "before")}
    dates = {name: to_time(text) for name, text in dates.items() if text is not None}
    seed = option_of(args, "seed")
    seed = draw_seed() if seed is None else seed
    folder = Path(args.output)
    with product_folder(folder, overwrite=args.overwrite) as part:
        components = read_components(
            args.tables, source=args.source, origin=args.origin
        )
        cube = restore(
            components.select(**dates),
            beam=beam,
            pixel_scale=pixel,
            noise=noise,
            rng=seed,
        )
        if noise is not None:
            cube = cube.with_step(f"noise of {noise} with the seed {seed}")
        paths = write_epochs(cube, part)
    first, last = cube.times.isot[[0, -1]]
    ny, nx = cube.shape[1:]
    drawn = "" if noise is None else f" (seed of the noise {seed})"
    reporter.say(
        f"{len(paths)} epochs, {first[:10]} to {last[:10]}, {nx} x {ny} pixels of "
        f"{pixel.to(u.mas):.4g}, beam {beam}, in {folder}{drawn}; next:\n"
        f"  astro-scc measure {folder}/*.fits -o {folder}-measured"
    )


def _quantity(option, text, example):
    """Return a positive quantity of the kind of an example."""
    return named(option, one_quantity, text, "one number", example)


def _beam(text):
    """Return a beam from one axis, two axes, or two axes and a position angle."""
    import astropy.units as u

    from astro_scc.epochs import Beam

    try:
        major, *rest = parse_quantities(text)
        if len(rest) > 2:
            raise ValueError("has too many numbers")
        return Beam(major, *rest) if rest else Beam(major, major)
    except (ValueError, u.UnitConversionError) as error:
        raise ValueError(
            f"--beam {text!r}: {error}; give major axis, minor axis and position "
            "angle, such as '1.0 mas 0.5 mas -7 deg'"
        ) from None
