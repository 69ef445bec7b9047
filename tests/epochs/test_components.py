# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable, Table
from astropy.time import Time

from astro_scc.epochs import ComponentList, read_components
from astro_scc.exceptions import EpochWarning


def columns(**changes):
    values = {
        "times": Time(["2006-07-01", "2006-01-01"]),
        "epoch": [0, 1, 1],
        "flux": [800, 1000, 500] * u.mJy,
        "east": [0.4, 0.0, 2.0] * u.mas,
        "north": [0.2, 0.0, 1.0] * u.mas,
        "major": [0.3, np.nan, 0.8] * u.mas,
        "minor": [0.3, np.nan, 0.4] * u.mas,
        "pa": [0, np.nan, 60] * u.deg,
        "feature": [1, 0, 1],
        "excluded": [True, False, False],
    }
    return {**values, **changes}


def mojave(**changes):
    """A table as MOJAVE's: positions from the core, the core's from the map."""
    values = {
        "epoch": ["2006-03-09", "2006-03-09", "2006-12-01", "2006-12-01"],
        "feature": [0, 1, 0, 2],
        "flux": [489.0, 7.2, 320.0, 20.9] * u.mJy,
        "separation": [0.5, 4.0, 1.0, 2.0] * u.mas,
        "position_angle": [270.0, 90.0, 0.0, 180.0] * u.deg,
        "major_fwhm": [0.2, np.nan, 0.4, 0.3] * u.mas,
        "axial_ratio": [0.5, np.nan, np.nan, 1.0],
        "major_pa": [292.0, np.nan, np.nan, np.nan] * u.deg,
        "excluded_from_fit": [False, True, False, False],
    }
    values = {**values, **changes}
    return QTable({k: v for k, v in values.items() if v is not None}, masked=True)


def write(table, path, **meta):
    table.meta.update(meta)
    table.write(path, format="ascii.ecsv", overwrite=True)
    return path


# The list itself --------------------------------------------------------------


def test_epochs_are_sorted_and_units_unified():
    components = ComponentList(**columns())
    assert list(components.times.isot) == [
        "2006-01-01T00:00:00.000",
        "2006-07-01T00:00:00.000",
    ]
    assert list(components.epoch) == [1, 0, 0]
    assert components.labels == ("2006-01-01", "2006-07-01")
    assert components.flux.unit == u.Jy
    assert components.major.value.tolist() == [0.3, 0.0, 0.8]
    assert components.pa.value.tolist() == [0, 0, 60]
    assert len(components) == 3
    assert "3 components at 2 epochs" in repr(components)
    arcsec = ComponentList(**columns(east=[0.4e-3, 0, 2e-3] * u.arcsec))
    np.testing.assert_allclose(arcsec.east.value, components.east.value)


def test_sizes_are_optional():
    components = ComponentList(
        **{k: columns()[k] for k in ("times", "epoch", "flux", "east", "north")}
    )
    assert not components.major.value.any()
    assert list(components.feature) == [-1, -1, -1]
    circles = ComponentList(**columns(minor=None))
    np.testing.assert_array_equal(circles.minor, circles.major)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"flux": [1, 2] * u.Jy}, "flux has shape"),
        ({"flux": [1, np.nan, 2] * u.Jy}, "component 2 of 3: flux is blank or not"),
        ({"east": [1, 1, np.inf] * u.mas}, "component 3 of 3: east is blank or not"),
        ({"minor": [0.4, 0, 0] * u.mas}, "component 1 of 3: axes must be"),
        ({"minor": [0.3, -1, 0] * u.mas}, "component 2 of 3: axes must be"),
        ({"epoch": [0, 1, 2]}, "indices into an array of times"),
        ({"times": Time("2006-01-01")}, "indices into an array of times"),
        ({"labels": ("one",)}, "2 epochs need 2 labels, got 1"),
    ],
)
def test_bad_lists(changes, message):
    with pytest.raises(ValueError, match=message):
        ComponentList(**columns(**changes))


def test_bad_unit():
    with pytest.raises(u.UnitConversionError):
        ComponentList(**columns(east=[1, 2, 3] * u.Jy))


