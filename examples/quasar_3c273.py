# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure small and large scales of 3C 273, and where they are, from the table of MOJAVE.

    python examples/quasar_3c273.py apjac230ft4_mrt.txt
"""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from astropy.table import QTable
from common import brief, run

from astro_scc import Beam, StackedCrossCorrelation
from astro_scc.epochs import read_components, restore
from astro_scc.flow import compare_scales, measure_profile
from astro_scc.kinematics import apparent_speed

GROUPS = {"1, 2": [1, 2], "3, 4": [3, 4]}
#: The speed in c of 1 mas/yr.
PER_C = apparent_speed(1 * u.mas / u.yr, redshift=0.158).value
#: Speeds in c of the paper, of both groups anywhere from 1 to 16 mas.
PAPER = 7.5, 9.0


def position_angles(ssps, scales, inner, outer):
    """Return the position angles of the patterns (SSPs) on some scales, in degrees."""
    east, north = ssps["east_centroid"], ssps["north_centroid"]
    r = np.hypot(east, north)
    use = np.isin(ssps["scale"], scales) & (r >= inner) & (r < outer)
    return np.arctan2(east, north)[use].to_value(u.deg) % 360


def measure(table, before="2011-01-01", n_trials=200):
    """Return speeds and position angles of two groups of scales in three regions."""
    components = read_components(table, source="1226+023")
    cube = restore(
        components.select(before=before),
        beam=Beam(1.0 * u.mas, 0.5 * u.mas, -7 * u.deg),
        pixel_scale=0.1 * u.mas,
        noise=0.3 * u.mJy / u.beam,
        rng=1,
    )
    scc = StackedCrossCorrelation(scales=[1, 2, 3, 4], position_angle=222 * u.deg)
    profile = measure_profile(
        scc, cube, [1, 6, 11, 16] * u.mas, scale_groups=GROUPS, n_trials=n_trials, rng=1
    )
    # The table that ``astro-scc measure`` writes as ssps.ecsv.
    ssps = profile.results["1, 2"][0].ssps
    rows, differences = [], []
    for region in compare_scales(profile):
        limits = region["r_min"], region["r_max"]
        apart, error = (
            PER_C * region[key].to_value(u.mas / u.yr)
            for key in ("difference", "difference_err")
        )
        p_value = f"p {region['p_value']:.2f}"
        differences.append(f"{apart:.1f} +- {error:.1f} c ({p_value})")
        for which, (name, scales) in zip(
            ("first_speed", "second_speed"), GROUPS.items(), strict=True
        ):
            pm = [region[key].to_value(u.mas / u.yr) for key in (which, f"{which}_err")]
            angles = position_angles(ssps, scales, *limits)
            low, middle, high = np.percentile(angles, [16, 50, 84]) * u.deg
            speed, error = PER_C * np.array(pm)
            row = speed, error, len(angles), middle, (high - low) / 2
            rows.append((*limits, name, *row))
    names = "r_min", "r_max", "scales", "beta_app", "beta_app_err", "ssps", "pa"
    found = brief(QTable(rows=rows, names=[*names, "pa_half"]), *names, "pa_half",
                  digits=1, r_min=0, r_max=0)  # fmt: skip
    found.meta["notes"] = [f"scales 3, 4 less 1, 2: {', '.join(differences)}"]
    return found, plot(found, ssps)


def plot(found, ssps):
    """Draw speed against distance, and the position angles of the inner region."""
    figure, (above, below) = plt.subplots(2, 1, figsize=(6, 6), layout="compressed")
    for k, (name, scales) in enumerate(GROUPS.items()):
        own = found[found["scales"] == name]
        low, high = own["r_min"].to_value(u.mas), own["r_max"].to_value(u.mas)
        speed, error = own["beta_app"].value, own["beta_app_err"].value
        # The regions are the same; their points stand side by side.
        middle = (low + high) / 2 + 0.3 * (k - 0.5)
        above.errorbar(middle, speed, error, fmt="o", label=f"scales {name}")
        label = f"scales {name}, Mertens & Lobanov"
        above.plot((1, 16), [PAPER[k]] * 2, "--", color=f"C{k}", lw=1, label=label)
        angles = position_angles(ssps, scales, *([1, 6] * u.mas))
        below.hist(
            angles,
            np.arange(200, 262, 2.5),
            weights=np.full(len(angles), 1 / len(angles)),
            histtype="step",
            lw=1.8,
            label=f"scales {name}",
        )
    above.set(xlabel="Core separation (mas)", ylabel="Apparent speed (c)", ylim=(0, 13))
    below.set(xlabel="Position angle (deg)", ylabel="Fraction of SSPs\nat 1 to 6 mas")
    for edge in (1, 6, 11, 16):
        label = "limits of the regions" if edge == 1 else None
        above.axvline(edge, color="0.8", lw=0.8, zorder=0, label=label)
    above.legend(loc="lower right", ncols=2)
    below.legend()
    return figure


if __name__ == "__main__":
    run(measure, __doc__, data=True)
