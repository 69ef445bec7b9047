# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Sources of a survey: read from a file, and their components in one table."""

import glob
import hashlib
import json
import re
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.io.misc import yaml
from astropy.table import Column, MaskedColumn, QTable, vstack

from astro_scc.cli import inputs
from astro_scc.columns import round_to_errors
from astro_scc.measurement import component_table, false_discovery_rate
from astro_scc.quantities import check_scales, finite_quantities, named
from astro_scc.settings import OPTIONS, Settings, read_toml
from astro_scc.writing import versions

__all__ = ["read_survey"]

#: Name of the part without a region, or without scale groups.
WHOLE = "all"
ALIGNMENTS = (None, "none", "core", "correlate", "wcs")
#: Keys of the file that hold tables, and all keys of a source but published_pm.
TABLES = ("regions", "scale_groups")
KEYS = {name for name, facts in OPTIONS.items() if "measure" in facts["commands"]}
KEYS = KEYS - {"region"} | {*TABLES, "compare"}
SEED, N_TRIALS = 1, 1000
#: Longest name of a folder, without its check sum.
LONGEST = 60
#: Pattern of a check sum.
SUM = re.compile(r"-[0-9a-f]{6}$", re.IGNORECASE)
#: Names that Windows reserves for devices.
RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
#: A unit in the header of an ECSV file to which others refer.
UNIT = re.compile(r"&(id\d+) (!astropy\.units\.Unit \{[^}]*\})")
#: What the meta of a table says of speeds in c, and of columns that are objects.
IN_C, SERIALIZED = ("redshift", "cosmology", "distance"), "__serialized_columns__"
#: Columns that identify a row of the table, and their descriptions.
HEAD = {
    "source": "name of the source",
    "region": "name of the region, all without one",
    "scale_group": "name of the scale group, all without one",
    "status": "measured, empty (searched, nothing to test) or failed",
    "message": "why there is no stream",
}