def test_selection():
    components = ComponentList(**columns())
    assert list(components.select(before="2006-07-01").feature) == [0, 1]
    assert components.select(after=Time("2006-07-01")).labels == ("2006-07-01",)
    ones = components.select(features=[1])
    assert len(ones) == 2
    assert ones.n_epochs == 2
    kept = components.select(excluded=False)
    assert kept.n_epochs == 1
    assert list(kept.epoch) == [0, 0]
    with pytest.raises(ValueError, match="no component is left of 3 between"):
        components.select(after="2010-01-01")


def test_round_trip_through_ecsv(tmp_path):
    components = ComponentList(**columns(meta={"name": "3C 273", "redshift": 0.158}))
    path = write(components.to_table(), tmp_path / "list.ecsv")
    back = read_components(path)
    assert back.meta == {"object": "3C 273", "redshift": 0.158}
    assert np.all(back.times == components.times)
    for name in ("epoch", "feature", "excluded"):
        np.testing.assert_array_equal(getattr(back, name), getattr(components, name))
    for name in ("flux", "east", "north", "major", "minor", "pa"):
        np.testing.assert_allclose(getattr(back, name), getattr(components, name))


# Tables -----------------------------------------------------------------------


def test_mojave_table_about_the_core(tmp_path):
    path = write(mojave(), tmp_path / "t.ecsv", name="S4", frequency="15.4 GHz")
    components = read_components(path)
    np.testing.assert_allclose(components.east.value, [0, 4, 0, 0], atol=1e-12)
    np.testing.assert_allclose(components.north.value, [0, 0, 0, -2], atol=1e-12)
    np.testing.assert_allclose(components.major.value, [0.2, 0, 0.4, 0.3])
    np.testing.assert_allclose(components.minor.value, [0.1, 0, 0.4, 0.3])
    assert components.pa[0] == 292 * u.deg
    assert list(components.excluded) == [False, True, False, False]
    assert components.meta == {"object": "S4", "frequency": 15.4e9}


CARTESIAN = {
    "separation": None, "position_angle": None,
    "east": [1.0, 2.0, 3.0, 4.0] * u.mas, "north": [1.0, 2.0, 3.0, 4.0] * u.mas,
}  # fmt: skip
BLANK = {
    "separation": [np.nan, 4, 1, 2] * u.mas,
    "position_angle": [np.nan, 90, 0, 180] * u.deg,
}


@pytest.mark.parametrize(
    ("changes", "origin", "expected"),
    [
        ({}, "map", {"east": [-0.5, 3.5, 0, 0], "north": [0, 0, 1, -1]}),
        # A core without an offset is at the map's centre.
        (BLANK, "map", {"east": [0, 4, 0, 0]}),
        # Without features, separations are from the map's centre.
        ({"feature": None}, None, {"east": [-0.5, 4, 0, 0]}),
        ({"axial_ratio": None, "excluded_from_fit": None}, None,
         {"minor": [0.2, 0, 0.4, 0.3], "excluded": [0, 0, 0, 0]}),
        (CARTESIAN, None, {"east": [1, 2, 3, 4]}),
        (CARTESIAN, "core", {"east": [0, 1, 0, 1], "north": [0, 1, 0, 1]}),
    ],
)  # fmt: skip
def test_positions_and_sizes_by_what_the_table_has(tmp_path, changes, origin, expected):
    path = write(mojave(**changes), tmp_path / "t.ecsv")
    components = read_components(path, origin=origin)
    for name, values in expected.items():
        found = np.asarray(getattr(components, name), dtype=float)
        np.testing.assert_allclose(found, values, atol=1e-12)


