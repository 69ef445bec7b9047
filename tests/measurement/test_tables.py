# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tables that keep their columns and units, on disk too, and adjusted p-values."""

from dataclasses import replace
from importlib.metadata import PackageNotFoundError
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from astropy.time import Time
from astropy.utils.masked import Masked
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc import StackedCrossCorrelation
from astro_scc.columns import columns_of
from astro_scc.decomposition import SSPs
from astro_scc.kinematics import PositionAngleFrame, RadialFrame, SkyFrame
from astro_scc.measurement import false_discovery_rate
from astro_scc.measurement.tables import (
    component_table,
    components_of,
    paper_table,
    ssp_table,
    velocity_columns,
)
from astro_scc.products.publication import latex_texts_of
from astro_scc.quantities import decimals
from astro_scc.writing import versions

PM = u.mas / u.yr


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
    row = dict.fromkeys(columns_of("components"), 1.0) | {"kind": "few", "caution": "-"}
    meta = {"seed": 1, "max_speed": 2 * PM}
    table = component_table([row] * n, meta=meta)
    assert len(table) == n
    for name in table.colnames:
        assert table[name].info.description
        if name.startswith("pm") and "_pa" not in name:
            assert table[name].unit == PM
    assert table["pm_pa"].unit == table["pm_pa_err"].unit == u.deg
    assert table.meta == meta
    # A missing column is no silence.
    del row["pm_dec"]
    with pytest.raises(KeyError, match="pm_dec"):
        component_table([row])


def test_versions_name_what_the_numbers_depend_on(monkeypatch):
    found = versions()
    assert set(found) >= {"astro_scc", "numpy", "scipy", "astropy", "scikit-image"}
    assert found["numpy"] == np.__version__

    def missing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setitem(versions.__globals__, "version", missing)
    read = versions.__globals__["_versions"]
    read.cache_clear()
    assert set(versions().values()) == {"unknown"}
    read.cache_clear()


# Of a measurement ----------------------------------------------------------------


def test_tables_round_trip_and_their_settings_can_be_used_again(sky_result, tmp_path):
    for name, table in (("c", sky_result.components), ("s", sky_result.ssps)):
        table.write(tmp_path / f"{name}.ecsv")
        same(QTable.read(tmp_path / f"{name}.ecsv"), table)
    meta = QTable.read(tmp_path / "c.ecsv").meta
    assert (meta["seed"], meta["n_trials"]) == (1, 40)
    assert meta["versions"] == versions()
    again = StackedCrossCorrelation(**meta["settings"])
    assert again.to_dict() == sky_result.meta["settings"]


def test_printed_columns_are_rounded_to_their_errors(sky_result):
    table = sky_result.components
    least = table["pm_err"].value.min()
    digits = decimals(least)
    assert table["pm"].info.format == table["pm_err"].info.format == f".{digits}f"
    assert f"{least:.{digits}f}" in "".join(table["pm", "pm_err"].pformat())
    # The numbers are whole.
    assert table["pm"][0].value != round(table["pm"][0].value, digits)
    shown = table.pformat(max_width=80)[0].split()
    assert {"kind", "pm", "pm_err", "p_global"} <= {*shown}


def test_what_a_paper_table_cannot_know():
    table = QTable(
        {
            "feature": ["2001_s2", "50% & more"],
            "first": Time(["2001-01-01", "2002-05-01"]),
            "pm": [2.128, np.nan] * u.mas / u.yr,
            "pm_err": [np.nan, np.nan] * u.mas / u.yr,
            "t_ej": Masked([2000.12, 0.0] * u.yr, mask=[False, True]),
            "t_ej_err": Masked([0.1, 0.0] * u.yr, mask=[False, True]),
            "r_min": [-3.14159, 20.0] * u.mas,
        }
    )
    plain = paper_table(table)
    assert plain.colnames == ["feature", "r_min", "first", "pm", "t_ej"]
    assert list(plain["pm"]) == ["2.13 (error unknown)", "-"]
    rows = latex_texts_of(table, "tracks")["aastex"].splitlines()
    assert rows[rows.index(r"\startdata") + 1 : rows.index(r"\enddata")] == [
        r"2001\_s2 & $-3.142$ & 2001-01-01 & $2.13 \pm \ldots$ & $2000.12 \pm 0.10$ \\",
        r"50\% \& more & 20 & 2002-05-01 & \nodata & \nodata",
    ]


