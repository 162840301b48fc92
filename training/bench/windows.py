"""Stretches of truth in a batch, and a method's run over them."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.failure import Failures
from cloth_envs.registry import load_task
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from training.bench.convergence.chaos import NUDGE, nudged
from training.bench.participants import FLOOR, NO_PHYSICS, Job, Method
from training.bench.truth import Case, length, load

REFINE = 16  # truth is four times finer than G1: explicit at a quarter of its step would be compared with itself


@dataclass(frozen=True, eq=False)
class Windows:
    """B stretches of truth, the first window of every seed first. ``truth[t]`` is the batch after t frames."""

    scene: Scene
    seeds: tuple[int, ...]
    starts: tuple[int, ...]
    controls: list[Controls]
    truth: list[State]
    key: str

    def first(self, count: int) -> Windows:
        """The first ``count`` of the batch."""
        if count >= len(self.seeds):
            return self
        cut: list[Any] = []
        for items in (self.controls, self.truth):
            cut.append([type(i)(**{n: a[:count] for n, a in vars(i).items()}) for i in items])
        return replace(self, seeds=self.seeds[:count], starts=self.starts[:count], controls=cut[0], truth=cut[1])

    def until(self, frames: int) -> Windows:
        """The first ``frames`` of every stretch."""
        return replace(self, controls=self.controls[:frames], truth=self.truth[: frames + 1])


def gather(cases: Sequence[Case], starts: Sequence[int], frames: int, last: int, cache: Path) -> Windows:
    """Windows of ``frames`` frames from every start of every case; truths reach to frame ``last`` and are cached."""
    truths = [load(replace(case, refine=REFINE), last, range(last + 1), cache) for case in cases]
    members = [(t, case.seed, start) for start in starts for t, case in zip(truths, cases, strict=True)]

    def join(kind: type, items: list[Any]) -> Any:
        return kind(**{f.name: np.concatenate([getattr(i, f.name) for i in items]) for f in fields(kind)})

    return Windows(
        truths[0].scene,
        tuple(seed for _, seed, _ in members),
        tuple(start for *_, start in members),
        [join(Controls, [t.controls[start + i] for t, _, start in members]) for i in range(frames)],
        [join(State, [t.states[start + i] for t, _, start in members]) for i in range(frames + 1)],
        hashlib.sha256("".join(t.key for t in truths).encode()).hexdigest()[:12],
    )


def simulate(method: Method, windows: Windows, threads: int = 1) -> tuple[list[State], list[str]]:
    """States after every frame, the start first, and for each window why and when it failed, or ``""``."""
    scene, start = windows.scene, windows.truth[0]
    job = Job(scene, start.batch, threads, windows.truth)
    if method.family == FLOOR:
        rng = np.random.default_rng(0)
        start = nudged(start, scene.handles, NUDGE * length(scene), rng)
        method = Method("explicit", {"dtype": "float64", "refine": REFINE})
    backend = method.build(job)
    if isinstance(backend, str):
        return [start], [backend] * start.batch
    failures, reasons, states = Failures(scene, load_task(scene.name).max_strain), [""] * start.batch, [start]
    backend.reset(start)
    for frame, controls in enumerate(windows.controls, 1):
        after = backend.advance(controls)
        states.append(State(**{n: np.array(getattr(after, n)) for n in (f.name for f in fields(State))}))
        for i, reason in enumerate(failures.check(states[-2], states[-1])):
            if reason and not reasons[i] and not (reason != "non-finite" and isinstance(backend, NO_PHYSICS)):
                reasons[i] = f"{reason} at frame {frame}"
    return states, reasons


def failed_by(reason: str, frame: int) -> bool:
    """Whether a run that ended for ``reason`` had done so by ``frame``."""
    return bool(reason) and (" at frame " not in reason or int(reason.rsplit(" ", 1)[1]) <= frame)


def rounded(row: Any) -> Any:
    """``row`` with its floats to five digits: files stay small."""
    return type(row)(**{n: float(f"{v:.5g}") if isinstance(v, float) else v for n, v in asdict(row).items()})
