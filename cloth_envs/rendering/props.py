"""Meshes beside the cloth: poles, rails, rings, pins, frames, bodies and the wind arrow."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cloth_envs.rendering import look
from cloth_envs.rendering.framing import arrow_length, support
from cloth_envs.scene import Scene


@dataclass
class Part:
    """A mesh that follows the handles."""

    mesh: Any  # ``pyvista.PolyData`` with its points ``(P, 3)`` [m] where the handles were at first
    color: str
    owner: np.ndarray | None = None  # ``(P,)`` the handle that each point moves with, or None for their mean motion
    along: np.ndarray | None = None  # unit vector ``(3,)`` of a direction in which it does not follow, or None
    options: dict[str, Any] = field(default_factory=dict)  # more of them for ``Plotter.add_mesh``

    def __post_init__(self) -> None:
        self.rest = np.array(self.mesh.points, np.float32)

    def become(self, other: "Part") -> None:
        """Take the shape of another part that has the same owners."""
        self.mesh.copy_from(other.mesh)
        self.rest, self.along = other.rest, other.along

    def follow(self, moved: np.ndarray) -> None:
        """Move with the handles' displacements ``(N, 3)`` [m]."""
        shift = moved.mean(0) if self.owner is None else moved[self.owner]
        if self.along is not None:
            shift = shift - (shift @ self.along) * self.along
        self.mesh.points = (self.rest + shift).astype(np.float32)


def axes_along(x: np.ndarray) -> np.ndarray:
    """Right-handed unit axes as rows ``(3, 3)``, the first along the unit vector ``x``."""
    y = np.cross([0.0, 0.0, 1.0] if abs(x[2]) < 0.9 else [0.0, 1.0, 0.0], x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)])


def repeated(pv: Any, template: Any, at: np.ndarray) -> tuple[Any, np.ndarray]:
    """One mesh with a copy of ``template`` at every point ``(N, 3)``, and the copy of each vertex."""
    copies = pv.PolyData(at.astype(np.float32)).glyph(geom=template, orient=False, scale=False)
    return copies, np.repeat(np.arange(len(at)), template.n_points)


def pole(pv: Any, handles: np.ndarray, thick: float, ground: float) -> list[Part]:
    """A flagpole through ``handles`` ``(N, 3)`` [m] with a foot on the ground and a ball on top."""
    top = handles[handles[:, 2].argmax()] + np.array([0, 0, 4 * thick])
    foot = np.array([top[0], top[1], ground])
    post = pv.Line(foot, top).tube(radius=thick, n_sides=20, capping=True)
    lift = np.array([0, 0, thick])
    ball = pv.Sphere(radius=2.1 * thick, center=top + 1.5 * lift, theta_resolution=24, phi_resolution=16)
    base = pv.Cylinder(center=foot + lift / 2, direction=(0, 0, 1), radius=6 * thick, height=thick)
    return [Part(post, look.WOOD), Part(ball, look.BRASS), Part(base, look.WOOD)]


