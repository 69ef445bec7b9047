# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure unusual and faulty inputs, and show what the command line answers.

Each case makes its files, six epochs of a small jet whose features all move 2 pixels
west per epoch, and measures them::

    python tools/inputs.py --table benchmarks/results/inputs.csv

prints the answers and, with ``--table FILE.csv``, writes them.  The tests in
``tests/robustness`` check that every case gets the answer that it states.
"""

import argparse
import contextlib
import csv
import io
import os
import re
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from astropy.io import fits

MAS = 1 / 3.6e6
DAYS = ("2001-01-01", "2001-01-31", "2001-03-02", "2001-04-01", "2001-05-01",
        "2001-05-31")  # fmt: skip
#: 0.2 mas to the west in 30 days, in mas/yr.
SPEED = 0.2 * 365.25 / 30
SHAPE = (40, 48)
FEATURES = ((20, 12, 1.0, 1.8), (12, 24, 0.6, 1.6), (28, 32, 0.5, 2.0))
QUICK = ("--scales=1,2", "--max-speed=5 mas/yr", "--n-trials=119", "--seed=1")
CARDS = {
    "OBJECT": "J0000+00",
    "BUNIT": "JY/BEAM",
    "EPOCH": 2000.0,
    "CTYPE1": "RA---SIN",
    "CRVAL1": 10.0,
    "CRPIX1": 24.0,
    "CDELT1": -0.1 * MAS,
    "CROTA1": 0.0,
    "CTYPE2": "DEC--SIN",
    "CRVAL2": 0.0,
    "CRPIX2": 21.0,
    "CDELT2": 0.1 * MAS,
    "CROTA2": 0.0,
    "CTYPE3": "FREQ",
    "CRVAL3": 15.4e9,
    "CRPIX3": 1.0,
    "CDELT3": 64e6,
    "CTYPE4": "STOKES",
    "CRVAL4": 1.0,
    "CRPIX4": 1.0,
    "CDELT4": 1.0,
    "BMAJ": 0.4 * MAS,
    "BMIN": 0.35 * MAS,
    "BPA": -7.0,
}
_COS, _SIN = np.cos(np.pi / 6), np.sin(np.pi / 6)
NO_BEAM = {"BMAJ": None, "BMIN": None, "BPA": None}


def image(i, *, turn=0, speed=2.0):
    """Return epoch ``i`` of the jet with noise, turned ``turn`` times by 90 degrees."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    data = np.random.default_rng(i).normal(0, 1e-3, SHAPE)
    for north, west, peak, width in FEATURES:
        r2 = (y - north) ** 2 + (x - west - speed * i) ** 2
        data += peak * np.exp(-r2 / 2 / width**2)
    return np.rot90(data, turn)


def header(i, **changes):
    """Return the header of epoch ``i``; None removes a keyword."""
    cards = {**CARDS, "DATE-OBS": DAYS[i]}
    cards |= {k.replace("DATE_", "DATE-"): v for k, v in changes.items()}
    return fits.Header({k: v for k, v in cards.items() if v is not None})


def write(folder, i, *, data=None, name=None, tables=(), **changes):
    """Write epoch ``i`` as AIPS does: with four axes and big-endian floats."""
    data = image(i) if data is None else np.asarray(data)
    data = data[None, None] if data.ndim == 2 else data
    path = Path(folder) / (name or f"e{i}.fits")
    primary = fits.PrimaryHDU(data.astype(">f4"), header(i, **changes))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fits.HDUList([primary, *tables]).writeto(path, output_verify="ignore")
    return path


def series(folder, each=lambda i: {}, n=6):
    """Write the jet; ``each(i)`` returns the options of `write` for epoch ``i``."""
    return [write(folder, i, **each(i)) for i in range(n)]


@dataclass(frozen=True, kw_only=True)
class Case:
    """
    An input, and the answer that it must get.

    Attributes
    ----------
    name : str
        What is special about the input.
    make : callable
        Makes the files in a folder and returns the arguments of ``measure``.
    status : int
        Exit status.
    says : str
        Regular expression for standard error; empty if nothing is printed.
    velocity : tuple of float or None
        Velocity to the east and north in mas/yr, if there is an answer.
    slow : bool
        Whether it takes more than two seconds.
    """

    name: str
    make: Callable
    status: int = 0
    says: str = ""
    velocity: tuple = (-SPEED, 0.0)
    slow: bool = False


