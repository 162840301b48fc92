"""The laws in plain NumPy: the definition of every force and contact, and the oracle of the compiled kernels.

``sheet`` (springs, dashpots, bending, weight), ``air`` (wind, pressure), ``bodies`` (contact), ``step`` (what is
driven, and a frame of them all), ``particles`` (the net of Zhao 2024); ``stencil``, ``diagnostics`` and
``budget`` beside them. All is computed in float64, one vertex class at a time, with nothing saved or reused: read it,
do not run it on anything large.
"""

from cloth_envs.physics.laws.air import pressure_energy, pressure_forces, wind_forces
from cloth_envs.physics.laws.sheet import (
    Forces,
    Materials,
    bend_energy,
    bend_forces,
    damper_forces,
    gravity_energy,
    gravity_forces,
    kinetic_energy,
    masses,
    spring_energy,
    spring_forces,
)
from cloth_envs.physics.laws.step import hermite, step, total_forces

__all__ = [
    "Forces",
    "Materials",
    "bend_energy",
    "bend_forces",
    "damper_forces",
    "gravity_energy",
    "gravity_forces",
    "hermite",
    "kinetic_energy",
    "masses",
    "pressure_energy",
    "pressure_forces",
    "spring_energy",
    "spring_forces",
    "step",
    "total_forces",
    "wind_forces",
]
