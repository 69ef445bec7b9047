# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The beam of an image among those of all channels, and beams that are equal."""

import pickle

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits

from astro_scc.epochs import Beam, EpochCube, inspect_epochs

CHANNELS = np.linspace(4.0, 1.0, 4)
ONE = [{"CHAN": 0, "POL": 0, "BMAJ": 2.0}]
FOUR = [{"CHAN": k, "POL": 0, "BMAJ": width} for k, width in enumerate(CHANNELS)]
FROM_1 = [row | {"CHAN": row["CHAN"] + 1} for row in FOUR]
STOKES = [{"CHAN": 0, "POL": k, "BMAJ": width} for k, width in enumerate(CHANNELS)]
BOTH = [row | {"POL": k, "BMAJ": row["BMAJ"] + 5 * k} for k in (0, 1) for row in FOUR]
SAME = [row | {"BMAJ": 2.0} for row in FOUR]
BLANK = [row | {"BMAJ": 2.0 * (row["CHAN"] == 2)} for row in FOUR]
VELOCITY = {"CTYPE3": "VRAD", "CUNIT3": "m/s", "CDELT3": 1e3}
#: Rows of a table BEAMS (0.1 mas), changes of the header, and the major axis.
BEAMS = [
    (ONE, {}, 2.0),
    (ONE, {"CRPIX3": -1.0}, 2.0),
    (FOUR, {"CRPIX3": 0.0}, 3.0),
    (FOUR, {"CRPIX3": -2.0}, 1.0),
    (FOUR, {"CRPIX3": -1.0, **VELOCITY}, 2.0),
    (FROM_1, {"CRPIX3": -2.0}, 1.0),
    (STOKES, {}, 4.0),
    (STOKES, {"CRPIX4": -1.0}, 2.0),
    (BOTH, {"CRPIX3": -2.0}, 1.0),
    (BOTH, {"CRPIX3": -2.0, "CRPIX4": 0.0}, 6.0),
    (SAME, {}, 2.0),
    (SAME, {"CRPIX3": -7.0}, 2.0),
    (BLANK, {}, 2.0),
    # What the header says counts.
    (FOUR, {"BMAJ": 5 / 3.6e7, "BMIN": 1 / 3.6e7, "BPA": 0.0}, 5.0),
]
UNKNOWN = [
    (FOUR, {}),
    (FOUR, {"CRPIX3": 0.5}),
    (FOUR, {"CRPIX3": -7.0}),
    (FOUR, {"CTYPE3": None}),
    (BOTH, {}),
    ([{"BMAJ": width} for width in CHANNELS], {"CRPIX3": 0.0}),
]


@pytest.fixture
def with_beams(make_fits):
    """Write an image with a table of beams."""

    def make(rows, changes, name="a.fits"):
        own = dict.fromkeys(("BMAJ", "BMIN", "BPA")) | changes
        path = make_fits(name, **own)
        columns = {"BMIN": np.ones(len(rows)), "BPA": np.zeros(len(rows))}
        columns |= {key: [row[key] for row in rows] for key in rows[0]}
        table = fits.BinTableHDU.from_columns(
            [
                fits.Column(key, "1J", array=values)
                if key in ("CHAN", "POL")
                else fits.Column(
                    key,
                    "1E",
                    unit="deg" if key == "BPA" else "arcsec",
                    array=np.asarray(values) / (1 if key == "BPA" else 1e4),
                )
                for key, values in columns.items()
            ],
            name="BEAMS",
        )
        fits.append(path, table.data, table.header)
        return path

    return make


@pytest.mark.parametrize(("rows", "changes", "major"), BEAMS)
def test_the_beam_of_the_channel(with_beams, rows, changes, major):
    cube = EpochCube.read(with_beams(rows, changes))
    assert cube.beams[0].major.to_value(u.mas) == pytest.approx(major / 10, rel=1e-6)


@pytest.mark.parametrize(("rows", "changes"), UNKNOWN)
def test_which_channel_it_is_cannot_be_told(with_beams, rows, changes):
    path = with_beams(rows, changes)
    words = f"its table BEAMS has {len(rows)} beams, and which one is that of its chan"
    with pytest.raises(ValueError, match=f"a.fits: {words}"):
        EpochCube.read(path)
    assert words in inspect_epochs(path)["problem"][0]
    given = Beam(1 * u.mas, 1 * u.mas)
    assert EpochCube.read(path, beams=given).beams == (given,)


MAS = u.mas
EQUAL = [
    (Beam(1 * MAS, 0.5 * MAS), Beam(1000 * u.uas, 500 * u.uas)),
    (Beam(1 * MAS, 0.5 * MAS, -7 * u.deg), Beam(1 * MAS, 0.5 * MAS, 173 * u.deg)),
    (Beam(1 * MAS, 1 * MAS), Beam(1 * MAS, 1 * MAS, 30 * u.deg)),
    (Beam(3 * MAS, 1 * MAS), Beam(float(np.float32(3 / 3.6e6)) * u.deg, 1 * MAS)),
]


@pytest.mark.parametrize(("one", "other"), EQUAL)
def test_equal_beams_are_one_in_a_set(one, other):
    assert one == other
    assert hash(one) == hash(other)
    assert len({one, other, pickle.loads(pickle.dumps(one))}) == 1
    far = Beam(one.major * 1.001, one.minor)
    assert len({one, other, far}) == 2
    assert one != 1
    data = np.random.default_rng(1).normal(size=(2, 8, 8))
    dates = ["2000-01-01", "2001-01-01"]
    cube = EpochCube.from_arrays(data, dates, pixel_scale=1 * MAS, beams=[one, other])
    assert cube.facts["beam"] == str(one)


def test_beams_of_radio_beam():
    beams = pytest.importorskip("radio_beam").Beams(
        [3, 3] * u.mas, [1, 2] * u.mas, [10, 20] * u.deg
    )
    made = {"data": np.ones((2, 4, 4)), "times": ["2000-01-01", "2001-01-01"]}
    cube = EpochCube.from_arrays(**made, pixel_scale=1 * u.mas, beams=beams)
    assert [beam.minor.value for beam in cube.beams] == [1, 2]
    with pytest.raises(ValueError, match="2 epochs need 2 beams, got 1"):
        EpochCube.from_arrays(**made, pixel_scale=1 * u.mas, beams=beams[:1])
    with pytest.raises(ValueError, match="of a beam are single angles, got 2; make a"):
        Beam([1, 2] * u.mas, 1 * u.mas)
