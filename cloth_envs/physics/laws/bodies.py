"""Contact of vertices with bodies in plain NumPy: the definition that the kernel follows."""

import numpy as np

from cloth_envs.scene import Collider, Scene
from cloth_envs.state import State

DEEP = 1e-5  # m, from which on a vertex is inside one of several bodies
SWEEPS = 8  # at most, over all bodies, until a vertex is in none
TURN_LEAST = 0.1  # of the squared length of what a capsule turns with, the least of its part across


def resolve_contact(
    scene: Scene, now: State, before: np.ndarray, bodies: np.ndarray, moved: np.ndarray, h: float
) -> None:
    """Push the vertices of ``now`` out of the bodies, one body after the other, with Coulomb friction.

    Those that are deep in one of several bodies then are put onto its surface, over and over until they are in none,
    up to ``SWEEPS`` times. ``before`` ``(B, 3, H, W)`` are the positions at the substep's start; ``bodies`` and
    ``moved`` ``(B, C, 2, 3)`` are the bodies at its start and end; ``h`` [s] is its length.
    """
    shape = now.positions.shape
    x0, x1, v = (array.reshape(*shape[:2], -1) for array in (before, now.positions, now.velocities))
    for number, body in enumerate(scene.colliders):
        turn = spin(body, bodies, moved, number)
        x1, v = resolve_body(body, x0, x1, v, bodies[:, number], moved[:, number], scene.thickness, h, turn)
    for _ in range(SWEEPS if len(scene.colliders) > 1 else 0):
        last = x1
        for number, body in enumerate(scene.colliders):
            x1 = leave(body, x1, moved[:, number], scene.thickness)
        if np.array_equal(x1, last):
            break
    now.positions, now.velocities = x1.reshape(shape), v.reshape(shape)


def resolve_body(
    body: Collider,
    x0: np.ndarray,
    x1: np.ndarray,
    v: np.ndarray,
    start: np.ndarray,
    end: np.ndarray,
    thickness: float,
    h: float,
    turn: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Corrected ``x1`` and ``v`` ``(B, 3, N)`` for one body that goes from ``start`` to ``end`` ``(B, 2, 3)``.

    A vertex that comes closer than ``R = radius + thickness`` is put on the tangent plane where it
    came in, its normal velocity is raised to the body's, and its sliding velocity (and the way slid
    in this substep) shrinks by at most ``friction`` times that change of velocity. That plane does not turn with a
    capsule: where it left a vertex inside, that is put on the surface. ``turn`` ``(B, 3)`` is by how much a capsule
    turns about its axis, see ``spin``: its surface carries along what it rubs.
    """
    radius = body.radius + thickness
    if body.kind == "plane":
        n = np.broadcast_to(end[:, 1][:, :, None], x1.shape)
        gap = dot(n, x1 - end[:, 0][:, :, None]) - radius
        carried = np.broadcast_to((end[:, 0] - start[:, 0])[:, :, None] / h, x1.shape)
        touching = gap < 0
    else:
        p0 = x0 - on_axis(start, axis_parameter(start, x0))
        s = axis_parameter(end, x1)
        p1 = x1 - on_axis(end, s)
        n = entry_normal(p0, p1, radius)
        gap = dot(n, p1) - radius
        carried = on_axis((end - start) / h, s)  # the velocity of the body there
        if turn is not None:
            carried = carried + radius / h * np.cross(turn[:, :, None], n, axis=1)
        touching = (gap < 0) & (dot(n, n) > 0)
    relative = v - carried
    speed = dot(n, relative)
    stop = np.where(touching, np.maximum(-speed, 0), 0)
    sliding = relative - speed * n
    size = np.sqrt(dot(sliding, sliding))
    hold = np.minimum(body.friction * stop / np.where(size > 0, size, 1), 1)
    x1 = x1 + np.where(touching, -gap, 0) * n - h * hold * sliding
    if body.kind == "capsule":
        p = x1 - on_axis(end, axis_parameter(end, x1))
        size = np.sqrt(dot(p, p))
        x1 = x1 + np.where((size > 0) & (size < radius), radius / np.where(size > 0, size, 1) - 1, 0) * p
    return x1, v + stop * n - hold * sliding


def spin(body: Collider, start: np.ndarray, end: np.ndarray, number: int) -> np.ndarray | None:
    """By how much a capsule turns about its axis between two places of all bodies ``(B, C, 2, 3)``, or None.

    A vector along the axis ``(B, 3)`` [rad]: as the part across of the axis of the body that it turns with does, and
    less where the two are nearly parallel.
    """
    if body.turns_with is None:
        return None
    axes = [(at[:, i, 1] - at[:, i, 0]) for at in (start, end) for i in (number, body.turns_with)]
    was, is_ = (other - _along(other, axis) * axis for axis, other in (axes[:2], axes[2:]))
    axis, other = axes[2:]
    square = np.maximum(_product(is_, is_), TURN_LEAST * _product(other, other))
    scale = _product(axis, axis) * square
    return _product(axis, np.cross(was, is_)) / np.where(scale > 0, scale, 1) * axis


def leave(body: Collider, x: np.ndarray, end: np.ndarray, thickness: float) -> np.ndarray:
    """Positions ``(B, 3, N)`` of which those deeper than ``DEEP`` inside a body at ``end`` are put onto its surface."""
    radius = body.radius + thickness
    if body.kind == "plane":
        n = end[:, 1][:, :, None]
        gap = dot(n, x - end[:, 0][:, :, None]) - radius
        return x + np.where(gap < -DEEP, -gap, 0) * n
    p = x - on_axis(end, axis_parameter(end, x))
    size = np.sqrt(dot(p, p))
    return x + np.where((size > 0) & (size < radius - DEEP), radius / np.where(size > 0, size, 1) - 1, 0) * p


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products of vectors ``(B, 3)``, ``(B, 1)``."""
    return (a * b).sum(1, keepdims=True)


