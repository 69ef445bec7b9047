# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Simulate images of a jet whose velocities are known."""

import re
from pathlib import Path

from astro_scc import simulation
from astro_scc.cli.arguments import FLOW, option_name
from astro_scc.cli.inputs import draw_seed
from astro_scc.measurement.products import product_folder
from astro_scc.settings import check_setting
from astro_scc.simulation import write_simulation

#: Names of options in `~astro_scc.simulation.simulate_jet`.
PARAMETERS = {"motion": "speed", "features": "n_features", "epochs": "n_epochs"}


def run(args, reporter):
    """Simulate a jet according to the arguments."""
    if args.epochs is not None and args.epochs < 1:
        raise ValueError(f"--epochs must be at least 1, got {args.epochs}")
    given = {}
    for name in (*FLOW, "dense", "epochs"):
        if (value := getattr(args, name)) is None:
            continue
        whose = {"dense": "two-fluid", "epochs": args.jet}.get(name, "jet")
        if args.jet != whose:
            raise ValueError(f"{option_name(name)} is for {whose}, not for {args.jet}")
        given[PARAMETERS.get(name, name)] = value
    seed = draw_seed(check_setting("seed", args.seed))
    folder = Path(args.output)
    with product_folder(folder, overwrite=args.overwrite) as part:
        try:
            make = getattr(simulation, f"simulate_{args.jet.replace('-', '_')}")
            jet = make(rng=seed, **given)
        except ValueError as error:
            raise ValueError(_of_option(str(error))) from None
        jet.truth.meta["seed"] = seed
        *images, _ = write_simulation(jet, part)
    reporter.say(
        f"{len(images)} epochs and truth.ecsv in {folder} (seed {seed}); next:\n"
        f"  astro-scc measure {folder}/*.fits -o {folder}-measured"
    )


def _of_option(message):
    """Return a message on a parameter of a jet with the option that sets it."""
    found = re.fullmatch(r"(?:flow '(\w+)': )?(\w+)(.*)", message)
    flow, name, text = found.groups() if found else (None, "", "")
    options = {parameter: option for option, parameter in PARAMETERS.items()}
    name = "standing" if flow == "standing" else options.get(name, name)
    return f"{option_name(name)}{text}" if name in FLOW else message
