# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The survey of a table of components, or of folders of images: its file is made."""

import glob
import json
import re
import shutil
import tomllib
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.io import ascii
from scipy.spatial import cKDTree

from astro_scc.cli import images
from astro_scc.cli.survey_sources import folder_names, read_survey
from astro_scc.components.lists import read_sources
from astro_scc.components.restoring import suited
from astro_scc.images.beam import Beam
from astro_scc.images.headers import first_line
from astro_scc.parallel import in_order
from astro_scc.writing import replace_when_complete

#: Folder of the images in that of the survey, and the file that names them.
IMAGES, PLAN = "images", "survey.toml"
#: Beginning of that file.
HEAD = "# Images from"
#: Names of images in a folder of one source.
PATTERNS = ("*.fits", "*.fit", "*.fits.gz", "*.fits.fz")
#: Table in the folder of every measurement.
COMPONENTS = "components.ecsv"
#: Names of the columns of redshifts, in small letters.
NAMES, REDSHIFTS = ("source", "name", "id", "object"), ("redshift", "z")


def survey_of(args, output, reporter):
    """
    Return the survey of a table of components, or of a folder of folders of images.

    The folder of the survey gets ``survey.toml``, which names the images of each
    source; settings may be added to it.  Of a table, they are restored into
    ``images/NAME``; those that an earlier run made from the same table in the same way
    are kept, and their sources stay in the survey.

    Parameters
    ----------
    args : `~argparse.Namespace`
        Its ``survey`` is a folder, or a table that `~astro_scc.epochs.read_components`
        reads.
    output : `~pathlib.Path`
        Folder of the survey.
    reporter : `~astro_scc.cli.program.Reporter`

    Returns
    -------
    ``Survey``

    Raises
    ------
    ValueError
        If there are no images, if the table lacks the source that is asked for, or if
        the images of no source can be restored.
    """
    source, found, how, published = Path(args.survey), {}, {}, ""
    redshifts = read_redshifts(args.redshifts) if args.redshifts else {}
    if source.is_dir():
        epochs = _images_in(source)
        head = f"{HEAD} {json.dumps(str(source.absolute()))}"
    else:
        found, how = _components(args, reporter)
        folders = folder_names(list(found))
        epochs = {k: f"{IMAGES}/{folders[k]}/*.fits" for k in found}
        state = source.stat()
        made_of = [str(source.absolute()), state.st_size, state.st_mtime_ns]
        asked = {k: str(v) for k, v in how.items() if k != "seed"}
        asked |= {"seed": args.seed}
        head = f"{HEAD} {json.dumps([*made_of, asked])}"
        if any((own.feature > 0).any() for own in found.values()):
            published = f"[defaults]\ncompare = {json.dumps(made_of[0])}\n"
    path = output / PLAN
    before = path.read_text(encoding="utf-8") if path.is_file() else ""
    # Images that were not restored here must not be deleted.
    if output.is_dir() and any(output.iterdir()) and not before.startswith(HEAD):
        raise OSError(
            f"{output}: exists and is not of a survey of a table; choose another folder"
        )
    # What was added to the file stays, and so do the sources of other calls.
    text = before if before.startswith(f"{head}\n") else f"{head}\n\n{published}"
    try:
        known = tomllib.loads(text).get("sources", {})
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path}: {first_line(error)}") from None
    for name, files in epochs.items():
        if name not in known:
            table = f"[sources.{json.dumps(name)}]\nepochs = {json.dumps(files)}\n"
            text = f"{text.rstrip()}\n\n{table}"
    if unknown := sorted(redshifts.keys() - epochs.keys() - known.keys()):
        some = "source is" if len(unknown) == 1 else "sources are"
        reporter.note(f"{args.redshifts}: {len(unknown)} {some} not of the survey")
    for name in redshifts.keys() - unknown:
        text = _with_redshift(text, name, redshifts[name])
    if text != before:
        if not known:
            shutil.rmtree(output / IMAGES, ignore_errors=True)
        output.mkdir(parents=True, exist_ok=True)
        with replace_when_complete(path, overwrite=True) as part:
            part.write_text(text, encoding="utf-8")
    target = {name: output / IMAGES / folders[name] for name in found}
    left = [name for name in found if not target[name].is_dir()]
    work = ((found[name], target[name], how) for name in left)
    done = in_order(_restore, work, args.workers or 1)
    for name, problem in zip(left, done, strict=True):
        if problem:
            reporter.warn(f"{name}: no images: {problem}")
    if found and not (output / IMAGES).is_dir():
        with suppress(OSError):
            path.unlink()
            output.rmdir()
        raise ValueError(f"{args.survey}: the images of no source can be restored")
    return read_survey(path)


