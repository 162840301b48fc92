"""Whole frames of the scenes: what the solver takes, and the environment around it."""

from collections.abc import Callable
from time import perf_counter
from timeit import repeat
from typing import Any

import gymnasium as gym
import numpy as np

import cloth_envs
from cloth_envs.state import Controls, State
from training.bench.throughput.rows import FrameRow


class Timed:
    """Stands for a solver's ``step`` and times its last call."""

    def __init__(self, step: Callable[[State, State, Controls], None]) -> None:
        self.step, self.seconds, self.idle = step, 0.0, False
        self.given: tuple[State, State, Controls]

    def __call__(self, old: State, new: State, controls: Controls) -> None:
        start, self.given = perf_counter(), (old, new, controls)
        if self.idle:
            new.positions[:], new.velocities[:] = old.positions, old.velocities
        else:
            self.step(old, new, controls)
        self.seconds = perf_counter() - start


def plain() -> int:
    """Some hundreds of the interpreter's instructions, spread over its types."""
    table, words = {str(k): k for k in range(20)}, [str(k) for k in range(20)]
    return sum(len(f"{table[word]:5.2f}".strip()) + isinstance(word, str) for word in words)


def frames_of(scene: str, steps: int) -> FrameRow:
    """One thread, default material, random actions, observation and reward included."""
    env: Any = gym.make(cloth_envs.env_id(scene)).unwrapped
    env.reset(seed=0)
    env.action_space.seed(0)
    backend = env.world.backend
    timed = backend.step = Timed(backend.step)

    def step(action: np.ndarray) -> tuple[float, float]:
        """Seconds in the solver, and around it."""
        start = perf_counter()
        env.step(action)
        return timed.seconds, perf_counter() - start - timed.seconds

    solver, overhead = np.median([step(env.action_space.sample()) for _ in range(steps)], 0)
    timed.idle, action = True, env.action_space.sample()
    _, repeated = np.median([step(action) for _ in range(20 * steps)], 0)
    warm = repeat(plain, number=1, repeat=steps)
    cold = repeat(plain, lambda: timed.step(*timed.given), number=1, repeat=steps)
    substeps, held = map(int, backend.cuts[0])
    return FrameRow(
        scene, env.scene.grid.vertices, substeps, held, env.scene.frame_dt * 1e3, float(solver) * 1e3,
        float(overhead) * 1e6, float(repeated) * 1e6, float(np.median(cold) / np.median(warm)),
    )  # fmt: skip
