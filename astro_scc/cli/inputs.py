# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Inputs of a command: settings from the command line and files, and epochs."""

import os
import re
import secrets
from contextlib import suppress
from dataclasses import replace

from astro_scc.cli.options import option_name
from astro_scc.settings import OPTIONS, Settings, check_setting, read_config

#: Pixels of all epochs from which on more processes save more time than they take to
#: start: some ten seconds of one.
WORTH_PROCESSES = 3e6
#: Seconds of a run from which on it says beforehand how long it will take.
LONG = 300.0
#: More processes are advised if a run takes less than this part of the time with them.
WORTH_IT = 0.8
#: What shortens the matching, on any number of processes.
LESS = "a --region, a --crop or fewer --scales shorten it"
#: Seconds of one core for the figures of a report, and to read an image.
REPORT, READ = 7.0, 0.03


def draw_seed(seed=None):
    """Return the seed, or a random one that is short enough to be typed."""
    return secrets.randbelow(2**31) if seed is None else seed


def workers_of(args):
    """Return the workers that ``--workers`` or ``--scheduler`` name, or None."""
    if args.workers is not None and args.workers < 1:
        raise ValueError(f"--workers must be at least 1, got {args.workers}")
    return args.workers if args.scheduler is None else args.scheduler


def workers_for(cube, workers=None):
    """Return the workers that were named, or one process per core for a large cube."""
    if workers is not None:
        return workers
    return 1 if cube.data.size < WORTH_PROCESSES else _n_cores()


def _n_cores():
    """Return the number of cores that this process may use."""
    with suppress(AttributeError):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def measuring_time(cube, settings, *, n_bins=0):
    """
    Estimate how long a measurement takes on one core, within a factor of two.

    Parameters
    ----------
    cube : `~astro_scc.EpochCube`
    settings : `~astro_scc.settings.Settings`
    n_bins : int, optional
        Bins of distance that are stacked besides the whole.

    Returns
    -------
    shared, alone : float
        Seconds of what several processes share, and of the rest.
    n_ssps : float
        Estimated number of SSPs.
    """
    from astro_scc import StackedCrossCorrelation
    from astro_scc.measurement.decomposing import matching_time
    from astro_scc.measurement.stacking import stacking_time
    from astro_scc.stacking import SearchSettings

    scc = StackedCrossCorrelation.from_settings(settings)
    decomposer, region = scc.decomposer(cube), settings.region
    shared, n_ssps = matching_time(cube, decomposer, scc.reach(cube), region=region)
    known = settings.position_angle not in (None, "any")
    n_axes = 1 if known else SearchSettings().n_axes
    # A bin has a part of the matches.
    stacks = 1 + n_bins / 2
    alone = stacks * stacking_time(len(cube), settings.n_trials, n_axes)
    return shared, alone + REPORT + READ * len(cube), n_ssps


def tell_time(reporter, cube, settings, n_workers, *, n_bins=0):
    """
    Say how long a measurement will take, if that is over five minutes.

    Parameters
    ----------
    reporter : `~astro_scc.cli.reporter.Reporter`
    cube, settings, n_bins
        See `measuring_time`.
    n_workers : int or object
        On a cluster, whose processes are not known, nothing is said.
    """
    if reporter.quiet or not isinstance(n_workers, int):
        return
    shared, alone, n_ssps = measuring_time(cube, settings, n_bins=n_bins)
    n, ny, nx = cube.shape
    what = f"{n} epochs of {nx} x {ny} pixels with about {rounded(n_ssps)} patterns"
    say_time(reporter, n_workers, shared, alone, what)


def say_time(reporter, n_workers, shared, alone, what, *, less=LESS, most=None):
    """
    Say that a run will take long, and what shortens it.

    Parameters
    ----------
    reporter : `~astro_scc.cli.reporter.Reporter`
    n_workers : int
    shared, alone : float
        Seconds of what several processes share, and of the rest, on one core.
    what : str
        What takes so long.
    less : str, optional
        What shortens the shared part besides processes.
    most : int, optional
        Most processes that can share it.
    """
    n_cores = min(_n_cores(), most or _n_cores())
    seconds = shared / min(n_workers, n_cores) + alone
    if seconds <= LONG:
        return
    least = shared / n_cores + alone
    advice = less if shared / n_cores > alone else "fewer --n-trials shorten it"
    if n_workers < n_cores and least < WORTH_IT * seconds:
        advice = f"--workers {n_cores} shortens it to {_duration(least)}"
    reporter.note(f"this will take about {_duration(seconds)} ({what}); {advice}")


def rounded(number):
    """Return a number rounded to two digits, as text."""
    return f"{float(f'{number:.2g}'):.0f}"


def _duration(seconds):
    """Return a time with two digits."""
    for unit, size in (("d", 86400), ("h", 3600)):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds / 60:.2g} min"


def option_of(args, name):
    """Return the value of one option that is a setting, or None."""
    return check_setting(name, getattr(args, name), option_name(name))


def override(given, own):
    """Return settings updated by others; distance and redshift replace each other."""
    if "distance" in own:
        given = {k: v for k, v in given.items() if k not in ("redshift", "cosmology")}
    elif "redshift" in own:
        given = {k: v for k, v in given.items() if k != "distance"}
    return given | own


