# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Configuration of Sphinx."""

import argparse
import ast
import csv
import json
import os
from base64 import b64encode
from pathlib import Path
from textwrap import indent
from unittest import mock

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util import logging

import astro_scc
from astro_scc.cli.program import build_parser, option_name
from astro_scc.settings import OPTIONS

LOGGER = logging.getLogger(__name__)

project = "astro_scc"
author = "The astro_scc developers"
copyright = f"2026, {author}"
release = astro_scc.__version__
version = ".".join(release.split(".")[:2])

extensions = [
    "sphinx.ext.autodoc",
    "sphinx_automodapi.automodapi",
    "numpydoc",
    "pytest_doctestplus.sphinx.doctestplus",
    "matplotlib.sphinxext.plot_directive",
    "sphinx_design",
]
exclude_patterns = ["_build"]
default_role = "obj"
# In the pages themselves, for readers without a network.
html_math_renderer = "mathml"
# Every link within these pages must lead somewhere.
nitpicky = True
nitpick_ignore_regex = [
    # Parts of what public functions return, explained where it is returned, and types.
    (
        "py:class",
        r"astro_scc\.(paper|spectrum|grid|streams|settings|epochs|images|matching|patterns|measurement|kinematics)"
        r"\..*|tuple\[.*|dict\[.*|list\[.*",
    ),
    ("py:obj", "astro_scc"),
]

# Builds must pass without a network, which the links to other packages need; Read the
# Docs has one.
if not os.environ.get("READTHEDOCS"):
    others = (
        "argparse|astropy|bokeh|collections|concurrent|contextlib|dask|glue|jinja2|"
        "matplotlib|multiprocessing|ndcube|numpy|pathlib|photutils|regions|reproject|"
        "scipy|skimage|spectral_cube|sunpy|typing|warnings"
    )
    nitpick_ignore_regex.append((r"py:.*", rf"({others})(\..*)?"))
else:
    extensions.append("sphinx.ext.intersphinx")
    intersphinx_mapping = {
        "python": ("https://docs.python.org/3", None),
        "numpy": ("https://numpy.org/doc/stable/", None),
        "scipy": ("https://docs.scipy.org/doc/scipy/", None),
        "matplotlib": ("https://matplotlib.org/stable/", None),
        "astropy": ("https://docs.astropy.org/en/stable/", None),
        "skimage": ("https://scikit-image.org/docs/stable/", None),
        "photutils": ("https://photutils.readthedocs.io/en/stable/", None),
        "regions": ("https://astropy-regions.readthedocs.io/en/stable/", None),
        "reproject": ("https://reproject.readthedocs.io/en/stable/", None),
        "ndcube": ("https://docs.sunpy.org/projects/ndcube/en/stable/", None),
    }

automodapi_toctreedirnm = "api"
automodapi_inheritance_diagram = False
numpydoc_show_class_members = False
# The docstrings say them, with shapes and units.
autodoc_typehints = "none"
numpydoc_xref_param_type = False
# What every public docstring must have; a failure is a warning, and so an error.
numpydoc_validation_checks = {
    "GL01",  # text starts on the line after the quotes
    "GL06",  # unknown section
    "GL07",  # order of the sections
    "GL08",  # no docstring
    "SS01",  # no summary
    "SS02",  # summary without a capital letter
    "SS03",  # summary without a full stop
    "SS06",  # summary longer than one line
    "PR01",  # parameter not documented
    "PR02",  # unknown parameter documented
    "PR03",  # order of the parameters
    "PR10",  # no space before the colon
    "RT01",  # no Returns section
    "YD01",  # no Yields section
}
# The fields of a result, which nobody constructs by hand, stand under Attributes.
# Methods of astropy's registry of readers and writers look like properties.
numpydoc_validation_overrides = {
    "PR01": [r"Attributes\n *-{10}\n"],
    "PR02": [r"\.list_formats\(\)"],
}

html_theme = "pydata_sphinx_theme"
html_title = f"astro_scc {version}"
html_static_path = ["_static", "_build/explore"]
html_css_files = ["astro_scc.css"]
# All pages are in the sidebar, so none are in the header.
html_sidebars = {"**": ["globaltoc.html"]}
html_theme_options = {
    "navbar_center": [],
    "show_prev_next": False,
    "navigation_with_keys": False,
    "show_toc_level": 2,
}

plot_formats = [("png", 120)]
plot_html_show_formats = False
plot_html_show_source_link = False


