# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tables that keep their columns, units and meta, empty or not, on disk or not."""

import astropy.units as u
import numpy as np
import pytest
from astropy.cosmology import Cosmology, FlatLambdaCDM
from astropy.table import QTable
from astropy.time import Time

from astro_scc.decomposition import SSPs
from astro_scc.measurement.tables import component_table, ssp_table, versions

PM = u.mas / u.yr
PROPER_MOTIONS = ["pm_ra_cosdec", "pm_dec", "pm", "pm_parallel", "pm_transverse"]
MOTIONS = [*PROPER_MOTIONS, "pm_pa"]
CONTRACT = [
    "component",
    "kind",
    "pm_ra_cosdec",
    "pm_dec",
    "pm",
    "pm_pa",
    "pm_parallel",
    "pm_transverse",
    "coefficient",
    "z_score",
    "p_local",
    "p_global",
    "p_global_err",
    "p_distinct",
    "p_smallest",
    "dispersion",
    "pm_min",
    "pm_max",
    "pm_limit",
    "pm_err_jitter",
    "pm_err_alignment",
    "n_ssp",
    "n_pairs",
    "n_features",
    "caution",
]


def row(number):
    names = [*CONTRACT, *(f"{name}_err" for name in (*MOTIONS, "dispersion"))]
    return {**dict.fromkeys(names, number), "kind": "not significant", "caution": "few"}


def same(read, written):
    assert read.colnames == written.colnames
    for name in written.colnames:
        a, b = read[name], written[name]
        assert getattr(a, "unit", None) == getattr(b, "unit", None)
        assert a.info.description == b.info.description
        if isinstance(b, Time):
            assert isinstance(a, Time)
            assert list(a.isot) == list(b.isot)
        elif b.dtype.kind in "US":
            assert list(a) == list(b)
        else:
            np.testing.assert_array_equal(np.asarray(a), np.asarray(b))
            assert a.dtype.kind == b.dtype.kind


@pytest.mark.parametrize("n", [0, 1, 3])
def test_components_have_all_columns_with_units_and_descriptions(n):
    table = component_table([row(k) for k in range(n)])
    assert len(table) == n
    for name in CONTRACT:
        assert name in table.colnames
        assert table[name].info.description
    for name in (*PROPER_MOTIONS, "dispersion"):
        for column in (name, f"{name}_err"):
            assert isinstance(table[column], u.Quantity)
            assert table[column].unit == PM
    assert table["pm_pa"].unit == table["pm_pa_err"].unit == u.deg
    assert table["pm_err"].info.description == "standard error of pm"
    assert table["pm_err_jitter"].unit == PM
    for name, value in (("kind", "not significant"), ("caution", "few")):
        assert list(table[name]) == [value] * n
        assert table[name].dtype.kind == "U"
    for name in ("component", "n_ssp", "n_pairs", "n_features"):
        assert table[name].dtype.kind == "i"
    for name in ("coefficient", "p_local", "p_global", "p_distinct", "p_smallest"):
        assert table[name].dtype.kind == "f"


def test_errors_stand_beside_their_values():
    names = component_table([]).colnames
    for name in (*MOTIONS, "dispersion"):
        assert names[names.index(name) + 1] == f"{name}_err"


def test_a_missing_column_is_no_silence():
    broken = row(1)
    del broken["pm_dec"]
    with pytest.raises(KeyError, match="pm_dec"):
        component_table([broken])


def test_meta_is_copied():
    meta = {"seed": 3}
    table = component_table([], meta=meta)
    table.meta["seed"] = 4
    assert meta == {"seed": 3}


def test_versions_name_what_the_numbers_depend_on():
    found = versions()
    assert set(found) >= {"astro_scc", "numpy", "scipy", "astropy", "scikit-image"}
    assert found["numpy"] == np.__version__
    assert all(isinstance(value, str) for value in found.values())


def test_a_package_without_metadata_has_an_unknown_version(monkeypatch):
    from importlib.metadata import PackageNotFoundError

    def missing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setitem(versions.__globals__, "version", missing)
    assert set(versions().values()) == {"unknown"}


# Of a measurement ----------------------------------------------------------------


