"""The marks of a goal in a picture."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cloth_envs.marks import Mark
from cloth_envs.rendering import look
from cloth_envs.style import INK

DOT, FIGURE = 0.014, 0.30  # of the cloth's longer side: radius of a dot, height of an onlooker


class Goals:
    """Actors of marks in the active subplot of ``plotter``, made as they are first shown and then moved.

    Args:
        size: the cloth's longer side [m].
    """

    def __init__(self, pv: Any, plotter: Any, size: float) -> None:
        self.pv, self.plotter, self.size = pv, plotter, size
        self.shown: list[tuple[Mark, list[Any]]] = []

    @property
    def actors(self) -> list[Any]:
        """All of them."""
        return [actor for _, actors in self.shown for actor in actors]

    def show(self, marks: Sequence[Mark], met: bool, ground: float) -> None:
        """Show ``marks`` in place of others, as ``met`` or not, over a ground at that height [m]."""
        shapes = [(mark.kind, mark.own, mark.points.shape) for mark in marks]
        if shapes != [(mark.kind, mark.own, mark.points.shape) for mark, _ in self.shown]:
            for actor in self.actors:
                self.plotter.remove_actor(actor, render=False)
            self.shown = [(mark, self._made(mark)) for mark in marks]
        for mark, (_, actors) in zip(marks, self.shown, strict=True):
            for actor in actors:
                actor.prop.color = INK if mark.own else look.MET if met else look.GOAL
            self._move(mark, actors, ground)

    def _made(self, mark: Mark) -> list[Any]:
        pv = self.pv
        sphere = pv.Sphere(radius=1.0, theta_resolution=32, phi_resolution=24)
        if mark.kind == "ghost":
            return [self._through(sphere, opacity=look.GHOST, **look.SOLID)]
        if mark.kind == "dot":
            return [self._through(sphere, lighting=False)]
        sight = pv.lines_from_points(mark.points)
        if mark.kind == "line":
            return [self._through(sight, line_width=3.0 if mark.own else 4.5, lighting=False)]
        body = pv.Cone(center=(0, 0, 0.38), direction=(0, 0, 1), height=0.76, radius=0.24, resolution=32)
        figure = body.merge(pv.Sphere(radius=0.2, center=(0, 0, 0.8)))
        return [self.plotter.add_mesh(figure, **look.SOLID), self._through(sight, line_width=3.0, lighting=False)]

    def _through(self, mesh: Any, **options: Any) -> Any:
        """An actor that nothing hides: its depth is brought near to the camera's."""
        actor = self.plotter.add_mesh(mesh, **options)
        near = "//VTK::Depth::Impl\n  gl_FragDepth = 0.001 * gl_FragCoord.z;\n"
        actor.GetShaderProperty().AddFragmentShaderReplacement("//VTK::Depth::Impl", True, near, False)
        return actor

    def _move(self, mark: Mark, actors: list[Any], ground: float) -> None:
        points = mark.points
        if mark.kind in ("dot", "ghost"):
            actors[0].position = tuple(points[0])
            actors[0].scale = DOT * self.size if mark.kind == "dot" else mark.radius
            return
        if mark.kind == "onlooker":
            height = FIGURE * self.size
            foot = np.array([*points[0, :2], ground])
            actors[0].position, actors[0].scale = tuple(foot), height
            points = np.stack([foot + np.array([0.0, 0.0, 0.8 * height]), points[1]])
        mesh = actors[-1].mapper.dataset
        mesh.points = points.astype(np.float32)
