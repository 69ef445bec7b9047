# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Profiles, stratification, acceleration and shells: what must be shown.

3C 120 and 3C 273 as in Sect. 3 of Mertens & Lobanov (2016), M 87, a bent jet whose
speeds are known, and a shell with two rates of expansion::

    python benchmarks/profiles.py ../shared/data/mojave_xviii
    python benchmarks/profiles.py ../shared/data/mojave_xviii --only bent shell
"""

import argparse
from dataclasses import replace
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import Table
from common import PM_UNIT, RESULTS, measured, p_text, plain, write_table
from mojave import BEFORE, NOISE, PIXEL, SOURCES, images

from astro_scc import Beam, StackedCrossCorrelation
from astro_scc.epochs import read_components, restore
from astro_scc.kinematics import apparent_speed, find_ridge_line
from astro_scc.measurement import select_ssps
from astro_scc.profiles import (
    check_lags,
    fit_profile,
    lorentz_profile,
    measure_acceleration,
    measure_profile,
)
from astro_scc.shells import fit_shell
from astro_scc.simulation import simulate_shell
from astro_scc.stratification import (
    compare_positions,
    compare_speeds,
    scale_groups,
)
from astro_scc.tracking import track_profile

SOURCE = {source.name: source for source in SOURCES}
VIEWING_ANGLE = 15 * u.deg
#: Paper, Sect. 3.2, by the middle of the bin in mas.
PAPER_3C120 = {1: "4.0 ± 0.2", 7: "6.0 ± 0.4", 8: "slower", 9: "slower", 10: "slower"}
M87_DISTANCE = 16.7 * u.Mpc
M87_BEAM = Beam(1.2 * u.mas, 0.6 * u.mas, -5 * u.deg)


def main():
    """Run what was asked for."""
    everything = {
        "3c120": acceleration_of_3c120,
        "3c273": streams_of_3c273,
        "m87": limit_of_m87,
        "bent": bent_jet,
        "shell": two_rates,
    }
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("folder", type=Path, help="of the tables of features")
    parser.add_argument("--only", nargs="+", choices=everything, default=everything)
    parser.add_argument("--n-trials", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    for name in args.only:
        everything[name](args)


def settings(source):
    """How the paper's jets are measured."""
    return StackedCrossCorrelation(
        scales=(1, 2, 3, 4),
        max_speed=source.max_speed * PM_UNIT,
        position_angle=source.position_angle * u.deg,
        baseline=source.baseline * u.yr,
    )


def features_as_the_paper(folder, table, radii, *, before, half_width=2.0):
    """Mean speed of the survey's own features within 2 mas of each distance."""
    seen = Table.read(folder / f"{table}.ecsv", format="ascii.ecsv")
    use = (np.asarray(seen["epoch"], dtype=str) < before) & (seen["feature"] > 0)
    seen = seen[use]
    years = [_year(text) for text in seen["epoch"]]
    distance = np.asarray(seen["separation"], dtype=float)
    return track_profile(
        years, distance, np.full(len(seen), 0.1), np.asarray(seen["feature"]), radii,
        half_width=half_width,
    )  # fmt: skip


def _year(text):
    from astropy.time import Time

    return float(Time(str(text)).jyear)


