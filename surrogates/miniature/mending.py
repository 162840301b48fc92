"""Edges of the upscaled cloth brought to their lengths at rest: wrinkle meshes (Mueller & Chentanez 2010).

Interpolation shortens a cloth where the coarse one is compressed, which real cloth answers by wrinkles, and lengthens
edges beside handles. Sweeps of Gauss-Seidel, as in position-based dynamics, move both ends of every edge by half of
what it is too long or too short, times a share. Too long is what exceeds ``SLACK``: cloth that is pulled is longer than
at rest. Diagonals are left out: with them sweeps took twice the time, and edges were no nearer to their lengths.

Sweeps are few, and a smooth sheet has no way out of its plane. So cloth that is shortened by a strain ``e`` begins with
a zigzag of four edges a wave, along its normal and fixed in the cloth, of slope ``wave sqrt(2 (e - BUCKLING))``; one of
slope ``sqrt(2 e)`` takes up all of ``e``. Rows and columns have their own, the border has none. A fixed wave keeps
wrinkles where they were, so that frames need nothing of the ones before them and can be computed when they are read.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from _minicloth_kernels import Mend

from cloth_envs.grid import Grid
from cloth_envs.grip import Holding
from cloth_envs.scene import Scene
from surrogates.upscale.protocol import Upscaler, is_compiled

SLACK, BUCKLING = 0.02, 0.003  # strains


class Level(NamedTuple):
    """``sweeps``, the share ``shorter`` that an edge loses of what it is too short, and ``wave`` before them."""

    sweeps: int
    shorter: float
    wave: float


# Chosen for the truth's bending energy, little strain and little time on seeds 600-602, 100 frames of the actions that
# ``bench wrinkles`` takes; that measures other seeds.
BETWEEN = Level(4, 0.5, 0.0)  # at half the coarse spacing, where a network gives that
LAST = {2: Level(7, 0.6, 0.55), 3: Level(3, 0.5, 0.6), 4: Level(1, 0.7, 0.75)}  # by the grid's factor
ALONE = Level(4, 0.5, 0.5)  # without ``BETWEEN``
MORE = Level(16, 0.5, 0.0)  # of a guarded cloth whose edges are still too long, beside handles between coarse vertices


def mends(scene: Scene, coarse: Grid) -> bool:
    """Whether a cloth upscaled from ``coarse`` gains by it: one that folds and hardly stretches.

    One whose border is held all around is taut, and one that its own weight would stretch by more than ``SLACK`` is
    soft: their edges are longer than at rest for good reasons. A tube stays as it is, for no sweep reaches the edges
    across its seam, and so does a cloth that is not coarser.
    """
    grid, material = scene.grid, scene.material
    taut = set(grid.border.tolist()) <= set(scene.handles)
    soft = material.areal_density * scene.gravity * grid.height > SLACK * material.stretch_stiffness
    return not (taut or soft or grid.periodic or coarse == grid)


def mend(grid: Grid, held: Sequence[int], level: Level) -> Mend:
    """What mends cloths on ``grid``, whose vertices ``held`` stay."""
    return Mend(
        grid.rows,
        grid.cols,
        grid.row_spacing,
        grid.col_spacing,
        np.array(held, np.int32),
        level.sweeps,
        slack=SLACK,
        shorter=level.shorter,
        wave=level.wave,
        buckling=BUCKLING,
    )


class Mending(NamedTuple):
    """What mends fine cloths: at half the coarse spacing, if there is such a step; at the end; without such a step.

    And ``more``, what a cloth without such a step is mended by once more where that was not enough.
    """

    between: Mend | None
    last: Mend
    alone: Mend
    more: Mend

    @classmethod
    def of(cls, upscaling: Upscaler, driven: Sequence[int]) -> "Mending":
        """For what ``upscaling`` makes of a coarse cloth whose vertices ``driven`` follow handles."""
        scene, half, cols = upscaling.fine, upscaling.half, upscaling.coarse.grid.cols
        firm = np.array(scene.handles, np.int32)[Holding.of(scene.grid, scene.handles, scene.grips).firm].tolist()
        alone = mend(scene.grid, firm, LAST[2] if upscaling.factor <= 2 else ALONE)
        more = mend(scene.grid, firm, MORE)
        if half is None or not is_compiled(upscaling.positions):
            return cls(None, alone, alone, more)
        held = [2 * (vertex // cols) * half.cols + 2 * (vertex % cols) for vertex in driven]
        last = mend(scene.grid, firm, LAST[round(upscaling.factor)])
        return cls(mend(half, held, BETWEEN), last, alone, more)
