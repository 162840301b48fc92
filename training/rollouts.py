"""The one loop that runs cloth for data and for measurements: record, replay, stack, nudge, retime.

A task's controls follow from the state, so those of a run are recorded once and replayed for every other physics: all
get the same handles, bodies, wind and pressure.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from time import perf_counter, process_time
from typing import NamedTuple

import numpy as np
from gymnasium.utils.seeding import np_random

from cloth_envs.backend import Backend
from cloth_envs.material import Material
from cloth_envs.physics.laws.drives import hermite
from cloth_envs.policies import open_loop
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from cloth_envs.world import World

NUDGE = 1e-6  # of the cloth's length: what the chaos floor starts from


@dataclass(frozen=True)
class Recording:
    """A run of B cloths.

    Attributes:
        scene: what was run.
        states: by frame number (0 is the start), each a batch of B; only those that were asked for.
        controls: of every frame.
        materials: of every cloth.
        failures: of every cloth, ``"<reason> at frame <n>"`` of the first failure, or empty.
    """

    scene: Scene
    states: dict[int, State]
    controls: list[Controls]
    materials: list[Material]
    failures: list[str]

    @property
    def good(self) -> list[int]:
        """The cloths that did not fail."""
        return [i for i, failure in enumerate(self.failures) if not failure]

    def only(self, which: Sequence[int]) -> Recording:
        """The same of some cloths."""
        chosen = list(which)
        return Recording(
            self.scene,
            {frame: state.select(chosen) for frame, state in self.states.items()},
            [Controls(**{name: value[chosen] for name, value in vars(c).items()}) for c in self.controls],
            [self.materials[i] for i in chosen],
            [self.failures[i] for i in chosen],
        )


def seeded_actions(world: World, seeds: Sequence[int], policies: Sequence[str], frames: int) -> np.ndarray:
    """Open-loop actions ``(frames, B, A)``, one seed a cloth; ``policies`` take turns over the seeds."""
    size, dt = len(world.task.actions), world.scene.frame_dt
    turns = [policies[i % len(policies)] for i in range(len(seeds))]
    drawn = [open_loop(policy, max(frames, 200), size, dt, seed) for policy, seed in zip(turns, seeds, strict=True)]
    return np.stack(drawn, 1)[:frames]


def record(world: World, actions: np.ndarray, keep: Iterable[int], *, seeds: Sequence[int]) -> Recording:
    """Start ``world`` from ``seeds``, run it under ``actions`` ``(T, B, A)``; states at the ends of frames ``keep``."""
    wanted, failures = set(keep), [""] * len(seeds)
    world.reset({i: np_random(seed)[0] for i, seed in enumerate(seeds)})
    states = {0: world.state.copy()} if 0 in wanted else {}
    controls: list[Controls] = []
    for frame, action in enumerate(actions, 1):
        reasons = world.step(action)[1]
        assert world.controls is not None
        controls.append(Controls(**{name: np.array(value) for name, value in vars(world.controls).items()}))
        failures = [
            old or (f"{new} at frame {frame}" if new else "") for old, new in zip(failures, reasons, strict=True)
        ]
        if frame in wanted:
            states[frame] = world.state.copy()
    return Recording(world.scene, states, controls, list(world.materials), failures)


class Seconds(NamedTuple):
    """Time that a frame took [s]: on the wall, and of the processor, whatever else ran on it meanwhile."""

    wall: float
    cpu: float


def replay(
    backend: Backend, start: State, controls: Sequence[Controls], materials: Sequence[Material] | None = None
) -> Iterator[tuple[State, Seconds]]:
    """The state after every frame from ``start``, and the time that the backend took for it."""
    backend.reset(start, materials)
    for control in controls:
        wall, cpu = perf_counter(), process_time()
        state = backend.advance(control)
        state.positions, state.velocities  # noqa: B018  a lazy backend infers them now
        yield state, Seconds(perf_counter() - wall, process_time() - cpu)


def stack_states(states: Sequence[State]) -> State:
    """Batches one after the other as one batch."""
    return State(**{f.name: np.concatenate([getattr(s, f.name) for s in states]) for f in fields(State)})


def stack_controls(controls: Sequence[Controls]) -> Controls:
    """Batches one after the other as one batch."""
    return Controls(**{f.name: np.concatenate([getattr(c, f.name) for c in controls]) for f in fields(Controls)})


def nudge(state: State, scene: Scene, seed: int) -> State:
    """``state`` with its free vertices moved by ``NUDGE`` of the cloth's longer side in random directions."""
    out, rng = state.copy(), np.random.default_rng(seed)
    push = rng.normal(size=out.positions.shape)
    push *= NUDGE * scene.grid.length / np.linalg.norm(push, axis=1, keepdims=True)
    push.reshape(*push.shape[:2], -1)[..., list(scene.handles)] = 0.0
    out.positions += push
    return out


def retime(scene: Scene, start: State, controls: Sequence[Controls], factor: float) -> list[Controls]:
    """``controls`` for frames ``factor`` times as long: 1/n or a whole number.

    Longer frames end where every ``factor``-th did, under the mean of their winds; shorter ones end on the cubics.
    """
    if factor >= 1:
        n = round(factor)
        groups = [controls[i : i + n] for i in range(0, len(controls) - n + 1, n)]
        return [_mixed(group) for group in groups]
    n, out = round(1 / factor), []
    flat = [a.reshape(1, 3, -1)[..., list(scene.handles)] for a in (start.positions, start.velocities)]
    x, v = (a.transpose(0, 2, 1) for a in flat)
    before = x, v, start.colliders, start.collider_velocities
    for control in controls:
        after = control.handle_positions, control.handle_velocities, control.colliders, control.collider_velocities
        for part in range(1, n + 1):
            handles = hermite(part / n, scene.frame_dt, *before[:2], *after[:2])
            bodies = hermite(part / n, scene.frame_dt, *before[2:], *after[2:])
            out.append(Controls(*handles, *bodies, control.wind, control.pressure))
        before = after
    return out


def _mixed(group: Sequence[Controls]) -> Controls:
    mean = {name: np.mean([getattr(c, name) for c in group], 0) for name in ("wind", "pressure")}
    return Controls(**{**vars(group[-1]), **mean})