CASES = []


def case(name, says="", *, status=0, **options):
    """Add a case whose files a function makes."""

    def add(make):
        CASES.append(Case(name=name, make=make, says=says, status=status, **options))
        return make

    return add


def refused(name, says):
    """Add a case that is refused with one line and status 2."""
    return case(name, says, status=2)


def each(name, says="", **options):
    """Add a case of six files, with options from a function of the epoch's number."""

    def add(special):
        case(name, says, **options)(lambda folder: series(folder, special))
        return special

    return add


# -- headers -----------------------------------------------------------------------

each("four axes, big-endian, as AIPS and difmap write them")(lambda i: {})
each("CDELT in single precision, not the same in every epoch")(
    lambda i: {
        "CDELT1": float(np.float32(-0.1 * MAS)) * (1 + 1e-8 * i),
        "CDELT2": float(np.float32(0.1 * MAS)),
    }
)
each("STOKES 1, -1 and -9", "is of Stokes RR, others are of I; leave it out if it")(
    lambda i: {"CRVAL4": (1.0, -1.0, -9.0, 1.0, 1.0, 1.0)[i]}
)
each("unit JY/PIXEL")(lambda i: {"BUNIT": "JY/PIXEL"})
each("unit 'counts / pixel'")(lambda i: {"BUNIT": "counts / pixel"})
each("unit missing")(lambda i: {"BUNIT": None})
each("unit that nobody knows", "'FURLONGS' is not known and taken as dimensionless")(
    lambda i: {"BUNIT": "FURLONGS"}
)
each("mJy/beam among Jy/beam")(
    lambda i: {"BUNIT": "mJy/beam", "data": 1e3 * image(i)} if i == 2 else {}
)
refused("one epoch in kelvin", "e2.fits: its unit is K, that of .* leave it out")(
    lambda folder: series(folder, lambda i: {"BUNIT": "K"} if i == 2 else {})
)


@case("beam in the history, below 3000 lines")
def _history(folder):
    paths = series(folder, lambda i: NO_BEAM)
    for path, lines in zip(paths, (10, 10, 3000, 10, 10, 10), strict=True):
        with fits.open(path, mode="update") as hdus:
            for k in range(lines):
                hdus[0].header.add_history(f"AIPS   line {k}")
            hdus[0].header.add_history(
                "AIPS   CLEAN BMAJ=  1.1111E-07 BMIN=  9.7222E-08 BPA=  -7.00"
            )
    return paths


def _beam_table(i):
    columns = [
        fits.Column(name, "1E", unit="DEGREES", array=[CARDS[name]])
        for name in ("BMAJ", "BMIN", "BPA")
    ]
    return {
        "tables": [fits.BinTableHDU.from_columns(columns, name="AIPS CG")],
        **NO_BEAM,
    }


each("beam in an AIPS CG table")(_beam_table)
each(
    "no beam at all",
    "note: the epochs have no beams: three pixels count as one",
)(lambda i: NO_BEAM)
refused("no beam in one epoch", "e1.fits: no beam where other epochs have one; write")(
    lambda folder: series(folder, lambda i: NO_BEAM if i == 1 else {})
)
refused("no position angle of a beam", "e1.fits: no beam where other epochs have one")(
    lambda folder: series(folder, lambda i: {"BPA": None} if i == 1 else {})
)
each("negative beam", "its beam is taken as unknown: .* is not positive")(
    lambda i: {"BMAJ": -0.4 * MAS}
)
each("beam in mas where degrees belong", "larger than the image; write BMAJ, BMIN")(
    lambda i: {"BMAJ": 0.4, "BMIN": 0.35}
)
each("beam smaller than a pixel", "smaller than a pixel; write BMAJ, BMIN")(
    lambda i: {"BMAJ": 0.05 * MAS, "BMIN": 0.04 * MAS}
)
refused(
    "a beam in uas that is given for images in mas", "is smaller than a pixel; give"
)(lambda folder: [*series(folder, lambda i: NO_BEAM), "--beam=0.4 uas 0.35 uas -7deg"])
each("beams that differ", "note: the beams differ: convolving to a common one")(
    lambda i: {"BMAJ": (0.4 + 0.02 * i) * MAS}
)
case("beams that differ, --no-common-beam", "note: the beams differ and are left so")(
    lambda folder: [
        *series(folder, lambda i: {"BMAJ": (0.4 + 0.02 * i) * MAS}),
        "--no-common-beam",
    ]
)
each("position angle of the beam beyond 360 degrees")(lambda i: {"BPA": 533.0})
each(
    "reference values that jump by 0.36 mas", "apart on the sky and are taken for one"
)(lambda i: {"CRVAL1": 10 + 0.36 * MAS * (i % 2)})


