"""Three scenes that every engine can run, and what is asked of a run: ``minicloth bench peers``.

A: a 1.0 x 1.5 m sheet starts horizontal with one 1 m row pinned and swings down. B: a 1.5 x 1.0 m flag, pinned along
its left column, in a steady wind. C: a 1.0 x 1.5 m sheet falls 5 cm onto a fixed sphere. The material is the default
one: 0.2 kg/m^2, stretch 500 N/m, shear 0.3 times that. Bending is 2e-5 N m per curvature: springs at distance two of
0.01 times the stretch stiffness, which have no continuum limit, hold about the same energy where neighbouring edges
meet at 20 degrees.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter, process_time
from typing import Protocol

import numpy as np

from cloth_envs.backend import Backend
from cloth_envs.failure import Failures
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.laws.budget import LEAST_FALL
from cloth_envs.physics.laws.diagnostics import strain
from cloth_envs.scene import Collider, Scene, Wind
from cloth_envs.state import Controls, State
from training.bench.truth import length, mean_height, vertex_error

NAMES = ("A", "B", "C")
TITLES = {"A": "A: sheet swings down", "B": "B: flag in wind", "C": "C: sheet falls on a sphere"}
EARLY, LATE = 0.2, 0.5  # s; errors after both, the mean height at the later
RADIUS, DROP = 0.3, 0.05  # m
# B: steady, 45 degrees off the flag's plane, [m/s]. C: smooth waves of 5 mm; in a perfectly flat sheet rounding would
# choose how it buckles.
WIND = (2.0, 2.0, 0.0)
WAVE = 0.005


@dataclass(frozen=True)
class Setup:
    """A scene, its start, the unstrained sheet ``(3, rows, cols)`` there, and controls that hold for every frame."""

    name: str
    scene: Scene
    start: State
    rest: np.ndarray
    controls: Controls

    @property
    def pins(self) -> np.ndarray:
        """Which vertices never move, ``(rows, cols)``."""
        held = np.zeros(self.scene.grid.vertices, bool)
        held[list(self.scene.handles)] = True
        return held.reshape(self.scene.grid.shape)

    def frames(self, seconds: float) -> int:
        """Whole frames that reach ``seconds``."""
        return int(np.ceil(seconds / self.scene.frame_dt - 1e-9))

    def state(self, positions: np.ndarray, velocities: np.ndarray | None = None) -> State:
        """A state of this scene from ``(3, rows, cols)`` arrays."""
        state = self.start.astype(np.float64)
        state.positions[0] = positions
        if velocities is not None:
            state.velocities[0] = velocities
        return state


def build(name: str, coarse: int = 1) -> Setup:
    """Scene ``name``, on a grid ``coarse`` times coarser.

    Raises:
        KeyError: not A, B or C.
    """
    rows, cols, height, width = {"A": (73, 49, 1.5, 1.0), "B": (33, 49, 1.0, 1.5), "C": (61, 41, 1.5, 1.0)}[name]
    grid = Grid((rows - 1) // coarse + 1, (cols - 1) // coarse + 1, height, width)
    along, down = np.linspace(0, width, grid.cols), np.linspace(0, height, grid.rows)[:, None]
    positions = np.zeros((1, 3, *grid.shape))
    bodies = None
    if name == "A":
        scene = Scene("A", grid, Material(), 0.04, handles=tuple(range(grid.cols)))
        positions[0, 0], positions[0, 1] = along, -down
    elif name == "B":
        hoist = tuple(grid.index(row, 0) for row in range(grid.rows))
        scene = Scene("B", grid, Material(), 0.04, handles=hoist, drag=False, wind=Wind())
        positions[0, 0], positions[0, 2] = along, -down
    else:
        scene = Scene("C", grid, Material(), 0.02, colliders=(Collider("sphere", RADIUS),))
        x, y = along - width / 2, height / 2 - down
        positions[0, 0], positions[0, 1] = x, y
        positions[0, 2] = RADIUS + scene.thickness + DROP
        bodies = np.zeros((1, 1, 2, 3))
    rest = positions[0].copy()
    if name == "C":
        positions[0, 2] += WAVE * np.sin(4 * np.pi * x / width + 0.5) * np.cos(6 * np.pi * y / height + 0.3)
    start = State.still(positions, bodies)
    controls = Controls.hold(start, scene.handles)
    if scene.wind is not None:
        controls.wind[:] = WIND
    return Setup(name, scene, start, rest, controls)


class Engine(Protocol):
    """One simulator set up for one scene.

    Attributes:
        substeps: steps of a frame. masses: of the vertices, ``(rows, cols)`` [kg].
    """

    substeps: int
    masses: np.ndarray

    def reset(self) -> None:
        """Back to the scene's start."""

    def advance(self) -> tuple[float, float]:
        """One frame; the wall clock and the processor time [s] that it took."""

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities now, ``(3, rows, cols)``."""


class Stopwatch:
    """Wall clock and processor time [s] of all ``with`` blocks together."""

    wall = cpu = 0.0

    def __enter__(self) -> None:
        self._wall, self._cpu = perf_counter(), process_time()

    def __exit__(self, *_: object) -> None:
        self.wall += perf_counter() - self._wall
        self.cpu += process_time() - self._cpu


class Own:
    """A backend of ours as an ``Engine``."""

    def __init__(self, setup: Setup, backend: Backend) -> None:
        self._setup, self._backend = setup, backend
        self.substeps = int(np.max(getattr(backend, "substeps", 1)))
        self.masses = setup.scene.mass
        self.reset()

    def reset(self) -> None:
        self._backend.reset(self._setup.start)

    def advance(self) -> tuple[float, float]:
        watch = Stopwatch()
        with watch:
            self._backend.advance(self._setup.controls)
        return watch.wall, watch.cpu

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        state = self._backend.state
        return state.positions[0].astype(np.float64), state.velocities[0].astype(np.float64)


@dataclass(frozen=True)
class Path:
    """What a run left: states at the early and the late time (None after a failure), and every frame's wall clock and
    processor time ``(frames, 2)`` [s].
    """

    early: State | None
    late: State | None
    seconds: np.ndarray
    failure: str


def follow(setup: Setup, engine: Engine, *, seconds: float = LATE, limit: float = np.inf) -> Path:
    """Run ``engine`` from the start for ``seconds`` of the scene, or until it has taken ``limit`` seconds of ours."""
    engine.reset()
    failures, before = Failures(setup.scene), setup.start.astype(np.float64)
    early, late = setup.frames(EARLY), setup.frames(LATE)
    kept: dict[int, State] = {}
    times: list[tuple[float, float]] = []
    failure = ""
    for frame in range(1, setup.frames(seconds) + 1):
        times.append(engine.advance())
        state = setup.state(*engine.state())
        failure = failures.check(before, state)[0] or ""
        if not failure and sum(wall for wall, _ in times) > limit:
            failure = f"stopped after {limit:g} s,"
        if failure:
            failure += f" at frame {frame}"
            break
        kept[frame] = before = state
    return Path(kept.get(early), kept.get(late), np.array(times), failure)


def error_mm(setup: Setup, state: State | None, truth: State | None) -> float:
    """Mean distance of the vertices [mm]; NaN where one is missing."""
    if state is None or truth is None:
        return float("nan")
    return 1e3 * length(setup.scene) * vertex_error(setup.scene, state, truth)


def lag(setup: Setup, state: State | None, truth: State | None) -> float:
    """Part of the truth's way by which the mean height stays behind (negative: ahead)."""
    if state is None or truth is None:
        return float("nan")
    begin, end = mean_height(setup.scene, setup.start), mean_height(setup.scene, truth)
    way = max(abs(end - begin), LEAST_FALL * length(setup.scene))
    return (mean_height(setup.scene, state) - end) * float(np.sign(begin - end)) / way


def p99(setup: Setup, state: State | None) -> float:
    """99th percentile of the structural edges' strain."""
    return float("nan") if state is None else float(strain(setup.scene.grid, state.positions).p99[0])
