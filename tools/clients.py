# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Drive the programs that people open our files with, and look at what they say.

    python tools/clients.py OUT [--only stilts fitsverify ds9 chromium] [--pages HTML]

measures a small simulated jet into the folder OUT and hands every product to the
program that is meant to read it: STILTS reads all tables and must find the units
that astropy finds, fitsverify must accept every FITS file, DS9 (under Xvfb) opens
an epoch with the regions of its SSPs, Chromium lays the report out wide and narrow,
and other pages that are given, such as those of the documentation, and nothing may
stick out.  Screenshots are left in OUT to be looked at.  A program that is not
installed is skipped with a message; on Debian they are

    apt install stilts fitsverify saods9 xvfb imagemagick chromium

The exit status is 1 if a program complained, 0 otherwise.
"""

import argparse
import csv
import html
import io
import json
import os
import re
import shutil
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import astropy.units as u
from astropy.table import QTable

WIDTHS = (1280, 768, 360)
CHROMIUM = (
    *("chromium", "--headless", "--no-sandbox", "--disable-gpu"),
    *("--allow-file-access-from-files", "--virtual-time-budget=5000"),
)
#: The epoch that is opened with its regions, and the colour of these.
EPOCH = 2
ORANGE = (255, 165, 0)


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument("out", type=Path, help="folder for products and screenshots")
    parser.add_argument("--only", nargs="+", choices=CLIENTS, default=list(CLIENTS))
    parser.add_argument("--pages", nargs="+", type=Path, default=[], metavar="HTML")
    args = parser.parse_args(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    make_products(args.out)
    failed = False
    for name in args.only:
        programs, check = CLIENTS[name]
        more = [args.pages] if name == "chromium" else []
        missing = [program for program in programs if shutil.which(program) is None]
        if missing:
            print(f"{name}: skipped, {' and '.join(missing)} not installed")
            continue
        for subject, problem, *note in check(args.out, *more):
            print(f"{name}: {subject}: {problem or ''.join(note) or 'fine'}")
            failed |= bool(problem)
    return int(failed)


def make_products(out):
    """One of every kind of file that the package writes."""
    from astro_scc import StackedCrossCorrelation
    from astro_scc.epochs import write_epochs
    from astro_scc.measurement import write_products, write_ssp_regions, write_votable
    from astro_scc.report import write_report
    from astro_scc.simulation import simulate_two_fluid

    jet = simulate_two_fluid(n_epochs=5, rng=1)
    scc = StackedCrossCorrelation(scales=[1, 2, 3], max_speed=36 * u.mas / u.yr)
    result = scc(jet.cube, n_trials=50, rng=1)
    write_products(result, result.components, out)
    write_report(result, result.components, out, title="A jet of two fluids")
    for name, table in (("components", result.components), ("ssps", result.ssps)):
        write_votable(table, out / f"{name}.vot", overwrite=True)
    write_epochs(jet.cube, out / "epochs", overwrite=True)
    jet.cube.write(out / "cube.fits", overwrite=True)
    result.matched.write(out / "matches.fits", overwrite=True)
    for shape in ("outline", "circle"):
        write_ssp_regions(
            result.matched.ssps,
            jet.cube,
            EPOCH,
            out / f"{shape}.reg",
            scales=[2],
            shape=shape,
            overwrite=True,
        )


def run(*command, timeout=180):
    """Standard output and error of a program as text, and its exit status."""
    done = subprocess.run(
        [str(word) for word in command],
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )
    return done.stdout + done.stderr, done.returncode


def check_stilts(out):
    """Every table: number of rows, names and units of the columns."""
    for path in sorted([*out.rglob("*.ecsv"), *out.rglob("*.vot")]):
        kind = {".ecsv": "ecsv", ".vot": "votable"}[path.suffix]
        source = ("tpipe", f"in={path}", f"ifmt={kind}", "ofmt=csv")
        text, status = run("stilts", *source, "cmd=meta name class units")
        if f"Unknown format {kind}" in text:
            yield path.name, "", f"not read, this STILTS is built without {kind}"
            continue
        if status:
            yield path.name, f"cannot be read: {text.strip().splitlines()[-1]}"
            continue
        found = {row["Name"]: row["Units"] for row in csv.DictReader(io.StringIO(text))}
        format_ = {"ecsv": "ascii.ecsv"}.get(kind, kind)
        table = QTable.read(path, format=format_)
        counted, _ = run("stilts", "tpipe", f"in={path}", f"ifmt={kind}", "omode=count")
        rows = int(re.search(r"rows: ([\d,]+)", counted)[1].replace(",", ""))
        yield path.name, _differences(table, found, rows)


def _differences(table, found, rows):
    if rows != len(table):
        return f"has {len(table)} rows, read are {rows}"
    if list(found) != table.colnames:
        return f"columns are {table.colnames}, read are {list(found)}"
    for name, text in found.items():
        unit = getattr(table[name], "unit", None) or u.dimensionless_unscaled
        if u.Unit(text or "") != unit:
            return f"the unit of {name} is {unit}, read is {text!r}"
    return ""


def check_fitsverify(out):
    """Every FITS file, without an error or a warning."""
    for path in sorted(out.rglob("*.fits")):
        text, _ = run("fitsverify", path)
        summary = re.search(r"found (\d+) warning\(s\) and (\d+) error\(s\)", text)
        said = re.findall(r"^\*\*\* .*(?:\n    .*)?", text, flags=re.MULTILINE)
        clean = summary is not None and summary.groups() == ("0", "0")
        yield path.name, "" if clean else "; ".join(said) or text[-300:]


def check_ds9(out):
    """An epoch with the regions of its SSPs, as pictures to look at."""
    epoch = sorted((out / "epochs").glob("*.fits"))[EPOCH]
    for shape in ("outline", "circle"):
        picture = out / f"ds9_{shape}.png"
        picture.unlink(missing_ok=True)
        ds9 = (
            *("ds9", "-geometry", "1200x800", epoch, "-scale", "asinh"),
            *("-regions", "load", out / f"{shape}.reg", "-zoom", "to", "fit"),
        )
        problem = photograph(ds9, picture, of=ORANGE)
        n_regions = len((out / f"{shape}.reg").read_text().splitlines()) - 3
        yield f"{n_regions} regions, look at {picture.name}", problem


def photograph(command, picture, *, of, patience=120):
    """Show a program on a screen of its own, and take a picture of what it draws.

    The picture is that in which the colour ``of`` is seen and no more of it comes;
    on a busy machine programs take their time.
    """
    with ExitStack() as stack:
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}

        def start(words, **kwargs):
            process = subprocess.Popen([str(w) for w in words], **quiet, **kwargs)
            stack.callback(process.wait)
            stack.callback(process.terminate)
            return process

        read, write = os.pipe()
        screen = ("Xvfb", "-screen", "0", "1200x830x24", "-displayfd", write)
        start(screen, pass_fds=[write])
        os.close(write)
        with open(read) as number:
            display = f":{number.readline().strip()}"
        shown = start(command, env={**os.environ, "DISPLAY": display})
        seen, end = 0, time.monotonic() + patience
        while time.monotonic() < end:
            time.sleep(5)
            if shown.poll() is not None:
                return f"ended with status {shown.returncode}"
            text, _ = run("import", "-display", display, "-window", "root", picture)
            if not picture.is_file():
                return f"no picture: {text[-300:]}"
            before, seen = seen, pixels_of(picture, of)
            if seen and seen == before:
                return ""
    return f"nothing of the colour of the regions in {patience} s"


def pixels_of(picture, color):
    """How many pixels of a picture have a colour."""
    from matplotlib.image import imread

    found = (255 * imread(picture)[..., :3]).round() == color
    return int(found.all(axis=-1).sum())


def check_chromium(out, pages=()):
    """The report, and other pages, wide and narrow: nothing is wider than the page."""
    report = out / "report.html"
    for page in (report, *pages):
        widths = page_widths(page, out)
        if widths is None:
            yield page.name, "did not open"
            continue
        for width, (scroll, client, tags) in widths.items():
            wide = f"is {scroll} px wide in {client} ({', '.join(tags)})"
            yield f"{page.name} at {width} px", wide if scroll > client else ""
    for width in WIDTHS:
        picture = (out / f"report_{width}.png").resolve()
        with wrapper(out, frame(report, width, 2400)) as page:
            size = f"--window-size={width + 20},2420"
            run(*CHROMIUM, f"--screenshot={picture}", size, page)
        yield f"look at {picture.name}", "" if picture.is_file() else "no picture"


def page_widths(page, out):
    """Width of a page that is laid out in frames, and what sticks out of them."""
    script = """<script>
    window.onload = () => {
      const seen = {};
      for (const frame of document.querySelectorAll("iframe")) {
        const page = frame.contentDocument.documentElement;
        const out = [...page.querySelectorAll("body *")].filter(
          e => e.getBoundingClientRect().right > page.clientWidth + 1);
        seen[frame.width] = [page.scrollWidth, page.clientWidth,
                             out.slice(0, 3).map(e => e.tagName)];
      }
      document.getElementById("seen").textContent = JSON.stringify(seen);
    };
    </script><pre id="seen"></pre>"""
    frames = "".join(frame(page, width, 900) for width in WIDTHS)
    with wrapper(out, script + frames) as url:
        text, _ = run(*CHROMIUM, "--dump-dom", url)
    seen = re.search(r'<pre id="seen">(.+?)</pre>', text, flags=re.DOTALL)
    return json.loads(html.unescape(seen[1])) if seen else None


def frame(page, width, height):
    """Windows of Chromium cannot be made narrow, frames can."""
    url = html.escape(Path(page).resolve().as_uri())
    style = "border:0"
    return (
        f'<iframe width={width} height={height} style="{style}" src="{url}"></iframe>'
    )


@contextmanager
def wrapper(out, body):
    """Address of a page that is there for a moment."""
    page = (out / "frames.html").resolve()
    page.write_text(f"<!doctype html><body style='margin:0'>{body}", encoding="utf-8")
    yield page.as_uri()
    page.unlink()


CLIENTS = {
    "stilts": (("stilts",), check_stilts),
    "fitsverify": (("fitsverify",), check_fitsverify),
    "ds9": (("ds9", "Xvfb", "import"), check_ds9),
    "chromium": (("chromium",), check_chromium),
}


if __name__ == "__main__":
    sys.exit(main())
