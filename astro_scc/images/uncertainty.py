# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Uncertainties of pixels, and the noise of an image by them."""

import astropy.units as u
import numpy as np
from astropy.nddata import InverseVariance, StdDevUncertainty, VarianceUncertainty

from astro_scc.images.brightness import parse_unit
from astro_scc.images.extensions import UNCERTAIN

#: Uncertainties by the names that astropy writes.
UNCERTAINTIES = {
    kind.__name__: kind
    for kind in (StdDevUncertainty, VarianceUncertainty, InverseVariance)
}
#: Factor by which uncertainties of pixels may differ from the image's median.
EVEN = 1.5


def uncertainty_of(hdu, values, unit, mask):
    """
    Return what an extension tells of the uncertainty of an image, or None.

    ``values`` are its pixels in the part that is read; ``unit`` and ``mask`` are those
    of the image.
    """
    name, text = (hdu.header.get(key) for key in ("UTYPE", "BUNIT"))
    kind = UNCERTAINTIES[name if name in UNCERTAINTIES else UNCERTAIN[hdu.name]]
    given = None if text is None else parse_unit(text)
    values = np.array(values, dtype=float)
    if hdu.name != "UNCERT":
        # Telescopes write 0 where there is no error, and units that do not fit.
        values[~(values > 0)] = np.nan
        if np.isnan(values[~mask]).all():
            return None
        power = 2 if kind is VarianceUncertainty else 1
        if given is not None and not given.is_equivalent(unit**power):
            given = None
    return kind(values, unit=given, copy=False)


def uncertainty_noise(uncertainty, unit, mask, *, most=np.inf):
    """
    Return the noise of an image whose pixels have uncertainties.

    The noise is the median standard deviation of the valid pixels, in the ``unit`` of
    the image, which is also assumed for an NDUncertainty without a unit.  The function
    also returns a mask of the pixels without one that is finite and no larger than
    ``most`` where most pixels have a smaller one, and whether
    the pixels differ little.  An uncertainty that cannot be used raises a ValueError.
    """
    kind, sigma = type(uncertainty).__name__, uncertainty
    if uncertainty.array is None:
        raise ValueError("its uncertainty has no values; remove it")
    try:
        with np.errstate(divide="ignore", invalid="ignore"):
            if not isinstance(uncertainty, StdDevUncertainty):
                sigma = uncertainty.represent_as(StdDevUncertainty)
        factor = 1.0 if sigma.unit is None else sigma.unit.to(unit)
    except TypeError:
        names = ", ".join(UNCERTAINTIES)
        raise ValueError(
            f"its uncertainty is of type {kind}; give it as {names}"
        ) from None
    except u.UnitConversionError:
        raise ValueError(
            f"its {kind} is in {uncertainty.unit}, which does not fit "
            f"images in {unit.to_string() or 'no unit'}; correct or remove it"
        ) from None
    if np.any(np.asarray(uncertainty.array) < 0):
        raise ValueError("its uncertainty has negative values; correct or remove it")
    sigma = np.broadcast_to(np.asarray(sigma.array) * factor, mask.shape)
    bad = ~np.isfinite(sigma)
    valid = sigma[~(mask | bad)]
    if valid.size == 0:
        raise ValueError("its uncertainty is finite at no valid pixel; remove it")
    noise = np.median(valid)
    if 0 < noise < most:
        bad |= sigma > most
        valid = sigma[~(mask | bad)]
    even = valid.max() <= EVEN * noise and noise <= EVEN * valid.min()
    return noise * unit, bad, even
