# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What determines the matches of a cube, so that outdated ones are recognised."""

import hashlib
import json
from dataclasses import asdict

import numpy as np

from astro_scc.measurement.decomposing import noise_facts
from astro_scc.measurement.tables import versions

#: What each part is called in messages.
NAMES = {
    "data": "images",
    "mask": "masks",
    "wcs": "coordinates",
    "beams": "beams",
    "decomposition": "settings of the decomposition",
    "correlation": "settings of the correlation",
    "noise": "noise",
    "reach": "largest displacement",
    "region": "region",
    "versions": "versions",
}


def image_provenance(cube):
    """
    Return the images of a cube as digests.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`

    Returns
    -------
    dict of str
        SHA-256 of the values, masks, pixel coordinates and beams.  Dates are
        left out because matches do not depend on them.
    """
    wcs = cube.wcs.to_header(relax=True)
    # These are of the first epoch, and the pixel coordinates do not depend on them.
    dates = ("DATE", "MJD")
    cards = [
        f"{card.keyword}={card.value!r}"
        for card in wcs.cards
        if not card.keyword.startswith(dates)
    ]
    beams = [
        (
            float(b.major.to_value("mas")),
            float(b.minor.to_value("mas")),
            float(b.pa.to_value("deg")),
        )
        for b in cube.beams or ()
    ]
    return {
        "data": _of_array(cube.data),
        "mask": _of_array(np.packbits(cube.mask)),
        "wcs": _of_text(cards, cube.pixel_matrix.value.tolist()),
        "beams": _of_text(beams),
    }


def match_provenance(cube, decomposer, correlator, reach, inside):
    """
    Return all that determines the matches of a cube.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`
    correlator : `~astro_scc.correlation.Correlator`
    reach : tuple of int
        Largest displacement in pixels.
    inside : `~numpy.ndarray` of bool, shape (ny, nx), or None
        The region, or None for everything.

    Returns
    -------
    dict
        Text, numbers and lists, which JSON can hold.  The dates of the epochs
        enter only through their order and through ``reach``.
    """
    facts = [
        (rms, None if beam is None else np.asarray(beam).tolist())
        for rms, beam in noise_facts(cube, decomposer)
    ]
    made = {
        **image_provenance(cube),
        "decomposition": asdict(decomposer),
        "correlation": asdict(correlator),
        "noise": _of_text(facts),
        "reach": list(reach),
        "region": "everything" if inside is None else _of_array(np.packbits(inside)),
        "versions": versions(),
    }
    # Give it the types that it will have when it is read.
    return json.loads(json.dumps(made))


def digest_of(provenance):
    """
    Return a short digest of a provenance.

    Parameters
    ----------
    provenance : dict

    Returns
    -------
    str
        16 hexadecimal digits.
    """
    return _of_text(json.dumps(provenance, sort_keys=True))[:16]


def selection_digest(select):
    """
    Return a short digest of a selection of SSPs.

    Parameters
    ----------
    select : `~numpy.ndarray` of bool, shape (n_ssps,)

    Returns
    -------
    str
    """
    return _of_array(np.asarray(select, dtype=bool))[:16]


def stale_parts(found, wanted):
    """
    Name the parts of a provenance that are not the wanted ones.

    Parameters
    ----------
    found, wanted : dict
        Only what is in ``wanted`` is compared.

    Returns
    -------
    str
        For example ``"images, versions"``; empty if all parts agree.
    """
    return ", ".join(
        NAMES.get(name, name)
        for name, value in wanted.items()
        if found.get(name) != value
    )


def _of_array(array):
    array = np.ascontiguousarray(array)
    sum_ = hashlib.sha256(f"{array.dtype.str}{array.shape}".encode())
    sum_.update(array.data)
    return sum_.hexdigest()


def _of_text(*parts):
    return hashlib.sha256(repr(parts).encode()).hexdigest()
