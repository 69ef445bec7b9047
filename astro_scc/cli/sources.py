# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A survey: its sources, read from a file, measured one by one, in one table."""

import glob
import hashlib
import json
import os
import re
import shutil
import traceback
import warnings
from collections import Counter
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import Column, QTable, vstack

from astro_scc.cli.inputs import read_epochs
from astro_scc.cli.measure import WORK, write_measurement
from astro_scc.cli.reporter import one_line
from astro_scc.correlation.parallel import as_done, workers_of
from astro_scc.epochs.cutout import refuse_pixels
from astro_scc.measurement import (
    component_table,
    false_discovery_rate,
    select_ssps,
    versions,
)
from astro_scc.partial import hold, partial_folder, remove_left, replace_when_complete
from astro_scc.progress import progress
from astro_scc.scc import StackedCrossCorrelation
from astro_scc.settings import OPTIONS, Settings, check_setting, override, read_toml

__all__ = ["read_survey", "run_survey"]

#: Without a region, and without scale groups.
WHOLE = "all"
ALIGNMENTS = (None, "none", "core", "correlate", "wcs")
SEED, N_TRIALS = 1, 1000
SOURCES, STATE, TABLE, PLAN = "sources", "source.json", "survey.ecsv", "survey.toml"
#: What the folder of a source begins with until it is complete.
PARTIAL = "partial-"
#: Columns of the table that name a row, and what is said of it.
HEAD = {
    "source": "name of the source",
    "region": "name of the region, all without one",
    "scale_group": "name of the scale group, all without one",
    "status": "measured, empty (searched, nothing to test) or failed",
    "message": "why there is no component",
}
#: Longest name of a folder, but for a check sum.
LONGEST = 60
#: What a check sum looks like.
SUM = re.compile(r"-[0-9a-f]{6}$", re.IGNORECASE)
#: What Windows keeps for devices.
RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)


@dataclass(frozen=True)
class Source:
    """A source: scales by name, and region files by name or one None for all."""

    name: str
    folder: str
    settings: Settings = field(hash=False)
    regions: dict = field(hash=False)
    scale_groups: dict = field(hash=False)

    @property
    def parts(self):
        """Names of each region with each scale group."""
        return [(r, g) for r in self.regions for g in self.scale_groups]

    def key(self):
        """Return a check sum of the settings, versions and files of the products."""
        known = {
            "settings": self.settings.to_dict(),
            "regions": self.regions,
            "scale_groups": {
                name: replace(self.settings, scales=scales).to_dict()["scales"]
                for name, scales in self.scale_groups.items()
            },
            "versions": versions(),
            "files": [_facts(path) for path in sorted(self._files())],
        }
        return hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()

    def _files(self):
        others = [*self.regions.values(), self.settings.crop]
        if self.settings.align not in ALIGNMENTS:
            others.append(self.settings.align)
        found = {path for path in others if path is not None}
        for pattern in self.settings.epochs:
            found |= set(glob.glob(pattern)) or {pattern}
        return found


def _facts(path):
    """Name, size and times of a file."""
    try:
        state = Path(path).stat()
    except OSError:
        return [str(path), None, None]
    # Of the content, which may be set back, and of anything about the file.
    return [str(path), state.st_size, state.st_mtime_ns, state.st_ctime_ns]


@dataclass(frozen=True)
class Survey:
    """Sources that are measured together, and the text of their file."""

    sources: tuple[Source, ...]
    text: str = ""


@dataclass(frozen=True)
class Outcome:
    """What became of a region and scale group; ``folder`` has its products."""

    source: str
    region: str
    scale_group: str
    status: str
    message: str = ""
    folder: str = ""


# -- reading ---------------------------------------------------------------------


