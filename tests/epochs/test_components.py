# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Lists of model components: their files, sources by their names, and images."""

import warnings

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import FK4, SkyCoord
from astropy.io import fits
from astropy.table import QTable
from astropy.time import Time
from astropy.utils.masked import Masked
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from astro_scc import Beam, EpochCube
from astro_scc.epochs import ComponentList, inspect_epochs, read_components, restore
from astro_scc.epochs.inspection import kind_of
from astro_scc.epochs.lists import read_sources
from astro_scc.epochs.restoring import add_gaussians, correlated_noise
from astro_scc.epochs.tables import place_of, same_source, source_list
from astro_scc.exceptions import EpochWarning

BEAM = Beam(1.0 * u.mas, 0.5 * u.mas, -7 * u.deg)
COLUMNS = ("flux", "east", "north", "major", "minor", "pa", "feature")
MAS = u.mas.to(u.deg)


def columns(**changes):
    values = {
        "times": Time(["2006-07-01", "2006-01-01"]), "epoch": [0, 1, 1],
        "flux": [800, 1000, 500] * u.mJy, "feature": [1, 0, 1],
        "east": [0.4, 0.0, 2.0] * u.mas, "north": [0.2, 0.0, 1.0] * u.mas,
        "major": [0.3, np.nan, 0.8] * u.mas, "minor": [0.3, np.nan, 0.4] * u.mas,
        "pa": [0, np.nan, 60] * u.deg,
    }  # fmt: skip
    return {**values, **changes}


def mojave(**changes):
    """A table as MOJAVE's: positions from the core, the core's from the map."""
    nan = np.nan
    values = {
        "epoch": ["2006-03-09", "2006-03-09", "2006-12-01", "2006-12-01"],
        "feature": [0, 1, 0, 2], "flux": [489.0, 7.2, 320.0, 20.9] * u.mJy,
        "separation": [0.5, 4.0, 1.0, 2.0] * u.mas, "axial_ratio": [0.5, nan, nan, 1.0],
        "position_angle": [270.0, 90.0, 0.0, 180.0] * u.deg,
        "major_fwhm": [0.2, nan, 0.4, 0.3] * u.mas, "major_pa": [292, nan, nan, nan]
        * u.deg, **changes,
    }  # fmt: skip
    return QTable({k: v for k, v in values.items() if v is not None}, masked=True)


def write(table, path, **meta):
    table.meta.update(meta)
    table.write(path, format="ascii.ecsv", overwrite=True)
    return path


def test_epochs_are_sorted_units_unified_sizes_optional_and_some_selected(tmp_path):
    wide = Beam(2 * u.mas, 1 * u.mas)
    components = ComponentList(**columns(beams=[BEAM, wide]))
    assert components.epoch.tolist() == [1, 0, 0]
    assert components.labels == ("2006-01-01", "2006-07-01")
    assert components.beams == (wide, BEAM)
    assert components.flux.unit == u.Jy
    assert components.major.value.tolist() == [0.3, 0.0, 0.8]
    assert "3 components at 2 epochs" in repr(components)
    assert components.select(before="2006-07-01").feature.tolist() == [0, 1]
    last = components.select(after=Time("2006-07-01"))
    assert (last.labels, last.beams, *last.epoch) == (("2006-07-01",), (BEAM,), 0)
    with pytest.raises(ValueError, match="no component is left of 3 between"):
        components.select(after="2010-01-01")
    # There and back.
    own = ComponentList(**columns(meta={"name": "Jet"}, beams=BEAM, minor=None))
    back = read_components(write(own.to_table(), tmp_path / "list.ecsv"))
    assert (back.meta, back.beams) == ({"object": "Jet"}, own.beams)
    assert np.all(back.times == own.times)
    for name in ("epoch", *COLUMNS):
        assert_allclose(getattr(back, name), getattr(own, name), rtol=1e-12)


def test_bad_lists():
    for changes, message in [
        ({"flux": [1, 2] * u.Jy}, "flux has shape"),
        ({"flux": [1, np.nan, 2] * u.Jy}, "component 2 of 3: flux is blank or not"),
        ({"minor": [0.3, -1, 0] * u.mas}, "component 2 of 3: axes must be"),
        ({"epoch": [0, 1, 2]}, "indices into an array of times"),
        ({"east": [1, 2, 3] * u.Jy}, "not convertible"),
    ]:
        with pytest.raises((ValueError, u.UnitConversionError), match=message):
            ComponentList(**columns(**changes))


