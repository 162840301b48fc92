"""Which vertices a spring or a bending term joins, and how stiff it is: plain index arrays."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from cloth_envs.grid import Grid


class Edges(NamedTuple):
    """One class of springs: no vertex is twice among ``first`` or twice among ``second``."""

    modulus: str  # the material's stiffness [N/m] that it scales with
    first: np.ndarray  # (E,) vertex numbers
    second: np.ndarray
    rest: float  # rest length [m]
    weight: np.ndarray  # (E,) spring constant per modulus [1]


class Triples(NamedTuple):
    """Three neighbours along a row or a column, for a second difference of the positions."""

    before: np.ndarray  # (T,) vertex numbers
    middle: np.ndarray
    after: np.ndarray
    weight: np.ndarray  # (T,) stiffness per bend stiffness [1/m^2]


class Quads(NamedTuple):
    """The corners of every cell, for a mixed difference ``x_ul - x_ur - x_ll + x_lr`` of the positions."""

    upper_left: np.ndarray  # (C,) vertex numbers
    upper_right: np.ndarray
    lower_left: np.ndarray
    lower_right: np.ndarray
    weight: float  # stiffness per bend stiffness and twist [1/m^2]


def _sides(grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Share of a full cell's width that a row ``(H, 1)`` and a column ``(1, W)`` carries: 1, or 1/2 on the border."""
    row, col = np.ones((grid.rows, 1)), np.ones((1, grid.cols))
    row[[0, -1]] = 0.5
    if not grid.periodic:
        col[:, [0, -1]] = 0.5
    return row, col


def edges(grid: Grid) -> Iterator[Edges]:
    """Structural edges along the columns' and the rows' direction, then the two diagonals of every cell.

    A spring stands for the strip of sheet around it, so ``k = modulus * width of the strip / length``;
    a strip at the border is half as wide. A cell sheared by the small angle g stretches each diagonal
    by ``g a b / d``: two springs ``G d^2 / (2 a b)`` then hold the energy ``G g^2 a b / 2`` of the cell.
    """
    number = np.arange(grid.vertices).reshape(grid.shape)
    right = np.roll(number, -1, axis=1)
    down = number[1:]
    a, b, d = grid.row_spacing, grid.col_spacing, grid.diagonal
    row, col = _sides(grid)
    inside = slice(None, grid.cells[1])  # columns that have a right neighbour
    across = np.broadcast_to(row * (a / b), grid.shape)[:, inside]
    along = np.broadcast_to(col * (b / a), grid.shape)[1:]
    diagonal = np.full(grid.cells, d * d / (2 * a * b))
    ul, ur, ll, lr = number[:-1, inside], right[:-1, inside], down[:, inside], right[1:, inside]
    for modulus, first, second, rest, weight in (
        ("stretch_stiffness", number[:, inside], right[:, inside], b, across),
        ("stretch_stiffness", number[:-1], down, a, along),
        ("shear_stiffness", ul, lr, d, diagonal),
        ("shear_stiffness", ur, ll, d, diagonal),
    ):
        yield Edges(modulus, first.ravel(), second.ravel(), rest, weight.ravel())


def triples(grid: Grid) -> Iterator[Triples]:
    """Second differences along every row and every column, none across a border."""
    number = np.arange(grid.vertices).reshape(grid.shape)
    a, b = grid.row_spacing, grid.col_spacing
    row, col = _sides(grid)
    along_row = [np.roll(number, shift, axis=1) for shift in (1, 0, -1)]
    weight = np.broadcast_to(row * (a / b**3), grid.shape)
    if not grid.periodic:
        along_row, weight = [part[:, 1:-1] for part in along_row], weight[:, 1:-1]
    before, middle, after = (part.ravel() for part in along_row)
    yield Triples(before, middle, after, weight.ravel())
    weight = np.broadcast_to(col * (b / a**3), grid.shape)[1:-1]
    yield Triples(number[:-2].ravel(), number[1:-1].ravel(), number[2:].ravel(), weight.ravel())


def quads(grid: Grid) -> Quads:
    """Mixed differences, one a cell: ``a b z_xy`` each, and ``B z_xy^2 a b`` is what a plate's twist costs there."""
    number = np.arange(grid.vertices).reshape(grid.shape)
    right, inside = np.roll(number, -1, axis=1), slice(None, grid.cells[1])
    ul, ur, ll, lr = (part[rows, inside].ravel() for rows in (slice(-1), slice(1, None)) for part in (number, right))
    return Quads(ul, ur, ll, lr, 2 / (grid.row_spacing * grid.col_spacing))