@case("reference pixels on a spot that jumps by 0.3 mas, and a table of the core")
def _table_of_cores(folder):
    # A pixel to the right is 0.1 mas to the west.
    rows = [f"{day},{0.3 * (i % 2)},0" for i, day in enumerate(DAYS)]
    text = "\n".join(["date,core_x_mas_east,core_y_mas_north", *rows])
    (folder / "cores.csv").write_text(text, encoding="utf-8")
    paths = series(folder, lambda i: {"CRPIX1": 24.0 + 3 * (i % 2)})
    return [*paths, f"--align={folder}/cores.csv"]


each("no reference values (CRVAL)")(lambda i: {"CRVAL1": None, "CRVAL2": None})
each("right ascension to the right (CDELT1 above 0)", velocity=(SPEED, 0.0))(
    lambda i: {"CDELT1": 0.1 * MAS}
)
each("turned by 90 degrees (CROTA2)", velocity=(0.0, -SPEED))(
    lambda i: {"CROTA2": 90.0}
)
each("turned by 30 degrees (CD matrix)", velocity=(-SPEED * _COS, -SPEED * _SIN))(
    lambda i: {
        "CDELT1": None,
        "CDELT2": None,
        "CROTA1": None,
        "CROTA2": None,
        "CD1_1": -0.1 * MAS * _COS,
        "CD1_2": -0.1 * MAS * _SIN,
        "CD2_1": -0.1 * MAS * _SIN,
        "CD2_2": 0.1 * MAS * _COS,
    }
)
each("DEC---SIN with three dashes")(lambda i: {"CTYPE2": "DEC---SIN"})
refused("no celestial axes", "e0.fits: it has no celestial coordinates")(
    lambda folder: series(folder, lambda i: {"CTYPE1": None, "CTYPE2": None})
)
refused("no pixel scale", "e0.fits: its celestial axes have no pixel scale")(
    lambda folder: series(folder, lambda i: {"CDELT1": 0.0})
)
refused(
    "pixels of 56 arcsec without a unit", "e0.fits: its sides are 2.69e.03 deg by CD"
)(lambda folder: series(folder, lambda i: {"CDELT1": -56.0, "CDELT2": 56.0}))
refused("reference pixel that is no number", "e0.fits: CRPIX1 = 'x' is not a finite")(
    lambda folder: series(folder, lambda i: {"CRPIX1": "x"})
)
each("dates with microseconds and a trailing Z")(
    lambda i: {"DATE_OBS": f"{DAYS[i]}T00:00:00.000001Z"}
)
each("dates as 21/03/95")(
    lambda i: {"DATE_OBS": "/".join(reversed(DAYS[i][2:].split("-")))}
)
each("MJD-OBS only")(lambda i: {"DATE_OBS": None, "MJD-OBS": 51910.0 + 30 * i})
each("DATE, of the file, is not that of the observation")(
    lambda i: {"DATE": "2024-01-01"}
)
refused("no date", "e2.fits: no date of observation .* write DATE-OBS")(
    lambda folder: series(folder, lambda i: {"DATE_OBS": None} if i == 2 else {})
)
refused("date that is none", "e2.fits: DATE-OBS: '2001-13-45' is no date")(
    lambda folder: series(
        folder, lambda i: {"DATE_OBS": "2001-13-45"} if i == 2 else {}
    )
)


# -- lists of files ----------------------------------------------------------------

