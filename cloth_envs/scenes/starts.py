"""What scenes start from: cloths that are bowed and turned at rest length, batched; NumPy arrays or tensors."""

from collections.abc import Sequence
from itertools import pairwise
from math import pi
from typing import Any

import numpy as np
from array_api_compat import array_namespace, device

from cloth_envs.grid import Grid

STEEPEST = 2.2  # rad, slope angle of the narrowest bow
ANGLES = 221  # from a straight line to it


def between(even: np.ndarray, low: float | Sequence[float], high: float | Sequence[float]) -> np.ndarray:
    """Even numbers between bounds, of ones in [0, 1); a bound is a number, or one for each place of the last axis.

    To the bit what ``numpy.random.Generator.uniform`` makes of what ``random`` gives.
    """
    xp = array_namespace(even)
    least, most = (
        bound if isinstance(bound, (int, float)) else xp.asarray(bound, dtype=even.dtype, device=device(even))
        for bound in (low, high)
    )
    return least + (most - least) * even


def either(rng: np.random.Generator) -> float:
    """-1 or 1; what ``rng.choice`` of the two draws, in a tenth of the time."""
    return 2.0 * int(rng.integers(2)) - 1.0


def bow(cells: int, ratio: np.ndarray) -> np.ndarray:
    """Bowed lines of ``cells`` unit edges, their ends ``ratio`` ``(B,)`` times ``cells`` apart, ``(B, 2, cells + 1)``.

    Along and across the straight line between the ends. The slope angle is a half cosine wave, so the
    mean of its cosine is ``ratio`` (J0 of the largest angle, for many cells); every edge has length 1.
    """
    xp, there = array_namespace(ratio), {"dtype": ratio.dtype, "device": device(ratio)}
    wave = xp.cos(pi * (xp.arange(cells, **there) + 0.5) / cells)
    steepest = xp.linspace(0.0, STEEPEST, ANGLES, **there)
    shortened = xp.cos(steepest[:, None] * wave).mean(1)
    slope = interpolate(-ratio, -shortened, steepest)[:, None] * wave
    return xp.cumulative_sum(xp.stack([xp.cos(slope), xp.sin(slope)], axis=1), axis=2, include_initial=True)


def interpolate(at: Any, places: Any, values: Any) -> Any:
    """``numpy.interp`` of what lies between the first and the last place."""
    xp = array_namespace(at)
    left = (xp.searchsorted(places, at, side="right") - 1).clip(0, len(places) - 2)
    slopes = (values[1:] - values[:-1]) / (places[1:] - places[:-1])
    return slopes[left] * (at - places[left]) + values[left]


def pleats(grid: Grid, waves: int, ratio: float, side: float) -> np.ndarray:
    """A cloth that hangs straight down in ``waves`` half waves, or as many as it has pairs of cells, ``(3, H, W)``.

    It is ``ratio`` times its width wide along x, in the middle of the upper edge is the origin, and the first half wave
    bows to ``side``, -1 or 1 along y.
    """
    positions = np.empty((3, *grid.shape))
    halves = np.linspace(0, grid.cols - 1, min(waves, grid.cells[1] // 2) + 1).round().astype(int)
    for i, (begin, end) in enumerate(pairwise(halves)):
        along, across = grid.col_spacing * bow(end - begin, np.array([ratio]))[0]
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


def rotation(angle: np.ndarray, first: int, second: int) -> np.ndarray:
    """Rotations by ``angle`` ``(B,)`` [rad] from axis ``first`` towards axis ``second``, ``(B, 3, 3)``."""
    xp = array_namespace(angle)
    cos, sin, one, zero = xp.cos(angle), xp.sin(angle), xp.ones_like(angle), xp.zeros_like(angle)
    entries = {(first, first): cos, (second, second): cos, (second, first): sin, (first, second): -sin}
    rows = [[entries.get((i, j), one if i == j else zero) for j in range(3)] for i in range(3)]
    return xp.stack([xp.stack(row, axis=1) for row in rows], axis=1)