def test_components_round_trip_in_ecsv(stacked, tmp_path):
    result = stacked(
        270 * u.deg, baseline=[20, 70] * u.day, min_error_beams=0.2, min_overlap=0.8
    )
    table = result.components
    assert len(table) > 0
    path = tmp_path / "components.ecsv"
    table.write(path)
    read = QTable.read(path)
    same(read, table)
    settings = read.meta["settings"]
    assert settings["max_speed"] == 30 * PM
    assert settings["scales"] == [1.0, 2.0]
    assert settings["position_angle"] == 270 * u.deg
    np.testing.assert_array_equal(
        settings["baseline"], ([20, 70] * u.day).to(u.yr), strict=False
    )
    assert read.meta["seed"] == 1
    assert read.meta["n_trials"] == 40
    assert read.meta["versions"] == versions()
    assert read.meta["jet_position_angle"] == 270 * u.deg
    # The settings are what a measurement can be repeated with.
    from astro_scc import StackedCrossCorrelation

    again = StackedCrossCorrelation(**settings)
    assert again.to_dict().keys() == settings.keys()


def test_components_in_c_round_trip_with_their_cosmology(sky_result, tmp_path):
    cosmology = FlatLambdaCDM(H0=71, Om0=0.27)
    table = sky_result.components_in_c(redshift=0.158, cosmology=cosmology)
    path = tmp_path / "components.ecsv"
    table.write(path)
    read = QTable.read(path)
    same(read, table)
    plain = read.meta["cosmology"]
    assert Cosmology.from_format(plain, format="mapping") == cosmology
    assert read.meta["redshift"] == 0.158


def test_no_components_round_trip_too(tmp_path):
    table = component_table([], meta={"seed": 1, "max_speed": 2 * PM})
    path = tmp_path / "components.ecsv"
    table.write(path)
    read = QTable.read(path)
    same(read, table)
    assert len(read) == 0
    assert read.meta == table.meta


def test_ssps_round_trip_in_ecsv(sky_result, tmp_path):
    table = sky_result.ssps
    path = tmp_path / "ssps.ecsv"
    table.write(path)
    same(QTable.read(path), table)
    path = tmp_path / "ssps.fits"
    table.meta = {}
    table.write(path)
    same(QTable.read(path, astropy_native=True), table)


def test_ssp_table_has_sky_positions_with_thermal_errors(sky_result):
    table, ssps, cube = sky_result.ssps, sky_result.matched.ssps, sky_result.cube
    assert len(table) == len(ssps) > 0
    x0, y0 = cube.reference_pixel
    np.testing.assert_allclose(
        table["east"].to_value(u.mas), -0.1 * (table["x"].value - x0), atol=1e-9
    )
    np.testing.assert_allclose(
        table["north"].to_value(u.mas), 0.1 * (table["y"].value - y0), atol=1e-9
    )
    # The beam is 1 mas wide and round (Fomalont 1999).
    expected = 1.0 / (np.sqrt(2) * table["snr"])
    np.testing.assert_allclose(table["east_err"].to_value(u.mas), expected)
    np.testing.assert_allclose(table["north_err"].to_value(u.mas), expected)
    assert set(np.unique(table["scale_size"].to_value(u.mas)).round(6)) == {0.2, 0.4}
    assert table["peak"].unit == table["coefficient_sum"].unit == cube.unit
    for epoch in range(len(cube)):
        dates = table["date"][table["epoch"] == epoch]
        assert isinstance(dates, Time)
        assert np.all(dates == cube.times[epoch])
    assert table["in_region"].all()
    np.testing.assert_array_equal(table["n_pixels"], np.diff(ssps.starts))
    near = np.hypot(
        (table["east_centroid"] - table["east"]).value,
        (table["north_centroid"] - table["north"]).value,
    )
    assert np.all(near < 2.0)


def test_ssp_table_says_which_were_used(sky_result):
    ssps, cube = sky_result.matched.ssps, sky_result.cube
    select = np.arange(len(ssps)) % 3 == 0
    np.testing.assert_array_equal(
        ssp_table(ssps, cube, select=select)["in_region"], select
    )


@pytest.mark.parametrize("beams", [True, False])
def test_an_empty_ssp_table_has_all_columns(sky_result, beams, tmp_path):
    from dataclasses import replace

    cube = sky_result.cube if beams else replace(sky_result.cube, beams=None)
    empty = ssp_table(SSPs.empty(), cube)
    assert len(empty) == 0
    assert empty.colnames == sky_result.ssps.colnames
    for name in empty.colnames:
        unit = getattr(sky_result.ssps[name], "unit", None)
        assert getattr(empty[name], "unit", None) == unit
    empty.write(tmp_path / "ssps.ecsv")
    assert QTable.read(tmp_path / "ssps.ecsv").colnames == empty.colnames