def acceleration_of_3c120(args):
    """Speed against distance in 3C 120, ten bins."""
    source = SOURCE["3C 120"]
    k = source.per_c
    cube = images(source, args.folder, args.seed)
    scc = settings(source)
    matched = scc.match(cube)
    edges = np.arange(0.5, 11.0) * u.mas
    profile = measure_profile(
        scc, matched, edges, n_trials=args.n_trials, rng=args.seed
    )
    radii = np.arange(1.0, 11.0)
    speed, error, n = features_as_the_paper(
        args.folder, source.table, radii, before=BEFORE
    )
    main_rows = {round(float(r["r_mid"].value)): r for r in profile.main}
    rows = []
    for i, radius in enumerate(radii.astype(int)):
        row = main_rows.get(int(radius))
        ours = ["", "", "", ""]
        if row is not None:
            v, e = (plain(row[c], PM_UNIT) for c in ("pm_parallel", "pm_parallel_err"))
            ours = [measured(k * v, k * e, 1), p_text(row["p_global"]),
                    p_text(row["p_fdr"]), row["kind"]]  # fmt: skip
        rows.append([
            radius, *ours, f"{measured(k * speed[i], k * error[i], 1)} ({n[i]})",
            PAPER_3C120.get(int(radius), ""),
        ])  # fmt: skip
    header = ["distance (mas)", "speed (c)", "p_global", "p_fdr", "kind",
              "features ± 2 mas (c)", "paper (c)"]  # fmt: skip
    write_table("profile_3c120", header, rows)
    accelerations(scc, matched, k)
    rows = []
    inside = profile.main[profile.main["r_mid"] < 7.6 * u.mas]
    for what, table in (("0.5 to 10.5", profile.main), ("0.5 to 7.5", inside)):
        r, v, e = (table[c] for c in ("r_mid", "pm_parallel", "pm_parallel_err"))
        for model in ("linear", "power-law", "broken"):
            try:
                fit = fit_profile(r, v, e, model=model)
            except ValueError:
                continue
            text = ", ".join(
                f"{name} {measured(fit.parameters[name].value, fit.errors[name].value)}"
                for name in fit.parameters
            )
            rows.append([f"stack, {what}", model, text,
                         f"{fit.chi2:.1f} / {fit.n_free}",
                         p_text(fit.p_constant)])  # fmt: skip
        gamma = lorentz_profile(
            r, k * v.value, k * np.asarray(e.value), VIEWING_ANGLE,
            angle_error=1 * u.deg, rng=1,
        )  # fmt: skip
        rows.append([f"stack, {what}", "Gamma = a z^k",
                     f"k {measured(gamma.k, gamma.k_err)}, possible "
                     f"{gamma.possible:.2f}", "", ""])  # fmt: skip
    use = (n > 0) & (radii < 7.6)
    gamma = lorentz_profile(
        radii[use] * u.mas, k * speed[use], k * np.maximum(error[use], 0.05),
        VIEWING_ANGLE, angle_error=1 * u.deg, rng=1,
    )  # fmt: skip
    rows.append(["features, 1 to 7", "Gamma = a z^k",
                 f"k {measured(gamma.k, gamma.k_err)}, possible {gamma.possible:.2f}",
                 "", ""])  # fmt: skip
    rows.append(["paper", "Gamma = a z^k", "k ~ 0.3", "", ""])
    header = ["speeds", "model", "parameters (mas, yr)", "chi2 / free",
              "p of a constant"]  # fmt: skip
    write_table("profile_3c120_fits", header, rows)
    figure_3c120(profile, matched, radii, speed, error, n, k)
    wide = replace(scc, baseline=[0.1, 1.2] * u.yr)
    table = check_lags(
        wide, matched, [2.0, 0.0] * PM_UNIT, r_min=0.5 * u.mas, r_max=10.5 * u.mas
    )
    rows = [
        [
            f"{row['lag'].value:.2f}",
            measured(row["displacement"].value, row["displacement_err"].value),
            f"{row['displacement'].value / row['lag'].value:.2f}",
        ]
        for row in table
    ]
    meta = table.meta
    if meta["p_offset"] is not None:
        rows.append(["0", measured(meta["offset"].value, meta["offset_err"].value),
                     f"p of no offset {p_text(meta['p_offset'])}"])  # fmt: skip
    write_table("profile_3c120_lags", ["lag (yr)", "displacement (mas)", "ratio"], rows)


def accelerations(scc, matched, k):
    """The stack in speed and acceleration, over stretches of 3C 120."""
    rows = []
    for low, high in ((0.5, 10.5), (0.5, 7.5), (1.5, 7.5), (5.5, 10.5)):
        found = measure_acceleration(
            scc, matched, r_min=low * u.mas, r_max=high * u.mas
        )
        inner, outer = (
            [k * plain(v, PM_UNIT) for v in found.at(r * u.mas)] for r in (low, high)
        )
        rows.append([
            f"{low:g} to {high:g}",
            measured(found.acceleration.value, found.acceleration_err.value, 3),
            p_text(found.p_value), found.n_blocks,
            measured(*inner, 1), measured(*outer, 1),
        ])  # fmt: skip
    header = ["distance (mas)", "acceleration (mas/yr^2)", "p", "blocks",
              "inner speed (c)", "outer speed (c)"]  # fmt: skip
    write_table("profile_3c120_acceleration", header, rows)


