"""Truth G1: the same mesh and energy, explicit in float64 at a quarter of the stable step, and its controls.

A task's controls follow from the state, so those of the truth's run are recorded once and replayed for every solver:
all of them get the same handles, bodies, wind and pressure. States are kept only at the frames that are asked for.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, NamedTuple

import numpy as np
from gymnasium.utils.seeding import np_random

from cloth_envs.backend import Backend
from cloth_envs.grid import coarser
from cloth_envs.physics.laws.drives import hermite
from cloth_envs.policies import open_loop
from cloth_envs.registry import load_task
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from cloth_envs.world import World

REFINE = 4  # truth G1 takes a quarter of the stable step


@dataclass(frozen=True)
class Case:
    """One episode of a scene under seeded smooth actions, on a grid ``coarse`` times coarser (1/2: finer)."""

    scene: str
    seed: int = 0
    coarse: float = 1
    refine: int = REFINE

    def world(self) -> World:
        resolution = coarser(load_task(self.scene).resolution, self.coarse)
        options = {"dtype": "float64", "refine": self.refine}
        return World(self.scene, backend_kwargs=options, resolution=resolution)


@dataclass(frozen=True)
class Truth:
    """``states`` by frame number, the ``controls`` of every frame, and a ``key`` that tells its content."""

    scene: Scene
    states: dict[int, State]
    controls: list[Controls]
    key: str


class _Recorder:
    """A backend that keeps the controls it is given."""

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self.controls: list[Controls] = []

    def advance(self, controls: Controls) -> State:
        self.controls.append(Controls(**{name: np.array(value) for name, value in vars(controls).items()}))
        return self._backend.advance(controls)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._backend, name)


def record(case: Case, frames: int, keep: Iterable[int]) -> tuple[Scene, dict[int, State], list[Controls]]:
    """Run ``case`` for ``frames``; the states at the ends of the frames ``keep`` (0 is the start), and all controls.

    Raises:
        ValueError: the truth itself failed.
    """
    world, wanted = case.world(), set(keep)
    world.reset({0: np_random(case.seed)[0]})
    recorder = _Recorder(world.backend)
    world.backend = recorder
    actions = open_loop("smooth", max(frames, 200), len(world.task.actions), world.scene.frame_dt, case.seed)
    states = {0: world.state.copy()} if 0 in wanted else {}
    for frame in range(1, frames + 1):
        reason = world.step(actions[frame - 1][None])[1][0]
        if reason:
            raise ValueError(f"the truth of {case} failed ({reason} at frame {frame}): choose another seed")
        if frame in wanted:
            states[frame] = world.state.copy()
    return world.scene, states, recorder.controls


def cache_folder(given: Path | None = None) -> Path:
    """``given``, or ``minicloth/truth`` among the user's caches."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return given or home / "minicloth" / "truth"


def load(case: Case, frames: int, keep: Iterable[int], folder: Path) -> Truth:
    """The truth of ``case``, from ``folder`` if it is there, else computed and stored there.

    Its name is a hash of the case, the scene and the first frame, which is computed anew, so that a changed kernel,
    task or material is never answered by an old truth.
    """
    wanted = sorted(set(keep))
    scene, first, controls = record(case, 1, [0, 1])
    parts = [repr((case, scene, frames, wanted)).encode()]
    parts += [a.tobytes() for item in (*first.values(), *controls) for a in vars(item).values()]
    key = hashlib.sha256(b"".join(parts)).hexdigest()[:16]
    path = folder / f"{case.scene.lower()}_{key}.npz"
    if not path.is_file():
        _, states, controls = record(case, frames, wanted)
        arrays = {f"state.{n}": np.concatenate([states[f].arrays()[n] for f in wanted]) for n in _names(State)}
        arrays |= {f"controls.{n}": np.concatenate([getattr(c, n) for c in controls]) for n in _names(Controls)}
        folder.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}.part.npz")
        np.savez(part, **arrays)  # type: ignore[arg-type]
        part.replace(path)
    with np.load(path) as file:
        arrays = dict(file)
    kept = {f: State(**{n: arrays[f"state.{n}"][[i]] for n in _names(State)}) for i, f in enumerate(wanted)}
    return Truth(
        scene,
        kept,
        [Controls(**{n: arrays[f"controls.{n}"][[i]] for n in _names(Controls)}) for i in range(frames)],
        key,
    )


def _names(kind: type[State] | type[Controls]) -> list[str]:
    return [field.name for field in fields(kind)]


class Seconds(NamedTuple):
    """Time that a frame took [s]: on the wall, and of the processor, whatever else ran on it meanwhile."""

    wall: float
    cpu: float


def replay(backend: Backend, start: State, controls: Sequence[Controls]) -> Iterator[tuple[State, Seconds]]:
    """The state after every frame from ``start``, and the time that the backend took for it."""
    backend.reset(start)
    for control in controls:
        wall, cpu = perf_counter(), process_time()
        state = backend.advance(control)
        state.positions, state.velocities  # noqa: B018  a lazy backend infers them now
        yield state, Seconds(perf_counter() - wall, process_time() - cpu)


def vertex_error(scene: Scene, state: State, truth: State) -> float:
    """Mean distance of the vertices from those of the truth over the cloth's longer side."""
    gap = state.positions[0].astype(np.float64) - truth.positions[0]
    return float(np.sqrt((gap**2).sum(0)).mean() / length(scene))


def length(scene: Scene) -> float:
    """The cloth's longer side [m]."""
    return max(scene.grid.height, scene.grid.width)


def mean_height(scene: Scene, state: State) -> float:
    """Height of the first cloth's centre of mass [m]."""
    return float(np.average(state.positions[0, 2].astype(np.float64), weights=scene.grid.areas))


def retime(scene: Scene, start: State, controls: Sequence[Controls], factor: float) -> list[Controls]:
    """``controls`` for frames ``factor`` times as long: 1/n or a whole number.

    Longer frames end where every ``factor``-th did, under the mean of their winds; shorter ones end on the cubics.
    """
    if factor >= 1:
        n = round(factor)
        groups = [controls[i : i + n] for i in range(0, len(controls) - n + 1, n)]
        return [_mixed(group[-1], group) for group in groups]
    n, out = round(1 / factor), []
    flat = start.positions.reshape(1, 3, -1)[..., list(scene.handles)].transpose(0, 2, 1)
    flat_v = start.velocities.reshape(1, 3, -1)[..., list(scene.handles)].transpose(0, 2, 1)
    before = flat, flat_v, start.colliders, start.collider_velocities
    for control in controls:
        after = control.handle_positions, control.handle_velocities, control.colliders, control.collider_velocities
        for part in range(1, n + 1):
            handles = hermite(part / n, scene.frame_dt, *before[:2], *after[:2])
            bodies = hermite(part / n, scene.frame_dt, *before[2:], *after[2:])
            out.append(Controls(*handles, *bodies, control.wind, control.pressure))
        before = after
    return out


def _mixed(last: Controls, group: Sequence[Controls]) -> Controls:
    mean = {name: np.mean([getattr(c, name) for c in group], 0) for name in ("wind", "pressure")}
    return Controls(**{**vars(last), **mean})
