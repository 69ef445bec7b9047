# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A profile as files: its table, the SSPs, and figures."""

from pathlib import Path

import astropy.units as u
import numpy as np

from astro_scc.epochs import ssp_offsets
from astro_scc.kinematics import RidgeLine, apparent_speed
from astro_scc.profiles.fits import fit_profile
from astro_scc.stacking import stack

__all__ = ["position_angle_groups", "scale_maps", "write_profile"]

#: Dots per inch of the figures.
DPI = 150


def write_profile(profile, components, directory, *, configuration=None, text=None):
    """
    Write the table and the figures of a profile.

    Parameters
    ----------
    profile : `Profile`
    components : `~astropy.table.QTable`
        `Profile.components`, or that with apparent speeds.
    directory : path
        A folder that exists.
    configuration : dict, optional
        Settings as plain numbers and text, for the meta of the table.
    text : str, optional
        The same as TOML, for ``config.toml``.

    Returns
    -------
    list of `~pathlib.Path`
        ``profile.ecsv``, ``profile.png``, ``velocity_maps.png``,
        ``position_angles.png`` and, with a ``text``, ``config.toml``.

    Raises
    ------
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.profiles import measure_profile, write_profile
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr,
    ...                               position_angle=270 * u.deg)
    >>> matched = scc.match(cube)
    >>> profile = measure_profile(
    ...     scc, matched, [2, 10, 18] * u.mas, n_trials=20, rng=1)
    >>> Path("out").mkdir()
    >>> [path.name for path in write_profile(profile, profile.components, "out")]
    ['profile.ecsv', 'profile.png', 'velocity_maps.png', 'position_angles.png']
    """
    from astro_scc.visualization import (
        plot_position_angles,
        plot_profile,
        plot_scale_maps,
    )

    directory = Path(directory)
    table = components.copy(copy_data=False)
    table.meta = dict(components.meta)
    if configuration is not None:
        table.meta.pop("settings", None)
        table.meta = {"configuration": configuration, **table.meta}
    paths = [directory / "profile.ecsv"]
    table.write(paths[0], format="ascii.ecsv", overwrite=True)
    result = next(r for r in profile.results if r is not None)
    beta = None
    how = {
        k: components.meta[k]
        for k in ("redshift", "cosmology", "distance")
        if components.meta.get(k) is not None
    }
    if how:
        beta = float(apparent_speed(1 * u.mas / u.yr, **how))
    maps, grid = scale_maps(profile)
    figures = {
        "profile": plot_profile(
            components,
            cube=result.cube,
            line=_line_of(result, profile.bins.max()),
            fits=_fits(profile),
            beta_per_pm=beta,
        ),
        "velocity_maps": plot_scale_maps(
            maps, grid, axis_names=tuple(result.frame.axis_names)
        ),
        "position_angles": plot_position_angles(position_angle_groups(profile)),
    }
    for name, figure in figures.items():
        paths.append(directory / f"{name}.png")
        figure.savefig(paths[-1], dpi=DPI)
    if text is not None:
        paths.append(directory / "config.toml")
        paths[-1].write_text(text, encoding="utf-8")
    return paths


def scale_maps(profile):
    """
    The stacks of each scale, over all bins together.

    Parameters
    ----------
    profile : `Profile`

    Returns
    -------
    maps : dict of `~numpy.ndarray`
        By the name of the scale.
    grid : `~astro_scc.stacking.VelocityGrid`
    """
    results = [r for r in profile.results if r is not None]
    grid = max((r.grid for r in results), key=lambda g: g.shape[0] * g.shape[1])
    ssps = results[0].matched.ssps
    maps = {}
    for scale in np.unique(ssps.scale):
        total = np.zeros(grid.shape)
        for result in results:
            d = result.displacements
            own = d.select(ssps.scale[d.ssp] == scale)
            total += stack(own, result.pairs, grid)
        maps[f"scale {scale:g}"] = total / len(results)
    return maps, grid


def position_angle_groups(profile):
    """
    Position angles of the SSPs of the bins about the core, by scale.

    Parameters
    ----------
    profile : `Profile`

    Returns
    -------
    dict of `~astropy.units.Quantity`
        By the name of the scale, within half a turn of the jet's direction.
    """
    results = [r for r in profile.results if r is not None]
    matched = results[0].matched
    select = np.any([r.matched.select for r in results], axis=0)
    east, north = ssp_offsets(matched.ssps, matched.cube, centroid=True)
    jet = results[0].position_angle.to_value(u.deg)
    angle = np.degrees(np.arctan2(east, north))
    angle = jet + (angle - jet + 180) % 360 - 180
    return {
        f"scale {scale:g}": angle[select & (matched.ssps.scale == scale)] * u.deg
        for scale in np.unique(matched.ssps.scale)
    }


def _line_of(result, length):
    """The line along which the jet is drawn."""
    if isinstance(result.frame, RidgeLine):
        return result.frame
    angle = result.position_angle.to_value(u.rad)
    s = [0.0, length.to_value(u.mas)] * u.mas
    return RidgeLine(s * np.sin(angle), s * np.cos(angle))


def _fits(profile):
    """A straight line and a power law, where there are enough speeds."""
    main = profile.main
    fits = []
    for model in ("linear", "power-law"):
        try:
            fits.append(
                fit_profile(
                    main["r_mid"],
                    main["pm_parallel"],
                    main["pm_parallel_err"],
                    model=model,
                )
            )
        except ValueError:
            continue
    return tuple(fits)
