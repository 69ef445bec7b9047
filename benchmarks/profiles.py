# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure speeds along jets, of layers and of shells, and compare them with known ones.

The sources are 3C 120 and 3C 273 as in Sect. 3 of Mertens & Lobanov (2016), M 87, a
bent jet whose speeds are known, and a shell with two rates of expansion::

    python benchmarks/profiles.py ../shared/data/mojave_xviii
    python benchmarks/profiles.py ../shared/data/mojave_xviii --only bent shell
"""

import argparse
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import Table
from bent import bent_jets
from common import (
    PM_UNIT,
    RESULTS,
    measured,
    mojave_images,
    p_text,
    plain,
    write_table,
)
from mojave import BEFORE, SOURCES
from shells import two_rates

from astro_scc import Beam, StackedCrossCorrelation
from astro_scc.features.motion import fit_motion
from astro_scc.flow import (
    compare_scales,
    fit_profile,
    measure_acceleration,
    measure_profile,
)
from astro_scc.flow.profile import angles_by_scale
from astro_scc.kinematics import apparent_speed
from astro_scc.streams.spread import mean_speed
from astro_scc.visualization.speeds import plot_position_angles

SOURCE = {source.name: source for source in SOURCES}
#: Fewest epochs, error of a position and width of the beam of the survey's features,
#: both in mas.
LEAST_EPOCHS, POSITION_ERROR, BEAM_FWHM = 3, 0.1, 0.8
#: Speeds in c from the paper, Sect. 3.2, by the middle of the bin in mas.
PAPER_3C120 = {1: "4.0 ± 0.2", 7: "6.0 ± 0.4", 8: "slower", 9: "slower", 10: "slower"}
M87_DISTANCE = 16.7 * u.Mpc
M87_BEAM = Beam(1.2 * u.mas, 0.6 * u.mas, -5 * u.deg)


def main():
    """Run the requested parts."""
    everything = {
        "3c120": acceleration_of_3c120,
        "3c273": streams_of_3c273,
        "m87": limit_of_m87,
        "bent": bent_jets,
        "shell": two_rates,
    }
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("folder", type=Path, help="of the tables of features")
    parser.add_argument("--only", nargs="+", choices=everything, default=everything)
    parser.add_argument("--n-trials", type=int, default=200)
    parser.add_argument("--n-jets", type=int, default=12, help="that bend")
    parser.add_argument("--n-shells", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    for name in args.only:
        everything[name](args)


def settings(source):
    """Return the measurement of one of the paper's jets."""
    return StackedCrossCorrelation(position_angle=source.position_angle * u.deg)


def features_as_the_paper(folder, table, radii, *, before, half_width=2.0):
    """Return the mean speed of the survey's features within 2 mas of each distance."""
    seen = Table.read(folder / f"{table}.ecsv", format="ascii.ecsv")
    use = (np.asarray(seen["epoch"], dtype=str) < before) & (seen["feature"] > 0)
    seen = seen[use]
    years = np.array([_year(text) for text in seen["epoch"]])
    distance = np.asarray(seen["separation"], dtype=float)
    place = np.stack([distance, 0 * distance], axis=1)
    speed, speed_err = np.zeros((2, len(radii)))
    n_features = np.zeros(len(radii), dtype=int)
    for k, radius in enumerate(radii):
        near = np.abs(distance - radius) <= half_width
        fits = []
        for feature in np.unique(seen["feature"][near]):
            own = near & (seen["feature"] == feature)
            if own.sum() >= LEAST_EPOCHS:
                error = np.full((own.sum(), 2), POSITION_ERROR)
                fits.append(fit_motion(years[own], place[own], error, BEAM_FWHM))
        if fits:
            mean = mean_speed(
                [fit.velocity[0] for fit in fits],
                [fit.velocity_err[0] for fit in fits],
                np.ones(len(fits)),
            )
            speed[k], speed_err[k], n_features[k] = mean.mean, mean.error, len(fits)
    return speed, speed_err, n_features


