# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The velocity map, the diagram and the features of a result as FITS extensions."""

import astropy.units as u
import numpy as np
from astropy.io import fits
from astropy.table import QTable

from astro_scc.measurement.tables import frame_velocities
from astro_scc.streams import SearchSettings
from astro_scc.units import PM_UNIT
from astro_scc.writing import ascii_line

MOTION = "direction of the proper motion"
#: What the header of the diagram says about it.
DIAGRAM = (
    "Matches per pattern (SSP) and beam of displacement beyond those of",
    "permuted epochs, weighted by their correlation coefficients, and smoothed",
    "by a Gaussian with a standard deviation of {blur:g} BEAM.  What moves at a",
    "constant speed is at displacement = speed * interval.",
    "INTV-LOG: interval = CRVAL1 * exp(CDELT1 * (pixel - CRPIX1) / CRVAL1).",
    "NaN: no two dates have this interval.  The table INTERVALS has the mean",
    "interval and the number of pairs of dates of each column.",
)


def velocity_hdus(result, *, text=None):
    """
    Return the velocity map, its significance and the diagram as FITS extensions.

    Parameters
    ----------
    result : `SCCResult`
    text : str, optional
        Settings, which become comments of the header.

    Returns
    -------
    `~astropy.io.fits.HDUList`
        The stacked correlation coefficients, and the extension ``ZSCORE``,
        with a linear WCS in mas/yr along the velocity axes; the image
        ``DIAGRAM`` of `SCCResult.diagram`; the table ``INTERVALS``, which
        describes the columns of that image; and the table ``FEATURES``, which is
        `SCCResult.feature_positions` without fluxes, with the velocity of the feature
        on the axes of the velocity map, ``pm_axis1`` and ``pm_axis2``, and dates as
        text.
    """
    hdus = []
    for which in ("coefficient", "z_score"):
        image = result.velocity_map(which)
        header = _header(image, (MOTION, MOTION))
        kind = fits.ImageHDU if hdus else fits.PrimaryHDU
        hdus.append(kind(np.asarray(image.data, dtype=float), header))
        hdus[-1].name = which.replace("_", "").upper()
    primary = hdus[0].header
    primary.update(_facts(result))
    for line in result.cube.meta.get("history", ()):
        primary.add_history(ascii_line(line))
    for line in (text or "").splitlines():
        primary.add_comment(ascii_line(line) or " ")
    return fits.HDUList([*hdus, *_diagram_hdus(result), _features_hdu(result)])


def _features_hdu(result):
    features = result.feature_positions.copy()
    features.meta.clear()
    # The standard does not have DN, which solar images are in.
    features.remove_column("flux")
    # Readers of FITS know dates as text.
    features["date"] = np.asarray(features["date"].isot, dtype="U23")
    velocity, _ = frame_velocities(result.frame, result.tracked_features)
    row = np.searchsorted(result.tracked_features.number, features["feature"])
    features["pm_axis1"], features["pm_axis2"] = velocity[row].T * PM_UNIT
    return fits.table_to_hdu(features, name="FEATURES")


def _diagram_hdus(result):
    image = result.diagram()
    along = result.frame.axis_names[0]
    along = "DISPPA" if along == "east" else along
    header = _header(image, ("between two dates", f"of patterns, along {along}"))
    header["BUNIT"] = image.unit.to_string("fits")
    header["BEAM"] = image.meta["beam"].value, "[mas] FWHM along the displacement"
    if (angle := image.meta["position_angle"]) is not None:
        header["DISPPA"] = angle.value, "[deg] position angle of the displacement"
    for line in DIAGRAM:
        header.add_comment(line.format(blur=SearchSettings().blur))
    columns = QTable({name: image.meta[name] for name in ("interval", "n_pairs")})
    table = fits.table_to_hdu(columns, name="INTERVALS")
    return fits.ImageHDU(image.data, header, name="DIAGRAM"), table


def _header(image, comments):
    header = image.wcs.to_header()
    # Keywords of celestial coordinates, which these axes are not.
    for key in ("LATPOLE", "LONPOLE", "MJDREF", "RADESYS"):
        header.remove(key, ignore_missing=True)
    for i, named in enumerate(zip(image.meta["axes"], comments, strict=True), start=1):
        header[f"CNAME{i}"] = named
    return header


def _facts(result):
    cube, meta = result.cube, result.meta
    times, angle = cube.times.utc[[0, -1]], result.position_angle.to_value(u.deg)
    versions = meta.get("versions", {})
    creator = f"astro_scc {versions.get('astro_scc', '')}"
    facts = {
        "OBJECT": (ascii_line(cube.meta.get("object", ""))[:60], "name of the object"),
        # If one form of a date is missing, readers warn that they add it.
        "TIMESYS": ("UTC", "time scale"),
        "DATE-BEG": (times.isot[0], "first epoch"),
        "DATE-END": (times.isot[1], "last epoch"),
        "MJD-BEG": (float(times.mjd[0]), "first epoch"),
        "MJD-END": (float(times.mjd[1]), "last epoch"),
        "NEPOCHS": (len(cube), "number of epochs"),
        "JETPA": (float(angle), "[deg] position angle of the jet"),
        "NTRIALS": (meta.get("n_trials"), "number of trials"),
        "SEED": (meta.get("seed"), "seed of the trials"),
        "CREATOR": (ascii_line(creator)[:60], "program"),
    }
    facts = {k: v for k, v in facts.items() if v[0] not in (None, "")}
    for i, (name, version) in enumerate(sorted(versions.items()), start=1):
        facts[f"VERS{i}"] = ascii_line(f"{name} {version}")[:60]
    return facts