case("epochs in any order")(
    lambda folder: [write(folder, k) for k in (3, 0, 5, 4, 1, 2)]
)
case("one path twice")(lambda folder: [*series(folder), folder / "e2.fits"])
refused("one epoch twice, under two names", "is of 2001-03-02, as is .*; leave one")(
    lambda folder: [*series(folder), write(folder, 2, name="copy.fits")]
)
refused("a mask among them", "mask.fits: .* seems to be a mask; leave it out")(
    lambda folder: [
        *series(folder),
        write(folder, 2, name="mask.fits", data=image(2) > 0.1),
    ]
)
refused("a stack of all among them, of the date of one", "is of 2001-03-02, as is .*;")(
    lambda folder: [
        *series(folder),
        write(
            folder, 2, name="stack.fits", data=np.mean([image(i) for i in range(6)], 0)
        ),
    ]
)
refused("another band among them", "x.fits: is at 43 GHz, others are at 15.4")(
    lambda folder: [*series(folder), write(folder, 2, name="x.fits", CRVAL3=43e9)]
)
refused("two sources in one list", "x.fits: shows B, somewhere else.* leave it out")(
    lambda folder: [
        *series(folder),
        write(folder, 2, name="x.fits", OBJECT="B", CRVAL1=50.0),
    ]
)
refused("Stokes Q among them", "x.fits: is of Stokes Q, others are of I; leave it out")(
    lambda folder: [*series(folder), write(folder, 2, name="x.fits", CRVAL4=2.0)]
)
refused("one epoch", "too few epochs: 1 image, 6 are needed")(
    lambda folder: series(folder, n=1)
)
refused("two epochs of one date", "x.fits: is of .*, as is .*; leave one out")(
    lambda folder: [write(folder, 1), write(folder, 1, name="x.fits")]
)
each("an epoch of another size")(
    lambda i: {"data": image(i)[:, 2:-2], "CRPIX1": 22.0} if i == 2 else {}
)
refused("pixels of an epoch a thousand times as large", "pixels")(
    lambda folder: series(
        folder,
        lambda i: {"CDELT1": -100 * MAS, "CDELT2": 100 * MAS} if i == 2 else {},
    )
)
refused("no files", "no epochs were given")(lambda folder: [])
refused("a pattern that matches nothing", r"no\*.fits: no file matches this pattern")(
    lambda folder: [folder / "no*.fits"]
)


# -- images ------------------------------------------------------------------------

each("some pixels NaN and infinite")(
    lambda i: {"data": np.where(np.arange(48) == 46, (-1.0) ** i * np.inf, image(i))}
)
refused("all pixels NaN", "e2.fits: no valid pixel, all are NaN; leave this file out")(
    lambda folder: series(
        folder, lambda i: {"data": image(i) * np.nan} if i == 2 else {}
    )
)
refused("all pixels zero", "e2.fits: has no more than two different values")(
    lambda folder: series(folder, lambda i: {"data": image(i) * 0} if i == 2 else {})
)
refused("all pixels the same", "e2.fits: has no more than two different values")(
    lambda folder: series(
        folder, lambda i: {"data": image(i) * 0 + 3} if i == 2 else {}
    )
)
refused("images of one pixel", "e0.fits: has no more than two different values")(
    lambda folder: series(folder, lambda i: {"data": [[1.0 + i]]})
)
refused("images of three by three pixels", "scale")(
    lambda folder: series(folder, lambda i: {"data": image(i)[19:22, 11:14]})
)
refused(
    "noise without a source", r"no significant pattern \(SSP\) in any epoch on scale"
)(
    lambda folder: series(
        folder, lambda i: {"data": np.random.default_rng(i).normal(0, 1, SHAPE)}
    )
)
refused("several frequencies in a file", "e0.fits: has 4 planes on axis FREQ; write")(
    lambda folder: series(folder, lambda i: {"data": np.stack([image(i)] * 4)[None]})
)
each("several Stokes parameters in a file")(
    lambda i: {"data": np.stack([image(i), image(0), image(0), image(0)])[:, None]}
)
each("pixels that are not square")(
    lambda i: {
        "data": np.repeat(image(i), 2, axis=0),
        "CDELT2": 0.05 * MAS,
        "CRPIX2": 41.5,
    }
)


# -- files -------------------------------------------------------------------------


