"""What the super-resolving network reads of the coarse cloth, for NumPy and torch alike, and how its answer is applied.

Every coarse vertex has axes of its own: the first along its row, the third along the normal. What is told of it is in
these, in units of the coarse spacing, so that turning or moving the cloth turns and moves what is answered: where its
four neighbours are, how that has changed since the frame before, its own velocity and acceleration over the last three
frames, which way down is, and whether it is driven. Beyond an open border, a vertex is its own neighbour.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from cloth_envs.grid import Grid

FRAMES = 3  # coarse ones that are read
CHANNELS = 34
SCALE = 4  # fine cells along each side of a coarse one
LIMIT = 0.3  # of a residual, in coarse spacings


def neighbours(x: Any, periodic: bool) -> list[Any]:
    """The next and the last vertex of ``x`` ``(..., h, w)`` along rows, then down columns."""
    xp = array_namespace(x)
    if periodic:
        after, before = xp.roll(x, -1, axis=-1), xp.roll(x, 1, axis=-1)
    else:
        after = xp.concat([x[..., 1:], x[..., -1:]], axis=-1)
        before = xp.concat([x[..., :1], x[..., :-1]], axis=-1)
    below = xp.concat([x[..., 1:, :], x[..., -1:, :]], axis=-2)
    above = xp.concat([x[..., :1, :], x[..., :-1, :]], axis=-2)
    return [after, before, below, above]


def axes(near: list[Any]) -> Any:
    """Right-handed axes ``(B, 3 axes, 3, h, w)`` of vertices whose ``neighbours`` these are."""
    xp = array_namespace(near[0])

    def unit(a: Any) -> Any:
        return a / xp.sqrt(xp.sum(a * a, axis=1, keepdims=True) + 1e-20)

    first = unit(near[0] - near[1])
    third = unit(xp.linalg.cross(near[2] - near[3], first, axis=1))
    return xp.stack([first, xp.linalg.cross(third, first, axis=1), third], axis=1)


def features(past: Sequence[Any], held: Any, grid: Grid) -> tuple[Any, Any]:
    """The numbers that are read, ``(B, CHANNELS, h, w)``, and the axes ``(B, 3 axes, 3, h, w)``.

    Args:
        past: positions [m] of the last ``FRAMES`` frames, the newest last, ``(B, 3, h, w)`` each.
        held: 1 where a vertex is driven, else 0, ``(h, w)``. grid: the coarse one.
    """
    earlier, before, now = past
    xp, unit = array_namespace(now), spacing(grid)
    near, old = neighbours(now, grid.periodic), neighbours(before, grid.periodic)
    turn = axes(near)

    def seen(a: Any) -> Any:
        return xp.sum(turn * a[:, None], axis=2) / unit

    step = now - before
    told = [seen(a - now) for a in near] + [seen(a - b - step) for a, b in zip(near, old, strict=True)]
    marks = xp.broadcast_to(held, (now.shape[0], 1, *now.shape[2:]))
    return xp.concat([*told, seen(step), seen(step - before + earlier), -turn[:, :, 2], marks], axis=1), turn


def spacing(grid: Grid) -> float:
    """The unit of length [m]."""
    return float(np.sqrt(grid.row_spacing * grid.col_spacing))


def residual(outputs: Any, turn: Any, grid: Grid) -> Any:
    """A network's ``outputs``, ``(B, 3, H, W)``, in fine vertices' axes ``turn`` ``(B, 3 axes, 3, H, W)``, as vectors.

    An answer ``y`` is shortened to ``y / sqrt(1 + |y|^2 / LIMIT^2)``: where the network extrapolates it tears no edge.

    Returns:
        ``(B, 3, H, W)`` [m].
    """
    xp = array_namespace(outputs)
    short = outputs / xp.sqrt(1 + xp.sum(outputs * outputs, axis=1, keepdims=True) / LIMIT**2)
    return spacing(grid) * xp.sum(turn * short[:, :, None], axis=1)
