"""Whole frames of every scene: time in the solver, and what the environment adds to it."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import gymnasium as gym
import numpy as np

import cloth_envs
from cloth_envs.state import Controls, State
from training.bench.throughput.rows import FrameRow


class Timed:
    """Stands for a solver's ``step`` and times its calls."""

    def __init__(self, step: Callable[[State, State, Controls], None]) -> None:
        self.step, self.times, self.idle = step, [0.0], False
        self.given: tuple[State, State, Controls]

    def __call__(self, old: State, new: State, controls: Controls) -> None:
        start, self.given = perf_counter(), (old, new, controls)
        if self.idle:
            new.positions[:], new.velocities[:] = old.positions, old.velocities
        else:
            self.step(old, new, controls)
        self.times.append(perf_counter() - start)


def plain() -> int:
    """Some hundreds of the interpreter's instructions, spread over its types."""
    table, words = {str(k): k for k in range(20)}, [str(k) for k in range(20)]
    return sum(len(f"{table[word]:5.2f}".strip()) + isinstance(word, str) for word in words)


def frames_of(scene: str, steps: int) -> FrameRow:
    """One thread, default material, random actions, observation and reward included."""
    env = gym.make(cloth_envs.env_id(scene)).unwrapped
    env.reset(seed=0)
    env.action_space.seed(0)
    backend = env.world.backend  # type: ignore[attr-defined]
    timed = backend.step = Timed(backend.step)
    totals, solver = [], []
    for _ in range(steps):
        action = env.action_space.sample()
        start = perf_counter()
        env.step(action)
        totals.append(perf_counter() - start)
        solver.append(timed.times[-1])
    timed.idle = True
    repeated = []
    for _ in range(20 * steps):
        start = perf_counter()
        env.step(action)
        repeated.append(perf_counter() - start - timed.times[-1])
    warm: list[float] = []
    cold: list[float] = []
    for times in (warm, cold):
        for _ in range(steps):
            if times is cold:
                timed.step(*timed.given)
            start = perf_counter()
            plain()
            times.append(perf_counter() - start)
    return FrameRow(
        scene=scene,
        vertices=env.scene.grid.vertices,  # type: ignore[attr-defined]
        substeps=int(backend.substeps[0]),
        frame_ms=env.scene.frame_dt * 1e3,  # type: ignore[attr-defined]
        solver_ms=float(np.median(solver)) * 1e3,
        overhead_us=float(np.median(np.subtract(totals, solver))) * 1e6,
        repeated_us=float(np.median(repeated)) * 1e6,
        cold=float(np.median(cold) / np.median(warm)),
    )
