# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Inputs of a command: settings from the command line and files, and epochs."""

import os
import re
import secrets
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import astropy.units as u
import numpy as np
from astropy.table import QTable

from astro_scc import plan
from astro_scc.epochs import EpochCube
from astro_scc.epochs.inspection import repeated
from astro_scc.exceptions import naming_all, warn
from astro_scc.grid import default_scales
from astro_scc.images import fits, regions
from astro_scc.images.beam import different_beam, parse_beam
from astro_scc.kinematics.cosmology import table_in_c
from astro_scc.products.publication import published_positions
from astro_scc.quantities import named, one_quantity, to_time
from astro_scc.settings import OPTIONS, Settings, read_config
from astro_scc.streams.finder import FEWEST_EPOCHS
from astro_scc.writing import versions

#: The survey whose tables are cited, and in how many bytes of a table its name stands.
SURVEY, HEAD = b"MOJAVE", 4000
#: Notes on ``common_beam``, as given, and whether beams differ, None without any.
NOTES = {
    (None, None): "the epochs have no beams: three pixels count as one (--beam)",
    (None, True): "the beams differ: convolving to a common one (--no-common-beam)",
    (False, True): "the beams differ and are left so, as --no-common-beam states",
}


class Inputs(NamedTuple):
    """
    Epochs as they are measured, and the settings with what was decided on the way.

    ``left_out`` has epochs that are not in the cube, and the reasons; ``chosen`` the
    choices that the images have made, each with its reason, as lines; ``published`` the
    features to compare with, if any.
    """

    cube: Any
    settings: Settings
    left_out: list
    chosen: list
    n_workers: Any = 1
    published: Any = None

    @property
    def found(self):
        """Lines on the choices for a summary."""
        return [f"Found in the images: {line}" for line in self.chosen]


def draw_seed(seed=None):
    """Return the seed, or a random one that is short enough to be typed."""
    return secrets.randbelow(2**31) if seed is None else seed


def workers_of(args, cube=None, *, large=3e6):
    """
    Return the workers that were named, or one process per core for a large cube.

    From so many pixels on, more processes save more time than they take to start: some
    ten seconds of one.
    """
    if args.workers is not None and args.workers < 1:
        raise ValueError(f"--workers must be at least 1, got {args.workers}")
    if args.scheduler is not None:
        return args.scheduler
    if args.workers is None and cube is not None and cube.data.size >= large:
        # The cores that this process may use, where the system tells.
        with suppress(AttributeError):
            return len(os.sched_getaffinity(0))
        return os.cpu_count() or 1
    return args.workers or 1


def override(given, others):
    """Return settings updated by others; distance and redshift replace each other."""
    replaced = {"distance": ("redshift", "cosmology"), "redshift": ("distance",)}
    out = next((names for name, names in replaced.items() if name in others), ())
    return {name: value for name, value in given.items() if name not in out} | others


def settings_of(args, reporter, **defaults):
    """
    Return the settings of the configuration file, overridden by the command line.

    Parameters
    ----------
    args : `argparse.Namespace`
    reporter : `~astro_scc.cli.program.Reporter`
    **defaults
        Defaults of the command.

    Returns
    -------
    `~astro_scc.settings.Settings`

    Raises
    ------
    ValueError
        If a setting is invalid, settings contradict each other, there are no epochs,
        or ``--workers`` is wrong.
    """
    given, written_by = read_config(args.config) if args.config else ({}, {})
    now = versions()
    other = {k: v for k, v in written_by.items() if now.get(k) != v}.items()
    other = ", ".join(f"{k} {v} (here {now.get(k, 'none')})" for k, v in other)
    if other:
        reporter.note(f"{args.config} was written with {other}: numbers may differ")
    every = vars(args).items()
    typed = {k: v for k, v in every if k in OPTIONS and v not in (None, [])}
    try:
        settings = Settings(**defaults | override(given, typed))
    except ValueError as error:
        if getattr(error, "setting", None) in given.keys() - typed.keys():
            raise ValueError(f"{args.config}: {error}") from None
        raise
    if not settings.epochs:
        raise ValueError("no epochs were given; name the FITS files, or a --config")
    # Refused before the images are read.
    workers_of(args)
    return settings