def _along(a: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """How often the ``axis`` fits into the part of ``a`` along it, ``(B, 1)``."""
    square = _product(axis, axis)
    return _product(a, axis) / np.where(square > 0, square, 1)


def entry_normal(p0: np.ndarray, p1: np.ndarray, radius: float) -> np.ndarray:
    """Outward unit normals ``(B, 3, N)`` where the segments ``p0 p1`` enter the ball of ``radius``.

    Away from the centre for a vertex that is inside already; zero where there is no entry.
    """
    d = p1 - p0
    outside, along = dot(p0, p0) - radius * radius, dot(p0, d)
    root = along * along - dot(d, d) * outside
    first = outside / np.where(along < 0, np.sqrt(np.maximum(root, 0)) - along, 1)
    enters = (outside >= 0) & (along < 0) & (root > 0) & (first <= 1)
    at = np.where(enters, p0 + first * d, np.where(outside < 0, p0, 0))
    size = np.sqrt(dot(at, at))
    return at / np.where(size > 0, size, 1)


def axis_parameter(ends: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Place ``(B, 1, N)`` in [0, 1] on the axis ``ends`` ``(B, 2, 3)`` of the point nearest to ``x`` ``(B, 3, N)``."""
    axis = (ends[:, 1] - ends[:, 0])[:, :, None]
    square = dot(axis, axis)
    return np.clip(dot(x - ends[:, 0][:, :, None], axis) / np.where(square > 0, square, 1), 0, 1)


def on_axis(ends: np.ndarray, s: np.ndarray) -> np.ndarray:
    """The points ``(B, 3, N)`` at ``s`` between two ends."""
    return (1 - s) * ends[:, 0][:, :, None] + s * ends[:, 1][:, :, None]


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar product over the axes, ``(B, 1, N)``."""
    return (a * b).sum(1, keepdims=True)
