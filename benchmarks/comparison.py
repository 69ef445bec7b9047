# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Compare the speeds that several packages for motion in images find in simulated jets.

    python benchmarks/comparison.py [--seeds 8] [--choose]

The packages are those of ``comparison-requirements.txt``; a package that is not
installed gets a row that says so.  ``--choose`` measures other jets with all settings
that were tried; the table uses the best settings of each package.
"""

import argparse
import itertools
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np
from common import RESULTS, measured, print_table, write_table
from comparison_packages import PACKAGES
from comparison_reading import GRID, Sample, densities, read_speeds
from matplotlib.figure import Figure

from astro_scc.epochs import Beam, EpochCube
from astro_scc.epochs.restoring import add_gaussians, correlated_noise
from astro_scc.images.beam import FWHM_TO_SIGMA
from astro_scc.simulation import (
    JetSimulation,
    Stream,
    simulate_random_velocity,
    simulate_two_fluid,
)

VALUES_HEADER = ["what moves", "package", "speeds found", "values (px/epoch)", "others",
                 "all right", "CPU s a jet"]  # fmt: skip
PACKAGES_HEADER = ["package", "version", "licence", "what it was told"]
CHOICE_HEADER = ["package", "settings", "all right", "true speeds found", "others"]
#: Largest distance of a speed found from the true speed it belongs to, in pixels/epoch.
NEAR = 3.0
#: The earlier epoch of the pair that is drawn.
PAIR_DRAWN = 4
BLUE, ORANGE = "#0072B2", "#E69F00"
SEEDS_TO_CHOOSE = range(101, 104)
SHAPE, BEAM, NOISE, N_EPOCHS = (128, 256), 10.0, 0.002, 10
DATES = JetSimulation([Stream("none", half_width=1.0)]).dates


# -- simulated images --------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """
    Images of one kind, and the speeds in them.

    A speed is right if it is within ``right`` of a true one.
    """

    name: str
    simulate: Callable
    truth: tuple
    right: float = 1.0

    @property
    def digits(self):
        """Number of decimals to print of a speed."""
        return 1 if self.right >= 1 else 2


def one_stream(seed):
    """Simulate the slow stream of the paper's jet alone."""
    slow = Stream("slow", dx=5.0, density=1.0, half_width=15.0, jitter=2.0)
    return JetSimulation([slow], name="one stream").run(rng=seed).cube


def knots(seed):
    """Simulate three features with different speeds that never meet."""
    rng = np.random.default_rng(seed)
    time = np.arange(N_EPOCHS)[:, None]
    start = np.array([25.0, 55.0, 105.0]) + rng.uniform(-5, 5, 3)
    x = start + np.array(KNOTS) * time + rng.normal(0, 0.3, (N_EPOCHS, 3))
    y = 64 + rng.uniform(-4, 4, 3) + rng.normal(0, 0.3, (N_EPOCHS, 3))
    return images_of(x, y, rng)


def shifted(seed):
    """Simulate an image that moves as a whole."""
    rng = np.random.default_rng(seed)
    time = np.arange(N_EPOCHS)[:, None]
    x = rng.uniform(30, 200, 18) + SHIFT[0] * time
    y = rng.uniform(50, 78, 18) + SHIFT[1] * time
    return images_of(x, y, rng)


def images_of(x, y, rng):
    """Make epochs with noise of features at positions, shape (n_epochs, n)."""
    n = x.shape[1]
    peak, fwhm = rng.uniform(0.3, 1.5, n), rng.uniform(2, 6, n)
    variance = FWHM_TO_SIGMA**2 * (BEAM**2 + fwhm**2)
    covariance = variance[:, None, None] * np.eye(2)
    scale, beam = 0.1 * u.mas, Beam(1 * u.mas, 1 * u.mas)
    data = np.array([add_gaussians(np.zeros(SHAPE), *at, peak, covariance)
                     for at in zip(x, y, strict=True)])  # fmt: skip
    data += [correlated_noise(SHAPE, rms=NOISE, beam=beam, pixel_scale=scale, rng=rng)
             for _ in data]  # fmt: skip
    return EpochCube.from_arrays(
        data, DATES, pixel_scale=scale, unit=u.Jy / u.beam, beams=[beam] * len(data),
        noise=np.full(len(data), NOISE) * u.Jy / u.beam,
    )  # fmt: skip