def test_date_may_be_given(tmp_path):
    table = mojave(epoch=None, feature=None)
    path = write(table, tmp_path / "t.ecsv")
    components = read_components(path, dates="2010-01-01")
    assert components.n_epochs == 1
    assert components.labels == ("t.ecsv",)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"epoch": ["2006-03-09", "soon", "2006-12-01", "x"]}, "row 2: 'soon' is no"),
        ({"flux": None}, "no column for flux; the table has epoch"),
        ({"epoch": None}, "no column for epoch"),
        ({"separation": None}, "no column for separation"),
        ({"flux": [1.0, 2, 3, 4]}, "column 'flux' has no unit"),
        ({"flux": [1, 2, 3, 4] * u.mas}, "column 'flux' has the unit mas"),
        ({"flux": list("abcd")}, "column 'flux' is not numeric"),
        ({"flux": [1, 2, np.nan, 4] * u.Jy}, "component 3 of 4: flux is blank"),
        ({"separation": [1, np.nan, 1, 1] * u.mas}, "row 2: separation or position"),
        ({"feature": [0, np.nan, 0, 1.0]}, "component 2 of 4: feature is blank"),
        ({"feature": [0, 0, 0, 1]}, "2 core components .* on 2006-03-09"),
        ({"axial_ratio": [0.5, 1, 1, 1.5]}, "component 4 of 4: axes must be"),
        ({"source": ["a", "a", "b", "b"]}, "2 sources in the table"),
    ],
)
def test_bad_tables(tmp_path, changes, message):
    path = write(mojave(**changes), tmp_path / "t.ecsv")
    with pytest.raises(ValueError, match=f"t.ecsv.*{message}") as error:
        read_components(path)
    assert "\n" not in str(error.value)


def test_core_that_the_origin_needs(tmp_path):
    with pytest.raises(ValueError, match="no core component .* expected one"):
        read_components(model(tmp_path), origin="core")
    path = write(mojave(feature=[0, 1, 3, 2]), tmp_path / "t.ecsv")
    assert len(read_components(path)) == 4
    with pytest.raises(ValueError, match="no core component .* on 2006-12-01"):
        read_components(path, origin="map")


def test_empty_table(tmp_path):
    path = write(mojave()[:0], tmp_path / "t.ecsv")
    with pytest.raises(ValueError, match="no components in the file"):
        read_components(path)


def test_source_of_many(tmp_path):
    table = mojave(source=["a", "a", "b", "b"])
    path = write(table, tmp_path / "t.ecsv")
    components = read_components(path, source="b")
    assert components.meta["object"] == "b"
    assert components.n_epochs == 1
    with pytest.raises(ValueError, match="no source 'c'"):
        read_components(path, source="c")


MRT = """\
Title: Kinematics of made-up jets
Authors: Nobody N.
Table: Fitted jet features
================================================================================
Byte-by-byte Description of file: features.txt
--------------------------------------------------------------------------------
   Bytes Format Units  Label  Explanations
--------------------------------------------------------------------------------
   1-  8 A8     ---    Name   Source name, B1950
  10- 11 I2     ---    ID     Feature identification number
      13 A1     ---    f_ID   a = left out of the kinematic fit
  15- 24 A10    ---    Obs    Date of observation, UT
  26- 31 F6.1   mJy    Dens   Flux density at 15 GHz
  33- 36 F4.2   mas    Off    ? Position offset (3)
  38- 42 F5.1   deg    Ang    ? Position angle
  44- 47 F4.2   mas    Wid    ? FWHM major axis (4)
  49- 52 F4.2   ---    Rat    ? Axial ratio (4)
  54- 58 F5.1   deg    Ori    ? Major axis position angle
--------------------------------------------------------------------------------
0000+000  0   2006-03-09  489.0 0.04 290.7 0.23 0.33 292.0
0000+000  1 a 2006-03-09    7.2 3.98 121.8
0000+001  0   2006-03-10  100.0            0.10 1.00
0000+000  0   2006-12-01  320.0 0.10 308.1 0.25 0.29 295.0
0000+000  1   2006-12-01    4.8 3.65 121.8 1.63 1.00
"""


def test_machine_readable_table(tmp_path):
    path = tmp_path / "features.txt"
    path.write_text(MRT)
    components = read_components(path, source="0000+000")
    assert components.n_epochs == 2
    assert list(components.feature) == [0, 1, 0, 1]
    assert list(components.excluded) == [False, True, False, False]
    assert components.flux[0] == 0.489 * u.Jy
    assert components.major.value.tolist() == [0.23, 0, 0.25, 1.63]
    assert components.minor[0].value == pytest.approx(0.23 * 0.33)
    assert components.east[1].value == pytest.approx(3.98 * np.sin(np.radians(121.8)))
    assert components.meta["object"] == "0000+000"
    with pytest.raises(ValueError, match="2 sources in the table"):
        read_components(path)


