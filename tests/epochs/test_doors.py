# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What people hand to the doors in Python is taken, or refused in one line."""

import astropy.units as u
import numpy as np
import pytest
from astropy.nddata import CCDData, NDData
from astropy.time import Time

from astro_scc import StackedCrossCorrelation
from astro_scc.epochs import EpochCube
from astro_scc.exceptions import EpochWarning
from astro_scc.quantities import random_generator
from astro_scc.settings import Settings

DATA = np.random.default_rng(1).normal(size=(2, 12, 16))
DATES = ["2000-01-01", "2001-01-01"]
SPEED = 2 * u.mas / u.yr


def cube():
    return EpochCube.from_arrays(DATA, DATES, pixel_scale=1 * u.mas)


def arrays(times=DATES, **options):
    return EpochCube.from_arrays(DATA, times, pixel_scale=1 * u.mas, **options)


def gwcs_of_the_sky():
    gwcs = pytest.importorskip("gwcs")
    from astropy import coordinates
    from astropy.modeling import models

    pixel = gwcs.coordinate_frames.Frame2D(axes_order=(0, 1), unit=(u.pix, u.pix))
    icrs = coordinates.ICRS()
    sky = gwcs.coordinate_frames.CelestialFrame(reference_frame=icrs)
    steps = models.Scale(1e-6) & models.Scale(1e-6)
    rotate = models.RotateNative2Celestial(5.6, -72.0, 180.0)
    return gwcs.WCS([(pixel, steps | models.Pix2Sky_TAN() | rotate), (sky, None)])


def of_gwcs():
    meta = {"DATE-OBS": DATES[0]}
    return EpochCube.from_ccddata(NDData(DATA[0], wcs=gwcs_of_the_sky(), meta=meta))


def ndcube_of_gwcs():
    ndcube = pytest.importorskip("ndcube")
    return EpochCube.from_ndcube(ndcube.NDCube(DATA[0], wcs=gwcs_of_the_sky()))


def of_collection():
    ndcube = pytest.importorskip("ndcube")
    own = cube().to_ndcube()
    return EpochCube.from_ndcube(ndcube.NDCollection([("a", own), ("b", own)]))


def of_unit(unit):
    image = CCDData(DATA[0], unit=unit, wcs=cube().wcs, meta={"DATE-OBS": DATES[0]})
    return EpochCube.from_ccddata(image)


REFUSED = [
    (lambda: EpochCube(DATA), TypeError, r"EpochCube.from_arrays\(data, times, pixel"),
    (lambda: EpochCube(DATA, DATES), TypeError, "EpochCube.from_arrays"),
    (of_gwcs, ValueError, "image 0: wcs must be a WCS, or one sliced, got gwcs.WCS; g"),
    (ndcube_of_gwcs, ValueError, "an NDCube must have two celestial axes, one of the"),
    (of_collection, TypeError, "a NDCollection is no NDCube; give one of its cubes, o"),
    (lambda: EpochCube.from_ndcube(DATA), TypeError, "a ndarray is no NDCube"),
    (lambda: EpochCube.from_ndcube([cube()]), TypeError, "a list is no NDCube"),
    (lambda: of_unit(u.mag), ValueError, "image 0: its unit is mag, a logarithm"),
    (lambda: of_unit(u.ABmag), ValueError, r"its unit is mag\(AB\), a logarithm"),
    (lambda: EpochCube.from_arrays(DATA * u.dex, DATES, pixel_scale=1 * u.mas),
     ValueError, "data: its unit is dex, a logarithm"),
    (lambda: EpochCube(DATA, Time(DATES, scale="local"), cube().wcs), ValueError,
     "scale 'local'"),
    *((lambda value=value: Settings(scales=value), ValueError, "scale 0 is single p")
      for value in (0, 0.0, "0", [0], np.int64(0))),
    (lambda: StackedCrossCorrelation(scales=0, max_speed=SPEED), ValueError, "scale 0"),
    (lambda: arrays(times=[2000.0, 2001.0]), TypeError, "of numbers make Time"),
    (lambda: arrays(times=np.arange(900.0)), TypeError, "got ndarray; of numbers"),
    *((lambda beam=beam: arrays(beams=beam), TypeError, "a beam has major, minor and")
      for beam in (0.5, 0.5 * u.mas, [0.5, 0.5])),
    *((lambda place=place: arrays(reference_pixel=place), ValueError,
       r"reference_pixel must be two numbers \(x, y\)")
      for place in ((1, 2, 3), 4.0, ("a", "b"), (1 * u.mas, 2 * u.mas))),
    (lambda: random_generator(np.random), ValueError, "rng must be a seed of 0 or"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "error", "words"), REFUSED)
def test_what_is_no_cube_is_refused_in_one_line(call, error, words):
    with pytest.raises(error, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)
    assert "truth value" not in str(caught.value)


def test_older_generators_are_taken():
    one, other = (random_generator(np.random.RandomState(3)) for _ in range(2))
    assert one.integers(10**9) == other.integers(10**9)


def test_zeros_that_pad_are_missing_at_each_door():
    image = np.pad(DATA[0], 20)
    wcs = cube().wcs
    found = EpochCube.from_ccddata(NDData(image, wcs=wcs, meta={"DATE-OBS": DATES[0]}))
    assert np.array_equal(found.mask[0], image == 0)
    found = EpochCube.from_arrays([image], DATES[:1], pixel_scale=1 * u.mas)
    assert np.array_equal(found.mask[0], image == 0)
    assert np.array_equal(EpochCube([image], DATES[:1], wcs).mask, found.mask)
    for number in (-999.0, 1e20):
        filled = np.where(image == 0, number, image)
        with pytest.warns(EpochWarning, match="its pixels of exactly .* are taken"):
            found = EpochCube.from_arrays([filled], DATES[:1], pixel_scale=1 * u.mas)
        assert np.array_equal(found.mask[0], image == 0)
        own = NDData(filled, wcs=wcs, meta={"DATE-OBS": DATES[0]})
        with pytest.warns(EpochWarning, match="image 0: its pixels of exactly"):
            assert np.array_equal(EpochCube.from_ccddata(own).mask, found.mask)