def read_survey(path):
    """
    Read the file of a survey.

    Parameters
    ----------
    path : path
        A TOML file: a table ``[sources.NAME]`` for each source with its
        ``epochs``, ``regions`` (a table of region files), ``scale_groups`` (a
        table of scales) and any setting of a measurement; and a table
        ``[defaults]`` with what holds where a source says nothing else.
        Paths are relative to the file.

    Returns
    -------
    Survey
        With ``sources``, for `run_survey`.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is no TOML, or a key or a value in it makes no sense.

    Examples
    --------
    >>> from pathlib import Path
    >>> from astro_scc.cli.sources import read_survey
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
        given = override(defaults, _known(values, where))
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


def _known(values, where):
    """Return the values of a table, all keys of which a survey has."""
    for name in _table(values, where):
        if name in ("regions", "scale_groups"):
            _table(values[name], f"{where}: {name}")
        elif name == "region" or "measure" not in OPTIONS.get(name, {}).get(
            "commands", ()
        ):
            raise ValueError(
                f"{where}: {name} is no setting of a survey; they are regions, "
                "scale_groups and those of astro-scc measure but region"
            )
    return values


def _source(name, folder, given, base):
    """Return a source of what its file gives; paths are relative to ``base``."""
    given = dict(given)
    regions = given.pop("regions", None) or {WHOLE: None}
    for label, file in regions.items():
        if file is not None and not (isinstance(file, str) and file):
            raise ValueError(f"regions.{label} must be the path of a region file")
    groups = {
        label: check_setting("scales", scales, f"scale_groups.{label}")
        for label, scales in (given.pop("scale_groups", None) or {WHOLE: None}).items()
    }
    if "redshift" not in given:
        given.pop("cosmology", None)
    if "scales" not in given and WHOLE not in groups:
        given["scales"] = _all_scales(list(groups.values()))
    settings = Settings(**given)
    if not settings.epochs:
        raise ValueError("has no epochs; name the FITS files")

    def absolute(path):
        return None if path is None else str(base / path)

    # What is special to patterns in the folder's own name is not meant so.
    escaped = glob.escape(str(base))
    align = settings.align
    settings = replace(
        settings,
        epochs=[str(Path(escaped, pattern)) for pattern in settings.epochs],
        align=align if align in ALIGNMENTS else absolute(align),
        crop=absolute(settings.crop),
    )
    regions = {label: absolute(file) for label, file in regions.items()}
    groups = {k: settings.scales if v is None else v for k, v in groups.items()}
    return Source(name, folder, settings, regions, groups)


def _all_scales(groups):
    if len({hasattr(group, "unit") for group in groups}) > 1:
        raise ValueError(
            "scale_groups must be all numbers or all angles, or give scales"
        )
    if hasattr(groups[0], "unit"):
        return np.unique(u.Quantity([angle for group in groups for angle in group]))
    return tuple(sorted({number for group in groups for number in group}))


def folder_names(names):
    """
    Return names of folders for any names, of one folder and all different.

    They have letters, digits and ``+ - _ .`` only, none at the beginning that hides or
    goes up, and at most 60 characters and a check sum.  A name that needs no change is
    its own; what had to be changed, looks like a check sum, or differs from another in
    upper and lower case only, ends in a check sum.
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


# -- the run ---------------------------------------------------------------------


def run_survey(
    survey, output, *, n_workers=1, report=False, done=None, progress_bar=False
):
    """
    Measure all sources of a survey and write one table.

    Parameters
    ----------
    survey : Survey
        See `read_survey`.
    output : path
        Folder of the products, on a cluster one that all workers see.  In a
        folder where this ran before, sources that are finished are not
        measured again.
    n_workers : int, str or `dask.distributed.Client`, optional
        Number of processes, or a Dask scheduler, by its address or a client of
        it; the unit of work is a source.  The numbers do not depend on it.
    report : bool, optional
        Write a report for each region and scale group.
    done : callable, optional
        Called with the name of each source that is done, a list with the
        status of each region and scale group, and whether it was finished before.
    progress_bar : bool, optional

    Returns
    -------
    `~astropy.table.QTable`
        A row for each source, region, scale group and component, with the
        columns of `~astro_scc.measurement.SCCResult.components` and ``p_fdr``,
        see `~astro_scc.measurement.false_discovery_rate`, over all that was
        searched; a row with masked numbers for each region and scale group
        without a component.  It is written to ``survey.ecsv``.

    Raises
    ------
    OSError
        If the folder has files of others, another run is at work in it, or it
        cannot be written to.

    Examples
    --------
    >>> from pathlib import Path
    >>> from astro_scc.cli.sources import read_survey, run_survey
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> simulate_two_fluid(n_epochs=5, rng=1).cube.write("jet.fits")
    >>> text = '''[sources.Jet]
    ... epochs = "jet.fits"
    ... scales = [2]
    ... max_speed = "30 mas/yr"
    ... n_trials = 20
    ... '''
    >>> _ = Path("survey.toml").write_text(text)
    >>> table = run_survey(read_survey("survey.toml"), "out")
    >>> set(table["source"].tolist()), set(table["status"].tolist())
    ({'Jet'}, {'measured'})
    """
    output = Path(output).absolute()
    work = output / WORK
    if output.is_dir() and any(output.iterdir()) and not (output / PLAN).is_file():
        raise OSError(f"{output}: exists and is not of a survey; choose another folder")
    try:
        (output / SOURCES).mkdir(parents=True, exist_ok=True)
        work.mkdir(exist_ok=True)
    except OSError as error:
        raise OSError(f"{output}: cannot be made or used: {error.strerror}") from None
    try:
        with hold(work):
            with replace_when_complete(output / PLAN, overwrite=True) as part:
                part.write_text(survey.text, encoding="utf-8")
            measure = partial(measure_source, output=output, report=report)
            try:
                found = _outcomes(
                    survey.sources, measure, n_workers, done, progress_bar
                )
            finally:
                # Of workers that were ended.
                remove_left(work, PARTIAL)
            table = _survey_table(found, output)
            with replace_when_complete(output / TABLE, overwrite=True) as part:
                table.write(part, format="ascii.ecsv")
    except BlockingIOError:
        raise OSError(
            f"{output}: another run measures a survey here; wait for it, or choose "
            "another folder"
        ) from None
    return table


