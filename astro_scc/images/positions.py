# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Positions on the sky; scale and north of images where structure is.

Speeds, directions and offsets are measured with one matrix, that of the ``wcs`` at
its reference pixel.  It holds where the sky is flat in the image.  Where the reference
pixel lies far away, or the projection stretches what is shown, `flat_wcs` replaces the
coordinates by a tangent plane of the sky at the structure.  Images and regions of
other frames are turned to one north.
"""

import re

import astropy.units as u
import numpy as np
from astropy.coordinates import FK5, ICRS, SkyCoord, angular_separation
from astropy.wcs import WCS
from astropy.wcs.utils import wcs_to_celestial_frame

from astro_scc.decomposition.wavelet import measure_noise
from astro_scc.exceptions import refusing
from astro_scc.images.headers import KEYWORDS
from astro_scc.quantities import named, one_quantity

#: Where longitude and latitude increase, and if longitude does so leftwards, by the
#: start of its CTYPE.
AXES = KEYWORDS["directions"]

#: Name of coordinates that are offsets in a plane, however large a pixel is.
PLANE = "OFFSETS"
#: Longitude and latitude of a source whose position is not known.
UNKNOWN = (180.0, 0.0)
#: Resolution of images without a beam, in pixels.
PIXELS_RESOLVED = 3
#: Largest difference of scale (relative) or north (radians) that one matrix may have.
SAME = 1e-3
#: The same where the matrix is that of the middle of the structure.
EVEN = 0.02
#: Facts about the frame that a WCS keeps: of the Sun, the place of the observer.
OBSERVER = "rsun_ref dsun_obs hgln_obs hglt_obs crln_obs a_radius b_radius c_radius"


def readable_angle(angle):
    """Return an angle as text, in the unit that suits its size."""
    least = {u.deg: 0.1, u.arcsec: 0.1, u.mas: 0.01, u.uas: 0.1}
    fits = (unit for unit in least if abs(angle).to_value(unit) >= least[unit])
    unit = next(fits, u.mas)
    return f"{angle.to_value(unit):.4g} {unit}"


def pixel_side(pixel_scale):
    """Return the side of a pixel as a Quantity, a positive angle."""
    return named("pixel_scale", one_quantity, pixel_scale, "an angle", "0.1 mas")


def offset_wcs(pixel_scale, reference_pixel, position=None):
    """
    Return a celestial WCS for offsets from a reference pixel.

    It is orthographic (``SIN``), with east to the left, north up and square pixels.

    Parameters
    ----------
    pixel_scale : `~astropy.units.Quantity`
        Side of a pixel, an angle.
    reference_pixel : tuple of float
        (x, y) of the origin of offsets, counted from 0.
    position : `~astropy.coordinates.SkyCoord`, optional
        Celestial position of the origin; by default (180 deg, 0 deg).
    """
    step = pixel_side(pixel_scale).to_value(u.deg)
    if not isinstance(position, SkyCoord | None):
        raise TypeError(f"position must be a SkyCoord, got {position!r}")
    position = SkyCoord(*UNKNOWN, unit=u.deg) if position is None else position.icrs
    wrong = f"reference_pixel must be two numbers (x, y), got {reference_pixel!r}"
    with refusing(wrong, AttributeError, TypeError, ValueError):
        x, y = (u.Quantity(v, u.pix).value.item() for v in reference_pixel)
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = "RA---SIN", "DEC--SIN"
    wcs.wcs.cunit = "deg", "deg"
    wcs.wcs.crval = position.ra.deg, position.dec.deg
    wcs.wcs.crpix = x + 1, y + 1
    wcs.wcs.cdelt = -step, step
    wcs.wcs.radesys = "ICRS"
    wcs.wcs.name = PLANE
    wcs.wcs.set()
    return wcs


def axis_words(cube):
    """
    Return where longitude and latitude increase, and if longitude does so leftwards.

    On the sky longitude increases to the east, which is left; in coordinates of the
    Sun it increases to the west, which is right.  The words are "east" and "north" for
    right ascension and declination only.  Only the ``wcs`` of the ``cube`` is used.
    """
    return tuple(AXES.get(str(cube.wcs.wcs.ctype[0])[:4], AXES["other"]))


def ssp_offsets(ssps, cube, *, centroid=False):
    """
    Return the offsets of SSPs from the reference pixel, in mas.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
    cube : `~astro_scc.epochs.EpochCube`
    centroid : bool, optional
        Use the centroids instead of the maxima.

    Returns
    -------
    east, north : `~numpy.ndarray`, shape (n,)

    Examples
    --------
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.images.positions import ssp_offsets
    >>> from astro_scc.simulation import simulate_static
    >>> cube = simulate_static(n_epochs=2, rng=1).cube
    >>> ssps = SSPs.of_epochs([Decomposer(scales=[2])(image) for image in cube.data])
    >>> east, north = ssp_offsets(ssps, cube)
    >>> east.shape == (len(ssps),)
    True
    """
    y, x = (ssps.y_centroid, ssps.x_centroid) if centroid else (ssps.y, ssps.x)
    return tuple(offset.value for offset in cube.pixel_to_offset(x, y))


def name_by_frame(table, cube):
    """
    Name the columns of a table by the celestial frame of its cube, in place.

    Tables are made with names for right ascension and declination.  In other
    frames, such as those of the Sun, ``pm_ra_cosdec`` becomes
    ``pm_lon_coslat``, ``pm_dec`` becomes ``pm_lat``, and the offsets ``east``
    and ``north`` become ``lon_offset`` and ``lat_offset``; columns derived from
    them change likewise.  The table is returned.
    """
    first, second, _ = axis_words(cube)
    if first == "east":
        return table
    words = {"to the east": f"to {first}", "to the north": f"to {second}"}
    words["through east"] = f"through {first}"
    for name in table.colnames:
        new, about = name, table[name].info.description or ""
        for pattern, replacement in KEYWORDS["longitude"].items():
            new = re.sub(pattern, replacement, new)
        renamed = {f"of {name.removesuffix('_err')}": f"of {new.removesuffix('_err')}"}
        for old, word in {**renamed, **words}.items():
            about = about.replace(old, word)
        if new != name:
            table.rename_column(name, new)
        if about:
            table[new].info.description = about
    return table


def sky_columns(table):
    """Return the names of the proper motions in longitude and latitude."""
    if "pm_lon_coslat" in table.colnames:
        return "pm_lon_coslat", "pm_lat"
    return "pm_ra_cosdec", "pm_dec"


def local_matrix(wcs, x, y, step=1e-6):
    """
    Return the offsets on the sky of one pixel step, at some pixels.

    Parameters
    ----------
    wcs : `~astropy.wcs.WCS`
        Celestial, two axes.
    x, y : array_like, shape (...)
        Pixels, counted from 0.
    step : float, optional
        Derivatives are taken over this part of a radian, or over a pixel if it is
        larger: projections bend over a radian, and degrees of float64 resolve 1e-16 of
        a circle.

    Returns
    -------
    `~numpy.ndarray`, shape (..., 2, 2)
        ``(east, north) = matrix @ (dx, dy)`` in degrees, with east and north of the
        place; NaN where the projection has no sky.  It is the CD matrix where that
        does not differ by more than a part in ten thousand.
    """
    x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
    usual = wcs.pixel_scale_matrix
    h = max(0.5, step / np.radians(np.sqrt(abs(np.linalg.det(usual)))))
    east, north, _ = _axes(*wcs.pixel_to_world_values(x, y))
    columns = []
    for dx, dy in ((h, 0), (0, h)):
        ahead, behind = (
            _axes(*wcs.pixel_to_world_values(x + sign * dx, y + sign * dy))[2]
            for sign in (1, -1)
        )
        change = np.degrees(ahead - behind) / (2 * h)
        columns.append([np.sum(axis * change, axis=0) for axis in (east, north)])
    found = np.moveaxis(np.array(columns), (0, 1), (-1, -2))
    near = np.abs(found - usual).max(axis=(-1, -2)) < 1e-4 * np.abs(usual).max()
    return np.where(near[..., None, None], usual, found)


def _axes(lon, lat):
    """Return unit vectors to the east, to the north and to places, shape (3, ...)."""
    lon, lat = np.radians(lon), np.radians(lat)
    x, y, across, up = np.cos(lon), np.sin(lon), np.cos(lat), np.sin(lat)
    east = np.array([-y, x, np.zeros_like(lon)])
    north = np.array([-up * x, -up * y, across])
    return east, north, np.array([across * x, across * y, up])


def local_area(wcs, x, y):
    """Return the solid angle of pixels (x, y) in square degrees."""
    (a, b), (c, d) = np.moveaxis(local_matrix(wcs, x, y), (-2, -1), (0, 1))
    return np.abs(a * d - b * c)


def middle_area(wcs, shape):
    """Return the solid angle of the pixel in the middle of an image (ny, nx)."""
    area = float(local_area(wcs, (shape[1] - 1) / 2, (shape[0] - 1) / 2))
    return area if np.isfinite(area) else abs(np.linalg.det(wcs.pixel_scale_matrix))


def whole(shape):
    """Return the box (x0, x1, y0, y1) of an image."""
    return 0.0, shape[1] - 1.0, 0.0, shape[0] - 1.0


def outline(box, n=33):
    """Return n pixels x and y along each side of a box, shape (2, 4 n)."""
    edge = np.linspace(0, 1, n)
    sides = (edge, 0), (edge, 1), (0, edge), (1, edge)
    parts = np.concatenate([np.broadcast_arrays(*side) for side in sides], axis=1)
    x0, x1, y0, y1 = box
    return np.array([[x0], [y0]]) + parts * [[x1 - x0], [y1 - y0]]


def differences(wcs, box, matrix, n=5):
    """
    Return by how much scale and north differ from those of a matrix, at most in a box.

    They are compared at n x n places.

    Parameters
    ----------
    wcs : `~astropy.wcs.WCS`
    box : tuple of float
        x0, x1, y0, y1.
    matrix : `~numpy.ndarray`, shape (2, 2)

    Returns
    -------
    stretch : float
        Largest relative difference of a length.
    turn : float
        Largest difference of north, in radians.  Both are infinite if a part of the
        box is not on the sky.
    """
    x0, x1, y0, y1 = box
    y, x = np.meshgrid(np.linspace(y0, y1, n), np.linspace(x0, x1, n))
    change = local_matrix(wcs, x, y) @ np.linalg.inv(matrix)
    if not np.all(np.isfinite(change)):
        return np.inf, np.inf
    stretch = np.abs(np.linalg.svd(change, compute_uv=False) - 1).max()
    turn = np.arctan2(
        change[..., 0, 1] - change[..., 1, 0], change[..., 0, 0] + change[..., 1, 1]
    )
    return float(stretch), float(np.abs(turn).max())


def is_flat(wcs, shape):
    """Return whether the matrix at the reference pixel holds in a whole image."""
    if wcs.wcs.name == PLANE:
        return True
    return max(differences(wcs, whole(shape), wcs.pixel_scale_matrix)) <= SAME


def is_far(wcs, shape, sizes=10):
    """
    Return whether offsets from the reference pixel say little about an image.

    It is more than some ``sizes`` of the image away.
    """
    away = np.abs(wcs.wcs.crpix - 1 - (np.array(shape[::-1]) - 1) / 2)
    return wcs.wcs.name != PLANE and bool(np.any(away > sizes * max(shape)))


def structure(image, snr=5.0, percentiles=(2, 98)):
    """
    Return the box of most of the bright pixels of an image, and the brightest one.

    Bright pixels are above ``snr`` times the noise, and the box is that between the
    ``percentiles`` of their places.  Pixels that are not finite are left out.  It is
    the whole image if nothing in it is bright.

    Returns
    -------
    box : tuple of float
        x0, x1, y0, y1.
    peak : tuple of int
        x and y.
    """
    bad = ~np.isfinite(image)
    if bad.all():
        return whole(image.shape), tuple((n - 1) // 2 for n in image.shape[::-1])
    level = np.where(bad, 0.0, image - np.median(image[~bad]))
    y, x = np.nonzero(level > snr * measure_noise(level, bad))
    top = np.unravel_index(np.argmax(level), level.shape)
    peak = int(top[1]), int(top[0])
    if len(x) == 0:
        return whole(image.shape), peak
    box = np.concatenate([np.percentile(v, percentiles) for v in (x, y)])
    return tuple(box.tolist()), peak


def flat_wcs(wcs, image, *, moved=False):
    """
    Return coordinates whose matrix holds where the structure of an image is.

    They are those given if their matrix is that in the middle of the structure, and
    holds all over it.  Otherwise they are a tangent
    plane at the brightest pixel, or in the middle of the structure if scale and north
    at the brightest pixel do not hold all over it.

    Parameters
    ----------
    wcs : `~astropy.wcs.WCS`
    image : `~numpy.ndarray`, shape (ny, nx)
        The mean of the epochs, NaN where bad.
    moved : bool, optional
        Never keep the reference pixel.

    Returns
    -------
    wcs : `~astropy.wcs.WCS` or None
        None if scales differ over the structure.
    turn : float
        By how much north turns over the structure, in radians.
    """
    usual = wcs.pixel_scale_matrix
    box, peak = structure(image)
    middle = (box[0] + box[1]) / 2, (box[2] + box[3]) / 2
    here = differences(wcs, (middle[0], middle[0], middle[1], middle[1]), usual)
    if not moved and max(here) <= SAME and max(differences(wcs, box, usual)) <= EVEN:
        return wcs, 0.0
    for place, limits in ((peak, (SAME, SAME)), (middle, (EVEN, np.inf))):
        matrix = local_matrix(wcs, *place)
        if not np.all(np.isfinite(matrix)):
            continue
        stretch, turn = differences(wcs, box, matrix)
        if stretch <= limits[0] and turn <= limits[1]:
            return tangent_wcs(wcs, place, matrix), turn
    return None, 0.0


def tangent_wcs(wcs, place, matrix=None):
    """
    Return the tangent plane of a WCS at a pixel, with true distances from there.

    Parameters
    ----------
    wcs : `~astropy.wcs.WCS`
    place : tuple of float
        x and y, counted from 0.
    matrix : `~numpy.ndarray`, shape (2, 2), optional
        By default the local one.
    """
    flat = WCS(naxis=2)
    flat.wcs.ctype = [f"{code[:5]}ARC" for code in wcs.wcs.ctype]
    flat.wcs.cunit = "deg", "deg"
    flat.wcs.crpix = np.asarray(place, dtype=float) + 1
    flat.wcs.crval = [float(v) for v in wcs.pixel_to_world_values(*place)]
    flat.wcs.cdelt = 1, 1
    flat.wcs.pc = local_matrix(wcs, *place) if matrix is None else matrix
    for name in ("radesys", "equinox", "dateobs", "mjdobs"):
        setattr(flat.wcs, name, getattr(wcs.wcs, name))
    for name in OBSERVER.split():
        setattr(flat.wcs.aux, name, getattr(wcs.wcs.aux, name, None))
    flat.wcs.set()
    flat.array_shape = wcs.array_shape
    return flat


def tangent_grid(wcs, image):
    """
    Return a tangent plane onto which the structure of an image can be resampled.

    Parameters
    ----------
    wcs : `~astropy.wcs.WCS`
    image : `~numpy.ndarray`, shape (ny, nx)

    Returns
    -------
    grid : `~astropy.wcs.WCS`
        With square pixels as fine as those in the middle of the structure, and its
        ``array_shape``.
    turn : float
        By how much north turns over the structure, in radians.

    Raises
    ------
    ValueError
        If the structure covers more of the sky than a plane holds.
    """
    ends = np.reshape(structure(image)[0], (2, 2))
    # What is around the structure belongs to it, as far as the image reaches.
    ends = ends + (np.diff(ends) / 4 + 5) * [-1, 1]
    ends = np.clip(ends, 0, np.array(image.shape)[::-1, None] - 1)
    place = ends.mean(axis=1)
    matrix = local_matrix(wcs, *place)
    if not np.all(np.isfinite(matrix)):
        raise ValueError(too_wide(wcs))
    side = np.hypot(*matrix).min()
    # Mirrored as the image is.
    square = side * np.diag([np.sign(np.linalg.det(matrix)), 1.0])
    grid = tangent_wcs(wcs, place, square)
    sky = wcs.pixel_to_world_values(*outline(ends.ravel()))
    x, y = grid.world_to_pixel_values(*sky)
    low, high = (how([x, y], axis=1) for how in (np.min, np.max))
    size = np.ceil(high - low) + 1
    if not np.all(np.isfinite(size)) or np.prod(size) > 100 * image.size:
        raise ValueError(too_wide(wcs))
    grid.wcs.crpix = grid.wcs.crpix - np.floor(low)
    grid.wcs.set()
    grid.array_shape = shape = tuple(size[::-1].astype(int).tolist())
    stretch, turn = differences(grid, whole(shape), grid.pixel_scale_matrix)
    if stretch > EVEN:
        raise ValueError(too_wide(wcs))
    return grid, turn


def too_wide(wcs):
    """Return what is wrong with images in which scales differ, and what to do."""
    return (
        f"the projection ({str(wcs.wcs.ctype[0])[5:]}) changes the scale too much over "
        "the structure for one speed; cut out the part that moves (--crop, region=), "
        "or reproject the images onto a tangent plane there"
    )


def unwrapped(wcs, shape):
    """
    Return a WCS that has the sky in the middle of an image.

    Cylinders repeat every 360 degrees of longitude, but coordinates end half a turn
    from the reference pixel.  Their reference pixel is moved along the equator into the
    middle of such an image.
    """
    places = np.meshgrid(*(np.linspace(0, n - 1, 3) for n in shape[::-1]))
    if np.all(np.isfinite(wcs.pixel_to_world_values(*places))):
        return wcs
    free = wcs.deepcopy()
    free.wcs.bounds_check(False, False)
    sky = _axes(*free.pixel_to_world_values(*places))[2]
    matrix = wcs.pixel_scale_matrix
    middle = (np.array(shape[::-1]) - 1) / 2
    lon = (matrix @ (middle - wcs.wcs.crpix + 1))[0]
    # Along an equator that is that of the sky, and by whole turns along others.
    for shift, turned in ((lon, lon), (360 * np.rint(lon / 360), 0.0)):
        crpix = wcs.wcs.crpix + np.linalg.solve(matrix, [shift, 0])
        crval = (wcs.wcs.crval[0] + turned) % 360, wcs.wcs.crval[1]
        moved = changed_wcs(wcs, crpix=crpix, crval=crval)
        found = _axes(*moved.pixel_to_world_values(*places))[2]
        if np.all(np.abs(found - sky) < 1e-9):
            return moved
    return wcs


def on_one_sky(every, first, frame):
    """
    Return the WCS of images that are laid on each other, the north of all that of one.

    Offsets have their reference pixels at (0, 0) and are turned to the north of the
    first one; in the frame "absolute", the WCS are returned as they are.
    """
    if frame == "absolute":
        return every
    place = {"crval": (0, 0), "radesys": "ICRS", "equinox": np.nan}
    offsets = [with_frame(wcs, ("RA---", "DEC--"), **place) for wcs in every]
    return list(map(turned, offsets, [north_in(wcs, first) for wcs in every]))


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


def reference_of(wcs, frame=None):
    """Return the reference point of a WCS as SkyCoord, in a frame if one is given."""
    known = frame_of(wcs)
    known = "icrs" if known is None else known
    place = SkyCoord(*wcs.wcs.crval, unit=u.deg, frame=known)
    return place if frame is None else place.transform_to(frame)


def apart_by_reference(one, other):
    """
    Return the distance of the reference points of two WCS on the sky, in degrees.

    It is 0 if it may be due to the way in which B1950 was turned into J2000: headers
    do not say whether the elliptic terms of aberration, up to 0.5 arcsec, are in them.
    """
    if is_one_frame(one, other):
        places = np.radians([*one.wcs.crval, *other.wcs.crval])
        return np.degrees(angular_separation(*places))
    found = reference_of(other, frame_of(one)).separation(reference_of(one))
    return found.deg if found > 0.5 * u.arcsec else 0.0


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
    return north_of(reference_of(wcs), frame_of(other))


def north_of(place, frame):
    """Return the position angle in a frame of the north of a SkyCoord, in radians."""
    # A small distance, and far above rounding.
    ahead = place.directional_offset_by(0 * u.deg, 1 * u.arcsec)
    here, there = (one.transform_to(frame) for one in (place, ahead))
    return here.position_angle(there).to_value(u.rad)


def placed_as(wcs, other):
    """Return a WCS with the reference point, frame and axes of another one."""
    names = ("crval", "radesys", "equinox", "lonpole", "latpole")
    values = {name: getattr(other.wcs, name) for name in names}
    return with_frame(wcs, other.wcs.ctype, **values)


def with_frame(wcs, axes, **values):
    """Return a copy of a WCS with other axis names and frame values."""
    codes = zip(axes, wcs.wcs.ctype, strict=True)
    ctype = [name[:5] + code[5:] for name, code in codes]
    return changed_wcs(wcs, **values, ctype=ctype)


def changed_wcs(wcs, **values):
    """Return a copy of a WCS with other values."""
    changed = wcs.deepcopy()
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
