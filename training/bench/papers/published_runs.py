"""Runs behind the tables of seed 000 that need networks: a teacher's run, miniature runs beside it, upscaled by all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from cloth_envs.physics.solver import reference
from cloth_envs.presets import load_preset, solver_of
from cloth_envs.resample import resample
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.checkpoint import load
from surrogates.miniature.backend import MiniatureBackend
from surrogates.miniature.coarse import coarse_scene
from surrogates.upscale.local import Local, weights_name
from surrogates.upscale.protocol import Upscaler, make_upscaler
from surrogates.upscale.published import FullyConnected
from training.bench.truth import replay
from training.generate import HELD_OUT_EVERY, Plan, draw, simulate, task_of

PRESET = "lee2019"
# Every upscaler here is scored in every table and drawn in every chart, where it has weights: one name a line more.
UPSCALERS = ("bilinear", "biquadratic", "bicubic", "hdnn", "fc")
UNSCALED = "hdnn unscaled"  # H-DNN-like as its paper has it: on a coarse cloth of the fine particles' mass
# Recipes beside those shipped: learnt from real miniatures, and started at random.
OTHERS = ("real", "real_4x128", "random")
NUDGE = 1e-6  # m, standard deviation of how far a nudged teacher starts from the teacher
HISTORY = 3


@dataclass(frozen=True)
class Run:
    """The teacher: its scene, its ``states`` (the start first) and the controls of every frame."""

    scene: Scene
    states: list[State]
    controls: list[Controls]

    @property
    def positions(self) -> np.ndarray:
        """After every frame, ``(T, 3, H, W)`` [m]."""
        return np.concatenate([state.positions for state in self.states[1:]])


def teacher(scene: str, frames: int, options: Mapping[str, float] | None = None, **attributes: float) -> Run:
    """The preset's own run, with zero actions; ``options`` are the preset's (mass, spring, wind).

    ``attributes`` are set on the task's class: ``across`` [rad], how far the flag starts from downwind.
    """
    cls: Any = load_preset(scene, {"name": PRESET, **(options or {})})
    cls = type(cls.__name__, (cls,), attributes)
    task = cls(cls.make_scene(resolution=cls.resolution, material=cls.material))
    run = simulate(task, PRESET, np.random.default_rng(0), frames)
    return Run(run.scene, list(run.states.values()), run.controls)


def held_out(scene: str, count: int) -> Iterator[Run]:
    """The first ``count`` trajectories that the networks were not trained on, simulated again."""
    plan = Plan(scene)
    for index in range(HELD_OUT_EVERY - 1, count * HELD_OUT_EVERY, HELD_OUT_EVERY):
        own = draw(plan, index)
        task, rng = task_of(scene, PRESET, own), np.random.default_rng((plan.seed, index, 1))
        run = simulate(task, PRESET, rng, plan.frames, own.push)
        yield Run(run.scene, list(run.states.values()), run.controls)


def miniature(run: Run, factor: int, first: int, frames: int, **options: Any) -> list[State]:
    """Coarse states from the teacher's after ``first`` frames on: two of the past, the start, and ``frames`` more."""
    name, solver = _solver()
    options = {"solver": name, "solver_kwargs": solver, **options}
    backend = MiniatureBackend(run.scene, factor=factor, **options)
    backend.reset(run.states[first])
    now = backend.coarse.state
    states = [now.copy() for _ in range(HISTORY)]
    for back, past in enumerate(reversed(states)):
        past.positions -= now.velocities * np.float32(back * run.scene.frame_dt)
    for control in run.controls[first : first + frames]:
        backend.advance(control)
        states.append(backend.coarse.state.copy())
    return states


def unscaled(factor: int) -> dict[str, Any]:
    """Options of a miniature that is H-DNN's coarsest level: particles of the same mass and springs, farther apart."""
    return {"scaling": "calibrated", "factors": {"areal_density": factor**-2.0}}


def decimated(run: Run, factor: int) -> list[State]:
    """The teacher's own states on the coarse grid, as ``miniature`` gives them: the oracle."""
    coarse, _ = coarse_scene(run.scene, factor, run.scene.material)
    states = [run.states[0]] * (HISTORY - 1) + run.states
    small = []
    for state in states:
        cloth = {n: resample(getattr(state, n), run.scene.grid, coarse.grid) for n in ("positions", "velocities")}
        arrays = {n: np.ascontiguousarray(a, np.float32) for n, a in cloth.items()}
        small.append(State(**{**state.arrays(), **arrays}))
    return small


