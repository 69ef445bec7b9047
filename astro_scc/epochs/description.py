# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What a cube holds, for people to read."""

import astropy.units as u
import numpy as np
from astropy.time import Time

from astro_scc.epochs.validation import date_labels

__all__ = ["describe", "epoch_table", "readable_angle"]


def readable_angle(angle):
    """
    An angle as text, in the unit that gives a number of common size.

    Parameters
    ----------
    angle : `~astropy.units.Quantity`

    Returns
    -------
    str

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.epochs.description import readable_angle
    >>> readable_angle(0.05 * u.arcsec), readable_angle(3e-6 * u.arcsec)
    ('50 mas', '3 uas')
    """
    units = (u.deg, u.arcsec, u.mas, u.uas)
    size = abs(angle)
    unit = next((unit for unit in units if size.to_value(unit) >= 0.1), u.mas)
    if unit == u.uas and size.to_value(u.mas) >= 0.01:
        unit = u.mas
    return f"{angle.to_value(unit):.4g} {unit}"


def describe(cube):
    """
    One line on a cube.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`

    Returns
    -------
    str
    """
    n, ny, nx = cube.shape
    dates = date_labels(cube.times)
    parts = [
        f"{n} epochs {dates[0]} to {dates[-1]}" if n > 1 else f"1 epoch {dates[0]}"
    ]
    parts.append(f"{nx} x {ny} pixels of {readable_angle(cube.pixel_scale)}")
    if cube.unit != u.dimensionless_unscaled:
        parts.append(f"{cube.unit}")
    if cube.beams is not None:
        beam = cube.beams[0]
        size = f"{readable_angle(beam.major)} x {readable_angle(beam.minor)}"
        same = all(other == beam for other in cube.beams)
        parts.append(f"beam {size}" if same else "beams that differ")
    return ", ".join(parts)


def epoch_table(cube):
    """
    One row an epoch; see `EpochCube.epochs`.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`

    Returns
    -------
    `~astropy.table.QTable`
    """
    from astropy.table import QTable

    table = QTable({"epoch": np.arange(len(cube)), "label": list(cube.labels)})
    table["date"] = Time(cube.times, format="isot")
    if cube.beams is not None:
        table["major"] = u.Quantity([beam.major for beam in cube.beams])
        table["minor"] = u.Quantity([beam.minor for beam in cube.beams])
        table["pa"] = u.Quantity([beam.pa for beam in cube.beams])
    table["noise"] = cube.noise_rms()
    table["object"] = [str(facts.get("object", "")) for facts in cube.epoch_meta]
    frequency = [facts.get("frequency", np.nan) for facts in cube.epoch_meta]
    table["frequency"] = np.divide(frequency, 1e9) * u.GHz
    return table
