"""Which vertices of a coarse grid are driven, and how the fine cloth is put back to its handles."""

from typing import NamedTuple

import numpy as np
from _minicloth_kernels import follow, place
from scipy.spatial import cKDTree

from cloth_envs.grid import Grid
from cloth_envs.state import Controls

ROUNDING = 1e-5  # m or m/s, of upscaling in float32
MIDWAY = 0.6  # coarse cells
CORNERS = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])


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
    def of(cls, fine: Grid, coarse: Grid, handles: tuple[int, ...]) -> "Handles":
        """Coarse vertices within a quarter of a cell of a handle, and those nearest to handles that have none.

        About midway between vertices a handle drives all of them: one would not keep it where it is driven.
        """
        ratio = np.divide(coarse.cells, fine.cells)
        place = np.stack(np.divmod(np.array(handles, np.intp), fine.cols), 1) * ratio  # in coarse cells
        nearest = np.floor(place + 0.5).astype(int)
        distance = np.abs(place - nearest).max(1)
        driven: dict[tuple[int, int], int] = {}
        for k in np.argsort(distance, kind="stable").tolist():
            around = np.floor(place[k]).astype(int) + CORNERS
            if distance[k] < 0.25 or not any(tuple(corner) in driven for corner in around.tolist()):
                for corner in around[np.abs(around - place[k]).max(1) < MIDWAY].tolist():
                    driven.setdefault(tuple(corner), k)
        vertices = tuple(row * coarse.cols + col % coarse.cols for row, col in driven)
        follows = np.array(list(driven.values()), np.int32)
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

    def offsets(self, coarse: np.ndarray, driven: np.ndarray) -> np.ndarray:
        """Where the coarse vertices are from what they follow, ``(B, n, 3)`` [m]; 0 where they are the same vertex.

        ``coarse`` are positions ``(B, 3, h, w)``, ``driven`` those of the fine handles, ``(B, N, 3)``.
        """
        here = coarse.reshape(len(coarse), 3, -1)[:, :, list(self.vertices)].transpose(0, 2, 1)
        return (here - driven[:, self.follows]).astype(np.float64)

    def controls(self, controls: Controls, offsets: np.ndarray) -> Controls:
        """The controls of the coarse cloth; bodies, wind and pressure are the same."""
        positions, velocities = follow(controls.handle_positions, controls.handle_velocities, self.follows, offsets)
        return Controls(
            positions, velocities,
            controls.colliders, controls.collider_velocities, controls.wind, controls.pressure,
        )  # fmt: skip
