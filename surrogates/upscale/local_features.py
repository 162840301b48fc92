"""What the local network sees of the coarse cloth, in NumPy: the twin of the kernel ``PatchNet``, and for training.

A patch is the 4 x 4 coarse vertices around a cell without the corners, which were no use, in the cell's own axes: the
origin is their mean, the first two axes lie evenly about the cell's mean edges, the unit is the coarse spacing. Beyond
the border the sheet is continued by a parabola, as bicubic interpolation does. Turning or moving the cloth turns and
moves patch and answer alike.
"""

from collections.abc import Sequence

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.scene import Scene

PLACES = np.array([1, 2, 4, 5, 6, 7, 8, 9, 10, 11, 13, 14])  # of a patch's vertices among 4 x 4
NODES = 9
LIMIT = 0.3  # of a residual, in coarse spacings
AIR = 1.2  # kg/m^3


def spacing(grid: Grid) -> float:
    """The unit of length of a grid's patches [m]."""
    return float(np.sqrt(grid.row_spacing * grid.col_spacing))


def patches(x: np.ndarray) -> np.ndarray:
    """The 12 vertices around every cell of ``x`` ``(B, 3, h, w)``: ``(B, cells, 3, 12)``."""
    for axis in (-2, -1):
        rows = np.moveaxis(x, axis, 0)
        before = 3 * (rows[:1] - rows[1:2]) + rows[2:3]
        after = 3 * (rows[-1:] - rows[-2:-1]) + rows[-3:-2]
        x = np.moveaxis(np.concatenate([before, rows, after]), 0, axis)
    around = np.lib.stride_tricks.sliding_window_view(x, (4, 4), (-2, -1))
    return np.moveaxis(around, 1, 3).reshape(len(x), -1, 3, 16)[..., PLACES]


def axes(patch: np.ndarray) -> np.ndarray:
    """The patches' axes, ``(B, cells, 3 axes, 3)``, of ``patch`` ``(B, cells, 3, 12)``."""

    def unit(a: np.ndarray) -> np.ndarray:
        return a / np.sqrt((a * a).sum(-1, keepdims=True) + 1e-20)

    upper, lower = patch[..., [3, 4]], patch[..., [7, 8]]  # the cell's own corners
    a, b = unit((upper + lower)[..., 1] - (upper + lower)[..., 0]), unit((lower - upper).sum(-1))
    u, d = unit(a + b), a - b
    v = unit(d - (u * d).sum(-1, keepdims=True) * u)
    first, second = (u + v) * np.sqrt(0.5), (u - v) * np.sqrt(0.5)
    return np.stack([first, second, np.cross(first, second)], -2).astype(patch.dtype)


def features(x: np.ndarray, unit: float) -> tuple[np.ndarray, np.ndarray]:
    """The numbers that the network reads, ``(B, cells, 36)``, and the axes ``(B, cells, 3, 3)``."""
    patch = patches(x)
    turn = axes(patch)
    inner = turn @ (patch - patch.mean(-1, keepdims=True)) / np.asarray(unit, x.dtype)
    return inner.reshape(*inner.shape[:2], -1), turn


def flat_features(grid: Grid) -> np.ndarray:
    """The features of a patch of the sheet at rest, ``(36,)``."""
    row, col = np.indices((4, 4)) - 1.5
    flat = np.stack([col * grid.col_spacing, row * grid.row_spacing, 0 * row]).reshape(1, 3, 16)
    patch = flat[..., PLACES]
    return (axes(patch[None])[0, 0] @ patch[0] / spacing(grid)).ravel()


def cells(double: np.ndarray) -> np.ndarray:
    """The 3 x 3 vertices that each cell spans in ``double`` ``(B, 3, 2h-1, 2w-1)``: ``(B, cells, 3, 9)``."""
    every = np.lib.stride_tricks.sliding_window_view(double, (3, 3), (-2, -1))
    return np.moveaxis(every[:, :, ::2, ::2], 1, 3).reshape(len(double), -1, 3, NODES)


def answer(outputs: np.ndarray, turn: np.ndarray, unit: float) -> np.ndarray:
    """A network's ``outputs`` ``(B, cells, 27)`` in the patches' axes as vectors [m], ``(B, cells, 9, 3)``.

    A vector ``y`` is shortened to ``y / sqrt(1 + |y|^2 / LIMIT^2)``: where the network extrapolates it tears no edge.
    """
    inner = outputs.reshape(*outputs.shape[:2], 3, NODES)
    inner = inner / np.sqrt(1 + (inner**2).sum(2, keepdims=True) / LIMIT**2)
    return np.swapaxes(inner, -1, -2) @ turn * np.asarray(unit, outputs.dtype)


def stiffness_numbers(coarse: Scene, materials: Sequence[Material]) -> np.ndarray:
    """Logarithms of two dimensionless numbers of (fine) ``materials``, ``(B, 2)``.

    ``k dt^2 / (sigma a b)``, how far the stretching wave goes in a frame, squared, in coarse spacings ``a``, ``b``; and
    ``sigma / (1.2 kg/m^3 sqrt(a b))``, the sheet's weight over that of the air beside it.
    """
    unit = spacing(coarse.grid)
    density = np.array([m.areal_density for m in materials])
    stretch = np.array([m.stretch_stiffness for m in materials])
    numbers = stretch * coarse.frame_dt**2 / (density * unit**2), density / (AIR * unit)
    return np.log(np.stack(numbers, 1))
