# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Marks of the tests, FITS images, pages, and a small jet for all that measure."""

from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from hypothesis import settings

from astro_scc import StackedCrossCorrelation
from astro_scc.features import find_features
from astro_scc.simulation import JetSimulation, Stream, simulate_jet

HERE = Path(__file__).parent
#: Folders and modules whose tests run the command line, or scripts, end to end.
INTEGRATION = "cli robustness test_docs_commands test_examples test_golden".split()
# The same examples everywhere: a commit passes or fails on each machine alike.  Others
# are drawn with --hypothesis-profile=random.
settings.register_profile("random", deadline=None)
settings.register_profile("same", derandomize=True, deadline=None)
settings.load_profile("same")

OPTIONS = {"scales": [1, 2, 3], "max_speed": 30 * u.mas / u.yr}


def pytest_collection_modifyitems(items):
    """Mark tests as integration tests by their place or the real data they read."""
    for item in items:
        if HERE in item.path.parents:
            place = item.path.relative_to(HERE).with_suffix("").parts[0]
            if place in INTEGRATION or "shared_data" in item.fixturenames:
                item.add_marker(pytest.mark.integration)


@pytest.fixture(scope="session")
def jet_cube():
    """Eight epochs of a core and of features that move 0.6 beam an epoch west."""
    flow = Stream("flow", dx=6.0, sigma=3.0, density=0.6, jitter=0.5)
    jet = JetSimulation(
        [flow], n_epochs=8, core=3.0, shape=(96, 180), extent=(20.0, 140.0), axis=48.0
    )
    return jet.run(rng=2).cube


@pytest.fixture(scope="session")
def matched(jet_cube):
    """The small jet, correlated on three scales; tests of other jets have their own."""
    return StackedCrossCorrelation(**OPTIONS).match(jet_cube)


@pytest.fixture(scope="session")
def decomposed(jet_cube):
    """The small jet, decomposed on three scales."""
    return StackedCrossCorrelation(**OPTIONS).decompose(jet_cube)


class Results(dict):
    """Results of the small jet by the kind of axes, measured when they are needed."""

    ANGLES = {"jet": 270 * u.deg, "sky": None, "radial": "radial"}

    def __init__(self, decomposed):
        self.decomposed = decomposed

    def __missing__(self, name):
        scc = StackedCrossCorrelation(**OPTIONS, position_angle=self.ANGLES[name])
        found = scc.measure(self.decomposed, n_trials=200, rng=1)
        return self.setdefault(name, found)


@pytest.fixture(scope="session")
def jet_results(decomposed):
    return Results(decomposed)


@pytest.fixture(scope="session")
def sky_result(jet_results):
    """The small jet, measured along east and north."""
    return jet_results["sky"]


@pytest.fixture(scope="session")
def with_cube():
    """A copy of a result of another cube, with the same features."""

    def make(result, cube):
        decomposed = replace(result.decomposed, cube=cube)
        decomposed._followed.append(result.tracked_features)
        return replace(result, decomposed=decomposed)

    return make


@pytest.fixture(scope="session")
def known_jet():
    """Ten epochs of a core and of features whose motions are known."""
    return simulate_jet(n_epochs=10, dispersion=0.1, rng=1)


@pytest.fixture(scope="session")
def known_features(known_jet):
    """Its features; the cached properties of copies of them are their own."""
    return find_features(known_jet.cube, seed=1)


VOID = {"meta", "img", "br", "link", "hr"}


class Page(HTMLParser):
    """The elements and the text of a page; fails if a tag is not closed."""

    def __init__(self, page):
        super().__init__()
        self.source = page if isinstance(page, str) else page.read_text("utf-8")
        self.open, self.tags, self.text = [], [], []
        self.feed(self.source)
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


@pytest.fixture(scope="session")
def read_page():
    return Page


MAS = 1 / 3.6e6
AIPS = {
    "OBJECT": "3C273", "TELESCOP": "VLBA", "DATE-OBS": "2006-03-09", "EPOCH": 2000.0,
    "BUNIT": "JY/BEAM", "CTYPE1": "RA---SIN", "CRVAL1": 187.25, "CRPIX1": 16.0,
    "CDELT1": -0.1 * MAS, "CROTA1": 0.0, "CTYPE2": "DEC--SIN", "CRVAL2": 2.05,
    "CRPIX2": 9.0, "CDELT2": 0.1 * MAS, "CROTA2": 0.0, "CTYPE3": "FREQ",
    "CRVAL3": 15.4e9, "CRPIX3": 1.0, "CDELT3": 64e6, "CTYPE4": "STOKES", "CRVAL4": 1.0,
    "CRPIX4": 1.0, "CDELT4": 1.0, "BMAJ": 1.0 * MAS, "BMIN": 0.5 * MAS, "BPA": -7.0,
}  # fmt: skip


@pytest.fixture
def aips_header():
    """Header of a VLBI image; None as a value removes a keyword."""

    def make(**changes):
        changes = {k.replace("DATE_", "DATE-"): v for k, v in changes.items()}
        cards = AIPS | changes
        return fits.Header({k: v for k, v in cards.items() if v is not None})

    return make


@pytest.fixture
def make_epochs(make_fits):
    """Write VLBI images of consecutive years, each with changes of its own."""

    def make(*changes):
        pairs = [({"DATE_OBS": f"200{i}-01-01"}, k) for i, k in enumerate(changes)]
        return [make_fits(f"{i}.fits", **a | b) for i, (a, b) in enumerate(pairs)]

    return make


@pytest.fixture
def make_fits(tmp_path, aips_header):
    """Write a VLBI image of 32 x 16 pixels, 4-D and big-endian, and give its path."""

    def make(name="a.fits", data=None, **changes):
        if data is None:
            data = np.random.default_rng(1).normal(size=(1, 1, 16, 32))
        data = np.asarray(data).astype(np.asarray(data).dtype.newbyteorder(">"))
        hdu = fits.PrimaryHDU(data, aips_header(**changes))
        hdu.writeto(tmp_path / name, overwrite=True)
        return tmp_path / name

    return make
