# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Why an emission is a secure feature, or which step lost it."""

import re
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

from astro_scc.explain import explain_feature


@pytest.fixture(scope="module")
def secure(known_features):
    """The secure feature of most epochs: its index, and its positions as published."""
    number = known_features.n_epochs.tolist()
    k = int(np.argmax(number * known_features.secure))
    rows = known_features.positions
    return k, rows[rows["feature"] == known_features.number[k]]


def test_a_secure_feature(known_features, secure):
    k, rows = secure
    lines = explain_feature(known_features, feature=known_features.number[k])
    text = " ".join(lines)
    assert lines[0].startswith(f"Detected within 0.5 beams in {len(rows)} of")
    assert f"p_false {known_features.p_false[k]:.2g} (at most 0.3)" in text
    assert f"motion of {known_features.moved[k]:.2g} beams and " in text
    assert "(at least 1 beam and 3 standard errors in 4 epochs, or 0.5 beams" in text
    assert lines[-1] == "It is secure."


def test_which_step_lost_an_emission(known_features, secure):
    k, rows = secure
    none = replace(known_features, tracks=())

    def lost(of=none, published=rows):
        return explain_feature(of, published=published)

    elsewhere = rows.copy()
    elsewhere["dec_offset"] += 50 * u.mas
    lines = lost(published=elsewhere)
    assert lines[-1].startswith("It is lost: that is outside of the images, or their ")
    elsewhere["dec_offset"] -= 47 * u.mas
    lines = lost(published=elsewhere)
    assert lines[-1] == "It is lost: nothing is detected there."
    assert lines[1].startswith("Not detected (date, S/N")
    # Emission that no detection is at.
    d = known_features.detections
    others = ~np.isin(np.arange(len(d)), known_features.tracks[k])
    away = replace(none, detections=d.select(others))
    bright = "nothing is detected there though there is emission: blended, or outside"
    assert bright in lost(away)[-1]
    assert "needs detections in 4 epochs" in lost(published=rows[:3])[-1]
    lines = lost()
    words = r"likeliest track joins \d+ of them; its log likelihood ratio .* \d+\.\d"
    assert re.search(words, lines[-2])
    assert "its links are in less than 60% of the perturbed assignments" in lines[-1]
    jump = np.random.default_rng(1).normal(scale=4.0, size=(10, 2))
    scattered = replace(d, place=d.place + jump[d.epoch])
    moved = rows.copy()
    for name, shift in zip(("ra_offset", "dec_offset"), jump.T, strict=True):
        moved[name] += shift[rows["epoch"]] * u.mas
    said = lost(replace(none, detections=scattered), moved)[-1]
    assert re.search(r"steady motion joins at most \d of them, and a feature", said)


def test_what_cannot_be_explained(known_features):
    with pytest.raises(ValueError, match="there is no feature 1; features.ecsv has"):
        explain_feature(known_features, feature=1)
    with pytest.raises(ValueError, match="give a feature, a published one, or an off"):
        explain_feature(known_features, offset=[1, 1] * u.mas)