def _changed(change):
    """Make six epochs and change the third one on the disk."""

    def make(folder):
        paths = series(folder)
        change(paths[2])
        return paths

    return make


refused("truncated file", "e2.fits: is truncated, .* bytes of its image are missing")(
    _changed(lambda path: path.write_bytes(path.read_bytes()[:6000]))
)
refused("header cut off", "e2.fits: cannot be read as FITS, it is broken or no FITS")(
    _changed(lambda path: path.write_bytes(path.read_bytes()[:1000]))
)
refused("empty file", "e2.fits: cannot be read as FITS")(
    _changed(lambda path: path.write_bytes(b""))
)
refused("text file", "e2.fits: cannot be read as FITS, it is broken or no FITS")(
    _changed(lambda path: path.write_text("no image\n" * 500))
)


def _directory(path):
    path.unlink()
    path.mkdir()


def _pipe(path):
    path.unlink()
    os.mkfifo(path)


def _link(path):
    path.unlink()
    path.symlink_to("nowhere.fits")


refused("directory", "e2.fits: is a directory; give")(_changed(_directory))
refused("named pipe", "e2.fits: is no ordinary file")(_changed(_pipe))
refused("link to nothing", "e2.fits: no such file")(_changed(_link))
refused("no image in the file", "e2.fits: holds no image")(
    _changed(lambda path: fits.PrimaryHDU().writeto(path, overwrite=True))
)


def _claim(path):
    old, new = (b"NAXIS1  =       " + n for n in (b"            48", b"          8192"))
    path.write_bytes(path.read_bytes().replace(old, new))


refused("header that claims 8192 x 40 pixels", "e2.fits: is truncated, 13.* bytes")(
    _changed(_claim)
)


@case("letters that are not ASCII in a header")
def _letters(folder):
    paths = series(folder)
    for path in paths:
        path.write_bytes(path.read_bytes().replace(b"J0000+00", b"J00\xe9\xff+\0\n"))
    return paths


@case("compressed with gzip")
def _gzip(folder):
    return [write(folder, i, name=f"e{i}.fits.gz") for i in range(6)]


@refused("compressed with gzip, and truncated", "e2.fits.gz: cannot be read as FITS")
def _broken_gzip(folder):
    paths = [write(folder, i, name=f"e{i}.fits.gz") for i in range(6)]
    paths[2].write_bytes(paths[2].read_bytes()[:3000])
    return paths


@case("six images of 8192 x 8192 pixels, of which a part is read", slow=True)
def _large(folder):
    side, (ny, nx) = 8192, SHAPE
    top, left = 5000, 3000
    paths = []
    for i in range(6):
        paths.append(folder / f"e{i}.fits")
        own = header(i, CRPIX1=24.0 + left, CRPIX2=21.0 + top, CTYPE3=None, CTYPE4=None)
        for name in ("CRVAL", "CRPIX", "CDELT"):
            for axis in "34":
                own.remove(name + axis)
        head = fits.Header({"SIMPLE": True, "BITPIX": -32, "NAXIS": 2})
        head["NAXIS1"], head["NAXIS2"] = side, side
        head.extend(own)
        with paths[-1].open("wb") as file:
            # Unwritten parts take no space on the disk and read as 0.
            start = file.write(head.tostring().encode("ascii"))
            for k, row in enumerate(image(i).astype(">f4")):
                file.seek(start + 4 * ((top + k) * side + left))
                file.write(row.tobytes())
            file.truncate(start + 4 * side**2 + -(start + 4 * side**2) % 2880)
    box = f"{left + nx / 2 + 0.5},{top + ny / 2 + 0.5},{nx},{ny}"
    (folder / "r.reg").write_text(f"image\nbox({box},0)\n", encoding="utf-8")
    return [*paths, f"--crop={folder}/r.reg"]


# -- options -----------------------------------------------------------------------


def _options(*words, **texts):
    """Make six epochs and text files, and add options."""

    def make(folder):
        for name, text in texts.items():
            (folder / name.replace("_", ".")).write_text(text)
        return [*series(folder), *(w.format(folder=folder) for w in words)]

    return make