#: As the journals print tables of jet features of many sources.
JOURNAL = """\
Title: Kinematics of made-up jets
Authors: Nobody N.
Table: Fitted Jet Features
================================================================================
Byte-by-byte Description of file: apjxxxxt4_mrt.txt
--------------------------------------------------------------------------------
   Bytes Format Units  Label  Explanations
--------------------------------------------------------------------------------
   1-  8 A8     ---    Name   Source name, B1950
  10- 11 I2     ---    ID     Feature identification number (1)
      13 A1     ---    f_ID   ? Flag (2)
  15- 18 I4     yr     Obs.Y  Year of observation, UT
  20- 21 I2     month  Obs.M  Month of observation, UT
  23- 24 I2     d      Obs.D  Day of observation, UT
  26- 31 F6.1   mJy    Dens   Flux density at 15 GHz
  33- 36 F4.2   mas    Off    ? Position offset (3)
  38- 42 F5.1   deg    Ang    ? Position angle
  44- 47 F4.2   mas    Wid    ? FWHM major axis (4)
  49- 52 F4.2   ---    Rat    ? Axial ratio (4)
  54- 58 F5.1   deg    Ori    ? Major axis position angle
--------------------------------------------------------------------------------
Note (1): Zero indicates the core feature.
Note (2): a = Individual feature epoch not used in kinematic fits.
Note (3): Offset from the core feature, that of the core itself from the map center.
--------------------------------------------------------------------------------
0000+000  0   2006  3  9  489.0 0.04 290.7 0.23 0.33 292.0
0000+000  1 a 2006  3  9    7.2 3.98 121.8
0000+001  0   2006  3 10  100.0            0.10 1.00
0000+000  0   2006 12  1  320.0 0.10 308.1 0.25 0.29 295.0
0000+000  1   2006 12  1    4.8 3.65 121.8 1.63 1.00
"""
COLUMNS = ("flux", "east", "north", "major", "minor", "pa", "feature", "excluded")


def test_dates_in_columns_of_year_month_and_day(tmp_path):
    (tmp_path / "whole.txt").write_text(MRT)
    (tmp_path / "parts.txt").write_text(JOURNAL)
    expected = read_components(tmp_path / "whole.txt", source="0000+000")
    found = read_components(tmp_path / "parts.txt", source="0000+000")
    assert list(found.times.isot) == list(expected.times.isot)
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert found.meta["object"] == "0000+000"
    with_names = JOURNAL.replace("I2     month", "A2     ---  ").replace(" 12 ", " De ")
    (tmp_path / "bad.txt").write_text(with_names)
    with pytest.raises(ValueError, match="bad.txt, row 3: '2006-De-01' is no date;"):
        read_components(tmp_path / "bad.txt", source="0000+000")


def test_tables_of_cds_have_their_description_beside_them(tmp_path):
    head, _, rows = JOURNAL.rpartition("-" * 80 + "\n")
    (tmp_path / "table4.dat").write_text(rows)
    with pytest.raises(OSError, match="table4.dat: has no byte-by-byte description;"):
        read_components(tmp_path / "table4.dat", source="0000+000")
    readme = head.replace("apjxxxxt4_mrt.txt", "table4.dat") + "-" * 80 + "\n"
    (tmp_path / "ReadMe").write_text(readme)
    (tmp_path / "whole.txt").write_text(JOURNAL)
    whole = read_components(tmp_path / "whole.txt", source="0000+000")
    parts = read_components(tmp_path / "table4.dat", source="0000+000")
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))


def test_sources_are_named_when_none_or_a_wrong_one_is_given(tmp_path):
    path = tmp_path / "t.txt"
    path.write_text(JOURNAL)
    with pytest.raises(ValueError, match=r"2 sources .*\(0000\+000, 0000\+001\)"):
        read_components(path)
    with pytest.raises(ValueError, match=r"'M87'; it has 0000\+000, 0000\+001"):
        read_components(path, source="M87")
    names = [f"{k:04d}+{k:03d}" for k in range(100, 130)]
    many = mojave(
        source=names, epoch=["2006-03-09"] * 30, feature=[0] * 30,
        flux=np.ones(30) * u.Jy, separation=np.zeros(30) * u.mas,
        position_angle=np.zeros(30) * u.deg, major_fwhm=None, axial_ratio=None,
        major_pa=None, excluded_from_fit=None,
    )  # fmt: skip
    path = write(many, tmp_path / "many.ecsv")
    with pytest.raises(ValueError, match=r"30 sources .*0107\+107 and 22 more\); say"):
        read_components(path)
    with pytest.raises(ValueError, match=r"'0129\+12'; did you mean 0129\+129"):
        read_components(path, source="0129+12")
    assert len(read_components(path, source="0129+129")) == 1


