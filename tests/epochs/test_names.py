# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Names of sources, the places that they or their tables tell, and lists of them."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import FK4, SkyCoord
from astropy.table import QTable
from numpy.testing import assert_allclose

from astro_scc.epochs import Beam, read_components, restore
from astro_scc.epochs.lists import read_sources
from astro_scc.epochs.tables import place_of, same_source, source_list

B1950 = FK4(equinox="B1950")
OLD = SkyCoord("04h30m", "5d12m", frame=B1950).icrs


def write(path, names=("0430+052", "1226+023"), meta=None, **columns):
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


@pytest.mark.parametrize(
    ("name", "lon", "lat", "frame"),
    [
        ("3c120", 4.5, 5.2, B1950),
        ("1253\N{MINUS SIGN}055", 12 + 53 / 60, -5.5, B1950),
        ("0433+0521", 4.55, 5.35, "icrs"),
        ("J043311.1+052115", 4.55 + 11.1 / 3600, 5.35 + 15 / 3600, "icrs"),
    ],
)
def test_places_that_names_tell(name, lon, lat, frame):
    wanted = SkyCoord(lon * u.hourangle, lat * u.deg, frame=frame).icrs
    assert place_of(name).separation(wanted) < 0.1 * u.arcsec
    assert [*map(place_of, ["", "jet", "M101", "2530+052", "1230+952"])] == [None] * 5


NAMES = ["0415+379", "0430+052", "1226+023", "1228+126", "J0854+2006"]


def test_sources_by_other_names(tmp_path):
    same = dict.fromkeys(("0430+052", "3C 120", "3c120", "J0433+0521"), "0430+052")
    same |= {"M 87": "1228+126", "0851+202": "J0854+2006"}
    for wanted, found in (same | {"0430+05": None, "3C 279": None}).items():
        assert same_source(wanted, NAMES) == ([found] if found else [])
        path = write(tmp_path, NAMES)
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
        ({"RAJ2000": 2 / 3 * u.hour, "DEJ2000": -20 * u.deg}, {}),
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
    path = write(tmp_path, meta=meta, **columns)
    components = read_components(path, source="0430+052")
    assert components.meta["position"].separation(place) < 0.1 * u.mas
    assert ("position_from" in components.meta) == (not (columns or meta))
    cube = restore(components, beam=Beam(1 * u.mas, 1 * u.mas), pixel_scale=0.2 * u.mas)
    assert_allclose(cube.wcs.wcs.crval, [place.ra.deg, place.dec.deg], atol=1e-9)
    told = "at the position that the name 0430+052 tells" in cube.meta["history"][0]
    assert told == (not (columns or meta))


def test_the_sources_of_a_table(tmp_path):
    dates = ["2006-03-09T00:00:00.000", "2007-01-01T00:00:00.000"]
    path = write(tmp_path)
    sources = ("0430+052", ["3C 120"], dates), ("1226+023", ["3C 273"], dates)
    assert source_list(path) == list(sources)
    model = tmp_path / "m_2006-03-09.mod"
    model.write_text("1.0v 0.0v 0v 0.1v 1 0 1\n")
    assert source_list(model) == [("m_2006-03-09", [], dates[:1])]
    bad = tmp_path / "bad.mod"
    bad.write_text("1.0v 0.0v 0v 0.1v 1 0 1\n")
    with pytest.raises(ValueError, match="bad.mod: no DATE-OBS in the header, or no"):
        source_list(bad)
