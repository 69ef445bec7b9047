# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Sources of a survey: their file, made of a table or of folders, and outcomes."""

import glob
import hashlib
import json
import os
import re
import shutil
from collections import Counter
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.io import ascii

from astro_scc.cli import images, inputs
from astro_scc.exceptions import first_line, naming_all, refusing, warn
from astro_scc.images.headers import some
from astro_scc.parallel import in_order
from astro_scc.quantities import finite_quantities, named
from astro_scc.settings import OPTIONS, Settings, read_toml
from astro_scc.writing import make_folder, replace_when_complete, versions

try:
    import fcntl
except ImportError:
    # Windows has no such locks.
    fcntl = None

__all__ = ["read_survey"]

#: What a survey's folder has: a folder of sources, with a file of state in each part.
SOURCES, STATE, FEATURES = "sources", "part.json", "features.ecsv"
#: Fields of a part that are its outcome.
OUTCOME = "status", "message", "n_epochs", "first", "last"
#: Name of the part without a region, or without scale groups.
WHOLE = "all"
ALIGNMENTS = (None, "none", "core", "correlate", "wcs")
#: Keys of the file that hold tables, and all keys of a source but published_pm.
TABLES = ("regions", "scale_groups")
KEYS = {name for name, facts in OPTIONS.items() if "measure" in facts["commands"]}
KEYS = KEYS - {"region"} | {*TABLES, "compare"}
SEED, N_TRIALS = 1, 1000
#: Options on images that are restored from components.
RESTORING = "beam", "pixel", "noise", "seed", "after", "before", "source", "origin"

#: Pattern of a check sum.
SUM = re.compile(r"-[0-9a-f]{6}$", re.IGNORECASE)
#: Names that Windows reserves for devices.
RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
#: Folder of restored images in that of the survey, the file that names them, and how
#: that begins.
IMAGES, PLAN, HEAD = "images", "survey.toml", "# Images from"
#: Names of images in a folder of one source.
PATTERNS = ("*.fits", "*.fit", "*.fits.gz", "*.fits.fz")

#: Names of the columns of redshifts, in small letters.
NAMES, REDSHIFTS = ("source", "name", "id", "object"), ("redshift", "z")


@dataclass(frozen=True, eq=False)
class Part:
    """A region and scale group of a source, its settings and, once known, outcome."""

    source: str
    region: str
    scale_group: str
    folder: str
    settings: Settings
    published: u.Quantity | None = None
    compare: str | None = None
    status: str = ""
    message: str = ""
    n_epochs: int = 0
    first: str = ""
    last: str = ""

    @property
    def title(self):
        """The names of the part that are not ``all``."""
        names = self.source, self.region, self.scale_group
        return ", ".join(name for name in names if name != WHOLE)

    @property
    def outcome(self):
        """What is known of it once it is measured, by the names of the fields."""
        return {name: getattr(self, name) for name in OUTCOME}

    def key(self):
        """Return a check sum of the settings, versions and files that products need."""
        given = self.settings
        others = given.region, given.crop, given.align, self.compare
        files = map(_facts, sorted({*others}.difference(ALIGNMENTS) | self.epochs()))
        settings = given.to_dict(), given.to_dict("profile")
        text = json.dumps([settings, versions(), *files], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def size(self):
        """Return the size of the epochs in bytes."""
        return sum(_facts(path)[1] for path in self.epochs())

    def epochs(self):
        """Return the paths of the epochs; a pattern that matches nothing is one."""
        found = (set(glob.glob(p)) or {p} for p in self.settings.epochs)
        return set().union(*found)


def _facts(path):
    """Return the name, size and times of a file."""
    with suppress(OSError):
        state = Path(path).stat()
        # The time of the content can be set back; the other one changes even then.
        return [str(path), state.st_size, state.st_mtime_ns, state.st_ctime_ns]
    return [str(path), 0]


def finished(part, output, report):
    """Return a part with its outcome if its products are complete, else None."""
    folder = Path(output, part.folder)
    needed = ["streams.ecsv", FEATURES, "report.html"][: 2 + report]
    with suppress(OSError, ValueError, KeyError, TypeError):
        state = json.loads((folder / STATE).read_text(encoding="utf-8"))
        found = replace(part, **state["outcome"])
        complete = all((folder / name).is_file() for name in needed)
        complete = complete and found.status == "measured" or found.status == "empty"
        if complete and state["key"] == part.key():
            return found
    return None


@contextmanager
def alone(folder):
    """
    Hold a folder against other runs, as long as this process lives or the block lasts.

    Raises an OSError if another one holds it, where the system has such locks.
    """
    if fcntl is None:
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    what = "another run writes into it; wait for its end, or choose another folder"
    try:
        with refusing(f"{folder}: {what}", BlockingIOError, error=OSError):
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)


