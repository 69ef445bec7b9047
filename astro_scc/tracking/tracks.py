# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features of the links of SSPs."""

import astropy.units as u
import numpy as np

from astro_scc.decomposition import scale_size
from astro_scc.epochs.positions import beam_fwhm, position_errors, ssp_offsets
from astro_scc.features import Detections, Features, Track
from astro_scc.features.finder import SAME_PATTERN
from astro_scc.kinematics.ridge_search import mean_width
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
    size = np.array([scale_size(scale) for scale in ssps.scale], dtype=float)
    keep, at = np.zeros(len(ssps), bool), np.stack([ssps.y, ssps.x], axis=1)

    def is_new(k):
        same = np.flatnonzero(keep & (ssps.epoch == ssps.epoch[k]))
        return not (np.hypot(*(at[same] - at[k]).T) <= SAME_PATTERN * size[k]).any()

    tracks = []
    found = [t for t in chains(links, ssps, min_epochs=min_epochs) if jet[t].all()]
    for track in sorted(found, key=lambda track: size[track[0]]):
        if np.mean([is_new(k) for k in track.tolist()]) > 0.5:
            keep[track] = True
            tracks.append(track)
    for k in np.lexsort((-ssps.snr, size)).tolist():
        keep[k] |= jet[k] and is_new(k)
    number = np.cumsum(keep) - 1
    detections = _detections(cube, ssps, np.flatnonzero(keep))
    # Detections are in the order of the epochs.
    tracks = sorted((number[track] for track in tracks), key=lambda own: own[0])
    cores = np.flatnonzero(core)
    return Features(
        cube=cube,
        detections=detections,
        core=_detections(cube, ssps, cores[lowest(size[cores], ssps.epoch[cores])]),
        tracks=tuple(Track(own, np.ones(len(own) - 1), 1.0, False) for own in tracks),
    )


def _detections(cube, ssps, own):
    """Return SSPs as detections, with the errors of positions from their SNR."""
    place = np.stack(ssp_offsets(ssps, cube), axis=1)
    fwhm = beam_fwhm(cube, ssps.epoch, ssps.scale, np.eye(2))
    if cube.beams is None:
        variance = mean_fwhm(cube, np.unique(ssps.scale)).value ** 2 / (8 * np.log(2))
        beam = variance * np.eye(2)
    else:
        beam = np.mean([one.covariance.value for one in cube.beams], axis=0)
    return Detections(
        epoch=ssps.epoch[own],
        place=place[own],
        place_error=position_errors(ssps.snr, fwhm, 0.0)[own],
        flux=ssps.flux[own],
        size=np.zeros(len(own)),
        years=cube.times[0].jyear + cube.years.to_value(u.yr),
        beam=beam,
    )


def mean_fwhm(cube, scales):
    """Return the resolution in mas: the mean beam, or twice the middle scale."""
    if cube.beams is None:
        middle = np.exp(np.mean(np.log([scale_size(s) for s in scales])))
        return 2 * middle * cube.pixel_scale
    return mean_width(cube) * u.mas
