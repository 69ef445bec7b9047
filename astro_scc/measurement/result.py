# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What a measurement found."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.nddata import NDData
from astropy.wcs import WCS

from astro_scc.correlation import Matches
from astro_scc.decomposition import SSPs
from astro_scc.epochs import EpochCube, name_by_frame
from astro_scc.epochs.positions import axis_words
from astro_scc.kinematics import table_in_c
from astro_scc.measurement.diagram_image import diagram_image
from astro_scc.measurement.tables import component_table, feature_table, ssp_table
from astro_scc.stacking import (
    DatePairs,
    Search,
    VelocityGrid,
    VelocityPeak,
    VelocitySamples,
)
from astro_scc.stacking.errors import JitteredVelocity, StreamVelocity
from astro_scc.stacking.permutations import PermutedStacks
from astro_scc.stacking.stack import sample_velocities

__all__ = ["MatchedEpochs", "SCCResult"]

#: A match belongs to a component within this many of its standard errors.
MEMBER_SIGMA = 2.0
#: Errors of a normal distribution above its mean at the one-sided limit of 95%.
LIMIT = 1.645


@dataclass(frozen=True, eq=False, repr=False)
class MatchedEpochs:
    """
    Epochs decomposed and correlated: all that a stack needs but the dates.

    Attributes
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decompositions : sequence of `~astro_scc.decomposition.Decomposition`
        Made again when they are asked for.
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    select : `~numpy.ndarray` of bool, shape (n_ssps,)
        The SSPs of the region.
    matches : `~astro_scc.correlation.Matches`
    provenance : dict
        What determined the matches, see
        `astro_scc.measurement.match_provenance`; `write` needs it.

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
    decompositions: Sequence
    ssps: SSPs
    select: np.ndarray
    matches: Matches
    provenance: dict = field(default_factory=dict)

    def __repr__(self):
        return (
            f"<MatchedEpochs: {len(self.cube)} epochs, "
            f"{int(self.select.sum())} SSPs, {len(self.matches)} matches>"
        )

    @property
    def scales(self):
        """Numbers of the scales that were decomposed."""
        return tuple(getattr(self.decompositions, "scales", ())) or tuple(
            self.decompositions[0].scales
        )

    def write(self, path, *, overwrite=False):
        """
        Write the SSPs and their matches, see `astro_scc.measurement.write_matches`.

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
        """
        from astro_scc.measurement.match_files import write_matches

        write_matches(self, path, overwrite=overwrite)

    @classmethod
    def read(cls, path, cube):
        """
        Read what `write` wrote, see `astro_scc.measurement.read_matches`.

        Parameters
        ----------
        path : path
        cube : `~astro_scc.epochs.EpochCube`
            The same that was matched; its dates may be others.

        Returns
        -------
        `MatchedEpochs`

        Raises
        ------
        OSError
            If the file cannot be read, or is not of this kind.
        ValueError
            If it is of other images or versions.
        """
        from astro_scc.measurement.match_files import read_matches

        return read_matches(path, cube)


@dataclass(frozen=True, eq=False, repr=False)
class SCCResult:
    """
    The stacked cross-correlation of a cube and its velocity components.

    Attributes
    ----------
    matched : `MatchedEpochs`
    frame : frame of `astro_scc.kinematics`
        The two velocity axes.
    position_angle : `~astropy.units.Quantity`
        Direction of the jet, to which ``pm_parallel`` refers.
    pairs : `~astro_scc.stacking.DatePairs`
    displacements : `~astro_scc.stacking.VelocitySamples`
    grid : `~astro_scc.stacking.VelocityGrid`
        In mas/yr.
    coefficient, z_score : `~numpy.ndarray`, shape ``grid.shape``
        The stack and its significance.
    permuted : `~astro_scc.stacking.permutations.PermutedStacks`
        Mean and standard deviation of the stacks of permuted epochs.
    search : `~astro_scc.stacking.Search`
        The streams, and the displacement-interval diagram they are found on.
    velocities : tuple of `~astro_scc.stacking.errors.StreamVelocity`
        Of the streams, with their errors.
    maxima : tuple of `~astro_scc.stacking.VelocityPeak`
        Of the stack, the nearest one to each velocity.
    jitters : tuple of `~astro_scc.stacking.errors.JitteredVelocity`
        The velocity-jitter test, the paper's uncertainty.
    meta : dict
        Settings, seed and versions.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    >>> result = scc(cube, n_trials=20, rng=1)
    >>> result.coefficient.shape == result.grid.shape
    True
    >>> len(result.components) == len(result.search.streams)
    True
    """

    matched: MatchedEpochs
    frame: object
    position_angle: u.Quantity
    pairs: DatePairs
    displacements: VelocitySamples
    grid: VelocityGrid
    coefficient: np.ndarray
    z_score: np.ndarray
    permuted: PermutedStacks
    search: Search
    velocities: tuple[StreamVelocity, ...]
    maxima: tuple[VelocityPeak, ...]
    jitters: tuple[JitteredVelocity, ...]
    meta: dict = field(default_factory=dict)

    def __repr__(self):
        return f"<SCCResult: {len(self.maxima)} components of {self.matched.cube!r}>"

    def _repr_html_(self):
        from astro_scc.measurement.notebook import result_html

        return result_html(self)

    @property
    def errors(self):
        """Covariance of each velocity, as it is quoted."""
        return tuple(velocity.covariance for velocity in self.velocities)

    @property
    def cube(self):
        """The epochs that were measured."""
        return self.matched.cube

    @cached_property
    def ssps(self):
        """The SSPs of all epochs as a `~astropy.table.QTable`."""
        return ssp_table(self.matched.ssps, self.cube, select=self.matched.select)

    @cached_property
    def features(self):
        """The features that were followed, a `~astropy.table.QTable`."""
        return feature_table(self)

    @cached_property
    def components(self):
        """
        The velocity components, a `~astropy.table.QTable`.

        One row a stream, those that move first, by their number of features, then
        what stands still.  If nothing moves significantly, the first row is
        the strongest speed that was tested, "not significant", and its
        ``note`` says why.  The meta holds the settings, the seed and the
        versions.
        """
        rows = [self._row(number) for number in range(1, len(self.maxima) + 1)]
        return name_by_frame(component_table(rows, meta=dict(self.meta)), self.cube)

    def components_in_c(self, *, redshift=None, cosmology=None, distance=None):
        """
        The components with apparent speeds in units of c.

        Parameters
        ----------
        redshift : float, str or `~astropy.units.Quantity`, optional
        cosmology : `~astropy.cosmology.FLRW` or str, optional
            Of the redshift, or its name; by default
            `~astro_scc.kinematics.paper_cosmology`.
        distance : `~astropy.units.Quantity` or str, optional
            Of a nearby source, instead of a redshift.

        Returns
        -------
        `~astropy.table.QTable`
            `components` with the columns ``beta_app`` and ``beta_app_err``,
            the speed ``pm`` in units of c, see
            `~astro_scc.kinematics.table_in_c`.  What it was made with is in
            its meta.

        Raises
        ------
        ValueError
            If neither a redshift nor a distance is given, or one is none.
        """
        return table_in_c(
            self.components, redshift=redshift, cosmology=cosmology, distance=distance
        )

    def velocity_map(self, which="coefficient"):
        """
        The stack as an image with velocity coordinates.

        Parameters
        ----------
        which : {"coefficient", "z_score"}

        Returns
        -------
        `~astropy.nddata.NDData`
            Its WCS is linear in mas/yr along the two axes of the frame.

        Raises
        ------
        ValueError
            For another name.
        """
        if which not in ("coefficient", "z_score"):
            raise ValueError(f"unknown map {which!r}: use 'coefficient' or 'z_score'")
        wcs = WCS(naxis=2)
        names = list(self.frame.axis_names)
        if names == ["east", "north"] and axis_words(self.cube)[0] != "east":
            names = ["lon", "lat"]
        wcs.wcs.ctype = [name.upper()[:8] for name in names]
        wcs.wcs.cunit = ["mas/yr", "mas/yr"]
        wcs.wcs.crpix = [(n + 1) / 2 for n in self.grid.shape[::-1]]
        wcs.wcs.crval = [0.0, 0.0]
        wcs.wcs.cdelt = self.grid.step
        return NDData(getattr(self, which), wcs=wcs, meta={"axes": tuple(names)})

    def diagram(self):
        """
        The displacement-interval diagram along the direction of the streams.

        What moves at a constant speed lies on a ray from the origin, what
        stands still at no displacement.

        Returns
        -------
        `~astropy.nddata.NDData`
            Matches per pair of dates beyond those of permuted epochs, weighted
            by their coefficients, shape (n_displacements, n_intervals); NaN at
            intervals that no two dates have.  The axes of the WCS are the
            interval, logarithmic as its bins are (FITS ``-LOG``), and the
            displacement in mas.  The meta holds the mean ``interval`` and the
            ``n_pairs`` of each bin, the ``beam`` along the displacement, its
            ``direction`` on the axes of the frame, and its ``position_angle``
            if that is the same everywhere, else None.

        Examples
        --------
        >>> import astropy.units as u
        >>> from astro_scc import StackedCrossCorrelation
        >>> from astro_scc.simulation import simulate_two_fluid
        >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
        >>> result = scc(simulate_two_fluid(n_epochs=5, rng=1).cube, n_trials=20, rng=1)
        >>> diagram = result.diagram()
        >>> diagram.data.shape[1] == len(diagram.meta["n_pairs"])
        True
        """
        return diagram_image(self)

    def members(self, number):
        """
        The matches that make a component.

        Parameters
        ----------
        number : int
            Of the component, from 1.

        Returns
        -------
        `~numpy.ndarray` of int
            Indices into ``displacements``: matches between SSPs of one
            feature of the stream; where no feature was followed, those
            between dates of the map within two standard errors of the
            velocity on both axes.

        Raises
        ------
        ValueError
            If there is no such component.
        """
        if not 1 <= number <= len(self.maxima):
            raise ValueError(f"no component {number}: there are {len(self.maxima)}")
        d, features = self.displacements, self.search.streams[number - 1].features
        if features:
            label = np.full(len(self.matched.ssps), -1)
            for k, feature in enumerate(features):
                label[feature.ssp] = k
            there = np.where(d.target_ssp >= 0, label[d.target_ssp], -1)
            return np.flatnonzero((there >= 0) & (label[d.ssp] == there))
        v = self.velocities[number - 1].value
        index, v1, v2, s1, s2, _ = sample_velocities(d, self.pairs)
        near = (np.abs(v1 - v[0]) <= MEMBER_SIGMA * s1) & (
            np.abs(v2 - v[1]) <= MEMBER_SIGMA * s2
        )
        return index[near]

    def plot(self, **kwargs):
        """
        Draw the velocity map with its components.

        Parameters
        ----------
        **kwargs
            Passed to `astro_scc.visualization.plot_velocity_map`.

        Returns
        -------
        `matplotlib.figure.Figure`
        """
        from astro_scc.visualization import plot_velocity_map

        return plot_velocity_map(self, **kwargs)

    def _row(self, number):
        peak, stream = self.maxima[number - 1], self.search.streams[number - 1]
        velocity, jitter = self.velocities[number - 1], self.jitters[number - 1]
        member = self.members(number)
        d = self.displacements
        pairs = np.stack([d.reference[member], d.target[member]])
        p, n = stream.p_global, len(self.search.permutations.permuted)
        row = {
            "component": number,
            "kind": stream.kind,
            "dispersion": velocity.dispersion,
            "dispersion_err": velocity.dispersion_error,
            "coefficient": peak.coefficient,
            "z_score": float(self.z_score[peak.row, peak.column]),
            "p_local": stream.p_local,
            "p_global": p,
            "p_global_err": np.sqrt(p * (1 - p) / n),
            "p_distinct": stream.p_distinct,
            "p_smallest": self.search.permutations.smallest_p,
            "n_ssp": len(np.unique(d.ssp[member])),
            "n_pairs": len(
                np.unique(pairs.min(axis=0) * d.n_epochs + pairs.max(axis=0))
            ),
            "n_features": len(stream.features),
            # ECSV takes empty text for a missing value.
            "note": stream.reason or "-",
        }
        where = self.frame, self.position_angle
        row.update(_vectors(velocity.value, velocity.covariance, *where))
        for name, covariance in (
            ("jitter", jitter.covariance),
            ("alignment", velocity.alignment),
        ):
            row[f"pm_err_{name}"] = _vectors(velocity.value, covariance, *where)[
                "pm_err"
            ]
        still = stream.kind != "moving"
        row["pm_limit"] = row["pm"] + LIMIT * row["pm_err"] if still else np.nan
        return row


def _root(variance):
    # That of errors along a line only is zero across it, but for rounding.
    return np.sqrt(np.maximum(variance, 0.0))


def _vectors(velocity, covariance, frame, position_angle):
    """
    Components of a velocity and their errors, on the sky and to the jet.

    Errors that the data do not give are NaN.
    """
    if not np.all(np.isfinite(covariance)):
        row = _vectors(velocity, np.zeros((2, 2)), frame, position_angle)
        row.update(dict.fromkeys([n for n in row if n.endswith("_err")], np.nan))
        return row
    if frame.uniform:
        to_sky = np.linalg.inv(frame.matrix(0.0, 0.0))
        sky, sky_covariance = to_sky @ velocity, to_sky @ covariance @ to_sky.T
        pa = position_angle.to_value(u.rad)
        jet = np.array([[np.sin(pa), np.cos(pa)], [np.cos(pa), -np.sin(pa)]])
        along, along_covariance = jet @ sky, jet @ sky_covariance @ jet.T
    else:
        # Away from a point or along a bend there is no one direction on the sky.
        sky, sky_covariance = np.full(2, np.nan), np.full((2, 2), np.nan)
        along, along_covariance = velocity, covariance
    speed = float(np.hypot(*along))
    unit = along / speed if speed > 0 else np.array([1.0, 0.0])
    across = np.array([-unit[1], unit[0]])
    speed_err = _root(unit @ along_covariance @ unit)
    pa_err = np.pi
    if not frame.uniform:
        pa_err = np.nan
    elif speed > 0:
        # No direction is more than half a turn off.
        across_err = _root(across @ along_covariance @ across)
        pa_err = np.minimum(across_err, np.pi * speed) / speed
    names = ("pm_ra_cosdec", "pm_dec", "pm_parallel", "pm_transverse")
    row = dict(zip(names, map(float, (*sky, *along)), strict=True))
    variances = (*np.diag(sky_covariance), *np.diag(along_covariance))
    for name, variance in zip(names, variances, strict=True):
        row[f"{name}_err"] = float(_root(variance))
    row["pm"], row["pm_err"] = speed, float(speed_err)
    row["pm_pa"] = float(np.degrees(np.arctan2(*sky)) % 360)
    row["pm_pa_err"] = float(np.degrees(pa_err))
    return row
