# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What determines the matches of a cube, so that old ones are known."""

import hashlib
import json
from dataclasses import asdict

import numpy as np

from astro_scc.measurement.decomposing import noise_facts
from astro_scc.measurement.tables import versions

#: How each part is called in messages.
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
        SHA-256 of the values, masks, coordinates of the pixels and beams.
        Dates are not among them: matches do not know them.
    """
    wcs = cube.wcs.to_header(relax=True)
    # Of the first epoch; the pixels are where they are on any date.
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
    All that determines the matches of a cube.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`
    correlator : `~astro_scc.correlation.Correlator`
    reach : tuple of int
        Largest displacement in pixels.
    inside : `~numpy.ndarray` of bool, shape (ny, nx), or None
        The region, or everything.

    Returns
    -------
    dict
        Text, numbers and lists, which JSON can hold.  The dates of the epochs
        enter through their order and ``reach`` alone.
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
    # As it will be when it is read.
    return json.loads(json.dumps(made))


def digest_of(provenance):
    """
    A provenance as a short text.

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
    A selection of SSPs as a short text.

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
    What of a provenance is not as it is wanted.

    Parameters
    ----------
    found, wanted : dict
        Only what is in ``wanted`` is compared.

    Returns
    -------
    str
        Such as ``"images, versions"``; empty if all is the same.
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
