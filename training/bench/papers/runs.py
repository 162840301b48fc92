"""Runs behind the tables of Lee 2019: a teacher's run, miniature runs beside it, upscaled by all.

Also flags that differ in what the paper leaves open (docs/networks.md): is their motion determined, do they still wave?
On a real miniature all upscalers err alike, so there bicubic stands for them, over several starts.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.backend import Backend
from cloth_envs.physics.solver import reference
from cloth_envs.presets import load_preset, solver_of
from cloth_envs.resample import on_grid
from cloth_envs.scene import Scene
from cloth_envs.state import State
from surrogates.checkpoint import load
from surrogates.miniature.backend import MiniatureBackend
from surrogates.miniature.coarse import coarse_scene
from surrogates.upscale.local import Local, weights_name
from surrogates.upscale.protocol import Upscaler, make_upscaler
from surrogates.upscale.published import FullyConnected
from training.generate import HELD_OUT_EVERY, HISTORY, Plan, draw, miniature, simulate, task_of
from training.metrics.errors import distances
from training.rollouts import Recording, replay

PRESET = "lee2019"
# Every upscaler here is scored in every table and drawn in every chart, where it has weights: one name a line more.
UPSCALERS = ("bilinear", "biquadratic", "bicubic", "hdnn", "fc")
UNSCALED = "hdnn unscaled"  # H-DNN-like as its paper has it: on a coarse cloth of the fine particles' mass
# Recipes beside those shipped: learnt from real miniatures, and started at random.
OTHERS = ("real", "real_4x128", "random")
NUDGE = 1e-6  # m, standard deviation of how far a nudged teacher starts from the teacher
# Bending springs, the wind's coefficient along the cloth, wind speed [m/s]. The first flag is ours.
READINGS: list[dict[str, float]] = [
    *({"bending": b, "tangential": t} for b in (0.25, 0.0, 0.0625, 1.0) for t in (0.2, 0.0, 0.1, 0.3, 0.4)),
    *({"wind": w, "bending": b, "tangential": t} for b, t in ((0.25, 0.2), (0.0, 0.1)) for w in (3.0, 6.0, 9.0)),
]
ACROSS = (0.4, 0.45, 0.5, 0.55, 0.6)  # rad from downwind, where readings start; the preset's own is the middle one


def teacher(scene: str, frames: int, options: Mapping[str, float] | None = None, **attributes: float) -> Recording:
    """The preset's own run, with zero actions; ``options`` are the preset's (mass, spring, wind).

    ``attributes`` are set on the task's class: ``across`` [rad], how far the flag starts from downwind.
    """
    cls: Any = load_preset(scene, {"name": PRESET, **(options or {})})
    cls = type(cls.__name__, (cls,), attributes)
    task = cls(cls.make_scene(resolution=cls.resolution, material=cls.material))
    return simulate(task, PRESET, np.random.default_rng(0), frames)


def held_out(scene: str, count: int) -> Iterator[Recording]:
    """The first ``count`` trajectories that the networks were not trained on, simulated again."""
    plan = Plan(scene)
    for index in range(HELD_OUT_EVERY - 1, count * HELD_OUT_EVERY, HELD_OUT_EVERY):
        own = draw(plan, index)
        task, rng = task_of(scene, PRESET, own), np.random.default_rng((plan.seed, index, 1))
        yield simulate(task, PRESET, rng, plan.frames, own.push)


def cloths(run: Recording) -> np.ndarray:
    """Positions after every frame, ``(T, 3, H, W)`` [m]."""
    return np.concatenate([run.states[frame].positions for frame in range(1, len(run.states))])


def unscaled(factor: int) -> dict[str, Any]:
    """Options of a miniature that is H-DNN's coarsest level: particles of the same mass and springs, farther apart."""
    return {"scaling": "calibrated", "factors": {"areal_density": factor**-2.0}}


def decimated(run: Recording, factor: int) -> list[State]:
    """The teacher's own states on the coarse grid, as ``miniature`` gives them: the oracle."""
    coarse, _ = coarse_scene(run.scene, factor, run.scene.material)
    states = [run.states[0]] * (HISTORY - 1) + list(run.states.values())
    return [on_grid(state, run.scene.grid, coarse.grid).astype(np.float32) for state in states]


def upscalers(run: Recording, factor: int, names: Sequence[str], folder: Path | None = None) -> dict[str, Upscaler]:
    """Those of ``names`` that have weights for this scene, and ``OTHERS`` and ``"local"`` in ``folder``."""
    coarse, _ = coarse_scene(run.scene, factor, run.scene.material)
    found: dict[str, Upscaler] = {}
    for name in names:
        with suppress(ValueError):
            found[name] = make_upscaler(name, coarse, run.scene, factor)
    stem = f"fc_{run.scene.name.lower()}_{factor}"
    for kind in OTHERS:
        if folder and (folder / f"{stem}_{kind}.safetensors").is_file():
            weights = load(f"{stem}_{kind}", folder)
            found["fc " + kind.replace("_", " ")] = FullyConnected(coarse, run.scene, factor, weights=weights)
    taught = f"{weights_name('local', run.scene.name)}_{factor}"
    if folder and (folder / f"{taught}.safetensors").is_file():  # of `minicloth train local --published`
        found["local"] = Local(coarse, run.scene, factor, arrays=load(taught, folder).arrays)
    for each in found.values():
        each.set_materials([0], [run.scene.material])
    return found


