"""A scene on a coarser grid: which vertices are driven, and what the sheet weighs and resists there."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from _minicloth_kernels import follow, place
from scipy.spatial import cKDTree

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.scene import Scene
from cloth_envs.state import Controls

SCALINGS = ("similar", "seed", "calibrated", "closure")
# Material properties that a calibration multiplies; a closure multiplies those after them too.
FACTORS = ("areal_density", "stretch_stiffness", "shear_stiffness", "bend_stiffness", "damping", "compression")
CLOSURE = (*FACTORS, "buckling_strain", "post_buckling", "compression_damping")


ROUNDING = 1e-5  # m or m/s, of upscaling in float32
CORNERS = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])


def coarse_grid(grid: Grid, factor: int) -> Grid:
    """The same sheet with about ``factor`` times fewer cells along each side.

    Where ``factor`` divides the cells, every vertex of it is a vertex of ``grid``.
    """
    rows, cols = (max(2, round(cells / factor)) for cells in grid.cells)
    return replace(grid, rows=rows + 1, cols=max(3, cols if grid.periodic else cols + 1))


def miniature_material(material: Material, factor: int, scaling: str, factors: dict[str, float]) -> Material:
    """The material of the full-size coarse sheet that moves as the miniature does, in its own units.

    A miniature is the down-sampled cloth with its axes divided by ``s``: rest length, particle mass and step
    are the fine cloth's, external forces are divided by ``s``. Enlarged ``s`` times it is a coarse sheet of
    the same density. ``"seed"`` (Lee et al. 2019) keeps the spring constants: enlarged, the sheet is ``s^2``
    times too stiff in stretch and shear and ``s^4`` times in bending. ``"similar"`` divides them by that, which
    leaves the material itself. ``"calibrated"`` and ``"closure"`` multiply its properties by fitted ``factors``.
    """
    if scaling == "seed":
        return material.with_changes(
            stretch_stiffness=material.stretch_stiffness * factor**2,
            shear_stiffness=material.shear_stiffness * factor**2,
            bend_stiffness=material.bend_stiffness * factor**4,
        )
    return material.with_changes(**{name: getattr(material, name) * value for name, value in factors.items()})


class Handles(NamedTuple):
    """Driven vertices of the coarse grid and, for each, the number of the fine handle that it follows.

    ``near`` are the free fine vertices within a coarse cell of a handle, ``guides`` the number of the nearest one and
    ``pull`` falls from 1 at the handle to 0.
    """

    vertices: tuple[int, ...]
    follows: np.ndarray
    near: np.ndarray
    guides: np.ndarray
    pull: np.ndarray

    @classmethod
    def of(cls, fine: Grid, coarse: Grid, handles: tuple[int, ...]) -> Handles:
        """Coarse vertices within a quarter of a cell of a handle, and the nearest ones to handles that have none."""
        ratio = np.divide(coarse.cells, fine.cells)
        place = np.stack(np.divmod(np.array(handles, np.intp), fine.cols), 1) * ratio  # in coarse cells
        nearest = np.floor(place + 0.5).astype(int)
        distance = np.abs(place - nearest).max(1)
        driven: dict[tuple[int, int], int] = {}
        for k in np.argsort(distance, kind="stable").tolist():
            around = [tuple(corner) for corner in (np.floor(place[k]) + CORNERS).astype(int).tolist()]
            if distance[k] < 0.25 or not any(corner in driven for corner in around):
                driven.setdefault(tuple(nearest[k]), k)
        vertices = tuple(row * coarse.cols + col % coarse.cols for row, col in driven)
        follows = np.array(list(driven.values()), np.int32)
        if not handles:
            nothing = np.zeros(0, np.int32)
            return cls(vertices, follows, nothing, nothing, np.zeros(0, np.float32))
        all_places = np.stack(np.divmod(np.arange(fine.vertices), fine.cols), 1) * ratio
        away, guides = cKDTree(place).query(all_places, p=np.inf)
        near = np.flatnonzero((away > 0) & (away < 1))
        pull = (1 - away[near]).astype(np.float32)
        return cls(vertices, follows, near.astype(np.int32), guides[near].astype(np.int32), pull)

    def place(self, fine: np.ndarray, driven: np.ndarray, handles: np.ndarray) -> None:
        """Put the handles of an upscaled field ``(B, 3, H, W)`` where they are driven, ``(B, N, 3)``.

        What is missing by more than rounding is shared with the free vertices around.
        """
        place(fine, driven, handles, self.near, self.guides, self.pull, ROUNDING)

    def offsets(self, fine: np.ndarray, coarse: np.ndarray, handles: tuple[int, ...]) -> np.ndarray:
        """Where the coarse vertices are from what they follow, ``(B, N, 3)`` [m]; 0 where they are the same vertex."""
        followed = np.array(handles, np.intp)[self.follows]
        here, there = coarse.reshape(len(coarse), 3, -1), fine.reshape(len(fine), 3, -1)
        return (here[:, :, list(self.vertices)] - there[:, :, followed]).transpose(0, 2, 1).astype(np.float64)

    def controls(self, controls: Controls, offsets: np.ndarray) -> Controls:
        """The controls of the coarse cloth; bodies, wind and pressure are the same."""
        positions, velocities = follow(controls.handle_positions, controls.handle_velocities, self.follows, offsets)
        return Controls(
            positions, velocities,
            controls.colliders, controls.collider_velocities, controls.wind, controls.pressure,
        )  # fmt: skip


def coarse_scene(scene: Scene, factor: int, material: Material) -> tuple[Scene, Handles]:
    """``scene`` on ``coarse_grid`` with ``material``, and how its handles follow those of ``scene``."""
    grid = coarse_grid(scene.grid, factor)
    handles = Handles.of(scene.grid, grid, scene.handles)
    return replace(scene, grid=grid, handles=handles.vertices, material=material), handles
