"""Speed and error of several physics on one scene, under the same seed and actions.

Cloth is chaotic: two runs that differ by a rounding error part within seconds. Errors are therefore
measured over short windows that restart from states of the truth; the long free run is for the video,
and its distance from the truth is reported as divergence.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
from gymnasium.utils.seeding import np_random

from cloth_envs.commands.entries import TRUTH_KWARGS, Entry
from cloth_envs.grid import Grid
from cloth_envs.resample import resample
from cloth_envs.state import Controls, State
from cloth_envs.world import World

HORIZONS = (1, 5, 10, 25)  # frames
STARTS = 4  # windows of the truth
REPEATS = 5  # timed runs, after one that warms up


class Timed:
    """A backend whose ``advance`` is timed, including the fine positions that a lazy backend infers when asked."""

    def __init__(self, backend: Any) -> None:
        self._backend = backend
        self.seconds: list[float] = []

    def advance(self, controls: Controls) -> State:
        start = perf_counter()
        state = self._backend.advance(controls)
        state.positions, state.velocities  # noqa: B018
        self.seconds.append(perf_counter() - start)
        return state

    def __getattr__(self, name: str) -> Any:
        return getattr(self._backend, name)


@dataclass
class Result:
    """What one entry did.

    Attributes:
        seconds: wall-clock time of every timed frame.
        errors: mean vertex distance from the truth over the cloth's length, ``(starts, horizons)``; NaN after a
            failure.
        heights: absolute difference of the mean height over the cloth's length, of the same shape.
        states: the free run, one state a frame, the start first.
        divergence: mean error over the free run.
        failure: why and when the free run failed, or None.
    """

    entry: Entry
    seconds: list[float] = field(default_factory=list)
    errors: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    heights: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    states: list[State] = field(default_factory=list)
    divergence: float = np.nan
    failure: str | None = None

    @property
    def ms(self) -> tuple[float, float, float]:
        """First quartile, median and third quartile of the time of a frame [ms]."""
        low, middle, high = np.percentile(np.array(self.seconds) * 1e3, [25, 50, 75])
        return float(low), float(middle), float(high)


@dataclass
class Comparison:
    """All results, the horizons [frames] and the frames at which the windows start."""

    scene: Any
    truth: Entry
    results: list[Result]
    horizons: list[int]
    starts: list[int]


def restart(world: World, saved: dict[str, np.ndarray], grid: Grid) -> None:
    """Continue ``saved``, a ``World.get_state()`` on ``grid``, in a world of another resolution or backend.

    The cloth is interpolated; bodies, goals, gusts and time are kept.
    """
    state = dict(saved)
    for name in ("state.positions", "state.velocities"):
        state[name] = resample(saved[name], grid, world.scene.grid)
    own = world.get_state()
    for name, value in saved.items():
        if name.startswith("memory.") and own[name].shape != value.shape:
            state[name] = own[name]
    world.set_state(state)


def run(world: World, actions: np.ndarray, see: Callable[[int, World], None]) -> str | None:
    """Step through ``actions`` ``(T, A)``; ``see`` is called with the number of frames done. Returns a failure."""
    for done, action in enumerate(actions, 1):
        reasons = world.step(action[None])[1]
        if reasons[0]:
            return f"{reasons[0]} at frame {done}"
        see(done, world)
    return None


@dataclass
class Truth:
    """The run that others are measured against: positions of every frame, and what was saved of some of them."""

    world: World
    positions: list[np.ndarray]
    saved: dict[int, dict[str, np.ndarray]]

    @classmethod
    def follow(cls, world: World, actions: np.ndarray, seed: int, starts: Sequence[int]) -> Truth:
        """Run ``world`` from its start, saving frame 0 and ``starts``.

        Raises:
            ValueError: it failed.
        """
        world.reset({0: np_random(seed)[0]})
        made = cls(world, [world.state.positions[0].copy()], {0: world.get_state()})

        def keep(done: int, world: World) -> None:
            made.positions.append(world.state.positions[0].copy())
            if done in starts:
                made.saved[done] = world.get_state()

        failure = run(world, actions, keep)
        if failure:
            raise ValueError(f"the reference itself failed ({failure}): choose another seed, policy or material")
        return made

    def set(self, world: World, frame: int) -> None:
        """Put another world where the truth was at a saved frame."""
        restart(world, self.saved[frame], self.world.scene.grid)

    def distance(self, world: World, frame: int) -> tuple[float, float]:
        """Mean vertex distance and difference of the mean height, both over the cloth's length."""
        grid = self.world.scene.grid
        length = max(grid.height, grid.width)
        gap = resample(world.state.positions[0].astype(np.float64), world.scene.grid, grid) - self.positions[frame]
        return float(np.sqrt((gap**2).sum(0)).mean() / length), float(abs(gap[2].mean()) / length)


