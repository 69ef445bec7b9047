# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tracks as files: tables and figures."""

__all__ = ["draw_tracks", "write_tracks"]

#: Dots per inch of the figures.
DPI = 130
#: Points of the profile.
N_RADII = 20


def write_tracks(tracking, config, folder, *, half_width=None, votable=False):
    """
    Write the tables.

    Parameters
    ----------
    tracking : `~astro_scc.tracking.Tracking`
    config : dict
        See `astro_scc.config`.
    folder : `~pathlib.Path`
    half_width : `~astropy.units.Quantity`, optional
        Of the profile; by default 2 mas, or a fifth of the longest distance
        if that is less.
    votable : bool, optional
        Write features and tracks as VOTable too.

    Returns
    -------
    `~astropy.table.QTable`
        The profile, see `~astro_scc.tracking.Tracking.profile`.
    """
    import astropy.units as u
    import numpy as np
    from astropy.table import QTable

    from astro_scc.config import distance_of, plain_settings
    from astro_scc.measurement import versions, write_votable
    from astro_scc.measurement.products import plain_meta
    from astro_scc.tracking import plain_table

    how = distance_of(config)
    tracks = tracking.tracks_in_c(**how) if how else tracking.tracks
    longest = tracks["r"].to_value(u.mas).max(initial=0.0) * u.mas
    if half_width is None:
        half_width = min(2 * u.mas, longest / 5) if longest > 0 else 2 * u.mas
    radii = np.linspace(0, 1, N_RADII + 1)[1:] if longest > 0 else []
    profile = tracking.profile(radii * longest, half_width=half_width)
    meta = {
        "configuration": plain_settings(config),
        **plain_meta({**tracks.meta, **profile.meta}),
        "versions": versions(),
    }
    tables = {
        "features": tracking.features,
        "tracks": tracks,
        "track_profile": profile,
    }
    for name, table in tables.items():
        table = QTable(table, copy=False)
        table.meta = meta
        table.write(folder / f"{name}.ecsv", format="ascii.ecsv", overwrite=True)
        if votable and name != "track_profile":
            write_votable(plain_table(table), folder / f"{name}.vot", overwrite=True)
    return profile


def draw_tracks(tracking, profile, config, folder, *, stack=None):
    """
    Write the figures.

    Parameters
    ----------
    tracking : `~astro_scc.tracking.Tracking`
    profile : `~astropy.table.QTable`
        See `write_tracks`.
    config : dict
        See `astro_scc.config`.
    folder : `~pathlib.Path`
    stack : `~astropy.table.QTable`, optional
        Profile of the stacked cross-correlation, to draw beside.
    """
    import astropy.units as u

    from astro_scc.config import distance_of
    from astro_scc.kinematics import apparent_speed
    from astro_scc.visualization import (
        plot_separation,
        plot_track_profile,
        plot_tracks,
    )

    how = distance_of(config)
    per_pm = float(apparent_speed(1 * u.mas / u.yr, **how)) if how else None
    figures = {
        "separation": plot_separation(tracking),
        "tracks": plot_tracks(tracking),
        "track_profile": plot_track_profile(profile, stack=stack, beta_per_pm=per_pm),
    }
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png", dpi=DPI, metadata={"Software": None})