def test_a_file_of_another_source_is_refused(tmp_path):
    path = write(mojave(), tmp_path / "t.ecsv", name="3C 273", source="1226+023")
    for name in ("3C 273", "3c273", "1226+023"):
        assert read_components(path, source=name).n_epochs == 2
    with pytest.raises(ValueError, match=r"t.ecsv: .*'M87'; it has 1226\+023, 3C"):
        read_components(path, source="M87")
    plain = tmp_path / "source_2006-03-09.mod"
    plain.write_text("0.9 0.1 90\n")
    with pytest.raises(ValueError, match="09.mod: no source 'M87'; it does not say"):
        read_components(plain, source="M87")


def test_machine_readable_and_ecsv_agree(tmp_path):
    path = tmp_path / "features.txt"
    path.write_text(MRT)
    table = Table.read(path, format="ascii.mrt")
    table = table[table["Name"] == "0000+000"]
    table.write(tmp_path / "same.ecsv")
    one = read_components(path, source="0000+000")
    two = read_components(tmp_path / "same.ecsv")
    for name in ("flux", "east", "north", "major", "minor", "pa"):
        np.testing.assert_allclose(getattr(one, name), getattr(two, name))


def test_mojave_xviii(shared_data):
    folder = shared_data / "mojave_xviii"
    expected = {"1226+023": (105, 957), "1228+126": (37, 295)}
    for source, (n_epochs, n) in expected.items():
        components = read_components(folder / f"{source}.ecsv")
        assert (components.n_epochs, len(components)) == (n_epochs, n)
        core = components.feature == 0
        assert core.sum() == n_epochs
        assert not components.east[core].value.any()
        read_components(folder / f"{source}.ecsv", origin="map")


# difmap -----------------------------------------------------------------------

MODEL = """\
! Center RA: 12 29 06.6997,  Dec: +02 03 08.598 (2000.0)
! Established model.
! Flux (Jy) Radius (mas)  Theta (deg)  Major (mas)  Axial ratio   Phi (deg) T
  0.900v      0.10v         90.0v        0.20v        0.5          -20v      1
  0.100v      2.00v        -45.0v        0.30         1.0            0       0
! a clean component follows

 -0.001       1.0           0
"""


def model(tmp_path, text=MODEL, name="1226+023.u.2006_03_09.mod"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_difmap_model(tmp_path):
    components = read_components(model(tmp_path))
    assert components.times[0].isot.startswith("2006-03-09")
    assert components.labels == ("1226+023.u.2006_03_09.mod",)
    np.testing.assert_allclose(components.flux.value, [0.9, 0.1, -0.001])
    np.testing.assert_allclose(components.east.value, [0.1, -np.sqrt(2), 0], atol=1e-12)
    np.testing.assert_allclose(components.north.value, [0, np.sqrt(2), 1], atol=1e-12)
    np.testing.assert_allclose(components.major.value, [0.2, 0, 0])
    np.testing.assert_allclose(components.minor.value, [0.1, 0, 0])
    assert components.pa[0] == -20 * u.deg
    assert components.meta["position"].ra.deg == pytest.approx(187.27791542)


def test_difmap_models_of_many_epochs(tmp_path):
    paths = [
        model(tmp_path, name=name)
        for name in (
            "s_20070101.mod",
            "2005-489_2006-01-01.mod",
            "J1229.2006.06.05.mod",
        )
    ]
    components = read_components(paths)
    assert list(components.times.strftime("%Y-%m-%d")) == [
        "2006-01-01",
        "2006-06-05",
        "2007-01-01",
    ]
    given = read_components(paths, dates=["2001-01-01", "2002-01-01", "2003-01-01"])
    assert given.labels == tuple(p.name for p in paths)
    assert "position" in given.meta


def test_units_and_kinds_of_difmap(tmp_path):
    text = MODEL.replace("Radius (mas)", "Radius (arcsec)")
    components = read_components(model(tmp_path, text))
    assert components.east[0].value == pytest.approx(100)
    assert components.major[0].value == pytest.approx(200)
    # A size without a type is that of a Gaussian.
    components = read_components(model(tmp_path, "1 0 0 0.5 1 0\n"))
    assert components.major[0] == 0.5 * u.mas


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2\n", "line 1: expected 3, 6 or 7 finite values"),
        ("! x\n1 2 nan\n", "line 2: expected 3, 6 or 7 finite values"),
        ("1 2 many\n", "line 1: not numbers"),
        ("1 2 3 4 1 0 2\n", "row 1: component type 2 is neither"),
        ("1 2 3 4 1.5 0 1\n", "component 1 of 1: axes must be"),
        ("1 2 3 -4 1 0 1\n", "component 1 of 1: axes must be"),
        ("! nothing\n", "no components in the file"),
    ],
)
def test_bad_models(tmp_path, text, message):
    with pytest.raises(ValueError, match=f"2006_03_09.mod.*{message}"):
        read_components(model(tmp_path, text))


