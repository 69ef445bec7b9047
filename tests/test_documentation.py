# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Every public name stands in the reference with an example; the pages are short."""

import ast
import builtins
import csv
import inspect
import re
import runpy
import textwrap
from importlib import import_module
from pathlib import Path

import pytest
from astropy import units

import astro_scc

REPOSITORY = Path(__file__).parents[1]
DOCS = REPOSITORY / "docs"
PACKAGE = Path(astro_scc.__file__).parent
PAGES = sorted(path.stem for path in DOCS.glob("*.rst"))


def page(name):
    return (DOCS / f"{name}.rst").read_text(encoding="utf-8")


#: Packages and modules whose names are in the reference of a page.
LISTED = re.findall(
    r"\n\.\. automodapi:: astro_scc\.([\w.]+)(?=\n)", "\n".join(map(page, PAGES))
)


def packages():
    """Names of all packages that export names, but for the command line."""
    for path in PACKAGE.rglob("*/__init__.py"):
        name = ".".join(path.parent.relative_to(PACKAGE).parts)
        if name != "cli" and getattr(import_module(f"astro_scc.{name}"), "__all__", ()):
            yield name


ROOMS = sorted({"exceptions", "scc", *packages(), *LISTED})
#: Methods that users call by an operator.
SPECIAL = "__call__", "__getitem__", "__iter__", "__len__"
#: All pages together, in words with their examples and equations.
LONGEST = 20_000


def public_names():
    """Every class and function that a room exports, under its first name."""
    seen = set()
    for room in ROOMS:
        module = import_module(f"astro_scc.{room}")
        for name in module.__all__:
            thing = getattr(module, name)
            if callable(thing) and id(thing) not in seen:
                seen.add(id(thing))
                yield f"{room}.{name}", thing


PUBLIC = dict(public_names())


def with_methods():
    """The same, with the public methods of the classes, inherited ones too."""
    for name, thing in PUBLIC.items():
        yield f"astro_scc.{name}"
        if inspect.isclass(thing):
            for method, value in inspect.getmembers(thing, inspect.isroutine):
                own = getattr(value, "__module__", None) or ""
                if not method.startswith("_") and own.startswith("astro_scc"):
                    yield f"astro_scc.{name}.{method}"


def test_every_public_name_has_an_example_and_a_place_in_the_reference():
    # They run as doctests of the package.
    texts = {name: thing.__doc__ or "" for name, thing in PUBLIC.items()}
    assert [name for name, text in texts.items() if ">>> " not in text] == []
    assert {"epochs.EpochCube", "scc.StackedCrossCorrelation"} <= set(PUBLIC)
    assert sorted(LISTED) == ROOMS
    assert page("reference").count("automodapi::") == len(ROOMS)


def test_every_docstring_is_complete():
    validate = pytest.importorskip(
        "numpydoc.validate", reason="numpydoc is among the tools of the documentation"
    )
    conf = runpy.run_path(str(DOCS / "conf.py"))
    checks = conf["numpydoc_validation_checks"]
    fields = re.compile(conf["numpydoc_validation_overrides"]["PR01"][0])
    problems = []
    for name in with_methods():
        found = validate.validate(name)
        made = fields.search(found["docstring"])
        for code, text in found["errors"]:
            if code in checks and not (code == "PR01" and made):
                problems.append(f"{name}: {code} {text}")
    assert problems == []


def functions():
    """Names, functions and docstrings of what public names define themselves."""
    for name, thing in PUBLIC.items():
        members = vars(thing) if inspect.isclass(thing) else {"": thing}
        for member, value in members.items():
            for wrapped in ("__func__", "fget", "func"):
                value = getattr(value, wrapped, value)
            private = member.startswith("_") and member not in SPECIAL
            # An attribute, or what a dataclass has made, has no source.
            if inspect.isfunction(value) and value.__code__.co_filename[0] != "<":
                made = member in ("__init__", "__post_init__")
                if made or not private:
                    text = thing.__doc__ if made else value.__doc__
                    yield f"{name}.{member}", value, text or ""


def test_every_public_signature_is_annotated():
    # Mypy checks them, by the step "types" of .ci/run.
    missing = []
    for name, function, _ in functions():
        signature = inspect.signature(function)
        if name.endswith("_init__"):
            continue
        for parameter in signature.parameters.values():
            kind, optional = str(parameter.annotation), parameter.default is None
            if parameter.name not in ("self", "cls") and (
                parameter.annotation is parameter.empty
                or (optional and not re.search("None|Any", kind))
            ):
                missing.append(f"{name}: {parameter}")
        if signature.return_annotation is signature.empty:
            missing.append(f"{name}: what it returns")
    assert missing == []


def test_every_error_is_documented():
    missing = []
    for name, function, text in functions():
        for node in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(function)))):
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                error = getattr(node.exc.func, "id", "")
                kind = getattr(builtins, error, None) or getattr(units, error, None)
                if kind and not issubclass(kind, (AttributeError, StopIteration)):
                    if not any(base.__name__ in text for base in kind.__mro__[:-3]):
                        missing.append(f"{name}: {error}")
    assert missing == []


def test_documentation_is_short_and_in_the_table_of_contents():
    words = sum(len(page(name).split()) for name in PAGES)
    assert words < LONGEST
    (first, _) = page("start").split("Get the table of 3C 120\n", 1)
    assert len(first.split()) < 300
    assert "Your own images" in first
    entries = re.findall(r"^   (\w+)$", page("index"), re.MULTILINE)
    assert sorted([*entries, "index"]) == PAGES


def calibrated(name):
    """The rows of a table of the calibration by the kind of jet."""
    path = REPOSITORY / "benchmarks" / "calibration" / "results" / f"{name}_table.csv"
    if not path.is_file():
        pytest.skip("the benchmarks are not part of this copy")
    with open(path, encoding="utf-8") as file:
        return {row["jets"]: row for row in csv.DictReader(file)}


def limits(text):
    """The 95% interval of a share."""
    _, low, high = map(float, re.findall(r"[\d.]+", text))
    return low, high


def test_what_is_said_of_the_calibration_is_what_it_found():
    """The page has words beside the tables; these are the numbers."""
    text = " ".join(page("validation").split())
    assert "are right to two per cent on average" in text
    static, speeds, streams = map(calibrated, ("static", "speeds", "streams"))
    static.pop("random-velocity")
    assert all(limits(row["moving row"])[0] <= 0.02 for row in static.values())
    usual = [k for k in speeds if k.startswith(("single", "features", "epochs"))]
    assert abs(sum(float(speeds[k]["bias"]) for k in usual) / len(usual)) <= 0.02
    paper = [k for k in streams if k.endswith(("region", "whole"))]
    assert len(paper) == 4
    assert all(limits(streams[k]["both"])[1] >= 0.95 for k in paper)


def test_the_ten_lines_of_a_measurement_name_what_is_there():
    source = (REPOSITORY / "astro_scc" / "scc.py").read_text(encoding="utf-8")
    head = source.partition('"""')[2].partition('"""')[0]
    lines = re.findall(r"^ +([\w, ]+?) += (?:\w+\.)*(\w+)\(", head, re.MULTILINE)
    assert len(lines) == 10
    code = "\n".join(path.read_text("utf-8") for path in PACKAGE.rglob("*.py"))
    for _, function in lines:
        assert re.search(rf"(?:def|class) {function}\b", code), function
