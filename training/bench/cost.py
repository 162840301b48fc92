"""Accuracy per cost: short runs of every configuration from states of the truth, timed and compared with it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from cloth_envs.backend import Backend
from cloth_envs.failure import Failures
from cloth_envs.physics.budget import LEAST_FALL
from cloth_envs.physics.diagnostics import strain
from training.bench.configurations import Config, label
from training.bench.store import Store
from training.bench.truth import Case, Truth, length, load, mean_height, replay, vertex_error

HORIZONS = (1, 5, 10)  # frames
# Truth here is four times finer than G1: explicit at a quarter of its step would be compared with itself.
REFINE = 16
WINDOW = 0.5  # s; the mean height is compared at its end
STARTS = (0.0, 1.0, 2.0)  # s of the episode; errors are told of those that have settled in, after the first
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


@dataclass(frozen=True)
class Summary:
    """All runs of a configuration on a scene.

    ``ms`` is the processor's time, which on an idle machine is the wall clock's; on a busy one that counts what the
    others do. Errors are means over the windows after the first, in % of the cloth's longer side and in metres;
    ``slow`` is the part of the truth's way that the mean height lags behind, all windows together.
    """

    scene: str
    solver: str
    options: str
    substeps: int
    iterations: int
    runs: int
    ms_q1: float
    ms_median: float
    ms_q3: float
    wall_ms_median: float
    error_1_percent: float
    error_5_percent: float
    error_10_percent: float
    error_1_m: float
    error_5_m: float
    error_10_m: float
    height_m: float
    slow: float
    p99: float
    p99_truth: float
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
) -> None:
    """Measure what ``store`` lacks; configurations take turns, so that a busy moment of the machine hits all alike."""
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
                        if name not in backends:  # the first frame warms up
                            made = backends[name] = build(config, truth.scene)
                            if not isinstance(made, str):
                                list(replay(made, truth.states[start], truth.controls[start : start + 1]))
                        store.add(window(truth, start, frames, config, backends[name], case))


def summaries(rows: Sequence[Run]) -> list[Summary]:
    """One row for each scene and configuration."""
    out = []
    for scene, solver, options in dict.fromkeys((r.scene, r.solver, r.options) for r in rows):
        mine = [r for r in rows if (r.scene, r.solver, r.options) == (scene, solver, options)]
        settled = [r for r in mine if r.start_s > 0] or mine
        errors = [float(np.mean([getattr(r, f"error_{h}") for r in settled])) for h in HORIZONS]
        q1, median, q3 = np.percentile([r.ms for r in mine], [25, 50, 75])
        way = sum(max(abs(r.sank_m), LEAST_FALL * r.length_m) for r in mine)
        lag = sum(r.height_m * np.sign(r.sank_m) for r in mine)
        failed = [r.failure for r in mine if r.failure]
        out.append(
            Summary(
                scene=scene,
                solver=solver,
                options=options,
                substeps=mine[0].substeps,
                iterations=json.loads(options).get("iterations", 0),
                runs=len(mine),
                ms_q1=float(q1),
                ms_median=float(median),
                ms_q3=float(q3),
                wall_ms_median=float(np.median([r.wall_ms for r in mine])),
                error_1_percent=100 * errors[0],
                error_5_percent=100 * errors[1],
                error_10_percent=100 * errors[2],
                error_1_m=errors[0] * mine[0].length_m,
                error_5_m=errors[1] * mine[0].length_m,
                error_10_m=errors[2] * mine[0].length_m,
                height_m=float(np.mean([abs(r.height_m) for r in mine])),
                slow=float(lag / way),
                p99=float(np.mean([r.p99 for r in mine])),
                p99_truth=float(np.mean([r.p99_truth for r in mine])),
                failure=f"{len(failed)} of {len(mine)}: {failed[0]}" if failed else "",
            )
        )
    return out


def table(rows: Sequence[Summary]) -> str:
    """The summaries as text, one block a scene."""
    lines = []
    for scene in dict.fromkeys(r.scene for r in rows):
        lines += [
            f"\n{scene}",
            f"{'':42s} {'substeps':>8s} {'runs':>4s} {'ms/frame (quartiles)':>22s}"
            f"{'error 1 fr. %':>14s}{'5 fr. %':>9s}{'10 fr. %':>9s}{'10 fr. mm':>10s}{'height mm':>10s}"
            f"{'lag':>7s}{'':6s}{'p99 strain (truth)':>20s}",
        ]
        for r in (r for r in rows if r.scene == scene):
            time = f"{r.ms_median:.3g} ({r.ms_q1:.3g}-{r.ms_q3:.3g})"
            lines.append(
                f"{label(r.solver, r.options):42s} {r.substeps:8d} {r.runs:4d} {time:>22s}"
                f"{r.error_1_percent:14.2g}{r.error_5_percent:9.2g}{r.error_10_percent:9.2g}"
                f"{1e3 * r.error_10_m:10.2g}{1e3 * r.height_m:10.2g}{f'{100 * r.slow:.1f}%':>7s}"
                f"{' SLOW ' if r.slow > TOLERANCE else ' FAST ' if r.slow < -TOLERANCE else '      '}"
                f"{f'{100 * r.p99:.2f}% ({100 * r.p99_truth:.2f}%)':>20s}  {r.failure}"
            )
    return "\n".join(lines)
