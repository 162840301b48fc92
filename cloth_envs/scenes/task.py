"""What every scene file fills in: a Task maps actions to controls and states to rewards, batched."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import _minicloth_kernels as kernels
import numpy as np

from cloth_envs.failure import MAX_STRAIN
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State


@dataclass
class Start:
    """How one episode begins: ``positions`` and ``velocities`` ``(3, H, W)``, ``colliders`` ``(C, 2, 3)``.

    ``memory`` holds what the task must remember (goals, gust phases); one array a name.
    """

    positions: np.ndarray
    velocities: np.ndarray
    colliders: np.ndarray
    memory: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass
class Episode:
    """What a task sees at a step: the batch's state, its memory ``(B, ...)`` and the clipped action ``(B, A)``."""

    state: State
    memory: dict[str, np.ndarray]
    action: np.ndarray

    @property
    def cloth(self) -> np.ndarray:
        """Positions with flat vertices, ``(B, 3, H * W)``; a view."""
        return self.state.positions.reshape(len(self.action), 3, -1)

    @property
    def cloth_velocity(self) -> np.ndarray:
        """Velocities with flat vertices, ``(B, 3, H * W)``; a view."""
        return self.state.velocities.reshape(len(self.action), 3, -1)


class Task(ABC):
    """One scene's task. Every method takes and returns batches, so single and vector environments agree bit for bit.

    Class attributes:
        size: rest ``(height, width)`` [m]. resolution: default ``(rows, cols)``. frame_dt [s].
        actions: names of the action's components, each in [-1, 1].
        lattice: rows and columns of the keypoints in the default observation.
        extras: names of the numbers that follow the keypoints in the observation.
        extras_bound: a bound on their absolute value.
        max_strain: of an edge, at which an episode ends as overstretched.
        drive: what the action moves, in scenes where it moves something.
        options: numbers that a preset lets its user change (``with_options``). fixed: what it leaves no choice of.
    """

    size: ClassVar[tuple[float, float]]
    resolution: ClassVar[tuple[int, int]]
    frame_dt: ClassVar[float]
    actions: ClassVar[tuple[str, ...]]
    lattice: ClassVar[tuple[int, int]]
    extras: ClassVar[tuple[str, ...]]
    extras_bound: ClassVar[float] = 100.0
    material: ClassVar[Material] = Material()
    max_strain: ClassVar[float] = MAX_STRAIN
    drive: Drive
    options: ClassVar[Mapping[str, float]] = {}
    fixed: ClassVar[tuple[str, ...]] = ()

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.keypoints = scene.grid.keypoints(*self.lattice).astype(np.int32)
        self.handles = np.array(scene.handles, dtype=np.int32)

    @classmethod
    def make_scene(cls, *, resolution: tuple[int, int], material: Material) -> Scene:
        """The scene at this resolution and material."""
        return cls.build_scene(Grid(*resolution, *cls.size), material)

    @classmethod
    @abstractmethod
    def build_scene(cls, grid: Grid, material: Material) -> Scene:
        """The scene on ``grid``."""

    @abstractmethod
    def start(self, rng: np.random.Generator) -> Start:
        """A random start; draws only from ``rng``."""

    @abstractmethod
    def controls(self, episode: Episode) -> Controls:
        """Where driven things are at the end of the coming frame."""

    def hold(self, episode: Episode) -> Controls:
        """Controls that bring every handle and body to rest where it is now; a scene changes what it drives."""
        return Controls(*kernels.hold(episode.state.positions, self.handles, episode.state.colliders))

    def carry(self, episode: Episode, position: np.ndarray, velocity: np.ndarray, share: np.ndarray) -> Controls:
        """Controls whose handles take ``share`` ``(N, n)`` of what the action moves, at rest otherwise.

        ``position`` and ``velocity`` ``(B, n)`` are those of what ``self.drive`` moves.
        """
        controls = self.hold(episode)
        moved, reached = self.drive(position, velocity, episode.action)
        kernels.carry(controls.handle_positions, controls.handle_velocities, moved, reached, share)
        return controls

    def middle(self, episode: Episode) -> np.ndarray:
        """Mean position of the keypoints, ``(B, 3)`` [m]."""
        return kernels.mean_point(episode.state.positions, self.keypoints)

    def middle_velocity(self, episode: Episode) -> np.ndarray:
        """Mean velocity of the keypoints, ``(B, 3)`` [m/s]."""
        return kernels.mean_point(episode.state.velocities, self.keypoints)

    def speed(self, episode: Episode, first: int = 0, last: int = 3) -> np.ndarray:
        """Root mean square over the keypoints of velocity components ``first`` to ``last - 1``, ``(B,)`` [m/s]."""
        return kernels.root_mean_square(episode.state.velocities, self.keypoints, first, last)

    @abstractmethod
    def observe(self, episode: Episode) -> np.ndarray:
        """The extras, ``(B, len(extras))``."""

    @abstractmethod
    def reward(self, episode: Episode) -> np.ndarray:
        """``(B,)`` in [0, 1]."""


