# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Use of public names for mypy, which reports a ``type: ignore`` without a need."""

from pathlib import Path
from typing import assert_type

import astropy.units as u
import numpy as np
from astropy.nddata import NDData
from astropy.table import QTable, Table
from astropy.time import Time
from matplotlib.figure import Figure

from astro_scc import (
    Beam,
    EpochCube,
    StackedCrossCorrelation,
    features,
    flow,
    kinematics,
    products,
    report,
    settings,
    simulation,
)
from astro_scc.measurement import SCCResult
from astro_scc.paper.method import measure_as_in_paper
from astro_scc.patterns import DecomposedEpochs


def measure(cube: EpochCube, path: Path) -> QTable:
    given, _ = settings.read_config(path)
    assert_type(settings.Settings(**given, redshift=0.158).to_toml("measure"), str)
    scc = StackedCrossCorrelation(scales=[1, 2, 3], max_speed=2 * u.mas / u.yr)
    StackedCrossCorrelation(max_speed=2.0)  # type: ignore[arg-type]
    StackedCrossCorrelation(speed=2 * u.mas / u.yr)  # type: ignore[call-arg]
    assert_type(scc.plan(cube)[2], float)
    decomposed = scc.decompose(cube, region="jet.reg", n_workers=2)
    assert_type(decomposed, DecomposedEpochs)
    result = scc.measure(decomposed, n_trials=100, rng=np.random.default_rng(1))
    scc.measure(cube)  # type: ignore[arg-type]
    assert_type(scc.match(cube, region="jet.reg"), DecomposedEpochs)
    assert_type(scc(cube, region=None, n_trials=1000, rng=1), SCCResult)
    return result.streams


def measure_as_the_paper(cube: EpochCube) -> NDData:
    settings = StackedCrossCorrelation(max_speed="2 mas/yr")
    found = measure_as_in_paper(cube, settings, n_trials=100, rng=1)
    assert_type(found.components, QTable)
    return found.velocity_map("z_score")


def profile(scc: StackedCrossCorrelation, epochs: DecomposedEpochs) -> QTable:
    ridge = kinematics.find_ridge_line(epochs.cube, smoothing=0.5 * u.mas)
    east, north = ridge.at(2 * u.mas)
    assert_type(ridge.coordinates(east, north), tuple[u.Quantity, u.Quantity])
    bins = flow.measure_profile(scc, epochs, np.arange(4) * u.mas, ridge=ridge, rng=1)
    flow.measure_profile(scc, "0.5 1.5 2.5 mas")  # type: ignore[arg-type,call-arg]
    result = bins.results["all"][0]
    assert_type(result, SCCResult | None)
    flow.fit_profile(bins.main["r_mid"], bins.main["pm"], bins.main["pm_err"])
    if result is not None:
        assert_type(flow.compare_scales(result, {"a": [1.0]}), QTable | None)
    return bins.components_in_c(redshift=0.1)


def track(cube: EpochCube) -> features.Features:
    features.find_features(cube, settings={"gate": 5})  # type: ignore[arg-type]
    return features.find_features(cube, detections="ssp", seed=1, n_workers=2)


def simulate() -> list[Path]:
    beam = Beam(0.8 * u.mas, 0.6 * u.mas, 10 * u.deg)
    jet = simulation.simulate_jet(
        streams=[simulation.Flow(positions=[1, 2], speed=0)],
        dates=Time(["2000-01-01", "2000-07-01"]), beam=beam, rng=1,
    )  # fmt: skip
    assert_type(jet.truth, QTable)
    return simulation.write_simulation(jet, "jet", overwrite=True)


def read_and_prepare(paths: list[str], table: Table) -> EpochCube:
    cube = EpochCube.read(paths, times=["2000-01-01"], beams=None, region="core.reg")
    assert_type(cube.epochs, QTable)
    assert_type(cube[1:], EpochCube)
    cube = cube.to_common_beam().align("table", table=table).crop("jet.reg", pad=4)
    east, north = cube.pixel_to_offset(3, [4, 5])
    assert_type(cube.offset_to_pixel(east, north), tuple[np.ndarray, np.ndarray])
    cube.write("cube.fits", clobber=True)  # type: ignore[call-arg]
    EpochCube.from_ndcube(cube.to_ndcube(), times=cube.times)
    return EpochCube.from_arrays(np.ones((2, 8, 8)), ["2000", "2001"], pixel_scale=east)


def read_results(result: SCCResult, matched: DecomposedEpochs) -> list[Path]:
    assert_type(result.components_in_c(redshift=0.158, cosmology="Planck18"), QTable)
    assert_type(result.velocity_map("z_score"), NDData)
    assert_type(SCCResult.read("result.fits"), SCCResult)
    result.cube.plot(0, result.ssps, unit="mas", vmax=1.0)
    assert_type(result.plot("tracks", unit=u.arcsec), Figure)
    products.ssp_regions(matched.ssps, result.cube, 0, frame="epoch").write("ssps.reg")
    page = report.write_report(result, "out", left_out=["a.fits", ("b.fits", "date")])
    return [page, *products.write_products(result, result.streams, "out")]
