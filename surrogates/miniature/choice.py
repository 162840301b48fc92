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
    """``scaling`` and ``upscaler`` by name, and of how many cells along a side ``least`` are kept."""

    scaling: str = "similar"
    upscaler: str = "bicubic"
    least: int = 2


def choose(scene: Scene, factor: int) -> Choice:
    """``"closure"`` and ``"local"`` where both are shipped for the scene, else ``"similar"`` and ``"bicubic"``.

    A cloth would tear with the former on grids unlike those of training: with fewer than half the cells of the scene's
    own along a side, or with cells over ``OBLONG`` times longer than wide. It is interpolated linearly there, from at
    least ``LEAST`` cells along each side; one that has no more is not coarsened.
    """
    if scene.name not in card("closure")["scenes"] or not of_factor(weights_name("local", scene.name), factor):
        return Choice()
    fine, own = scene.grid, load_task(scene.name).resolution
    small = any(2 * cells < usual - 1 for cells, usual in zip(fine.cells, own, strict=True))
    if not small and not _oblong(fine) and not _oblong(coarse_grid(fine, factor)):
        return Choice("closure", "local")
    return Choice("similar" if coarse_grid(fine, factor, LEAST) == fine else "closure", "bilinear", LEAST)


def _oblong(grid: Grid) -> bool:
    """Whether cells are much longer than wide, or wider than long."""
    return bool(abs(np.log(grid.row_spacing / grid.col_spacing)) > np.log(OBLONG))
