"""Contact of vertices with bodies in plain NumPy: the definition that the kernel follows."""

import numpy as np

from cloth_envs.scene import Collider, Scene
from cloth_envs.state import State


def resolve_contact(
    scene: Scene, now: State, before: np.ndarray, bodies: np.ndarray, moved: np.ndarray, h: float
) -> None:
    """Push the vertices of ``now`` out of the bodies, one body after the other, with Coulomb friction.

    ``before`` ``(B, 3, H, W)`` are the positions at the substep's start; ``bodies`` and ``moved``
    ``(B, C, 2, 3)`` are the bodies at its start and end; ``h`` [s] is its length.
    """
    shape = now.positions.shape
    x0, x1, v = (array.reshape(*shape[:2], -1) for array in (before, now.positions, now.velocities))
    for number, body in enumerate(scene.colliders):
        x1, v = resolve_body(body, x0, x1, v, bodies[:, number], moved[:, number], scene.thickness, h)
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
) -> tuple[np.ndarray, np.ndarray]:
    """Corrected ``x1`` and ``v`` ``(B, 3, N)`` for one body that goes from ``start`` to ``end`` ``(B, 2, 3)``.

    A vertex that comes closer than ``R = radius + thickness`` is put on the tangent plane where it
    came in, its normal velocity is raised to the body's, and its sliding velocity (and the way slid
    in this substep) shrinks by at most ``friction`` times that change of velocity. That plane does not turn with a
    capsule: where it left a vertex inside, that is put on the surface.
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
