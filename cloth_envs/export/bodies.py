"""Bodies as meshes that are moved: spheres, capsules that grow and shrink, and a square for a plane."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from cloth_envs.grid import Grid
from cloth_envs.scene import Collider

RINGS, SECTORS = 9, 32  # of half a sphere, from the pole to the equator


class Place(NamedTuple):
    """Where a body is: translation ``(3,)`` [m], quaternion ``(4,)`` x y z w, length of a capsule's axis [m] or 0."""

    translation: np.ndarray
    quaternion: np.ndarray
    length: float


@dataclass(frozen=True)
class Body:
    """A body at the origin, its axis or normal along z; P points, F triangles.

    Attributes:
        name: unlike that of any other body of the scene.
        kind: ``"sphere"``, ``"capsule"`` or ``"plane"``.
        size: the radius, or the side of a plane's square [m].
        points: ``(P, 3)`` [m] float32; of a capsule those at length 0.
        normals: ``(P, 3)`` float32, unit vectors outwards, at every length.
        growth: ``(P,)`` float32, how far a point moves along z where a capsule grows by 1 m.
        triangles: ``(F, 3)`` int32, counter-clockwise seen from outside.
    """

    name: str
    kind: str
    size: float
    points: np.ndarray
    normals: np.ndarray
    growth: np.ndarray
    triangles: np.ndarray

    def stretched(self, length: float) -> np.ndarray:
        """Points ``(P, 3)`` [m] float32 of a capsule whose axis has this ``length`` [m]."""
        return self.points + np.outer(length * self.growth, [0, 0, 1]).astype(np.float32)

    def moved(self, place: Place) -> tuple[np.ndarray, np.ndarray]:
        """Points [m] and normals, ``(P, 3)`` float32, where the body is."""
        turn = Rotation.from_quat(place.quaternion)
        points = turn.apply(self.stretched(place.length)) + place.translation
        return points.astype(np.float32), turn.apply(self.normals).astype(np.float32)


def make(number: int, collider: Collider, side: float) -> Body:
    """The body of ``collider`` number ``number``; ``side`` [m] is that of a plane's square."""
    name = f"{collider.name}_{number}"
    if collider.kind == "plane":
        square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32) * np.float32(side / 2)
        upwards, still = np.tile(np.array([0, 0, 1], np.float32), (4, 1)), np.zeros(4, np.float32)
        return Body(name, "plane", side, square, upwards, still, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    unit, growth, triangles = ball(capsule=collider.kind == "capsule")
    points = np.float32(collider.radius) * unit
    return Body(name, collider.kind, collider.radius, points, unit, growth, triangles)


def ball(*, capsule: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points ``(P, 3)`` of the unit sphere, their ``growth`` and triangles; a capsule's equator is there twice."""
    half = np.linspace(0, np.pi / 2, RINGS)
    down = np.concatenate([half, half[0 if capsule else 1 :] + np.pi / 2])[:, None]
    turn = 2 * np.pi * np.arange(SECTORS) / SECTORS
    unit = np.stack(np.broadcast_arrays(np.sin(down) * np.cos(turn), np.sin(down) * np.sin(turn), np.cos(down)), -1)
    growth = np.where(np.arange(len(down)) < RINGS, 0.5, -0.5) * capsule
    merged = np.arange(unit.shape[0] * SECTORS)
    merged[:SECTORS], merged[-SECTORS:] = 0, len(merged) - SECTORS  # the rings at the poles are a point each
    triangles = merged[Grid(len(down), SECTORS, 1.0, 1.0, periodic=True).triangles]
    proper = (triangles != np.roll(triangles, 1, axis=1)).all(1)
    used, again = np.unique(triangles[proper], return_inverse=True)
    points, growths = unit.reshape(-1, 3)[used], np.repeat(growth, SECTORS)[used]
    return points.astype(np.float32), growths.astype(np.float32), again.reshape(-1, 3).astype(np.int32)


def place(kind: str, ends: np.ndarray, centre: np.ndarray) -> Place:
    """Where a body at ``ends`` ``(2, 3)`` of a state is; a plane's square is below or above ``centre`` ``(3,)`` [m]."""
    if kind == "plane":
        turn = turn_from_z(ends[1])
        normal = Rotation.from_quat(turn).apply([0, 0, 1])
        return Place(centre - (centre - ends[0]) @ normal * normal, turn, 0.0)
    axis = ends[1] - ends[0]
    return Place(ends.mean(0), turn_from_z(axis), float(np.linalg.norm(axis)) if kind == "capsule" else 0.0)


def turn_from_z(axis: np.ndarray) -> np.ndarray:
    """The smallest turn that brings z to ``axis`` ``(3,)``: a unit quaternion x y z w, none for no axis."""
    size = float(np.linalg.norm(axis))
    x, y, z = axis / size if size > 1e-9 else (0.0, 0.0, 1.0)
    quaternion = np.array([-y, x, 0.0, 1 + z]) if z > -1 + 1e-9 else np.array([1.0, 0.0, 0.0, 0.0])
    return quaternion / np.linalg.norm(quaternion)


class Mesh(NamedTuple):
    """Bodies in one mesh: points [m] and normals ``(P, 3)``, each point's body ``(P,)``, triangles ``(F, 3)``."""

    points: np.ndarray
    normals: np.ndarray
    numbers: np.ndarray
    triangles: np.ndarray


def joined(bodies: Sequence[Body], places: Sequence[Place]) -> Mesh:
    """All of at least one body where they are."""
    points, normals = zip(*(body.moved(at) for body, at in zip(bodies, places, strict=True)), strict=True)
    counts = [len(body.points) for body in bodies]
    triangles = [body.triangles + first for body, first in zip(bodies, np.cumsum([0, *counts[:-1]]), strict=True)]
    numbers = np.repeat(np.arange(len(bodies)), counts).astype(np.int32)
    return Mesh(np.concatenate(points), np.concatenate(normals), numbers, np.concatenate(triangles).astype(np.int32))
