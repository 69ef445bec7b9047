# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What the settings of a measurement come to: epochs, distance, all defaults."""

from dataclasses import fields

__all__ = ["distance_of", "read_epochs", "select_epochs", "settings_as_used"]

#: `~astro_scc.kinematics.paper_cosmology`, as it stands in a file.
PAPER_COSMOLOGY = "H0=71,Om0=0.27"


def settings_over(config, own):
    """
    Settings with others over them.

    Parameters
    ----------
    config, own : dict

    Returns
    -------
    dict
        One kind of distance in ``own``, by redshift or not, replaces the
        other; a redshift has a cosmology.

    Raises
    ------
    ValueError
        If there are both a distance and a redshift.
    """
    if "distance" in own:
        config = {k: v for k, v in config.items() if k not in ("redshift", "cosmology")}
    elif "redshift" in own:
        config = {k: v for k, v in config.items() if k != "distance"}
    config = {**config, **own}
    if "distance" in config and ("redshift" in config or "cosmology" in config):
        raise ValueError("distance needs neither redshift nor cosmology; leave one out")
    if "redshift" in config:
        config.setdefault("cosmology", PAPER_COSMOLOGY)
    return config


def read_epochs(config, *, files=None, note=None):
    """
    Read the epochs of a configuration.

    Parameters
    ----------
    config : dict
        See `read_config`.
    files : list of path, optional
        Where the epochs are now, if that is not where they will be.
    note : callable, optional
        Called with a line of text for what is decided here.

    Returns
    -------
    cube : `~astro_scc.EpochCube`
        With one beam and aligned.
    config : dict
        With the files and the steps that were taken.
    left_out : list of (str, str)
        Epochs that are not in the cube, and why.

    Raises
    ------
    OSError, ValueError
        If files cannot be read, or not as one cube.

    Examples
    --------
    >>> from astro_scc.config import read_epochs
    >>> from astro_scc.epochs import write_epochs
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> paths = write_epochs(simulate_two_fluid(n_epochs=4, rng=1).cube, "jet")
    >>> cube, config, left_out = read_epochs(
    ...     {"epochs": ["jet/*.fits"], "before": "2000-03-15"})
    >>> len(cube), [name for name, why in left_out]
    (3, ['two-fluid_03_2000-03-31.fits'])
    """
    from astro_scc.epochs import EpochCube
    from astro_scc.epochs.cutout import refuse_pixels
    from astro_scc.epochs.files.assembly import find_files

    config = dict(config)
    if files is None:
        files = find_files(config["epochs"])
        config["epochs"] = [str(path) for path in files]
    align = config.setdefault("align", "none")
    frame = "absolute" if align == "wcs" else "offset"
    if "crop" in config and "region" in config:
        refuse_pixels(config["region"])
    cube = EpochCube.read(files, frame=frame, region=config.get("crop"))
    cube, left_out = select_epochs(cube, config)
    config["common_beam"] = _wants_common_beam(cube, config, note or _silent)
    if config["common_beam"]:
        cube = cube.to_common_beam()
    return cube.align(align), config, left_out


def _silent(text):
    pass


def _wants_common_beam(cube, config, note):
    from astro_scc.epochs.beam import different_beam

    wanted = config.get("common_beam")
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


def select_epochs(cube, config):
    """
    The epochs between two dates.

    Parameters
    ----------
    cube : `~astro_scc.EpochCube`
    config : dict
        With ``after`` and ``before``, or without.

    Returns
    -------
    cube : `~astro_scc.EpochCube`
    left_out : list of (str, str)
        The other epochs, and why they are left out.

    Raises
    ------
    ValueError
        If no epoch is left.

    Examples
    --------
    >>> from astro_scc.config import select_epochs
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=4, rng=1).cube
    >>> late, left_out = select_epochs(cube, {"after": "2000-02-01"})
    >>> len(late), len(left_out)
    (2, 2)
    """
    from astro_scc.quantities import to_time

    left_out = {}
    # In atomic time, as far dates are.
    for i, time in enumerate(cube.times.tai):
        if "after" in config and time < to_time(config["after"]):
            left_out[i] = f"before {config['after']}"
        if "before" in config and time >= to_time(config["before"]):
            left_out[i] = f"not before {config['before']}"
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


def settings_as_used(scc, config, *, seed):
    """
    All settings of a measurement; what was given stays as it was written.

    Parameters
    ----------
    scc : `~astro_scc.StackedCrossCorrelation`
    config : dict
    seed : int
        Without one in the configuration.

    Returns
    -------
    dict

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.config import settings_as_used
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    >>> used = settings_as_used(scc, {"max_speed": "36 mas/yr"}, seed=1)
    >>> used["max_speed"], used["kappa"], used["seed"]
    ('36 mas/yr', 0.6, 1)
    """
    return {
        "n_trials": 1000,
        "seed": seed,
        **{field.name: getattr(scc, field.name) for field in fields(scc)},
        **config,
    }


def distance_of(config):
    """
    How to turn proper motions into speeds, the options of `components_in_c`.

    Parameters
    ----------
    config : dict

    Returns
    -------
    dict

    Examples
    --------
    >>> from astro_scc.config import distance_of
    >>> settings = {"redshift": None, "cosmology": None, "distance": "16.7 Mpc"}
    >>> sorted(distance_of(settings))
    ['distance']
    """
    names = ("distance",) if "distance" in config else ("redshift", "cosmology")
    return {name: config[name] for name in names if name in config}
