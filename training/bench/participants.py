"""Who takes part in `minicloth bench speed-accuracy`: solvers, miniatures and baselines, each swept into a curve."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cloth_envs.registry import make_backend
from cloth_envs.resample import resample, weights
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, LazyState, State
from surrogates.miniature.coarse import CoarsePhysics, coarse_grid
from surrogates.miniature.upscaled import Upscaled
from surrogates.upscale.protocol import INTERPOLATIONS, Interpolation


def moved(state: State, controls: Controls, cloth: Mapping[str, np.ndarray]) -> State:
    """``cloth`` with the bodies, wind and pressure of ``controls``."""
    driven = {name: getattr(controls, name) for name in ("colliders", "collider_velocities", "wind", "pressure")}
    return State(**{**state.arrays(), **driven, **cloth})


class Extrapolation:
    """No physics: the last known frame again, or on at its velocity with ``moving``."""

    def __init__(self, scene: Scene, *, moving: bool) -> None:
        self.scene, self._moving = scene, moving

    def reset(self, state: State) -> None:
        self._state = state.astype(np.float32)
        self._state.velocities *= self._moving

    def advance(self, controls: Controls) -> State:
        now = self._state
        step = {"positions": now.positions + np.float32(self.scene.frame_dt) * now.velocities}
        self._state = moved(now, controls, {**step, "velocities": now.velocities})
        return self._state


def coarser(scene: Scene, *, num_envs: int, factor: float, upscaler: str) -> Upscaled:
    """The similar miniature of any ``factor`` above 1, such as 1.5."""
    coarse = CoarsePhysics(scene, num_envs=num_envs, factor=factor)
    return Upscaled(coarse, Interpolation(coarse.scene, scene, factor, kind=INTERPOLATIONS[upscaler]))


class Offset:
    """A miniature plus what its upscaled start lacked: the fine detail of the start stays for ever."""

    def __init__(self, miniature: Upscaled) -> None:
        self.scene, self._miniature = miniature.scene, miniature

    def reset(self, state: State) -> None:
        self._miniature.reset(state)
        coarse = self._miniature.coarse
        self._lack = {}
        for name in ("positions", "velocities"):
            lack = getattr(state, name) - resample(getattr(coarse.state, name), coarse.scene.grid, self.scene.grid)
            lack.reshape(*lack.shape[:2], -1)[..., list(self.scene.handles)] = 0.0
            self._lack[name] = lack.astype(np.float32)

    def advance(self, controls: Controls) -> State:
        state = self._miniature.advance(controls)
        x, v = self._lack["positions"], self._lack["velocities"]
        return LazyState(self._miniature.coarse.state, lambda _: state.positions + x, lambda _: state.velocities + v)


class Oracle:
    """The exact coarse cloth, upscaled: what interpolation alone loses."""

    def __init__(self, scene: Scene, truth: Sequence[State], *, factor: float, upscaler: str) -> None:
        self.scene, self._truth, self._kind = scene, truth, INTERPOLATIONS[upscaler]
        self._coarse = coarse_grid(scene.grid, factor)

    def reset(self, state: State) -> None:
        self._frame = 0

    def advance(self, controls: Controls) -> State:
        self._frame += 1
        now, up = self._truth[self._frame], weights(self._coarse, self.scene.grid, self._kind)
        fields = ("positions", "velocities")
        small = {name: resample(getattr(now, name), self.scene.grid, self._coarse) for name in fields}
        return moved(now, controls, {name: up[0] @ small[name] @ up[1].T for name in fields})


@dataclass(frozen=True)
class Job:
    """For what a method is built: the ``scene``, a batch, threads, and the truth's frames (for the oracle)."""

    scene: Scene
    num_envs: int = 1
    threads: int = 1
    truth: Sequence[State] = ()


def _solver(name: str, job: Job, **options: Any) -> Any:
    threads = {"threads": job.threads} if job.threads > 1 else {}
    return make_backend(
        "reference", job.scene, num_envs=job.num_envs, backend_kwargs={"solver": name, **options, **threads}
    )


def _miniature(scaling: str, job: Job, *, factor: float, upscaler: str = "bicubic", **options: Any) -> Any:
    if factor not in (2, 3, 4):
        return coarser(job.scene, num_envs=job.num_envs, factor=factor, upscaler=upscaler)
    options |= {"factor": factor, "scaling": scaling, "upscaler": upscaler, "threads": job.threads}
    return make_backend("miniature", job.scene, num_envs=job.num_envs, backend_kwargs=options)


def _offset(scaling: str, job: Job, *, factor: int) -> Any:
    return Offset(_miniature(scaling, job, factor=factor))


