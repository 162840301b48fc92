"""Runs of accuracy per cost summed up: one row for each scene and configuration."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cloth_envs.physics.laws.budget import LEAST_FALL
from training.bench.configurations import label
from training.bench.cost import HORIZONS, TOLERANCE, Run


@dataclass(frozen=True)
class Summary:
    """All runs of a configuration on a scene.

    ``ms`` is the processor's time, which on an idle machine is the wall clock's; on a busy one that counts what the
    others do. Errors are means over the windows that have settled in, in % of the cloth's longer side and in metres;
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


def summaries(rows: Sequence[Run]) -> list[Summary]:
    """One row for each scene and configuration."""
    out = []
    for scene, solver, options in dict.fromkeys((r.scene, r.solver, r.options) for r in rows):
        mine = [r for r in rows if (r.scene, r.solver, r.options) == (scene, solver, options)]
        settled = [r for r in mine if r.start_s > 0] or mine
        errors = [float(np.mean([getattr(r, f"error_{h}") for r in settled])) for h in HORIZONS]
        q1, median, q3 = np.percentile([r.ms for r in mine], [25, 50, 75])  # NaN of one that never ran
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
