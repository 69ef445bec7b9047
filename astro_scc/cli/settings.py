# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What was given on the command line and in a file, as settings."""

__all__ = ["draw_seed", "parse_option", "settings_of", "workers_of"]

#: Options of `measure` that are settings of its configuration.
OPTIONS = (
    "epochs",
    "after",
    "before",
    "align",
    "common_beam",
    "crop",
    "region",
    "scales",
    "max_speed",
    "position_angle",
    "baseline",
    "kernel",
    "kappa",
    "n_trials",
    "seed",
    "redshift",
    "cosmology",
    "distance",
    "bins",
    "window",
)


def parse_option(name, value):
    """
    The value of an option that is also a setting.

    Parameters
    ----------
    name : str
        Of the setting.
    value
        As given.

    Returns
    -------
    object

    Raises
    ------
    ValueError
        If it makes no sense; the message names the option.
    """
    from astro_scc.config import parse_setting

    try:
        return parse_setting(name, value)
    except ValueError as error:
        option = name.replace("_", "-")
        raise ValueError(f"--{option} {value!r}: {error}") from None


def draw_seed():
    """A seed that nobody chose, short enough to be typed."""
    import secrets

    return secrets.randbelow(2**31)


def settings_of(args, reporter):
    """
    The settings of the configuration file and of the command line over it.

    Parameters
    ----------
    args : `argparse.Namespace`
    reporter : `~astro_scc.cli.reporter.Reporter`

    Returns
    -------
    dict
        Those that were given, see `astro_scc.config`.

    Raises
    ------
    ValueError
        If one makes no sense, some do not go together, or there are no epochs.
    """
    from astro_scc.config import read_config
    from astro_scc.config.measuring import settings_over

    config, written_by = read_config(args.config) if args.config else ({}, {})
    _compare_versions(written_by, args, reporter)
    given = {
        name: parse_option(name, value)
        for name in OPTIONS
        if (value := getattr(args, name, None)) not in (None, [])
    }
    config = settings_over(config, given)
    if "cosmology" in config and "redshift" not in config:
        raise ValueError("--cosmology needs a --redshift")
    if not config.get("epochs"):
        raise ValueError("no epochs were given; name the FITS files, or a --config")
    return config


def _compare_versions(written_by, args, reporter):
    from astro_scc.measurement import versions

    now = versions()
    other = [
        f"{name} {version} (here {now.get(name, 'none')})"
        for name, version in written_by.items()
        if now.get(name) != version
    ]
    if other:
        reporter.note(
            f"{args.config} was written with {', '.join(other)}: numbers may differ"
        )


def workers_of(args):
    """
    The workers that ``--workers`` or ``--scheduler`` name.

    Parameters
    ----------
    args : `argparse.Namespace`

    Returns
    -------
    int or str

    Raises
    ------
    ValueError
        If it is no number of workers.
    """
    if args.workers < 1:
        raise ValueError(f"--workers must be at least 1, got {args.workers}")
    return args.workers if args.scheduler is None else args.scheduler