refused("a scale twice", "--scales '1,2,1' must differ: leave out")(
    _options("--scales=1,2,1")
)
refused("no scale", "--scales '' must be scale numbers such as 1,2,3")(
    _options("--scales=")
)
refused("scale larger than the image", "too small for wavelet scale 20 .* leave")(
    _options("--scales=20")
)
refused(
    "scale far larger than any image", "--scales '99' must be of the series 0, 0.5"
)(_options("--scales=99"))
refused("scale below none", "--scales '-1' must be of the series")(
    _options("--scales=-1")
)
refused(
    "largest speed beyond the image", "--max-speed moves .* mas: give a smaller one"
)(_options("--max-speed=1e12 mas/yr"))
refused(
    "largest speed below any that is seen",
    "--max-speed moves .* mas: give a larger one",
)(_options("--max-speed=1e-12 mas/yr"))
case("position angle of the jet beyond 360 degrees")(
    _options("--position-angle=630 deg")
)
case("position angle below zero, as an option may be")(
    _options("--position-angle", "-90deg")
)
refused("position angle without a unit", "'-90' has no unit at its end; it must be")(
    _options("--position-angle", "-90")
)
refused("a speed of two numbers", "--max-speed '1 5 mas/yr' must be an angle per")(
    _options("--max-speed=1 5 mas/yr")
)
refused("redshift beyond any", "--redshift '1e300' must be below 30")(
    _options("--redshift=1e300")
)
refused("redshift as a velocity", "is a velocity.* give the redshift, 0.158 if it is")(
    _options("--redshift=47367 km/s")
)
refused("redshift as a velocity without its unit", "must be below 30; of a velocity")(
    _options("--redshift=47367")
)
refused("redshift as a distance", "'600 Mpc' is a length; give it as the distance")(
    _options("--redshift=600 Mpc")
)
case("redshift in per cent")(_options("--redshift=15.8 %"))
refused("distance without a unit", "--distance '16.7' has no unit at its end; it")(
    _options("--distance=16.7")
)
refused("distance with a blank for its point", "'16 7 Mpc' must be one distance")(
    _options("--distance=16 7 Mpc")
)
refused("a cosmology that nobody knows", "'Planck' is no cosmology; give H0=71,Om0")(
    _options("--redshift=0.158", "--cosmology=Planck")
)
refused("a redshift and a distance", "distance needs neither redshift nor cosmology")(
    _options("--redshift=0.158", "--distance=16.7 Mpc")
)
refused("redshift as a velocity in a file", "c.toml: redshift = '47367 km/s' is a vel")(
    _options("--config={folder}/c.toml", c_toml="redshift = '47367 km/s'")
)
refused("a region outside the image", "r.reg: ")(
    _options("--region={folder}/r.reg", r_reg="image\ncircle(999,999,3)\n")
)
case(
    "a region without patterns",
    r"warning: r.reg: no significant pattern has its .* inside, \d+ in the rest of",
    velocity=None,
)(_options("--region={folder}/r.reg", r_reg="image\ncircle(3,3,2)\n"))


@refused("a region, and no patterns at all", r"no significant pattern \(SSP\) in any")
def _nothing(folder):
    (folder / "r.reg").write_text("image\ncircle(20,20,9)\n")
    paths = series(
        folder, lambda i: {"data": np.random.default_rng(i).uniform(0, 1, SHAPE)}
    )
    return [*paths, f"--region={folder}/r.reg"]


refused("a region file that is none", "r.reg: ")(
    _options("--region={folder}/r.reg", r_reg="<html></html>")
)
refused("a FITS region file", "r.fits: is not a text file; give a DS9 or CRTF region")(
    _options("--region={folder}/r.fits", r_fits="SIMPLE  =                    T")
)
refused(
    "a region of mas in CRTF with the digits that are written by default",
    "r.crtf: a CircleSkyRegion of .* is written in steps of 3.6 mas, which moves it",
)(
    _options(
        "--region={folder}/r.crtf",
        r_crtf="#CRTFv0\nglobal coord=J2000\n"
        "circle[[10.000000deg, -0.000001deg], 0.000001deg]\n",
    )
)
refused("a table of offsets that is none", "t.csv: ")(
    _options("--align={folder}/t.csv", t_csv="\0\1\2")
)
refused("settings that are no TOML", "c.toml: is not a TOML file")(
    _options("--config={folder}/c.toml", c_toml="a = [")
)
refused("an unknown setting", "c.toml: unknown key 'max_sped', did you mean max_speed")(
    _options("--config={folder}/c.toml", c_toml="max_sped = 1")
)
refused("a setting in the wrong unit", "c.toml: max_speed = '2 mas' must be an angle")(
    _options("--config={folder}/c.toml", c_toml="max_speed = '2 mas'")
)
refused("settings nested without end", "c.toml: is not a TOML file")(
    _options("--config={folder}/c.toml", c_toml="a = " + "[" * 20000)
)
refused("a number of 400 digits", "c.toml: kappa = .* must be a finite number")(
    _options("--config={folder}/c.toml", c_toml="kappa = 1" + "0" * 400)
)


