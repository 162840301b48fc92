"""What is held of a cloth, by its size in metres: the same patch of cloth on every grid."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cloth_envs.grid import Grid

STIFFNESS = 9.0  # of what holds softly, over the cloth's stretch stiffness per radius^2; docs/physics.md
POINTS = 16  # of a vertex's cell along each side, where a grip's profile is taken
MIDWAY = 0.6  # of the spacing; vertices nearer than this to a middle keep it where it is driven
LEAST = 1e-3  # of a weight; less holds nothing


@dataclass(frozen=True)
class Grip:
    """A round patch of the flat sheet, held firmly in its middle and less towards its edge.

    ``middle`` [m] is how far it lies from the first row and from the first column. The weight of a piece of cloth falls
    linearly from 1 at the middle to 0 at ``radius`` [m]. Held with a sharp edge, a cloth's strain there would grow
    without bound on finer grids. ``along`` are the axes that the soft part is held along; the middle is along all.
    """

    middle: tuple[float, float]
    radius: float
    along: tuple[bool, bool, bool] = (True, True, True)

    def weights(self, grid: Grid) -> dict[int, float]:
        """Vertices of an open grid and how much of each is held: the mean weight of its share of the sheet.

        The first is the one nearest to the middle, the lead: it is held firmly (1), so that a point of the cloth is
        driven, and the others with it. Where the middle lies about midway between vertices, all of these are firm.
        """
        spacing = grid.row_spacing, grid.col_spacing
        near, away = zip(*map(self._along, self.middle, grid.shape, spacing), strict=True)
        distance = np.hypot(away[0][:, :, None, None], away[1])
        weights = np.clip(1.0 - distance / self.radius, 0.0, 1.0).mean((1, 3))
        off = [np.abs(at - middle / d) for at, middle, d in zip(near, self.middle, spacing, strict=True)]
        cells = np.maximum(off[0][:, None], off[1])
        weights[cells < max(MIDWAY, cells.min() + 1e-9)] = 1.0
        vertices = near[0][:, None] * grid.cols + near[1]
        order = np.argsort(cells, axis=None, kind="stable")
        pairs = zip(vertices.ravel()[order].tolist(), weights.ravel()[order].tolist(), strict=True)
        return {vertex: weight for vertex, weight in pairs if weight > LEAST}

    def _along(self, middle: float, count: int, spacing: float) -> tuple[np.ndarray, np.ndarray]:
        """Of ``count`` places along a side those near the middle, and how far points of their cells are from it [m]."""
        at = np.arange(count)
        at = at[np.abs(at * spacing - middle) < self.radius + spacing]
        low, high = np.maximum(at - 0.5, 0.0), np.minimum(at + 0.5, count - 1.0)
        inside = (np.arange(POINTS) + 0.5) / POINTS
        return at, (low[:, None] + (high - low)[:, None] * inside) * spacing - middle


def held(grid: Grid, grips: Sequence[Grip]) -> tuple[int, ...]:
    """The vertices that ``grips`` hold, in order."""
    return tuple(sorted({vertex for grip in grips for vertex in grip.weights(grid)}))


class Holding(NamedTuple):
    """How handles are held: ``hold`` ``(N, 3)`` [1/m^2] along x, y, z; ``lead`` ``(N,)``, the handle that one follows.

    A firm handle is driven: its ``hold`` is infinite. A soft one, of weight ``t`` in a grip of radius ``r``, is drawn
    by a spring of ``9 t / (1 - t)^2 / r^2`` times the cloth's stretch stiffness, per area, to where it would be if it
    had moved with its lead alone. Around the middle that is ``9 / d^2`` at a distance ``d``: the cloth's displacement
    grows as ``d^3`` there, so that the lead itself carries nothing, however fine the grid.
    """

    hold: np.ndarray
    lead: np.ndarray

    @classmethod
    def of(cls, grid: Grid, handles: Sequence[int], grips: Sequence[Grip]) -> "Holding":
        """Of handles on a grid. Those in no grip are firm; a vertex in two follows the one that holds it more."""
        found: dict[int, tuple[float, int, Grip]] = {}
        for grip in grips:
            weights = grip.weights(grid)
            lead = next(iter(weights))
            for vertex, t in weights.items():
                if vertex not in found or t > found[vertex][0]:
                    found[vertex] = t, lead, grip
        number = {vertex: i for i, vertex in enumerate(handles)}
        hold, leads = np.full((len(handles), 3), np.inf), np.arange(len(handles), dtype=np.int32)
        for i, vertex in enumerate(handles):
            if vertex in found:
                t, lead, grip = found[vertex]
                leads[i] = number[lead]
                if t < 1:
                    hold[i] = STIFFNESS * t / (1 - t) ** 2 / grip.radius**2 * np.array(grip.along)
        return cls(hold, leads)

    @property
    def firm(self) -> np.ndarray:
        """Which of them are firm, ``(N,)``."""
        return np.isinf(self.hold[:, 0])
