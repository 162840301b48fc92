"""The one loop that runs cloth for data and for measurements: record, play, replay, stack, nudge, retime.

A task's controls follow from the state, so those of a run are recorded once and replayed for every other physics: all
get the same handles, bodies, wind and pressure.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from time import perf_counter, process_time, thread_time
from typing import Any, NamedTuple

import numpy as np
from gymnasium.utils.seeding import np_random

from cloth_envs.backend import Backend
from cloth_envs.material import Material
from cloth_envs.physics.laws.drives import handle_starts, hermite
from cloth_envs.policies import open_loop
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from cloth_envs.world import World

NUDGE = 1e-6  # of the cloth's length: what the chaos floor starts from


@dataclass(frozen=True)
class Recording:
    """A run of B cloths: the states that were asked for by frame number (0 is the start), controls of every frame.

    ``failures`` are of every cloth, ``"<reason> at frame <n>"`` of the first one, or empty.
    """

    scene: Scene
    states: dict[int, State]
    controls: list[Controls]
    materials: list[Material]
    failures: list[str]

    @property
    def good(self) -> list[int]:
        """Numbers of the cloths that did not fail."""
        return [i for i, failure in enumerate(self.failures) if not failure]

    def only(self, which: Sequence[int]) -> "Recording":
        """The same of some cloths."""
        chosen = list(which)
        return Recording(
            self.scene,
            {frame: state.select(chosen) for frame, state in self.states.items()},
            [Controls(**{name: value[chosen] for name, value in vars(c).items()}) for c in self.controls],
            [self.materials[i] for i in chosen],
            [self.failures[i] for i in chosen],
        )


def seeded_actions(
    world: World, seeds: Sequence[int], policies: Sequence[str], frames: int, *, least: int = 200
) -> np.ndarray:
    """Open-loop actions ``(frames, B, A)`` of seeds, over which ``policies`` take turns, drawn for ``least``+."""
    size, dt = len(world.task.actions), world.scene.frame_dt
    turns = [policies[i % len(policies)] for i in range(len(seeds))]
    drawn = [open_loop(policy, max(frames, least), size, dt, seed) for policy, seed in zip(turns, seeds, strict=True)]
    return np.stack(drawn, 1)[:frames]


def record(
    world: World,
    actions: Iterable[np.ndarray],
    keep: Iterable[int],
    *,
    seeds: Sequence[int | np.random.Generator],
    take: Callable[[State], State] = State.copy,
) -> Recording:
    """Start ``world`` from ``seeds`` (or generators) and run it; ``take`` of the states at the ends of frames ``keep``.

    ``actions`` are ``(T, B, A)``, or what gives ``(B, A)`` frame by frame, asked for the first after the start.
    """
    wanted, failures = set(keep), [""] * len(seeds)
    world.reset({i: s if isinstance(s, np.random.Generator) else np_random(s)[0] for i, s in enumerate(seeds)})
    states = {0: take(world.state)} if 0 in wanted else {}
    controls: list[Controls] = []
    for frame, action in enumerate(actions, 1):
        reasons = world.step(action)[1]
        assert world.controls is not None
        controls.append(Controls(**{name: np.array(value) for name, value in vars(world.controls).items()}))
        told = [f"{reason} at frame {frame}" if reason else "" for reason in reasons]
        failures = [old or new for old, new in zip(failures, told, strict=True)]
        if frame in wanted:
            states[frame] = take(world.state)
    return Recording(world.scene, states, controls, list(world.materials), failures)


def play(
    world: World, policy: Callable[[np.ndarray], np.ndarray], seeds: Sequence[int], frames: int
) -> tuple[np.ndarray, np.ndarray]:
    """Mean reward per frame of an episode from every seed, and which of them failed, both ``(B,)``.

    ``policy`` turns observations of the batch into actions. A failed member earns nothing from then on.
    """
    world.reset({i: np_random(seed)[0] for i, seed in enumerate(seeds)})
    total, alive = np.zeros(len(seeds)), np.ones(len(seeds), bool)
    for _ in range(frames):
        rewards, reasons = world.step(policy(world.observe()))
        alive &= [reason is None for reason in reasons]
        total += rewards * alive
    return total / frames, ~alive


class Seconds(NamedTuple):
    """Time that a frame took [s]: by the clock, its part until ``advance`` returned, of the process, of this thread."""

    wall: float
    step: float
    cpu: float
    thread: float


def replay(
    backend: Backend, start: State | None, controls: Iterable[Controls], materials: Sequence[Material] | None = None
) -> Iterator[tuple[State, Seconds]]:
    """The state after every frame from ``start`` (None: where the backend is), and the time that it took."""
    if start is not None:
        backend.reset(start, materials)
    for control in controls:
        thread, cpu, wall = thread_time(), process_time(), perf_counter()
        state = backend.advance(control)
        step = perf_counter() - wall
        state.positions, state.velocities  # noqa: B018  a lazy backend infers them now
        yield state, Seconds(perf_counter() - wall, step, process_time() - cpu, thread_time() - thread)


def stack_states(states: Sequence[State]) -> State:
    """Batches one after the other as one batch."""
    return State(**_stacked(states))


def stack_controls(controls: Sequence[Controls]) -> Controls:
    """Batches one after the other as one batch."""
    return Controls(**_stacked(controls))


def _stacked(batches: Sequence[State] | Sequence[Controls]) -> dict[str, np.ndarray]:
    return {f.name: np.concatenate([getattr(b, f.name) for b in batches]) for f in fields(batches[0])}


@dataclass(frozen=True)
class FramePairs:
    """N frames of a scene, each with its material: the cloths before, its controls, the cloths after."""

    scene: Scene
    before: State
    controls: Controls
    after: State
    materials: list[Material]


def one_frame_pairs(
    scene: str, seeds: Sequence[int], frames: int, *, policies: Sequence[str] = ("smooth",), **options: Any
) -> FramePairs:
    """Every frame of one episode a seed, episode by episode: what a surrogate of single frames learns from.

    ``policies`` (of ``cloth_envs.policies``) take turns over the seeds; ``options`` are the world's.

    Raises:
        ValueError: all episodes failed; those that did are left out.
    """
    world = World(scene, num_envs=len(seeds), **options)
    run = record(world, seeded_actions(world, seeds, policies, frames), range(frames + 1), seeds=seeds)
    if not run.good:
        raise ValueError(f"all episodes of {scene} failed ({run.failures[0]}): choose other seeds or fewer frames")
    cloths = [run.only([i]) for i in run.good]
    return FramePairs(
        world.scene,
        stack_states([cloth.states[frame] for cloth in cloths for frame in range(frames)]),
        stack_controls([control for cloth in cloths for control in cloth.controls]),
        stack_states([cloth.states[frame] for cloth in cloths for frame in range(1, frames + 1)]),
        [cloth.materials[0] for cloth in cloths for _ in range(frames)],
    )


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
        means = {k: [np.mean([getattr(c, k) for c in group], 0) for group in groups] for k in ("wind", "pressure")}
        return [replace(g[-1], wind=w, pressure=p) for g, w, p in zip(groups, *means.values(), strict=True)]
    n, out = round(1 / factor), []
    x, v = (
        a.reshape(1, 3, -1)[..., list(scene.handles)].transpose(0, 2, 1) for a in (start.positions, start.velocities)
    )
    bodies, moving = start.colliders, start.collider_velocities
    for c in controls:
        for part in (k / n for k in range(1, n + 1)):
            starts = handle_starts(scene, x, v, c.handle_positions)
            handles = hermite(part, scene.frame_dt, *starts, c.handle_positions, c.handle_velocities)
            around = hermite(part, scene.frame_dt, bodies, moving, c.colliders, c.collider_velocities)
            out.append(Controls(*handles, *around, c.wind, c.pressure))
        x, v, bodies, moving = c.handle_positions, c.handle_velocities, c.colliders, c.collider_velocities
    return out
