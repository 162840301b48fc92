"""Three scenes that every engine can run, and what is asked of a run.

A: a 1.0 x 1.5 m sheet starts horizontal with one 1 m row pinned and swings down. B: a 1.5 x 1.0 m flag, pinned along
its left column, in a steady wind. C: a 1.0 x 1.5 m sheet falls 5 cm onto a fixed sphere. The material is the default
one: 0.2 kg/m^2, stretch 500 N/m, shear 0.3 times that. Bending is 2e-5 N m per curvature: springs at distance two of
0.01 times the stretch stiffness, which have no continuum limit, hold about the same energy where neighbouring edges
meet at 20 degrees.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import repeat
from time import perf_counter, process_time
from typing import Any, NamedTuple

import numpy as np

from cloth_envs.backend import Backend
from cloth_envs.failure import Failures
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.laws.budget import LEAST_FALL
from cloth_envs.physics.laws.diagnostics import strain
from cloth_envs.scene import Air, Collider, Scene
from cloth_envs.state import Controls, State
from training.metrics.errors import distances
from training.rollouts import replay

TITLES = {"A": "A: sheet swings down", "B": "B: flag in wind", "C": "C: sheet falls on a sphere"}
NAMES = tuple(TITLES)
EARLY, LATE = 0.2, 0.5  # s; errors after both, the mean height at the later
RADIUS, DROP = 0.3, 0.05  # m
# B: steady, 45 degrees off the flag's plane, [m/s]. C: smooth waves of 5 mm; in a perfectly flat sheet rounding would
# choose how it buckles.
WIND = (2.0, 2.0, 0.0)
WAVE = 0.005


@dataclass(frozen=True)
class Setup:
    """A scene, its start, the unstrained sheet ``(3, rows, cols)`` there, and controls that hold for every frame."""

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


def build(name: str, coarse: int = 1) -> Setup:
    """Scene ``name``, on a grid ``coarse`` times coarser.

    Raises:
        KeyError: not A, B or C.
    """
    rows, cols, height, width = {"A": (73, 49, 1.5, 1.0), "B": (33, 49, 1.0, 1.5), "C": (61, 41, 1.5, 1.0)}[name]
    grid = Grid((rows - 1) // coarse + 1, (cols - 1) // coarse + 1, height, width)
    options: dict[str, Any] = {"handles": tuple(range(grid.cols))}
    material = Material(drag=0.5)  # as all engines know it
    if name == "B":
        hoist = tuple(grid.index(row, 0) for row in range(grid.rows))
        options, material = {"handles": hoist, "air": Air(max_wind=12.0)}, Material()
    elif name == "C":
        options = {"colliders": (Collider("sphere", RADIUS),)}
    scene = Scene(name, grid, material, 0.02 if name == "C" else 0.04, **options)
    rest = np.zeros((3, *grid.shape))
    rest[0] = np.linspace(0, width, grid.cols)
    rest[2 if name == "B" else 1] = -np.linspace(0, height, grid.rows)[:, None]
    if name == "C":
        rest += np.reshape([-width / 2, height / 2, RADIUS + scene.thickness + DROP], (3, 1, 1))
    positions = rest[None].copy()
    if name == "C":
        x, y = rest[:2]
        positions[0, 2] += WAVE * np.sin(4 * np.pi * x / width + 0.5) * np.cos(6 * np.pi * y / height + 0.3)
    start = State.still(positions, np.zeros((1, len(scene.colliders), 2, 3)))
    controls = Controls.hold(start, scene.handles)
    if scene.windy:
        controls.wind[:] = WIND
    return Setup(scene, start, rest, controls)


def clock() -> np.ndarray:
    """Wall clock and processor time ``(2,)`` [s]."""
    return np.array([perf_counter(), process_time()])


class Peer(ABC):
    """Somebody else's simulator as a backend for the one cloth of a ``Setup``, with ``substeps`` a frame.

    ``masses`` are the vertices' ``(rows, cols)`` [kg], ``taken`` is by ``clock`` what the last frame took the engine.
    """

    substeps: int
    masses: np.ndarray

    def __init__(self, setup: Setup) -> None:
        self.setup, self.scene, self.taken = setup, setup.scene, np.zeros(2)
        self.memory: dict[str, np.ndarray] = {}

    @abstractmethod
    def reset(self, state: State, materials: object = None, which: object = None) -> None:
        """Start from ``state``; the material is the scene's."""

    @abstractmethod
    def run_frame(self, wind: np.ndarray) -> None:
        """One frame under ``wind`` ``(1, 3)`` [m/s], adding to ``taken`` what the engine does of it."""

    @abstractmethod
    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities now, ``(3, rows, cols)``."""

    @property
    def state(self) -> State:
        """The present state, float64."""
        state = self.setup.start.astype(np.float64)
        state.positions[0], state.velocities[0] = self.read()
        return state

    def recall(self, memory: dict[str, np.ndarray]) -> None:
        """Nothing decides the future beyond the state."""
        self.memory = memory

    def advance(self, controls: Controls) -> State:
        """One frame; pins and bodies stay."""
        self.taken = np.zeros(2)
        self.run_frame(controls.wind)
        return self.state


class Trace(NamedTuple):
    """States at the early and the late time (None after a failure), and ``clock`` of every frame ``(frames, 2)``."""

    early: State | None = None
    late: State | None = None
    seconds: np.ndarray = np.zeros((0, 2))
    failure: str = ""


def follow(setup: Setup, engine: Backend, *, seconds: float = LATE, limit: float = np.inf) -> Trace:
    """Run ``engine`` from the start for ``seconds`` of the scene, or until it has taken ``limit`` seconds of ours."""
    failures, before = Failures(setup.scene), setup.start.astype(np.float64)
    kept: dict[int, State] = {}
    times: list[np.ndarray] = []
    failure = ""
    frames = replay(engine, setup.start, repeat(setup.controls, setup.frames(seconds)))
    for frame, (state, taken) in enumerate(frames, 1):
        times.append(engine.taken if isinstance(engine, Peer) else np.array([taken.wall, taken.cpu]))
        state = state.astype(np.float64)
        failure = failures.check(before, state).get(0, "")
        if not failure and np.sum(times, 0)[0] > limit:
            failure = f"stopped after {limit:g} s,"
        if failure:
            failure += f" at frame {frame}"
            break
        kept[frame] = before = state
    return Trace(kept.get(setup.frames(EARLY)), kept.get(setup.frames(LATE)), np.array(times), failure)


def error_mm(state: State | None, truth: State | None) -> float:
    """Mean distance of the vertices [mm]; NaN where one is missing."""
    if state is None or truth is None:
        return float("nan")
    return 1e3 * float(distances(state.positions[0], truth.positions[0]).mean())


def lag(setup: Setup, state: State | None, truth: State | None) -> float:
    """Part of the truth's way by which the mean height stays behind (negative: ahead)."""
    if state is None or truth is None:
        return float("nan")
    areas = setup.scene.grid.areas
    begin, now, end = (np.average(s.positions[0, 2], weights=areas) for s in (setup.start, state, truth))
    way = max(abs(end - begin), LEAST_FALL * setup.scene.grid.length)
    return float((now - end) * np.sign(begin - end) / way)


def p99(setup: Setup, state: State | None) -> float:
    """99th percentile of the structural edges' strain."""
    return float("nan") if state is None else float(strain(setup.scene.grid, state.positions).p99[0])
