"""``Series``: what every format writes of a trajectory."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cloth_envs.export.bodies import Place, make, place
from cloth_envs.grid import Grid
from cloth_envs.recording import Rollout
from cloth_envs.rendering.sheet import drawn, normals, vertex_strain
from cloth_envs.state import State

PLANE = 4.0  # least side of a plane's square, in lengths of the cloth
FAR = 1e15  # m, m/s, s: beyond it float32 overflows where values are subtracted or squared


@dataclass(frozen=True)
class Frame:
    """One frame; N vertices.

    Attributes:
        number: the frame's number in the recording.
        time: [s].
        positions, velocities, normals: ``(N, 3)`` float32 [m], [m/s] and unit vectors.
        strain: ``(N,)`` float32, structural, positive when stretched.
        places: where the bodies are.
    """

    number: int
    time: float
    positions: np.ndarray
    velocities: np.ndarray
    normals: np.ndarray
    strain: np.ndarray
    places: list[Place]


class Series:
    """Every ``every``-th frame of one trajectory, all of them looked at once before the first is given.

    The vertices are those of the recording, row by row; of a tube the first column comes again at the end, where the
    texture is cut. Times are the recording's, or number times ``frame_dt`` where those do not increase from 0 or later.

    Attributes:
        scene: what was recorded.
        triangles: ``(F, 3)`` int32, counter-clockwise seen from where the normals point.
        texture: ``(N, 2)`` float32 in [0, 1]; u along a row, v upwards, 1 at the first row.
        bodies: what moves beside the cloth; a plane's square is where the cloth is.

    Raises:
        ValueError: no such trajectory, one without a frame, or a frame that is not finite.
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
        times, low, high = [], np.full(3, np.inf), np.full(3, -np.inf)
        for number in self._numbers:
            state = rollout.state(number, trajectory)
            self._check(number, state)
            times.append(float(state.time[0]))
            low = np.minimum(low, state.positions[0].min((1, 2)))
            high = np.maximum(high, state.positions[0].max((1, 2)))
        self._times = increasing(times, self._numbers, self.scene.frame_dt)
        self._centre = (low + high) / 2
        side = max(PLANE * grid.length, 2 * float(np.linalg.norm(high - low)))
        self.bodies = [make(number, collider, side) for number, collider in enumerate(self.scene.colliders)]

    def __len__(self) -> int:
        return len(self._numbers)

    def __iter__(self) -> Iterator[Frame]:
        for number, time in zip(self._numbers, self._times, strict=True):
            yield self._frame(number, time, self._rollout.state(number, self._trajectory))

    def _check(self, number: int, state: State) -> None:
        for name in ("positions", "velocities", "colliders"):
            if not (np.abs(getattr(state, name)) < FAR).all():
                raise ValueError(
                    f"frame {number} of trajectory {self._trajectory} has {name} that are not finite, or huge: "
                    "choose another trajectory, or record one that ends before"
                )

    def _frame(self, number: int, time: float, state: State) -> Frame:
        grid, at = self.scene.grid, state.positions[0]
        bodies = zip(self.bodies, state.colliders[0].astype(float), strict=True)

        def listed(values: np.ndarray) -> np.ndarray:  # (3, H, W) to (N, 3)
            return np.ascontiguousarray(drawn(values, grid.periodic).reshape(3, -1).T, np.float32)

        return Frame(
            number=number,
            time=time,
            positions=listed(at),
            velocities=listed(state.velocities[0]),
            normals=listed(normals(at.astype(float), grid.periodic)),
            strain=drawn(vertex_strain(at.astype(float), grid), grid.periodic).ravel().astype(np.float32),
            places=[place(body.kind, ends, self._centre) for body, ends in bodies],
        )


def increasing(times: Sequence[float], numbers: Sequence[int], frame_dt: float) -> list[float]:
    """``times`` [s] where no file mixes them up: from 0 or later, with steps that show in float32 and in frames."""
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.diff(np.array(times, np.float32))
    if 0 <= times[0] < FAR and (steps > 1e-3 * frame_dt).all() and (steps < FAR).all():
        return list(times)
    return [number * frame_dt for number in numbers]
