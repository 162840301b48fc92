"""``Series``: what every format writes of a trajectory."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cloth_envs.export import bodies
from cloth_envs.grid import Grid
from cloth_envs.recording import Rollout
from cloth_envs.rendering.sheet import drawn, normals, vertex_strain
from cloth_envs.state import State


@dataclass(frozen=True)
class Frame:
    """One frame; N vertices, C bodies.

    Attributes:
        number: the frame's number in the recording.
        time: [s].
        positions, velocities, normals: ``(N, 3)`` float32 [m], [m/s] and unit vectors.
        strain: ``(N,)`` float32, structural, positive when stretched.
        translations, quaternions: of the bodies, ``(C, 3)`` [m] and ``(C, 4)`` x y z w.
    """

    number: int
    time: float
    positions: np.ndarray
    velocities: np.ndarray
    normals: np.ndarray
    strain: np.ndarray
    translations: np.ndarray
    quaternions: np.ndarray


class Series:
    """Every ``every``-th frame of one trajectory.

    The vertices are those of the recording, row by row; of a tube the first column comes again at the end, where the
    texture is cut.

    Attributes:
        scene: what was recorded.
        triangles: ``(F, 3)`` int32, counter-clockwise seen from where the normals point.
        texture: ``(N, 2)`` float32 in [0, 1]; u along a row, v upwards, 1 at the first row.
        bodies: what moves beside the cloth.

    Raises:
        ValueError: no such trajectory, or one without a frame.
    """

    def __init__(self, rollout: Rollout, trajectory: int = 0, every: int = 1) -> None:
        length = rollout.length(trajectory)
        if not length:
            raise ValueError(f"trajectory {trajectory} holds no whole frame: its writer was killed; choose another")
        self._rollout, self._trajectory = rollout, trajectory
        self._numbers = range(0, length, every)
        self.scene = rollout.scene
        grid = self.scene.grid
        flat = Grid(grid.rows, grid.cells[1] + 1, grid.height, grid.width)
        self.triangles = flat.triangles.astype(np.int32)
        v, u = np.meshgrid(np.linspace(1, 0, flat.rows), np.linspace(0, 1, flat.cols), indexing="ij")
        self.texture = np.stack([u.ravel(), v.ravel()], 1).astype(np.float32)
        first = rollout.state(0, trajectory).colliders[0].astype(float)
        self.bodies = [bodies.make(i, c, first[i], grid.length) for i, c in enumerate(self.scene.colliders)]

    def __len__(self) -> int:
        return len(self._numbers)

    def __iter__(self) -> Iterator[Frame]:
        for number in self._numbers:
            yield self._frame(number, self._rollout.state(number, self._trajectory))

    def _frame(self, number: int, state: State) -> Frame:
        grid, at = self.scene.grid, state.positions[0]
        placed = [bodies.place(b, e) for b, e in zip(self.bodies, state.colliders[0].astype(float), strict=True)]

        def listed(values: np.ndarray) -> np.ndarray:  # (3, H, W) to (N, 3)
            return np.ascontiguousarray(drawn(values, grid.periodic).reshape(3, -1).T, np.float32)

        return Frame(
            number=number,
            time=float(state.time[0]),
            positions=listed(at),
            velocities=listed(state.velocities[0]),
            normals=listed(normals(at.astype(float), grid.periodic)),
            strain=drawn(vertex_strain(at.astype(float), grid), grid.periodic).ravel().astype(np.float32),
            translations=np.array([p for p, _ in placed]).reshape(-1, 3),
            quaternions=np.array([q for _, q in placed]).reshape(-1, 4),
        )
