# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""One source of a survey: measured, its products written, never an error."""

import json
import os
import secrets
import shutil
import traceback
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from astro_scc.config import (
    distance_of,
    format_config,
    plain_settings,
    read_epochs,
    settings_as_used,
)
from astro_scc.epochs.cutout import refuse_pixels
from astro_scc.measurement import select_ssps, versions, write_products
from astro_scc.scc import StackedCrossCorrelation
from astro_scc.survey.names import folder_names
from astro_scc.survey.plan import SEED, WHOLE, Source

__all__ = ["Job", "Outcome", "finished_outcomes", "measure_source", "one_line"]

#: Folders of a survey.
SOURCES, WORK = "sources", ".astro_scc-work"
STATE = "source.json"
REMARKS = (
    "What determined this measurement of a survey.  To do it again by itself:",
    "astro-scc measure --config FILE -o FOLDER",
)


@dataclass(frozen=True)
class Outcome:
    """
    What became of one region and scale group of a source.

    Attributes
    ----------
    source, region, scale_group : str
    status : {"measured", "empty", "failed"}
        Empty is what was searched without anything that could be tested.
    message : str
        The reason, of what is not measured.
    folder : str
        Of its products, in that of the survey; empty if there are none.

    Examples
    --------
    >>> from astro_scc.survey import Outcome
    >>> Outcome("M87", "inner", "fine", "failed", "no two epochs make a pair").status
    'failed'
    """

    source: str
    region: str
    scale_group: str
    status: str
    message: str = ""
    folder: str = ""


@dataclass(frozen=True)
class Job:
    """
    A source to measure, as a piece of work.

    Attributes
    ----------
    source : `Source`
    output : str
        Folder of the survey.
    write_report : callable, optional
        See `run_survey`.
    """

    source: Source
    output: str
    write_report: Callable | None = None


def finished_outcomes(job):
    """
    The outcomes of a source that was measured before.

    Parameters
    ----------
    job : `Job`

    Returns
    -------
    list of `Outcome`, or None
        None if it was not, or not all of it, or otherwise.
    """
    path = Path(job.output, SOURCES, job.source.folder, STATE)
    try:
        state = json.loads(path.read_text(encoding="utf-8"))
        if state["key"] != job.source.key():
            return None
        found = [Outcome(**outcome) for outcome in state["outcomes"]]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    needed = ["components.ecsv"] + ["report.html"] * (job.write_report is not None)
    done = all(
        outcome.status != "failed"
        and all(Path(job.output, outcome.folder, name).is_file() for name in needed)
        for outcome in found
    )
    return found if done else None


def measure_source(job):
    """
    Measure a source in all its regions and scale groups.

    Parameters
    ----------
    job : `Job`

    Returns
    -------
    list of `Outcome`
        One for each region and scale group.  What goes wrong is their
        message; the place of the program that raised it stands in
        ``error.txt`` of the source's folder.

    Notes
    -----
    SSPs are correlated once, in all regions and on all scales together; each
    region and scale group is a stack of its own.  The folder of the source is
    replaced as a whole when all is written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.survey import measure_source
    >>> from astro_scc.survey import read_survey
    >>> from astro_scc.survey.source import Job
    >>> simulate_two_fluid(n_epochs=5, rng=1).cube.write("jet.fits")
    >>> text = '''[sources.Jet]
    ... epochs = "jet.fits"
    ... scales = [2]
    ... max_speed = "30 mas/yr"
    ... n_trials = 20
    ... '''
    >>> _ = Path("survey.toml").write_text(text)
    >>> survey = read_survey("survey.toml")
    >>> Path("out").mkdir()
    >>> [outcome.status for outcome in measure_source(Job(survey.sources[0], "out"))]
    ['measured']
    """
    source, output = job.source, Path(job.output)
    final = output / SOURCES / source.folder
    part = output / WORK / f"partial-{source.folder}-{secrets.token_hex(4)}"
    key = source.key()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        part.mkdir(parents=True)
        try:
            outcomes = _measure(job, part, said)
        except Exception as error:
            (part / "error.txt").write_text(traceback.format_exc(), encoding="utf-8")
            outcomes = [
                Outcome(source.name, *names, "failed", one_line(error))
                for names in source.parts
            ]
    state = {
        "key": key,
        "source": source.name,
        "outcomes": [asdict(outcome) for outcome in outcomes],
        "warnings": _lines(said),
    }
    (part / STATE).write_text(json.dumps(state, indent=1) + "\n", encoding="utf-8")
    _replace(part, final)
    return outcomes


