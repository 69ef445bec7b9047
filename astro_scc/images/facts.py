# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Facts that tell whether images belong together."""

from astro_scc.images.cards import axis_of, axis_value, get

_STOKES = {1: "I", 2: "Q", 3: "U", 4: "V", -1: "RR", -2: "LL", -3: "RL", -4: "LR"}
_STOKES |= {-5: "XX", -6: "YY", -7: "XY", -8: "YX"}
#: Facts about an image, and their keywords; the first one is written.
FACTS = {
    "object": ("OBJECT", "TARGNAME"),
    "telescope": ("TELESCOP",),
    "frequency": ("FREQ", "FREQUENCY", "OBSFREQ", "RESTFRQ", "RESTFREQ"),
    "filter": ("FILTER", "FPA.FILTERID", "FILTERS"),
    "stokes": ("STOKES",),
    "wavelength": ("WAVELNTH", "WAVELEN", "WAVELENG"),
    "band": ("BAND", "BANDNAME"),
    "polarisation": ("POLARIZ", "POLARISA", "POLAR"),
    "channel": ("SPECTRAL",),
    "type": ("BTYPE",),
    "low": ("ENERGYLO", "ENERG_LO", "E_MIN"),
    "high": ("ENERGYHI", "ENERG_HI", "E_MAX"),
}
#: Names of axes of wavelengths and velocities.
SPECTRAL = "WAVE", "AWAV", "VRAD", "VOPT", "VELO", "FELO", "ZOPT", "ENER", "WAVN"
#: Units of frequency other than that of the standard, in Hz.
HERTZ = {"KHZ": 1e3, "MHZ": 1e6, "GHZ": 1e9}
#: Numbers of filter wheels.
WHEELS = "1", "2", "3", "01", "02", "03"


def header_facts(header):
    """
    Return the facts that tell whether images belong together.

    These are ``object``, ``telescope``, ``frequency`` (Hz), ``filter``, ``stokes``,
    ``wavelength``, ``band``, ``polarisation``, ``channel`` (on an axis of wavelengths
    or velocities) and ``type`` (of image), as far as the header has them.
    """
    facts = {
        fact: get(header, *keywords, kind=float if fact == "frequency" else str)
        for fact, keywords in FACTS.items()
    }
    if frequency := axis_value(header, "FREQ"):
        facts["frequency"] = frequency * _hertz(header)
    facts["filter"] = _filters(header, facts["filter"])
    if (stokes := axis_value(header, "STOKES")) is not None:
        facts["stokes"] = _STOKES.get(round(stokes))
    if facts["wavelength"] and not facts["wavelength"].endswith(("m", "A")):
        unit = get(header, "WAVEUNIT", kind=str) or ""
        # A power of ten stands for metres.
        unit = {"-9": "nm", "-10": "angstrom"}.get(unit, unit)
        value = get(header, *FACTS["wavelength"], kind=float)
        value = facts["wavelength"] if value is None else f"{value:g}"
        facts["wavelength"] = f"{value} {unit}".strip()
    for name in SPECTRAL:
        if (value := axis_value(header, name)) is not None:
            unit = get(header, f"CUNIT{axis_of(header, name)}", kind=str) or ""
            facts["channel"] = f"{name} {value:.7g} {unit}".strip()
    return {key: value for key, value in facts.items() if value is not None}


def bandwidth(header):
    """Return the width of a frequency channel in Hz, None without one."""
    axis = axis_of(header, "FREQ")
    step = axis and get(header, f"CDELT{axis}", kind=float)
    return abs(step) * _hertz(header) if step else None


def _hertz(header):
    """Return the unit of the axis of frequencies in Hz."""
    unit = get(header, f"CUNIT{axis_of(header, 'FREQ')}", kind=str) or ""
    return HERTZ.get(unit.upper(), 1.0)


def _filters(header, name):
    """Return the filters in the light path, of all wheels."""
    found = [] if name is None else [name]
    for start in ("FILTER", "FILTNAM") if name is None else ():
        wheels = (get(header, f"{start}{k}", kind=str) or "CLEAR" for k in WHEELS)
        found = found or [w for w in wheels if not w.upper().startswith("CLEAR")]
    # JWST has narrow filters in the wheel of the pupil.
    pupil = get(header, "PUPIL", kind=str) or "CLEAR"
    if name is not None and not pupil.upper().startswith(("CLEAR", "IMAGING")):
        found.append(pupil)
    return " + ".join(found) or None
