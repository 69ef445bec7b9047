# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Matches, and their files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from astro_scc.correlation import Matches
from astro_scc.decomposition import Decomposer, SSPs
from astro_scc.decomposition.decompose import Decomposition
from astro_scc.epochs import EpochCube
from astro_scc.exceptions import MeasurementWarning, warn
from astro_scc.features import Features, find_features
from astro_scc.images.serialize import read_object, without_dates, write_object
from astro_scc.measurement.decomposing import decompose_epochs, noise_facts
from astro_scc.measurement.tables import versions

#: What the files are, in their headers and in messages.
MATCHES = "astro_scc matches"
#: Words for parts in messages, where their names are not clear.
NAMES = {
    "data": "images",
    "mask": "masks",
    "wcs": "coordinates",
    "decomposition": "settings of the decomposition",
    "correlation": "settings of the correlation",
    "reach": "largest displacement",
}


@dataclass(frozen=True, eq=False, repr=False)
class MatchedEpochs:
    """
    Decomposed and correlated epochs: all that a stack needs except the dates.

    Attributes
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`
        That of every epoch.
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    select : `~numpy.ndarray` of bool, shape (n_ssps,)
        The SSPs of the region.
    matches : `~astro_scc.correlation.Matches`
    provenance : dict
        What determined the matches, see
        ``match_provenance``; `write` needs it.
    region : `~numpy.ndarray` of bool, shape (ny, nx), optional
        The pixels of the region; None for all.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=2, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    >>> matched = scc.match(cube)
    >>> int(matched.select.sum()) == len(matched.ssps)
    True
    >>> matched.write("matches.fits")
    >>> again = type(matched).read("matches.fits", cube)
    >>> len(again.matches) == len(matched.matches)
    True
    """

    cube: EpochCube
    decomposer: Decomposer
    ssps: SSPs
    select: np.ndarray
    matches: Matches
    provenance: dict = field(default_factory=dict)
    region: np.ndarray | None = None

    def __repr__(self):
        return (
            f"<MatchedEpochs: {len(self.cube)} epochs, "
            f"{int(self.select.sum())} SSPs, {len(self.matches)} matches>"
        )

    @property
    def scales(self) -> tuple[float, ...]:
        """Numbers of the scales that were decomposed."""
        return tuple(self.decomposer.scales)

    @property
    def decompositions(self) -> Sequence[Decomposition]:
        """Decompositions of all epochs, which are computed again at each access."""
        return decompose_epochs(self.cube, self.decomposer)

    @cached_property
    def features(self) -> Features:
        """
        The features that are followed from epoch to epoch.

        They are `~astro_scc.features.Features` of Gaussian models of the images or,
        without beams, of SSPs, inside the region.
        """
        return self.follow()

    def follow(self, **how: Any) -> Features:
        """
        Return the `features`, which are found only once.

        Parameters
        ----------
        **how
            ``n_workers`` and ``progress_bar`` of `~astro_scc.features.find_features`.

        Returns
        -------
        `~astro_scc.features.Features`
        """
        if "features" not in vars(self):
            of = {"ssps": self.ssps, "region": self.region}
            vars(self)["features"] = find_features(self.cube, **of, **how)
        return vars(self)["features"]

    def part(self, select: np.ndarray) -> MatchedEpochs:
        """
        Return the matches of some SSPs.

        Parameters
        ----------
        select : `~numpy.ndarray` of bool, shape (n_ssps,)

        Returns
        -------
        `MatchedEpochs`
        """
        found = replace(self, select=select)
        # The same features, which are found only once.
        vars(found)["features"] = self.features
        return found

    def write(self, path: Path | str, *, overwrite: bool = False) -> None:
        """
        Write the SSPs and their matches.

        Parameters
        ----------
        path : path
            A FITS file.
        overwrite : bool, optional

        Raises
        ------
        OSError
            If the file exists and ``overwrite`` is False, or cannot be
            written.
        ValueError
            If these matches have no ``provenance``.

        Notes
        -----
        The file holds neither the images nor their wavelet planes, which are
        quickly computed again.
        """
        if not self.provenance:
            raise ValueError(
                "these matches have no provenance and cannot be written: get them from "
                "StackedCrossCorrelation.match"
            )
        provenance, selected = self.provenance, selection_digest(self.select)
        if provenance["selected"] != selected:
            # No region that can be requested gives SSPs that were selected later.
            provenance = provenance | {"region": "chosen SSPs", "selected": selected}
        parts = replace(self, cube=None, provenance=provenance)
        write_object(parts, path, creator=MATCHES, overwrite=overwrite)

    @classmethod
    def read(
        cls, path: Path | str, cube: EpochCube, *, wanted: dict | None = None
    ) -> MatchedEpochs:
        """
        Read what `write` wrote.

        Parameters
        ----------
        path : path
        cube : `~astro_scc.epochs.EpochCube`
            The cube that was matched; its dates may differ.
        wanted : dict, optional
            Provenance that the matches must have; by default the images and
            versions must be the present ones.

        Returns
        -------
        `MatchedEpochs`
            With the dates of ``cube``.

        Raises
        ------
        OSError
            If the file cannot be read, or is not a file of matches.
        ValueError
            If it was made from other images, or by other settings or versions.
        """
        parts = read_object(path, creator=MATCHES)
        found = parts.provenance
        if wanted is None:
            wanted = {**image_provenance(cube), "versions": versions()}
        stale = [name for name, value in wanted.items() if found.get(name) != value]
        if stale:
            what = ", ".join(NAMES.get(name, name) for name in stale)
            raise ValueError(f"{path}: is of other {what}; match the epochs again")
        return replace(parts, cube=cube)