def read_survey(
    path: Path | str, redshifts: dict[str, float] | None = None
) -> tuple[list[Part], str]:
    """
    Read the file of a survey.

    Parameters
    ----------
    path : path
        A TOML file with a table ``[sources.NAME]`` for each source, with its
        ``epochs``, ``regions`` (a table of region files), ``scale_groups`` (a table of
        scales, two or more, that are measured as by
        `~astro_scc.flow.measure_profile`), ``published_pm`` and ``compare``, a speed
        and a table of published features to compare with, and any setting of a
        measurement; and a table ``[defaults]`` for what a source does not set.  Paths
        are relative to the file.
    redshifts : dict of float, optional
        Redshifts of sources, in place of those in the file.

    Returns
    -------
    parts : list of ``Part``
        A region and scale group of a source each.
    text : str
        The text of the file.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If the file is not TOML, or a key or a value in it is invalid.

    Examples
    --------
    >>> from pathlib import Path
    >>> from astro_scc.cli.survey_sources import read_survey
    >>> _ = Path("survey.toml").write_text('''
    ... [defaults]
    ... scale_groups = {fine = [1, 2], coarse = [3, 4]}
    ... [sources."3C 273"]
    ... epochs = "3c273/*.fits"
    ... redshift = 0.158
    ... ''')
    >>> parts, _ = read_survey("survey.toml")
    >>> [part.title for part in parts]
    ['3C 273, fine', '3C 273, coarse']
    """
    path = Path(path)
    values, text = read_toml(path)
    if unknown := sorted(set(values) - {"defaults", "sources"}):
        raise ValueError(
            f"{path}: unknown key {unknown[0]!r}; a survey has [defaults] and "
            "[sources.NAME]"
        )
    sources = _table(values.get("sources", {}), f"{path}: sources")
    if not sources:
        raise ValueError(f"{path}: names no source; add a table [sources.NAME]")
    base = {"seed": SEED, "n_trials": N_TRIALS}
    defaults = base | _known(values.get("defaults", {}), f"{path}: defaults")
    folders, found = folder_names(list(sources)), []
    for name, values in sources.items():
        where = f"{path}: sources.{name}"
        given = inputs.override(defaults, _known(values, where, "published_pm"))
        if name in (redshifts or {}):
            given = inputs.override(given, {"redshift": redshifts[name]})
        try:
            found += _parts(name, folders[name], given, path.absolute().parent)
        except ValueError as error:
            if getattr(error, "setting", None) not in {None, *values}:
                where = f"{path}: defaults"
            raise ValueError(f"{where}: {error}") from None
    return found, text


def _table(value, where):
    if not isinstance(value, dict):
        raise ValueError(f"{where} must be a table")
    return value


def _known(values, where, *more):
    """Return the values of a table, and refuse keys that a survey does not have."""
    for name in _table(values, where):
        if name not in (*KEYS, *more):
            raise ValueError(
                f"{where}: {name} is no setting of a survey; they are regions, "
                "scale_groups, compare, published_pm of a source, and those of "
                "astro-scc measure but region"
            )
        if name in TABLES:
            _table(values[name], f"{where}: {name}")
    return values


