# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc simulate``: jets whose velocities are known."""

from pathlib import Path

from astro_scc.cli.arguments import add_overwrite
from astro_scc.cli.settings import draw_seed, parse_option

__all__ = ["add_parser", "run", "simulated"]

# Name -> the function of astro_scc.simulation, and what the jet is.
JETS = {
    "two-fluid": ("simulate_two_fluid", "a slow sheath around a fast spine"),
    "random-velocity": (
        "simulate_random_velocity",
        "a new random velocity for every feature at every epoch",
    ),
    "ballistic": ("simulate_ballistic", "features that each keep a random velocity"),
    "static": ("simulate_static", "features that stand still"),
    "unrelated": ("simulate_unrelated", "epochs that have nothing in common"),
}


def add_parser(commands):
    """Add the command to the program's parser."""
    width = max(map(len, JETS))
    parser = commands.add_parser(
        "simulate",
        help="make images of a jet whose velocities are known",
        description="Make the images of a jet whose velocities are known: one FITS "
        "file an\nepoch, and truth.ecsv with the position and the velocity of every "
        "feature.\n\njets:\n"
        + "\n".join(f"  {name:{width}}  {what}" for name, (_, what) in JETS.items()),
        epilog="example:\n  astro-scc simulate two-fluid jet --seed 1 --epochs 10",
    )
    parser.add_argument("jet", choices=JETS, metavar="JET", help="one of the above")
    parser.add_argument("output", metavar="DIR", help="folder for the images")
    add_overwrite(parser)
    parser.add_argument("--seed", metavar="N", help="drawn and printed by default")
    parser.add_argument(
        "--epochs",
        metavar="N",
        type=int,
        default=10,
        help="number of epochs, 30 days apart; default 10",
    )
    parser.add_argument(
        "--dense",
        action="store_true",
        help="more and brighter features in the two-fluid jet",
    )
    return parser


def simulated(jet, *, seed, n_epochs=10, **options):
    """
    A simulated jet whose truth knows its seed.

    Parameters
    ----------
    jet : str
        Its name on the command line.
    seed : int
    n_epochs : int, optional
    **options
        Of the function in `astro_scc.simulation`.

    Returns
    -------
    `~astro_scc.simulation.SimulatedJet`
    """
    from astro_scc import simulation

    made = getattr(simulation, JETS[jet][0])(rng=seed, n_epochs=n_epochs, **options)
    made.truth.meta["seed"] = seed
    return made


def run(args, reporter):
    """
    Simulate, as the arguments say.

    Parameters
    ----------
    args : `argparse.Namespace`
    reporter : `~astro_scc.cli.reporter.Reporter`
    """
    from astro_scc.measurement import product_folder
    from astro_scc.simulation import write_simulation

    if args.dense and args.jet != "two-fluid":
        raise ValueError(f"--dense is for the two-fluid jet, not for {args.jet}")
    if args.epochs < 1:
        raise ValueError(f"--epochs must be at least 1, got {args.epochs}")
    seed = draw_seed() if args.seed is None else parse_option("seed", args.seed)
    options = {"dense": True} if args.dense else {}
    folder = Path(args.output)
    with product_folder(folder, overwrite=args.overwrite) as part:
        jet = simulated(args.jet, seed=seed, n_epochs=args.epochs, **options)
        *images, _ = write_simulation(jet, part)
    reporter.say(
        f"{len(images)} epochs and truth.ecsv in {folder} (seed {seed}); next:\n"
        f"  astro-scc measure {folder}/*.fits -o {folder}-measured"
    )