CARTESIAN = {
    "separation": None, "position_angle": None,
    "east": [1.0, 2.0, 3.0, 4.0] * u.mas, "north": [1.0, 2.0, 3.0, 4.0] * u.mas,
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "origin", "expected"),
    [
        ({}, None,
         {"east": [0, 4, 0, 0], "north": [0, 0, 0, -2], "major": [0.2, 0, 0.4, 0.3],
          "minor": [0.1, 0, 0.4, 0.3], "pa": [292, 0, 0, 0]}),
        ({}, "map", {"east": [-0.5, 3.5, 0, 0], "north": [0, 0, 1, -1]}),
        # Without features, separations are from the map's centre.
        ({"feature": None}, None, {"east": [-0.5, 4, 0, 0]}),
        ({"axial_ratio": None}, None, {"minor": [0.2, 0, 0.4, 0.3]}),
        (CARTESIAN, "core", {"east": [0, 1, 0, 1], "north": [0, 1, 0, 1]}),
        ({"RA_offset": [0, 1, 0, 2] * u.mas, "Dec_offset": [0, 3, 0, 4] * u.mas}, None,
         {"east": [0, 1, 0, 2], "north": [0, 3, 0, 4]}),
        ({"epoch": Time([53803, 53803, 54070, 54070], format="mjd"),
          "feature": ["C", "C3", "C", "C2"]}, None, {"feature": [0, 3, 0, 2]}),
        ({"feature": ["core", "B", "core", "C"]}, None, {"feature": [0, 1, 0, 2]}),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore:.*has names, which are numbered. B is 1, C is 2")
def test_positions_and_sizes_by_what_the_table_has(tmp_path, changes, origin, expected):
    path = tmp_path / "t.ecsv"
    write(mojave(**changes), path, name="S4", frequency="15.4 GHz")
    components = read_components(path, origin=origin)
    for name, values in expected.items():
        found = np.asarray(getattr(components, name), dtype=float)
        assert_allclose(found, values, atol=1e-12)
    assert components.meta == {"object": "S4", "frequency": 15.4e9}


@pytest.mark.parametrize("of_map", [0, 1])
def test_positions_of_the_map_are_told_from_those_of_the_core(tmp_path, of_map):
    core = np.array([0.3, -0.2, 0.1, 0.4, -0.3])
    table = QTable(
        {"epoch": np.repeat(np.arange(2001, 2006), 2), "feature": [0, 1] * 5}
    )
    table["flux"], table["position_angle"] = np.ones(10) * u.Jy, np.full(10, 90) * u.deg
    places = np.stack([core, np.arange(5) + of_map * core], axis=1)
    table["separation"] = places.ravel() * u.mas
    with warnings.catch_warnings(record=True, action="always") as said:
        read_components(write(table, tmp_path / "t.ecsv"))
    assert ["seem to be from the" in str(w.message) for w in said] == [True] * of_map


def test_bad_tables(tmp_path):
    for changes, options, message in [
        ({"epoch": ["2006-03-09", "soon", "2006-12-01", "x"]}, {}, "row 2: 'soon' is"),
        ({"epoch": None, "flux": None}, {}, "no column for 'epoch', 'flux'; the"),
        ({"separation": None}, {}, "'separation' .or 'east', 'north'.; the table"),
        ({"flux": [1.0, 2, 3, 4]}, {}, "column 'flux' has no unit"),
        ({"flux": [1, 2, 3, 4] * u.mas}, {}, "column 'flux' has the unit mas"),
        ({"flux": [1, 2, np.inf, 4] * u.Jy}, {}, "row 3: flux is infinite"),
        ({"separation": [1, np.nan, 1, 1] * u.mas}, {}, "row 2: 'separation' or 'posi"),
        ({"separation": np.ones((4, 2)) * u.mas}, {}, "has several numbers in a row"),
        ({"feature": [0, 1.5, 0, 1]}, {}, "row 2: feature is 1.5, expected a whole"),
        ({"epoch": Time(["2006-03-09"] * 4, scale="local")}, {}, "write it in UTC"),
        ({"feature": [0, 0, 0, 1]}, {}, "2 core components .* on 2006-03-09"),
        ({"feature": [0, 1, 3, 2]}, {"origin": "map"}, "no core component .* 2006-12"),
        ({"source": ["a", "a", "b", "b"]}, {"source": "M87"}, "'M87'; it has a, b"),
        ({}, {"origin": "jet"}, "origin = .jet. must be"),
        ({}, {"dates": ["then"]}, "dates: 'then' is no date"),
    ]:
        path = write(mojave(**changes), tmp_path / "t.ecsv")
        with pytest.raises(ValueError, match=message) as error:
            read_components(path, **options)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(("name", "dates"), [
    ("epoch", [2006.5, 2006.25, 2006.1234, 2010.0]), ("JD", [2454000.5] * 4),
    ("MJD", [53800, 53800, 54070, 54070]), ("epoch", [20060309] * 4),
])  # fmt: skip
def test_dates_that_are_numbers(tmp_path, name, dates):
    table = mojave(**{"epoch": None, "feature": [0, 1, 2, 3], name: dates})
    found = read_components(write(table, tmp_path / "t.ecsv"))
    form = {"JD": "jd", "MJD": "mjd"}.get(name, "jyear")
    days = dates if dates[0] < 2e7 else [2006.1841] * 4
    times = np.unique(Time(days, format=form).jyear)
    assert_allclose(found.times.jyear, times, atol=1e-3)
    with pytest.raises(ValueError, match="row 1: '1' is no date"):
        read_components(write(mojave(epoch=[1, 2, 3, 4]), tmp_path / "t.ecsv"))


#: As the journals print tables of jet features of many sources.
JOURNAL = """\
Title: Kinematics of made-up jets
================================================================================
Byte-by-byte Description of file: table4.dat
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
0000+000  0   2006  3  9  489.0 0.04 290.7 0.23 0.33 292.0
0000+000  1 a 2006  3  9    7.2 3.98 121.8
0000+001  0   2006  3 10  100.0            0.10 1.00
0000+000  0   2006 12  1  320.0 0.10 308.1 0.25 0.29 295.0
0000+000  1   2006 12  1    4.8 3.65 121.8 1.63 1.00
"""


def test_machine_readable_tables_with_their_description_or_beside_it(tmp_path):
    (tmp_path / "features.txt").write_text(JOURNAL)
    components = read_components(tmp_path / "features.txt", source="0000+000")
    assert components.labels == ("2006-03-09", "2006-12-01")
    assert components.feature.tolist() == [0, 1, 0, 1]
    assert components.major.value.tolist() == [0.23, 0, 0.25, 1.63]
    assert components.east[1].value == pytest.approx(3.98 * np.sin(np.radians(121.8)))
    # As CDS keeps them.
    head, line, rows = JOURNAL.rpartition("-" * 80 + "\n")
    (tmp_path / "table4.dat").write_text(rows)
    with pytest.raises(OSError, match="table4.dat: has no byte-by-byte description;"):
        read_components(tmp_path / "table4.dat", source="0000+000")
    (tmp_path / "ReadMe").write_text(head + line)
    parts = read_components(tmp_path / "table4.dat", source="0000+000")
    for name in COLUMNS:
        assert_array_equal(getattr(parts, name), getattr(components, name))


def test_mojave_xviii(shared_data):
    folder = shared_data / "mojave_xviii"
    own = read_components(folder / "0003+380.ecsv")
    core = own.feature == 0
    assert core.sum() == own.n_epochs == 10
    assert not own.east[core].value.any()
    # Its label ID is the source, and F the feature.
    found = read_components(folder / "apjac230ft4_mrt.txt", source="0003+380")
    for name in COLUMNS:
        assert u.allclose(getattr(found, name), getattr(own, name))


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
    assert components.labels == ("1226+023.u.2006_03_09.mod",)
    expected = {
        "flux": [0.9, 0.1, -0.001], "east": [0.1, -np.sqrt(2), 0], "pa": [-20, 0, 0],
        "north": [0, np.sqrt(2), 1], "major": [0.2, 0, 0], "minor": [0.1, 0, 0],
    }  # fmt: skip
    for name, values in expected.items():
        assert_allclose(getattr(components, name).value, values, atol=1e-12)
    assert components.meta["position"].ra.deg == pytest.approx(187.27791542)
    text = MODEL.replace("Radius (mas)", "Radius (arcsec)")
    assert read_components(model(tmp_path, text)).east[0] == 100 * u.mas
    # A size without a type is that of a Gaussian.
    path = model(tmp_path, "1 0 0 0.5 1 0\n", "2006-03-09.mod")
    assert read_components(path).major[0] == 0.5 * u.mas
    names = "s_20070101.mod", "2005-489_2006-01-01.mod", "J1229.2006.06.05.mod"
    paths = [model(tmp_path, name=name) for name in names]
    days = read_components(paths).times.strftime("%Y-%m-%d").tolist()
    assert days == ["2006-01-01", "2006-06-05", "2007-01-01"]


NAME = "1226+023.u.2006_03_09.mod"
BAD = [
    (NAME, b"1 2\n", "line 1: expected 3, 6 or 7 finite values"),
    (NAME, b"1 2 3 4 1 0 2\n", "row 1: component type 2 is neither"),
    (NAME, b"1 2 many\n", "line 1: not numbers"),
    (NAME, b"! nothing\n", "no components in the file"),
    (NAME, b"\xff\xfe\x00", "it is not text"),
    ("jet.mod", b"1 2 3\n", "no date in a name like .*.mod; write"),
    ("jet.model", b"1 2 3\n", "its suffix is none of .ecsv, .*; rename it"),
    ("t.fits", b"SIMPLE = no\n", "cannot be read as FITS"),
    ("t.ecsv", b"<html>not found</html>\n", "not a readable ascii.ecsv"),
]


@pytest.mark.parametrize(("name", "content", "message"), BAD)
def test_bad_files(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises((ValueError, OSError), match=message) as error:
        read_components(tmp_path / name)
    assert str(error.value).startswith(str(tmp_path / name))
    assert "\n" not in str(error.value)


def aips(path, *, tables=1, header=None):
    values = {
        "FLUX": [1.0, 0.5], "DELTAX": [0.0, -2 * MAS], "DELTAY": [0.0, 1 * MAS],
        "MAJOR AX": [0.0, 0.5 * MAS], "MINOR AX": [0.0, 0.25 * MAS],
        "POSANGLE": [0.0, 30.0], "TYPE OBJ": [0.0, 1.0],
    }  # fmt: skip
    unit = {"FLUX": "JY", "TYPE OBJ": "CODE"}
    keywords = {
        "OBJECT": "0506+056", "DATE-OBS": "2009-01-07", "CTYPE1": "RA---SIN",
        "CRVAL1": 77.0, "CTYPE2": "DEC--SIN", "CRVAL2": 5.0, "CDELT1": -1e-7,
        "CDELT2": 1e-7, **(header or {}),
    }  # fmt: skip
    hdus = [fits.PrimaryHDU(np.zeros((2, 2), np.float32))]
    hdus[0].header.update({k: v for k, v in keywords.items() if v is not None})
    for version in range(1, tables + 1):
        made = [
            fits.Column(name, "1E", unit=unit.get(name, "DEGREES"),
                        array=np.array(array) * (version if name == "FLUX" else 1))
            for name, array in values.items()
        ]  # fmt: skip
        hdus.append(fits.BinTableHDU.from_columns(made, name="AIPS CC", ver=version))
    fits.HDUList(hdus).writeto(path)
    return path


def test_aips_table(tmp_path):
    components = read_components(aips(tmp_path / "a.fits", tables=2))
    expected = {  # of the highest version
        "flux": [2, 1], "east": [0, -2], "north": [0, 1], "major": [0, 0.5],
        "minor": [0, 0.25], "pa": [0, 30],
    }  # fmt: skip
    for name, values in expected.items():
        assert_allclose(getattr(components, name).value, values)
    assert components.meta["position"].ra.deg == 77
    other = {"OBJECT": "Jet", "DATE-OBS": "2010-01-07"}
    other = aips(tmp_path / "b.fits", header=other)
    with pytest.warns(EpochWarning, match=r"files are of 0506\+056, Jet"):
        assert "object" not in read_components([tmp_path / "a.fits", other]).meta
    # Where there is no image, components are restored.
    with fits.open(tmp_path / "a.fits") as hdus:
        assert kind_of(tmp_path / "a.fits") == "images"
        hdus[0].data = None
        hdus.writeto(tmp_path / "list.fits")
    assert kind_of(tmp_path / "list.fits") == "components"


def test_lists_that_cannot_be_images(tmp_path, make_fits):
    models = [model(tmp_path, name=f"s_2006-0{month}-09.mod") for month in (3, 9)]
    image = make_fits()
    beside = aips(tmp_path / "image.fits", header={"CTYPE1": None})
    negative = model(tmp_path, "-0.1v 1v 0v 0.2v 1 0 1\n", "n_2006-09-09.mod")
    calls = [
        (models, None, r"09.mod: is a list of components without a beam .*; give --be"),
        (beside, None, r"image.fits: .*coordinates"),
        ([image, *models], None, r"09.mod: is a list of components and no im"),
        ([*models, image], BEAM, r"a.fits: no AIPS CC table .* leave it out"),
        (negative, BEAM, r"09-09.mod: no component is positive; leave"),
    ]
    for paths, beams, words in calls:
        with pytest.raises(ValueError, match=words):
            EpochCube.read(paths, beams=beams)
    problems = inspect_epochs([image, *models])["problem"]
    assert sum("give lists alone to astro-scc measure" in p for p in problems) == 2


def test_visibilities(tmp_path):
    data = fits.GroupData(
        np.ones((5, 1, 1, 1, 1, 1, 3), "f4"), bitpix=-32, parnames=["UU", "VV"],
        pardata=[np.ones(5)] * 2,
    )  # fmt: skip
    fits.GroupsHDU(data).writeto(tmp_path / "a.uvf")
    idi = fits.BinTableHDU.from_columns([fits.Column("FLUX", "E")], name="UV_DATA")
    fits.HDUList([fits.PrimaryHDU(), idi]).writeto(tmp_path / "a.idifits")
    for own in tmp_path.iterdir():
        with pytest.raises(OSError, match="holds visibilities and no image; make an"):
            EpochCube.read(own)


B1950 = FK4(equinox="B1950")
OLD = SkyCoord("04h30m", "5d12m", frame=B1950).icrs


def write_sources(path, names=("0430+052", "1226+023"), meta=None, **columns):
    """Write a table with two epochs of each source; its path."""
    rows = [name for name in names for _ in range(4)]
    n = len(rows)
    found = QTable({"source": rows, "feature": [0, 1, 0, 1] * len(names)})
    found["epoch"] = np.tile(np.repeat(["2006-03-09", "2007-01-01"], 2), len(names))
    found["flux"] = np.ones(n) * u.Jy
    found["separation"] = np.tile([0.0, 2.0], n // 2) * u.mas
    found["position_angle"] = np.zeros(n) * u.deg
    for name, value in columns.items():
        found[name] = [value] * n if isinstance(value, str) else value * np.ones(n)
    found.meta.update(meta or {})
    found.write(path / "table.ecsv", overwrite=True)
    return path / "table.ecsv"


def test_places_that_names_tell():
    for name, lon, lat, frame in [
        ("3c120", 4.5, 5.2, B1950),
        ("1253\N{MINUS SIGN}055", 12 + 53 / 60, -5.5, B1950),
        ("0433+0521", 4.55, 5.35, "icrs"),
        ("J043311.1+052115", 4.55 + 11.1 / 3600, 5.35 + 15 / 3600, "icrs"),
    ]:
        wanted = SkyCoord(lon * u.hourangle, lat * u.deg, frame=frame).icrs
        assert place_of(name).separation(wanted) < 0.1 * u.arcsec
    assert [*map(place_of, ["", "jet", "M101", "2530+052", "1230+952"])] == [None] * 5


NAMES = ["0415+379", "0430+052", "1226+023", "1228+126", "J0854+2006"]


def test_sources_by_other_names(tmp_path):
    same = dict.fromkeys(("0430+052", "3C 120", "3c120", "J0433+0521"), "0430+052")
    same |= {"M 87": "1228+126", "0851+202": "J0854+2006"}
    for wanted, found in (same | {"0430+05": None, "3C 279": None}).items():
        assert same_source(wanted, NAMES) == ([found] if found else [])
        path = write_sources(tmp_path, NAMES)
        if found:
            components = read_components(path, source=wanted)
            assert (components.meta["object"], len(components)) == (found, 4)
            assert list(read_sources(path, source=wanted)) == [found]
        else:
            words = f"^[^\n]*no source '{wanted[:4]}.* restore TABLE --list lists all"
            with pytest.raises(ValueError, match=words):
                read_components(path, source=wanted)


@pytest.mark.parametrize(
    ("columns", "meta"),
    [
        ({}, {}),
        ({}, {"position": "00h40m00s -20d00m00s"}),
        ({}, {"ra": "10 deg", "dec": "-20 deg"}),
        ({"RAdeg": 10 * u.deg, "DEdeg": -20 * u.deg}, {}),
        ({"RA": Masked(3 * u.deg, mask=True), "Dec": 1 * u.deg,
          "position": "00h40m00s -20d00m00s"}, {}),
        ({"RAJ2000": "00 40 00", "DEJ2000": "-20 00 00"}, {}),
        ({"RAh": 0, "RAm": 40, "RAs": 0.0, "DE-": "-", "DEd": 20, "DEm": 0, "DEs": 0.0},
         {}),
        ({"RAB1950": OLD.fk4.ra, "DEB1950": OLD.fk4.dec}, {}),
    ],
)  # fmt: skip
def test_the_position_of_a_table_is_that_of_its_images(columns, meta, tmp_path):
    place = SkyCoord(10 * u.deg, -20 * u.deg)
    if not (columns or meta) or "RAB1950" in columns:
        place = OLD
    path = write_sources(tmp_path, meta=meta, **columns)
    components = read_components(path, source="0430+052")
    assert components.meta["position"].separation(place) < 0.1 * u.mas
    assert ("position_from" in components.meta) == (not (columns or meta))
    cube = restore(components, beam=Beam(1 * u.mas, 1 * u.mas), pixel_scale=0.2 * u.mas)
    assert_allclose(cube.wcs.wcs.crval, [place.ra.deg, place.dec.deg], atol=1e-9)
    told = "at the position that the name 0430+052 tells" in cube.meta["history"][0]
    assert told == (not (columns or meta))


def test_the_sources_of_a_table(tmp_path):
    dates = ["2006-03-09T00:00:00.000", "2007-01-01T00:00:00.000"]
    path = write_sources(tmp_path)
    sources = ("0430+052", ["3C 120"], dates), ("1226+023", ["3C 273"], dates)
    assert source_list(path) == list(sources)
    model = tmp_path / "m_2006-03-09.mod"
    model.write_text("1.0v 0.0v 0v 0.1v 1 0 1\n")
    assert source_list(model) == [("m_2006-03-09", [], dates[:1])]
    QTable.read(path)[:0].write(tmp_path / "t.ecsv")
    words = "t.ecsv: no components in the file"
    with (
        pytest.warns(EpochWarning, match=f"{words}; the source t is left out"),
        pytest.raises(ValueError, match=words),
    ):
        read_sources(tmp_path / "t.ecsv")


PIXEL = 0.1 * u.mas
FLIP = np.diag([-1, 1])
UNITS = u.mas, u.mas, u.deg


THREE = ComponentList(
    times=Time(["2006-01-01", "2006-07-01"]), epoch=[0, 0, 1],
    flux=[1.0, 0.5, 0.8] * u.Jy, east=[0.0, 2.0, 0.4] * u.mas,
    north=[0.0, 1.0, 0.2] * u.mas, major=[0.0, 0.8, 0.3] * u.mas,
    minor=[0.0, 0.4, 0.3] * u.mas, pa=[0.0, 60.0, 0.0] * u.deg,
)  # fmt: skip


def one(**changes):
    """One component at the origin."""
    place = {"east": [0.0] * u.mas, "north": [0.0] * u.mas, "flux": [2.0] * u.Jy}
    return ComponentList(times=Time(["2006-01-01"]), epoch=[0], **place | changes)


def restored(source, **options):
    return restore(source, **{"beam": BEAM, "pixel_scale": PIXEL, **options})


def moments(image):
    y, x = np.indices(image.shape)
    weight = image / image.sum()
    mean = np.array([(weight * x).sum(), (weight * y).sum()])
    d = np.stack([x - mean[0], y - mean[1]])
    return mean, np.einsum("iyx,yx,jyx->ij", d, weight, d)


@settings(max_examples=40, deadline=None)
@given(n=st.integers(0, 4), seed=st.integers(0, 1000))
def test_boxes_equal_the_literal_sum(n, seed):
    rng = np.random.default_rng(seed)
    x, y, peak = rng.uniform(-30, 60, n), rng.uniform(-30, 50, n), rng.normal(size=n)
    angle, width = rng.uniform(0, np.pi, n), rng.uniform(0.3, 12, n)
    axes = width[:, None] * np.stack([np.ones(n), rng.uniform(0.02, 1, n)], axis=1)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    covariance = np.einsum("ain,na,ajn->nij", turn.swapaxes(0, 1), axes**2,
                           turn.swapaxes(0, 1))  # fmt: skip
    fast = add_gaussians(np.zeros((21, 34)), x, y, peak, covariance)
    slow, (yy, xx) = np.zeros((21, 34)), np.indices((21, 34))
    for x0, y0, p, c in zip(x, y, peak, covariance, strict=True):
        d = np.stack([xx - x0, yy - y0])
        slow += p * np.exp(-0.5 * np.einsum("iyx,ij,jyx->yx", d, np.linalg.inv(c), d))
    assert_allclose(fast, slow, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("axes", [(0, 0, 0), (0.9, 0.3, 40)])
def test_flux_is_kept_and_covariances_add(axes):
    names = ("major", "minor", "pa")
    sizes = {k: [v] * x for k, v, x in zip(names, axes, UNITS, strict=True)}
    cube = restored(one(**sizes))
    pixels_a_beam = (BEAM.area / PIXEL**2).to_value(u.one)
    assert cube.data[0].sum() / pixels_a_beam == pytest.approx(2.0, rel=1e-6)
    total = BEAM.covariance
    if axes[0]:
        total = total + Beam(*(v[0] for v in sizes.values())).covariance
    mean, covariance = moments(cube.data[0])
    assert_allclose(mean, cube.reference_pixel, atol=1e-6)
    expected = FLIP @ (total / PIXEL**2).to_value(u.one) @ FLIP
    assert_allclose(covariance, expected, rtol=1e-4, atol=1e-3)


def test_grids():
    cube = restored(THREE)
    (x, y), (ny, nx) = cube.reference_pixel, cube.shape[1:]
    assert min(x - 20, nx - 1 - x, y, ny - 1 - y - 10) >= 40
    edges = cube.data[:, [0, -1]].ravel(), cube.data[:, :, [0, -1]].ravel()
    assert np.abs(np.concatenate(edges)).max() < 1e-12
    assert restored(one(), shape=(65, 81)).reference_pixel == (40, 32)
    with pytest.warns(EpochWarning, match="1 of 3 components lie outside"):
        restored(THREE, shape=(40, 20), reference_pixel=(5, 20))


def test_bad_options():
    for options, message in [
        ({"beam": [BEAM]}, "2 epochs need 2 beams, got 1"),
        ({"beam": None}, "needs a beam; give one"),
        ({"noise": 1 * u.mas}, "noise must be a Quantity in Jy / beam"),
        ({"pixel_scale": 0 * u.mas}, "pixel_scale = .* must be finite and above 0"),
        ({"pixel_scale": 1 * u.mas}, "a pixel of 1 mas is larger than the beam of"),
        ({"pixel_scale": 1e-5 * u.mas}, "give larger pixels"),
        ({"reference_pixel": (3, 3)}, "reference_pixel needs a shape; give both"),
    ]:
        with pytest.raises((ValueError, TypeError), match=message):
            restored(THREE, **options)


def test_restores_what_aips_restored(shared_data):
    path = min((shared_data / "0506+056").glob("*.fits"))
    image, header = fits.getdata(path).squeeze(), fits.getheader(path)
    beam = Beam(*(header[k] * u.deg for k in ("BMAJ", "BMIN", "BPA")))
    place = {"reference_pixel": (header["CRPIX1"] - 1, header["CRPIX2"] - 1)}
    how = place | {"shape": image.shape, "pixel_scale": header["CDELT2"] * u.deg}
    cube = restore(read_components(path), beam=beam, **how)
    # What remains is the residual image: 0.14 mJy, and no source.
    residual = image - cube.data[0]
    assert residual.std() < 2e-4
    assert np.abs(residual).max() < 0.01 * image.max()


@settings(max_examples=8)
@given(
    shape=st.tuples(st.integers(1, 60), st.integers(1, 60)),
    major=st.floats(0.05, 1.5), ratio=st.floats(0.2, 1), pa=st.floats(-180, 180),
)  # fmt: skip
def test_rms_is_the_theoretical_one_everywhere(shape, major, ratio, pa):
    beam = Beam(major * u.mas, major * ratio * u.mas, pa * u.deg)
    rng = np.random.default_rng(5)
    options = {"rms": 2.0, "beam": beam, "pixel_scale": PIXEL, "rng": rng}
    noise = np.array([correlated_noise(shape, **options) for _ in range(200)])
    # Edges included.
    for part in (noise, noise[:, :3], noise[:, :, -3:]):
        assert np.sqrt(np.mean(part**2)) == pytest.approx(2.0, rel=0.3)
