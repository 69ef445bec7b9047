# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The report: sentences, tables, figures and files, and the same on the terminal."""

import base64
import os
import re
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import Column, vstack
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.columns import cell
from astro_scc.kinematics import paper_cosmology
from astro_scc.quantities import with_error
from astro_scc.report import write_report
from astro_scc.report.answer import component_lines, feature_lines, headline, notes
from astro_scc.report.page import acceleration_text, draw_figures, feature_rows
from astro_scc.units import PM_UNIT

CHANCE = "permuted epochs give as strong a peak (p_global 0.62)"
HOSTILE = "<script>alert('1')</script> & \"more\""
MAIN = ("separation", "tracks", "diagram", "speeds")
MORE = ("velocity_map", "significance", "members", "epochs", "sensitivity")


@pytest.fixture(scope="module")
def result(jet_results):
    """Of epochs with names that are code."""
    measured = jet_results["jet"]
    cube = measured.cube
    labels = (HOSTILE, *(f"epoch{k}.fits" for k in range(len(cube) - 1)))
    cube = replace(cube, labels=labels).with_step(f"tested with {HOSTILE}")
    return replace(measured, matched=replace(measured.matched, cube=cube))


def changed(table, **columns):
    """Return a copy of components with other columns, of text of any length."""
    table = table.copy()
    if "caution" in columns:
        caution = np.broadcast_to(columns.pop("caution"), len(table))
        table.replace_column("caution", Column(caution, description="what counts"))
    for name, value in columns.items():
        table[name] = value
    return table


@pytest.fixture(scope="module")
def components(result):
    """Three kinds of components."""
    table = result.components_in_c(redshift=0.033, cosmology=paper_cosmology())
    assert list(table["kind"]) == ["moving", "stationary"]
    kinds = ["moving", "stationary", "not significant"]
    return changed(vstack([table, table[:1]]), kind=kinds, caution=["-", "-", CHANCE])