def figure_3c120(profile, matched, radii, speed, error, n, k):
    """The paper's figure: speed against distance, the jet above it."""
    from astro_scc.kinematics import RidgeLine
    from astro_scc.visualization import plot_profile

    angle = np.radians(SOURCE["3C 120"].position_angle)
    s = [0.0, 10.5] * u.mas
    use = n > 0
    others = [("features within 2 mas", radii[use] * u.mas, speed[use] * PM_UNIT,
               error[use] * PM_UNIT)]  # fmt: skip
    figure = plot_profile(
        profile.components, cube=matched.cube, others=others, beta_per_pm=k,
        line=RidgeLine(s * np.sin(angle), s * np.cos(angle)),
    )  # fmt: skip
    figure.savefig(RESULTS / "profile_3c120.png", dpi=110)


def streams_of_3c273(args):
    """Speeds and places of small and large scales in 3C 273."""
    source = SOURCE["3C 273"]
    k = source.per_c
    cube = images(source, args.folder, args.seed)
    scc = settings(source)
    matched = scc.match(cube)
    groups = scale_groups(matched, {"1, 2": [1, 2], "3, 4": [3, 4]})
    rows, places = [], []
    for low, high in ((1, 6), (6, 11), (11, 16), (1, 16)):
        limits = {"r_min": low * u.mas, "r_max": high * u.mas}
        row = compare_speeds(
            scc, matched, groups, **limits, n_trials=1000, rng=args.seed
        )[0]
        cells = [
            measured(k * plain(row[c], PM_UNIT), k * plain(row[f"{c}_err"], PM_UNIT), 1)
            for c in ("first_speed", "second_speed", "difference")
        ]
        rows.append([f"{low} to {high}", *cells, p_text(row["p_value"]),
                     row["n_blocks"], "about 7.5 and 9 c"])  # fmt: skip
        table = compare_positions(
            scc, matched, groups, **limits, speed=0.85 * PM_UNIT, n_trials=200,
            rng=args.seed,
        )  # fmt: skip
        for r in table:
            places.append([
                f"{low} to {high}", r["quantity"], r["unit"],
                measured(r["first_median"], r["first_spread"]),
                measured(r["second_median"], r["second_spread"]),
                p_text(r["p_ksamp"]), p_text(r["p_paired"]),
            ])  # fmt: skip
    header = ["distance (mas)", "scales 1, 2 (c)", "scales 3, 4 (c)", "difference (c)",
              "p, paired", "blocks", "paper"]  # fmt: skip
    write_table("stratification_3c273", header, rows)
    header = ["distance (mas)", "quantity", "unit", "scales 1, 2: median ± spread",
              "scales 3, 4", "p, Anderson-Darling", "p, paired"]  # fmt: skip
    write_table("stratification_3c273_places", header, places)
    from astro_scc.stratification.positions import ssp_places
    from astro_scc.visualization import plot_position_angles

    angle, _, _ = ssp_places(scc, matched)
    inner = select_ssps(matched, r_min=1 * u.mas, r_max=6 * u.mas).select
    figure = plot_position_angles(
        {f"scales {name}": angle[inner & g] for name, g in groups.items()}
    )
    figure.savefig(RESULTS / "stratification_3c273.png", dpi=110)


def limit_of_m87(args):
    """What can be said of M 87, and the limit below which nothing can."""
    components = read_components(args.folder / "1228+126.ecsv")
    cube = restore(components, beam=M87_BEAM, pixel_scale=PIXEL, noise=NOISE,
                   rng=args.seed)  # fmt: skip
    scc = StackedCrossCorrelation(
        scales=(1, 2, 3, 4),
        max_speed=0.6 * PM_UNIT,
        position_angle=-72 * u.deg,
        baseline=[1.0, 4.0] * u.yr,
    )
    matched = scc.match(cube)
    k = float(apparent_speed(1 * PM_UNIT, distance=M87_DISTANCE))
    profile = measure_profile(
        scc, matched, [0.5, 2, 4, 8, 16] * u.mas, n_trials=args.n_trials, rng=args.seed
    )
    rows = []
    for row in profile.components:
        v, e = (plain(row[c], PM_UNIT) for c in ("pm_parallel", "pm_parallel_err"))
        rows.append([
            f"{row['r_min'].value:g} to {row['r_max'].value:g}", measured(v, e, 3),
            measured(k * v, k * e, 3), p_text(row["p_global"]), p_text(row["p_fdr"]),
            row["kind"], f"{2 * k * e:.3f}",
        ])  # fmt: skip
    header = ["distance (mas)", "along (mas/yr)", "speed (c)", "p_global", "p_fdr",
              "kind", "limit, 2 errors (c)"]  # fmt: skip
    write_table("profile_m87", header, rows)


