"""Modes of a grid: eigenvectors and eigenvalues of ``M / h^2 + K`` in closed form, and what holds some vertices.

With borders' masses and stiffnesses halved, springs along rows, columns and both diagonals act on a grid as on
one mirrored about its borders, so products of cosines along rows and columns are eigenvectors, and solving takes
four small matrix products (Lynch, Rice & Thomas 1964). On a tube cosines and sines go round.
"""

from __future__ import annotations

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.material import Material


def modes(count: int, periodic: bool) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvectors of a row of ``count`` vertices as columns ``(count, count)``, and the cosine of each one's step.

    Vectors that are even about the middle come first. With the weights ``w`` of the vertices (1, on borders 1/2)
    ``(q * w[:, None]).T @ q`` is the identity; one step changes mode k as ``2 cos_k`` times itself minus its past.
    """
    place, order = np.arange(count)[:, None], np.arange(count)
    if periodic:
        even, odd = np.arange((count + 1) // 2), np.arange(1, count // 2 + 1)
        angle = 2 * np.pi / count * np.concatenate([even, odd])
        phase = (place + 0.5) * angle
        q = np.concatenate([np.cos(phase[:, : len(even)]), np.sin(phase[:, len(even) :])], 1)
        weight = np.ones((count, 1))
    else:
        angle = np.pi / (count - 1) * np.concatenate([order[0::2], order[1::2]])
        q = np.cos(place * angle)
        weight = np.ones((count, 1))
        weight[[0, -1]] = 0.5
    return q / np.sqrt((weight * q * q).sum(0)), np.cos(angle)


def eigenvalues(grid: Grid, material: Material, h: float, weight: float) -> np.ndarray:
    """Of ``M / h^2 + K`` relative to the vertices' weights, ``(H, W)`` [N/m], in the order of ``modes``.

    ``K`` holds ``weight`` times the springs, their dashpots ``c`` as ``c / h``, and bending. At free borders
    bending has a term less than on a mirrored grid: the matrix is then an upper bound of the true one.
    """
    a, b, d = grid.row_spacing, grid.col_spacing, grid.diagonal
    row, col = modes(grid.rows, False)[1][:, None], modes(grid.cols, grid.periodic)[1][None, :]
    springs = weight * (1 + material.damping / h)
    stretch = springs * material.stretch_stiffness * (a / b * (2 - 2 * col) + b / a * (2 - 2 * row))
    shear = springs * material.shear_stiffness * d * d / (2 * a * b) * (4 - 4 * row * col)
    bend = material.bend_stiffness * (a / b**3 * (2 - 2 * col) ** 2 + b / a**3 * (2 - 2 * row) ** 2)
    return material.areal_density * a * b / h**2 + stretch + shear + bend


def capacitance(grid: Grid, values: np.ndarray, held: tuple[int, ...]) -> np.ndarray:
    """Inverse ``(N, N)`` [N/m] of how the ``held`` vertices give way to forces on them, for eigenvalues ``values``."""
    rows, cols = np.divmod(np.array(held, int), grid.cols)
    along, across = modes(grid.rows, False)[0][rows], modes(grid.cols, grid.periodic)[0][cols]
    give = np.zeros((len(held), len(held)))
    for mode, value in zip(along.T, values, strict=True):
        e = mode[:, None] * across / np.sqrt(value)
        give += e @ e.T
    return np.linalg.inv(give)