def score(result: Result, world: World, truth: Truth, actions: np.ndarray, horizons: list[int], start: int) -> None:
    """Add to ``result`` the errors of the window that begins at a saved frame, NaN from a failure on."""
    found = np.full((2, len(horizons)), np.nan)

    def measure(done: int, world: World) -> None:
        if done in horizons:
            found[:, horizons.index(done)] = truth.distance(world, start + done)

    truth.set(world, start)
    run(world, actions[start : start + horizons[-1]], measure)
    result.errors, result.heights = np.vstack([result.errors, found[0]]), np.vstack([result.heights, found[1]])


def go_free(result: Result, world: World, truth: Truth, actions: np.ndarray) -> None:
    """Fill in the free run of ``result``: its states, how far it parts, why it failed."""
    truth.set(world, 0)
    result.states = [world.state.copy()]
    path: list[float] = []

    def watch(done: int, world: World) -> None:
        result.states.append(world.state.copy())
        path.append(truth.distance(world, done)[0])

    result.failure = run(world, actions, watch)
    result.divergence = float(np.mean(path)) if path else np.nan


def clock(result: Result, world: World, truth: Truth, actions: np.ndarray) -> None:
    """Add the time of every frame of one more free run."""
    backend, timed = world.backend, Timed(world.backend)
    truth.set(world, 0)
    world.backend = timed
    run(world, actions, lambda done, world: None)
    world.backend = backend
    result.seconds += timed.seconds


def compare(
    scene: str,
    entries: Sequence[Entry],
    actions: np.ndarray,
    *,
    seed: int = 0,
    material: Any = None,
    resolution: tuple[int, int],
    repeats: int = REPEATS,
    report: Callable[[str], None] = lambda text: None,
) -> Comparison:
    """Measure ``entries`` over ``actions`` ``(T, A)`` against the truth at ``resolution``.

    Args:
        report: is told before each of the ``2 + len(entries)`` stages.

    Raises:
        ValueError: a bad entry, or too few frames.
    """
    frames = len(actions)
    horizons = [h for h in HORIZONS if h <= frames]
    if not horizons:
        raise ValueError("a comparison needs at least 1 frame")
    last = frames - horizons[-1]
    starts = sorted({round(last * i / STARTS) for i in range(1, STARTS + 1)}) if last else [0]
    truth_entry = Entry("reference", resolution, TRUTH_KWARGS)
    worlds = [entry.world(scene, material) for entry in entries]
    world_of_truth = truth_entry.world(scene, material)
    report("truth")
    truth = Truth.follow(world_of_truth, actions, seed, starts)
    none = np.zeros((0, len(horizons)))
    results = [Result(entry, errors=none, heights=none) for entry in entries]
    for result, world in zip(results, worlds, strict=True):
        report(result.entry.label)
        world.reset({0: np_random(seed)[0]})
        for start in starts:
            score(result, world, truth, actions, horizons, start)
        go_free(result, world, truth, actions)
    report("timing")
    for _ in range(repeats):  # in turn, so that a busy moment of the machine hits all alike
        for result, world in zip(results, worlds, strict=True):
            clock(result, world, truth, actions)
    return Comparison(truth.world.scene, truth_entry, results, horizons, starts)
