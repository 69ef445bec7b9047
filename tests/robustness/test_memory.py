# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Series that are larger than the memory, see ``benchmarks/memory.py``."""

import pytest
from astropy.table import QTable

from astro_scc.cli import main
from astro_scc.cli.survey import run_survey
from astro_scc.cli.survey_sources import read_survey
from astro_scc.epochs import EpochCube

SKY = 'fk5\nbox(10d,0d,0.0036",0.0026",0)\n'


@pytest.fixture
def part(tmp_path):
    path = tmp_path / "part.reg"
    path.write_text("image\nbox(24,21,38,30,0)\n")
    return path


@pytest.mark.slow
def test_a_part_is_measured(inputs, epochs, measure, part, tmp_path):
    status, err = measure(*epochs, "-o", tmp_path / "out", "--crop", part)
    assert (status, err.count("error")) == (0, 0)
    table = QTable.read(tmp_path / "out" / "components.ecsv")
    assert table["pm_ra_cosdec"][0].value == pytest.approx(-inputs.SPEED, abs=0.05)
    assert table.meta["configuration"]["crop"] == str(part)
    (line,) = (text for text in table.meta["history"] if "cropped" in text)
    assert line == "cropped to pixels x 5 to 41, y 6 to 34"
    # The settings do it again.
    config = tmp_path / "out" / "config.toml"
    assert main(["measure", "--config", str(config), "-o", str(tmp_path / "again"),
                 "--no-report", "--quiet"]) == 0  # fmt: skip
    same = [(tmp_path / name / "ssps.ecsv").read_bytes() for name in ("out", "again")]
    assert same[0] == same[1]


@pytest.mark.slow
def test_regions_in_pixels_are_those_of_the_part(epochs, measure, part, tmp_path):
    region = tmp_path / "jet.reg"
    region.write_text("image\ncircle(20,20,9)\n")
    words = [*epochs, "-o", tmp_path / "out", "--crop", part, "--region", region]
    status, err = measure(*words)
    assert status == 2
    assert err.splitlines()[-1] == (
        f"astro-scc measure: error: {region}: is in pixels, which are others in a part "
        "of the images (crop); give it in celestial coordinates"
    )
    region.write_text(SKY)
    assert measure(*words)[0] == 0


def test_a_part_that_is_nowhere(epochs, measure, tmp_path):
    part = tmp_path / "part.reg"
    part.write_text("image\nbox(900,21,38,30,0)\n")
    status, err = measure(*epochs, "-o", tmp_path / "out", "--crop", part)
    assert (status, len(err.splitlines())) == (2, 1)
    assert "part.reg: holds no pixel of the 48 x 40 image; check its coord" in err


@pytest.mark.slow
def test_parts_of_a_survey(epochs, tmp_path):
    text = (
        f'[sources.Jet]\nepochs = "{epochs[0].parent}/*.fits"\nn_trials = 2\n'
        'scales = [1, 2]\nmax_speed = "5 mas/yr"\ncrop = "part.reg"\n'
        'regions = {sky = "sky.reg", pixels = "part.reg"}\n'
    )
    (tmp_path / "s.toml").write_text(text)
    (tmp_path / "part.reg").write_text("image\nbox(24,21,38,30,0)\n")
    (tmp_path / "sky.reg").write_text(SKY)
    told = []

    def run():
        survey = read_survey(tmp_path / "s.toml")
        return run_survey(
            survey, tmp_path / "out", done=lambda *args: told.append(args[2])
        )

    table = run()
    rows = {str(row["region"]): row for row in table}
    assert rows["sky"]["status"] == "measured"
    assert rows["pixels"]["status"] == "failed"
    assert "is in pixels, which are others" in rows["pixels"]["message"]
    (tmp_path / "s.toml").write_text(text.replace(', pixels = "part.reg"', ""))
    run()
    run()
    (tmp_path / "part.reg").write_text("image\nbox(24,21,40,30,0)\n")
    run()
    assert told == [False, False, True, False]


def test_more_than_the_machine_has(epochs, measure, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("astro_scc.epochs.reading.machine_memory", lambda: 1e4)
    status, err = measure(*epochs, "-o", tmp_path / "out")
    assert (status, len(err.splitlines())) == (2, 1)
    assert err.startswith(
        "astro-scc measure: error: 5 images of 48 x 40 pixels are 8.64e-05 GB, this "
        "machine has 1e-05; read a region of them (region=, --crop)"
    )
    assert not (tmp_path / "out").exists()
    # Each file by itself can be looked at.
    assert main(["inspect", *map(str, epochs)]) == 0
    out = capsys.readouterr().out
    assert "as one series: 5 images of 48 x 40 pixels are 8.64e-05 GB" in out
    assert EpochCube.read(epochs, region=(slice(5, 9), slice(5, 9))).shape == (5, 4, 4)
