"""Accuracy of the speed-accuracy charts: metrics after short windows, statistics of long runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np

from cloth_envs.physics import laws
from cloth_envs.physics.laws.budget import slow_motion
from cloth_envs.physics.laws.diagnostics import strains
from cloth_envs.scene import Scene
from cloth_envs.state import State
from training import metrics
from training.bench.cost import WINDOW
from training.bench.participants import Method
from training.bench.windows import Windows, failed_by, rounded, simulate
from training.metrics.contact import HAS_IPCTK, crossing_triangles
from training.metrics.errors import displacement_span

HORIZONS = (1, 5, 10, 25)  # frames
BURN_IN = 25  # frames that long-run statistics leave out


@dataclass(frozen=True)
class Score:
    """Metrics of ``training.metrics`` after ``frames``: means over the ``windows`` of one seed that did not fail.

    Errors are in % of the cloth's length; ``crossings`` (pairs of triangles, at the last horizon) may be NaN.
    """

    scene: str
    rows: int
    cols: int
    family: str
    options: str
    seed: int
    frames: int
    truth: str
    windows: int
    error_mean: float
    error_p95: float
    error_max: float
    relative_l2: float
    psnr: float
    vmse: float
    max_dx: float
    normal_deg: float
    curvature: float
    bending_ratio: float
    detail_ratio: float
    depth_mean: float
    depth_max: float
    inside: float
    flicker: float
    tunnelled: float
    crossings: float
    crossings_truth: float
    failure: str


SCORE_KEY = ("scene", "rows", "cols", "family", "options", "seed", "frames", "truth")
MEASURED = [f.name for f in fields(Score) if f.type == "float"]


@lru_cache(maxsize=2)
def truth_span(windows: Windows) -> np.ndarray:
    """Range of the truth's displacements from its mean, ``(3,)`` [m], for PSNR."""
    everything = np.concatenate([s.positions for s in windows.truth])
    return displacement_span(everything, everything.mean(0))


@lru_cache(maxsize=2)
def truth_crossings(windows: Windows, frames: int) -> np.ndarray:
    """Pairs of crossing triangles in the first window of every seed."""
    first = sum(start == windows.starts[0] for start in windows.starts)
    return crossing_triangles(windows.scene.grid, windows.truth[frames].positions[:first])


def score(method: Method, windows: Windows, threads: int = 1, horizons: Sequence[int] = HORIZONS) -> list[Score]:
    """Run the windows and compare them with the truth; one row for each seed and horizon."""
    scene, truth = windows.scene, windows.truth
    states, reasons = simulate(method, windows, threads)
    span = truth_span(windows)
    out = []
    for frames in horizons:
        values: dict[str, np.ndarray] = {name: np.full(len(reasons), np.nan) for name in MEASURED}
        if frames < len(states):
            good = np.flatnonzero([not failed_by(reason, frames) for reason in reasons])
            if len(good):
                run, true = ([s.select(good) for s in part[: frames + 1]] for part in (states, truth))
                found = metrics.at_frame(scene, run[-1], true[-1], span=span)
                if frames >= 2:
                    found |= metrics.over_frames(scene, run, true)
                for name, value in found.items():
                    values[name][good] = value
                few = [i for i, member in enumerate(good) if windows.starts[member] == windows.starts[0]]
                if frames == horizons[-1] and HAS_IPCTK and few:
                    values["crossings"][good[few]] = crossing_triangles(scene.grid, run[-1].positions[few])
                    values["crossings_truth"][good[few]] = truth_crossings(windows, frames)[good[few]]
        for seed in dict.fromkeys(windows.seeds):
            mine = [i for i, s in enumerate(windows.seeds) if s == seed]
            bad = [reasons[i] for i in mine if failed_by(reasons[i], frames)]
            kept = {n: v[mine][~np.isnan(v[mine])] for n, v in values.items()}
            means: dict[str, Any] = {n: float(v.mean()) if len(v) else np.nan for n, v in kept.items()}
            row = Score(
                scene.name, *scene.grid.shape, method.family, method.text, seed, frames, windows.key, len(mine),
                **means, failure=f"{len(bad)} of {len(mine)}: {bad[0]}" if bad else "",
            )  # fmt: skip
            out.append(rounded(row))
    return out


