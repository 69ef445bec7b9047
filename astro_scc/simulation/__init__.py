# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Simulation: images of jets and shells with known velocities."""

from astro_scc.simulation.jets import (
    JetSimulation,
    simulate_ballistic,
    simulate_jet,
    simulate_random_velocity,
    simulate_resolved_jet,
    simulate_shell,
    simulate_static,
    simulate_two_fluid,
    simulate_unrelated,
    write_simulation,
)
from astro_scc.simulation.streams import Flow, Layer, Stream, m87_layers

__all__ = [
    "Flow", "JetSimulation", "Layer", "Stream", "m87_layers", "simulate_ballistic",
    "simulate_jet", "simulate_random_velocity", "simulate_resolved_jet",
    "simulate_shell", "simulate_static", "simulate_two_fluid", "simulate_unrelated",
    "write_simulation",
]  # fmt: skip