def _outcomes(sources, measure, n_workers, done, progress_bar):
    """Return what became of each source, in their order."""
    found = {}
    with (
        workers_of(n_workers) as workers,
        progress(len(sources), "Sources", show=progress_bar) as step,
    ):

        def finish(k, outcomes, before):
            found[k] = outcomes
            step(1)
            if done is not None:
                done(sources[k].name, outcomes, before)

        for k, source in enumerate(sources):
            outcomes = finished_outcomes(source, **measure.keywords)
            if outcomes is not None:
                finish(k, outcomes, True)
        left = [k for k in range(len(sources)) if k not in found]
        for i, outcomes in as_done(measure, (sources[k] for k in left), workers):
            if isinstance(outcomes, Exception):
                # Of the worker, not of the measurement: it died, or its disk is full.
                outcomes = _failed(sources[left[i]], outcomes)
            finish(left[i], outcomes, False)
    return [outcome for k in range(len(sources)) for outcome in found[k]]


def finished_outcomes(source, output, report):
    """Return the outcomes of a source that is finished, by its products, or None."""
    path = Path(output, SOURCES, source.folder, STATE)
    try:
        state = json.loads(path.read_text(encoding="utf-8"))
        if state["key"] != source.key():
            return None
        found = [Outcome(**outcome) for outcome in state["outcomes"]]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    needed = ["components.ecsv", "report.html"][: 1 + report]
    there = all(
        outcome.status != "failed" and Path(output, outcome.folder, name).is_file()
        for outcome in found
        for name in needed
    )
    return found if there else None


# -- one source ------------------------------------------------------------------


def measure_source(source, output, report=False):
    """
    Measure a source in all its regions and scale groups, and never fail.

    SSPs are correlated once, in all regions and on all scales together; each region and
    scale group is a stack of its own.  The folder of the source is replaced as a whole
    when all is written.  What goes wrong is the message of an outcome; the place of the
    program that raised it stands in ``error.txt`` of the folder.

    Parameters
    ----------
    source : Source
    output : path
        Folder of the survey.
    report : bool, optional

    Returns
    -------
    list of Outcome
        One for each region and scale group.
    """
    output, key = Path(output), source.key()
    (output / WORK).mkdir(exist_ok=True)
    with (
        partial_folder(output / WORK, PARTIAL) as part,
        warnings.catch_warnings(record=True) as said,
    ):
        warnings.simplefilter("always")
        try:
            outcomes = _measure(source, output, part, report, said)
        except Exception as error:
            _note_error(part)
            outcomes = _failed(source, error)
        state = {
            "key": key,
            "source": source.name,
            "outcomes": [asdict(outcome) for outcome in outcomes],
            "warnings": _lines(said),
        }
        (part / STATE).write_text(json.dumps(state, indent=1) + "\n", encoding="utf-8")
        final = output / SOURCES / source.folder
        final.parent.mkdir(exist_ok=True)
        with partial_folder(output / WORK, PARTIAL) as old:
            if final.exists():
                os.replace(final, old / "old")
            os.replace(part, final)
    return outcomes


