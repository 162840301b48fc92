"""What a miniature is made of by default: what is shipped, on grids like those that it was fitted and trained on."""

from typing import NamedTuple

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.registry import load_task
from cloth_envs.scene import Scene
from surrogates.checkpoint import of_factor
from surrogates.miniature.closure import card
from surrogates.miniature.coarse import coarse_grid
from surrogates.upscale.local import weights_name

OBLONG = 1.5
LEAST = 6  # coarse cells along a side


class Choice(NamedTuple):
    """``scaling`` and ``upscaler`` by name and the ``least`` coarse cells along rows and columns."""

    scaling: str = "similar"
    upscaler: str = "bicubic"
    least: tuple[int, int] = (2, 2)


def choose(scene: Scene, factor: int) -> Choice:
    """``"closure"`` and ``"local"`` where both are shipped for the scene.

    A small or thin cloth would tear with them. Along a side of fewer than half the cells of the scene's own grid
    ``LEAST`` cells are kept; where that keeps more than ``factor`` would, and where cells are over ``OBLONG`` times
    longer than wide, the cloth is interpolated linearly, and where it keeps all, it is the fine one.
    """
    if scene.name not in card("closure")["scenes"] or not of_factor(weights_name("local", scene.name), factor):
        return Choice()
    fine, usual = scene.grid, coarse_grid(scene.grid, factor)
    own = load_task(scene.name).resolution
    rows, cols = (2 if 2 * cells >= n - 1 else LEAST for cells, n in zip(fine.cells, own, strict=True))
    coarse = coarse_grid(fine, factor, (rows, cols))
    if coarse == fine:
        return Choice("similar", "bilinear", (rows, cols))
    trained = coarse == usual and not (_oblong(fine) or _oblong(coarse))
    return Choice("closure", "local" if trained else "bilinear", (rows, cols))


def _oblong(grid: Grid) -> bool:
    """Whether cells are much longer than wide, or wider than long."""
    return bool(abs(np.log(grid.row_spacing / grid.col_spacing)) > np.log(OBLONG))
