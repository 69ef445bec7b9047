# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Make images from lists of Gaussian or CLEAN components."""

from pathlib import Path

import astropy.units as u

from astro_scc.cli.inputs import draw_seed
from astro_scc.epochs import read_components, restore, write_epochs
from astro_scc.epochs.beam import parse_beam
from astro_scc.epochs.restoring import NO_BEAM
from astro_scc.measurement import product_folder
from astro_scc.quantities import named, one_quantity, to_time
from astro_scc.settings import check_setting


def run(args, reporter):
    """Restore images according to the arguments."""
    beam = check_setting("beam", args.beam)
    pixel = named("--pixel", one_quantity, args.pixel, "one number", "0.1 mas")
    if (noise := args.noise) is not None:
        noise = named("--noise", one_quantity, noise, "one number", "0.3 mJy/beam")
    given = {"after": args.after, "before": args.before}
    dates = {k: check_setting(k, v) and to_time(v) for k, v in given.items()}
    seed = draw_seed(check_setting("seed", args.seed))
    folder = Path(args.output)
    with product_folder(folder, overwrite=args.overwrite) as part:
        options = {"source": args.source, "origin": args.origin}
        options["beams"] = None if beam is None else parse_beam(beam)
        own = read_components(args.tables, **options).select(**dates)
        if not own.beams:
            raise ValueError(f"{args.tables[0]}: {NO_BEAM}")
        options = {"pixel_scale": pixel, "noise": noise, "rng": seed}
        cube = restore(own, beam=own.beams, **options)
        if noise is not None:
            cube = cube.with_step(f"noise of {noise} with the seed {seed}")
        paths = write_epochs(cube, part)
    first, last = cube.times.isot[[0, -1]]
    ny, nx = cube.shape[1:]
    beam = own.beams[0]
    drawn = "" if noise is None else f" (seed of the noise {seed})"
    reporter.say(
        f"{len(paths)} epochs, {first[:10]} to {last[:10]}, {nx} x {ny} pixels of "
        f"{pixel.to(u.mas):.4g}, beam {beam}, in {folder}{drawn}; next:\n"
        f"  astro-scc measure {folder}/*.fits -o {folder}-measured"
    )
