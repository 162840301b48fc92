"""Contact: depth in bodies, vertices that went through one, triangles that cross each other."""

from collections.abc import Sequence
from itertools import pairwise

import _minicloth_kernels as kernels
import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.physics.laws.bodies import axis_parameter, dot, on_axis
from cloth_envs.physics.laws.diagnostics import Penetration, penetration
from cloth_envs.scene import Scene
from cloth_envs.state import State

SAMPLES = 17  # between two frames


def inside(scene: Scene, state: State) -> Penetration:
    """Depth of the vertices inside of bodies (mean, max) and how many these are; the thickness does not count."""
    return penetration(scene, state, thickness=0.0)


def tunnelled(scene: Scene, states: Sequence[State]) -> np.ndarray:
    """How many times a vertex went through a body from one state to the next, ``(B,)``.

    All move in straight lines between two states. Through a ball or capsule is: outside at both ends, and nearer to its
    middle than half the radius in between (cutting a corner is none); through a plane: above before, below after.
    """
    count = np.zeros(states[0].batch, np.int64)
    for before, after in pairwise(states):
        x0, x1 = (s.positions.astype(np.float64).reshape(s.batch, 3, -1) for s in (before, after))
        for number, body in enumerate(scene.colliders):
            c0, c1 = (s.colliders[:, number].astype(np.float64) for s in (before, after))
            if body.kind == "plane":
                g0, g1 = (dot(c[:, 1][:, :, None], x - c[:, 0][:, :, None]) for c, x in ((c0, x0), (c1, x1)))
                count += ((g0 > 0) & (g1 < 0)).sum((1, 2))
                continue
            start = np.linalg.norm(x0 - on_axis(c0, axis_parameter(c0, x0)), axis=1)
            way = np.linalg.norm(x1 - x0, axis=1) + np.linalg.norm(c1 - c0, axis=-1).max(1)[:, None]
            if (start - way).min() >= body.radius / 2:  # none can come as near
                continue
            gaps = []
            for s in np.linspace(0, 1, SAMPLES):
                x, ends = x0 + s * (x1 - x0), c0 + s * (c1 - c0)
                gaps.append(np.linalg.norm(x - on_axis(ends, axis_parameter(ends, x)), axis=1))
            through = (gaps[0] >= body.radius) & (gaps[-1] >= body.radius) & (np.min(gaps, 0) < body.radius / 2)
            count += through.sum(1)
    return count


def crossing_triangles(grid: Grid, positions: np.ndarray) -> np.ndarray:
    """Pairs of the cloth's triangles that pass through each other, ``(B,)`` of ``positions`` ``(B, 3, H, W)``.

    An edge of one crosses the inside of the other, and they have no vertex in common; touching is none.
    ``kernels.crossing_pairs`` lists them.

    Raises:
        ValueError: positions that are not finite.
    """
    return kernels.crossing_triangles(positions, periodic=grid.periodic)
