# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""All that a result offers, in each frame of velocities."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation, kinematics
from astro_scc.flow import measure_acceleration, measure_field, measure_profile
from astro_scc.products import write_products
from astro_scc.report import write_report
from astro_scc.visualization import FIGURES

OPTIONS = {"scales": [1, 2, 3], "max_speed": 30 * u.mas / u.yr}
HERE = [0, 0] * u.mas
FRAMES = {
    "sky": kinematics.SkyFrame(),
    "position angle": kinematics.PositionAngleFrame(270 * u.deg),
    "radial": kinematics.RadialFrame(HERE),
    "ridge line": kinematics.RidgeLine([0, -8] * u.mas, [0, 0] * u.mas),
    "expansion": kinematics.ExpansionFrame(HERE, 6 * u.mas),
}


@pytest.mark.slow
@pytest.mark.parametrize("frame", FRAMES)
def test_each_frame_has_all_figures_files_and_questions(frame, decomposed, tmp_path):
    scc = StackedCrossCorrelation(**{**OPTIONS, "position_angle": FRAMES[frame]})
    result = scc.measure(decomposed, n_trials=99, rng=1)
    for name in FIGURES:
        if name != "paper":
            result.plot(name)
            plt.close("all")
    write_products(result, result.streams, tmp_path)
    write_report(result, tmp_path)
    found = measure_acceleration(result)
    assert ("radial flow" in str(found)) == (frame == "radial")
    profile = measure_profile(scc, decomposed, [2, 5, 9] * u.mas, n_trials=99, rng=1)
    assert profile.bins[0].to_value(u.mas).tolist() == [2, 5]
    if frame != "sky":
        field = measure_field(result, along=[2, 9] * u.mas, n_trials=19)
        assert np.isfinite(field.table["p_global"]).any()


def test_the_radius_of_an_expansion_is_that_of_the_shell(decomposed):
    frame = kinematics.ExpansionFrame(HERE, 0.1 * u.mas)
    scc = StackedCrossCorrelation(**{**OPTIONS, "position_angle": frame})
    with pytest.raises(ValueError, match="give that of the shell"):
        scc.measure(decomposed, n_trials=9, rng=1)
