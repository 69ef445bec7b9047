# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Make images from lists of Gaussian or CLEAN components."""

from pathlib import Path

import astropy.units as u

from astro_scc.cli.inputs import draw_seed
from astro_scc.components.restoring import NO_BEAM
from astro_scc.epochs import read_components, restore, write_epochs
from astro_scc.images.beam import parse_beam
from astro_scc.measurement.products import product_folder
from astro_scc.quantities import named, one_quantity, to_time
from astro_scc.settings import check_setting


def run(args, reporter):
    """Restore images according to the arguments."""
    how = images_of(args)
    folder, pixel, noise = Path(args.output), how["pixel_scale"], how["noise"]
    found = read_components(
        args.tables, source=args.source, origin=args.origin, beams=how["beam"]
    )
    if not found.beams:
        raise ValueError(f"{args.tables[0]}: {NO_BEAM}")
    cube = write_images(found, folder, how, overwrite=args.overwrite)
    first, last = cube.times.isot[[0, -1]]
    ny, nx = cube.shape[1:]
    drawn = "" if noise is None else f" (seed of the noise {how['seed']})"
    reporter.say(
        f"{len(cube)} epochs, {first[:10]} to {last[:10]}, {nx} x {ny} pixels of "
        f"{pixel.to(u.mas):.4g}, beam {found.beams[0]}, in {folder}{drawn}; next:\n"
        f"  astro-scc measure {folder}/*.fits -o {folder}-measured"
    )


def images_of(args):
    """Return how images are restored, from the arguments."""
    beam = check_setting("beam", args.beam)
    if (pixel := args.pixel) is not None:
        pixel = named("--pixel", one_quantity, pixel, "one number", "0.1 mas")
    if (noise := args.noise) is not None:
        noise = named("--noise", one_quantity, noise, "one number", "0.3 mJy/beam")
    given = {"after": args.after, "before": args.before}
    dates = {k: check_setting(k, v) and to_time(v) for k, v in given.items()}
    seed = draw_seed(check_setting("seed", args.seed))
    beam = None if beam is None else parse_beam(beam)
    return {"beam": beam, "pixel_scale": pixel, "noise": noise, "seed": seed} | dates


def write_images(components, folder, how, *, overwrite=False):
    """
    Restore the images of components into a folder, and return them.

    Parameters
    ----------
    components : `~astro_scc.epochs.ComponentList`
    folder : path
    how : dict
        See `images_of`.
    overwrite : bool, optional

    Returns
    -------
    `~astro_scc.EpochCube`
    """
    pixel, noise, seed = (how[k] for k in ("pixel_scale", "noise", "seed"))
    with product_folder(folder, overwrite=overwrite) as part:
        own = components.select(after=how["after"], before=how["before"])
        cube = restore(own, beam=own.beams, pixel_scale=pixel, noise=noise, rng=seed)
        if noise is not None:
            cube = cube.with_step(f"noise of {noise} with the seed {seed}")
        write_epochs(cube, part)
    return cube