def read_epochs(settings, args=None, *, note=None, features=False, moving=False):
    """
    Read the epochs of a measurement.

    Parameters
    ----------
    settings : `~astro_scc.settings.Settings`
    args : `argparse.Namespace`, optional
        Name the workers, and published features.
    note : callable, optional
        Called with a line of text on beams.
    features : bool, optional
        See `prepare`.
    moving : bool, optional
        Whether it shall be shown that something moves, which needs six epochs.

    Returns
    -------
    `Inputs`
        The epochs, aligned, with a common beam if that is wanted; the settings with
        the files, the steps that were taken, and a seed.

    Raises
    ------
    OSError, ValueError
        If the files cannot be read, or do not make one cube.
    """
    files = fits.find_files(settings.epochs)
    frame = "absolute" if settings.align == "wcs" else "offset"
    if settings.region is not None:
        regions.refuse_pixels(settings.region, settings.crop is not None)
    beam = settings.beam and parse_beam(settings.beam)
    cube = EpochCube.read(files, frame=frame, region=settings.crop, beams=beam)
    if settings.region is not None:
        regions.refuse_pixels(settings.region, False, cube)
    for said in repeated(cube):
        warn(said)
    cube, left_out = select_epochs(cube, settings.after, settings.before)
    if moving:
        require_epochs(cube)
    cube, found, chosen = prepare(cube, settings, note=note, features=features)
    found |= {"epochs": [*map(str, files)], "seed": draw_seed(settings.seed)}
    settings = settings.changed(**found)
    n_workers = 1 if args is None else workers_of(args, cube)
    published = published_of(getattr(args, "compare", None), cube)
    return Inputs(cube, settings, left_out, chosen, n_workers, published)


def published_of(path, cube):
    """Return published features to compare with, which say of which survey they are."""
    if path is None:
        return None
    published = published_positions(path, cube)
    published.meta["survey"] = table_name(path)
    return published


def table_name(path):
    """Return the name of a table, and that of the survey if its head says it."""
    path = Path(path)
    # Tables of the CDS are described beside them.
    heads = [path, path.with_name("ReadMe")] if path.suffix == ".dat" else [path]
    texts = [each.read_bytes()[:HEAD] for each in heads if each.is_file()]
    survey = f" ({SURVEY.decode()})" if any(SURVEY in text for text in texts) else ""
    return f"{path.name}{survey}"


def refuse_paper(settings):
    """Refuse the paper's method where only the velocity spectrum is measured."""
    if settings.method != "spectrum":
        raise ValueError(
            f"method is {settings.method!r}, which astro-scc measure has: leave it out"
        )


def with_speeds_in_c(table, settings):
    """Return a table with speeds in units of c, if the settings have a distance."""
    return table_in_c(table, **settings.in_c) if settings.in_c else table


def require_epochs(cube):
    """Refuse so few epochs that nothing could be shown to move."""
    n = len(cube)
    if n < FEWEST_EPOCHS:
        raise ValueError(
            f"too few epochs: {n} image{'' if n == 1 else 's'}, {FEWEST_EPOCHS} are "
            "needed to show that anything moves (a file that is given twice counts "
            "once); astro-scc track follows features in four or more"
        )


