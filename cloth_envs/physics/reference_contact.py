"""Contact of vertices with bodies in plain NumPy: the definition that the kernel follows."""

from __future__ import annotations

import numpy as np

from cloth_envs.scene import Collider, Scene
from cloth_envs.state import State


def axis_points(ends: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Parameter in [0, 1] of the point of the axis ``ends`` ``(B, 2, 3)`` nearest to ``x`` ``(B, 3, N)``: ``(B, 1, N)``."""
    axis = (ends[:, 1] - ends[:, 0])[:, :, None]
    square = (axis**2).sum(1, keepdims=True)
    along = ((x - ends[:, 0][:, :, None]) * axis).sum(1, keepdims=True)
    return np.clip(np.divide(along, square, out=np.zeros_like(along), where=square > 0), 0, 1)


def contact_normal(p0: np.ndarray, p1: np.ndarray, radius: float) -> np.ndarray:
    """Unit normals ``(B, 3, N)`` of a motion from ``p0`` to ``p1`` against the ball ``radius``; zero without contact.

    From outside: at the first point of the segment on the ball. From inside: away from the centre.
    """
    d = p1 - p0
    aa, bb = (d * d).sum(1), (p0 * d).sum(1)
    cc = (p0 * p0).sum(1) - radius * radius
    root = bb * bb - aa * cc
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (-bb - np.sqrt(np.maximum(root, 0))) / aa
    enters = (cc >= 0) & (root > 0) & (t >= 0) & (t <= 1)
    at = np.where(enters[:, None], p0 + np.nan_to_num(t)[:, None] * d, np.where((cc < 0)[:, None], p0, p1))
    touches = enters | (cc < 0) | ((p1 * p1).sum(1) < radius * radius)
    size = np.linalg.norm(at, axis=1, keepdims=True)
    return np.where(touches[:, None], at / np.where(size > 0, size, 1), 0.0)


def resolve_contact(
    scene: Scene, now: State, before: np.ndarray, bodies: np.ndarray, moved: np.ndarray, h: float
) -> None:
    """Push the vertices of ``now`` out of the bodies, one body after the other, and apply Coulomb friction.

    ``before`` ``(B, 3, H, W)`` are the positions at the substep's start, ``bodies`` and ``moved``
    ``(B, C, 2, 3)`` the bodies at its start and end.
    """
    shape = now.positions.shape
    x0, x1, v = before.reshape(*shape[:2], -1), now.positions.reshape(*shape[:2], -1), now.velocities.reshape(*shape[:2], -1)
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
    """Corrected ``x1`` and ``v`` ``(B, 3, N)`` for one body between ``start`` and ``end`` ``(B, 2, 3)``."""
    radius = body.radius + thickness
    if body.kind == "plane":
        point0, point1 = start[:, 0][:, :, None], end[:, 0][:, :, None]
        n = np.broadcast_to(end[:, 1][:, :, None], x1.shape)
    else:
        s = axis_points(start, x0)
        point0, point1 = ((1 - s) * ends[:, 0][:, :, None] + s * ends[:, 1][:, :, None] for ends in (start, end))
        n = contact_normal(x0 - point0, x1 - point1, radius)
    gap = (n * (x1 - point1)).sum(1, keepdims=True) - radius
    hit = (gap < 0) & (n != 0).any(1, keepdims=True)
    relative = v - (point1 - point0) / h
    speed = (n * relative).sum(1, keepdims=True)
    tangential = relative - speed * n
    pushed = np.maximum(-speed, 0)
    size = np.linalg.norm(tangential, axis=1, keepdims=True)
    keep = np.maximum(1 - body.friction * pushed / np.where(size > 0, size, 1), 0)
    new = np.where(hit, np.maximum(speed, 0) * n + keep * tangential + (point1 - point0) / h, v)
    return np.where(hit, x1 - gap * n, x1), new