def test_ssp_table_has_sky_positions_with_thermal_errors(sky_result):
    table, ssps, cube = sky_result.ssps, sky_result.matched.ssps, sky_result.cube
    assert len(table) == len(ssps) > 0
    x0, y0 = cube.reference_pixel
    for end in ("", "_centroid"):
        x, y = getattr(ssps, f"x{end}"), getattr(ssps, f"y{end}")
        east, north = table[f"east{end}"].value, table[f"north{end}"].value
        np.testing.assert_allclose(east, -0.1 * (x - x0), atol=1e-9)
        np.testing.assert_allclose(north, 0.1 * (y - y0), atol=1e-9)
    # The beam is 1 mas wide and round (Fomalont 1999).
    expected = 1.0 / (np.sqrt(2) * table["snr"])
    np.testing.assert_allclose(table["east_err"].to_value(u.mas), expected)
    np.testing.assert_allclose(table["north_err"].to_value(u.mas), expected)
    sizes = np.unique(table["scale_size"].to_value(u.mas))
    np.testing.assert_allclose(sizes, [0.2, 0.4, 0.8])
    assert table["peak"].unit == table["coefficient_sum"].unit == cube.unit
    for epoch in range(len(cube)):
        dates = table["date"][table["epoch"] == epoch]
        assert isinstance(dates, Time)
        assert np.all(dates == cube.times[epoch])
    np.testing.assert_array_equal(table["n_pixels"], np.diff(ssps.starts))
    select = np.arange(len(ssps)) % 3 == 0
    np.testing.assert_array_equal(
        ssp_table(replace(sky_result.matched, select=select))["in_region"], select
    )


@pytest.mark.parametrize("beams", [True, False])
def test_an_empty_ssp_table_has_all_columns(sky_result, beams):
    cube = sky_result.cube if beams else replace(sky_result.cube, beams=None)
    none = {"ssps": SSPs.empty(), "select": np.zeros(0, bool)}
    empty = ssp_table(replace(sky_result.matched, cube=cube, **none))
    assert len(empty) == 0
    assert empty.colnames == sky_result.ssps.colnames
    for name in empty.colnames:
        unit = getattr(sky_result.ssps[name], "unit", None)
        assert getattr(empty[name], "unit", None) == unit


# Vectors -------------------------------------------------------------------------

speeds, errors = st.floats(-5, 5), st.floats(0.01, 2)
correlations = st.floats(-0.95, 0.95)


@given(speeds, speeds, errors, errors, correlations, st.floats(-360, 360))
def test_on_the_sky_frame(east, north, err1, err2, correlation, pa):
    covariance = np.diag([err1, err2])
    covariance = covariance @ [[1, correlation], [correlation, 1]] @ covariance
    row = velocity_columns(np.array([east, north]), covariance, SkyFrame(), pa * u.deg)
    assert (row["pm_ra_cosdec"], row["pm_dec"]) == pytest.approx((east, north))
    assert row["pm_ra_cosdec_err"] == pytest.approx(err1)
    assert row["pm_dec_err"] == pytest.approx(err2)
    assert row["pm"] == pytest.approx(np.hypot(east, north))
    along = np.array([np.sin(np.radians(pa)), np.cos(np.radians(pa))])
    across = np.array([along[1], -along[0]])
    for name, axis in (("parallel", along), ("transverse", across)):
        assert row[f"pm_{name}"] == pytest.approx(
            axis @ [east, north], rel=1e-9, abs=1e-9
        )
        assert row[f"pm_{name}_err"] == pytest.approx(
            np.sqrt(axis @ covariance @ axis), rel=1e-6
        )
    assert 0 <= row["pm_pa"] <= 360
    if row["pm"] > 1e-6:
        pa = np.radians(row["pm_pa"])
        np.testing.assert_allclose(
            (np.sin(pa), np.cos(pa)), np.array([east, north]) / row["pm"], atol=1e-9
        )
        unit = np.array([east, north]) / row["pm"]
        turned = np.array([-unit[1], unit[0]])
        assert row["pm_err"] == pytest.approx(np.sqrt(unit @ covariance @ unit))
        sigma = np.sqrt(turned @ covariance @ turned) / row["pm"]
        assert row["pm_pa_err"] == pytest.approx(min(np.degrees(sigma), 180.0))