def settings_of(args, reporter, *, unused=(), **defaults):
    """
    Return the settings of the configuration file, overridden by the command line.

    Parameters
    ----------
    args : `argparse.Namespace`
    reporter : `~astro_scc.cli.reporter.Reporter`
    unused : sequence of str, optional
        Settings of the file that the command does not use.
    **defaults
        Defaults of the command.

    Returns
    -------
    `~astro_scc.settings.Settings`

    Raises
    ------
    ValueError
        If a setting is invalid, settings contradict each other, or there are no
        epochs.
    """
    given = {}
    if args.config:
        given, written_by = read_config(args.config)
        _compare_versions(written_by, args.config, reporter)
    given = {name: value for name, value in given.items() if name not in unused}
    own = {
        name: value
        for name in OPTIONS
        if (value := getattr(args, name, None)) not in (None, [])
    }
    try:
        settings = Settings(**defaults | override(given, own))
    except ValueError as error:
        if (name := getattr(error, "setting", None)) not in own:
            raise
        # The message names the option as it is typed.
        text = str(error).replace(f"{name} =", option_name(name), 1)
        raise ValueError(text) from None
    if not settings.epochs:
        raise ValueError("no epochs were given; name the FITS files, or a --config")
    return settings


def _compare_versions(written_by, file, reporter):
    from astro_scc.measurement import versions

    now = versions()
    other = [
        f"{name} {version} (here {now.get(name, 'none')})"
        for name, version in written_by.items()
        if now.get(name) != version
    ]
    if other:
        reporter.note(f"{file} was written with {', '.join(other)}: numbers may differ")


def _ignore(text):
    """Tell nobody."""


def read_epochs(settings, *, files=None, note=_ignore, chosen=_ignore):
    """
    Read the epochs of a measurement.

    Parameters
    ----------
    settings : `~astro_scc.settings.Settings`
    files : list of path, optional
        Present paths of the epochs, if they will be moved.
    note : callable, optional
        Called with a line of text on every decision.
    chosen : callable, optional
        Called with each choice that the images have made and its reason.

    Returns
    -------
    cube : `~astro_scc.EpochCube`
        The epochs, aligned, with a common beam if that is wanted.
    settings : `~astro_scc.settings.Settings`
        The settings with the files, the steps that were taken, and a seed.
    left_out : list of (str, str)
        Epochs that are not in the cube, and the reasons.

    Raises
    ------
    OSError, ValueError
        If the files cannot be read, or do not make one cube.
    """
    from astro_scc.epochs import EpochCube
    from astro_scc.epochs.cutout import refuse_pixels
    from astro_scc.epochs.fits import find_files
    from astro_scc.measurement.choices import choose_alignment

    if files is None:
        files = find_files(settings.epochs)
        settings = replace(settings, epochs=[str(path) for path in files])
    frame = "absolute" if settings.align == "wcs" else "offset"
    if settings.crop is not None and settings.region is not None:
        refuse_pixels(settings.region)
    cube = EpochCube.read(files, frame=frame, region=settings.crop)
    cube, left_out = select_epochs(cube, settings.after, settings.before)
    common = _wants_common_beam(cube, settings.common_beam, note)
    if common:
        cube = cube.to_common_beam()
    align = settings.align
    if align is None:
        align, reason = choose_alignment(cube)
        chosen(f"--align {align}: {reason}")
    seed = draw_seed(settings.seed)
    cube = cube.align(align)
    settings = with_scales(cube, settings, chosen=chosen)
    settings = replace(settings, align=align, common_beam=common, seed=seed)
    return cube, settings, left_out


def with_scales(cube, settings, *, chosen=_ignore):
    """Return the settings with the scales that suit the images."""
    if settings.scales is not None:
        return settings
    from astro_scc.measurement.choices import choose_scales

    scales, reason = choose_scales(cube)
    chosen(f"--scales {','.join(map(str, scales))}: {reason}")
    return replace(settings, scales=scales)


def with_direction(cube, settings, *, chosen=_ignore):
    """Return the settings with the direction of the jet, if its images show one."""
    if settings.position_angle is not None:
        return settings
    from astro_scc.measurement.choices import choose_direction

    angle, reason = choose_direction(cube)
    found = "any" if angle is None else f'"{angle:g}"'
    chosen(f"--position-angle {found}: {reason}")
    return replace(settings, position_angle="any" if angle is None else angle)


def output_of(args, settings):
    """Return the folder for the products, by default named after the object."""
    if args.output is not None:
        return args.output
    from astropy.io import fits

    from astro_scc.epochs.fits import find_files

    first = find_files(settings.epochs)[0]
    name = ""
    # What cannot be read is refused where the epochs are.
    with suppress(Exception):
        name = str(fits.getval(first, "OBJECT")).strip()
    name = re.sub(r"[^\w.+-]+", "_", name) or first.resolve().parent.name
    return f"{name}-{args.command}"


def _wants_common_beam(cube, wanted, note):
    """Return whether to convolve to a common beam, and note what is decided."""
    from astro_scc.epochs.beam import different_beam

    differ = different_beam(cube) is not None
    if wanted is False and differ:
        note("the beams differ and are left so, as --no-common-beam states")
    if wanted is not None:
        return wanted
    if cube.beams is None:
        note("the epochs have no beams and are left as they are")
    elif differ:
        note("the beams differ: convolving to a common one (--no-common-beam)")
    return differ


def select_epochs(cube, after=None, before=None):
    """Return the epochs between two dates, and the other ones with the reasons."""
    from astro_scc.quantities import to_time

    left_out = {}
    # Very old or future dates are kept in atomic time, so compare in it.
    for i, time in enumerate(cube.times.tai):
        if after is not None and time < to_time(after):
            left_out[i] = f"before {after}"
        if before is not None and time >= to_time(before):
            left_out[i] = f"not before {before}"
    if not left_out:
        return cube, []
    if len(left_out) == len(cube):
        first, last = cube.times.isot[[0, -1]]
        raise ValueError(
            f"no epoch is left between --after and --before; they are of {first[:10]} "
            f"to {last[:10]}"
        )
    keep = [i for i in range(len(cube)) if i not in left_out]
    return cube[keep], [(cube.labels[i], why) for i, why in left_out.items()]