def one_line(error):
    """
    An error or a warning as one line.

    Parameters
    ----------
    error : Exception

    Returns
    -------
    str
        With the name of its class, unless the text says enough.
    """
    text = str(error)
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        text = f"{error.filename}: {error.strerror}"
    kinds = (ValueError, OSError, Warning)
    name = "" if isinstance(error, kinds) and text else f"{type(error).__name__}: "
    return " ".join(f"{name}{text}".split())


def _replace(part, final):
    final.parent.mkdir(exist_ok=True)
    old = part.with_name(part.name.replace("partial-", "old-", 1))
    if final.exists():
        os.rename(final, old)
    os.rename(part, final)
    shutil.rmtree(old, ignore_errors=True)


def _measure(job, part, said):
    source, output = job.source, Path(job.output)
    cube, config, left_out = read_epochs(source.config)
    scc = StackedCrossCorrelation.from_settings(config)
    used = settings_as_used(scc, config, seed=SEED)
    masks, failed = {}, {}
    for name, path in source.regions.items():
        try:
            if path is not None and "crop" in source.config:
                refuse_pixels(path)
            masks[name] = None if path is None else cube.region_mask(path)
        except (ValueError, OSError) as error:
            failed[name] = one_line(error)
    matched = None
    if masks:
        matched = scc.match(
            cube,
            region=_together(list(masks.values())),
            cache=output / WORK / f"{source.folder}.fits",
        )
    regions = folder_names(list(source.regions))
    groups = folder_names(list(source.scale_groups))
    of_all = len(said)
    outcomes = []
    for region, group in source.parts:
        outcome = Outcome(source.name, region, group, "failed", failed.get(region, ""))
        if region in masks:
            folder = Path(regions[region], groups[group])
            where = Path(SOURCES, source.folder, folder)
            (part / folder).mkdir(parents=True)
            own = {
                **used,
                "region": source.regions[region],
                "scales": source.scale_groups[group] or used["scales"],
            }
            own = {k: v for k, v in own.items() if v is not None}
            before = len(said)
            try:
                result, components = _stack(scc, matched, masks[region], own)
                text = _write(result, components, part / folder, own)
                if job.write_report is not None:
                    job.write_report(
                        result,
                        components,
                        part / folder,
                        title=_title(source, region, group),
                        warnings=_lines([*said[:of_all], *said[before:]]),
                        left_out=left_out,
                        rerun="astro-scc measure --config "
                        f"{output / where / 'config.toml'} -o FOLDER",
                        config_text=text,
                    )
            except Exception as error:
                shutil.rmtree(part / folder)
                with open(part / "error.txt", "a", encoding="utf-8") as file:
                    file.write(f"{region}, {group}:\n{traceback.format_exc()}\n")
                outcome = replace(outcome, message=one_line(error))
            else:
                status, message = _found(result, components)
                outcome = replace(
                    outcome, status=status, message=message, folder=where.as_posix()
                )
        outcomes.append(outcome)
    return outcomes


def _lines(said):
    """Warnings that were recorded, each once."""
    return sorted({one_line(warning.message) for warning in said})


def _together(masks):
    if any(mask is None for mask in masks):
        return None
    inside = masks[0].copy()
    for mask in masks[1:]:
        inside |= mask
    return inside


def _stack(scc, matched, inside, config):
    """Measure one region and scale group; the result and its components."""
    scales = config["scales"]
    part = select_ssps(matched, region=inside, scales=scales)
    result = replace(scc, scales=scales).stack(
        part, n_trials=config["n_trials"], rng=config["seed"]
    )
    how = distance_of(config)
    return result, result.components_in_c(**how) if how else result.components


def _write(result, components, folder, config):
    """Write the products; the configuration as text."""
    text = format_config(config, versions=versions(), remarks=REMARKS)
    write_products(
        result, components, folder, configuration=plain_settings(config), text=text
    )
    return text


def _found(result, components):
    """The status of what was measured, and the reason if it is empty."""
    if len(components):
        return "measured", ""
    if not result.matched.select.any():
        return "empty", "no significant pattern here on these scales"
    return "empty", "no match that could be tested"


def _title(source, region, group):
    """Of a report."""
    parts = [name for name in (region, group) if name != WHOLE]
    return ", ".join([source.name, *parts])
