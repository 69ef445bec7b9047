# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features of the links of SSPs."""

import astropy.units as u
import numpy as np

from astro_scc.decomposition.wavelet import scale_size
from astro_scc.features import Features
from astro_scc.features.detecting import (
    finest_patterns,
    is_new,
    ssp_sizes,
    ssps_of,
)
from astro_scc.features.tracks import Track
from astro_scc.kinematics.ridge_line import mean_width
from astro_scc.tracking.candidates import core_ssps, lowest
from astro_scc.tracking.linking import chains


def linked_features(cube, ssps, links, *, select=None, min_epochs=3):
    """
    Return the features that links of SSPs make up, one row for each.

    A pattern that is followed on several scales is one feature, that of the finest
    scale.  Detections are the SSPs of these tracks, and of the others those that are
    not the same pattern, also the finest ones.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    links : `Links`
    select : array_like of bool, shape (n_ssps,), optional
        The SSPs that were linked.
    min_epochs : int, optional
        Fewest epochs of a track.

    Returns
    -------
    `~astro_scc.features.Features`
        There are no disturbed assignments, so ``agreement`` and ``same_speed`` are 1;
        no track is ``proven``, as the rounds of `link` need not find the best links.
    """
    core = core_ssps(ssps, cube)
    jet = ~core if select is None else np.asarray(select) & ~core
    size, keep = ssp_sizes(ssps), np.zeros(len(ssps), bool)
    tracks = []
    found = [t for t in chains(links, ssps, min_epochs=min_epochs) if jet[t].all()]
    for track in sorted(found, key=lambda track: size[track[0]]):
        if np.mean([is_new(ssps, keep, k) for k in track.tolist()]) > 0.5:
            keep[track] = True
            tracks.append(track)
    own = finest_patterns(ssps, keep, jet)
    number = np.full(len(ssps), -1)
    number[own] = np.arange(len(own))
    # Detections are in the order of the epochs.
    tracks = sorted((number[track] for track in tracks), key=lambda own: own[0])
    cores = np.flatnonzero(core)
    cores = cores[lowest(size[cores], ssps.epoch[cores])]
    fwhm = mean_fwhm(cube, np.unique(ssps.scale)).value
    return Features(
        cube=cube,
        detections=ssps_of(cube, ssps, own, fwhm),
        core=ssps_of(cube, ssps, cores, fwhm),
        tracks=tuple(Track(own, np.ones(len(own) - 1), 1.0, False) for own in tracks),
    )


def mean_fwhm(cube, scales):
    """Return the resolution in mas: the mean beam, or twice the middle scale."""
    if cube.beams is None:
        middle = np.exp(np.mean(np.log([scale_size(s) for s in scales])))
        return 2 * middle * cube.pixel_scale
    return mean_width(cube) * u.mas