KNOTS = (2.0, 7.0, 12.0)
SHIFT = (2.3, -0.7)
CASES = (
    Case("two streams", lambda seed: simulate_two_fluid(rng=seed).cube, (5.0, 20.0)),
    Case("one stream", one_stream, (5.0,)),
    Case("no common speed", lambda seed: simulate_random_velocity(rng=seed).cube, ()),
    Case("three knots", knots, KNOTS),
    Case("the whole image", shifted, SHIFT[:1], right=0.1),
)


# -- results -----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a package found in one jet."""

    case: Case
    speeds: np.ndarray
    seconds: float
    sample: Sample | None = None
    error: str = ""

    @cached_property
    def near(self):
        """The speed found for each true one; each is used only once."""
        left, near = list(self.speeds), {}
        truth = self.case.truth
        for distance, v, true in sorted(
            (abs(v - t), v, t) for v in left for t in truth
        ):
            if distance <= NEAR and true not in near and v in left:
                near[true] = v
                left.remove(v)
        return near

    @property
    def right(self):
        """The true speeds that were found."""
        return [t for t, v in self.near.items() if abs(v - t) <= self.case.right]

    @property
    def others(self):
        """Number of speeds found that are not true."""
        return len(self.speeds) - len(self.right)

    @property
    def all_right(self):
        """Whether all true speeds were found, and no others."""
        complete = len(self.right) == len(self.case.truth)
        return complete and not self.others and not self.error


