"""Bodies as meshes that stay as they are and are moved: spheres, capsules, and a square for a plane."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from cloth_envs.grid import Grid
from cloth_envs.scene import Collider

RINGS, SECTORS = 17, 32  # of a sphere
PLANE = 4.0  # side of a plane's square, in lengths of the cloth


@dataclass(frozen=True)
class Body:
    """A body at the origin, its axis or normal along z.

    Attributes:
        name: unlike that of any other body of the scene.
        kind: ``"sphere"``, ``"capsule"`` or ``"plane"``.
        radius: [m], 0 for a plane.
        length: of a capsule's axis or a plane's side [m], as at the start.
        points: ``(P, 3)`` [m] float32.
        triangles: ``(F, 3)`` int32, counter-clockwise seen from outside.
    """

    name: str
    kind: str
    radius: float
    length: float
    points: np.ndarray
    triangles: np.ndarray


def ball(radius: float, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and triangles of a sphere, or of a capsule whose axis has this ``length`` [m]."""
    half = np.linspace(0, np.pi / 2, RINGS // 2 + 1)
    down = np.concatenate([half, half + np.pi / 2])[:, None] if length else np.linspace(0, np.pi, RINGS)[:, None]
    turn = 2 * np.pi * np.arange(SECTORS) / SECTORS
    unit = np.stack(np.broadcast_arrays(np.sin(down) * np.cos(turn), np.sin(down) * np.sin(turn), np.cos(down)), -1)
    points = radius * unit
    if length:
        points[: len(half), :, 2] += length / 2
        points[len(half) :, :, 2] -= length / 2
    triangles = Grid(len(down), SECTORS, 1.0, 1.0, periodic=True).triangles
    flat = points.reshape(-1, 3).astype(np.float32)
    poles = {tuple(flat[0]): 0, tuple(flat[-1]): len(flat) - SECTORS}  # the rings at the poles have one point each
    merged = np.array([poles.get(tuple(point), number) for number, point in enumerate(flat)])[triangles]
    proper = (merged != np.roll(merged, 1, axis=1)).all(1)
    used, again = np.unique(merged[proper], return_inverse=True)
    return flat[used], again.reshape(-1, 3).astype(np.int32)


def make(number: int, collider: Collider, ends: np.ndarray, cloth: float) -> Body:
    """The body of ``collider`` number ``number``, at ``ends`` ``(2, 3)`` [m] first; ``cloth`` is its length [m]."""
    name = f"{collider.name}_{number}"
    if collider.kind == "plane":
        side = PLANE * cloth
        square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32) * np.float32(side / 2)
        return Body(name, "plane", 0.0, side, square, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    length = float(np.linalg.norm(ends[1] - ends[0])) if collider.kind == "capsule" else 0.0
    return Body(name, collider.kind, collider.radius, length, *ball(collider.radius, length))


def place(body: Body, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Translation ``(3,)`` [m] and quaternion ``(4,)``, x y z w, of a body at ``ends`` ``(2, 3)`` of a state."""
    if body.kind == "plane":
        return ends[0], turn_from_z(ends[1])
    return ends.mean(0), turn_from_z(ends[1] - ends[0]) if body.length else np.array([0.0, 0.0, 0.0, 1.0])


def turn_from_z(axis: np.ndarray) -> np.ndarray:
    """The smallest turn that brings z to ``axis`` ``(3,)``: a unit quaternion x y z w, none for no axis."""
    size = float(np.linalg.norm(axis))
    x, y, z = axis / size if size > 1e-9 else (0.0, 0.0, 1.0)
    quaternion = np.array([-y, x, 0.0, 1 + z]) if z > -1 + 1e-9 else np.array([1.0, 0.0, 0.0, 0.0])
    return quaternion / np.linalg.norm(quaternion)


def moved(body: Body, translation: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """Points ``(P, 3)`` [m] float32 of a body where it is placed."""
    return (Rotation.from_quat(quaternion).apply(body.points) + translation).astype(np.float32)