def test_model_without_a_date(tmp_path):
    with pytest.raises(ValueError, match="no date in the file's name"):
        read_components(model(tmp_path, name="jet.mod"))
    with pytest.raises(ValueError, match="'then' is no date"):
        read_components(model(tmp_path, name="jet.mod"), dates=["then"])


# AIPS -------------------------------------------------------------------------


def aips(path, *, tables=1, drop=(), units=True, header=None, **changes):
    mas = u.mas.to(u.deg)
    values = {
        "FLUX": [1.0, 0.5],
        "DELTAX": [0.0, -2 * mas],
        "DELTAY": [0.0, 1 * mas],
        "MAJOR AX": [0.0, 0.5 * mas],
        "MINOR AX": [0.0, 0.25 * mas],
        "POSANGLE": [0.0, 30.0],
        "TYPE OBJ": [0.0, 1.0],
        **changes,
    }
    unit = {"FLUX": "JY", "TYPE OBJ": "CODE"}
    hdus = [fits.PrimaryHDU()]
    keywords = {
        "OBJECT": "0506+056",
        "DATE-OBS": "2009-01-07",
        "CTYPE1": "RA---SIN",
        "CRVAL1": 77.0,
        "CTYPE2": "DEC--SIN",
        "CRVAL2": 5.0,
        **(header or {}),
    }
    hdus[0] = fits.PrimaryHDU(np.zeros((2, 2), np.float32))
    for key, value in keywords.items():
        if value is not None:
            hdus[0].header[key] = value
    for version in range(1, tables + 1):
        hdu = fits.BinTableHDU.from_columns(
            [
                fits.Column(
                    name=name,
                    format="1E",
                    unit=unit.get(name, "DEGREES") if units else None,
                    array=np.array(array) * (version if name == "FLUX" else 1),
                )
                for name, array in values.items()
                if name not in drop
            ],
            name="AIPS CC",
        )
        hdu.ver = version
        hdus.append(hdu)
    fits.HDUList(hdus).writeto(path)
    return path


def test_aips_table(tmp_path):
    components = read_components(aips(tmp_path / "a.fits", tables=2))
    # The highest version.
    np.testing.assert_allclose(components.flux.value, [2, 1])
    np.testing.assert_allclose(components.east.value, [0, -2])
    np.testing.assert_allclose(components.north.value, [0, 1])
    np.testing.assert_allclose(components.major.value, [0, 0.5])
    np.testing.assert_allclose(components.minor.value, [0, 0.25])
    np.testing.assert_allclose(components.pa.value, [0, 30])
    assert components.meta["object"] == "0506+056"
    assert components.meta["position"].ra.deg == 77
    assert components.times[0].isot.startswith("2009-01-07")


def test_aips_table_of_points(tmp_path):
    drop = ("MAJOR AX", "MINOR AX", "POSANGLE", "TYPE OBJ")
    components = read_components(aips(tmp_path / "a.fits", drop=drop, units=False))
    assert not components.major.value.any()


