# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc simulate`` and ``restore``, and what is measured besides images."""

import re

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable
from astropy.time import Time

from astro_scc import EpochCube
from astro_scc.epochs import (
    Beam,
    ComponentList,
    read_components,
    restore,
    write_epochs,
)


def epochs(folder):
    return sorted(folder.glob("*.fits"))


def test_simulate_and_its_seed(astro_scc, here):
    status, out, err = astro_scc("simulate", "two-fluid", "a", "--epochs", 3, "--dense")
    assert (status, err) == (0, "")
    seed = int(re.search(r"\(seed (\d+)\)", out).group(1))
    truth = QTable.read(here / "a" / "truth.ecsv")
    assert truth.meta["seed"] == seed
    assert set(truth["group"]) == {"slow", "fast"}
    status, out, _ = astro_scc(
        "simulate", "two-fluid", "b/c/", "--epochs", 3, "--dense", "--seed", seed
    )
    assert status == 0
    assert "b/c/*.fits -o b/c-measured" in out
    for path in (here / "a").iterdir():
        assert path.read_bytes() == (here / "b" / "c" / path.name).read_bytes()
    assert len(epochs(here / "a")) == 3


def test_simulate_a_real_jet(astro_scc, here):
    options = ["--motion", 0.4, "--features", 5, "--standing", 2, "--seed", 1]
    options += ["--epochs", 3, "--dispersion", 0.2, "--distribution", "lognormal"]
    options += ["--flux-variation", 0]
    assert astro_scc("simulate", "jet", "a", *options)[::2] == (0, "")
    a = QTable.read(here / "a" / "truth.ecsv")
    flow, standing = a.meta["streams"]
    assert (flow["speed"], flow["dispersion"], flow["n_features"]) == (0.4, 0.2, 5.0)
    assert flow["distribution"] == "lognormal"
    assert standing["n_features"] == 2
    core = a["flux"][a["group"] == "core"]
    assert np.all(core == 1 * u.Jy)
    beams = EpochCube.read(here / "a" / "*.fits").beams
    assert beams[0] == beams[1]


@pytest.mark.parametrize(
    "jet", ["random-velocity", "ballistic", "static", "unrelated", "jet"]
)
def test_every_jet_is_simulated(astro_scc, here, jet):
    status, _, err = astro_scc("simulate", jet, "a", "--epochs", 2, "--seed", 1)
    assert (status, err) == (0, "")
    assert len(epochs(here / "a")) == 2


MODEL = "1.0v 0.0v 0v 0.2v 1 0 1\n0.3v 2.0v 45v 0.5v 1 0 1\n"


@pytest.fixture
def models(here):
    """Two models of difmap."""
    names = ["3c1_2006-03-09.mod", "3c1_2007-03-09.mod"]
    for name in names:
        (here / name).write_text(MODEL)
    return names


def test_restore(models, astro_scc, here):
    options = ["--beam", "1.0 mas 0.5 mas -7 deg", "--pixel", "0.1 mas"]
    noise = ["--noise", "0.3 mJy/beam"]
    status, out, err = astro_scc("restore", *models, "-o", "a", *options, *noise)
    assert (status, err) == (0, "")
    seed = re.search(r"seed of the noise (\d+)", out).group(1)
    cube = EpochCube.read(here / "a" / "*.fits")
    assert len(cube) == 2
    assert cube.beams[0] == Beam(1 * u.mas, 0.5 * u.mas, -7 * u.deg)
    assert cube.pixel_scale.round(6) == 0.1 * u.mas
    header = fits.getheader(epochs(here / "a")[0])
    assert any(f"seed {seed}" in line for line in header["HISTORY"])
    astro_scc("restore", *models, "-o", "b", *options, *noise, "--seed", seed)
    for path in (here / "a").iterdir():
        assert path.read_bytes() == (here / "b" / path.name).read_bytes()


TABLE = """\
Title: Made-up jets
Authors: Nobody N.
Table: Fitted Jet Features
================================================================================
Byte-by-byte Description of file: table4.txt
--------------------------------------------------------------------------------
   Bytes Format Units  Label  Explanations
--------------------------------------------------------------------------------
   1-  8 A8     ---    Name   Source name, B1950
  10- 11 I2     ---    ID     Feature identification number
  13- 16 I4     yr     Obs.Y  Year of observation, UT
  18- 19 I2     month  Obs.M  Month of observation, UT
  21- 22 I2     d      Obs.D  Day of observation, UT
  24- 29 F6.1   mJy    Dens   Flux density at 15 GHz
  31- 34 F4.2   mas    Off    Position offset
  36- 40 F5.1   deg    Ang    Position angle
--------------------------------------------------------------------------------
0000+000  0 2006  3  9  489.0 0.04 290.7
0000+000  1 2006  3  9    7.2 3.98 121.8
0000+001  0 2006  3 10  100.0 0.00   0.0
0000+000  0 2006 12  1  320.0 0.10 308.1
"""


def test_restore_one_source_of_a_survey(astro_scc, refused, here):
    (here / "table4.txt").write_text(TABLE)
    words = ["restore", "table4.txt", "--beam", "1 mas", "--pixel", "0.1 mas"]
    line = refused(*words, "-o", "out")
    assert "table4.txt: 2 sources in the table (0000+000, 0000+001); say which" in line
    status, _, err = astro_scc(*words, "-o", "out", "--source", "0000+000")
    assert (status, err) == (0, "")
    names = sorted(path.name for path in (here / "out").iterdir())
    assert names == ["0000+000_00_2006-03-09.fits", "0000+000_01_2006-12-01.fits"]


