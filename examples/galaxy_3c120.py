# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure speed and Lorentz factor against distance in 3C 120, from the table of MOJAVE.

    python examples/galaxy_3c120.py apjac230ft4_mrt.txt
"""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from astropy.table import QTable
from common import brief, run

from astro_scc import Beam, StackedCrossCorrelation
from astro_scc.epochs import read_components, restore
from astro_scc.flow import fit_profile, measure_profile
from astro_scc.kinematics import apparent_speed, beta_intrinsic, lorentz_factor

#: The jet's direction, its angle to the line of sight, and c of 1 mas/yr.
DIRECTION, VIEW = 248 * u.deg, 15 * u.deg
PER_C = apparent_speed(1 * u.mas / u.yr, redshift=0.033)
#: Distances in mas and speeds in c of the paper, and their errors.
PAPER = (1, 7), (4.0, 6.0), (0.2, 0.4)


def gamma_of(beta_app):
    """Return Lorentz factors at the angle to the line of sight."""
    return lorentz_factor(beta_intrinsic(beta_app, VIEW))


def feature_speeds(components, distances, near=2.0, without=0):
    """
    Return mean speeds of the survey's features near distances, and their errors.

    Feature 0 is the core; another one may be left out as well.
    """
    direction = DIRECTION.to_value(u.rad)
    east, north = (x.to_value(u.mas) for x in (components.east, components.north))
    along = east * np.sin(direction) + north * np.cos(direction)
    years, speeds = components.times.jyear[components.epoch], []
    for distance in distances.to_value(u.mas):
        part, own = np.abs(along - distance) <= near, []
        for feature in {*components.feature[part].tolist()} - {0, without}:
            seen = part & (components.feature == feature)
            # Straight lines, as in the paper, through five dates or more.
            if seen.sum() >= 5:
                own.append(np.polyfit(years[seen], along[seen], 1)[0])
        # One feature has no scatter.
        error = np.std(own, ddof=1) / len(own) ** 0.5 if len(own) > 1 else np.nan
        speeds.append((np.mean(own) if own else np.nan, error, len(own)))
    return np.array(speeds).T


def feature_slope(components, distances):
    """Return the slope of these speeds and its error, by a jackknife over features."""
    numbers = np.unique(components.feature[components.feature > 0])
    slopes = []
    for without in (0, *numbers):
        speed, error, _ = feature_speeds(components, distances, without=without)
        fit = fit_profile(distances, PER_C.value * speed, PER_C.value * error)
        slopes.append(fit.parameters["gradient"].value)
    slope, *others = slopes
    return slope, np.sqrt((len(others) - 1) * np.var(others))


def measure(table, before="2011-01-01", n_trials=200):
    """Return speeds and Lorentz factors in ten bins of 1 mas, and their figure."""
    components = read_components(table, source="0430+052").select(before=before)
    cube = restore(
        components,
        beam=Beam(1.2 * u.mas, 0.5 * u.mas, -5 * u.deg),
        pixel_scale=0.1 * u.mas,
        noise=0.3 * u.mJy / u.beam,
        rng=1,
    )
    scc = StackedCrossCorrelation(position_angle=DIRECTION)
    edges = np.arange(0.5, 11) * u.mas
    profile = measure_profile(scc, cube, edges, n_trials=n_trials, rng=1)
    # One speed for each bin that has one, and how they depend on each other.
    bins = profile.components.meta["covariance"]["all"]
    r, beta_app = bins["distance"], (bins["speed"] * PER_C).to_value(u.mas / u.yr)
    covariance = bins["covariance"].to_value((u.mas / u.yr) ** 2) * PER_C.value**2
    # Errors of single speeds count in full that patterns have different ones.  The same
    # patterns cross neighbouring bins, so that slopes have the covariance.
    rows = {round(row["r_min"].to_value(u.mas), 3): row for row in profile.main}
    rows = [rows[round(edges[k].to_value(u.mas), 3)] for k in bins["bins"]]
    error = [(row["pm_parallel_err"] * PER_C).to_value(u.mas / u.yr) for row in rows]
    gamma = gamma_of(beta_app).value
    slope = (gamma_of(beta_app + 0.01) - gamma_of(beta_app - 0.01)).value / 0.02
    gamma_covariance = slope[:, None] * covariance * slope
    gamma_err = np.abs(slope) * error
    power = fit_profile(
        r,
        gamma,
        np.sqrt(np.diag(gamma_covariance)),
        model="power-law",
        covariance=gamma_covariance,
    )
    line = fit_profile(r, beta_app, np.sqrt(np.diag(covariance)), covariance=covariance)
    feature_speed, feature_err, n = feature_speeds(components, r)
    # The windows overlap, so that their speeds are not independent.
    known, known_err = feature_slope(components, r)
    found = QTable(
        {
            "r": r,
            "beta_app": beta_app,
            "beta_app_err": error,
            "beta_features": feature_speed * PER_C.value,
            "beta_features_err": feature_err * PER_C.value,
            "n_features": n.astype(int),
            "gamma": gamma,
            "gamma_err": gamma_err,
        }
    )
    columns = [name for name in found.colnames if name not in ("r", "n_features")]
    found = brief(found, "r", *columns[:4], "n_features", *columns[4:], digits=1)
    found.meta["notes"] = [
        f"{profile.acceleration}",
        f"slope: {line.parameters['gradient'].value:.2f} +- "
        f"{line.errors['gradient'].value:.2f} c/mas",
        f"slope of features: {known:.2f} +- {known_err:.2f} c/mas",
        f"gamma as r^k: k {power.parameters['index'].value:.2f} +- "
        f"{power.errors['index'].value:.2f}, p {power.p_constant:.2g}",
    ]
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(6, 6), sharex=True, layout="compressed"
    )
    above.errorbar(r.value, beta_app, error, fmt="o", label="bins of the images")
    beside = [found[name].value for name in ("beta_features", "beta_features_err")]
    above.errorbar(
        r.value + 0.12, *beside, fmt="D", ms=4, color="0.5", label="survey's features"
    )
    z = np.linspace(0.5, 10.5) * u.mas
    above.plot(z, line(z), color="C0", lw=1, label="line through the bins")
    above.errorbar(*PAPER, fmt="s", mfc="none", color="C1", label="Mertens & Lobanov")
    above.set_ylabel("Apparent speed (c)")
    above.legend(loc="lower right")
    below.errorbar(r.value, gamma, gamma_err, fmt="o")
    below.plot(z, power(z), color="C0", lw=1, label="power law through the bins")
    index = np.log(gamma_of(PAPER[1][1]) / gamma_of(PAPER[1][0])) / np.log(7)
    # The paper's acceleration ends at the second of its distances.
    inner = np.linspace(*PAPER[0])
    of_paper = gamma_of(PAPER[1][0]) * inner**index
    below.plot(inner, of_paper, ":", color="C1", label="Mertens & Lobanov")
    below.legend(loc="upper left")
    below.set(xlabel="Core separation (mas)", ylabel=f"Lorentz factor at {VIEW:g}")
    # The error of one Lorentz factor near the largest speed would fill the panel.
    above.set_ylim(0, 1.1 * np.max(beta_app + np.array(error)))
    below.set_ylim(0, 1.6 * np.max(gamma))
    return found, figure


if __name__ == "__main__":
    run(measure, __doc__, data=True)