def write_settings(app):
    """Write the table of the settings, which a page of the documentation includes."""
    path = Path(app.srcdir, "_build", "settings.csv")
    path.parent.mkdir(exist_ok=True)
    rows = []
    for name, facts in OPTIONS.items():
        default, metavar = facts["default"], facts["metavar"]
        example = metavar or "" if default is None else json.dumps(default)
        option = "" if metavar is None else f"``{option_name(name)}``"
        rows.append(
            [f"``{name}``", option, example and f"``{example}``", facts["help"]]
        )
    with open(path, "w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(rows)


def write_help(app):
    """Write what ``--help`` of each command prints, folded, as a page includes it."""
    commands = next(
        action.choices
        for action in build_parser()._actions
        if isinstance(action, argparse._SubParsersAction)
    )
    lines = []
    with mock.patch.dict(os.environ, COLUMNS="90"):
        for name, parser in commands.items():
            lines += [f".. dropdown:: astro-scc {name}", ""]
            lines += ["   .. code-block:: text", ""]
            lines += [indent(parser.format_help(), "      "), ""]
    path = Path(app.srcdir, "_build", "help.rst")
    path.write_text("\n".join(lines), encoding="utf-8")


def write_paper_test(app):
    """Write the table of the paper's jets without a program of unknown version."""
    source = Path(app.srcdir).parent / "benchmarks" / "results" / "paper_test.csv"
    with open(source, encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    other = rows[0].index("authors' program")
    path = Path(app.srcdir, "_build", "paper_test.csv")
    with open(path, "w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(row[:other] + row[other + 1 :] for row in rows)


def write_explore(app):
    """Write the page with linked panels that the documentation embeds."""
    import astropy.units as u

    from astro_scc.simulation import simulate_two_fluid

    path = Path(app.srcdir, "_build", "explore", "two_fluid.html")
    if path.exists():
        return
    scc = astro_scc.StackedCrossCorrelation(
        scales=[1, 2, 3], max_speed=36 * u.mas / u.yr, position_angle=270 * u.deg
    )
    try:
        scc(simulate_two_fluid(rng=1).cube, n_trials=200, rng=1).explore(path)
    except ImportError as error:
        # It is among the requirements of the documentation, but not of a test of it.
        LOGGER.info("%s: left out: %s", path, error)


def notebook_of(script):
    """
    Return an example as a notebook: a cell for each group of its statements.

    The last two cells have the table and the figure that the script has written.
    """
    source = script.read_text(encoding="utf-8")
    lines, (title, *body) = source.splitlines(), ast.parse(source).body
    common = (script.parent / "common.py").read_text(encoding="utf-8")
    brief = next(
        ast.get_source_segment(common, node)
        for node in ast.parse(common).body
        if getattr(node, "name", "") == "brief"
    )
    groups, start = [], title.end_lineno
    # The last statement runs the example as a script.
    for node in body[:-1]:
        text = "\n".join(lines[start : node.end_lineno])
        start = node.end_lineno
        # A function by itself, and imports apart from constants.
        kind = node if isinstance(node, ast.FunctionDef) else type(node).__name__[:6]
        if groups and groups[-1][0] == kind:
            groups[-1][1] += f"\n{text}"
        else:
            groups.append([kind, text])
    cells = [text.strip("\n") for _, text in groups]
    helper = "from common import brief, run"
    cells[0] = cells[0].replace(helper, "from astropy.table import QTable")
    cells.insert(1, brief)
    needs_data = "data=True" in lines[-1]
    argument = '"apjac230ft4_mrt.txt"' if needs_data else ""
    cells += [f"table, figure = measure({argument})\ntable", "figure"]
    words = ast.get_docstring(ast.parse(source)).splitlines()[0]
    code = {"cell_type": "code", "execution_count": None, "metadata": {}, "outputs": []}
    cells = [code | {"source": cell} for cell in cells]
    results = script.parent / "results"
    text = (results / f"{script.stem}.txt").read_text(encoding="utf-8")
    image = b64encode((results / f"{script.stem}.png").read_bytes()).decode()
    shown = {"text/plain": text}, {"image/png": image, "text/plain": "<Figure>"}
    for cell, data in zip(cells[-2:], shown, strict=True):
        cell["outputs"] = [
            {"output_type": "display_data", "metadata": {}, "data": data}
        ]
    return {
        "cells": [
            {"cell_type": "markdown", "metadata": {}, "source": f"# {words}"},
            *cells,
        ],
        "metadata": {
            "kernelspec": {
                "display_name": "Python 3", "language": "python", "name": "python3"
            }
        },
        "nbformat": 4,
        "nbformat_minor": 4,
    }  # fmt: skip


def write_notebooks(app):
    """Write the notebooks that the gallery offers beside the scripts."""
    folder = Path(app.srcdir, "_build", "notebooks")
    folder.mkdir(parents=True, exist_ok=True)
    for script in Path(app.srcdir).parent.glob("examples/*.py"):
        if script.stem not in ("common", "relativity"):
            text = json.dumps(notebook_of(script), indent=1)
            (folder / f"{script.stem}.ipynb").write_text(text, encoding="utf-8")


def resolve_top_level(app, env, node, contnode):
    """What is imported from the top, such as ``astro_scc.EpochCube``, where it is."""
    package, _, rest = node.get("reftarget", "").partition(".")
    name, dot, member = rest.partition(".")
    if package != "astro_scc" or name not in astro_scc._PUBLIC:
        return None
    target = f"{astro_scc._PUBLIC[name]}.{name}{dot}{member}"
    python = env.get_domain("py")
    where = node.get("refdoc", env.docname), app.builder
    return python.resolve_xref(env, *where, "obj", target, node, contnode)


def visit_math(translator, node):
    """Write an equation as MathML, which browsers show without any script."""
    block = isinstance(node, nodes.math_block)
    try:
        translator.body.append(tex2mathml(node.astext(), as_block=block))
    except MathError as error:
        LOGGER.warning("%s: %s", node.astext(), error, location=node)
    raise nodes.SkipNode


def setup(app):
    # Sphinx checks that static folders are there before it builds anything.
    Path(app.srcdir, "_build", "explore").mkdir(parents=True, exist_ok=True)
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_math, None))
    app.connect("builder-inited", write_settings)
    app.connect("builder-inited", write_help)
    app.connect("builder-inited", write_paper_test)
    app.connect("builder-inited", write_explore)
    app.connect("builder-inited", write_notebooks)
    app.connect("missing-reference", resolve_top_level)
