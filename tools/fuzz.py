# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Damage files at random and read them.

Every file must be read, or refused with one line of `ValueError`, `TypeError` or
`OSError`, in a short time and without filling the memory::

    python tools/fuzz.py --number 10000 --seed 1

prints the numbers of files of each kind that were read and refused, and lists every
other file.  ``--seed 1 --first 1234 --number 1`` makes number 1234 again.
"""

import argparse
import os
import re
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.io import fits
from astropy.time import Time
from astropy.utils.exceptions import AstropyWarning

from astro_scc.cli.survey_sources import read_survey
from astro_scc.epochs import EpochCube, read_components
from astro_scc.epochs.align import offsets_from_table
from astro_scc.settings import Settings, read_config

#: Errors that a user may get.
EXPECTED = (ValueError, TypeError, OSError)
#: Most seconds and bytes for one file.
TIME, MEMORY = 10, 2**30
CARD, BLOCK = 80, 2880
ODD = (
    b"nan", b"inf", b"-inf", b"0", b"-1", b"1e308", b"1e-308", b"99999999999999999999",
    b"-9223372036854775808", b"''", b"'", b" ", b"T", b"[]", b"{", b"\\0", b"\0",
    b"\xff\xfe", b"../../x", b"<script>", b"10**999999", b"m^(1/0)", b"1e400",
    b"!!python/object/apply:os.system", b"&a [*a]", b"%s%n", b"2001-02-30",
    b"\n", b"\r",
)  # fmt: skip


def _settings(path):
    return Settings(**read_config(path)[0])


# -- files to damage -----------------------------------------------------------------


def sources(folder):
    """
    Make sound files of every kind that is read.

    Parameters
    ----------
    folder : path

    Returns
    -------
    dict
        For each kind, the suffix, the bytes, and the function that reads a
        path.
    """
    folder = Path(folder)
    data = np.random.default_rng(0).normal(size=(2, 8, 12))
    cube = EpochCube.from_arrays(
        data, times=["2001-01-01", "2002-01-01"], pixel_scale=0.1 * u.mas
    )
    cube.write(folder / "cube.fits")
    cards = {
        "OBJECT": "3C273", "DATE-OBS": "2001-01-01", "BUNIT": "JY/BEAM",
        "EPOCH": 2000.0, "CTYPE1": "RA---SIN", "CRVAL1": 187.25, "CRPIX1": 6.0,
        "CDELT1": -1e-8, "CROTA1": 0.0, "CTYPE2": "DEC--SIN", "CRVAL2": 2.05,
        "CRPIX2": 5.0, "CDELT2": 1e-8, "CROTA2": 0.0, "CTYPE3": "FREQ",
        "CRVAL3": 15.4e9, "CTYPE4": "STOKES", "CRVAL4": 1.0, "BMAJ": 4e-8,
        "BMIN": 3e-8, "BPA": -7.0,
    }  # fmt: skip
    image = fits.PrimaryHDU(data[:1, None].astype(">f4"), fits.Header(cards))
    image.header["HISTORY"] = "AIPS   CLEAN BMAJ=  1.1E-07 BMIN=  9.7E-08 BPA=  -7.00"
    image.writeto(folder / "image.fits")
    columns = [
        fits.Column(name, "1E", unit=unit, array=[scale * 1e-8, 0])
        for name, unit, scale in (
            ("FLUX", "JY", 1), ("DELTAX", "DEGREES", 1), ("DELTAY", "DEGREES", 1),
            ("MAJOR AX", "DEGREES", 1), ("MINOR AX", "DEGREES", 1),
            ("POSANGLE", "DEGREES", 1), ("TYPE OBJ", "CODE", 1e8),
        )
    ]  # fmt: skip
    table = fits.BinTableHDU.from_columns(columns, name="AIPS CC")
    fits.HDUList([image, table]).writeto(folder / "cc.fits")
    kinds = {
        "image": (".fits", folder / "image.fits", EpochCube.read),
        "cube": (".fits", folder / "cube.fits", EpochCube.read),
        "AIPS components": (".fits", folder / "cc.fits", read_components),
        "components": (".ecsv", COMPONENTS, read_components),
        "difmap model": (".mod", MODEL, partial(read_components, dates="2001-01-01")),
        "offsets": (".ecsv", OFFSETS, _offsets),
        "region": (".reg", REGION, cube.region_mask),
        "configuration": (".toml", CONFIGURATION, _settings),
        "survey": (".toml", SURVEY, read_survey),
    }
    return {
        kind: (suffix, start if isinstance(start, bytes) else start.read_bytes(), read)
        for kind, (suffix, start, read) in kinds.items()
    }


def _offsets(path):
    return offsets_from_table(path, Time(["2001-01-01", "2002-01-01"]), ["a", "b"])


COMPONENTS = b"""\
# %ECSV 1.0
# ---
# datatype:
# - {name: epoch, datatype: string}
# - {name: feature, datatype: int64}
# - {name: flux, unit: Jy, datatype: float64}
# - {name: separation, unit: mas, datatype: float64}
# - {name: position_angle, unit: deg, datatype: float64}
# - {name: major_fwhm, unit: mas, datatype: float64}
# - {name: axial_ratio, datatype: float64}
# - {name: major_pa, unit: deg, datatype: float64}
# meta: {object: 3C 273}
# schema: astropy-2.0
epoch feature flux separation position_angle major_fwhm axial_ratio major_pa
2001-01-01 0 1.5 0.0 0.0 0.1 1.0 0.0
2001-01-01 1 0.5 1.5 -120.0 0.4 0.5 30.0
2002-01-01 0 1.4 0.0 0.0 0.1 1.0 0.0
2002-01-01 1 0.4 1.9 -121.0 "" "" ""
"""
MODEL = b"""\
! Flux (Jy) Radius (mas) Theta (deg) Major (mas) Ratio Phi (deg) T
 0.9v 0.1v 90 0.2v 1 0 1
 0.1v 2.0v -45.0v 0.3 0.5 10 1
 0.05 3.0 -50.0