@dataclass(frozen=True)
class Long:
    """A run of an episode's ``frames``: distances of distributions over time from the truth's, and the height gate.

    ``height``: of the mean height, over its standard deviation. ``bending``, ``kinetic``: of these energies, over
    their mean. ``strain``: of all structural edges' strains, over their mean size. ``score``: the mean of the four, in
    %. ``gate``: largest difference of the mean height in the first half second over the way that it goes; at
    most 0.05 passes, a run that failed by then has infinity.
    """

    scene: str
    rows: int
    cols: int
    family: str
    options: str
    seed: int
    frames: int
    truth: str
    height: float
    bending: float
    kinetic: float
    strain: float
    score: float
    gate: float
    failure: str


LONG_KEY = ("scene", "rows", "cols", "family", "options", "seed", "frames", "truth")


def statistics(scene: Scene, states: Sequence[State]) -> dict[str, np.ndarray]:
    """Mean height, bending and kinetic energy ``(B, T)`` and strains ``(B, N)`` of a run."""
    grid, sheets = scene.grid, [scene.material] * states[0].batch
    share = grid.areas / grid.areas.sum()
    return {
        "height": np.stack([(s.positions[:, 2] * share).sum((1, 2)) for s in states], 1),
        "bending": np.stack([laws.bend_energy(grid, sheets, s.positions) for s in states], 1),
        "kinetic": np.stack([laws.kinetic_energy(grid, sheets, s.velocities) for s in states], 1),
        "strain": np.concatenate([strains(grid, s.positions) for s in states[::5]], 1),
    }


@lru_cache(maxsize=2)
def truth_statistics(windows: Windows, burn_in: int) -> dict[str, np.ndarray]:
    """``statistics`` of the truth after ``burn_in`` frames."""
    return statistics(windows.scene, windows.truth[burn_in:])


def gate_frames(scene: Scene) -> int:
    """Frames that the height gate looks at."""
    return round(np.ceil(WINDOW / scene.frame_dt - 1e-9))


def long_run(method: Method, windows: Windows, threads: int = 1, burn_in: int = BURN_IN) -> list[Long]:
    """Run whole episodes; one row for each seed. Episodes no longer than ``burn_in`` have a gate and no statistics."""
    scene, truth = windows.scene, windows.truth
    states, reasons = simulate(method, windows, threads)
    names, settled = ("height", "bending", "kinetic", "strain"), len(truth) > burn_in + 1
    if settled:
        true = truth_statistics(windows, burn_in)
        scales = {"height": true["height"].std(), "strain": abs(true["strain"]).mean()}
        scales |= {name: true[name].mean() for name in ("bending", "kinetic")}
    out = []
    for i, (seed, reason) in enumerate(zip(windows.seeds, reasons, strict=True)):
        parts: dict[str, Any] = dict.fromkeys(names, float("nan"))
        if settled and not reason:
            found = statistics(scene, [s.select([i]) for s in states[burn_in:]])
            for name, values in found.items():
                gaps = np.abs(np.sort(values[0]) - np.sort(true[name][i]))
                parts[name] = float(gaps.mean() / scales[name])
        gate = float("inf")
        early = gate_frames(scene)
        if not failed_by(reason, early):
            run, fell = ([s.select([i]) for s in part[: early + 1]] for part in (states, truth))
            gate = float(slow_motion(scene, run, fell).fraction[0])
        row = Long(
            scene.name, *scene.grid.shape, method.family, method.text, seed, len(truth) - 1, windows.key,
            **parts, score=100 * float(np.mean(list(parts.values()))), gate=gate, failure=reason,
        )  # fmt: skip
        out.append(rounded(row))
    return out
