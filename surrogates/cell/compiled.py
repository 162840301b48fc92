"""The fitted cell in the compiled kernels: of particles, or of the sheet whose material it was identified to be."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cloth_envs.material import Material
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.particles.solver import Cell, ParticleSolver, make_kernel, mass_spring_cell, net_of
from cloth_envs.scene import Scene

SHEET = ("stretch_stiffness", "shear_stiffness", "bend_stiffness", "damping", "gravity")
# A sheet's cell class by class: three branches of its edges in the order of ``stencil.edges``, bending, the weight.
# Twist is a sum of what the first branches multiply, so no class of its own: half of it goes with either bending.
EDGES = ("along", "down", "right_diagonal", "left_diagonal")
CLASSES = (
    *(f"{branch}_{edge}" for branch in ("alpha", "beta", "gamma") for edge in EDGES),
    *("bend_along", "bend_down", "bias_x", "bias_y", "bias_z"),
)
# Columns: which classes each number of ``SHEET`` stands for once a spring is a spring; then the sideways bias.
SHARED = np.zeros((len(CLASSES), 7))
SHARED[np.arange(17), [0, 0, 1, 1, 0, 0, 1, 1, 3, 3, 3, 3, 2, 2, 5, 6, 4]] = 1.0


def dimensional(scene: Scene, arrays: Mapping[str, np.ndarray]) -> Cell:
    """The cell of a checkpoint's ``arrays`` for the particles of ``scene``, whatever their stiffness and mass."""
    law, weight = mass_spring_cell(scene), net_of(scene).node_mass * scene.gravity
    return Cell(law.coefficients * arrays["coefficients"], weight * arrays["bias"], float(arrays["eps"][0]))


def dimensionless(scene: Scene, cell: Cell) -> dict[str, np.ndarray]:
    """The arrays of a checkpoint, of which ``dimensional`` makes ``cell`` again on particles like the scene's."""
    law, weight = mass_spring_cell(scene), net_of(scene).node_mass * scene.gravity
    numbers = cell.coefficients / law.coefficients
    return {"coefficients": numbers, "bias": cell.bias / weight, "eps": np.array([cell.eps])}


class CellNet(ParticleSolver):
    """A net of particles whose forces are those of ``cell``; the simulator's kernel, step, contact and ``options``.

    A convolution reads the velocities as they were before the step, where the simulator's loop changes them in place.
    """

    def __init__(self, scene: Scene, cell: Cell, *, dtype: str = "float32", **options: int) -> None:
        super().__init__(scene, dtype=dtype, **options)
        self._kernel = make_kernel(scene, cell, in_place=False, dtype=self.dtype.name)


def felt_as(material: Material, factors: Mapping[str, float]) -> Material:
    """The material that a cell of these ``factors`` steps ``material`` as."""
    return material.with_changes(**{name: getattr(material, name) * factor for name, factor in factors.items()})


class CellSheet(ExplicitSolver):
    """A sheet whose material is what a cell was identified to be; kernel, contact and ``options`` are the reference's.

    ``factors`` multiply the material's stretch, shear, bending and damping, and the scene's gravity (``SHEET``).
    """

    def __init__(self, scene: Scene, factors: Mapping[str, float], **options: Any) -> None:
        self._factors = dict(factors)
        gravity = scene.gravity * self._factors.pop("gravity")
        super().__init__(replace(scene, gravity=gravity), **options)
        self.scene = scene

    def check_material(self, material: Material) -> None:
        super().check_material(felt_as(material, self._factors))

    def set_materials(self, which: Sequence[int], materials: Sequence[Material]) -> None:
        super().set_materials(which, [felt_as(m, self._factors) for m in materials])