def test_aips_date_may_be_given(tmp_path):
    path = aips(tmp_path / "a.fits", header={"DATE-OBS": None, "CTYPE1": None})
    components = read_components(path, dates="2009-01-07")
    assert "position" not in components.meta
    same = read_components(path, dates=Time("2009-01-07"))
    assert same.times[0] == components.times[0]
    with pytest.raises(ValueError, match="no DATE-OBS in the header"):
        read_components(path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tables": 0}, "no AIPS CC table"),
        ({"drop": ("DELTAX",)}, "no column for position_angle, sep"),
        ({"FLUX": [1, np.nan]}, "component 2 of 2: flux is blank"),
        ({"TYPE OBJ": [0, 3]}, "row 2: component type 3"),
        ({"MINOR AX": [0, 1.0]}, "component 2 of 2: axes must be"),
        ({"header": {"DATE-OBS": "never"}}, "'never' is no date"),
    ],
)
def test_bad_aips_tables(tmp_path, options, message):
    path = aips(tmp_path / "a.fits", **options)
    with pytest.raises(ValueError, match=f"a.fits.*{message}"):
        read_components(path)


def test_aips_tables_that_are_empty_or_in_other_units(tmp_path):
    names = ("FLUX", "DELTAX", "DELTAY", "MAJOR AX", "MINOR AX", "POSANGLE", "TYPE OBJ")
    path = aips(tmp_path / "empty.fits", **{name: [] for name in names})
    with pytest.raises(ValueError, match="no components in the file"):
        read_components(path)
    path = aips(tmp_path / "a.fits")
    with fits.open(path, mode="update") as hdus:
        hdus[1].header["TUNIT2"] = "ARCSEC"
    with pytest.raises(ValueError, match="column 'DELTAX' has the unit ARCSEC"):
        read_components(path)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("t.ecsv", b"<html>not found</html>\n", "not a readable ascii.ecsv"),
        ("t.fits", b"SIMPLE = no\n", "not a readable FITS file"),
        ("t_2006-03-09.mod", b"\xff\xfe\x00", "it is not text"),
    ],
)
def test_files_of_something_else(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(OSError, match=f"{name}: .*{message}") as error:
        read_components(path)
    assert "\n" not in str(error.value)


def test_files_of_two_objects(tmp_path):
    one = aips(tmp_path / "a.fits")
    two = aips(
        tmp_path / "b.fits", header={"OBJECT": "3C 273", "DATE-OBS": "2010-01-01"}
    )
    with pytest.warns(EpochWarning, match="files are of 0506\\+056, 3C 273"):
        components = read_components([one, two])
    assert "object" not in components.meta


def test_mojave_images(shared_data):
    paths = sorted((shared_data / "0506+056").glob("*.fits"))
    components = read_components(paths)
    assert components.n_epochs == 3
    assert components.meta["object"] == "0506+056"


# Which reader -----------------------------------------------------------------


def test_format_by_name_or_by_word(tmp_path):
    path = model(tmp_path, name="2006-03-09.model")
    with pytest.raises(ValueError, match="the suffix '.model' tells no format"):
        read_components(path)
    assert len(read_components(path, format="difmap")) == 3
    with pytest.raises(ValueError, match="format = .wise. must be one of ecsv"):
        read_components(path, format="wise")


@pytest.mark.parametrize(
    ("paths", "options", "error", "message"),
    [
        ([], {}, OSError, "no files were given"),
        ("missing.ecsv", {}, OSError, "missing.ecsv: no such file"),
        ("a.mod", {"origin": "jet"}, ValueError, "origin = .jet. must be"),
        ("a.mod", {"dates": ["2006-01-01"] * 2}, ValueError, "2 dates for 1"),
    ],
)
def test_bad_arguments(tmp_path, monkeypatch, paths, options, error, message):
    model(tmp_path, name="a.mod")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=message):
        read_components(paths, **options)


def test_the_table_of_the_journal(shared_data):
    # Its label ID is the source, and F the feature.
    table = shared_data / "mojave_xviii" / "apjac230ft4_mrt.txt"
    found = read_components(table, source="0003+380")
    own = read_components(shared_data / "mojave_xviii" / "0003+380.ecsv")
    assert len(found.times) == len(own.times) == 10
    np.testing.assert_array_equal(found.feature, own.feature)
    np.testing.assert_array_equal(found.excluded, own.excluded)
    for name in ("flux", "east", "north", "major"):
        assert u.allclose(getattr(found, name), getattr(own, name))
    with pytest.raises(ValueError, match="67 sources in the table"):
        read_components(table)