def upscalers(run: Run, factor: int, names: Sequence[str], extra: Path | None = None) -> dict[str, Upscaler]:
    """Those of ``names`` that have weights for this scene, and ``OTHERS`` and ``"local"`` in the folder ``extra``."""
    coarse, _ = coarse_scene(run.scene, factor, run.scene.material)
    found: dict[str, Upscaler] = {}
    for name in names:
        try:
            found[name] = make_upscaler(name, coarse, run.scene, factor)
        except ValueError:
            continue
    stem = f"fc_{run.scene.name.lower()}_{factor}"
    for kind in OTHERS:
        if extra and (extra / f"{stem}_{kind}.safetensors").is_file():
            found["fc " + kind.replace("_", " ")] = FullyConnected(
                coarse, run.scene, factor, weights=load(f"{stem}_{kind}", extra)
            )
    taught = f"{weights_name('local', run.scene.name)}_{factor}"
    if extra and (extra / f"{taught}.safetensors").is_file():  # of training.local.published
        found["local"] = Local(coarse, run.scene, factor, arrays=load(taught, extra).arrays)
    for each in found.values():
        each.set_materials([0], [run.scene.material])
    return found


def upscaled(run: Run, up: Upscaler, states: Sequence[State], factor: int, first: int = 0) -> np.ndarray:
    """Positions ``(T, 3, H, W)`` [m] of the fine cloth after every frame, driven vertices where they are driven."""
    _, handles = coarse_scene(run.scene, factor, run.scene.material)
    held, out = np.array(run.scene.handles, np.int32), []
    for k in range(HISTORY, len(states)):
        fine = up.positions(states[: k + 1][-HISTORY:])
        handles.place(fine, run.controls[first + k - HISTORY].handle_positions, held)
        out.append(fine[0])
    return np.stack(out)


def by_frame(positions: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Mean distance of the vertices in every frame, ``(T,)`` [m]."""
    return np.sqrt(((positions.astype(np.float64) - truth) ** 2).sum(1)).mean((1, 2))


def nudged(run: Run) -> np.ndarray:
    """The error by frame of the teacher itself, started ``NUDGE`` away: below that nothing can be predicted."""
    start = run.states[0].copy()
    free = np.ones(run.scene.grid.vertices, bool)
    free[list(run.scene.handles)] = False
    noise = np.random.default_rng(1).normal(0, NUDGE, start.positions.shape)
    start.positions += (noise * free.reshape(run.scene.grid.shape)).astype(np.float32)
    return teacher_again(run, start)


def teacher_again(run: Run, start: State | None = None, **options: Any) -> np.ndarray:
    """The error by frame of the teacher's solver with other ``options``, or from another start."""
    backend = reference(run.scene, num_envs=1, **{**solver_of(PRESET), **options})
    states = [state.positions[0].copy() for state, _ in replay(backend, start or run.states[0], run.controls)]
    return by_frame(np.stack(states), run.positions)


def milliseconds(run: Run, factor: int, names: Sequence[str]) -> dict[str, float]:
    """Processor time of a frame [ms]: the teacher, and the miniature with each upscaler. The best of five passes."""
    name, solver = _solver()
    backends: dict[str, Any] = {"teacher": reference(run.scene, num_envs=1, **solver_of(PRESET))}
    for up in names:
        options = {**(unscaled(factor) if up == "hdnn" else {}), "upscaler": up}
        try:
            backends[up] = MiniatureBackend(run.scene, factor=factor, solver=name, solver_kwargs=solver, **options)
        except ValueError:
            continue
    best = dict.fromkeys(backends, np.inf)
    for _ in range(5):
        for key, backend in backends.items():
            backend.reset(run.states[0])
            times = []
            for control in run.controls:
                begin = process_time()
                backend.advance(control).positions  # noqa: B018  a lazy backend infers them now
                times.append(process_time() - begin)
            best[key] = min(best[key], 1e3 * float(np.median(times)))
    return best


def _solver() -> tuple[str, dict[str, Any]]:
    solver = dict(solver_of(PRESET))
    return solver.pop("solver"), solver
