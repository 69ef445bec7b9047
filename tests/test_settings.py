# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Settings in TOML: what is read, what is refused, and what comes back."""

import pickle

import astropy.units as u
import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.quantities import random_generator
from astro_scc.settings import OPTIONS, Settings, check_setting, read_config, require

PM = u.mas / u.yr
FULL = {
    "epochs": ["a.fits", "b c.fits"], "after": "1995-01-01", "before": "2011.0",
    "align": "core", "beam": "1.0 mas 0.5 mas -7 deg", "common_beam": True,
    "crop": "part.reg", "region": "jet.reg", "method": "spectrum",
    "scales": "0.2 mas, 0.4 mas",
    "max_speed": "2 mas/yr", "position_angle": "248 deg", "baseline": "70 d 1.0 yr",
    "min_error_beams": 0.2, "kappa": 0.6, "target": "segments", "min_overlap": 0.8,
    "wavelet": "b3", "detection": 4, "segmentation": 3.0, "noise": "local",
    "alpha": 0.05, "outward": True, "alignment_error": "0.02 mas",
    "small_displacement_correction": False, "n_trials": 1000, "seed": 2**63 - 1,
    "redshift": 0.158, "cosmology": "H0=71,Om0=0.27",
}  # fmt: skip
#: Of other commands than `measure`, and what does not go with a redshift.
OTHERS = {
    "distance": "16.7 Mpc", "bins": "0.5 1.5 2.5 mas", "window": "1 mas",
    "detections": "ssp", "scale_groups": "1,2; 3.5",
}  # fmt: skip


def same(a, b):
    if isinstance(a, u.Quantity):
        return a.unit == b.unit and np.array_equal(a.value, b.value)
    return type(a) is type(b) and a == b


def test_settings_survive_the_file_to_the_bit(tmp_path):
    made = Settings(**FULL)
    path = tmp_path / "config.toml"
    text = made.to_toml(versions={"numpy": "2.0"})
    assert text.startswith("# What determined the results.")
    assert "astro-scc measure --config FILE -o FOLDER\n\nepochs = " in text
    path.write_text(text, encoding="utf-8")
    found, versions = read_config(path)
    assert (versions, set(found)) == ({"numpy": "2.0"}, set(FULL))
    again = Settings(**found)
    for name in OPTIONS:
        assert same(getattr(again, name), getattr(made, name)), name
    # What the measurement computes with is the same, too.
    one, other = map(StackedCrossCorrelation.from_settings, (made, again))
    assert one.max_speed == other.max_speed == 2 * PM
    # They are equal by their values, also those of another process.
    assert len({one, other, pickle.loads(pickle.dumps(one))}) == 1
    assert made == again == pickle.loads(pickle.dumps(made))
    assert made != made.changed(alpha=0.5)
    assert one not in (made, 1)
    # A command keeps its own settings.
    for command in ("profile", "track"):
        plain = Settings(epochs="a.fits", **OTHERS).to_dict(command)
        assert ("bins" in plain) == ("alpha" in plain) == (command == "profile")
        assert ("detections" in plain) == (command == "track")
        assert Settings(**plain).to_dict(command) == plain


def test_speeds_in_c_need_one_kind_of_distance():
    assert Settings().in_c == {}
    own = {"redshift": 0.1, "cosmology": "H0=71,Om0=0.27"}
    assert Settings(redshift=0.1).in_c == own
    assert Settings(distance="1 Mpc").in_c == {"distance": 1 * u.Mpc}
    with pytest.raises(ValueError, match="distance needs neither redshift nor"):
        Settings(redshift=0.1, distance="1 Mpc")


def test_generators_of_either_kind():
    one, other = (random_generator(np.random.RandomState(3)) for _ in range(2))
    assert one.integers(10**9) == other.integers(10**9)


def test_values_that_make_no_sense():
    for name, value, reason in [
        ("epochs", [], "list of files"),
        ("epochs", ["a.fits", 3], "must be text"),
        ("align", " ", "must be text"),
        ("common_beam", "yes", "true or false"),
        ("max_speed", "1x2 mas", "unknown unit 'x2 mas'"),
        ("position_angle", "117 mas", "must be in degrees or radians"),
        ("redshift", [0.1, 0.2], "must be one redshift"),
        ("kappa", float("nan"), "finite"),
        ("kappa", 1.0, "kappa = 1.0 must be between 0 and 1"),
        ("noise", "none", "noise = 'none' must be one of plane, local, propagated"),
        ("max_speed", "2", "max_speed = '2' has no unit at its end; it must be an"),
        ("position_angle", "65", "radial, ridge, fit, any or an angle"),
        ("position_angle", "west", "has 'west' where a number is expected; it must be"),
        *(("baseline", k, "shortest and a longest") for k in ("1 yr", "2 yr 1 yr")),
        ("scales", "1,b", "scale numbers such as 1,2,3 or angles"),
        ("scales", "0 mas", "above 0"),
        ("scales", "99", "of the series 0, 0.5, 1, 1.5, ..., 20: scale j is 2\\^j pix"),
        ("scales", [], r"scales = \[\] must be scale numbers such as 1,2,3"),
        ("scales", [*range(98), 1], r"scales = \[0, 1, 2.*\.\.\. must differ"),
        ("before", "yesterday", "is no date such as 2011-01-01"),
        ("alignment_error", "-0.1 mas", "0 or above"),
        ("alignment_error", [1, np.nan] * u.mas, "must be an angle or a list of them"),
    ]:  # fmt: skip
        with pytest.raises(ValueError, match=reason) as caught:
            check_setting(name, value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("max_speed", "2 mas/yr", 2 * PM),
        ("scales", np.array([1, 2]), (1.0, 2.0)),
        # Groups are compared on scale 0 alone, which is a default too.
        ("scale_groups", "0;1", {"0": (0.0,), "1": (1.0,)}),
        ("scales", 0.4 * u.mas, [0.4] * u.mas),
        ("position_angle", "115 deg", 115 * u.deg),
        ("position_angle", "\N{MINUS SIGN}112deg", 248 * u.deg),
        ("baseline", "0.2 yr 1 yr", [0.2, 1.0] * u.yr),
        ("baseline", [0.2 * u.yr, 365.25 * u.day], [0.2, 1.0] * u.yr),
        ("alignment_error", "0.1 0.2 mas", [0.1, 0.2] * u.mas),
        ("kappa", "0.7", 0.7),
        ("n_trials", np.int64(100), 100),
        ("redshift", "15.8 %", 0.158),
        ("max_speed", None, None),
    ],
)
def test_text_in_python_is_what_it_is_on_the_command_line(name, value, expected):
    assert same(require(name, value), expected)


def test_files_that_make_no_sense(tmp_path):
    for text, reason in [
        (b"xyzzy = 1", "unknown key 'xyzzy'; see"),
        (b"\xff\xfe\x00", "is not a TOML file"),
        (b"versions = 3", "versions must be a table"),
        (b"alpha = 1.5", "alpha = 1.5 must be"),
    ]:
        path = tmp_path / "jet.toml"
        path.write_bytes(text)
        with pytest.raises(ValueError, match=reason) as caught:
            read_config(path)
        assert str(caught.value).startswith(f"{path}: ")
        assert "\n" not in str(caught.value)
