"""Accuracy per cost: short runs of every configuration from states of the truth, timed and compared with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from cloth_envs.backend import Backend
from cloth_envs.failure import Failures
from cloth_envs.physics.laws.diagnostics import strain
from training.bench.configurations import Config, label
from training.bench.truth import Case, Truth, length, load, mean_height, replay, vertex_error
from training.rows import Store

HORIZONS = (1, 5, 10)  # frames
# Truth here is four times finer than G1: explicit at a quarter of its step would be compared with itself.
REFINE = 16
WINDOW = 0.5  # s; the mean height is compared at its end
STARTS = (1.0, 2.0, 0.0)  # s of the episode; errors are told of those that have settled in
LIMIT = 10.0  # s of the processor, for a configuration on a scene
TOLERANCE = 0.05  # of the way that the mean height goes; more is slow motion


@dataclass(frozen=True)
class Run:
    """One run of one window. NaN after a failure.

    ``ms`` and ``wall_ms`` are medians over its frames of the processor's time and of the wall clock; ``error_N`` the
    mean distance of the vertices after N frames over the cloth's longer side; ``height_m`` the mean height less the
    truth's at the window's end, and ``sank_m`` how far the truth's sank in it [m]; ``p99`` the 99th percentile of the
    structural edges' strain there.
    """

    scene: str
    solver: str
    options: str
    seed: int
    start_s: float
    truth: str
    substeps: int
    ms: float
    wall_ms: float
    error_1: float
    error_5: float
    error_10: float
    height_m: float
    sank_m: float
    p99: float
    p99_truth: float
    length_m: float
    failure: str


KEY = ("scene", "solver", "options", "seed", "start_s", "truth")


def window(truth: Truth, start: int, frames: int, config: Config, backend: Backend | str, case: Case) -> Run:
    """Run ``backend`` (or why there is none) from the truth's state at frame ``start``."""
    scene, states = truth.scene, truth.states
    failures, before, seconds = Failures(scene), states[start], []
    errors: dict[int, float] = dict.fromkeys(HORIZONS, np.nan)
    height = p99 = float("nan")
    failure = backend if isinstance(backend, str) else ""
    if not isinstance(backend, str):
        for frame, (state, time) in enumerate(replay(backend, before, truth.controls[start : start + frames]), 1):
            seconds.append(time)
            reason = failures.check(before, state)[0]
            if reason:
                failure = f"{reason} at frame {frame}"
                break
            if frame in errors:
                errors[frame] = vertex_error(scene, state, states[start + frame])
            before = state.copy()
        else:
            height = mean_height(scene, before) - mean_height(scene, states[start + frames])
            p99 = float(strain(scene.grid, before.positions).p99[0])
    end = states[start + frames]
    return Run(
        scene=case.scene,
        solver=config.solver,
        options=config.text,
        seed=case.seed,
        start_s=round(start * scene.frame_dt, 6),
        truth=truth.key,
        substeps=substeps_of(config, backend),
        ms=milliseconds([s.cpu for s in seconds]),
        wall_ms=milliseconds([s.wall for s in seconds]),
        error_1=errors[1],
        error_5=errors[5],
        error_10=errors[10],
        height_m=height,
        sank_m=mean_height(scene, states[start]) - mean_height(scene, end),
        p99=p99,
        p99_truth=float(strain(scene.grid, end.positions).p99[0]),
        length_m=length(scene),
        failure=failure,
    )


def milliseconds(seconds: Sequence[float]) -> float:
    """The median [ms], NaN of none."""
    return float(np.median(seconds)) * 1e3 if seconds else np.nan


def substeps_of(config: Config, backend: Any) -> int:
    """Per frame; 0 of a solver that refused."""
    if isinstance(backend, str):
        return 0
    own: Any = getattr(backend, "substeps", config.options.get("substeps", 1))
    return int(np.max(own))


def build(config: Config, scene: Any) -> Backend | str:
    """The backend, or the words with which it refused."""
    try:
        return config.build(scene)
    except ValueError as error:
        return f"refused: {error}"


def run(
    store: Store[Run],
    cases: Sequence[Case],
    configs: Sequence[Config],
    cache: Path,
    starts: Sequence[float] = STARTS,
    limit: float = LIMIT,
) -> None:
    """Measure what ``store`` lacks; configurations take turns, so that a busy moment of the machine hits all alike.

    One that has used ``limit`` [s] of the processor on a scene is not run in that scene's further windows; one whose
    first frame foretells three times that for a single window is left out, and its rows say so.
    """
    with tqdm(total=len(cases) * len(starts) * len(configs), desc="accuracy per cost", disable=None) as bar:
        for scene in dict.fromkeys(case.scene for case in cases):
            backends: dict[str, Backend | str] = {}
            for case in (replace(case, refine=REFINE) for case in cases if case.scene == scene):
                dt = case.world().scene.frame_dt
                frames, begin = round(np.ceil(WINDOW / dt - 1e-9)), [round(s / dt) for s in starts]
                keep = {b + f for b in begin for f in (0, *HORIZONS, frames)}
                truth = load(case, max(begin) + frames, keep, cache)
                for start in begin:
                    for config in configs:
                        name = label(config.solver, config.text)
                        bar.set_postfix_str(f"{scene} {name}")
                        bar.update()
                        at = round(start * dt, 6)
                        if (scene, config.solver, config.text, case.seed, at, truth.key) in store:
                            continue
                        if spent(store.rows, scene, config, frames) > limit:
                            continue
                        if name not in backends:  # the first frame warms up
                            made = backends[name] = build(config, truth.scene)
                            if not isinstance(made, str):
                                first = list(replay(made, truth.states[start], truth.controls[start : start + 1]))
                                if (cpu := first[0][1].cpu) * frames > 3 * limit:
                                    backends[name] = f"left out: {cpu:.1f} s a frame"
                        store.add(window(truth, start, frames, config, backends[name], case))


def spent(rows: Sequence[Run], scene: str, config: Config, frames: int) -> float:
    """Processor's time [s] of the runs of ``config`` on ``scene``."""
    mine = [r.ms for r in rows if (r.scene, r.solver, r.options) == (scene, config.solver, config.text)]
    return float(np.nansum(mine)) * frames / 1e3