def bent_jet(args):
    """A jet that bends by 70 deg, with two speeds along it."""
    rows = []
    radius, slow, fast = 16.0, 0.5, 1.4
    for seed in range(args.seed, args.seed + 3):
        cube = bent_images(seed, radius, (slow, fast))
        scc = StackedCrossCorrelation(scales=[1, 2], max_speed=2.2 * PM_UNIT)
        matched = scc.match(cube)
        line = find_ridge_line(
            cube, position_angle=270 * u.deg, half_width=2 * u.mas,
            smoothing=3 * u.mas,
        )  # fmt: skip
        part = select_ssps(matched, r_min=2 * u.mas, r_max=17 * u.mas)
        for name, axes in (("ridge line", line), ("position angle", 300 * u.deg)):
            table = (
                replace(scc, position_angle=axes)
                .stack(part, n_trials=args.n_trials, rng=seed)
                .components
            )
            cells = [
                f"{measured(plain(r['pm_parallel'], PM_UNIT), plain(r['pm_parallel_err'], PM_UNIT))}"  # noqa: E501
                f" ({r['kind']}, p {p_text(r['p_global'])})"
                for r in table
            ]
            rows.append([seed, name, *(cells + ["", "", ""])[:3]])
    header = ["seed", "axes", "first (mas/yr)", "second", "third"]
    print(f"Put in: {slow} and {fast} mas/yr along the line")
    write_table("profile_bent", header, rows)


def bent_images(seed, radius, speeds, n_epochs=10):
    """A circle from west to north, features at two speeds along it."""
    from astro_scc.epochs import EpochCube
    from astro_scc.epochs.gaussians import add_gaussians

    rng = np.random.default_rng(seed)
    beam = Beam(1 * u.mas, 1 * u.mas)
    cube = EpochCube.from_arrays(
        np.zeros((n_epochs, 200, 220)),
        [f"{2000 + i}-01-01" for i in range(n_epochs)],
        pixel_scale=0.1 * u.mas, unit=u.Jy / u.beam, beams=beam,
        noise=0.002 * u.Jy / u.beam, reference_pixel=(25, 25),
    )  # fmt: skip
    end = radius * np.radians(70)
    years = cube.years.to_value(u.yr)
    for speed, spread in zip(speeds, (0.9, 0.3), strict=True):
        n = int(1.0 * (end + speed * years[-1]))
        start = rng.uniform(-speed * years[-1], end, n)
        off, peak = rng.normal(0, spread, n), rng.uniform(0.3, 1.5, n)
        for image, year in zip(cube.data, years, strict=True):
            s = start + speed * year + rng.normal(0, 0.05, n)
            seen = (s > 0) & (s < end)
            t, r = s / radius, radius - off
            x, y = cube.offset_to_pixel(-r * np.sin(t) * u.mas,
                                        (radius - r * np.cos(t)) * u.mas)  # fmt: skip
            covariance = np.broadcast_to(4.6**2 * np.eye(2), (seen.sum(), 2, 2))
            add_gaussians(image, x[seen], y[seen], peak[seen], covariance)
    cube.data[:] += rng.normal(0, 0.002, cube.data.shape)
    return cube


def two_rates(args):
    """Rates and centre of simulated shells."""
    rows = []
    for seed in range(args.seed, args.seed + 3):
        shell = simulate_shell(rng=seed)
        scc = StackedCrossCorrelation(
            scales=[1, 4], max_speed=200 * u.mas / u.yr, baseline=[10, 25] * u.yr,
            kernel=0.1, detection=7, segmentation=5,
        )  # fmt: skip
        matched = scc.match(shell.cube)
        fit = fit_shell(scc, matched, scale_groups(matched, {"1": [1], "4": [4]}))
        rates = [measured(r.value, e.value, 4)
                 for r, e in zip(fit.rate, fit.rate_err, strict=True)]  # fmt: skip
        away = (fit.centre - shell.centre).to_value(u.arcsec)
        errors = fit.centre_err.to_value(u.arcsec)
        off = [measured(a, e) for a, e in zip(away, errors, strict=True)]
        rows.append([seed, *rates, *off])
    mean = 12.5
    print(
        "Put in, at the mean date: "
        + " and ".join(f"{100 * e / (1 + e * mean):.4f}" for e in (0.0011, 0.0007))
        + " %/yr; resolution of scale 1: 4 arcsec"
    )
    header = ["seed", "scale 1 (%/yr)", "scale 4 (%/yr)", "centre off, east (arcsec)",
              "north"]  # fmt: skip
    write_table("shell", header, rows)


if __name__ == "__main__":
    main()