def ask(package, case, cube, settings):
    """Measure one jet with one package."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        start = time.process_time()
        try:
            speeds, sample = package.run(cube, **settings)
        except Exception as error:  # whatever another package raises is its answer
            message = f"{type(error).__name__}: {error}".splitlines()[0]
            seconds = time.process_time() - start
            return Outcome(case, np.empty(0), seconds, error=message)
        seconds = time.process_time() - start
    return Outcome(
        case, read_speeds(sample) if speeds is None else speeds, seconds, sample
    )


def row_of(case, package, outcomes):
    """Return the table row of what a package found in all jets of a kind."""
    values = []
    for true in case.truth:
        own = [o.near[true] for o in outcomes if true in o.near]
        n = sum(true in o.right for o in outcomes)
        text = measured(np.mean(own), np.std(own), case.digits) if own else "none"
        values.append(f"{true:g}: {text} ({n})")
    failed = [o.error for o in outcomes if o.error]
    if failed:
        values.append(f"failed in {len(failed)}: {failed[0]}")
    return [
        case.name,
        package.name,
        f"{np.mean([len(o.speeds) for o in outcomes]):.1f}",
        "; ".join(values),
        f"{np.mean([o.others for o in outcomes]):.1f}",
        share(outcomes),
        f"{np.mean([o.seconds for o in outcomes]):.2f}",
    ]


def share(outcomes):
    """Return in how many jets the answer is right, as text."""
    return f"{sum(o.all_right for o in outcomes)}/{len(outcomes)}"


def compare(n_seeds):
    """Return the outcomes of all packages in all jets, by kind of jet and package."""
    found = {}
    RESULTS.mkdir(exist_ok=True)
    for case in CASES:
        cubes = [case.simulate(seed) for seed in range(1, n_seeds + 1)]
        for package in PACKAGES:
            if package.why_not or (package.cases and case.name not in package.cases):
                continue
            if not any(name == package.name for _, name in found):
                # The first call imports the package, which must not be timed.
                ask(package, case, cubes[0][:3], package.settings)
            outcomes = [ask(package, case, c, package.settings) for c in cubes]
            found[case.name, package.name] = outcomes
            print(*row_of(case, package, outcomes), sep="  ", flush=True)
        if case is CASES[0]:
            figure = draw(cubes[0], case, found)
            figure.savefig(RESULTS / "comparison.png", dpi=100)
    print()
    return found


def report(found):
    """Write the tables."""
    rows, values, about = [], [], []
    for package in PACKAGES:
        name, why_not = package.name, package.why_not
        kinds = [found.get((case.name, name), []) for case in CASES]
        every = [o.seconds for outcomes in kinds for o in outcomes]
        shares = [share(outcomes) if outcomes else "" for outcomes in kinds]
        seconds = f"{np.mean(every):.2f}" if every else ""
        rows.append([name, *shares, seconds, why_not])
        settings = text_of(package.settings) or package.about
        about.append([name, package.version or "", package.license, settings])
    for case in CASES:
        values += [row_of(case, package, found[case.name, package.name])
                   for package in PACKAGES
                   if (case.name, package.name) in found]  # fmt: skip
    kinds = [case.name for case in CASES]
    write_table("comparison", ["package", *kinds, "CPU s a jet", "why not"], rows)
    print_table(VALUES_HEADER, values)
    write_table("comparison_packages", PACKAGES_HEADER, about)


def draw(cube, case, found):
    """Draw the vectors of all packages in one jet, and the density of their speeds."""
    names = [name for kind, name in found if kind == case.name]
    outcomes = [found[case.name, name][0] for name in names]
    figure = Figure(figsize=(7.2, 1.2 * len(names) + 0.6), layout="constrained")
    axes = figure.subplots(
        len(names), 2, sharex="col", squeeze=False, width_ratios=(2, 1)
    )
    scale = cube.pixel_scale.to_value(u.mas)
    ny, nx = cube.shape[1:]
    corners = cube.pixel_to_offset([-0.5, nx - 0.5], [-0.5, ny - 0.5])
    (left, right), (bottom, top) = (c.to_value(u.mas) for c in corners)
    for (sky, speed), name, outcome in zip(axes, names, outcomes, strict=True):
        sky.imshow(
            np.arcsinh(cube.data[PAIR_DRAWN] / 0.05), origin="lower", cmap="Greys",
            extent=(left, right, bottom, top), vmin=0, vmax=9, aspect="equal",
        )  # fmt: skip
        sky.set(ylim=(-3.2, 3.2), yticks=(-2, 0, 2))
        sky.set_title(name, fontsize="medium", loc="left", pad=3)
        speed.set(yticks=(), ylim=(0, 1.3), xlim=(-20, 30))
        for true in case.truth:
            speed.axvline(true, color=ORANGE, lw=1.2, ls="--")
        speed.plot(outcome.speeds, np.full(len(outcome.speeds), 1.15), "v", color=BLUE)
        sample = outcome.sample and outcome.sample.within_limits()
        if not sample or len(sample.pair) == 0:
            continue
        density = densities(sample).sum(axis=0)
        speed.fill_between(GRID, density / density.max(), color="0.75", lw=0)
        now = sample.pair == PAIR_DRAWN
        east, north = cube.pixel_to_offset(sample.x[now], sample.y[now])
        sky.quiver(
            east.to_value(u.mas), north.to_value(u.mas),
            -scale * sample.along[now], scale * sample.across[now],
            angles="xy", scale_units="xy", scale=1, color=BLUE, width=0.003,
        )  # fmt: skip
    axes[-1, 0].set_xlabel("offset to the east (mas)")
    axes[-1, 1].set_xlabel("speed along the jet (px/epoch)")
    figure.supylabel("offset to the north (mas)", fontsize="medium")
    return figure


def choose():
    """Try all settings of all packages on jets of other seeds."""
    jets = [(case, case.simulate(seed)) for case in CASES for seed in SEEDS_TO_CHOOSE]
    rows = []
    for package in PACKAGES:
        if not package.settings or package.why_not:
            continue
        values = [(v, *package.others.get(k, ())) for k, v in package.settings.items()]
        tried = []
        for chosen in itertools.product(*values):
            settings = dict(zip(package.settings, chosen, strict=True))
            found = [ask(package, case, cube, settings) for case, cube in jets]
            tried.append(
                (
                    sum(o.all_right for o in found),
                    sum(len(o.right) for o in found),
                    sum(o.others for o in found),
                    settings,
                )
            )
        tried.sort(key=lambda row: (-row[0], row[2] - row[1]))
        n_true = sum(len(case.truth) for case, _ in jets)
        rows += [
            [package.name, text_of(s), f"{n}/{len(jets)}", f"{right}/{n_true}", others]
            for n, right, others, s in tried
        ]
        print(*rows[-len(tried)], sep="  ", flush=True)
    print()
    print_table(CHOICE_HEADER, rows)


def text_of(settings):
    """Return settings as text for a cell of a table."""
    return ", ".join(f"{k} {v}" for k, v in settings.items())


def main():
    """Print the tables, draw the figure and write them to ``results``."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("--seeds", type=int, default=8, help="jets of each kind")
    parser.add_argument("--choose", action="store_true", help="try all settings")
    args = parser.parse_args()
    if args.choose:
        choose()
        return
    report(compare(args.seeds))


if __name__ == "__main__":
    main()
