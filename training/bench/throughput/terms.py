"""The terms that are timed one by one, and what their source computes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

from cloth_envs.material import Material
from cloth_envs.scene import Air, Collider


class Work(NamedTuple):
    """Arithmetic for a vertex: ``operations`` (a fused multiply-add is two) and ``instructions`` (it is one)."""

    operations: float
    instructions: float

    def plus(self, other: "Work", held: int = 1) -> "Work":
        """With ``other`` every ``held`` substeps."""
        return Work(self.operations + other.operations / held, self.instructions + other.instructions / held)


NOTHING = Work(0, 0)
# Of an inner vertex of even cloth in float32, by the kernels' source (explicit/step.hpp, springs.hpp and slow.hpp,
# near.hpp, sheet/air.hpp); comparisons and shuffles are not counted. Four edges and the step:
SPRINGS = Work(4 * (16 + 7) + 24 + 31, 4 * (11 + 4) + 18 + 18)
YIELDING = Work(4 * 30, 4 * 18)  # a second length and the branches of four edges
AHEAD = Work(6, 3)  # slow forces: where the vertex will be
BENDING = Work(111, 90)
AIR = Work(87 + 4 * 52 + 9, 78 + 4 * 38 + 6)  # four triangles of a cell, and its velocity ahead
PRESSURE = Work(87, 78)
SPHERE, PLANE, CAPSULE = Work(8, 6), Work(9, 7), Work(19, 13)  # how far it is, every few substeps (explicit/near.hpp)


@dataclass(frozen=True)
class Term:
    """A sheet with terms up to this one: what is computed every substep, and what is held for some."""

    material: Material
    every: Work
    slow: Work = NOTHING
    extra: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    body: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None

    def work(self, held: int) -> Work:
        """A substep's, where slow forces are held for ``held``."""
        return self.every.plus(self.slow, held)


def _body(kind: str, work: Work, first: tuple[float, float, float], second: tuple[float, float, float]) -> Term:
    extra = {"colliders": (Collider(kind, 0.0 if kind == "plane" else 0.1),)}
    return Term(Material(), SPRINGS, AHEAD.plus(BENDING).plus(work), extra, (first, second))


# Gravity is in every row. Bodies touch a few of the vertices of a sheet whose corner is at the origin.
TERMS = {
    "springs": Term(Material(bend_stiffness=0.0, damping=0.0), SPRINGS),
    "+ dampers": Term(Material(bend_stiffness=0.0), SPRINGS),
    "+ bending": Term(Material(), SPRINGS, AHEAD.plus(BENDING)),
    "+ air": Term(Material(), SPRINGS, AHEAD.plus(BENDING).plus(AIR), {"air": Air()}),
    "+ pressure, no air": Term(Material(), SPRINGS, AHEAD.plus(BENDING).plus(PRESSURE), {"pressure": True}),
    "+ sphere, no air": _body("sphere", SPHERE, (0.5, 0.5, -0.09), (0.5, 0.5, -0.09)),
    "+ plane, no air": _body("plane", PLANE, (0.0, 0.0, -0.021), (0.0, 0.0, 1.0)),
    "+ capsule, no air": _body("capsule", CAPSULE, (0.4, 0.5, -0.09), (0.6, 0.5, -0.09)),
    "yielding springs": Term(Material(compression=0.1), SPRINGS.plus(YIELDING), AHEAD.plus(BENDING)),
}
DEFAULT = "+ bending"
