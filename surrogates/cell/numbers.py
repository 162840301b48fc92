"""What a cell on a sheet learns: a number a class of edges and branch, and what they stand for together."""

from __future__ import annotations

import numpy as np

SHEET = ("stretch_stiffness", "shear_stiffness", "bend_stiffness", "damping", "gravity")
# A sheet's cell class by class: three branches of its edges in the order of ``stencil.edges``, bending, the weight.
EDGES = ("along", "down", "right_diagonal", "left_diagonal")
CLASSES = (
    *(f"{branch}_{edge}" for branch in ("alpha", "beta", "gamma") for edge in EDGES),
    *("bend_along", "bend_down", "bias_x", "bias_y", "bias_z"),
)
# Columns: which classes each number of ``SHEET`` stands for once a spring is a spring; then the sideways bias.
SHARED = np.zeros((len(CLASSES), 7))
SHARED[np.arange(17), [0, 0, 1, 1, 0, 0, 1, 1, 3, 3, 3, 3, 2, 2, 5, 6, 4]] = 1.0
