# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure errors of rates and centres of simulated shells, and the least possible errors.

    python benchmarks/shells.py
"""

import argparse

import astropy.units as u
import numpy as np
from common import RESULTS, measured, print_table, write_table
from compact import remove_compact

from astro_scc import StackedCrossCorrelation
from astro_scc.expansion import fit_shell
from astro_scc.simulation import simulate_shell

RATE = u.percent / u.yr
#: Full width at half maximum of the largest knots.
COMPACT = 5 * u.arcsec
#: Mean width of the knots, and the resolution of scale 1, in arcsec.
BEAM = 4.0
#: Added to the seed, as the fit was developed with smaller seeds.
FIRST = 200
#: Number of shells for which the bound is calculated.
N_BOUNDS = 4
FWHM_TO_SIGMA = 1 / np.sqrt(8 * np.log(2))


def settings(*scales):
    """Return the measurement of a shell."""
    return StackedCrossCorrelation(
        scales=scales, max_speed=200 * u.mas / u.yr, baseline=[4, 26] * u.yr,
        min_error_beams=0.1, detection=7, segmentation=5,
    )  # fmt: skip


def main():
    """Measure the shells, write the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument("--n-shells", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    two_rates(parser.parse_args())


def two_rates(args):
    """Measure the rates and centres of simulated shells, one per seed."""
    true = np.array([0.11, 0.07])
    true = true / (1 + 12.5 * true / 100)
    rows, off, errors, leaked = [], [], [], []
    start = FIRST + args.seed
    for seed in range(start, start + args.n_shells):
        shell = simulate_shell(rng=seed)
        fine, blended, coarse = settings(1.5), settings(2), settings(4)
        smooth = remove_compact(shell.cube, COMPACT)
        matched = {
            "knots": fine.match(shell.cube),
            "ring": coarse.match(smooth),
            # These patterns blend both rates, but they share the centre.
            "knots on clumps": blended.match(shell.cube),
        }
        fit = fit_shell(fine, matched)
        rate, error = fit.rate[:2].to_value(RATE), fit.rate_err[:2].to_value(RATE)
        away = (fit.centre - shell.centre).to_value(u.arcsec)
        scatter = fit.centre_err.to_value(u.arcsec)
        off.append([*(rate - true), *away])
        errors.append([*error, *scatter])
        as_it_is = fit_shell(coarse, coarse.match(shell.cube), centre=fit.centre)
        leaked.append([
            as_it_is.rate[0].to_value(RATE) - true[1],
            as_it_is.rate_err[0].to_value(RATE),
        ])  # fmt: skip
        rows.append([
            seed, *(measured(*pair, 4) for pair in zip(rate, error, strict=True)),
            *(measured(*pair) for pair in zip(away, scatter, strict=True)),
            f"{np.hypot(*away) / BEAM:.2f}",
        ])  # fmt: skip
        print(*rows[-1], flush=True)
    print(f"Put in, at the mean date: {true[0]:.4f} and {true[1]:.4f} %/yr")
    header = ["seed", "knots (%/yr)", "ring (%/yr)", "centre off, east (arcsec)",
              "north", "off / 4 arcsec"]  # fmt: skip
    print_table(header, rows)
    bounds = [bound(seed) for seed in range(start, start + N_BOUNDS)]
    summary(np.array(off), np.array(errors), np.array(leaked), np.mean(bounds, axis=0))
    draw(start, np.array(off) + [*true, 0, 0], np.array(errors), true)


def summary(off, errors, leaked, least):
    """Write the deviations in units of the errors, and those of centres in beams."""
    columns = [
        ("knots (%/yr)", off[:, 0], errors[:, 0], least[0], 5),
        ("ring (%/yr)", off[:, 1], errors[:, 1], least[1], 5),
        ("ring, knots not removed", leaked[:, 0], leaked[:, 1], least[1], 5),
        ("centre, east (arcsec)", off[:, 2], errors[:, 2], least[2], 2),
        ("centre, north", off[:, 3], errors[:, 3], least[2], 2),
    ]
    rows = []
    for name, d, e, b, digits in columns:
        pull = d / e
        rows.append([
            name, measured(d.mean(), d.std(ddof=1) / np.sqrt(len(d)), digits),
            f"{d.std(ddof=1):.{digits}f}", f"{np.median(e):.{digits}f}",
            f"{b:.{digits}f}", f"{pull.mean():+.2f}",
            f"{np.sqrt((pull**2).mean()):.2f}",
            f"{np.mean(np.abs(pull) <= 1):.2f}", f"{np.mean(np.abs(pull) <= 2):.2f}",
        ])  # fmt: skip
    header = ["quantity", "mean off", "scatter", "median error", "bound",
              "off / error, mean", "rms", "within 1", "within 2"]  # fmt: skip
    write_table("shell_summary", header, rows)
    away = np.hypot(off[:, 2], off[:, 3]) / BEAM
    best = least[2] / BEAM
    rows = [
        ["measured", f"{np.median(away):.3f}", f"{np.mean(away <= 0.1):.2f}"],
        ["at the bound", f"{best * np.sqrt(2 * np.log(2)):.3f}",
         f"{1 - np.exp(-(0.1**2) / (2 * best**2)):.2f}"],
    ]  # fmt: skip
    header = ["centre", "median distance (beams)", "share within 0.1 beams"]
    print_table(header, rows)


def bound(seed):
    """
    Return the least possible errors of the two rates and the centre (Cramer & Rao).

    They are those of a fit to the counts of all epochs, of all features at
    once, with their positions, maxima and widths unknown.
    """
    shell = simulate_shell(rng=seed)
    truth, cube = shell.truth, shell.cube
    years = cube.years.to_value(u.yr)
    knot = np.asarray(truth["group"]) == "knots"
    rate = truth["rate"].to_value(1 / u.yr)
    place = np.stack([truth[c].to_value(u.arcsec) for c in ("east", "north")])
    sigma = FWHM_TO_SIGMA * truth["fwhm"].to_value(u.arcsec)
    centre = shell.centre.to_value(u.arcsec)
    ny, nx = cube.shape[1:]
    n = len(truth)

    def bells(year):
        """Yield the offsets from each feature and its Gaussian, on nearby pixels."""
        x = (nx - 1) / 2 - (centre[0] + (1 + rate * year) * place[0])
        y = (ny - 1) / 2 + (centre[1] + (1 + rate * year) * place[1])
        for k in range(n):
            reach = int(5 * sigma[k]) + 2
            low = np.maximum([int(y[k]) - reach, int(x[k]) - reach], 0)
            near = np.s_[low[0] : int(y[k]) + reach, low[1] : int(x[k]) + reach]
            dy, dx = np.mgrid[:ny, :nx][(slice(None), *near)]
            dy, dx = dy - y[k], dx - x[k]
            yield near, dx, dy, np.exp(-0.5 * (dx**2 + dy**2) / sigma[k] ** 2)

    design = np.zeros((n + 1, ny, nx))
    design[n] = 1
    for k, (near, _, _, bell) in enumerate(bells(0)):
        design[k][near] = bell
    flat = design.reshape(n + 1, -1)
    peak = np.linalg.lstsq(flat @ flat.T, flat @ cube.data[0].ravel(), rcond=None)[0]
    information = np.zeros((4 + 4 * n,) * 2)
    for year in years:
        image, slopes = np.full((ny, nx), peak[n]), np.zeros((4 + 4 * n, ny, nx))
        for k, (near, dx, dy, bell) in enumerate(bells(year)):
            image[near] += peak[k] * bell
            east, north = (s * peak[k] * bell / sigma[k] ** 2 for s in (-dx, dy))
            grown, own = 1 + rate[k] * year, 4 + 4 * k
            slopes[0 if knot[k] else 1][near] += year * (
                east * place[0, k] + north * place[1, k]
            )
            slopes[2][near] += east
            slopes[3][near] += north
            slopes[own][near], slopes[own + 1][near] = grown * east, grown * north
            slopes[own + 2][near] = bell
            slopes[own + 3][near] = peak[k] * bell * (dx**2 + dy**2) / sigma[k] ** 3
        slopes = (slopes / np.sqrt(image)).reshape(len(slopes), -1)
        information += slopes @ slopes.T
    unit = 1 / np.sqrt(np.diag(information))
    outer = np.outer(unit, unit)
    variance = np.diag(outer * np.linalg.inv(information * outer))[:4]
    knots, ring, east, north = np.sqrt(variance)
    return 100 * knots, 100 * ring, np.sqrt(0.5 * (east**2 + north**2))


def draw(seed, found, errors, true):
    """Draw a shell, and the rates and centres that were measured."""
    from matplotlib.figure import Figure

    shell = simulate_shell(n_epochs=2, rng=seed)
    figure = Figure(figsize=(10, 3.7), layout="constrained")
    left, middle, right = figure.subplots(1, 3, width_ratios=[1.1, 1, 1])
    east, north = (o.to_value(u.arcsec) for o in shell.cube.offsets())
    box = east[0, 0] + 0.5, east[0, -1] - 0.5, north[0, 0] - 0.5, north[-1, 0] + 0.5
    left.imshow(np.sqrt(shell.cube.data[0]), extent=box, origin="lower", cmap="gray_r")
    left.plot(*shell.centre.to_value(u.arcsec), "+", color="#D55E00", ms=10, mew=2)
    left.set(xlabel="East (arcsec)", ylabel="North (arcsec)",
             title="First epoch, and the centre")  # fmt: skip
    place = np.arange(len(found)) + seed
    for column, color, label in ((0, "#0072B2", "knots"), (1, "#E69F00", "ring")):
        middle.axhline(true[column], color="0.6", lw=1, zorder=0)
        middle.errorbar(place, found[:, column], errors[:, column], fmt="o", ms=4,
                        color=color, label=label)  # fmt: skip
    middle.set(xlabel="Seed", ylabel="Rate (% / yr)", title="Rates", ylim=(0.06, 0.12))
    middle.legend(frameon=False, loc="center right")
    right.errorbar(found[:, 2], found[:, 3], errors[:, 3], errors[:, 2], fmt="o", ms=4,
                   color="#0072B2", elinewidth=0.6)  # fmt: skip
    turn = np.linspace(0, 2 * np.pi, 200)
    right.plot(0.1 * BEAM * np.cos(turn), 0.1 * BEAM * np.sin(turn), color="#D55E00",
               label="a tenth of 4 arcsec")  # fmt: skip
    right.set(xlim=(2, -2), ylim=(-2, 2), aspect="equal", title="Centres")
    right.set(xlabel="East of the centre (arcsec)", ylabel="North of it (arcsec)")
    right.legend(frameon=False, loc="upper left")
    figure.savefig(RESULTS / "shell.png", dpi=110)


if __name__ == "__main__":
    main()
