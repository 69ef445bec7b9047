# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The commands that make images: simulate and restore."""

import re
from pathlib import Path

import astropy.units as u

from astro_scc import simulation
from astro_scc.cli.arguments import FLOW, option_name
from astro_scc.cli.inputs import draw_seed
from astro_scc.components.restoring import NO_BEAM
from astro_scc.epochs import read_components, write_epochs
from astro_scc.epochs import restore as restored
from astro_scc.images.beam import parse_beam
from astro_scc.products.folder import product_folder
from astro_scc.quantities import named, one_quantity, to_time
from astro_scc.settings import check_setting
from astro_scc.simulation import write_simulation

#: Names of options in `~astro_scc.simulation.simulate_jet`.
PARAMETERS = {"motion": "speed", "features": "n_features", "epochs": "n_epochs"}


def simulate(args, reporter):
    """Simulate a jet whose velocities are known according to the arguments."""
    if args.epochs is not None and args.epochs < 1:
        raise ValueError(f"--epochs must be at least 1, got {args.epochs}")
    given = {}
    for name in (*FLOW, "dense", "epochs"):
        value = getattr(args, name)
        if value is None or value is False:
            continue
        whose = {"dense": "two-fluid", "epochs": args.jet}.get(name, "jet")
        if args.jet != whose:
            raise ValueError(f"{option_name(name)} is for {whose}, not for {args.jet}")
        given[PARAMETERS.get(name, name)] = value
    seed = draw_seed(check_setting("seed", args.seed))
    with product_folder(args.output, overwrite=args.overwrite) as part:
        try:
            make = getattr(simulation, f"simulate_{args.jet.replace('-', '_')}")
            jet = make(rng=seed, **given)
        except ValueError as error:
            raise ValueError(_of_option(str(error))) from None
        jet.truth.meta["seed"] = seed
        *images, _ = write_simulation(jet, part)
    _say(reporter, args, len(images), " and truth.ecsv", f" (seed {seed})")


def _say(reporter, args, n_epochs, what, more):
    """Say what has been written, and how it is measured."""
    folder, epochs = Path(args.output), "epoch" if n_epochs == 1 else "epochs"
    said = f"{n_epochs} {epochs}{what} in {folder}{more}"
    if n_epochs > 1:
        said += f"; next:\n  astro-scc measure {folder}/*.fits -o {folder}-measured"
    reporter.say(said)


def _of_option(message):
    """Return a message on a parameter of a jet with the option that sets it."""
    found = re.fullmatch(r"(?:flow '(\w+)': )?(\w+)(.*)", message)
    flow, name, text = found.groups() if found else (None, "", "")
    options = {parameter: option for option, parameter in PARAMETERS.items()}
    name = "standing" if flow == "standing" else options.get(name, name)
    return f"{option_name(name)}{text}" if name in FLOW else message


def restore(args, reporter):
    """Make images from lists of components according to the arguments."""
    if args.source and "," in args.source:
        raise ValueError("--source: restore takes one source, survey takes several")
    how = images_of(args)
    found = read_components(
        args.tables, source=args.source, origin=args.origin, beams=how["beam"]
    )
    if not found.beams:
        raise ValueError(f"{args.tables[0]}: {NO_BEAM}")
    cube = write_images(found, args.output, how, overwrite=args.overwrite)
    first, last = cube.times.isot[[0, -1]]
    ny, nx = cube.shape[1:]
    what = (
        f", {first[:10]} to {last[:10]}, {nx} x {ny} pixels of "
        f"{how['pixel_scale'].to(u.mas):.4g}, beam {found.beams[0]},"
    )
    drawn = "" if how["noise"] is None else f" (seed of the noise {how['seed']})"
    _say(reporter, args, len(cube), what, drawn)


def images_of(args):
    """Return how images are restored, from the arguments."""
    beam = check_setting("beam", args.beam)
    how = {"beam": None if beam is None else parse_beam(beam)}
    for name, key, example in (
        ("pixel", "pixel_scale", "0.1 mas"), ("noise", "noise", "0.3 mJy/beam")
    ):  # fmt: skip
        value, kind = getattr(args, name), ("one number", example)
        if value is not None:
            value = named(option_name(name), one_quantity, value, *kind)
        how[key] = value
    for name in ("after", "before"):
        value = getattr(args, name)
        how[name] = check_setting(name, value) and to_time(value)
    return how | {"seed": draw_seed(check_setting("seed", args.seed))}


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
        cube = restored(own, beam=own.beams, pixel_scale=pixel, noise=noise, rng=seed)
        if noise is not None:
            cube = cube.with_step(f"noise of {noise} with the seed {seed}")
        write_epochs(cube, part)
    return cube
