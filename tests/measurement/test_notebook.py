# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What a notebook shows."""

from dataclasses import replace
from html.parser import HTMLParser

import numpy as np

from astro_scc.measurement.tables import paper_table, printed


class Page(HTMLParser):
    """Tags that are open, and the text of cells."""

    def __init__(self, text):
        super().__init__()
        self.open, self.cells, self.seen = [], [], set()
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.seen.add(tag)
        if tag != "br":
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "td":
            self.cells.append(data)


def test_components(sky_result):
    html = sky_result._repr_html_()
    page = Page(html)
    assert not page.open
    table = paper_table(printed(sky_result.components))
    assert len(page.cells) == len(table.colnames) * len(table)
    assert page.cells[0] == "1"
    assert table["pm"][0] in page.cells
    assert "mas / yr" in html
    assert "40 trials, seed 1" in html
    assert len(html) < 5000


def test_the_representation_says_the_speeds(sky_result):
    first = sky_result.components[0]
    digits = max(0, 1 - int(np.floor(np.log10(first["pm_err"].value))))
    speed, error = (f"{first[name].value:.{digits}f}" for name in ("pm", "pm_err"))
    text = repr(sky_result)
    assert text.startswith("<SCCResult")
    assert f": {speed} +- {error} mas/yr {first['kind']}" in text
    assert text.endswith("8 epochs>")
    assert "\n" not in text


def test_text_is_escaped(sky_result):
    cube = replace(sky_result.cube, meta={"object": "<script>alert(1)</script>"})
    result = replace(sky_result, matched=replace(sky_result.matched, cube=cube))
    html = result._repr_html_()
    assert "&lt;script&gt;" in html
    assert "script" not in Page(html).seen
    labels = [f"<b>{k}</b>" for k in range(len(cube))]
    assert "b" not in Page(replace(cube, labels=labels)._repr_html_()).seen


def test_without_components(sky_result):
    empty = replace(sky_result, maxima=(), velocities=(), jitters=())
    assert "no stream, 8 epochs>" in repr(empty)
    html = empty._repr_html_()
    assert "no stream" in html
    assert "<table" not in html
