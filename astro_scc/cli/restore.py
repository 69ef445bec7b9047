# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Make images from lists of Gaussian or CLEAN components.

Make images from lists of components, all with one beam: one FITS file per epoch.

examples:
  astro-scc restore 1226+023.ecsv -o 3c273 --beam "1.0 mas 0.5 mas -7 deg" \\
      --pixel "0.1 mas" --noise "0.3 mJy/beam" --seed 1 --before 2011-01-01
  astro-scc restore apjac230ft4_mrt.txt --source 1226+023 -o 3c273 --beam "1 mas" \\
      --pixel "0.1 mas"
  astro-scc restore models/*.mod -o images --beam "0.9 0.6 mas -5 deg" \\
      --pixel "0.1 mas"

Tables are ECSV files or the machine-readable tables of journals, from the AAS (.txt)
or the CDS (.dat, with its ReadMe beside it), with the columns epoch (or Obs.Y, Obs.M,
Obs.D), flux, separation and position_angle.  Files .mod are models of difmap with the
date in the name; files .fits have CLEAN components in an AIPS CC table.
"""

from pathlib import Path

from astro_scc.cli.arguments import add_option, add_output, add_setting
from astro_scc.cli.inputs import draw_seed
from astro_scc.quantities import named, one_quantity, parse_quantities, to_time
from astro_scc.settings import check_setting


def add_arguments(parser):
    """Add the arguments of the command."""
    text = "a table of many epochs, or one file per epoch"
    add_option(parser, "tables", "TABLE.ecsv|MODEL.mod", text, nargs="+")
    add_output(parser, "the images")
    text = (
        "major axis, minor axis (full widths at half maximum) and position angle; "
        "one axis is a circle"
    )
    add_option(parser, "--beam", '"1.0 mas 0.5 mas -7 deg"', text, required=True)
    add_option(parser, "--pixel", '"0.1 mas"', "side of a pixel", required=True)
    text = "rms of the noise to add, correlated by the beam; default none"
    add_option(parser, "--noise", '"0.3 mJy/beam"', text)
    for name in ("seed", "after", "before"):
        add_setting(parser, name)
    text = (
        "source to take from a table of many; a wrong or missing one is refused with "
        "the names that there are"
    )
    add_option(parser, "--source", "NAME", text)
    text = (
        "what is at the reference pixel, the core (feature 0) or the centre of the "
        "map; default the core in tables that refer to it"
    )
    parser.add_argument("--origin", choices=("core", "map"), help=text)


def run(args, reporter):
    """Restore images according to the arguments."""
    import astropy.units as u

    from astro_scc.epochs import read_components, restore, write_epochs
    from astro_scc.measurement import product_folder

    beam = _beam(args.beam)
    pixel = named("--pixel", one_quantity, args.pixel, "one number", "0.1 mas")
    if (noise := args.noise) is not None:
        noise = named("--noise", one_quantity, noise, "one number", "0.3 mJy/beam")
    given = {"after": args.after, "before": args.before}
    dates = {k: check_setting(k, v) and to_time(v) for k, v in given.items()}
    seed = draw_seed(check_setting("seed", args.seed))
    folder = Path(args.output)
    with product_folder(folder, overwrite=args.overwrite) as part:
        found = read_components(args.tables, source=args.source, origin=args.origin)
        own = found.select(**dates)
        cube = restore(own, beam=beam, pixel_scale=pixel, noise=noise, rng=seed)
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


def _beam(text):
    """Return a beam from one axis, two axes, or two axes and a position angle."""
    import astropy.units as u

    from astro_scc.epochs import Beam

    try:
        major, *rest = parse_quantities(text)
        if len(rest) > 2:
            raise ValueError("has too many numbers")
        if len(rest) == 1 and rest[0] != major:
            raise ValueError("has no position angle")
        return Beam(major, *rest) if rest else Beam(major, major)
    except (ValueError, u.UnitConversionError) as error:
        raise ValueError(
            f"--beam {text!r}: {error}; give major axis, minor axis and position "
            "angle, such as '1.0 mas 0.5 mas -7 deg'"
        ) from None
