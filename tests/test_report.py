# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The report: sentences, tables, figures and files, and the same on the terminal."""

import re
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import Column, vstack
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.columns import cell
from astro_scc.kinematics import paper_cosmology
from astro_scc.quantities import with_error
from astro_scc.report import answer, write_report
from astro_scc.units import PM_UNIT

CHANCE = "p_global 0.62 is above alpha"
HOSTILE = "<script>alert('1')</script> & \"more\""
FIGURES = "spectrum distance diagram separation tracks speeds velocity_map".split()
FIGURES += "significance epochs sensitivity".split()


@pytest.fixture(scope="module")
def result(jet_results, with_cube):
    """Of epochs with names that are code."""
    cube = jet_results["jet"].cube
    labels = (HOSTILE, *(f"epoch{k}.fits" for k in range(len(cube) - 1)))
    cube = replace(cube, labels=labels).with_step(f"tested with {HOSTILE}")
    return with_cube(jet_results["jet"], cube)


def changed(table, **columns):
    """Return a copy of streams with other columns, of text of any length."""
    table = table.copy()
    if "caution" in columns:
        caution = np.broadcast_to(columns.pop("caution"), len(table))
        table.replace_column("caution", Column(caution, description="what counts"))
    for name, value in columns.items():
        table[name] = value
    return table


@pytest.fixture(scope="module")
def streams(result):
    """Three kinds of streams."""
    table = result.components_in_c(redshift=0.033, cosmology=paper_cosmology())
    assert list(table["kind"]) == ["moving"]
    kinds = ["moving", "stationary", "not significant"]
    table = vstack([table] * 3, metadata_conflicts="silent")
    table["stream"] = [1, 2, 3]
    return changed(table, kind=kinds, caution=["-", "-", CHANCE])