def _published_pm(value):
    """Return a published speed, or a speed and its error."""
    wanted = 'must be a speed, or one and its error, such as "0.9 0.1 mas/yr"'
    found = finite_quantities(value, u.mas / u.yr, wanted)
    if found.size > 2 or np.any(found < 0):
        raise ValueError(wanted)
    return found


def _parts(name, folder, given, base):
    """Yield the parts of a source from its table; paths are relative to ``base``."""
    published, compare, regions = (
        given.pop(key, None) for key in ("published_pm", "compare", "regions")
    )
    if published is not None:
        published = named("published_pm", _published_pm, published)
    regions = regions or {WHOLE: None}
    files = {f"regions.{label}": file for label, file in regions.items()}
    for label, file in (files | {"compare": compare}).items():
        if file is not None and not (isinstance(file, str) and file):
            raise ValueError(f"{label} must be the path of a file")
    if "redshift" not in given:
        given.pop("cosmology", None)
    # A source may override the groups of the defaults by none.
    settings = Settings(**given | {"scale_groups": given.get("scale_groups") or None})
    if not settings.epochs:
        raise ValueError("has no epochs; name the FITS files")
    inputs.refuse_paper(settings)

    def of_base(file):
        return file and str(base / file)

    # Special characters in the folder's own name are not meant as a pattern.
    escaped, align = Path(glob.escape(str(base))), settings.align
    settings = settings.changed(
        epochs=[str(escaped / pattern) for pattern in settings.epochs],
        # A core may have the direction of its jet.
        align=align if (align or "core").split()[0] in ALIGNMENTS else of_base(align),
        crop=of_base(settings.crop),
    )  # fmt: skip
    groups = list(settings.scale_groups or [WHOLE])
    of_region, of_group = folder_names(list(regions)), folder_names(groups)
    for (region, file), group in product(regions.items(), groups):
        yield Part(
            name, region, group,
            f"{SOURCES}/{folder}/{of_region[region]}/{of_group[group]}",
            settings.changed(region=of_base(file)), published, of_base(compare),
        )  # fmt: skip


def folder_names(names):
    """
    Return safe and different folder names for any names.

    They have only letters, digits and ``+ - _ .``, none at the beginning that hides
    the folder or leads upwards, and at most 60 characters and a check sum.  A name that
    needs no change is kept.  A name that is changed, looks like a check sum, is
    reserved, or differs from another only in upper and lower case, ends in a check sum.
    """
    found, count = {}, Counter(name.casefold() for name in names)
    for name in names:
        text = re.sub(r"[^A-Za-z0-9+._-]+", "_", name)[:60]
        found[name] = text = text.lstrip("._-+").rstrip("._") or "unnamed"
        taken = SUM.search(name) or RESERVED.fullmatch(name)
        if text != name or taken or count[name.casefold()] > 1:
            code = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()
            found[name] = f"{text}-{code[:6]}"
    return found


# -- the file of a table of components, or of folders of images ----------------------


def survey_of(args, output, reporter):
    """Return the survey of the arguments of the command, and whether it has reports."""
    given, redshifts = Path(args.survey), {}
    of_file = given.suffix.lower() == ".toml"
    for name in RESTORING if of_file or given.is_dir() else ():
        if getattr(args, name) is not None:
            raise ValueError(
                f"--{name} is for a table of components, not for {given}; settings are "
                "written into survey.toml"
            )
    if args.redshifts:
        redshifts = read_redshifts(args.redshifts)
    path = given if of_file else write_survey(args, output, reporter)
    survey = parts, _ = read_survey(path, redshifts)
    if unknown := redshifts.keys() - {part.source for part in parts}:
        are = "source is" if len(unknown) == 1 else "sources are"
        reporter.note(f"{args.redshifts}: {len(unknown)} {are} not of the survey")
    return survey, of_file if args.report is None else args.report


