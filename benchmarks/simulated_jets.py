# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Compare statistics and images of simulated jets with those of jets of the MOJAVE survey.

``python benchmarks/simulated_jets.py ../shared/data`` prints a table and writes
``results/simulated_jets.png``.
"""

import argparse
from pathlib import Path

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from common import RESULTS, mojave_images, print_table
from vlbi import observe

from astro_scc.decomposition import Decomposer
from astro_scc.epochs import Beam
from astro_scc.simulation import simulate_jet

BEAM = Beam(1.0 * u.mas, 0.5 * u.mas, -5 * u.deg)
SOURCES = {
    "3C 273": "1226+023",
    "3C 120": "0430+052",
    "3C 345": "1641+399",
    "3C 111": "0415+379",
    "BL Lac": "2200+420",
    "0333+321": "0333+321",
    "1308+326": "1308+326",
}
SCALES = (1, 2, 3, 4)
N_EPOCHS = 12


def row(name, cube):
    """Return statistics of one jet, from an even selection of epochs."""
    steps = np.log(np.diff(cube.years.to_value(u.yr)))
    # Use 15 consecutive epochs, as many as are simulated.
    windows = [np.std(steps[i : i + 14]) for i in range(0, len(steps) - 13, 7)]
    x0, y0 = cube.reference_pixel
    y, x = np.indices(cube.shape[1:])
    beam = np.sqrt(BEAM.major * BEAM.minor) / cube.pixel_scale
    r = np.hypot(x - x0, y - y0) / beam.to_value(u.one)
    decomposer = Decomposer(scales=SCALES)
    found = []
    chosen = np.linspace(0, len(cube) - 1, min(N_EPOCHS, len(cube))).astype(int)
    for image in cube.data[chosen]:
        noise = 1.4826 * np.median(np.abs(image - np.median(image)))
        bright = image > 4 * noise
        scale = np.asarray(decomposer(image).ssps.scale)
        outside = image[bright & (r > 1.5)].sum() / image[bright].sum()
        found.append(
            [
                *((scale == s).sum() for s in SCALES),
                image.max() / noise,
                np.log(image[r < 1.5].max()),
                outside,
                np.percentile(r[bright], 98),
            ]
        )
    found = np.array(found)
    counts = found.mean(axis=0)
    return {
        "jet": name,
        "epochs": len(cube),
        "scatter of ln interval": f"{np.median(windows):.2f}",
        **{
            f"SSPs, scale {s}": f"{n:.1f}" for s, n in zip(SCALES, counts, strict=False)
        },
        "peak over noise": f"{np.median(found[:, 4]):.0f}",
        "scatter of ln core": f"{found[:, 5].std():.2f}",
        "flux outside the core": f"{np.median(found[:, 6]):.2f}",
        "length (beams)": f"{np.median(found[:, 7]):.0f}",
    }


def main():
    """Write the table and the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    folder = parser.parse_args().data / "mojave_xviii"
    cubes = {
        name: mojave_images(folder, table, BEAM) for name, table in SOURCES.items()
    }
    for seed in (1, 2, 3):
        jet = simulate_jet(rng=seed, beam=BEAM)
        cubes[f"simulated, {seed}"] = jet.cube
        cubes[f"the same with the VLBA, {seed}"] = observe(
            jet, beam=BEAM, rng=seed
        ).cube
    rows = [row(*item) for item in cubes.items()]
    print_table(list(rows[0]), [list(r.values()) for r in rows])
    shown = {name: cubes[name] for name in ("3C 120", "3C 345")}
    shown |= {name: cubes[name] for name in list(cubes)[-6:-4]}
    figure, axes = plt.subplots(
        4, 3, figsize=(8, 7.6), layout="constrained", sharex=True, sharey=True
    )
    for line, (name, cube) in zip(axes, shown.items(), strict=True):
        x0, y0 = cube.reference_pixel
        noise = float(np.median(cube.noise_rms().to_value(u.Jy / u.beam)))
        for ax, i in zip(line, (2, 5, 8), strict=True):
            ny, nx = cube.shape[1:]
            edges = np.array([-0.5 - x0, nx - 0.5 - x0, -0.5 - y0, ny - 0.5 - y0]) / 10
            ax.imshow(
                np.arcsinh(cube.data[i] / (3 * noise)),
                origin="lower",
                extent=edges * [-1, -1, 1, 1],
                cmap="Greys",
            )
            ax.set_title(f"{name}\n{cube.labels[i][:10]}", fontsize="small")
            ax.set(xlim=(6, -14), ylim=(-5, 6), xticks=range(-10, 6, 5))
    figure.supxlabel("Relative R.A. (mas)", fontsize="medium")
    figure.supylabel("Relative Decl. (mas)", fontsize="medium")
    figure.savefig(RESULTS / "simulated_jets.png", dpi=90)


if __name__ == "__main__":
    main()