def rail(pv: Any, handles: np.ndarray, thick: float, length: float) -> list[Part]:
    """A curtain rail of ``length`` [m] over ``handles`` ``(N, 3)`` [m], with a ring at each, or at about 12 of many."""
    along = handles[-1] - handles[0]
    along = along / max(float(np.linalg.norm(along)), 1e-9)
    up = np.array([0, 0, 1.8 * thick])
    middle, half = handles.mean(0) + up, along * length / 2
    ends = np.stack([middle - half, middle + half])
    bar = pv.Line(*ends).tube(radius=0.8 * thick, n_sides=20, capping=True)
    balls, _ = repeated(pv, pv.Sphere(radius=1.7 * thick), ends)
    ring = pv.ParametricTorus(ringradius=1.7 * thick, crosssectionradius=0.4 * thick, u_res=24, v_res=9, w_res=2)
    ring = ring.rotate_y(90).rotate_z(np.degrees(np.arctan2(along[1], along[0])))
    ringed = np.arange(0, len(handles), max(1, len(handles) // 12))
    rings, owner = repeated(pv, ring, handles[ringed] + up)
    return [
        Part(bar, look.WOOD, along=along),
        Part(balls, look.BRASS, along=along),
        Part(rings, look.BRASS, owner=ringed[owner]),
    ]


def patches(scene: Scene) -> np.ndarray:
    """Of each patch of neighbouring handles the one nearest to a corner of the sheet; places in ``scene.pins``."""
    rows, cols = scene.grid.shape
    at = np.stack(np.divmod(np.array(scene.pins, int), cols), 1)
    patch = np.arange(len(at))
    for i, place in enumerate(at):  # one pass over the rows joins what touches, diagonals included
        near = np.flatnonzero(np.abs(at[: i + 1] - place).max(1) <= 1)
        for other in np.unique(patch[near]):
            patch[patch == other] = patch[near[0]]
    inwards = np.minimum(at, [rows - 1, cols - 1] - at).sum(1)
    return np.array(
        [members[inwards[members].argmin()] for n in np.unique(patch) for members in [np.flatnonzero(patch == n)]]
    )


def fixtures(pv: Any, scene: Scene, handles: np.ndarray, ground: float) -> list[Part]:
    """What holds the cloth at ``handles`` ``(N, 3)`` [m], above a ground at that height [m]."""
    kind, size = support(scene), max(scene.grid.width, scene.grid.height)
    thick = 0.011 * size
    if kind == "pole":
        return pole(pv, handles, thick, ground)
    if kind == "rail":
        return rail(pv, handles, thick, 1.12 * max(scene.grid.width, float(np.ptp(handles, 0).max())))
    if kind in ("frame", "belt"):
        order = np.argsort(scene.pins)  # places in the handles, around the border or the tube
        around = order if kind == "belt" else order[np.searchsorted(scene.pins, scene.grid.border, sorter=order)]
        line = pv.lines_from_points(handles[around], close=True)
        tube = {"line_width": 5.0, "render_lines_as_tubes": True}
        return [Part(line, look.STEEL, owner=np.append(around, around[:1])[: line.n_points], options=tube)]
    grips = patches(scene)
    radius = (2.0 if scene.grips or len(grips) < len(handles) else 1.3) * thick
    ball = pv.Sphere(radius=radius, theta_resolution=20, phi_resolution=14)
    pins, owner = repeated(pv, ball, handles[grips])
    return [Part(pins, look.BRASS, owner=grips[owner])]


class Capsule:
    """A sphere of ``radius`` [m] whose two halves move to the two ends of an axis."""

    def __init__(self, pv: Any, radius: float) -> None:
        self.mesh = pv.Sphere(radius=radius, theta_resolution=48, phi_resolution=34)
        self.color, self.options = look.BODY, dict[str, Any]()
        self.unit = np.array(self.mesh.points) / radius
        self.radius = radius
        self.half = (self.unit[:, 2] > 0).astype(int)

    def place(self, ends: np.ndarray) -> None:
        """Put it from ``ends[0]`` to ``ends[1]`` ``(2, 3)`` [m]."""
        axis = ends[1] - ends[0]
        length = float(np.linalg.norm(axis))
        z = axis / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
        normals = self.unit @ np.roll(axes_along(z), -1, axis=0)
        self.mesh.points = (ends[self.half] + self.radius * normals).astype(np.float32)
        self.mesh.point_data.active_normals = normals.astype(np.float32)


class Arrow:
    """The wind, drawn over the ground under the cloth: along it, its length as the root of the speed."""

    def __init__(self, pv: Any, plotter: Any, scene: Scene) -> None:
        self.scene, self.fastest = scene, scene.air.max_wind if scene.air else 0.0
        self.length = arrow_length(scene, self.fastest)
        self.centre = np.zeros(3)
        mesh = pv.Arrow(tip_length=0.32, tip_radius=0.085, shaft_radius=0.03, tip_resolution=24, shaft_resolution=16)
        self.actor = plotter.add_mesh(mesh, color=look.ARROW, **look.SOLID)

    def stand(self, foot: np.ndarray) -> None:
        """Stay over the place ``(3,)`` [m] on the ground."""
        self.centre = foot + np.array([0.0, 0.0, 0.09 * self.length])

    def blow(self, wind: np.ndarray, along: np.ndarray) -> None:
        """Point along ``wind`` ``(3,)`` [m/s], moved by ``along`` ``(3,)`` [m] over the ground; hidden in still air."""
        speed = float(np.linalg.norm(wind))
        self.actor.visibility = speed > 0.01 * self.fastest
        if self.actor.visibility:
            length = arrow_length(self.scene, speed)
            x, y, z = axes_along(wind / speed)
            matrix = np.eye(4)
            centre = self.centre + along * [1, 1, 0]
            matrix[:3] = np.stack([x * length, y * self.length, z * self.length, centre - x * length / 2], 1)
            self.actor.user_matrix = matrix