def _year(text):
    from astropy.time import Time

    return float(Time(str(text)).jyear)


def acceleration_of_3c120(args):
    """Measure speed against distance in 3C 120 in ten bins."""
    source = SOURCE["3C 120"]
    k = source.per_c
    cube = mojave_images(
        args.folder, source.table, source.beam, before=BEFORE, seed=args.seed
    )
    scc = settings(source)
    decomposed = scc.decompose(cube)
    edges = np.arange(0.5, 11.0) * u.mas
    profile = measure_profile(
        scc, decomposed, edges, n_trials=args.n_trials, rng=args.seed
    )
    radii = np.arange(1.0, 11.0)
    speed, error, n = features_as_the_paper(
        args.folder, source.table, radii, before=BEFORE
    )
    beside = [f"{measured(k * v, k * e, 1)} ({m})"
              for v, e, m in zip(speed, error, n, strict=True)]  # fmt: skip
    bins_of_3c120(profile, beside, k)
    slopes_of_3c120(profile, scc, decomposed, k, args)
    figure_3c120(profile, cube, radii, speed, error, n, k)


def bins_of_3c120(profile, beside, k):
    """Write the main stream of each bin, compared with features and paper."""
    main_rows = {round(float(r["r_mid"].value)): r for r in profile.main}
    own, beam = profile.speeds["all"], profile.flow.beam
    rows = []
    for radius, features in enumerate(beside, 1):
        row, v, e = main_rows.get(radius), own.speed[radius - 1], own.error[radius - 1]
        ours = [""] * 5
        if row is not None:
            pm = [plain(row[c], PM_UNIT) for c in ("pm_parallel", "pm_parallel_err")]
            ours = [measured(k * pm[0], k * pm[1], 1), row["pm_from"],
                    p_text(row["p_global"]), p_text(row["p_fdr"]),
                    row["kind"]]  # fmt: skip
        rows.append([radius, measured(k * beam * v, k * beam * e, 1), *ours, features,
                     PAPER_3C120.get(radius, "")])  # fmt: skip
    header = ["distance (mas)", "spectrum (c)", "row (c)", "from", "p_global", "p_fdr",
              "kind", "features ± 2 mas (c)", "paper (c)"]  # fmt: skip
    write_table("profile_3c120", header, rows)


def slopes_of_3c120(profile, scc, decomposed, k, args):
    """Write fits to the bins with their covariance, and the acceleration of parts."""
    own, beam = profile.speeds["all"], profile.flow.beam
    r, v, e = own.place * beam * u.mas, own.speed * beam, own.error * beam
    covariance = profile.covariance.value
    rows = []
    for low, high in ((0.5, 10.5), (0.5, 7.5), (1.5, 7.5), (5.5, 10.5)):
        use = (r.value > low) & (r.value < high)
        square = covariance[np.ix_(use, use)]
        for model in ("linear", "power-law", "broken"):
            fit = fit_profile(r[use], v[use], e[use], model=model, covariance=square)
            text = ", ".join(
                f"{name} {measured(fit.parameters[name].value, fit.errors[name].value)}"
                for name in fit.parameters
            )
            gradient = ""
            if model == "linear":
                g, g_err = (x["gradient"].value for x in (fit.parameters, fit.errors))
                gradient = f"{measured(k * g, k * g_err, 2)}, {g / g_err:.1f} sigma"
            rows.append([f"{low:g} to {high:g}", model, text, gradient,
                         f"{fit.chi2:.1f} / {fit.n_free}",
                         p_text(fit.p_constant)])  # fmt: skip
    header = ["distance (mas)", "model", "parameters (mas, yr)", "gradient (c/mas)",
              "chi2 / free", "p of a constant"]  # fmt: skip
    write_table("profile_3c120_fits", header, rows)
    whole = scc.measure(decomposed, n_trials=args.n_trials, rng=args.seed)
    rows = []
    found = {"ten bins": profile.acceleration, "the whole": measure_acceleration(whole)}
    for name, of in found.items():
        rows.append([
            name, of.n_parts, measured(k * of.speed.value, np.nan, 1),
            f"{of.centre.value:.1f}",
            measured(of.gradient.value, of.gradient_err.value, 3),
            measured(of.acceleration.value, of.acceleration_err.value, 3),
            p_text(of.p_value),
        ])  # fmt: skip
    header = ["of", "parts", "speed (c)", "at (mas)", "dv/dx (1/yr)",
              "acceleration (mas/yr^2)", "p"]  # fmt: skip
    write_table("profile_3c120_acceleration", header, rows)


