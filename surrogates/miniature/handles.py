"""Which vertices of a coarse grid are driven, and how the fine cloth is put back to its handles."""

from typing import NamedTuple

import numpy as np
from _minicloth_kernels import follow, place
from scipy.spatial import cKDTree

from cloth_envs.grid import Grid
from cloth_envs.grip import MIDWAY, Grip, Holding
from cloth_envs.state import Controls

ROUNDING = 1e-5  # m or m/s, of upscaling in float32
CORNERS = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])


class Handles(NamedTuple):
    """Driven vertices of the coarse grid and, for each, the number of the fine handle that it follows.

    ``firm`` are the numbers of the fine handles that are firm, ``near`` the other fine vertices within a coarse cell of
    one, ``guides`` the nearest one among the firm and ``pull`` falls from 1 at the handle to 0.
    """

    vertices: tuple[int, ...]
    follows: np.ndarray
    firm: np.ndarray
    near: np.ndarray
    guides: np.ndarray
    pull: np.ndarray

    @classmethod
    def of(cls, fine: Grid, coarse: Grid, handles: tuple[int, ...], grips: tuple[Grip, ...] = ()) -> "Handles":
        """Coarse vertices within a quarter of a cell of a firm handle, and those nearest to ones that have none.

        About midway between vertices a handle drives all of them: one would not keep it where it is driven. Coarse
        vertices that a grip holds softly follow its lead.
        """
        ratio = np.divide(coarse.cells, fine.cells)
        firm = np.flatnonzero(Holding.of(fine, handles, grips).firm)
        place = np.stack(np.divmod(np.array(handles, np.intp)[firm], fine.cols), 1) * ratio  # in coarse cells
        nearest = np.floor(place + 0.5).astype(int)
        distance = np.abs(place - nearest).max(1)
        driven: dict[int, int] = {}
        for k in np.argsort(distance, kind="stable").tolist():
            around = np.floor(place[k]).astype(int) + CORNERS
            vertices = around[:, 0] * coarse.cols + around[:, 1] % coarse.cols
            if distance[k] < 0.25 or not any(vertex in driven for vertex in vertices.tolist()):
                for vertex in vertices[np.abs(around - place[k]).max(1) < MIDWAY].tolist():
                    driven.setdefault(vertex, int(firm[k]))
        softly: dict[int, tuple[float, int]] = {}
        for grip in grips:
            lead = handles.index(next(iter(grip.weights(fine))))
            for vertex, weight in grip.weights(coarse).items():
                softly[vertex] = max((weight, lead), softly.get(vertex, (0.0, 0)))
        driven = {vertex: lead for vertex, (_, lead) in softly.items()} | driven
        all_places = np.stack(np.divmod(np.arange(fine.vertices), fine.cols), 1) * ratio
        away, guides = cKDTree(place).query(all_places, p=np.inf)
        near = np.flatnonzero((away > 0) & (away < 1))
        pull = (1 - away[near]).astype(np.float32)
        follows = np.array(list(driven.values()), np.int32)
        return cls(tuple(driven), follows, firm, near.astype(np.int32), guides[near].astype(np.int32), pull)

    def place(self, fine: np.ndarray, driven: np.ndarray, handles: np.ndarray) -> None:
        """Put the firm ``handles`` of an upscaled field ``(B, 3, H, W)`` where they are driven, ``(B, N, 3)``.

        What is missing by more than rounding is shared with the vertices around; soft ones are where the cloth is.
        """
        if len(self.firm) < len(handles):
            driven, handles = driven[:, self.firm], handles[self.firm]
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
