# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What a survey measures: its file, and the sources that it names."""

import glob
import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path

from astro_scc.config import parse_setting, plain_settings
from astro_scc.config.files import read_toml
from astro_scc.config.measuring import settings_over
from astro_scc.config.settings import SETTINGS
from astro_scc.measurement import versions
from astro_scc.survey.names import folder_names

__all__ = ["Source", "Survey", "read_survey"]

#: Without a region, and without scale groups.
WHOLE = "all"
#: Settings of a measurement that are said in another way here, or not at all.
NOT_HERE = ("region", "bins", "window")
ALIGNMENTS = ("none", "core", "correlate", "wcs")
SEED = 1


@dataclass(frozen=True)
class Source:
    """
    One source of a survey.

    Attributes
    ----------
    name : str
    folder : str
        Name of the folder of its products.
    config : dict
        Settings of its measurement, see `astro_scc.config.read_config`.
    regions : dict of str
        Region files by name, or one None for everything.
    scale_groups : dict
        Scales by name, or one None for all that are decomposed.

    Examples
    --------
    >>> from pathlib import Path
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.survey import read_survey
    >>> simulate_two_fluid(n_epochs=5, rng=1).cube.write("jet.fits")
    >>> text = '''[sources.Jet]
    ... epochs = "jet.fits"
    ... scales = [2]
    ... max_speed = "30 mas/yr"
    ... n_trials = 20
    ... '''
    >>> _ = Path("survey.toml").write_text(text)
    >>> survey = read_survey("survey.toml")
    >>> source = survey.sources[0]
    >>> source.folder, source.config["scales"], source.regions
    ('Jet', (2.0,), {'all': None})
    """

    name: str
    folder: str
    config: dict = field(hash=False)
    regions: dict = field(hash=False)
    scale_groups: dict = field(hash=False)

    @property
    def parts(self):
        """Names of each region with each scale group."""
        return [(r, g) for r in self.regions for g in self.scale_groups]

    def key(self):
        """
        A check sum of all that determines the products.

        The settings, the versions of the packages, and names, sizes and
        times of the last change of the files, in content or otherwise.

        Returns
        -------
        str
        """
        known = {
            "config": plain_settings(self.config),
            "regions": self.regions,
            "scale_groups": {
                name: scales and plain_settings({"scales": scales})
                for name, scales in self.scale_groups.items()
            },
            "versions": versions(),
            "files": [_facts(path) for path in sorted(self._files())],
        }
        return hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()

    def _files(self):
        found = {path for path in self.regions.values() if path is not None}
        for pattern in self.config["epochs"]:
            found |= set(glob.glob(pattern)) or {pattern}
        if self.config.get("align", "none") not in ALIGNMENTS:
            found.add(self.config["align"])
        if "crop" in self.config:
            found.add(self.config["crop"])
        return found


def _facts(path):
    try:
        state = Path(path).stat()
    except OSError:
        return [str(path), None, None]
    # Of the content, which may be set back, and of anything about the file.
    return [str(path), state.st_size, state.st_mtime_ns, state.st_ctime_ns]


@dataclass(frozen=True)
class Survey:
    """
    Sources that are measured together.

    Attributes
    ----------
    sources : tuple of `Source`
    text : str
        The file, as it was read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.survey import read_survey
    >>> simulate_two_fluid(n_epochs=5, rng=1).cube.write("jet.fits")
    >>> text = '''[sources.Jet]
    ... epochs = "jet.fits"
    ... scales = [2]
    ... max_speed = "30 mas/yr"
    ... n_trials = 20
    ... '''
    >>> _ = Path("survey.toml").write_text(text)
    >>> survey = read_survey("survey.toml")
    >>> [source.name for source in survey.sources]
    ['Jet']
    """

    sources: tuple[Source, ...]
    text: str = ""


