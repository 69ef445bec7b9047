# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc simulate``: jets whose velocities are known."""

from pathlib import Path

from astro_scc.cli.inputs import draw_seed, option_of
from astro_scc.cli.options import add_overwrite, add_setting

# Name -> the function of astro_scc.simulation, and what the jet is.
JETS = {
    "two-fluid": ("simulate_two_fluid", "a slow sheath around a fast spine"),
    "random-velocity": (
        "simulate_random_velocity",
        "a new random velocity for every feature at every epoch",
    ),
    "ballistic": ("simulate_ballistic", "features that each keep a random velocity"),
    "static": ("simulate_static", "stationary features"),
    "unrelated": ("simulate_unrelated", "epochs that have nothing in common"),
    "jet": (
        "simulate_jet",
        "as surveys see them: uneven dates, a core, features about a flow",
    ),
}
# Option -> the parameter of simulate_jet, its type and its help.
FLOW = {
    "--motion": ("speed", float, "mean, in beams per median interval; default 0.6"),
    "--dispersion": ("dispersion", float, "of the speeds, over the mean; default 0.1"),
    "--distribution": (
        "distribution",
        str,
        "of the speeds: normal (default), lognormal or uniform",
    ),
    "--features": ("n_features", float, "moving features in view at a time; default 8"),
    "--standing": ("standing", int, "number of stationary features; default 0"),
    "--acceleration": (
        "acceleration",
        float,
        "speed at the jet's end over that at the core; default 1",
    ),
    "--flux-variation": (
        "flux_variation",
        float,
        "scatter of ln(flux) in time; default 0.35",
    ),
    "--alignment-error": (
        "alignment_error",
        float,
        "shift of each image, rms in beams; default 0",
    ),
}


WIDTH = max(map(len, JETS))
HELP = "make images of a jet whose velocities are known"
DESCRIPTION = """\
Make the images of a jet whose velocities are known: one FITS file per
epoch, and truth.ecsv with the position and the velocity of every feature.

jets:
""" + "\n".join(f"  {name:{WIDTH}}  {what}" for name, (_, what) in JETS.items())
EPILOG = """\
examples:
  astro-scc simulate two-fluid jet --seed 1 --epochs 10
  astro-scc simulate jet jet --motion 0.4 --dispersion 0.2 --vlba"""


def add_arguments(parser):
    """Add the arguments of the command."""
    parser.add_argument("jet", choices=JETS, metavar="JET", help="one of the above")
    parser.add_argument("output", metavar="DIR", help="folder for the images")
    add_overwrite(parser)
    add_setting(parser, "seed")
    parser.add_argument(
        "--epochs",
        metavar="N",
        type=int,
        help="number of epochs; default 10, 30 days apart, and of a jet 15 at uneven "
        "dates, 0.2 years apart in the median",
    )
    parser.add_argument(
        "--dense",
        action="store_true",
        default=None,
        help="more and brighter features in the two-fluid jet",
    )
    group = parser.add_argument_group("options of the jet 'jet'")
    for option, (name, kind, text) in FLOW.items():
        group.add_argument(option, metavar="X", dest=name, type=kind, help=text)
    group.add_argument(
        "--vlba",
        action="store_true",
        default=None,
        help="image it from visibilities of the VLBA, with CLEAN",
    )


def simulated(jet, *, seed, **options):
    """Return a jet by its name on the command line; its truth knows its seed."""
    from astro_scc import simulation

    made = getattr(simulation, JETS[jet][0])(rng=seed, **options)
    made.truth.meta["seed"] = seed
    return made


def run(args, reporter):
    """Simulate, as the arguments say."""
    from astro_scc.measurement import product_folder
    from astro_scc.simulation import observe, write_simulation

    if args.epochs is not None and args.epochs < 1:
        raise ValueError(f"--epochs must be at least 1, got {args.epochs}")
    own = {name: (option, "jet") for option, (name, *_) in FLOW.items()}
    own |= {"vlba": ("--vlba", "jet"), "dense": ("--dense", "two-fluid")}
    given = {name: value for name in own if (value := getattr(args, name)) is not None}
    for option, whose in map(own.get, given):
        if args.jet != whose:
            raise ValueError(f"{option} is for {whose}, not for {args.jet}")
    vlba = given.pop("vlba", False)
    if args.epochs is not None:
        given["n_epochs"] = args.epochs
    seed = option_of(args, "seed")
    seed = draw_seed() if seed is None else seed
    folder = Path(args.output)
    with product_folder(folder, overwrite=args.overwrite) as part:
        jet = simulated(args.jet, seed=seed, **given)
        if vlba:
            jet = observe(jet, rng=seed)
        *images, _ = write_simulation(jet, part)
    reporter.say(
        f"{len(images)} epochs and truth.ecsv in {folder} (seed {seed}); next:\n"
        f"  astro-scc measure {folder}/*.fits -o {folder}-measured"
    )