def write_survey(args, output, reporter):
    """
    Write the file of a survey of a table of components, or of folders of images.

    The folder of the survey gets ``survey.toml``, which names the images of each
    source; settings may be added to it.  Of a table, they are restored into
    ``images/NAME``; those that an earlier run made from the same table in the same way
    are kept, and their sources stay in the survey.
    """
    given, path = Path(args.survey), output / PLAN
    found, how, defaults, made_of = {}, {}, "", str(given.absolute())
    if given.is_dir():
        epochs = _images_in(given)
    else:
        found, how = images.components_of(args, reporter)
        folders = folder_names(list(found))
        epochs = {name: f"{IMAGES}/{folders[name]}/*.fits" for name in found}
        if any((components.feature > 0).any() for components in found.values()):
            defaults = f"[defaults]\ncompare = {json.dumps(made_of)}\n"
        asked = {k: str(v) for k, v in how.items()} | {"seed": args.seed}
        made_of = [made_of, *_facts(given)[1:3], asked]
    is_new = not output.is_dir()
    make_folder(output, output)
    with alone(output):
        _update_plan(path, f"{HEAD} {json.dumps(made_of)}", defaults, epochs)
        targets = {name: output / IMAGES / folders[name] for name in found}
        left = [name for name in found if not targets[name].is_dir()]
        work = ((found[name], targets[name], how) for name in left)
        problems = in_order(images.restored, work, args.workers or 1)
        for name, problem in zip(left, problems, strict=True):
            if problem:
                reporter.warn(f"{name}: no images: {problem}")
    if found and not (output / IMAGES).is_dir():
        if is_new:
            shutil.rmtree(output)
        raise ValueError(f"{given}: the images of no source can be restored")
    return path


def _update_plan(path, head, defaults, epochs):
    """Add sources to the file of a survey, or begin it anew if its head is another."""
    values, text = read_toml(path) if path.is_file() else ({}, "")
    # Images that were not restored here must not be deleted.
    if any(path.parent.iterdir()) and not text.startswith(HEAD):
        raise OSError(
            f"{path.parent}: exists and is not of a survey of a table; choose another "
            "folder"
        )
    # What was added to the file stays, and so do the sources of other calls.
    known = values.get("sources", {})
    if not text.startswith(f"{head}\n"):
        text, known = f"{head}\n\n{defaults}", {}
        shutil.rmtree(path.parent / IMAGES, ignore_errors=True)
    for name, files in epochs.items():
        if name not in known:
            table = f"[sources.{json.dumps(name)}]\nepochs = {json.dumps(files)}\n"
            text = f"{text.rstrip()}\n\n{table}"
    with replace_when_complete(path, overwrite=True) as part:
        part.write_text(text, encoding="utf-8")


def _images_in(folder):
    """Return the patterns of the images in each folder of a folder, by its name."""
    found, without = {}, []
    for path in sorted(path for path in folder.iterdir() if path.is_dir()):
        # A measurement beside its images is no source.
        made = any((path / name).is_file() for name in ("streams.ecsv", PLAN))
        if path.name.startswith(".") or made:
            continue
        here = Path(glob.escape(str(path.absolute())))
        if kinds := [kind for kind in PATTERNS if next(path.glob(kind), None)]:
            found[path.name] = [str(here / kind) for kind in kinds]
        else:
            without.append(str(path))
    if found and without:
        warn(f"{some(without)}: no FITS images in the folder, which is no source")
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
    except Exception as error:
        what = "cannot be read" if isinstance(error, OSError) else "is no table"
        raise ValueError(f"{path}: {what}: {first_line(error)}") from None
    columns = {name.lower(): table[name] for name in table.colnames}
    names, values = (
        next((columns[k] for k in kinds if k in columns), None)
        for kinds in (NAMES, REDSHIFTS)
    )
    if names is None or values is None:
        raise ValueError(
            f"{path}: needs the columns source and redshift; it has "
            f"{', '.join(map(repr, table.colnames))}"
        )
    wanted = f"its column {values.name} must be numbers without a unit, as 0.158"
    with naming_all(f"{path}: {wanted}"):
        numbers = np.ma.filled(values.astype(float), np.nan)
    rows = zip(names, numbers, strict=True)
    return {str(name): float(z) for name, z in rows if np.isfinite(z)}
