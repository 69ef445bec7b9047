# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Matches as velocity samples along the axes of a frame, with their errors."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np

from astro_scc import kinematics
from astro_scc.correlation.correlate import target_ssps
from astro_scc.images import positions
from astro_scc.kinematics.frames import frame_displacements
from astro_scc.paper.stack import Displacements


@dataclass(frozen=True, eq=False, repr=False)
class VelocitySamples:
    """
    Matches as displacements along two axes, and where on the sky they are.

    Attributes
    ----------
    displacements : ``Displacements``
        In mas.
    position, motion : `~numpy.ndarray`, shape (n, 2)
        Place of the SSP of each match, and its displacement, east and north in mas.
    years : `~numpy.ndarray`, shape (n_epochs,)
        Dates in years, ascending.
    """

    displacements: Displacements
    position: np.ndarray
    motion: np.ndarray
    years: np.ndarray

    @property
    def interval(self) -> np.ndarray:
        """Time from the SSP's epoch to that of its match, in years, signed."""
        d = self.displacements
        return self.years[d.target] - self.years[d.reference]

    def within(self, pairs, limit):
        """
        Return which samples are of pairs of dates, in any direction, and slow enough.

        Parameters
        ----------
        pairs : ``DatePairs``
        limit : float
            Largest velocity along either axis, included.

        Returns
        -------
        `~numpy.ndarray` of bool, shape (n,)
        """
        d, paired = self.displacements, np.zeros((len(self.years),) * 2, dtype=bool)
        paired[pairs.first, pairs.second] = paired[pairs.second, pairs.first] = True
        way = limit * np.abs(self.interval)
        slow = (np.abs(d.d1) <= way) & (np.abs(d.d2) <= way)
        return paired[d.reference, d.target] & slow


def matched_displacements(matched, settings):
    """
    Return matches as displacements along the velocity axes, and the axes.

    Parameters
    ----------
    matched : `~astro_scc.matching.MatchedEpochs`
    settings : `~astro_scc.StackedCrossCorrelation`

    Returns
    -------
    samples : `VelocitySamples`
        Of the selected SSPs.  SSPs at which the frame has no axes count as
        SSPs without a match.
    frame : frame of `astro_scc.kinematics`
        Gives the two axes at the position of each SSP.
    """
    cube, ssps, select = matched.cube, matched.ssps, matched.select
    frame = velocity_frame(cube, settings.position_angle)
    fraction = settings.min_error_beams
    east, north = positions.ssp_offsets(ssps, cube)
    axes = np.asarray(frame.matrix(east, north))
    # A radial frame has no axes at its origin.
    known = select & np.isfinite(axes).all(axis=(-2, -1))
    matches = matched.matches.select(known[matched.matches.ssp])
    owner = matches.ssp
    pixels = np.stack([matches.dx, matches.dy], axis=-1).astype(float)
    sky = pixels @ cube.pixel_matrix.value.T
    position = np.stack([east[owner], north[owner]], axis=-1)
    d = frame_displacements(frame, position, sky)
    # The resolution in the epochs of SSPs and of their matches.
    here = positions.beam_fwhm(cube, ssps.epoch, ssps.scale, axes)[owner]
    own = ssps.scale[owner], axes if axes.ndim == 2 else axes[owner]
    there = positions.beam_fwhm(cube, matches.target, *own)
    ends = (ssps.snr[owner], here), (matches.target_snr, there)
    first, second = (positions.position_errors(*end, fraction) for end in ends)
    s = np.sqrt(first**2 + second**2)
    displacements = Displacements(
        d1=d[:, 0],
        d2=d[:, 1],
        s1=s[:, 0],
        s2=s[:, 1],
        weight=(matches.coefficient * matches.overlap).astype(float),
        reference=ssps.epoch[owner].astype(np.int32),
        target=matches.target.astype(np.int32),
        ssp=owner.astype(np.int32),
        target_ssp=target_ssps(matches, ssps).astype(np.int32),
        n_ssps=np.bincount(ssps.epoch[select], minlength=len(cube)),
    )
    years = cube.years.to_value(u.yr)
    samples = VelocitySamples(displacements, position, sky, years)
    return samples, frame


def velocity_frame(cube, position_angle):
    """Return the velocity axes for a setting."""
    match position_angle:
        case u.Quantity():
            return kinematics.PositionAngleFrame(position_angle)
        case "fit":
            angle, _ = kinematics.fit_position_angle(cube)
            return kinematics.PositionAngleFrame(angle)
        case "ridge":
            return kinematics.find_ridge_line(cube)
        case "radial":
            return kinematics.RadialFrame()
        case None | "any":
            return kinematics.SkyFrame()
    return position_angle


def alignment_errors(cube, error=None):
    """
    Return the standard error of the alignment of each epoch on both axes.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    error : `~astropy.units.Quantity`, optional
        One error for all epochs, or one per epoch.  The default is the error
        of each epoch's last alignment, or zero without it.

    Returns
    -------
    `~numpy.ndarray`, shape (n_epochs, 2)
        In mas.

    Raises
    ------
    ValueError
        If ``error`` has neither one element nor one per epoch.
    """
    n, names = len(cube), ("shift_east_err_mas", "shift_north_err_mas")
    if error is None:
        last = {record["epoch"]: record for record in cube.meta.get("alignment", ())}
        records = [last.get(label, {}) for label in cube.labels]
        left = [[record.get(name) or 0.0 for name in names] for record in records]
        each = np.sqrt(np.mean(np.square(left, dtype=float), axis=1))
    else:
        each = np.atleast_1d(error.to_value(u.mas)).astype(float)
        if each.shape not in ((1,), (n,)):
            raise ValueError(
                f"alignment_error must be 1 or {n} angles, got {each.size}"
            )
    return np.broadcast_to(each[:, None], (n, 2))