"""
OFFSETS = b"""\
# %ECSV 1.0
# ---
# datatype:
# - {name: epoch, datatype: string}
# - {name: core_east, unit: mas, datatype: float64}
# - {name: core_north, unit: mas, datatype: float64}
# schema: astropy-2.0
epoch core_east core_north
2001-01-01 0.1 -0.2
2002-01-01 -0.05 0.07
"""
REGION = b"""\
# Region file format: DS9
global color=green
image
ellipse(6,4,4,2,30)
-circle(6,4,1)
polygon(1,1,8,1,8,6)
"""
CONFIGURATION = b"""\
epochs = ["jet/*.fits"]
after = 2001-01-01
align = "core"
scales = [1, 2, 3]
max_speed = "2 mas / yr"
position_angle = "65 deg"
baseline = ["0.2 yr", "1.0 yr"]
outward = true
n_trials = 500
seed = 7
redshift = 0.158
cosmology = "H0=71,Om0=0.27"
[versions]
numpy = "2.0"
"""
SURVEY = b"""\
[defaults]
scales = [1, 2]
max_speed = "2 mas / yr"
n_trials = 100
[sources."3C 273"]
epochs = ["*.fits"]
redshift = 0.158
[sources.M87]
epochs = ["image.fits", "cube.fits"]
distance = "16.7 Mpc"
position_angle = "290 deg"
"""


# -- damage --------------------------------------------------------------------------


def damage(content, rng):
    """
    Return bytes with one to four random changes.

    Parameters
    ----------
    content : bytes
    rng : `~numpy.random.Generator`

    Returns
    -------
    bytes
    """
    binary = content.startswith(b"SIMPLE")
    changes = TEXT + HEADER * 2 if binary else TEXT
    # Many changes would leave hardly anything of a text.
    for _ in range(rng.integers(1, 5 if binary else 3)):
        content = changes[rng.integers(len(changes))](content, rng)
        if not content:
            break
    return content


def _slice(content, rng, longest=40):
    start = int(rng.integers(len(content)))
    return start, min(len(content), start + int(rng.integers(1, longest)))


def _overwrite(content, rng):
    start, end = _slice(content, rng)
    return content[:start] + rng.bytes(end - start) + content[end:]


def _flip(content, rng):
    k = int(rng.integers(len(content)))
    return content[:k] + bytes([content[k] ^ 1 << rng.integers(8)]) + content[k + 1 :]


def _cut(content, rng):
    start, end = _slice(content, rng)
    return content[:start] + content[end:]


def _repeat(content, rng):
    start, end = _slice(content, rng)
    return content[:end] + content[start:end] * int(rng.integers(1, 50)) + content[end:]


def _truncate(content, rng):
    return content[: rng.integers(len(content))]


def _odd_word(content, rng):
    words = list(re.finditer(rb"[\w.+-]+", content[: 10 * BLOCK]))
    if not words:
        return content
    word = words[rng.integers(len(words))]
    return content[: word.start()] + _odd(rng) + content[word.end() :]


def _odd(rng):
    return ODD[rng.integers(len(ODD))]


def _swap_words(content, rng):
    words = list(re.finditer(rb"[\w.+-]+", content[: 10 * BLOCK]))
    if len(words) < 2:
        return content
    one, other = sorted(rng.choice(len(words), 2, replace=False))
    one, other = words[one], words[other]
    between = content[one.end() : other.start()]
    head, tail = content[: one.start()], content[other.end() :]
    return head + other.group() + between + one.group() + tail


def _card(content, rng):
    end = content.find(b"END" + b" " * 77)
    n = (end if end > 0 else min(len(content), BLOCK)) // CARD
    return CARD * int(rng.integers(max(n, 1)))


def _odd_value(content, rng):
    k = _card(content, rng)
    card = content[k : k + 10] + _odd(rng).rjust(20)[:70]
    return content[:k] + card.ljust(CARD) + content[k + CARD :]


def _repeat_card(content, rng):
    k, other = _card(content, rng), _card(content, rng)
    return content[:k] + content[other : other + CARD] + content[k + CARD :]


def _blank_card(content, rng):
    k = _card(content, rng)
    return content[:k] + b" " * CARD + content[k + CARD :]


def _other_digit(content, rng):
    k = _card(content, rng)
    digits = [m.start() for m in re.finditer(rb"\d", content[k + 9 : k + 30])]
    if not digits:
        return content
    at = k + 9 + digits[rng.integers(len(digits))]
    return content[:at] + b"%d" % rng.integers(10) + content[at + 1 :]


TEXT = (_overwrite, _flip, _cut, _repeat, _truncate, _odd_word, _swap_words)
HEADER = (_odd_value, _repeat_card, _blank_card, _other_digit)


# -- reading -------------------------------------------------------------------------


class TooLongError(BaseException):
    """A file took too long; no reader catches this exception."""


@contextmanager
def limits(memory=MEMORY):
    """Let this process allocate at most ``memory`` additional bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    used = int(re.search(r"VmData:\s+(\d+)", _status())[1]) * 1024
    resource.setrlimit(resource.RLIMIT_DATA, (used + memory, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _status():
    return Path("/proc/self/status").read_text(encoding="ascii")


def _too_long(*args):
    raise TooLongError


def read(path, reader):
    """
    Read a file and return the outcome.

    Returns
    -------
    str
        "read", "refused", or what went wrong.
    """
    before = signal.signal(signal.SIGALRM, _too_long)
    signal.setitimer(signal.ITIMER_REAL, TIME)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", AstropyWarning)
            reader(path)
        return "read"
    except EXPECTED as error:
        return "refused" if "\n" not in str(error) else f"of lines: {error!r}"
    except (Exception, TooLongError) as error:
        where = traceback.extract_tb(error.__traceback__)
        own = [f for f in where if f"astro_scc{os.sep}" in f.filename] or where
        text = " ".join(str(error).split())[:100]
        return (
            f"{type(error).__name__}: {text} "
            f"({Path(own[-1].filename).name}:{own[-1].lineno})"
        )
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def fuzz(number, *, seed=0, first=0, kinds=None, seconds=np.inf):
    """
    Damage and read files of all kinds in turn.

    Parameters
    ----------
    number : int
        Number of files.
    seed, first : int
        Seed of the damage, and number of the first file.
    kinds : sequence of str, optional
    seconds : float, optional
        Stop after this time.

    Returns
    -------
    counts : `~collections.Counter`
        Files by kind and outcome: "read", "refused" or "fault".
    faults : list of (int, str, str)
        Number of the file, its kind and what went wrong.
    """
    counts, faults = Counter(), []
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        sound = sources(folder)
        kinds = list(kinds or sound)
        for i in range(first, first + number):
            if time.monotonic() - start > seconds:
                break
            kind = kinds[i % len(kinds)]
            suffix, content, reader = sound[kind]
            path = Path(folder) / f"damaged{suffix}"
            path.write_bytes(damage(content, np.random.default_rng([seed, i])))
            found = read(path, reader)
            if found not in ("read", "refused"):
                faults.append((i, kind, found))
                found = "fault"
            counts[kind, found] += 1
    return counts, faults


def main():
    """Print the outcomes, and list the faults."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument("--number", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kind", action="append")
    args = parser.parse_args()
    start = time.monotonic()
    with limits():
        counts, faults = fuzz(
            args.number, seed=args.seed, first=args.first, kinds=args.kind
        )
    print(f"{'kind':20}{'read':>8}{'refused':>10}{'faults':>8}")
    for kind in dict.fromkeys(kind for kind, _ in counts):
        read_, refused, fault = (
            counts[kind, what] for what in ("read", "refused", "fault")
        )
        print(f"{kind:20}{read_:8}{refused:10}{fault:8}")
    for i, kind, what in faults:
        print(f"{i} {kind}: {what}")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{sum(counts.values())} files in {time.monotonic() - start:.0f} s, "
        f"{len(faults)} faults, at most {peak:.0f} MB"
    )
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