def figure_3c120(profile, cube, radii, speed, error, n, k):
    """Draw the paper's figure: speed against distance, with the jet above it."""
    use = n > 0
    others = [("features within 2 mas", radii[use] * u.mas, speed[use] * PM_UNIT,
               error[use] * PM_UNIT)]  # fmt: skip
    angle = SOURCE["3C 120"].position_angle
    figure = figure_along(profile, cube, angle, k, others=others)
    figure.savefig(RESULTS / "profile_3c120.png", dpi=110)


def figure_along(profile, cube, position_angle, k, **kwargs):
    """Draw speed against distance along a position angle, with the jet above it."""
    from astro_scc.kinematics import RidgeLine
    from astro_scc.visualization import plot_profile

    angle = np.radians(position_angle)
    s = u.Quantity([0 * u.mas, profile.bins.max()])
    return plot_profile(
        profile.components, cube=cube, beta_per_pm=k,
        line=RidgeLine(s * np.sin(angle), s * np.cos(angle)), **kwargs,
    )  # fmt: skip


def streams_of_3c273(args):
    """Compare the speeds of small and large scales in 3C 273."""
    source = SOURCE["3C 273"]
    k = source.per_c
    cube = mojave_images(
        args.folder, source.table, source.beam, before=BEFORE, seed=args.seed
    )
    edges = u.Quantity([1, 6, 11, 16] * u.mas)
    parts = edges, edges[[0, -1]]
    profiles = [
        measure_profile(
            settings(source), cube, part, scale_groups="1,2; 3,4",
            n_trials=args.n_trials, rng=args.seed,
        )
        for part in parts
    ]  # fmt: skip
    rows = []
    for row in (row for profile in profiles for row in compare_scales(profile)):
        cells = [
            measured(k * plain(row[c], PM_UNIT), k * plain(row[f"{c}_err"], PM_UNIT), 1)
            for c in ("first_speed", "second_speed", "difference")
        ]
        rows.append([f"{row['r_min'].value:g} to {row['r_max'].value:g}", *cells,
                     p_text(row["p_value"]), "about 7.5 and 9 c"])  # fmt: skip
    header = ["distance (mas)", "scales 1, 2 (c)", "scales 3, 4 (c)", "difference (c)",
              "p", "paper"]  # fmt: skip
    write_table("stratification_3c273", header, rows)
    inner = measure_profile(
        settings(source), cube, edges[:2], scale_groups="1,2; 3,4", n_trials=20, rng=1
    )
    figure = plot_position_angles(angles_by_scale(inner, inner.results["1, 2"][0]))
    figure.savefig(RESULTS / "stratification_3c273.png", dpi=110)


def limit_of_m87(args):
    """Write the components in bins of M 87, and the limits of their speeds."""
    cube = mojave_images(args.folder, "1228+126", M87_BEAM, seed=args.seed)
    scc = StackedCrossCorrelation(
        scales=(1, 2, 3, 4),
        max_speed=0.6 * PM_UNIT,
        position_angle=-72 * u.deg,
        baseline=[1.0, 4.0] * u.yr,
    )
    k = float(apparent_speed(1 * PM_UNIT, distance=M87_DISTANCE))
    profile = measure_profile(
        scc, cube, [0.5, 2, 4, 8, 16] * u.mas, n_trials=args.n_trials, rng=args.seed
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


if __name__ == "__main__":
    main()
