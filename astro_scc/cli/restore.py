# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Make images from lists of Gaussian or CLEAN components."""

from pathlib import Path

import astropy.units as u

from astro_scc.cli.inputs import draw_seed
from astro_scc.epochs import Beam, read_components, restore, write_epochs
from astro_scc.measurement import product_folder
from astro_scc.quantities import named, one_quantity, parse_quantities, to_time
from astro_scc.settings import check_setting


def run(args, reporter):
    """Restore images according to the arguments."""
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
