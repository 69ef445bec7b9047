# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Survey: many sources measured alike, one table of all."""

from astro_scc.survey.names import folder_names
from astro_scc.survey.plan import Source, Survey, read_survey
from astro_scc.survey.run import run_survey
from astro_scc.survey.source import Outcome, measure_source
from astro_scc.survey.table import survey_table

__all__ = [
    "Outcome",
    "Source",
    "Survey",
    "folder_names",
    "measure_source",
    "read_survey",
    "run_survey",
    "survey_table",
]
