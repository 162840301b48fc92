"""What every scene file fills in: a Task maps actions to controls and states to rewards, batched."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

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
    """

    size: ClassVar[tuple[float, float]]
    resolution: ClassVar[tuple[int, int]]
    frame_dt: ClassVar[float]
    actions: ClassVar[tuple[str, ...]]
    lattice: ClassVar[tuple[int, int]]
    extras: ClassVar[tuple[str, ...]]
    extras_bound: ClassVar[float] = 100.0
    material: ClassVar[Material] = Material()

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.keypoints = scene.grid.keypoints(*self.lattice)
        self.handles = np.array(scene.handles, dtype=np.intp)

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
        state, batch = episode.state, len(episode.action)
        at = np.array(episode.cloth[:, :, self.handles].transpose(0, 2, 1), dtype=np.float64, order="C")
        bodies = np.array(state.colliders, dtype=np.float64)
        return Controls(
            handle_positions=at,
            handle_velocities=np.zeros(at.shape),
            colliders=bodies,
            collider_velocities=np.zeros(bodies.shape),
            wind=np.zeros((batch, 3)),
            pressure=np.zeros(batch),
        )

    @abstractmethod
    def observe(self, episode: Episode) -> np.ndarray:
        """The extras, ``(B, len(extras))``."""

    @abstractmethod
    def reward(self, episode: Episode) -> np.ndarray:
        """``(B,)`` in [0, 1]."""


def tolerance(error: np.ndarray, margin: float) -> np.ndarray:
    """1 where ``error`` is 0, falling as a Gaussian to 0.1 where it is ``margin``."""
    return np.exp(np.log(0.1) * np.square(error / margin))


BRAKE = 0.1  # s, driven things slow down over this time as they near the edge of their box


def drive(
    position: np.ndarray,
    velocity: np.ndarray,
    target: np.ndarray,
    *,
    low: np.ndarray | float,
    high: np.ndarray | float,
    acceleration: float,
    dt: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity at the end of a frame in which the velocity ramps linearly towards ``target``.

    The velocity changes by no more than ``acceleration * dt``. Nothing leaves the box ``low..high``: the
    speed towards a side is at most the distance to it over ``BRAKE``, which ``acceleration`` of at least
    the top speed over ``BRAKE`` can follow. All arrays ``(B, n)`` or broadcastable, in m, m/s, m/s^2.
    """
    upper, lower = np.maximum((high - position) / BRAKE, 0.0), np.minimum((low - position) / BRAKE, 0.0)
    aim = np.minimum(np.maximum(target, lower), upper)
    change = acceleration * dt
    reached = np.minimum(np.maximum(aim, velocity - change), velocity + change)
    return position + 0.5 * dt * (velocity + reached), reached


def grip(grid: Grid, row: int, col: int, radius: float = 0.04) -> tuple[int, ...]:
    """Vertices within ``radius`` [m] of a corner: a grip spreads the load that would overstretch a single edge."""
    rows, cols = np.indices(grid.shape)
    down, along = (rows - row % grid.rows) * grid.row_spacing, (cols - col % grid.cols) * grid.col_spacing
    return tuple(np.flatnonzero(np.hypot(down, along) <= radius).tolist())


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


def draw_gust(rng: np.random.Generator) -> np.ndarray:
    """Frequencies [rad/s] and phases of a gust, ``(2, GUST_TONES)``."""
    return np.stack([2 * np.pi * rng.uniform(0.15, 1.2, GUST_TONES), rng.uniform(0, 2 * np.pi, GUST_TONES)])


def gust(tones: np.ndarray, time: np.ndarray) -> np.ndarray:
    """A smooth signal in [-1, 1] at ``time`` ``(B,)`` from ``tones`` ``(B, 2, GUST_TONES)``."""
    return np.sin(tones[:, 0] * time[:, None] + tones[:, 1]).mean(1)