@pytest.fixture(scope="module")
def folder(result, components, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "new" / "folder"
    folder.mkdir(parents=True)
    (folder / "components.ecsv").touch()
    with pytest.MonkeyPatch.context() as patch:
        # What the page shows need not be sharp.
        patch.setattr("astro_scc.visualization.style.DPI", 20)
        path = write_report(
            result, folder, components=components, title=f"3C {HOSTILE}",
            warnings=[f"beware of {HOSTILE}"],
            left_out=[("late.fits", f"no date, {HOSTILE}"), f"bad.fits {HOSTILE}"],
            rerun=f"astro-scc measure {HOSTILE}", all_figures=True,
        )  # fmt: skip
    assert path == folder / "report.html"
    return folder


@pytest.fixture(scope="module")
def page(folder, read_page):
    return read_page(folder / "report.html")


@pytest.fixture
def words_of(tmp_path, monkeypatch, read_page):
    """Write a report without the time that figures take; its text."""
    figures = {"velocity_map.png": b"PNG"}
    monkeypatch.setattr("astro_scc.report.page.draw_figures", lambda *_, **_k: figures)

    def write(result, components=None, **more):
        how = {"components": components, "title": "M87"} | more
        return read_page(write_report(result, tmp_path, **how)).words

    return write


# -- the page ------------------------------------------------------------------------


def test_the_page_stands_alone_for_every_reader(page, folder):
    assert not page.all("script") + page.all("link")
    assert not re.search(r"(src|href)=\"?(http|//)|url\(|@import", page.source)
    heads, inside = zip(
        *(img["src"].split(",") for img in page.all("img")), strict=True
    )
    assert set(heads) == {"data:image/png;base64"}
    beside = [(folder / f"{name}.png").read_bytes() for name in MAIN + MORE]
    assert [base64.b64decode(data) for data in inside] == beside
    files = {"report.html", "components.ecsv", *(f"{name}.png" for name in MAIN + MORE)}
    assert {path.name for path in folder.iterdir()} == files
    # Nothing that was given is code.
    assert page.words.count("<script>alert('1')</script>") >= 6
    assert "alert" not in str([attrs for _, attrs in page.tags])
    # For who cannot see, and for narrow screens and paper.
    assert len({img["alt"] for img in page.all("img")}) == len(MAIN + MORE)
    assert page.all("html") == [{"lang": "en"}]
    assert all(th["scope"] == "col" for th in page.all("th"))
    screen, paper = page.source.split("</style>")[0].split("@media print")
    assert ".wide { overflow-x: auto; }" in screen
    assert ".wide { overflow: visible; }" in paper
    assert page.all("div").count({"class": "wide"}) == len(page.all("table")) == 5


def test_the_answer_comes_first(page, components):
    said = headline(components).replace("+-", "±")
    assert said.startswith("Motion: ")
    order = [
        said, "1: acceleration: ", "beware of", f"1 (not significant): {CHANCE}.",
        "at any velocity; here it cannot be below 0.024.", "Separation against time.",
        "More figures", "Velocity map.", "Main speed with other choices.",
        "astro-scc measure", "Sensitivity to the choice of the data: no part in which",
        "2 epochs left out", "late.fits: no date", "max speed", "tested with", "numpy",
    ]  # fmt: skip
    places = [page.words.find(part) for part in order]
    assert -1 not in places, order[places.index(-1)]
    assert places == sorted(places)
    kinds = [tr.get("class") for tr in page.all("tr") if tr.get("class")]
    # What the answer is made of, and the rest.
    assert kinds[:4] == 2 * ["moving", "not-significant"]
    heads = {
        "speed (mas/yr)", "speed (c)", "PA (deg)", "SSPs", "z-score (paper)",
        "dispersion (mas/yr)", "paper's error of the speed (mas/yr)",
    }  # fmt: skip
    assert heads <= set(page.text)
    for words in (
        cell(components[2], "p_global"), "speed (c): apparent speed, in units of c",
        # Descriptions speak of headings, not of names of columns.
        "part of the error of the speed by the alignment", "position angle 270 deg",
        "baseline not given", "scales 1, 2, 3", "small displacement correction no",
        "cosmology FlatLambdaCDM with H0 = 71 km/s/Mpc, Om0 = 0.27",
    ):  # fmt: skip
        assert words in page.words
    assert page.words.count(CHANCE) == 1
    assert [a["href"] for a in page.all("a")] == ["components.ecsv"]


def test_each_feature_has_its_own_speed(result, page):
    part = page.source.split("<h2>Features</h2>")[1].split("</section>")[0]
    rows = re.findall(r"<tr(?: class=not-significant)?>(.*)</tr>", part)
    head, *rows = [re.findall(r"<t[hd][^>]*>([^<]*)", row) for row in rows]
    rows = [cells for cells in rows if cells != head]
    # Those that are not secure are folded away.
    n_secure = part.partition("<details>")[0].count("<tr>") - 1
    assert n_secure == result.features["secure"].sum() > 0
    features = result.features[np.argsort(~result.features["secure"], kind="stable")]
    for cells, row in zip(rows, features, strict=True):
        assert cells[:3] == [str(row[k]) for k in ("feature", "component", "n_epochs")]
        assert cells[3] == row["first"].strftime("%Y-%m-%d")
        assert cells[head.index("speed (mas/yr)")] == cell(row, "pm")
    # Of many, those that were seen longest are shown.
    table = changed(result.features, secure=True)
    longest = np.sort(np.argsort(-table["n_epochs"], kind="stable")[:2])
    numbers = table["feature"].astype(str)
    _, said, _, *lines, _ = feature_lines(table, most=2)
    assert said.endswith("secure; the 2 that were seen in most epochs:")
    for line, row in zip(lines, table[longest], strict=True):
        assert line.split()[:2] == [str(row["feature"]), str(row["component"])]
        assert cell(row, "pm", "+-") in line
    _, shown, others = feature_rows(table, 2)
    assert [cells[0] for cells, _ in shown] == list(numbers[longest])
    assert [cells[0] for cells, _ in others] == list(np.delete(numbers, longest))


@pytest.mark.slow
def test_the_same_files_each_time_and_as_pdf(result, tmp_path, monkeypatch):
    monkeypatch.setattr("astro_scc.visualization.style.DPI", 20)
    a, b = (write_report(result, tmp_path / name, pdf=True).parent for name in "ab")
    assert all(k.read_bytes() == (b / k.name).read_bytes() for k in a.iterdir())
    assert {k.stem for k in a.glob("*.pdf")} == set(MAIN)


def test_figures_that_are_empty_or_not_wanted(result, monkeypatch, words_of):
    empty = replace(result, maxima=(), velocities=(), jitters=())
    words = words_of(empty, rerun="astro-scc measure again")
    assert "No motion found: no pattern has a match in another epoch." in words
    assert "p_global is" not in words
    monkeypatch.setattr(
        "astro_scc.visualization.style.figure_files", lambda figures, **_: set(figures)
    )
    assert draw_figures(result, result.components) == set(MAIN)
    drawn = draw_figures(empty, empty.components, every=True)
    assert drawn == {*MAIN, *MORE} - {"members"}


# -- what it says --------------------------------------------------------------------

#: Columns of components, and what the page says of them and does not.
FAST = "Stream 1 is as fast as anything that was searched: measure with a larger"
SAID = [
    ({"kind": "not significant", "caution": CHANCE}, [
        "which does not show",
        f"Stream 1 (not significant): {CHANCE}. Stream 2 (not significant): {CHANCE}.",
    ], "): -"),
    ({"kind": "stationary"}, ["mas/yr: all features are stationary within"], FAST),
    # Small probabilities are not rounded to nothing, columns that are new are shown,
    # and text is no code.
    ({"p_local": 0.000123, "gamma_min": 1.2346, "caution": "<b>good</b>"},
     [" 0.00012 ", "gamma_min", " 1.235 ", "<b>good</b>", FAST], "0.000123"),
    ({"p_smallest": 1 / 11}, ["p_global cannot be below 0.091: with so few no"], "/N"),
    # The core is no component of the jet.
    ({}, ["Row 2 of components.ecsv is the core, the reference."], "2 stationary"),
]  # fmt: skip


@pytest.mark.parametrize(("columns", "said", "unsaid"), SAID)
def test_what_the_page_says_of_components(
    result, words_of, monkeypatch, columns, said, unsaid
):
    # The features move at 7.3 mas/yr of 30.
    monkeypatch.setattr("astro_scc.report.page.EDGE", 0.2)
    words = words_of(result, changed(result.components, **columns))
    assert [text for text in said if text not in words] == []
    assert unsaid not in words


def test_the_headline_names_each_stream(result):
    table = result.components[[0, 0, 0]]
    table["kind"] = ["moving", "moving", "not confirmed"]
    said = headline(table)
    assert said.count("towards PA") == 2
    assert component_lines(table, result.features)[0] == said


def test_choices_that_change_the_speed_are_named(result, words_of):
    choices = [dict(row) for row in result.choices]
    choices[1]["significant"] = True
    words = words_of(replace(result, choices=choices))
    assert "Stream 1 (moving): differs with the data: " in words
    assert f"({choices[1]['choice']})" in words
    assert "Sensitivity to" not in words_of(replace(result, choices=[]))
    assert FAST not in words


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_what_does_not_move_has_a_limit(result, share):
    table, features = result.components.copy(), result.features
    own = features[features["component"] == 1]
    assert table["pm_limit"][1] == table["pm"][1] + 1.645 * table["pm_err"][1]
    table["pm_limit"][0] = share * own["pm"].max()
    named = ", ".join(map(str, own["feature"]))
    # The core has none, and neither have features of which one is faster.
    said = [line for line in notes(table, features) if "upper limit" in line]
    assert said == (share > 1) * [
        f"Stream 1: {table['pm_limit'][0].value:.2g} mas/yr is the upper limit (95%) "
        f"of the mean speed of its features ({named})"
    ]


def test_a_core_is_known_by_its_beam(result, words_of):
    table = result.components.copy()
    assert table.meta["core"] == [2]
    plain = replace(result.cube, beams=None)
    plain = replace(result, matched=replace(result.decomposed, cube=plain))
    assert plain.core == []
    table.meta["core"] = []
    assert "2 stationary" in words_of(result, table)


def test_the_page_with_linked_panels_is_linked(result, tmp_path, words_of, read_page):
    command = {"explore": "astro-scc explore out"}
    said = "features, epochs and velocities: astro-scc explore out"
    assert said in words_of(result, **command)
    (tmp_path / "explore.html").write_text("here")
    assert said not in words_of(result, **command)
    assert {"href": "explore.html"} in read_page(tmp_path / "report.html").all("a")


def test_accelerations_are_named(result):
    table = result.features.copy()
    table["acc_parallel"][:] = np.nan
    assert acceleration_text(table) == ""
    k, unit = np.flatnonzero(table["secure"])[0], table["acc_parallel"].unit
    table["acc_parallel"][k], table["acc_parallel_err"][k] = 1.25 * unit, 0.31 * unit
    assert acceleration_text(table) == f"{table['feature'][k]}: 1.25 ± 0.31 mas/yr²"


def test_what_cannot_be_written(result, tmp_path, words_of, monkeypatch):
    (tmp_path / "out").touch()
    with pytest.raises(OSError, match="out: is a file; choose another folder"):
        write_report(result, tmp_path / "out")
    (tmp_path / "report.html").write_text("old")

    def fail(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="No space left"):
        words_of(result)
    assert {path.name for path in tmp_path.iterdir()} == {"report.html", "out"}
    assert (tmp_path / "report.html").read_text() == "old"


# -- the terminal --------------------------------------------------------------------


@pytest.fixture(scope="module")
def features(jet_results):
    return jet_results["radial"].features


@pytest.fixture(scope="module")
def radial(jet_results):
    """Components away from a point, which have no direction on the sky."""
    row = jet_results["radial"].components[:1]
    return changed(
        vstack([row] * 4, metadata_conflicts="silent"),
        kind=["moving", "not significant", "stationary", "not significant"],
        p_global=[0.00099, 0.5, 1.0, 0.3], caution=["-", "permuted", "-", "blends"],
    )  # fmt: skip


def test_lines_of_components(radial, features):
    lines = component_lines(radial, features)
    speed, n = cell(radial[0], "pm", "+-"), radial["n_features"][0]
    assert lines[:2] == [f"Motion: {speed} mas/yr outward, {n} features.", ""]
    assert {"stream", "proper motion (mas / yr)"} <= set(re.split("  +", lines[2]))
    spread = f"{radial['dispersion'][0].value:.2g}"
    row = ["1", "moving", speed, "-", spread, "0.00099", str(n)]
    assert re.split("  +", lines[3]) == row
    assert re.split("  +", lines[5])[1:6:4] == ["stationary", "-"]
    assert lines[7].startswith("p_global: probability that epochs in permuted order")
    assert [line.partition(": ")[2] for line in lines[9:11]] == ["permuted", "blends"]
    low, high = (radial.meta[f"{k}_searched"].value for k in ("slowest", "fastest"))
    assert 0 < low < 2 < 20 < high < 40
    said = f"strongest peak between {low:.2g} and {high:.2g} mas/yr has"
    assert said in headline(radial[1:2])
    assert "larger region or --max-speed" in component_lines(radial[:0], features)[1]


#: Changes of a row of components, and lines of what is said.
LINES = [
    ({"pm_parallel": -5 * PM_UNIT}, {0: " inward, "}),
    ({"kind": "not confirmed", "caution": "rest is near"},
     {0: "not confirmed: {speed} mas/yr with p_global {p}, but rest is near."}),
    ({"kind": "not confirmed", "caution": "none is seen", "n_features": 0,
      "pm": np.nan * PM_UNIT, "pm_limit": 3 * PM_UNIT},
     {0: "Motion not confirmed: p_global {p}, but none is seen.",
      3: "1       not confirmed                         -         -  "}),
    ({"kind": "not significant", "caution": "permuted"},
     {0: "mas/yr has p_global {p}, which does not show",
      6: "Stream 1 (not significant): permuted"}),
    ({"dispersion": 1 * PM_UNIT, "dispersion_err": 0.4 * PM_UNIT,
      "pm_min": 0.14 * PM_UNIT, "pm_max": 0.58 * PM_UNIT},
     {0: "Motion: 0.14 to 0.58 mas/yr, mean {speed} mas/yr outward, "}),
    ({"caution": "moves towards the core", "pm_pa": 90 * u.deg},
     {0: "towards PA 90 deg, which is towards the core"}),
]  # fmt: skip


@pytest.mark.parametrize(("columns", "said"), LINES)
def test_lines_of_one_component(radial, features, columns, said):
    table = changed(radial[:1], **columns)
    lines = component_lines(table, features)
    known = {"speed": cell(table[0], "pm", "+-"), "p": f"{table['p_global'][0]:.2g}"}
    for place, words in said.items():
        assert words.format(**known) in lines[place]


def test_what_secure_features_would_need_is_said(features):
    table = changed(features, secure=False, motion=0.04, p_false=0.5)
    lines = feature_lines(table)
    assert lines[0] == f"{len(table)} features, 0 of them secure."
    assert "moves by at least" in lines[1]
    assert re.match(r"The nearest to that is feature \d+: p_false .* errors", lines[2])
    # What is not to be seen in ten times the time is no advice.
    assert "would have to be seen" not in lines[2]
    table = table[:1]
    table["motion"], table["p_false"], table["pm"] = 0.4, 0.01, 4 * table["pm_err"]
    (years,) = re.findall(r"be seen for (\S+) yr", feature_lines(table)[2])
    span = (table["last"] - table["first"])[0].to_value(u.yr)
    assert float(years) == pytest.approx(span / 0.4, rel=0.05)
    assert feature_lines(table)[0] == "1 feature, 0 of them secure."
    assert feature_lines(table[:0])[0] == "0 features, 0 of them secure."


# -- cells ---------------------------------------------------------------------------


#: Values, their errors and how both are written.
WRITTEN = [
    (5.5687, 0.4323, "5.57 ± 0.43"), (117.3, 12.2, "117 ± 12"),
    (0.01234, 0.00098, "0.01234 ± 0.00098"), (0.5804, 0.0998, "0.58 ± 0.10"),
    (5.5687, np.nan, "5.57 (error unknown)"), (5.5687, np.inf, "5.57 (error unknown)"),
    (5.5687, 0.0, "5.57"), (np.nan, 0.1, "-"),
]  # fmt: skip


def test_numbers_have_two_digits_of_their_error():
    assert [(v, e, with_error(v, e)) for v, e, _ in WRITTEN] == WRITTEN


@given(st.floats(-1e4, 1e4), st.floats(1e-6, 1e3))
def test_rounding_is_small_beside_the_error(value, error):
    shown, shown_error = map(float, with_error(value, error).split(" ± "))
    assert shown_error == pytest.approx(error, rel=0.06, abs=0.5 if error > 10 else 0)
    assert abs(shown - value) <= max(0.051 * error, 0.5) + 1e-9