# -- running -----------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """What a run of ``measure`` printed, measured and left behind."""

    status: int
    errors: str
    velocity: tuple | None
    left: frozenset

    @property
    def answer(self):
        """The answer in one line, without what differs from run to run."""
        if self.status:
            return self.errors.splitlines()[-1].removeprefix(
                "astro-scc measure: error: "
            )
        found = "no component"
        if self.velocity is not None:
            # Adding 0 makes negative zeros positive.
            east, north = (round(value, 2) + 0.0 for value in self.velocity)
            found = f"{east:.2f}, {north:.2f} mas/yr"
        return "; ".join([found, *self.errors.splitlines()])


def run(case, folder):
    """
    Measure a case in a folder.

    Returns
    -------
    `Outcome`
    """
    from astropy.table import QTable

    from astro_scc.cli import main

    folder = Path(folder)
    words = [str(word) for word in case.make(folder)]
    before = set(folder.rglob("*"))
    out = folder / "out"
    # The options of the case come last and take precedence.
    argv = ["measure", "-o", str(out), "--no-report", *QUICK, *words]
    errors = io.StringIO()
    with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(io.StringIO()):
        status = main(argv)
    velocity = None
    if status == 0:
        table = QTable.read(out / "streams.ecsv")
        if len(table) and table["kind"][0] != "not significant":
            velocity = tuple(
                float(table[name][0].value) for name in ("pm_ra_cosdec", "pm_dec")
            )
        shutil.rmtree(out)
    left = frozenset(set(folder.rglob("*")) - before)
    text = errors.getvalue().replace(f"{folder}/", "")
    lines = [line for line in text.splitlines() if "allow no p_global" not in line]
    return Outcome(status, "\n".join(lines), velocity, left)


def faults(found, case):
    """
    Return what is wrong with an outcome.

    Returns
    -------
    list of str
    """
    wrong = []
    if found.status != case.status:
        wrong.append(f"status {found.status}")
    if found.left:
        wrong.append(f"left {sorted(found.left)}")
    lines = found.errors.splitlines()
    if bool(case.says) != bool(lines) or not re.search(case.says, found.errors):
        wrong.append("other words")
    if sum(not line.startswith(("note: ", "warning: ")) for line in lines) > 1:
        wrong.append("more than one line")
    if found.status == 0 and not _right(found.velocity, case.velocity):
        wrong.append("wrong velocity")
    return wrong


def _right(found, true):
    if found is None or true is None:
        return found is true
    return np.hypot(*np.subtract(found, true)) < 0.02 * SPEED


def main():
    """Run all cases and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument("--only", default="", help="cases with this in their name")
    parser.add_argument("--table", type=Path, help="write it here")
    args = parser.parse_args()
    rows = []
    for one in CASES:
        if args.only not in one.name:
            continue
        with tempfile.TemporaryDirectory() as folder:
            try:
                found = run(one, folder)
            except Exception as error:
                print(f"FAILED {one.name}: {type(error).__name__}: {error}")
                continue
        wrong = faults(found, one)
        mark = f"FAULT ({', '.join(wrong)}) " if wrong else ""
        print(f"{mark}{one.name}: {found.answer}", flush=True)
        # The page that shows the table interprets it as reStructuredText.
        answer = re.sub(r"([*`|\\])", r"\\\1", found.answer)
        rows.append([one.name, found.status, answer])
    if args.table:
        with args.table.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerows([["input", "status", "what it gets"], *rows])
    return 0


if __name__ == "__main__":
    sys.exit(main())