def _measure(source, output, part, report, said):
    """Match a source and measure its parts."""
    cube, settings, left_out = read_epochs(source.settings)
    scc = StackedCrossCorrelation.from_settings(settings)
    masks, failed = {}, {}
    for name, path in source.regions.items():
        try:
            if path is not None and settings.crop is not None:
                refuse_pixels(path)
            masks[name] = None if path is None else cube.region_mask(path)
        except (ValueError, OSError) as error:
            failed[name] = _reason(error)
    if masks:
        inside = list(masks.values())
        matched = scc.match(
            cube,
            region=None if inside[0] is None else np.any(inside, axis=0),
            cache=output / WORK / f"{source.folder}.fits",
        )
    regions = folder_names(list(source.regions))
    groups = folder_names(list(source.scale_groups))
    of_all, outcomes = len(said), []
    for region, group in source.parts:
        outcome = Outcome(source.name, region, group, "failed", failed.get(region, ""))
        if region in masks:
            where = Path(SOURCES, source.folder, regions[region], groups[group])
            folder = part / regions[region] / groups[group]
            own = {"region": source.regions[region]}
            own = replace(settings, scales=source.scale_groups[group], **own)
            folder.mkdir(parents=True)
            before = len(said)
            names = [name for name in (region, group) if name != WHOLE]
            try:
                result = _stack(matched, masks[region], own)
                components = write_measurement(
                    result,
                    own,
                    folder,
                    output=output / where,
                    report=report,
                    title=", ".join([source.name, *names]),
                    warnings=_lines([*said[:of_all], *said[before:]]),
                    left_out=left_out,
                )
            except Exception as error:
                shutil.rmtree(folder)
                _note_error(part, f"{region}, {group}:\n")
                outcome = replace(outcome, message=_reason(error))
            else:
                found = _found(result, components)
                outcome = replace(outcome, folder=where.as_posix(), **found)
        outcomes.append(outcome)
    return outcomes


def _stack(matched, inside, settings):
    """Measure one region and scale group."""
    scc = StackedCrossCorrelation.from_settings(settings)
    part = select_ssps(matched, region=inside, scales=scc.scales)
    return scc.stack(part, n_trials=settings.n_trials, rng=settings.seed)


def _found(result, components):
    """Return the status of what was measured, and the reason if it is empty."""
    if len(components):
        return {"status": "measured", "message": ""}
    searched = result.matched.select.any()
    message = "match that could be tested"
    if not searched:
        message = "significant pattern here on these scales"
    return {"status": "empty", "message": f"no {message}"}


def _failed(source, error):
    """Return the outcomes of a source that failed as a whole."""
    reason = _reason(error)
    return [Outcome(source.name, *names, "failed", reason) for names in source.parts]


def _reason(error):
    """Return an error in one line, with its class unless the text is for users."""
    known = isinstance(error, ValueError | OSError | Warning) and str(error)
    return one_line(error) if known else f"{type(error).__name__}: {one_line(error)}"


def _note_error(folder, head=""):
    with open(folder / "error.txt", "a", encoding="utf-8") as file:
        file.write(f"{head}{traceback.format_exc()}\n")


def _lines(said):
    """Return warnings that were recorded, each once."""
    return sorted({one_line(warning.message) for warning in said})


# -- the table -------------------------------------------------------------------


def _survey_table(outcomes, output):
    """Return the components of all sources as one table, see `run_survey`."""
    tables = {
        outcome: QTable.read(
            Path(output, outcome.folder, "components.ecsv"), format="ascii.ecsv"
        )
        for outcome in outcomes
        if outcome.folder
    }
    adjusted = false_discovery_rate(tables)
    empty, *_ = false_discovery_rate([component_table([])])
    if any("beta_app" in table.colnames for table in adjusted.values()):
        for name in ("beta_app", "beta_app_err"):
            empty[name] = [] * u.one
    rows = [_with_head(empty, None)]
    for outcome in outcomes:
        own = adjusted.get(outcome, ())
        rows.append(_with_head(own if len(own) else None, outcome))
    table = vstack(rows, metadata_conflicts="silent")
    table.meta.clear()
    table.meta["versions"] = versions()
    searched = sum(max(len(own), 1) for own in adjusted.values())
    table.meta["false_discovery"] = {"method": "bh", "n_tests": searched}
    # A source has one redshift and cosmology, or one distance, in all its parts.
    how = ("redshift", "cosmology", "distance")
    table.meta["speeds_in_c"] = {
        outcome.source: {name: own.meta[name] for name in how if name in own.meta}
        for outcome, own in tables.items()
        if "beta_app" in own.colnames
    }
    return table


def _with_head(components, outcome):
    """Return components, or one row without any, behind what they are of."""
    n = 1 if components is None else len(components)
    table = QTable()
    for name, description in HEAD.items():
        values = [] if outcome is None else [getattr(outcome, name)] * n
        table[name] = Column(
            values, dtype=None if values else "U1", description=description
        )
    for name in () if components is None else components.colnames:
        table[name] = components[name]
    return table