Builder = Callable[..., Any]
FACTORS = ({"factor": 2}, {"factor": 3}, {"factor": 4})
ALL_FACTORS = ({"factor": 1.5}, *FACTORS)
ORACLE, FLOOR = "oracle coarse", "chaos floor"
# family -> (how it is built from a Job and options, its sweep). Add a method by a line.
FAMILIES: dict[str, tuple[Builder, Sequence[Mapping[str, Any]]]] = {
    "explicit": (lambda job, **o: _solver("explicit", job, **o), ({}, {"refine": 2}, {"refine": 4})),
    "admm": (lambda job, **o: _solver("admm", job, **o), [{"iterations": n} for n in (1, 3, 10, 30, 100)]),
    "admm substeps": (
        lambda job, **o: _solver("admm", job, **o),
        [{"iterations": 10, "substeps": n} for n in (2, 4, 8, 16)],
    ),
    "implicit": (lambda job, **o: _solver("implicit", job, **o), [{"tolerance": t} for t in (1e-1, 1e-2)]),
    "implicit substeps": (
        lambda job, **o: _solver("implicit", job, **o),
        [{"scheme": "sdirk2", "tolerance": 1e-1, "substeps": n} for n in (1, 2, 4)],
    ),
    "coarse bilinear": (lambda job, **o: _miniature("similar", job, upscaler="bilinear", **o), ALL_FACTORS),
    "coarse biquadratic": (lambda job, **o: _miniature("similar", job, upscaler="biquadratic", **o), ALL_FACTORS),
    "miniature seed": (lambda job, **o: _miniature("seed", job, **o), FACTORS),
    "miniature similar": (lambda job, **o: _miniature("similar", job, **o), ALL_FACTORS),
    "miniature calibrated": (lambda job, **o: _miniature("calibrated", job, **o), FACTORS),
    "calibrated ridge": (lambda job, **o: _miniature("calibrated", job, upscaler="ridge", **o), FACTORS),
    "calibrated local": (lambda job, **o: _miniature("calibrated", job, upscaler="local", **o), FACTORS),
    "miniature closure": (lambda job, **o: _miniature("closure", job, **o), FACTORS),
    "closure local": (lambda job, **o: _miniature("closure", job, upscaler="local", **o), FACTORS),
    "closure learned": (
        lambda job, **o: _miniature("closure", job, correction="learned", **o),
        ({"factor": 2}, {"factor": 4}),
    ),
    "cnn": (lambda job, **o: make_backend("cnn", job.scene, num_envs=job.num_envs, backend_kwargs=o), ({},)),
    "similar + offset": (lambda job, **o: _offset("similar", job, **o), FACTORS),
    "calibrated + offset": (lambda job, **o: _offset("calibrated", job, **o), FACTORS),
    "repeat last frame": (lambda job: Extrapolation(job.scene, moving=False), ({},)),
    "constant velocity": (lambda job: Extrapolation(job.scene, moving=True), ({},)),
    ORACLE: (
        lambda job, **o: Oracle(job.scene, job.truth, **o),
        [{**f, "upscaler": u} for u in INTERPOLATIONS for f in ALL_FACTORS],
    ),
}
THREADED = ("explicit", "admm", "miniature similar")  # families that are timed in batches too


@dataclass(frozen=True)
class Method:
    """One point of a family's sweep."""

    family: str
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The options as JSON, for a row."""
        return json.dumps(dict(self.options))

    def build(self, job: Job) -> Any:
        """An object with ``reset(state)`` and ``advance(controls)``, or the words with which it was refused."""
        try:
            return FAMILIES[self.family][0](job, **self.options)
        except (ValueError, ImportError) as error:
            return f"refused: {error}"


def label(family: str, options: str) -> str:
    """``miniature similar x2`` or ``admm iterations=10`` from a row's fields."""
    parts: dict[str, Any] = json.loads(options)
    factor = parts.pop("factor", None)
    words = [family, *([f"x{factor:g}"] if factor else []), *(f"{n}={v}" for n, v in parts.items())]
    return " ".join(words)


NO_PHYSICS = (Extrapolation, Oracle)  # an edge too long is no failure of these


def choose(families: Sequence[str] | None = None, *, quick: bool = False) -> list[Method]:
    """All methods of ``families`` (default: all); ``quick`` takes the ends of every sweep."""
    out = []
    for name, (_, sweep) in FAMILIES.items():
        if families is None or name in families:
            out += [Method(name, o) for o in (sweep[:: max(1, len(sweep) - 1)] if quick else sweep)]
    return out