def tolerance(error: np.ndarray, margin: float, least: float = 0.0) -> np.ndarray:
    """1 where ``error`` ``(B,)`` is 0, falling as a Gaussian to 0.1 where it is ``margin``; squeezed over ``least``."""
    return kernels.tolerance(error, margin, least)


def columns(*parts: np.ndarray) -> np.ndarray:
    """Numbers ``(B,)`` or ``(B, n)`` side by side, float32: what ``Task.observe`` returns."""
    return kernels.columns(*parts)


def norm(vectors: np.ndarray) -> np.ndarray:
    """Lengths of ``(B, n)`` vectors; a third of ``numpy.linalg.norm``'s cost for a few numbers."""
    return kernels.norm(vectors)


def mean_span(positions: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Mean of ``x[second] - x[first]`` over pairs of vertices (int32 numbers), ``(B, 3)`` [m]."""
    return kernels.mean_span(positions, first, second)


def loop_area(positions: np.ndarray, loop: np.ndarray) -> np.ndarray:
    """Area vector ``sum x_i x x_(i+1) / 2`` of a closed line through vertices (int32 numbers), ``(B, 3)`` [m^2]."""
    return kernels.loop_area(positions, loop)


def largest_stretch(positions: np.ndarray, first: np.ndarray, second: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Largest distance over ``rest`` ``(P,)`` [m] of pairs of vertices (int32 numbers), ``(B,)``."""
    return kernels.largest_stretch(positions, first, second, rest)


class Drive:
    """Moves something by an action: a wanted velocity, limited acceleration, a box it can't leave.

    The velocity ramps linearly through a frame and changes by at most ``acceleration * dt``. The speed
    towards a side of the box is at most the distance to it over ``BRAKE``, so it slows down in time.

    Args:
        low, high: the box [m], ``n`` numbers. speed: at full action [m/s], one or ``n`` numbers.
        acceleration: [m/s^2]; at least ``speed / BRAKE``. dt: frame [s].
    """

    BRAKE = 0.1  # s

    def __init__(
        self,
        low: Sequence[float],
        high: Sequence[float],
        *,
        speed: float | Sequence[float],
        acceleration: float,
        dt: float,
    ) -> None:
        self.low, self.high = np.array(low, float), np.array(high, float)
        self.speed = np.zeros(len(low)) + speed
        self.change, self.dt = acceleration * dt, dt

    def __call__(self, position: np.ndarray, velocity: np.ndarray, action: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far it moves in the frame [m] and its velocity at the end [m/s]; all arrays ``(B, n)``."""
        return kernels.drive(
            position, velocity, action, self.low, self.high, self.speed, self.change, self.BRAKE, self.dt
        )


def grip(grid: Grid, row: int, col: int, size: float = 0.05) -> tuple[int, ...]:
    """Vertices of a square patch, ``size`` [m] along each side, in a corner.

    Held by one vertex, a cloth would overstretch the edges there, the more the finer the grid.
    """
    rows, cols = np.indices(grid.shape)
    down, along = (rows - row % grid.rows) * grid.row_spacing, (cols - col % grid.cols) * grid.col_spacing
    return tuple(np.flatnonzero(np.maximum(np.abs(down), np.abs(along)) <= size * (1 + 1e-9)).tolist())


def bow(cells: int, ratio: float) -> np.ndarray:
    """A bowed line of ``cells`` unit edges whose ends are ``ratio * cells`` apart, ``(2, cells + 1)``.

    Along and across the straight line between the ends. The slope angle is a half cosine wave, so the
    mean of its cosine is ``ratio`` (J0 of the largest angle, for many cells); every edge has length 1.
    """
    wave = np.cos(np.pi * (np.arange(cells) + 0.5) / cells)
    steepest = np.linspace(0.0, 2.2, 221)
    shortened = np.cos(steepest[:, None] * wave).mean(1)
    slope = np.interp(-ratio, -shortened, steepest) * wave
    path = np.zeros((2, cells + 1))
    np.cumsum([np.cos(slope), np.sin(slope)], axis=1, out=path[:, 1:])
    return path


GUST_TONES = 4


def draw_gust(rng: np.random.Generator, signals: int = 1) -> np.ndarray:
    """Frequencies [rad/s] and phases of independent signals, ``(2, signals, GUST_TONES)``."""
    shape = (signals, GUST_TONES)
    return np.stack([2 * np.pi * rng.uniform(0.15, 1.2, shape), rng.uniform(0, 2 * np.pi, shape)])


def gust(tones: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Smooth signals in [-1, 1], ``(B, signals)``, at ``time`` ``(B, 1)``; of one signal also at times ``(B, K)``."""
    return kernels.gust(tones, time)


def gusty_wind(
    tones: np.ndarray, time: np.ndarray, speed: np.ndarray, heading: np.ndarray, *, swell: float, turn: float
) -> np.ndarray:
    """A level wind, ``(B, 3)`` [m/s]: one gust changes its ``speed`` by up to ``swell`` of it, one its ``heading``.

    ``tones`` are two signals of ``draw_gust``; ``time``, ``speed`` [m/s] and ``heading`` [rad] are ``(B,)``, ``turn``
    is in radians.
    """
    return kernels.gusty_wind(tones, time, speed, heading, swell, turn)
