"""Cost of the speed-accuracy charts: wall clock per simulated frame, end to end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from cloth_envs.state import Controls, State
from training.bench.speed_accuracy_methods import Job, Method
from training.bench.speed_accuracy_windows import Windows, rounded

RUNS, TIMED = 7, 10  # timed runs after one that warms up, and frames in each
SLOW, TIMED_SLOW = 50.0, 3  # ms a frame; frames of a run that takes longer


@dataclass(frozen=True)
class Cost:
    """Wall clock of a simulated frame of one cloth [ms]: median and quartiles over ``runs``, the best, and the medians
    of the coarse step and of the upscaling to positions and velocities.
    """

    scene: str
    rows: int
    cols: int
    family: str
    options: str
    batch: int
    threads: int
    runs: int
    ms_q1: float
    ms_median: float
    ms_q3: float
    ms_best: float
    step_ms: float
    upscale_ms: float
    failure: str


COST_KEY = ("scene", "rows", "cols", "family", "options", "batch", "threads")


def cost(
    methods: Sequence[Method], windows: Windows, *, batch: int = 1, threads: int = 1, runs: int = RUNS
) -> list[Cost]:
    """Time ``methods`` in turn, so that a busy moment of the machine hits all alike."""
    start = State(**{n: np.repeat(a[:1], batch, 0) for n, a in windows.truth[0].arrays().items()})
    controls = [Controls(**{n: np.repeat(a[:1], batch, 0) for n, a in vars(c).items()}) for c in windows.controls]
    built = [method.build(Job(windows.scene, batch, threads)) for method in methods]
    count = [TIMED] * len(methods)
    times: list[list[np.ndarray]] = [[] for _ in methods]
    for run in range(runs + 1):
        for i, backend in enumerate(built):
            if isinstance(backend, str):
                continue
            backend.reset(start)
            frames = []
            for control in controls[: count[i] if run else 2]:
                begin = perf_counter()
                state = backend.advance(control)
                middle = perf_counter()
                state.positions, state.velocities  # noqa: B018  a lazy backend infers them now
                end = perf_counter()
                frames.append((end - begin, middle - begin, end - middle))
            taken = np.median(frames, 0) * 1e3 / batch
            if run:
                times[i].append(taken)
            elif taken[0] * batch > SLOW:
                count[i] = TIMED_SLOW
    out = []
    for method, backend, mine in zip(methods, built, times, strict=True):
        table = np.array(mine).reshape(-1, 3) if mine else np.full((1, 3), np.nan)
        q1, median, q3 = np.percentile(table[:, 0], [25, 50, 75])
        step, upscale = np.median(table[:, 1:], 0)
        row = Cost(
            windows.scene.name, *windows.scene.grid.shape, method.family, method.text, batch, threads, len(mine),
            float(q1), float(median), float(q3), float(table[:, 0].min()), float(step), float(upscale),
            failure=backend if isinstance(backend, str) else "",
        )  # fmt: skip
        out.append(rounded(row))
    return out
