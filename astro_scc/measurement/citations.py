# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What a result rests on, as BibTeX."""

import re
from importlib import resources

from astro_scc.kinematics.cosmology import cosmology_text, paper_cosmology, to_cosmology
from astro_scc.writing import versions

#: What names the MOJAVE survey and its table of features in a history.
MOJAVE = re.compile(r"MOJAVE|apjac230ft4|J/ApJ/923/30")


def citations_of(history, meta):
    """
    Return what a measurement rests on as BibTeX.

    Parameters
    ----------
    history : sequence of str
        What was done to the images, and what they were compared with.
    meta : dict
        Of a table: its ``cosmology`` is cited.

    Returns
    -------
    str
        Entries, and comments on what has none.

    Examples
    --------
    >>> from astro_scc.measurement.citations import citations_of
    >>> text = citations_of(["components from MOJAVE"], {"cosmology": "Planck18"})
    >>> print("; ".join(line for line in text.splitlines() if line.startswith("@")))
    @article{mertens2016,; @article{mertens2015,; @software{astro_scc,;
    @article{lister2021,; @misc{cosmology,
    """
    text = resources.files("astro_scc.measurement").joinpath("citations.bib")
    version = versions()["astro_scc"]
    entries = text.read_text(encoding="utf-8").replace("VERSION", version)
    *parts, survey = entries.strip().split("\n\n")
    if any(MOJAVE.search(line) for line in history):
        parts.append(survey)
    else:
        parts.append("% Cite the survey or the observers of the images, too.")
    if "cosmology" in meta:
        parts.append(_cosmology(to_cosmology(meta["cosmology"])))
    return "\n\n".join(parts) + "\n"


def _cosmology(cosmology):
    """Return the source of a cosmology as an entry, or the cosmology as a comment."""
    from astropy.cosmology import available

    # Tables keep the parameters and the name, which astropy knows with its source.
    known = to_cosmology(cosmology.name) if cosmology.name in available else cosmology
    if source := known.meta.get("reference"):
        note = re.sub(r"([&%#_])", r"\\\1", source)
        return f"@misc{{cosmology,\n  note = {{{cosmology.name}: {note}}}\n}}"
    whose = ", as in mertens2016" if cosmology == paper_cosmology() else ""
    return f"% Cosmology: {cosmology_text(cosmology)}{whose}."
