"""Speed and error of several physics on one scene, under the same seed and actions.

Cloth is chaotic: errors are measured over short windows that restart from states of the truth, the free run is filmed.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import _minicloth_kernels as kernels
import numpy as np
from gymnasium.utils.seeding import np_random

from cloth_envs.commands.entries import Entry
from cloth_envs.grid import Grid
from cloth_envs.physics.truth import TRUTHS
from cloth_envs.progress import progress
from cloth_envs.resample import resample
from cloth_envs.state import Controls, State
from cloth_envs.world import World

HORIZONS = (1, 5, 10, 25)  # frames
STARTS = 4  # windows of the truth
REPEATS = 5  # timed runs, after one that warms up


class Timed:
    """A backend whose ``advance`` is timed, including the fine positions that a lazy backend infers when asked."""

    def __init__(self, backend: Any, seconds: list[float]) -> None:
        self._backend, self.seconds = backend, seconds

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
    """What one entry did; errors are over the cloth's length, ``(starts, horizons)``, NaN after a failure."""

    entry: Entry
    errors: np.ndarray  # mean vertex distance from the truth
    heights: np.ndarray  # absolute difference of the mean height
    states: list[State]  # the free run, one state a frame, the start first
    divergence: float  # mean error over the free run
    crossings: np.ndarray  # pairs of the cloth's own triangles that cross, by frame of the free run
    failure: str | None  # why and when the free run failed
    seconds: list[float] = field(default_factory=list)  # wall-clock time of every timed frame

    @property
    def ms(self) -> list[float]:
        """First quartile, median and third quartile of the time of a frame [ms]."""
        return np.percentile(np.array(self.seconds) * 1e3, [25, 50, 75]).tolist()


@dataclass
class Comparison:
    """All results, the horizons [frames] and the frames at which the windows start."""

    scene: Any
    truth: Entry
    results: list[Result]
    horizons: list[int]
    starts: list[int]

    @property
    def twins(self) -> dict[str, str]:
        """Labels of entries whose errors are to the bit those of an earlier one, which they name."""
        whole = [r for r in self.results if np.isfinite(r.errors).all()]
        return {
            r.entry.label: first.entry.label
            for i, r in enumerate(whole)
            for first in whole[:i][::-1]
            if np.array_equal(r.errors, first.errors)
        }


def restart(world: World, saved: dict[str, np.ndarray], grid: Grid) -> None:
    """Continue ``saved``, a ``World.get_state()`` on ``grid``, in a world of another resolution or backend.

    The cloth is interpolated, and gripped as it lies then; bodies, goals, gusts and time are kept.
    """
    state = dict(saved)
    for name in ("state.positions", "state.velocities"):
        state[name] = resample(saved[name], grid, world.scene.grid)
    gripped = {f"memory.{name}": value for name, value in world.task.gripped(state["state.positions"]).items()}
    own = world.get_state() | gripped
    state["scene"] = own["scene"]
    for name in {name for name in (*saved, *gripped) if name.startswith("memory.")}:
        if name not in own:
            del state[name]
        elif name not in saved or saved[name].shape != own[name].shape:
            state[name] = own[name]
    world.set_state(state)


def run(world: World, actions: np.ndarray) -> Iterator[tuple[int, str | None]]:
    """Step through ``actions`` ``(T, A)``; yields the number of frames done and, as the last one, why it failed."""
    for done, action in enumerate(actions, 1):
        reason = world.step(action[None])[1][0]
        yield done, f"{reason} at frame {done}" if reason else None
        if reason:
            return


@dataclass
class Truth:
    """The run that others are measured against: positions of every frame, and what was saved of some of them."""

    world: World
    positions: list[np.ndarray]
    saved: dict[int, dict[str, np.ndarray]]

    def distance(self, world: World, frame: int) -> tuple[float, float]:
        """Mean vertex distance and difference of the mean height, both over the cloth's length."""
        grid = self.world.scene.grid
        gap = resample(world.state.positions[0].astype(np.float64), world.scene.grid, grid) - self.positions[frame]
        return float(np.sqrt((gap**2).sum(0)).mean() / grid.length), float(abs(gap[2].mean()) / grid.length)


def measure(
    entry: Entry, world: World, truth: Truth, actions: np.ndarray, horizons: list[int], starts: list[int]
) -> Result:
    """The errors of ``entry`` in windows that begin at saved frames, and its free run; nothing is timed yet."""
    found = np.full((2, len(starts), len(horizons)), np.nan)
    for row, start in enumerate(starts):
        restart(world, truth.saved[start], truth.world.scene.grid)
        for done, failure in run(world, actions[start : start + horizons[-1]]):
            if done in horizons and not failure:
                found[:, row, horizons.index(done)] = truth.distance(world, start + done)
    restart(world, truth.saved[0], truth.world.scene.grid)
    states, path = [world.state.copy()], []
    for done, failure in run(world, actions):
        if not failure:
            states.append(world.state.copy())
            path.append(truth.distance(world, done)[0])
    cloths, tube = np.concatenate([state.positions for state in states]), world.scene.grid.periodic
    crossings = kernels.crossing_triangles(cloths, periodic=tube)
    return Result(entry, found[0], found[1], states, float(np.mean(path)) if path else np.nan, crossings, failure)


def compare(
    scene: str,
    entries: Sequence[Entry],
    actions: np.ndarray,
    *,
    seed: int = 0,
    material: Any = None,
    self_contact: bool | None = None,
    resolution: tuple[int, int],
    repeats: int = REPEATS,
) -> Comparison:
    """Measure ``entries`` over ``actions`` ``(T, A)`` against the truth at ``resolution``.

    Raises:
        ValueError: a bad entry, or too few frames.
    """
    frames = len(actions)
    horizons = [h for h in HORIZONS if h <= frames]
    if not horizons:
        raise ValueError("a comparison needs at least 1 frame")
    last = frames - horizons[-1]
    starts = sorted({round(last * i / STARTS) for i in range(1, STARTS + 1)}) if last else [0]
    truth_entry = Entry("reference", resolution, TRUTHS["g1"])
    worlds = [entry.world(scene, material, self_contact) for entry in entries]
    world = truth_entry.world(scene, material, self_contact)
    world.reset({0: np_random(seed)[0]})
    truth = Truth(world, [world.state.positions[0].copy()], {0: world.get_state()})
    for done, failure in run(world, actions):
        if failure:
            raise ValueError(f"the reference itself failed ({failure}): choose another seed, policy or material")
        truth.positions.append(world.state.positions[0].copy())
        if done in starts:
            truth.saved[done] = world.get_state()
    results = []
    for entry, world in zip(progress(entries, "physics", name=lambda entry: entry.label), worlds, strict=True):
        world.reset({0: np_random(seed)[0]})
        results.append(measure(entry, world, truth, actions, horizons, starts))
    for _ in progress(range(repeats), "timing", unit="run"):  # in turn: a busy moment of the machine hits all alike
        for result, world in zip(results, worlds, strict=True):
            restart(world, truth.saved[0], truth.world.scene.grid)
            backend, world.backend = world.backend, Timed(world.backend, result.seconds)
            for _done in run(world, actions):
                pass
            world.backend = backend
    return Comparison(truth.world.scene, truth_entry, results, horizons, starts)