def _with_redshift(text, name, redshift):
    """Return the text of a survey's file with the redshift of one of its sources."""
    table = re.escape(f"[sources.{json.dumps(name)}]\n")
    found = re.search(rf"^{table}(.*?)(?=^\[|\Z)", text, re.DOTALL | re.MULTILINE)
    if found is None:
        raise ValueError(f"survey.toml: write the redshift of {name} into it")
    own = re.sub(r"^redshift\b.*\n", "", found[1], flags=re.MULTILINE)
    epochs, line, rest = own.partition("\n")
    own = f"{epochs}{line}redshift = {redshift}\n{rest}"
    return text[: found.start(1)] + own + text[found.end(1) :]


def _restore(task):
    """Restore the images of a source, and return why that is not possible, or None."""
    own, target, how = task
    try:
        given = {k: v for k, v in how.items() if v is not None}
        if not given.keys() >= {"pixel_scale", "noise"}:
            given = suited(own) | given
        images.write_images(own, target, how | given)
    except ValueError as error:
        return str(error)
    return None


def _components(args, reporter):
    """Return the components of each source with a beam, and how to restore images."""
    how = images.images_of(args)
    options, found = {"origin": args.origin, "beams": how["beam"]}, {}
    for name in args.source.split(",") if args.source else (None,):
        found |= read_sources(args.survey, source=name, **options)
    if not all(own.beams for own in found.values()):
        # That of the whole table, so that no source depends on which others are chosen.
        every = read_sources(args.survey, **options) if args.source else found
        how["beam"] = beam = _typical_beam(every.values())
        found = {k: replace(v, beams=[beam] * len(v.times)) for k, v in found.items()}
        reporter.note(
            f"{args.survey} has no beam: images are restored with one of "
            f"{beam.major:.2g}, the median distance of neighbours in an epoch (--beam)"
        )
    left = [k for k, name in {"pixels": "pixel_scale", "noise": "noise"}.items()
            if how[name] is None]  # fmt: skip
    if left:
        reporter.note(
            f"images get {' and '.join(left)} that suit their components: a fifth of "
            "the beam, and a tenth of the faintest peak (--pixel, --noise)"
        )
    return found, how


def _typical_beam(lists):
    """Return a circular beam that separates half of the components of an epoch."""
    nearest = []
    for own in lists:
        places = np.stack([own.east, own.north], axis=1).to_value(u.mas)
        for epoch in range(own.n_epochs):
            here = places[own.epoch == epoch]
            if len(here) > 1:
                # The nearest of all is the component itself.
                nearest += cKDTree(here).query(here, k=2)[0][:, 1].tolist()
    size = np.median(nearest) if nearest else 0.0
    if not size > 0:
        raise ValueError("no epoch of the table has two components apart; give --beam")
    size = float(f"{size:.2g}") * u.mas
    return Beam(size, size, 0 * u.deg)


def _images_in(folder):
    """Return the patterns of the images in each folder of a folder, by its name."""
    found = {}
    for own in sorted(path for path in folder.iterdir() if path.is_dir()):
        # A measurement beside its images is no source.
        if own.name.startswith(".") or (own / COMPONENTS).is_file():
            continue
        here = Path(glob.escape(str(own.absolute())))
        if kinds := [k for k in PATTERNS if next(own.glob(k), None)]:
            found[own.name] = [str(here / kind) for kind in kinds]
    if not found:
        raise ValueError(
            f"{folder}: has no folder of FITS images; a survey is a folder with one "
            "for each source, a table of components or a .toml file"
        )
    return found


def read_redshifts(path):
    """
    Return the redshifts of sources in a table that astropy reads, by their names.

    Its columns are ``source``, ``name``, ``id`` or ``object``, and ``redshift`` or
    ``z``.  Sources whose redshift is not known are left out.
    """
    try:
        table = ascii.read(path)
    except OSError as error:
        raise OSError(f"{path}: cannot be read: {first_line(error)}") from None
    except Exception as error:
        raise ValueError(f"{path}: is no table: {first_line(error)}") from None
    columns = {name.lower(): name for name in table.colnames}
    names, values = (
        next((columns[k] for k in kinds if k in columns), None)
        for kinds in (NAMES, REDSHIFTS)
    )
    if names is None or values is None:
        raise ValueError(
            f"{path}: needs the columns source and redshift; it has "
            f"{', '.join(table.colnames)}"
        )
    try:
        numbers = np.ma.filled(table[values].astype(float), np.nan)
    except ValueError as error:
        raise ValueError(
            f"{path}: its column {values} must be numbers without a unit, as 0.158: "
            f"{first_line(error)}"
        ) from None
    rows = zip(table[names], numbers, strict=True)
    return {str(name): float(z) for name, z in rows if np.isfinite(z)}
