"""What an environment's step takes, and what of it is outside its backend: part of ``minicloth bench throughput``."""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import gymnasium as gym
import numpy as np

import cloth_envs
from cloth_envs.state import Controls, State

BATCHES = (1, 32)
BACKENDS: dict[str, dict[str, Any]] = {"reference": {"threads": 1}, "miniature": {"threads": 1, "factor": 4}}
RESETS = 4  # episodes that a measurement goes through, at batch 1


@dataclass(frozen=True)
class StepRow:
    """Medians for one environment of ``batch``: ``gym.make`` at 1, else ``gym.make_vec``; default material.

    ``outside_us`` is a step less its call of the backend, in which the cloth is read too.
    """

    scene: str
    vertices: int
    backend: str
    batch: int
    step_us: float
    outside_us: float


class Timed:
    """Stands for a backend's ``advance``, reads the cloth at once and times both."""

    def __init__(self, backend: Any) -> None:
        self._advance, self.seconds = backend.advance, 0.0
        backend.advance = self

    def __call__(self, controls: Controls) -> State:
        start = perf_counter()
        state: State = self._advance(controls)
        state.arrays()
        self.seconds = perf_counter() - start
        return state


def steps_of(scene: str, backend: str, batch: int, count: int) -> StepRow:
    """``count`` steps of random actions on one thread, the first tenth of them to warm up."""
    options: dict[str, Any] = {"backend": backend, "backend_kwargs": BACKENDS[backend]}
    name = cloth_envs.env_id(scene)
    env: Any = gym.make(name, **options) if batch == 1 else gym.make_vec(name, num_envs=batch, **options)
    env.reset(seed=0)
    env.action_space.seed(0)
    timed, seconds = Timed(env.unwrapped.world.backend), []
    for k in range(count):
        action = env.action_space.sample()
        start = perf_counter()
        _, _, terminated, truncated, _ = env.step(action)
        whole = perf_counter() - start
        seconds.append((whole, whole - timed.seconds))
        if batch == 1 and (terminated or truncated or (k + 1) % (count // RESETS) == 0):
            env.reset()
    step, outside = np.median(seconds[count // 10 :], 0) / batch * 1e6
    return StepRow(scene, env.unwrapped.scene.grid.vertices, backend, batch, float(step), float(outside))


def step_table(rows: Sequence[StepRow]) -> str:
    """A line a scene and backend: microseconds of a whole step and, in brackets, outside the backend."""
    lines = [f"{'scene':10s} {'vertices':>8s} {'backend':10s}" + "".join(f"{f'batch {b}':>20s}" for b in BATCHES)]
    for scene, vertices, backend in dict.fromkeys((r.scene, r.vertices, r.backend) for r in rows):
        found = {
            r.batch: f"{r.step_us:.0f} ({r.outside_us:.1f}) us"
            for r in rows
            if (r.scene, r.backend) == (scene, backend)
        }
        lines.append(f"{scene:10s} {vertices:8d} {backend:10s}" + "".join(f"{found.get(b, '-'):>20s}" for b in BATCHES))
    return "\n".join(lines)


def step_rows(scenes: Sequence[str], quick: bool) -> list[StepRow]:
    """Of every scene, backend and batch."""
    return [
        steps_of(
            scene, backend, batch, (40 if backend == "reference" else 400) // (1 if batch == 1 else 4) // (1 + quick)
        )
        for scene in scenes
        for backend in BACKENDS
        for batch in BATCHES
    ]
