"""What the super-resolving network reads of the coarse cloth, for NumPy and torch alike, and how its answer is applied.

Every coarse vertex has axes of its own: the first along its row, the third along the normal. What is told of it is in
these, in units of the coarse spacing, so that turning or moving the cloth turns and moves what is answered: where its
four neighbours are, how that has changed since the frame before, its own velocity and acceleration over the last three
frames, which way down is, where the nearest body is and how it slides along it, whether it is driven, and how near that
body is. Beyond an open border, a vertex is its own neighbour.

Of a mirrored cloth the third component of every vector is the opposite, all else is the same (``MIRROR``): so is what a
network answers that is built for that.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from array_api_compat import array_namespace

from cloth_envs.grid import Grid

FRAMES = 3  # coarse ones that are read
VECTORS = 13
CHANNELS = 3 * VECTORS + 2
MIRROR = np.array([1, 1, -1] * VECTORS + [1, 1], np.float32)  # of the channels
SCALE = 4  # fine cells along each side of a coarse one
LIMIT = 0.3  # of a residual, in coarse spacings
REACH = 2.0  # coarse spacings from its surface within which a body is told of


class Bodies(NamedTuple):
    """The bodies around B cloths, C each, none of them perhaps.

    Attributes:
        now, before: where they are and were a frame before, ``(B, C, 2, 3)`` [m] as of ``State.colliders``.
        radii: with the thickness of contact, ``(B or 1, C)`` [m]. planes: which are planes.
    """

    now: Any
    before: Any
    radii: Any
    planes: Sequence[bool]


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


def touched(now: Any, step: Any, bodies: Bodies, reach: float) -> tuple[Any, Any, Any]:
    """How near the nearest body is to every vertex, and that times its normal and the way slid along it.

    Args:
        now, step: positions [m] and their change in the last frame, ``(B, 3, h, w)``.
        reach: [m] from a surface; nearness is 1 on it, 0 from there on, more inside.

    Returns:
        ``(B, 1, h, w)``, ``(B, 3, h, w)`` and ``(B, 3, h, w)`` [m].
    """
    xp = array_namespace(now)
    gap, normal, slide = xp.full_like(now[:, :1], reach), xp.zeros_like(now), xp.zeros_like(now)
    for k, plane in enumerate(bodies.planes):
        ends, old = (part[:, k, :, :, None, None] for part in (bodies.now, bodies.before))
        from_end, axis, was = now - ends[:, 0], ends[:, 1] - ends[:, 0], old[:, 1] - old[:, 0]
        if plane:
            moved, out = ends[:, 0] - old[:, 0], xp.broadcast_to(ends[:, 1], now.shape)
            away = _dot(out, from_end)
        else:
            square = _dot(axis, axis)
            place = xp.clip(_dot(from_end, axis) / xp.where(square > 0, square, xp.ones_like(square)), 0, 1)
            moved = ends[:, 0] - old[:, 0] + place * (axis - was)
            off = from_end - place * axis
            away = xp.sqrt(_dot(off, off) + 1e-20)
            out = off / away
        away = away - bodies.radii[:, k, None, None, None]
        nearer = away < gap
        gap, normal, slide = (xp.where(nearer, a, b) for a, b in ((away, gap), (out, normal), (step - moved, slide)))
    near = 1 - gap / reach
    return near, near * normal, near * slide


def _dot(a: Any, b: Any) -> Any:
    return array_namespace(a).sum(a * b, axis=1, keepdims=True)


def features(past: Sequence[Any], bodies: Bodies, held: Any, grid: Grid) -> tuple[Any, Any]:
    """The numbers that are read, ``(B, CHANNELS, h, w)``, and the axes ``(B, 3 axes, 3, h, w)``.

    Args:
        past: positions [m] of the last ``FRAMES`` frames, the newest last, ``(B, 3, h, w)`` each.
        bodies: at the last two of them.
        held: 1 where a vertex is driven, else 0, ``(h, w)``. grid: the coarse one.
    """
    earlier, before, now = past
    xp, unit = array_namespace(now), spacing(grid)
    near, old = neighbours(now, grid.periodic), neighbours(before, grid.periodic)
    turn = axes(near)

    def seen(a: Any) -> Any:
        return xp.sum(turn * a[:, None], axis=2) / unit

    step = now - before
    reached, normal, slide = touched(now, step, bodies, REACH * unit)
    told = [seen(a - now) for a in near] + [seen(a - b - step) for a, b in zip(near, old, strict=True)]
    marks = xp.broadcast_to(held, (now.shape[0], 1, *now.shape[2:]))
    told += [seen(step), seen(step - before + earlier), -turn[:, :, 2], seen(unit * normal), seen(slide)]
    return xp.concat([*told, marks, reached], axis=1), turn


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
