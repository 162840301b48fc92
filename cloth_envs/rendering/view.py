"""One view of a scene: adds its actors once, then only moves and reshapes them."""

from typing import Any

import numpy as np

from cloth_envs.rendering import framing, look
from cloth_envs.rendering.goals import Goals
from cloth_envs.rendering.ground import Ground, refined
from cloth_envs.rendering.props import Arrow, Capsule, Part, fixtures
from cloth_envs.rendering.sheet import Sheet
from cloth_envs.scene import Scene
from cloth_envs.state import State

PARTICLES_DEPTH = 0.005  # m, how far particles come into a body: it is drawn that much smaller


class View:
    """The actors for ``scene`` in the active subplot of ``plotter``.

    Args:
        scene: what is drawn, on the grid of the states that will come.
        start, member: what the pictures are framed by; what holds the cloth is built around its handles.
        box: low and high corner ``(2, 3)`` [m] of what may be occupied; its bottom is the ground.
        camera: where the camera stands.
        follow: the camera goes along with handles or bodies that move far.
        strain_range: strain at the ends of the colours, or None for fabric.
    """

    def __init__(
        self,
        pv: Any,
        plotter: Any,
        scene: Scene,
        start: State,
        member: int,
        box: np.ndarray,
        camera: framing.Camera,
        *,
        follow: bool,
        strain_range: float | None,
    ) -> None:
        self.pv, self.scene, self.follow = pv, scene, follow
        self.slack = framing.SLACK * max(scene.grid.width, scene.grid.height)
        self.camera = plotter.camera
        self.camera.view_angle = framing.VIEW_ANGLE
        plotter.set_background(look.FLOOR, top=look.SKY)
        self.lights = [pv.Light(focal_point=(0, 0, 0), color=color, intensity=power) for _, color, power in look.LIGHTS]
        for light in self.lights:
            plotter.add_light(light, only_active=True)
        self.ground = Ground(pv, plotter, box, camera.towards)
        self.sheet = Sheet(pv, plotter, scene.grid, strain_range)
        inset = 0.0 if scene.particles is None else PARTICLES_DEPTH
        self.bodies = {
            index: Capsule(pv, body.radius - inset)
            for index, body in enumerate(scene.colliders)
            if body.kind != "plane"
        }
        self.parts = self._fixtures(start, member)
        self.solids: list[Capsule | Part] = [*self.bodies.values(), *self.parts]
        for solid in self.solids:
            options = look.SOLID | solid.options
            plotter.add_mesh(solid.mesh, color=solid.color, **options).prop.interpolation = "Phong"
        self.arrow = Arrow(pv, plotter, scene) if scene.windy else None
        self.goals = Goals(pv, plotter, max(scene.grid.width, scene.grid.height))
        self.decoration = [self.ground.actor, self.ground.tiles] + ([self.arrow.actor] if self.arrow else [])
        self._stand(start, member, camera)

    def _handles(self, state: State, member: int) -> np.ndarray:
        return state.positions[member].reshape(3, -1).T[list(self.scene.pins)].astype(np.float32)

    def _fixtures(self, start: State, member: int) -> list[Part]:
        handles = self._handles(start, member)
        return fixtures(self.pv, self.scene, handles, self.ground.height) if self.scene.pins else []

    def _stand(self, start: State, member: int, camera: framing.Camera) -> None:
        """Set what everything moves from, and the lights around the vertical."""
        self.place, self.camera.up = camera, camera.up
        self.anchor, self.start = framing.anchor(self.scene, start, member), self._handles(start, member)
        axes = look.level_axes(camera.towards)
        for light, (at, _, _) in zip(self.lights, look.LIGHTS, strict=True):
            light.position = tuple(np.array(at) @ axes)
        if self.arrow is not None:
            self.arrow.stand(np.array([*start.positions[member, :2].mean((1, 2)), self.ground.height]))

    def frame(self, start: State, member: int, box: np.ndarray, camera: framing.Camera) -> None:
        """Go to another start; the arguments are those of the class."""
        self.ground.lay(box, camera.towards)
        for part, other in zip(self.parts, self._fixtures(start, member), strict=True):
            part.become(other)
        self._stand(start, member, camera)

    def check(self, state: State) -> None:
        """Refuse another resolution than that of the actors.

        Raises:
            ValueError: the state has one.
        """
        if state.positions.shape[2:] != self.scene.grid.shape:
            raise ValueError(
                f"this view draws a grid of {self.scene.grid.shape}, got {state.positions.shape[2:]}; "
                "make another Renderer for another resolution"
            )

    def update(self, state: State, member: int) -> None:
        """Move everything to one member of ``state``.

        Raises:
            ValueError: the state has another resolution than the first one.
        """
        self.check(state)
        positions = state.positions[member].astype(np.float32)
        self.sheet.move(positions)
        for index, body in self.bodies.items():
            body.place(state.colliders[member, index].astype(float))
        moved = self._handles(state, member) - self.start
        for part in self.parts:
            part.follow(moved)
        along = np.zeros(3)
        if self.follow:
            moved_by = framing.anchor(self.scene, state, member) - self.anchor
            along = moved_by * max(0.0, 1.0 - self.slack / max(float(np.linalg.norm(moved_by)), 1e-12))
        self.camera.position = np.add(self.place.position, along)
        self.camera.focal_point = np.add(self.place.focal_point, along)
        if self.arrow is not None:
            self.arrow.blow(state.wind[member], along)
        shading = [refined(positions), *(np.asarray(solid.mesh.points) for solid in self.solids)]
        self.ground.cast(np.concatenate(shading), along)

    def solid_only(self, on: bool) -> None:
        """Hide shadow, arrow and marks and show the ground as a solid (for depth), or the reverse."""
        for actor in (*self.decoration, *self.goals.actors):
            actor.visibility = not on
        self.ground.solid.visibility = on
