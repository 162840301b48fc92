"""Which grid a cloth's folds need, and a word where it is coarser."""

import math

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.material import Material, warn_once
from cloth_envs.scene import GRAVITY, Scene


def bending_length(material: Material) -> float:
    """``(B / rho g)^(1/3)`` [m] (Peirce 1930): what folds under the own weight are as wide as."""
    return float(np.cbrt(material.bend_stiffness / (material.areal_density * GRAVITY)))


def needed(grid: Grid, material: Material) -> tuple[int, int]:
    """Rows and columns from which on the number of folds no longer depends on the grid: spaced by a bending length.

    ``docs/scenes.md`` has how that was measured; how sharp folds are takes half of that spacing.
    """
    length = bending_length(material)
    rows = math.ceil(grid.height / length - 1e-9) + 1
    return rows, math.ceil(grid.width / length - 1e-9) + (not grid.periodic)


def warn_coarse(scene: Scene) -> None:
    """Warn once where a chosen grid is coarser than the folds of its cloth need."""
    grid, material = scene.grid, scene.material
    if scene.particles is not None or material.bend_stiffness == 0:
        return
    rows, cols = needed(grid, material)
    if grid.rows < rows or grid.cols < cols:
        warn_once(
            f"{grid} vertices are too coarse for this cloth's folds, which need a spacing of at most its bending "
            f"length of {100 * bending_length(material):.2g} cm: choose resolution=({rows}, {cols}) or finer"
        )