def test_restore_some_dates_with_a_round_beam(models, astro_scc, here):
    status, out, _ = astro_scc(
        "restore", *models, "-o", "a", "--beam", "0.8 mas", "--pixel", "100 uas",
        "--before", "2007-01-01",
    )  # fmt: skip
    assert status == 0
    assert "seed" not in out
    cube = EpochCube.read(here / "a" / "*.fits")
    assert cube.times.isot.tolist() == ["2006-03-09T00:00:00.000"]
    assert cube.beams[0] == Beam(0.8 * u.mas, 0.8 * u.mas)


# -- what measure and track take besides images ------------------------------------


@pytest.mark.slow
def test_difmap_models_are_tracked(astro_scc, here):
    for k in range(6):
        text = f"1.0v 0.0v 0v 0.1v 1 0 1\n0.5v {1.5 + 0.3 * k}v 60v 0.3v 1 0 1\n"
        (here / f"3c1_200{k}-03-09.mod").write_text(text)
    beam = ["--beam", "0.8 mas", "--seed", "1", "--no-figures"]
    status, out, err = astro_scc("track", *here.glob("*.mod"), "-o", "a", *beam)
    assert status == 0
    assert "restored with the beam 0.8 x 0.8 mas" in err
    table = QTable.read(here / "a" / "features.ecsv")
    (row,) = table[table["secure"]]
    assert abs(row["pm"] - 0.3 * u.mas / u.yr) < 3 * row["pm_err"]
    assert "beam: 0.8 mas" in (here / "a" / "features.ecsv").read_text()


def test_models_without_beam_or_date(refused, models, here):
    assert "--beam '1.0 mas 0.5 mas -7 deg'" in refused("measure", *models, "-o", "a")
    (here / models[0]).rename(here / "model.mod")
    line = refused("track", "model.mod", "-o", "a", "--beam", "1 mas")
    assert "model.mod: no date in the file's name; rename it" in line
    line = refused("measure", "model.mod", "-o", "a", "--beam", "1 mas 2 mas")
    assert "--beam '1 mas 2 mas' is no beam: has no position angle; give" in line


def test_restore_with_the_beam_of_the_table(models, astro_scc, here):
    words = ["restore", "--pixel", "0.1 mas", "-o"]
    beam = Beam(1 * u.mas, 0.5 * u.mas, -7 * u.deg)
    table = read_components(models, beams=beam).to_table()
    table.write(here / "a.ecsv", format="ascii.ecsv")
    status, _, err = astro_scc(*words, "b", "a.ecsv")
    assert (status, err) == (0, "")
    assert EpochCube.read(here / "b" / "*.fits").beams == (beam, beam)


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", ["GZIP_1", "GZIP_2", "RICE_1", "PLIO_1", "HCOMPRESS_1"]
)
def test_tables_from_tile_compressed_images(astro_scc, here, kind):
    """The same as from the plain ones, within a sixteenth of the noise."""
    times = Time([f"200{k}-03-09" for k in range(6)])
    offsets = np.ravel([[0, 1.5 + 0.3 * k, 4 + 0.4 * k] for k in range(6)])
    components = ComponentList(
        times=times, epoch=np.repeat(np.arange(6), 3), flux=[1, 0.3, 0.2] * 6 * u.Jy,
        east=offsets * u.mas, north=0.5 * offsets * u.mas,
    )  # fmt: skip
    cube = restore(
        components, beam=Beam(0.8 * u.mas, 0.8 * u.mas), pixel_scale=0.1 * u.mas,
        shape=(512, 512), noise=1 * u.mJy / u.beam, rng=1,
    )  # fmt: skip
    (here / "plain").mkdir()
    (here / "packed").mkdir()
    for path in write_epochs(cube, here / "own"):
        with fits.open(path) as hdus:
            data = hdus[0].data.astype(">f4")
            if kind == "PLIO_1":
                # Of numbers from 0 to 2^24.
                data = np.rint((data + 0.01) * 1e5).astype(">i4")
            header = hdus[0].header
            fits.PrimaryHDU(data, header).writeto(here / "plain" / path.name)
            image = fits.CompImageHDU(data, header, compression_type=kind)
            image.writeto(here / "packed" / f"{path.name}.fz")
    assert sum(p.stat().st_size for p in (here / "packed").iterdir()) < 6 * 700_000
    tables = []
    for name in ("plain", "packed"):
        files = sorted((here / name).iterdir())
        words = ["-o", f"{name}-out", "--seed", "1", "--no-figures"]
        assert astro_scc("track", *files, *words)[0] == 0
        tables.append(QTable.read(here / f"{name}-out" / "features.ecsv"))
    one, other = tables
    assert len(one) == len(other) >= 2
    for column in ("pm", "pm_ra_cosdec", "pm_dec", "ra_offset", "dec_offset", "flux"):
        error = one[f"{column}_err"] if f"{column}_err" in one.colnames else None
        error = 0.01 * one[column] if error is None else error
        assert np.all(abs(one[column] - other[column]) <= 0.25 * abs(error))
    assert np.array_equal(one["secure"], other["secure"])
    if kind == "PLIO_1":
        assert np.array_equal(one["pm"], other["pm"])