@pytest.mark.parametrize("unknown", [np.inf, np.nan])
def test_errors_that_are_not_known_are_nan_and_the_velocity_is_not(unknown):
    covariance = np.diag([unknown, unknown])
    row = velocity_columns(np.array([3.0, 4.0]), covariance, SkyFrame(), 65 * u.deg)
    assert row["pm"] == pytest.approx(5.0)
    for name, value in row.items():
        assert np.isnan(value) == name.endswith("_err")


# Features and their components -----------------------------------------------------


def motion(velocity, place=(3.0, 0.0), error=0.05):
    speed = float(np.hypot(*velocity))
    return SimpleNamespace(
        velocity=np.array(velocity), velocity_err=np.full(2, error), speed=speed,
        speed_err=error, place=np.array(place),
    )  # fmt: skip


class Moving(list):
    """Features of which only the motions are known, with two detections each."""

    @property
    def motions(self):
        return self

    @property
    def tracks(self):
        return [SimpleNamespace(detection=[2 * k, 2 * k + 1]) for k in range(len(self))]


def part(track=None):
    """A chain of matches, or a feature that was followed."""
    detection = () if track is None else (2 * track, 2 * track + 1)
    return SimpleNamespace(detection=detection, followed=track is not None)


def streams(*each, frame):
    """A result with components: kind, velocity, dispersion and, if given, features."""
    made = [
        (
            SimpleNamespace(
                kind=kind, angle=np.arctan2(*velocity[::-1]), features=own or [part()]
            ),
            SimpleNamespace(
                value=np.array(velocity), covariance=np.diag([0.03, 0.03]) ** 2,
                dispersion=dispersion,
            ),
        )
        for kind, velocity, dispersion, *own in each
    ]  # fmt: skip
    own, velocities = zip(*made, strict=True)
    search = SimpleNamespace(streams=own)
    return SimpleNamespace(search=search, velocities=velocities, frame=frame)


ALONG = (
    ("moving", (2.0, 0.0), 0.3),
    ("moving", (4.0, 0.0), np.nan),
    ("stationary", (0.0, 0.0), np.nan),
    ("not significant", (8.0, 0.0), np.nan),
)


@pytest.mark.parametrize(
    ("velocity", "component"),
    [
        ((2.5, 0.0), 1),  # within the dispersion
        ((2.0, 0.1), 1),
        ((2.0, 0.5), 1),  # which is that across as well
        ((2.0, 0.7), 0),
        ((2.7, 0.0), 0),
        ((4.1, 0.0), 2),
        ((4.2, 0.0), 0),
        ((0.05, 0.05), 3),
        ((0.11, 0.11), 0),  # within two errors on both axes, but it moves
        ((8.0, 0.0), 0),
    ],
)
def test_a_feature_is_of_the_component_with_its_velocity(velocity, component):
    speed, across = velocity
    sky = SkyFrame(), motion((speed, across))
    west = PositionAngleFrame(270 * u.deg), motion((-speed, across))
    # At north of the origin, a radial motion is to the north.
    radial = RadialFrame(), motion((across, speed), place=(0.0, 5.0))
    for frame, own in (sky, west, radial):
        result = streams(*ALONG, frame=frame)
        assert components_of(result, Moving([own])).tolist() == [component]