def prepare(cube, settings, *, note=None, features=False):
    """
    Convolve and align epochs, and choose by them the settings that are not given.

    Parameters
    ----------
    cube : `~astro_scc.EpochCube`
    settings : `~astro_scc.settings.Settings`
    note : callable, optional
        Called with a line of text on beams.
    features : bool, optional
        Whether only features are followed, which needs no scales and no direction.

    Returns
    -------
    cube : `~astro_scc.EpochCube`
    found : dict
        The settings that were chosen.
    chosen : list of str
        The choices and their reasons.
    """
    wanted, differ = settings.common_beam, different_beam(cube.beams) is not None
    said = NOTES.get((wanted, None if cube.beams is None else differ))
    if said and note:
        note(said)
    chosen, found = [], {"common_beam": differ if wanted is None else wanted}
    if found["common_beam"]:
        cube = cube.to_common_beam()
    if settings.align is None:
        found["align"], reason = plan.choose_alignment(cube)
        chosen.append(f"--align {found['align']}: {reason}")
    cube = _aligned(cube, found.get("align", settings.align))
    if features:
        return cube, found, chosen
    if settings.scales is None and settings.method == "paper":
        found["scales"], reason = plan.choose_scales(cube)
        chosen.append(f"--scales {','.join(map(str, found['scales']))}: {reason}")
    elif settings.scales is None and not settings.scale_groups:
        pixels = plan.flow_beam(cube) / cube.pixel_scale.to_value(u.mas)
        scales = ",".join(map(str, default_scales(pixels)))
        chosen.append(f"speeds from scales {scales}: the largest up to 0.55 beams")
    if settings.position_angle is None:
        angle, reason = plan.choose_direction(cube)
        found["position_angle"] = "any" if angle is None else "fit"
        shown = "any:" if angle is None else f"fit: {angle:g},"
        chosen.append(f"--position-angle {shown} {reason}")
    return cube, found, chosen


def _aligned(cube, align):
    """Return the epochs aligned; the jet may have a direction, as in "core 270 deg"."""
    method, _, angle = align.partition(" ")
    if method != "core" or not angle or Path(align).is_file():
        return cube.align(align)
    kind = "a position angle", "270 deg", False
    return cube.align("core", jet_pa=named("--align core", one_quantity, angle, *kind))


def select_epochs(cube, after=None, before=None):
    """Return the epochs between two dates, and the other ones with the reasons."""
    # Very old or future dates are kept in atomic time, so compare in it.
    times, why = cube.times.tai, np.full(len(cube), "", dtype=object)
    if after is not None:
        why[times < to_time(after)] = f"before {after}"
    if before is not None:
        why[times >= to_time(before)] = f"not before {before}"
    if np.all(why != ""):
        first, last = cube.times.isot[[0, -1]]
        raise ValueError(
            f"no epoch is left between --after and --before; they are of {first[:10]} "
            f"to {last[:10]}"
        )
    left_out = [(cube.labels[i], why[i]) for i in np.flatnonzero(why)]
    return (cube[why == ""] if left_out else cube), left_out


def output_of(args, settings):
    """Return the folder for the products, by default named after the object."""
    if args.output is not None:
        return Path(args.output)
    first, name = fits.find_files(settings.epochs)[0], ""
    # What cannot be read is refused where the epochs are.
    with suppress(Exception):
        name = fits.read_plane(first, load=False).facts.get("object", "").strip()
    name = re.sub(r"[^\w.+-]+", "_", name) or first.resolve().parent.name
    return Path(f"{name}-{args.command}")


def refuse_others(folder, settings, *kept):
    """Refuse a folder whose tables would be kept, if they are of other images."""
    kept = [name for name in kept if (folder / name).exists()]
    theirs = None
    # A file that cannot be read says nothing.
    with suppress(OSError, ValueError):
        theirs = read_config(folder / "config.toml")[0].get("epochs")
    if not (kept and theirs):
        return
    of_both = (
        {path.resolve() for path in fits.find_files(names, missing_ok=True)}
        for names in (settings.epochs, theirs)
    )
    if len({*map(frozenset, of_both)}) > 1:
        what = f"holds {kept[0]} of other images"
        raise OSError(f"{folder}: {what}; choose another folder, or remove this one")


def read_table(path, advice="", name=None):
    """Return an ECSV table, from a file or lines; what is wrong with it is one line."""
    if name is None and not path.exists():
        raise OSError(f"{path}: does not exist{advice}")
    with naming_all(f"{name or path}: is no ECSV table"):
        return QTable.read(path, format="ascii.ecsv")
