# Licensed under a 3-clause BSD style license - see LICENSE.rst

import base64
import os
import re
from dataclasses import replace
from html.parser import HTMLParser

import astropy.units as u
import numpy as np
import pytest
from astropy.table import Column, vstack
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.cli.summary import component_lines
from astro_scc.kinematics import paper_cosmology
from astro_scc.measurement.tables import core_streams
from astro_scc.quantities import with_error
from astro_scc.report import write_report
from astro_scc.report.answer import headline, notes
from astro_scc.report.tables import feature_rows

CHANCE = "permuted epochs give as strong a peak (p_global above alpha)"
HOSTILE = "<script>alert('1')</script> & \"more\""
MAIN = ("separation", "tracks", "diagram", "speeds")
MORE = ("velocity_map", "significance", "members", "epochs", "intervals", "sensitivity")
VOID = {"meta", "img", "br", "link", "hr"}


class Page(HTMLParser):
    """The elements and the text of a page; fails if a tag is not closed."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.text = [], [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open:
            self.text.append(data)

    def all(self, tag):
        return [attrs for name, attrs in self.tags if name == tag]

    @property
    def words(self):
        return " ".join(" ".join(self.text).split())


@pytest.fixture(scope="module")
def result(jet_results):
    """Of epochs with names that are code."""
    measured = jet_results["jet"]
    cube = measured.cube
    labels = (HOSTILE, *(f"epoch{k}.fits" for k in range(len(cube) - 1)))
    cube = replace(cube, labels=labels).with_step(f"tested with {HOSTILE}")
    return replace(measured, matched=replace(measured.matched, cube=cube))


@pytest.fixture(scope="module")
def components(result):
    """Three kinds of components."""
    table = result.components_in_c(redshift=0.033, cosmology=paper_cosmology())
    assert list(table["kind"]) == ["moving", "stationary"]
    table = vstack([table, table[:1]])
    table["kind"][2] = "not significant"
    return with_notes(table, ["-", "-", CHANCE])


def with_notes(table, notes):
    description = table["caution"].info.description
    table.replace_column("caution", Column(notes, description=description))
    return table


@pytest.fixture(scope="module")
def folder(result, components, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "new" / "folder"
    folder.mkdir(parents=True)
    (folder / "components.ecsv").touch()
    path = write_report(
        result, folder, components=components, title=f"3C {HOSTILE}",
        warnings=[f"beware of {HOSTILE}"],
        left_out=[("late.fits", f"no date, {HOSTILE}"), f"bad.fits {HOSTILE}"],
        rerun=f"astro-scc measure {HOSTILE}", all_figures=True,
    )  # fmt: skip
    assert path == folder / "report.html"
    return folder


@pytest.fixture(scope="module")
def page(folder):
    return Page((folder / "report.html").read_text(encoding="utf-8"))


@pytest.fixture
def quick(monkeypatch):
    """Reports without the time that figures take."""
    figures = {"velocity_map.png": b"PNG"}
    monkeypatch.setattr("astro_scc.report.page.draw_figures", lambda *_, **_k: figures)


def test_the_page_stands_alone(page, folder):
    assert not page.all("script")
    assert not page.all("link")
    for img in page.all("img"):
        head, data = img["src"].split(",")
        assert head == "data:image/png;base64"
        assert base64.b64decode(data).startswith(b"\x89PNG")
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"(src|href)=\"?(http|//)|url\(|@import", text)


def test_who_cannot_see_it_hears_what_the_figures_show(page):
    alts = [img["alt"] for img in page.all("img")]
    assert alts[4] == (
        "Map of the stacked correlation over the velocities parallel and transverse, "
        "2 streams marked"
    )
    assert (
        alts[7]
        == "Images of up to twelve of 8 epochs with circles about their patterns"
    )
    assert len(set(alts)) == len(MAIN + MORE)
    assert page.all("html") == [{"lang": "en"}]
    assert all(th["scope"] == "col" for th in page.all("th"))


def test_it_fits_narrow_screens_and_paper(page, folder):
    assert {"name": "viewport", "content": "width=device-width, initial-scale=1"} in (
        page.all("meta")
    )
    style = (folder / "report.html").read_text(encoding="utf-8").split("</style>")[0]
    screen, paper = style.split("@media print")
    # What is wider than the screen scrolls by itself; on paper nothing can.
    assert ".wide { overflow-x: auto; }" in screen
    assert "figure img { display: block; width: 100%;" in screen
    assert ".wide { overflow: visible; }" in paper
    assert "break-inside: avoid" in paper
    assert page.all("div").count({"class": "wide"}) == len(page.all("table")) == 5


def test_the_figures_are_beside_it(page, folder):
    inside = [base64.b64decode(img["src"].split(",")[1]) for img in page.all("img")]
    beside = [(folder / f"{name}.png").read_bytes() for name in MAIN + MORE]
    assert inside == beside
    assert not list(folder.glob(".*"))
    assert {path.name for path in folder.iterdir()} == {
        "report.html", "components.ecsv", *(f"{name}.png" for name in MAIN + MORE)
    }  # fmt: skip


def test_nothing_that_was_given_is_code(page):
    assert page.words.count("<script>alert('1')</script>") >= 6
    assert "alert" not in str([attrs for _, attrs in page.tags])


def test_the_answer_comes_first(page, components):
    words = page.words
    said = headline(components).replace("+-", "±")
    assert said.startswith("Motion: ")
    order = [
        said,
        "1: acceleration: ",
        "beware of",
        f"Stream 1 (not significant): {CHANCE}.",
        "epochs in permuted order would give an equally strong peak at any velocity; "
        "here it cannot be below 0.024.",
        "Other columns of the velocity components",
        "Errors are from the alignment",
        "Separation against time.",
        "Paths of the features.",
        "Displacement against interval.",
        "Speed against separation.",
        "More figures",
        "Velocity map.",
        "Patterns of each stream.",
        "Main speed with other choices.",
        "astro-scc measure",
        "Sensitivity to the settings: no choice changes the main speed significantly "
        "and by more than its error",
        "intervals up to",
        "2 epochs left out",
        "late.fits: no date",
        "max speed",
        "tested with",
        "numpy",
    ]
    places = [words.find(part) for part in order]
    assert -1 not in places, order[places.index(-1)]
    assert places == sorted(places)


def test_the_table_has_a_row_for_each_component(page, components):
    kinds = [tr.get("class") for tr in page.all("tr") if tr.get("class")]
    # What the answer is made of, and the rest.
    assert kinds[:4] == 2 * ["moving", "not-significant"]
    for name in ("speed (mas/yr)", "speed (c)", "PA (deg)", "p_global", "SSPs",
                 "z-score (paper)", "dispersion (mas/yr)", "p_distinct", "kind",
                 "paper's error of the speed (mas/yr)"):  # fmt: skip
        assert name in page.text
    words = page.words
    assert with_error(components["p_global"][2], components["p_global_err"][2]) in words
    assert "the scatter of the speeds of features" in words
    assert words.count(CHANCE) == 1
    # Descriptions speak of headings, not of names of columns.
    assert "speed (c): apparent speed, in units of c" in words
    assert "part of the error of the speed by the alignment" in words


def test_it_names_the_settings_and_the_files(page):
    for words in ("position angle 270 deg", "min error beams 0.2", "baseline not given",
                  "scales 1, 2, 3", "n trials 40", "seed 1", "redshift 0.033",
                  "cosmology FlatLambdaCDM with H0 = 71 km/s/Mpc, Om0 = 0.27",
                  "small displacement correction no"):  # fmt: skip
        assert words in page.words
    assert [a["href"] for a in page.all("a")] == ["components.ecsv"]


def test_the_same_measurement_gives_the_same_page(
    result, components, tmp_path, quick, folder
):
    paths = [
        write_report(result, tmp_path / name, components=components, title="M87")
        for name in "ab"
    ]
    assert paths[0].read_bytes() == paths[1].read_bytes()


@pytest.mark.slow
def test_figures_as_pdf(result, components, tmp_path):
    write_report(result, tmp_path / "a", components=components)
    assert not list((tmp_path / "a").glob("*.pdf"))
    for name in "bc":
        write_report(result, tmp_path / name, components=components, pdf=True)
    written = {path.stem for path in (tmp_path / "b").glob("*.pdf")}
    assert written == {path.stem for path in (tmp_path / "b").glob("*.png")}
    for path in (tmp_path / "b").glob("*.pdf"):
        assert path.read_bytes().startswith(b"%PDF")
        assert path.read_bytes() == (tmp_path / "c" / path.name).read_bytes()


def words_of(result, components, folder, **kwargs):
    path = write_report(result, folder, components=components, title="M87", **kwargs)
    return Page(path.read_text(encoding="utf-8")).words


@pytest.mark.slow
def test_no_component_is_an_answer_too(result, tmp_path):
    empty = replace(result, maxima=(), velocities=(), jitters=())
    words = words_of(empty, empty.components, tmp_path)
    assert "No motion found: no pattern has a match in another epoch." in words
    assert "p_global is" not in words
    assert not (tmp_path / "members.png").exists()


NONE = f"Stream 1 (not significant): {CHANCE}. Stream 2 (not significant): {CHANCE}."
#: Columns of components, and what the page says of them and does not.
SAID = [
    ({"kind": "not significant", "caution": CHANCE}, "No motion found between", "): -"),
    ({"kind": "not significant", "caution": CHANCE}, NONE, "): -"),
    ({"kind": "not significant", "caution": "of one"}, "significant): of one.", "): -"),
    ({"kind": "not significant", "caution": "-"}, "No motion found", "): -"),
    ({"kind": "stationary"}, "mas/yr: all features are stationary within", "): -"),
    # Small probabilities are not rounded to nothing.
    ({"p_local": 0.000123}, " 0.00012 ", "0.000123"),
    # Columns that are new are shown, and their text is no code.
    ({"gamma_min": 1.2346}, "gamma_min", "1.2346"),
    ({"gamma_min": 1.2346}, " 1.235 ", "1.2346"),
    ({"caution": "<b>good</b>"}, "<b>good</b>", "): -"),
]


@pytest.mark.parametrize(("columns", "said", "unsaid"), SAID)
def test_what_the_page_says_of_components(
    result, tmp_path, quick, columns, said, unsaid
):
    table = result.components.copy()
    for name, value in columns.items():
        if name == "caution":
            with_notes(table, [value] * len(table))
        else:
            table[name] = value
    words = words_of(result, table, tmp_path)
    assert said in words
    assert unsaid not in words
    if columns.get("kind") == "stationary":
        assert "not significant" not in words.partition("Rows in italics")[0]


def test_each_feature_has_its_own_speed(result, folder):
    text = (folder / "report.html").read_text(encoding="utf-8")
    part = text.split("<h2>Features</h2>")[1].split("</section>")[0]
    rows = re.findall(r"<tr(?: class=not-significant)?>(.*)</tr>", part)
    head, *rows = [re.findall(r"<t[hd][^>]*>([^<]*)", row) for row in rows]
    rows = [cells for cells in rows if cells != head]
    assert head[:2] == ["No.", "stream"]
    assert head[-2:] == ["t_ej", "p_false"]
    assert "speed (c)" in head
    # Those that are not secure are folded away.
    n_secure = part.partition("<details>")[0].count("<tr>") - 1
    assert n_secure == result.features["secure"].sum() > 0
    features = result.features[np.argsort(~result.features["secure"], kind="stable")]
    for cells, row in zip(rows, features, strict=True):
        assert cells[:3] == [str(row[k]) for k in ("feature", "component", "n_epochs")]
        assert cells[3] == row["first"].strftime("%Y-%m-%d")
        speed = with_error(row["pm"].value, row["pm_err"].value)
        assert cells[head.index("speed (mas/yr)")] == speed


def test_of_many_features_those_seen_longest_are_shown(result):
    table = result.features.copy()
    table["secure"] = True
    assert len(table) > 3
    _, shown, others = feature_rows(table, 2)
    longest = np.sort(np.argsort(-table["n_epochs"], kind="stable")[:2])
    numbers = table["feature"].astype(str)
    assert [cells[0] for cells in shown] == list(numbers[longest])
    rest = np.delete(np.arange(len(table)), longest)
    assert [cells[0] for cells, _ in others] == list(numbers[rest])


def test_choices_that_change_the_speed_are_named(result, tmp_path, quick):
    table = result.components
    words = words_of(result, table, tmp_path)
    assert "no choice changes the main speed" in words
    choices = [dict(row) for row in result.choices]
    for row in choices[1:3]:
        row["significant"] = True
    other = replace(result, choices=choices)
    words = words_of(other, other.components, tmp_path)
    assert "Stream 1 (moving): differs with the data: " in words
    assert f"({choices[1]['choice']})" in words
    other = replace(result, choices=[])
    assert "Sensitivity to" not in words_of(other, table, tmp_path)


def test_what_does_not_move_has_a_limit(result, tmp_path, quick):
    table = result.components.copy()
    limit = table["pm_limit"][1]
    assert table["kind"][1] == "stationary"
    assert limit == table["pm"][1] + 1.645 * table["pm_err"][1]
    assert np.isnan(table["pm_limit"][0])
    # The core has none, and neither have features of which one is faster.
    assert "upper limit" not in words_of(result, table, tmp_path)
    own = result.features[result.features["component"] == 1]
    table["pm_limit"][0] = 1.1 * own["pm"].max()
    said = words_of(result, table, tmp_path)
    assert f"Stream 1: {table['pm_limit'][0].value:.2g} mas/yr is the upper" in said
    assert f"mean speed of these features ({own['feature'][0]}, " in said
    table["pm_limit"][0] = 0.9 * own["pm"].max()
    assert "upper limit" not in " ".join(notes(table[:1], result.features))
    assert "is slower than" not in said


def test_too_few_epochs_are_named(result, tmp_path, quick, monkeypatch):
    monkeypatch.setattr("astro_scc.report.page.flow_lines", lambda result: [])
    few = replace(result, matched=replace(result.matched, cube=result.cube[:4]))
    table = result.components.copy()
    assert "with so few" not in words_of(result, table, tmp_path)
    table["p_smallest"] = 2 / 24
    table["kind"] = ["not significant", "stationary"]
    line = (
        "With 4 epochs p_global cannot be below 0.083 (2/N!): with so few no motion "
        "can be significant; measure more epochs."
    )
    ssps = result.ssps[result.ssps["epoch"] < 4]
    object.__setattr__(few, "ssps", ssps)
    object.__setattr__(few, "features", result.features)
    vars(few.matched)["features"] = result.tracked_features
    assert line in words_of(few, table, tmp_path)
    # What stands still is told without an order of the epochs.
    assert "with so few" not in words_of(few, table[1:], tmp_path)


def test_too_few_trials_are_named(result, tmp_path, quick):
    table = result.components.copy()
    table["p_smallest"] = 1 / 11
    line = (
        "With 10 trials p_global cannot be below 0.091: with so few no motion can "
        "be significant; measure with more."
    )
    short = replace(result, meta={**result.meta, "n_trials": 10})
    assert line in words_of(short, table, tmp_path)


@pytest.mark.parametrize(
    ("kinds", "begin"),
    [
        (["not significant"], "No motion found between "),
        (["not confirmed", "not significant"], "Motion not confirmed: "),
        (["moving", "not confirmed"], "Motion: "),
        (["moving"] * 12, "Motion: "),
    ],
)
def test_headlines_are_those_of_the_terminal(
    result, tmp_path, quick, monkeypatch, kinds, begin
):
    monkeypatch.setattr("astro_scc.report.page.fast_components", lambda *_: [])
    table = vstack([result.components[:1]] * len(kinds), metadata_conflicts="silent")
    table["kind"] = kinds
    said = headline(table)
    assert said.startswith(begin)
    assert said.count("towards PA") == kinds.count("moving")
    assert said.replace("+-", "±") in words_of(result, table, tmp_path)
    assert component_lines(table, result.features)[0] == said


def test_a_radial_speed_is_outward_or_inward(result):
    table = result.components.copy()
    table["kind"] = "moving"
    table["pm_pa"] = np.nan * u.deg
    table["pm_parallel"] = [5, -5] * u.mas / u.yr
    said = headline(table)
    assert said.index(" outward, ") < said.index(" inward, ")


def test_without_features_there_is_no_speed(result, tmp_path, quick):
    table = result.components[:1].copy()
    table["kind"], table["n_features"] = ["not significant"], 0
    words = words_of(result, table, tmp_path)
    speed = with_error(table["pm"][0].value, table["pm_err"][0].value)
    rows = words.partition("Velocity components No.")[2].partition("Errors are")[0]
    assert rows
    assert speed not in rows
    assert speed not in words.partition("Velocity components No.")[0]


def test_a_component_as_fast_as_the_search_is_pointed_out(
    result, jet_stacked, tmp_path, quick
):
    line = (
        "Stream 1 is as fast as anything that was searched: measure with a larger "
        "max_speed before you believe it."
    )
    table = result.components
    assert "anything that was searched" not in words_of(result, table, tmp_path)
    # The features move at 7.3 mas/yr.
    close = jet_stacked(270 * u.deg, max_speed=7.5 * u.mas / u.yr)
    assert close.components["kind"][0] == "moving"
    assert line in words_of(close, close.components, tmp_path)
    chance = close.components.copy()
    chance["kind"] = "not significant"
    assert "anything that" not in words_of(close, chance, tmp_path)


def test_only_ssps_of_the_region_are_counted(result, tmp_path, quick):
    n = len(result.ssps)
    words = words_of(result, result.components, tmp_path)
    assert f"{n} significant" in words
    assert "outside the region" not in words
    ssps = result.ssps.copy()
    ssps["in_region"] = np.arange(n) < 5
    other = replace(result)
    object.__setattr__(other, "ssps", ssps)
    words = words_of(other, result.components, tmp_path)
    assert "; 5 significant" in words
    assert f"on 3 scales, of {n} in the images" in words


def test_the_core_is_no_component_of_the_jet(result, tmp_path, quick):
    table = result.components
    assert table.meta["core"] == [2]
    words = words_of(result, table, tmp_path)
    assert "Row 2 of components.ecsv is the core, the reference." in words
    assert "2 stationary" not in words
    plain = replace(result.cube, beams=None)
    plain = replace(result, matched=replace(result.matched, cube=plain))
    assert core_streams(plain) == []
    table = table.copy()
    table.meta["core"] = []
    words = words_of(result, table, tmp_path)
    assert "2 stationary" in words
    assert "is the core" not in words


def test_only_four_figures_are_drawn_unless_all_are_wanted(result, tmp_path):
    how = {"rerun": "astro-scc measure again"}
    words = words_of(result, result.components, tmp_path, **how)
    assert {path.stem for path in tmp_path.glob("*.png")} == set(MAIN)
    assert "are drawn by astro-scc measure again --all-figures" in words
    assert "write_report(..., all_figures=True)" in words_of(
        result, result.components, tmp_path
    )


def test_a_file_is_no_folder(result, components, tmp_path, quick):
    (tmp_path / "out").touch()
    with pytest.raises(OSError, match="out: is a file; choose another folder"):
        write_report(result, tmp_path / "out", components=components, title="M87")


def test_what_cannot_be_completed_leaves_what_was_there(
    result, components, tmp_path, quick, monkeypatch
):
    (tmp_path / "report.html").write_text("old")

    def fail(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="No space left"):
        write_report(result, tmp_path, components=components, title="M87")
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
    assert (tmp_path / "report.html").read_text() == "old"


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (5.5687, 0.4323, "5.57 ± 0.43"),
        (117.3, 12.2, "117 ± 12"),
        (0.01234, 0.00098, "0.01234 ± 0.00098"),
        (0.5804, 0.0998, "0.58 ± 0.10"),
        (5.5687, np.nan, "5.57 (error unknown)"),
        (5.5687, np.inf, "5.57 (error unknown)"),
        (5.5687, 0.0, "5.57"),
        (np.nan, 0.1, "-"),
    ],
)
def test_numbers_have_two_digits_of_their_error(value, error, text):
    assert with_error(value, error) == text


@given(st.floats(-1e4, 1e4), st.floats(1e-6, 1e3))
def test_rounding_is_small_beside_the_error(value, error):
    shown, shown_error = map(float, with_error(value, error).split(" ± "))
    assert shown_error == pytest.approx(error, rel=0.06, abs=0.5 if error > 10 else 0)
    assert abs(shown - value) <= max(0.051 * error, 0.5) + 1e-9


def test_the_page_with_linked_panels_is_linked(result, tmp_path, monkeypatch):
    monkeypatch.setattr("astro_scc.report.page.draw_figures", lambda *_, **_k: {})
    command = {"explore": "astro-scc explore out"}

    def written(**page):
        path = write_report(result, tmp_path, title="Jet", **page)
        return Page(path.read_text(encoding="utf-8"))

    def linked(page):
        return {"href": "explore.html"} in page.all("a")

    assert not linked(written())
    page = written(**command)
    assert not linked(page)
    assert "features, epochs and velocities: astro-scc explore out" in page.words
    (tmp_path / "explore.html").write_text("here")
    assert linked(written())
    assert "astro-scc explore" not in written(**command).words