def test_the_nearest_component_in_units_of_the_errors():
    wide, narrow = ("moving", (2.0, 0.0), 1.0), ("moving", (3.0, 0.0), 0.0)
    result = streams(wide, narrow, frame=SkyFrame())
    slow, fast = motion((2.85, 0.0)), motion((3.02, 0.0))
    assert components_of(result, Moving([slow, fast])).tolist() == [1, 2]


def test_features_that_make_a_stream_are_of_it_and_others_are_not():
    features = [motion((v, 0.0)) for v in (2.9, 2.0, 4.0, 4.0)]
    slow = "moving", (2.0, 0.0), 0.3, part(0)
    fast = "moving", (4.0, 0.0), 0.3, part(3), part()
    result = streams(slow, fast, frame=SkyFrame())
    # A chain of the second stream may be the third feature.
    assert components_of(result, Moving(features)).tolist() == [1, 0, 2, 2]


# Adjusted p-values ----------------------------------------------------------------


def table(p, **columns):
    return QTable({"p_global": np.array(p, dtype=float), **columns})


def by_definition(p, method):
    """The smallest rate at which the procedure would accept each of them."""
    p = np.asarray(p)
    m = len(p)
    factor = m * (sum(1 / k for k in range(1, m + 1)) if method == "by" else 1.0)
    adjusted = []
    for own in p:
        candidates = [
            factor * other / np.sum(p <= other) for other in p if other >= own
        ]
        adjusted.append(min(1.0, *candidates, np.inf))
    return adjusted


probabilities = st.lists(
    st.integers(1, 40).map(lambda b: b / 40), min_size=1, max_size=9
)


@settings(max_examples=60, deadline=None)
@given(groups=st.lists(probabilities, min_size=1, max_size=4), by=st.booleans())
def test_is_the_procedure_over_all_tables_together(groups, by):
    method = "by" if by else "bh"
    done = false_discovery_rate([table(p) for p in groups], method=method)
    got = np.concatenate([t["p_fdr"] for t in done])
    p = np.concatenate(groups)
    np.testing.assert_allclose(got, by_definition(p, method), rtol=1e-12)
    assert np.all((got >= p - 1e-12) & (got <= 1))


def test_empty_tables_are_searches_and_what_stands_still_is_none():
    own = {"a": table([0.01, 1.0], kind=["moving", "stationary"]), "b": table([0.02])}
    own |= {f"none {k}": component_table([]) for k in range(18)}
    once = false_discovery_rate(own)
    assert once["a"]["p_fdr"].tolist() == pytest.approx([0.2, 1.0])
    assert once["b"]["p_fdr"].tolist() == pytest.approx([0.2])
    assert once["a"].meta["false_discovery"] == {"method": "bh", "n_tests": 20}
    empty = once["none 1"]
    assert len(empty) == 0
    assert empty["p_fdr"].dtype == float
    assert empty["p_fdr"].info.description
    # They are copies, and can be adjusted again.
    twice = false_discovery_rate(once)
    assert own["b"].colnames == ["p_global"]
    assert once["b"].colnames == twice["b"].colnames == ["p_global", "p_fdr"]
    np.testing.assert_array_equal(once["b"]["p_fdr"], twice["b"]["p_fdr"])
    assert false_discovery_rate([]) == []


@pytest.mark.parametrize(
    ("tables", "method", "words"),
    [
        (table([0.1]), "bh", r"got one: give \[table\]"),
        ([table([0.1]), QTable()], "bh", "table 1 has no column p_global"),
        ({"inner": table([np.nan])}, "bh", "'inner': p_global must be from 0 to 1"),
        ([], "bonferroni", "unknown method 'bonferroni': use 'bh' or"),
    ],
)
def test_says_what_is_wrong(tables, method, words):
    with pytest.raises((TypeError, ValueError), match=words):
        false_discovery_rate(tables, method=method)