def kept_matches(path, cube, provenance):
    """
    Return the file for the matches of a provenance, and what it holds.

    Parameters
    ----------
    path : path or None
        A FITS file, or a folder for files of many provenances.
    cube : `~astro_scc.epochs.EpochCube`
    provenance : dict
        See `match_provenance`.

    Returns
    -------
    path : `~pathlib.Path` or None
    matched : `MatchedEpochs` or None

    Warns
    -----
    `~astro_scc.exceptions.MeasurementWarning`
        If there is a file but it cannot be used.
    """
    if path is None:
        return None, None
    path, matched = Path(path), None
    if path.suffix.lower() != ".fits":
        digest = _of_text(json.dumps(provenance, sort_keys=True))[:16]
        path /= f"matches-{digest}.fits"
    if path.exists():
        try:
            matched = MatchedEpochs.read(path, cube, wanted=provenance)
        except (OSError, ValueError) as error:
            why = str(error).removesuffix("; match the epochs again")
            warn(f"{why}; not used, the epochs are matched again", MeasurementWarning)
    return path, matched


def image_provenance(cube):
    """
    Return the images of a cube as digests: SHA-256 of values, masks, grid and beams.

    Dates are left out because matches do not depend on them.
    """
    # The dates are of the first epoch, and the pixel coordinates do not need them.
    wcs = without_dates(cube.wcs.to_header(relax=True))
    cards = [f"{card.keyword}={card.value!r}" for card in wcs.cards]
    beams = [
        tuple(float(axis.value) for axis in (beam.major, beam.minor, beam.pa))
        for beam in cube.beams or ()
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
    noise = noise_facts(cube, decomposer)
    made = {
        **image_provenance(cube),
        "decomposition": asdict(decomposer),
        "correlation": asdict(correlator),
        "noise": _of_text([(rms, np.asarray(beam).tolist()) for rms, beam in noise]),
        "reach": list(reach),
        "region": "everything" if inside is None else _of_array(np.packbits(inside)),
        "versions": versions(),
    }
    # Give it the types that it will have when it is read.
    return json.loads(json.dumps(made))


def selection_digest(select):
    """Return a short digest of a selection of SSPs."""
    return _of_array(np.asarray(select, dtype=bool))[:16]


def _of_array(array):
    array = np.ascontiguousarray(array)
    sum_ = hashlib.sha256(f"{array.dtype.str}{array.shape}".encode())
    sum_.update(array.data)
    return sum_.hexdigest()


def _of_text(*parts):
    return hashlib.sha256(repr(parts).encode()).hexdigest()