@pytest.fixture(scope="module")
def folder(result, streams, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "new" / "folder"
    folder.mkdir(parents=True)
    (folder / "streams.ecsv").touch()
    with pytest.MonkeyPatch.context() as patch:
        # What the page shows need not be sharp.
        patch.setattr("astro_scc.visualization.style.DPI", 20)
        path = write_report(
            result, folder, streams=streams, title=f"3C {HOSTILE}",
            warnings=[f"beware of {HOSTILE}"],
            left_out=[("late.fits", f"no date, {HOSTILE}"), f"bad.fits {HOSTILE}"],
            rerun=f"astro-scc measure {HOSTILE}", all_figures=True,
        )  # fmt: skip
    assert path == folder / "report.html"
    return folder


@pytest.fixture(scope="module")
def page(folder, read_page):
    return read_page(folder / "report.html")


def test_the_page_stands_alone_for_every_reader(page, folder):
    assert not page.all("script") + page.all("link")
    assert not re.search(r"(src|href)=\"?(http|//)|url\(|@import", page.source)
    assert {img["src"][:22] for img in page.all("img")} == {"data:image/png;base64,"}
    files = {"report.html", "streams.ecsv", *(f"{name}.png" for name in FIGURES)}
    assert {path.name for path in folder.iterdir()} == files
    # Nothing that was given is code.
    assert page.words.count("<script>alert('1')</script>") >= 6
    assert "alert" not in str([attrs for _, attrs in page.tags])


def test_the_answer_comes_first(page, streams):
    said = answer.headline(streams).replace("+-", "±")
    assert said.startswith("Motion: ")
    order = [
        said, "1: acceleration: ", "beware of", f"3 (not significant): {CHANCE}.",
        "where no permutation reaches as much, an upper limit stands.",
        "Velocity spectrum.", "Speed against dist", "More figures", "Velocity map.",
        "epochs are aligned", "astro-scc measure",
        "Speed of the main stream from parts of the data: ", "2 epochs left out",
        "late.fits: no date", "max speed", "tested with", "numpy",
    ]  # fmt: skip
    places = [page.words.find(part) for part in order]
    assert -1 not in places, order[places.index(-1)]
    assert places == sorted(places)
    # Descriptions speak of headings, not of names of columns.
    assert "part of the error of the speed by the alignment" in page.words
    assert page.words.count(CHANCE) == 1
    assert [a["href"] for a in page.all("a")] == ["streams.ecsv"]


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_what_does_not_move_has_a_limit(result, share):
    table, features = result.streams.copy(), result.features
    own = features[features["stream"] == 1]
    table["pm_limit"][0] = share * own["pm"].max()
    named = ", ".join(map(str, own["feature"]))
    # There is none if a feature is faster.
    said = [line for line in answer.notes(table, features) if "upper limit" in line]
    assert said == (share > 1) * [
        f"Stream 1: {table['pm_limit'][0].value:.2g} mas/yr is the upper limit (95%) "
        f"of the mean speed of its features ({named})"
    ]


def test_features_are_counted_once(result):
    table, streams = result.features.copy(), result.streams
    alone = np.flatnonzero(table["secure"])[0]
    table["stream"] = 1
    table["stream"][alone] = 0
    number = table["feature"][alone]
    said = f"1 secure feature belongs to no stream ({number}): moving by 45 degrees"
    assert any(line.startswith(said) for line in answer.notes(streams, table))
    table["secure"] = np.arange(len(table)) == alone
    n, said = len(table) - 1, answer.feature_count(table)
    assert said == f"{n + 1} features ({n} of stream 1, 1 of no stream)"
    assert answer.headline(streams, table).endswith("; 1 secure feature of no stream.")


@pytest.fixture(scope="module")
def features(jet_results):
    return jet_results["radial"].features


@pytest.fixture(scope="module")
def radial(jet_results):
    """Streams away from a point, which have no direction on the sky."""
    return jet_results["radial"].streams[:1]


KINDS = "moving", "not confirmed", "stationary", "not significant"


@settings(max_examples=15)
@given(st.lists(st.sampled_from(KINDS), max_size=4))
def test_headline_and_table_agree(radial, features, kinds):
    order = sorted(kinds, key=KINDS.index)
    rows = vstack([radial, *[radial] * len(order)], metadata_conflicts="silent")[1:]
    table = changed(rows, kind=np.array(order, dtype="U15"), caution="why")
    table["stream"] = np.arange(len(order)) + 1
    table["pm"] = (1.1 * table["stream"] + 5) * PM_UNIT
    said, *lines = answer.stream_lines(table, features)
    shown = [k for k, kind in enumerate(order) if kind in KINDS[:2]]
    quoted = [f"{cell(table[k], 'pm', '+-')} mas/yr outward, " for k in shown]
    places = [said.find(text) for text in quoted]
    assert -1 not in places
    assert places == sorted(places)
    assert said.count("+-") == len(shown)
    for kind, word in zip(KINDS, ("Motion: ", "Not confirmed: "), strict=False):
        assert (word in said) == (kind in order)
    nothing = re.match("Nothing moves significantly: .* unambiguous to", said)
    assert bool(nothing) == (not shown)
    # Each row is a line, with its number and kind; and its caution is said.
    for k, kind in enumerate(order):
        assert re.split("  +", lines[2 + k])[:2] == [str(k + 1), kind]
        assert f"Stream {k + 1} ({kind}): why" in lines


#: Changes of a row of streams, and what the headline says.
SENTENCES = [
    ({"pm_parallel": -5 * PM_UNIT}, " inward, "),
    ({"n_features": 0}, "mas/yr outward, no features."),
    ({"n_features": 1}, "mas/yr outward, 1 feature."),
    ({"pm_min": 6.14 * PM_UNIT, "pm_max": 7.58 * PM_UNIT}, "features of 6.1 to 7.6."),
    ({"caution": "moves towards the core", "pm_pa": 90 * u.deg},
     "towards PA 90 deg, which is towards the core"),
    ({"caution": "why; no one direction holds for the emission: what to do"},
     "No one direction holds for the emission: what to do. Motion: "),
]  # fmt: skip


@pytest.mark.parametrize(("columns", "said"), SENTENCES)
def test_the_headline_of_one_stream(radial, columns, said):
    assert said in answer.headline(changed(radial, **columns))


def test_what_secure_features_would_need_is_said(features):
    table = changed(features, secure=False, motion=0.04, p_false=0.5)
    lines = answer.feature_lines(table)
    assert lines[0].startswith(f"{len(table)} features (")
    assert lines[0].endswith("), 0 of them secure.")
    assert "moved by 1 beam" in lines[2]
    words = r"The nearest to being secure is feature \d+: p_false .* errors"
    assert re.match(words, lines[-1])
    # What is not to be seen in ten times the time is no advice.
    assert "would have to be seen" not in lines[-1]
    table = table[:1]
    table["motion"], table["p_false"], table["pm"] = 0.4, 0.01, 4 * table["pm_err"]
    (years,) = re.findall(r"be seen for (\S+) yr", answer.feature_lines(table)[-1])
    span = (table["last"] - table["first"])[0].to_value(u.yr)
    assert float(years) == pytest.approx(span / 0.4, rel=0.05)
    table["stream"] = 0
    assert answer.feature_lines(table)[0] == "1 feature, 0 of them secure."


#: Values, their errors and how both are written.
WRITTEN = [
    (5.5687, 0.4323, "5.57 ± 0.43"), (117.3, 12.2, "117 ± 12"),
    (0.01234, 0.00098, "0.01234 ± 0.00098"), (0.5804, 0.0998, "0.58 ± 0.10"),
    (5.5687, np.nan, "5.57 (error unknown)"), (5.5687, np.inf, "5.57 (error unknown)"),
    (5.5687, 0.0, "5.57"), (np.nan, 0.1, "-"),
]  # fmt: skip


def test_numbers_have_two_digits_of_their_error():
    assert [(v, e, with_error(v, e)) for v, e, _ in WRITTEN] == WRITTEN


def test_choices_that_change_the_speed_are_named(result):
    choices = [dict(row) for row in result.choices]
    choices[1]["significant"] = True
    other = replace(result, choices=choices)
    (said,) = answer.notes(other.streams, other.features)
    assert said.startswith("Stream 1 (moving): its speed differs between parts: ")
    assert f"({choices[1]['choice']})" in said
    assert "(the whole spectrum)" in said
    assert replace(result, choices=[]).sensitivity_line == ""