@dataclass(frozen=True)
class Source:
    """A source: its scale groups and regions by name; the region None is everything."""

    name: str
    folder: str
    settings: Settings
    regions: dict
    scale_groups: dict
    published: u.Quantity | None = None
    compare: str | None = None

    @property
    def parts(self):
        """Names of all pairs of a region and a scale group."""
        return [(r, g) for r in self.regions for g in self.scale_groups]

    def key(self):
        """Return a check sum of the settings, versions and files that products need."""
        groups = self.scale_groups.values()
        settings = [replace(self.settings, scales=scales) for scales in groups]
        settings = [own.to_dict() for own in (self.settings, *settings)]
        files = [*self.regions.values(), self.settings.crop, self.settings.align]
        files.append(self.compare)
        files = self._epochs() | {path for path in files if path not in ALIGNMENTS}
        known = settings, self.parts, self.regions, versions()
        text = json.dumps([*known, *map(_facts, sorted(files))], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def size(self):
        """Return the size of the epochs in bytes, at least 1."""
        return max(sum(_facts(path)[1] for path in self._epochs()), 1)

    def _epochs(self):
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


@dataclass(frozen=True)
class Survey:
    """Sources to be measured together, and the text of their file."""

    sources: tuple[Source, ...]
    text: str = ""


def read_survey(path: Path | str) -> Survey:
    """
    Read the file of a survey.

    Parameters
    ----------
    path : path
        A TOML file with a table ``[sources.NAME]`` for each source, with its
        ``epochs``, ``regions`` (a table of region files), ``scale_groups`` (a
        table of scales), ``published_pm`` and ``compare``, a speed and a table of
        published features to compare with, and any setting of a
        measurement; and a table ``[defaults]`` for what a source does not set.
        Paths are relative to the file.

    Returns
    -------
    Survey
        With ``sources``, for `~astro_scc.cli.survey.run_survey`.

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
    >>> survey = read_survey("survey.toml")
    >>> [(source.name, source.parts) for source in survey.sources]
    [('3C 273', [('all', 'fine'), ('all', 'coarse')])]
    """
    path = Path(path)
    values, text = read_toml(path)
    unknown = set(values) - {"defaults", "sources"}
    if unknown:
        raise ValueError(
            f"{path}: unknown key {sorted(unknown)[0]!r}; a survey has [defaults] and "
            "[sources.NAME]"
        )
    sources = _table(values.get("sources", {}), f"{path}: sources")
    if not sources:
        raise ValueError(f"{path}: names no source; add a table [sources.NAME]")
    base = {"seed": SEED, "n_trials": N_TRIALS}
    defaults = base | _known(values.get("defaults", {}), f"{path}: defaults")
    folders = folder_names(list(sources))
    found = []
    for name, values in sources.items():
        where = f"{path}: sources.{name}"
        given = inputs.override(defaults, _known(values, where, "published_pm"))
        try:
            found.append(_source(name, folders[name], given, path.absolute().parent))
        except ValueError as error:
            setting = getattr(error, "setting", None)
            if setting is not None and setting not in values:
                where = f"{path}: defaults"
            raise ValueError(f"{where}: {error}") from None
    return Survey(tuple(found), text)


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


def _source(name, folder, given, base):
    """Return a source from the values of its table; paths are relative to ``base``."""
    if (published := given.pop("published_pm", None)) is not None:
        published = named("published_pm", _published_pm, published)
    compare = given.pop("compare", None)
    regions = given.pop("regions", None) or {WHOLE: None}
    files = {f"regions.{label}": file for label, file in regions.items()}
    for label, file in (files | {"compare": compare}).items():
        if file is not None and not (isinstance(file, str) and file):
            raise ValueError(f"{label} must be the path of a file")
    groups = given.pop("scale_groups", None) or {}
    groups = {k: named(f"scale_groups.{k}", check_scales, v) for k, v in groups.items()}
    if "redshift" not in given:
        given.pop("cosmology", None)
    if "scales" not in given and groups:
        if len({hasattr(group, "unit") for group in groups.values()}) > 1:
            raise ValueError(
                "scale_groups must be all numbers or all angles, or give scales"
            )
        given["scales"] = np.unique(np.concatenate([*groups.values()]))
    settings = Settings(**given)
    if not settings.epochs:
        raise ValueError("has no epochs; name the FITS files")

    # Special characters in the folder's own name are not meant as a pattern.
    escaped, align = glob.escape(str(base)), settings.align
    settings = replace(
        settings,
        epochs=[str(Path(escaped, pattern)) for pattern in settings.epochs],
        align=align if align in ALIGNMENTS else str(base / align),
        crop=settings.crop and str(base / settings.crop),
    )
    regions = {label: file and str(base / file) for label, file in regions.items()}
    groups = groups or {WHOLE: settings.scales}
    compare = compare and str(base / compare)
    return Source(name, folder, settings, regions, groups, published, compare)


def folder_names(names):
    """
    Return safe and different folder names for any names.

    They have only letters, digits and ``+ - _ .``, none at the beginning that hides
    the folder or leads upwards, and at most 60 characters and a check sum.  A name that
    needs no change is kept.  A name that is changed, looks like a check sum, or differs
    from another only in upper and lower case, ends in a check sum.
    """
    plain = {}
    for name in names:
        text = re.sub(r"[^A-Za-z0-9+._-]+", "_", name)[:LONGEST]
        text = text.lstrip("._-+").rstrip("._") or "unnamed"
        plain[name] = f"{text}_" if RESERVED.fullmatch(text) else text
    kept = {
        name for name, text in plain.items() if text == name and not SUM.search(name)
    }
    count = Counter(name.casefold() for name in kept)
    for name, text in plain.items():
        if name not in kept or count[name.casefold()] > 1:
            code = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()
            plain[name] = f"{text}-{code[:6]}"
    return plain


# -- the table -------------------------------------------------------------------


def catalogues(outcomes, sources, output):
    """
    Return the components and the features of all sources.

    Parameters
    ----------
    outcomes : sequence of `~astro_scc.cli.survey.Outcome`
    sources : sequence of `Source`
    output : path
        Folder of the survey.

    Returns
    -------
    components : `~astropy.table.QTable`
        See `~astro_scc.cli.survey.run_survey`.
    features : `~astropy.table.QTable`
        The tables of features of all sources, with the columns of ``HEAD`` that
        identify them.
    """
    redshifts = {source.name: source.settings.redshift for source in sources}
    empty = component_table([])
    found, how = _stacked(outcomes, output, "components.ecsv", empty.copy())
    features, _ = _stacked(outcomes, output, "features.ecsv", QTable())
    searched = {k for k, outcome in enumerate(outcomes) if outcome.folder}
    nothing = dict.fromkeys(searched - set(found["outcome"]), empty)
    tested = false_discovery_rate({"all": found} | nothing)
    rest = QTable({"outcome": [*({*range(len(outcomes))} - set(found["outcome"]))]})
    rest["outcome"] = rest["outcome"].astype(int)
    table = vstack([tested["all"], rest], metadata_conflicts="silent")
    table = _with_head(table, outcomes, redshifts)
    table.meta = {
        "versions": versions(),
        "false_discovery": {"method": "bh", "n_tests": len(found) + len(nothing)},
        # A source has one redshift and cosmology, or one distance, in all its parts.
        "speeds_in_c": {outcomes[k].source: own for k, own in how.items() if own},
    }
    features = _with_head(features, outcomes, redshifts)
    features.remove_columns(["status", "message"])
    features.meta = {key: table.meta[key] for key in ("versions", "speeds_in_c")}
    return table, features


def _stacked(outcomes, output, name, empty):
    """
    Return a table of all parts, with their numbers, and how each has speeds in c.

    Most of the time to read an ECSV file is that for its header, and headers of
    different sources differ only in the meta.  The rows under equal headers are
    therefore read together.
    """
    parts, how = {}, {}
    for number, outcome in enumerate(outcomes):
        if not outcome.folder:
            continue
        path = Path(output, outcome.folder, name)
        head, meta, rows = _split(path)
        how[number] = yaml.load("".join(meta.get(k, "") for k in IN_C) or "[]")
        how[number] = {k: v for item in how[number] for k, v in item.items()}
        _, _, numbers, lines = parts.setdefault(head, (path, rows[0], [], []))
        numbers += [number] * len(rows[1:])
        lines += rows[1:]
    empty["outcome"] = np.zeros(0, dtype=int)
    tables = [empty]
    for head, (path, names, numbers, lines) in parts.items():
        table = inputs.read_table([*head.splitlines(), names, *lines], name=path)
        table.meta.clear()
        table["outcome"] = numbers
        tables.append(table)
    return round_to_errors(vstack(tables, metadata_conflicts="silent")), how


def _split(path):
    """Return the head of an ECSV file without meta, the items of this, and the rows."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        n = next(k for k, line in enumerate(lines) if line[:1] != "#")
    except (OSError, ValueError, StopIteration):
        # Says what is wrong.
        inputs.read_table(path)
        raise
    head, _, meta = "\n".join(lines[:n]).partition("\n# meta: !!omap")
    meta = meta.partition("\n# schema: ")[0]
    # Numbers of digits are those of the source.
    head = re.sub(r", format: [^,}]*", "", head)
    # Items refer to units of others.
    units = dict(UNIT.findall(meta))
    meta = re.sub(r"\*(id\d+)", lambda m: units[m[1]], re.sub(r"&id\d+ ", "", meta))
    items = re.split(r"\n# (?=- )", meta)[1:]
    items = {re.match(r"- \{?(\w+)", own)[1]: own for own in items}
    own = "\n# " + items.pop(SERIALIZED) if SERIALIZED in items else ""
    head += f"\n# meta: !!omap{own}\n# schema: astropy-2.0" if own else ""
    items = {k: re.sub(r"\n# ?", "\n", own) + "\n" for k, own in items.items()}
    return head, items, lines[n:]


def _with_head(table, outcomes, redshifts):
    """Return rows in the order of their parts, after the columns of ``HEAD``."""
    table = table[np.argsort(table["outcome"], kind="stable")]
    number = np.asarray(table["outcome"], dtype=int)
    table.remove_column("outcome")
    for k, (name, text) in enumerate(HEAD.items()):
        values = np.array([getattr(own, name) for own in outcomes], dtype=str)[number]
        table.add_column(Column(values, description=text), index=k, name=name)
    z = np.array([redshifts[own.source] or np.nan for own in outcomes])[number]
    column = MaskedColumn(z, mask=np.isnan(z), format="g")
    column.description = "redshift of the source, if it was given"
    table.add_column(column, index=1, name="redshift")
    return table
