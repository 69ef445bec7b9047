# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Celestial frames of images: one north, one place, and regions of other frames."""

import astropy.units as u
import numpy as np
from astropy.coordinates import FK5, ICRS, SkyCoord, angular_separation
from astropy.wcs.utils import wcs_to_celestial_frame

#: Headers of B1950 do not say whether the elliptic terms of aberration are in them.
E_TERMS = 0.5 * u.arcsec
#: Distance to the place that tells where north is: small, and far above rounding.
NORTHWARDS = 1 * u.arcsec


def in_frame(wcs, frame, north=0.0):
    """
    Return a WCS; for offsets, one with its reference pixel at (0, 0).

    It is turned by the position angle of its ``north``, in radians.
    """
    if frame == "absolute":
        return wcs
    placed = with_frame(
        wcs, ("RA---", "DEC--"), crval=(0, 0), radesys="ICRS", equinox=np.nan
    )
    return turned(placed, north)


def on_one_sky(every, first, frame):
    """Return WCS as `in_frame` does, each turned to the north of the first one."""
    return [in_frame(wcs, frame, north_in(wcs, first)) for wcs in every]


def turned(wcs, angle):
    """Return a WCS whose offsets are turned through east by an angle in radians."""
    if angle == 0:
        return wcs
    sin, cos = np.sin(angle), np.cos(angle)
    changed, matrix = wcs.deepcopy(), wcs.pixel_scale_matrix
    del changed.wcs.cd, changed.wcs.crota
    changed.wcs.cdelt = 1, 1
    changed.wcs.pc = np.array([[cos, sin], [-sin, cos]]) @ matrix
    changed.wcs.set()
    return changed


def frame_of(wcs):
    """
    Return the celestial frame of a WCS, None if astropy does not know it.

    FK5 of J2000 is taken for ICRS: headers of VLBI name either for the same positions.
    """
    try:
        frame = wcs_to_celestial_frame(wcs)
    except ValueError:
        return None
    return ICRS() if frame.is_equivalent_frame(FK5()) else frame


def place_of(wcs, frame=None):
    """Return the reference point of a WCS as SkyCoord, in a frame if one is given."""
    known = frame_of(wcs)
    place = SkyCoord(
        *wcs.wcs.crval, unit=u.deg, frame="icrs" if known is None else known
    )
    return place if frame is None else place.transform_to(frame)


def separation(one, other):
    """
    Return the distance of the reference points of two WCS on the sky, in degrees.

    It is 0 if it may be due to the way in which B1950 was turned into J2000.
    """
    if is_one_frame(one, other):
        return np.degrees(
            angular_separation(*np.radians([*one.wcs.crval, *other.wcs.crval]))
        )
    found = place_of(other, frame_of(one)).separation(place_of(one))
    return found.deg if found > E_TERMS else 0.0


def is_one_frame(one, other):
    """Return whether two WCS are of one celestial frame, as far as it is known."""
    frames = frame_of(one), frame_of(other)
    return None in frames or frames[0].is_equivalent_frame(frames[1])


def north_in(wcs, other):
    """
    Return the position angle of the north of a WCS in the frame of another one.

    It is that at the reference point, in radians, 0 in the same frame.
    """
    if is_one_frame(wcs, other):
        return 0.0
    return north_of(place_of(wcs), frame_of(other))


def north_of(place, frame):
    """Return the position angle in a frame of the north of a SkyCoord, in radians."""
    ahead = place.directional_offset_by(0 * u.deg, NORTHWARDS)
    return (
        place.transform_to(frame)
        .position_angle(ahead.transform_to(frame))
        .to_value(u.rad)
    )


def placed_as(wcs, other):
    """Return a WCS with the reference point, frame and axes of another one."""
    names = ("crval", "radesys", "equinox", "lonpole", "latpole")
    values = {name: getattr(other.wcs, name) for name in names}
    return with_frame(wcs, other.wcs.ctype, **values)


def with_frame(wcs, axes, **values):
    """Return a copy of a WCS with other axis names and frame values."""
    changed = wcs.deepcopy()
    codes = zip(axes, wcs.wcs.ctype, strict=True)
    values["ctype"] = [name[:5] + code[5:] for name, code in codes]
    for name, value in values.items():
        setattr(changed.wcs, name, value)
    changed.wcs.set()
    return changed


def region_in_frame(region, wcs):
    """
    Return a region of the sky in the frame of a WCS.

    Its angle refers to the north of the frame in which it was drawn, and regions would
    take it for that of the image.
    """
    # It imports matplotlib.
    from regions import CompoundSkyRegion

    if isinstance(region, CompoundSkyRegion):
        parts = (region_in_frame(one, wcs) for one in (region.region1, region.region2))
        return region.copy(**dict(zip(("region1", "region2"), parts, strict=True)))
    if frame_of(wcs) is None or not hasattr(region, "angle"):
        return region
    frame, centre = wcs_to_celestial_frame(wcs), region.center
    if centre.is_equivalent_frame(frame):
        return region
    angle = region.angle + north_of(centre, frame) * u.rad
    return region.copy(center=centre.transform_to(frame), angle=angle)
