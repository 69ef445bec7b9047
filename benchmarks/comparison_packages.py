# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
The packages that are compared, each used through its documented functions.

All get the same input: ten images, and the limit of 30 pixels per epoch for all speeds.
They return a `Sample` of velocities, and the speeds if the package itself derives them.
A package is imported when it is used.
"""

from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from io import StringIO
from itertools import pairwise

import astropy.units as u
import numpy as np
from common import PM_UNIT
from comparison_reading import ACROSS, LARGEST, Sample

#: If a package gives a vector for every position, those are used at which the earlier
#: image is brighter than this fraction of its maximum.
BRIGHT = 0.1
#: Step in pixels between the vectors that are used; the beam is 10 pixels wide.
EVERY = 4


@dataclass(frozen=True)
class Package:
    """
    One way to measure velocities in images.

    Attributes
    ----------
    name : str
    distribution : str
        Its name in the package index.
    license : str
    run : callable
        Takes a cube and settings, and returns (speeds or None, `Sample`).
    settings : dict
        Settings of the table.
    others : dict of tuple
        Other settings that were tried, see ``--choose``.
    cases : tuple of str, optional
        Names of the jets for which it is meant, if not all.
    about : str
        Text for the table if there are no settings.
    reason : str
        Why it has no answer, if it has none.
    """

    name: str
    distribution: str
    license: str
    run: Callable | None = None
    settings: dict = field(default_factory=dict)
    others: dict = field(default_factory=dict)
    cases: tuple = ()
    about: str = ""
    reason: str = ""

    @property
    def why_not(self):
        """Why there is no answer, or "" if there is one."""
        if self.reason:
            return self.reason
        return "" if self.version else f"not installed: pip install {self.distribution}"

    @property
    def version(self):
        """The installed version, or None."""
        try:
            return version(self.distribution)
        except PackageNotFoundError:
            return None


def pixel_an_epoch(cube):
    """Return the proper motion of one pixel per epoch."""
    return (cube.pixel_scale / np.diff(cube.years).mean()).to(PM_UNIT)


def of_pairs(cube, displacements):
    """Return the vectors (x, y, along, across) that a function finds in all pairs."""
    images = cube.data / cube.data.max()
    return Sample.of(
        (i, *displacements(images[i], images[i + 1])) for i in range(len(images) - 1)
    )


def bright(image, along, across):
    """Return the vectors of a field at bright pixels."""
    y, x = np.mgrid[: image.shape[0] : EVERY, : image.shape[1] : EVERY]
    use = image[y, x] > BRIGHT * image.max()
    y, x = y[use], x[use]
    return x, y, along[y, x], across[y, x]


def whole(cube, along, across):
    """Return one vector per pair of epochs, in the middle of the image."""
    y, x = ((n - 1) / 2 for n in cube.shape[1:])
    vectors = enumerate(zip(along, across, strict=True))
    return Sample.of((i, x, y, *vector) for i, vector in vectors)


# -- astro_scc ---------------------------------------------------------------------


def streams(cube):
    """Return speeds of streams, and displacements of the features."""
    from astro_scc import StackedCrossCorrelation

    step = pixel_an_epoch(cube)
    scc = StackedCrossCorrelation(
        scales=(1, 2, 3), max_speed=LARGEST * step, position_angle=270 * u.deg
    )
    result = scc(cube, n_trials=1000, rng=1)
    found = result.streams[np.isin(result.streams["kind"], ("moving", "stationary"))]
    speeds = np.sort((found["pm_parallel"] / step).to_value(u.one))
    return speeds, displacements(result)


def displacements(result):
    """Return the displacements of the features between consecutive epochs."""
    seen = result.feature_positions
    x, y = result.cube.offset_to_pixel(seen["ra_offset"], seen["dec_offset"])
    feature, epoch = np.asarray(seen["feature"]), np.asarray(seen["epoch"])
    order = np.lexsort([epoch, feature])
    parts = [
        (epoch[i], x[i], y[i], x[j] - x[i], y[j] - y[i])
        for i, j in pairwise(order)
        if feature[i] == feature[j] and epoch[j] == epoch[i] + 1
    ]
    return Sample.of(parts)


def links(epoch, x, y):
    """Return (pair, x, y, along, across) from each epoch of a track to the next."""
    gap = np.diff(epoch)
    along, across = np.diff(x) / gap, np.diff(y) / gap
    return zip(epoch[:-1], x[:-1], y[:-1], along, across, strict=True)


def aligned(cube):
    """Return the shifts that align whole images."""
    done = cube.align("correlate").meta["alignment"]
    east, north = (
        np.array([record[f"shift_{axis}_mas"] for record in done])
        / cube.pixel_scale.to_value(u.mas)
        for axis in ("east", "north")
    )
    # The alignment moves the image back by what it has moved; +x is west.
    return None, whole(cube, np.diff(east), -np.diff(north))


# -- the others --------------------------------------------------------------------


def trackpy(cube, *, diameter, separation, reach, predict):
    """Link blobs into trajectories."""
    import pandas as pd
    import trackpy as tp

    tp.quiet()
    images = cube.data / cube.data.max()
    blobs = pd.concat(
        tp.locate(
            image, diameter, minmass=1, separation=separation, engine="python"
        ).assign(frame=i)
        for i, image in enumerate(images)
    )
    how = {"memory": 1, "adaptive_stop": 2, "adaptive_step": 0.9}
    reach = (ACROSS, LARGEST) if reach == "jet" else LARGEST
    link = tp.predict.NearestVelocityPredict().link_df if predict else tp.link
    tracks = tp.filter_stubs(link(blobs, reach, **how), 3)
    parts = []
    for _, own in tracks.reset_index(drop=True).groupby("particle"):
        own = own.sort_values("frame")
        parts += links(*(own[k].to_numpy() for k in ("frame", "x", "y")))
    return None, Sample.of(parts)


def openpiv(cube, *, window, extended, sig2noise):
    """Correlate windows of each image with the next image."""
    from openpiv.pyprocess import extended_search_area_piv, get_coordinates

    search = window + 2 * int(LARGEST) if extended else window
    overlap = search - 2 * EVERY

    def displacements(a, b):
        frames = [(4095 * np.clip(image, 0, 1)).astype(np.int32) for image in (a, b)]
        along, across, ratio = extended_search_area_piv(
            *frames, window_size=window, overlap=overlap, search_area_size=search,
            normalized_correlation=True, sig2noise_method="peak2peak",
        )  # fmt: skip
        x, y = get_coordinates(a.shape, search, overlap)
        here = a[np.rint(y).astype(int), np.rint(x).astype(int)]
        use = (here > BRIGHT * a.max()) & (ratio >= sig2noise)
        return x[use], y[use], along[use], -across[use]

    return None, of_pairs(cube, displacements)


def openpiv_passes(cube, *, windows):
    """Correlate ever smaller windows, which follow the results of larger ones."""
    from openpiv.settings import PIVSettings
    from openpiv.windef import simple_multipass

    told = PIVSettings(
        windowsizes=windows,
        overlap=tuple(3 * window // 4 for window in windows),
        num_iterations=len(windows),
        normalized_correlation=True,
        min_max_u_disp=(-LARGEST, LARGEST),
        min_max_v_disp=(-LARGEST, LARGEST),
    )

    def displacements(a, b):
        frames = [(4095 * np.clip(image, 0, 1)).astype(np.int32) for image in (a, b)]
        with redirect_stdout(StringIO()):
            x, y, along, across, _ = simple_multipass(*frames, told)
        # OpenPIV counts y from the last row of the image, but rows from the first.
        y = len(a) - y
        use = a[np.rint(y).astype(int), np.rint(x).astype(int)] > BRIGHT * a.max()
        return x[use], y[use], along[use], -across[use]

    return None, of_pairs(cube, displacements)


def flow_ilk(cube, *, radius):
    """Measure optical flow by iterative Lucas-Kanade."""
    from skimage.registration import optical_flow_ilk

    def displacements(a, b):
        y, x = optical_flow_ilk(a, b, radius=radius)
        return bright(a, x, y)

    return None, of_pairs(cube, displacements)


def flow_tvl1(cube, *, attachment, tightness):
    """Measure optical flow of small total variation."""
    from skimage.registration import optical_flow_tvl1

    def displacements(a, b):
        y, x = optical_flow_tvl1(a, b, attachment=attachment, tightness=tightness)
        return bright(a, x, y)

    return None, of_pairs(cube, displacements)


def phase(cube, *, normalization):
    """Measure the shift of the whole image."""
    from skimage.registration import phase_cross_correlation

    shifts = np.array(
        [
            phase_cross_correlation(
                a, b, upsample_factor=100, normalization=normalization
            )[0]
            for a, b in zip(cube.data[:-1], cube.data[1:], strict=True)
        ]
    )
    # The shifts bring the later image onto the earlier one.
    return None, whole(cube, -shifts[:, 1], -shifts[:, 0])


def flct(cube, *, sigma, kr):
    """Measure motion by Fourier local correlation tracking."""
    from pyflct import flct as track

    def displacements(a, b):
        x, y, done = track(
            a, b, 1.0, 1.0, float(sigma), quiet=True, biascor=True, thresh=BRIGHT, kr=kr
        )
        return bright(np.where(done == 1, a, 0), x, y)

    return None, of_pairs(cube, displacements)


PACKAGES = (
    Package("astro_scc, streams", "astro_scc", "BSD-3-Clause", streams,
            about="scales 1 to 3, 1000 trials"),
    Package(
        "astro_scc, align", "astro_scc", "BSD-3-Clause", aligned,
        cases=("the whole image",), about="align('correlate')",
    ),
    Package(
        "trackpy", "trackpy", "BSD-3-Clause", trackpy,
        {"diameter": 11, "separation": None, "reach": "any", "predict": False},
        {"diameter": (7, 15), "separation": (5,), "reach": ("jet",),
         "predict": (True,)},
    ),
    Package(
        "OpenPIV", "OpenPIV", "GPL-3.0", openpiv,
        {"window": 48, "extended": False, "sig2noise": 1.0},
        {"window": (24, 32, 64), "extended": (True,), "sig2noise": (1.2,)},
    ),
    Package(
        "OpenPIV, passes", "OpenPIV", "GPL-3.0", openpiv_passes,
        {"windows": (64, 32, 16)}, {"windows": ((64, 48, 32),)},
    ),
    Package(
        "scikit-image, ILK", "scikit-image", "BSD-3-Clause", flow_ilk,
        {"radius": 7},
        {"radius": (10, 15, 25)},
    ),
    Package(
        "scikit-image, TV-L1", "scikit-image", "BSD-3-Clause", flow_tvl1,
        {"attachment": 50, "tightness": 0.3},
        {"attachment": (5, 15, 150), "tightness": (0.1,)},
    ),
    Package(
        "scikit-image, phase", "scikit-image", "BSD-3-Clause", phase,
        {"normalization": None}, {"normalization": ("phase",)},
    ),
    Package(
        "pyflct", "pyflct", "LGPL-2.1-or-later", flct,
        {"sigma": 30, "kr": 0.2}, {"sigma": (5, 10, 20), "kr": (None,)},
    ),
    Package(
        "VCAT", "vcat-vlbi", "GPL-3.0",
        reason="fits motions to components that a user has named, no unattended answer",
    ),
)  # fmt: skip
