"""What scenes start from: cloths that are bowed and turned at rest length."""

from itertools import pairwise

import numpy as np

from cloth_envs.grid import Grid


def bow(cells: int, ratio: float) -> np.ndarray:
    """A bowed line of ``cells`` unit edges whose ends are ``ratio * cells`` apart, ``(2, cells + 1)``.

    Along and across the straight line between the ends. The slope angle is a half cosine wave, so the
    mean of its cosine is ``ratio`` (J0 of the largest angle, for many cells); every edge has length 1.
    """
    wave = np.cos(np.pi * (np.arange(cells) + 0.5) / cells)
    steepest = np.linspace(0.0, 2.2, 221)
    shortened = np.cos(steepest[:, None] * wave).mean(1)
    slope = np.interp(-ratio, -shortened, steepest) * wave
    path = np.zeros((2, cells + 1))
    np.cumsum([np.cos(slope), np.sin(slope)], axis=1, out=path[:, 1:])
    return path


def pleats(grid: Grid, waves: int, ratio: float, side: float) -> np.ndarray:
    """A cloth that hangs straight down in ``waves`` half waves, or as many as it has pairs of cells, ``(3, H, W)``.

    It is ``ratio`` times its width wide along x, in the middle of the upper edge is the origin, and the first half wave
    bows to ``side``, -1 or 1 along y.
    """
    positions = np.empty((3, *grid.shape))
    halves = np.linspace(0, grid.cols - 1, min(waves, grid.cells[1] // 2) + 1).round().astype(int)
    for i, (begin, end) in enumerate(pairwise(halves)):
        along, across = grid.col_spacing * bow(end - begin, ratio)
        positions[0, :, begin : end + 1] = ratio * (begin * grid.col_spacing - 0.5 * grid.width) + along
        positions[1, :, begin : end + 1] = (-1) ** i * side * across
    positions[2] = -np.linspace(0.0, grid.height, grid.rows)[:, None]
    return positions


def ruffle(grid: Grid, pleats: int, radius: float) -> np.ndarray:
    """A closed line of the grid's columns, in pleats around a circle, every edge at rest length; ``(2, W)`` [m].

    ``radius`` [m] is the mean distance from its centre, at most that of the line laid out as a circle. There are fewer
    ``pleats`` than asked for where one would have less than four columns, and none, but that circle, where that leaves
    less than half of them.
    """
    possible = min(pleats, grid.cols // 4)
    turns = 2 * np.pi * (np.arange(grid.cols) + 0.5) / grid.cols
    wave = np.cos(possible * turns) * (2 * possible >= pleats)
    sharpest = np.linspace(0.0, 2.2, 221)[:, None]
    edges = np.exp(1j * (turns + sharpest * wave))
    lines = grid.col_spacing * np.cumsum(edges - edges.mean(1, keepdims=True), 1)
    lines -= lines.mean(1, keepdims=True)
    line = lines[np.abs(np.abs(lines).mean(1) - radius).argmin()]
    return np.roll(np.stack([line.real, line.imag]), 1, 1)


def rotation(angle: float, first: int, second: int) -> np.ndarray:
    """Rotation by ``angle`` [rad] from axis ``first`` towards axis ``second``, ``(3, 3)``."""
    matrix = np.eye(3)
    matrix[[first, second], [first, second]] = np.cos(angle)
    matrix[second, first], matrix[first, second] = np.sin(angle), -np.sin(angle)
    return matrix