def errors(run: Recording, up: Upscaler, states: Sequence[State], factor: int, first: int = 0) -> np.ndarray:
    """The error by frame of coarse ``states`` from frame ``first`` on, upscaled, with driven vertices in place."""
    _, handles = coarse_scene(run.scene, factor, run.scene.material)
    held, out = np.array(run.scene.handles, np.int32), []
    for k in range(HISTORY, len(states)):
        fine = up.positions(states[: k + 1][-HISTORY:])
        handles.place(fine, run.controls[first + k - HISTORY].handle_positions, held)
        out.append(fine[0])
    return by_frame(np.stack(out), cloths(run)[first : first + len(out)])


def by_frame(positions: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Mean distance of the vertices in every frame, ``(T,)`` [m]."""
    return distances(positions, truth).mean((1, 2))


def follow(run: Recording, backend: Backend, start: State | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Positions ``(T, 3, H, W)`` [m] of ``backend`` under the controls of ``run``, and seconds ``(T,)`` of each frame.

    The latter are the processor's. It starts where the run did, or at ``start``.
    """
    steps = replay(backend, start or run.states[0], run.controls)
    positions, seconds = zip(*((state.positions[0].copy(), taken.cpu) for state, taken in steps), strict=True)
    return np.stack(positions), np.array(seconds)


def nudged(run: Recording) -> np.ndarray:
    """The error by frame of the teacher itself, started ``NUDGE`` away: below that nothing can be predicted."""
    start = run.states[0].copy()
    free = np.ones(run.scene.grid.vertices, bool)
    free[list(run.scene.handles)] = False
    noise = np.random.default_rng(1).normal(0, NUDGE, start.positions.shape)
    start.positions += (noise * free.reshape(run.scene.grid.shape)).astype(np.float32)
    return teacher_again(run, start)


def teacher_again(run: Recording, start: State | None = None, **options: Any) -> np.ndarray:
    """The error by frame of the teacher's solver with other ``options``, or from another start."""
    return by_frame(follow(run, solver(run.scene, **options), start)[0], cloths(run))


def solver(scene: Scene, **options: Any) -> Backend:
    """The teacher's solver of the fine cloth, with other ``options``."""
    return reference(scene, num_envs=1, **{**solver_of(PRESET), **options})


def shrunk(scene: Scene, factor: int, **options: Any) -> MiniatureBackend:
    """A miniature stepped by the teacher's solver."""
    kwargs = dict(solver_of(PRESET))
    return MiniatureBackend(scene, factor=factor, solver=kwargs.pop("solver"), solver_kwargs=kwargs, **options)


def measured(options: Mapping[str, float], frames: int) -> dict[tuple[str, str], float]:
    """``(method, measure)`` -> mean over ``ACROSS``, of the flag with these options; ``"worst"``: the worst error."""
    found: list[dict[tuple[str, str], float]] = []
    for across in ACROSS:
        run = teacher("Flag", frames, options, across=across)
        off = errors(run, upscalers(run, 2, ("bicubic",))["bicubic"], miniature(run, 2, 0, frames), 2)
        found.append({("bicubic", "error"): float(off.mean()), ("teacher nudged", "error"): float(nudged(run).mean())})
        found[-1] |= {("teacher", name): value for name, value in motion(run).items()}
    means = {key: float(np.mean([values[key] for values in found])) for key in found[0]}
    return means | {("bicubic", "worst"): max(values["bicubic", "error"] for values in found)}


def motion(run: Recording) -> dict[str, float]:
    """How a flag flies in the second half of a run, to tell one that waves from one that only hangs.

    ``"fly"`` [m] is how far its free edge is from the pole, horizontally; ``"waves"`` [m] the root mean square
    distance of the outer quarter's vertices from their means; ``"speed"`` [m/s] that of all velocities.
    """
    half = len(run.controls) // 2
    late = cloths(run)[half:].astype(np.float64)
    outer = late[..., -(late.shape[-1] // 4 + 1) :]
    velocities = np.concatenate([run.states[k].velocities for k in range(1 + half, len(run.states))]).astype(np.float64)
    return {
        "fly": float(np.hypot(late[:, 0, :, -1], late[:, 1, :, -1]).mean()),
        "waves": float(np.sqrt(((outer - outer.mean(0)) ** 2).sum(1).mean())),
        "speed": float(np.sqrt((velocities**2).sum(1).mean())),
    }