def read_survey(path):
    """
    Read the file of a survey.

    Parameters
    ----------
    path : path
        A TOML file: a table ``[sources.NAME]`` for each source with its
        ``epochs``, ``regions`` (a table of region files), ``scale_groups`` (a
        table of scales) and any setting of a measurement; and a table
        ``[defaults]`` with what holds where a source says nothing else.
        Paths are relative to the file.

    Returns
    -------
    `Survey`

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is no TOML, or a key or a value in it makes no sense.

    Examples
    --------
    >>> from pathlib import Path
    >>> from astro_scc.survey import read_survey
    >>> _ = Path("survey.toml").write_text('''
    ... [defaults]
    ... scale_groups = {fine = [1, 2], coarse = [3, 4]}
    ... [sources."3C 273"]
    ... epochs = "3c273/*.fits"
    ... redshift = 0.158
    ... ''')
    >>> survey = read_survey("survey.toml")
    >>> [(source.name, source.parts) for source in survey.sources]
    [('3C 273', [('all', 'fine'), ('all', 'coarse')])]
    """
    path = Path(path)
    values, text = read_toml(path)
    unknown = set(values) - {"defaults", "sources"}
    if unknown:
        raise ValueError(
            f"{path}: unknown key {sorted(unknown)[0]!r}; a survey has [defaults] and "
            "[sources.NAME]"
        )
    sources = _table(values.get("sources", {}), f"{path}: sources")
    if not sources:
        raise ValueError(f"{path}: names no source; add a table [sources.NAME]")
    folder = path.absolute().parent
    defaults = _settings(values.get("defaults", {}), f"{path}: defaults", folder)
    folders = folder_names(list(sources))
    found = []
    for name, values in sources.items():
        where = f"{path}: sources.{name}"
        own = _settings(values, where, folder)
        found.append(_source(name, folders[name], own, defaults, where))
    return Survey(tuple(found), text)


def _table(value, where):
    if not isinstance(value, dict):
        raise ValueError(f"{where} must be a table")
    return value


def _settings(values, where, folder):
    """Settings, regions and scale groups of a table of the file."""
    found = {}
    for name, value in _table(values, where).items():
        here = f"{where}: {name}"
        if name == "regions":
            files = {k: _text(v, f"{here}.{k}") for k, v in _table(value, here).items()}
            found[name] = {k: _path(v, folder) for k, v in files.items()}
        elif name == "scale_groups":
            found[name] = {
                k: _parsed("scales", v, f"{here}.{k}")
                for k, v in _table(value, here).items()
            }
        elif name not in SETTINGS or name in NOT_HERE:
            raise ValueError(
                f"{here} is no setting of a survey; they are regions, scale_groups "
                "and those of astro-scc measure but region"
            )
        else:
            found[name] = _parsed(name, value, here)
    if "epochs" in found:
        # What is special to patterns in the folder's own name is not meant so.
        escaped = glob.escape(str(folder))
        found["epochs"] = [_path(item, escaped) for item in found["epochs"]]
    if found.get("align", "none") not in ALIGNMENTS:
        found["align"] = _path(found["align"], folder)
    if "crop" in found:
        found["crop"] = _path(found["crop"], folder)
    return found


def _parsed(name, value, where):
    try:
        return parse_setting(name, value)
    except ValueError as error:
        raise ValueError(f"{where} = {value!r} {error}") from None


def _text(value, where):
    if not isinstance(value, str) or not value:
        raise ValueError(f"{where} must be the path of a region file")
    return value


def _path(text, folder):
    return str(Path(folder, text))


def _source(name, folder, own, defaults, where):
    try:
        config = settings_over({"seed": SEED, "n_trials": 1000, **defaults}, own)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    regions = config.pop("regions", None) or {WHOLE: None}
    groups = config.pop("scale_groups", None) or {WHOLE: None}
    if not config.get("epochs"):
        raise ValueError(f"{where} has no epochs; name the FITS files")
    if "redshift" not in config:
        config.pop("cosmology", None)
    if "scales" not in config and WHOLE not in groups:
        config["scales"] = _all_scales(groups.values(), where)
    return Source(name, folder, config, regions, groups)


def _all_scales(groups, where):
    import astropy.units as u
    import numpy as np

    groups = list(groups)
    if len({hasattr(group, "unit") for group in groups}) > 1:
        raise ValueError(
            f"{where}: scale_groups must be all numbers or all angles, or give scales"
        )
    if hasattr(groups[0], "unit"):
        return np.unique(u.Quantity([angle for group in groups for angle in group]))
    return tuple(sorted({number for group in groups for number in group}))
