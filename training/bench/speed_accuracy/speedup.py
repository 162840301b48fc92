"""Speed-up at equal error of learned and fitted methods, from the rows of ``minicloth bench speed-accuracy``.

McGreivy & Hakim (2024, arXiv:2407.07218) found most speed-ups of learned solvers to be over weak baselines. So each
method is set beside the cheapest setting, among ever stronger baselines, that is at least as close to the truth.
Settings between the measured ones may be cheaper, so that is an upper bound of the speed-up; a straight line on
logarithmic axes between the two neighbours on the front estimates what they would cost.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from training.bench.participants import FAMILIES, FLOOR, label
from training.bench.speed_accuracy.rows import SpeedAccuracyRow, front
from training.rows import rounded

FRAMES = (5, 10)
SOLVERS = ("explicit", "admm", "admm substeps", "implicit", "implicit substeps")
COARSE = ("coarse bilinear", "miniature seed", "miniature similar")
RULE = ("miniature rule",)
FITTED = ("miniature calibrated",)
# What a method is compared with -> families; each takes in those before.
BASELINES = {
    "solvers": SOLVERS,
    "coarser grids": SOLVERS + COARSE,
    "tension field": SOLVERS + COARSE + RULE,
    "fitted springs": SOLVERS + COARSE + RULE + FITTED,
}
METHODS = (*RULE, *FITTED, "miniature closure", "closure ridge", "miniature", "closure learned", "cnn", "mfsr")


@dataclass(frozen=True)
class SpeedUpRow:
    """A method against the front of ``baselines``: ``speedup`` over the cheapest measured setting with at most its
    error, ``interpolated`` over the front drawn through; over 1 the method is faster.

    Both are NaN where no setting is as close, ``interpolated`` also where none is less close. Errors below the chaos
    floor count as the floor. Baselines have to pass the height gate, unless the method itself does not (``passes`` 0).
    """

    scene: str
    family: str
    options: str
    frames: int
    ms: float
    error: float
    passes: int
    baselines: str
    beside: str
    beside_ms: float
    beside_error: float
    speedup: float
    interpolated: float


def counted(row: SpeedAccuracyRow) -> float:
    """Its error, or the chaos floor where that is larger."""
    return max(row.error, row.floor) if row.floor > 0 else row.error


def against(row: SpeedAccuracyRow, rows: Sequence[SpeedAccuracyRow], baselines: str) -> SpeedUpRow:
    """``row`` beside those of ``rows`` of the same scene and horizon that are ``baselines``."""
    rivals = [r for r in rows if (r.scene, r.frames) == (row.scene, row.frames) and r.family in BASELINES[baselines]]
    if not row.passes:
        rivals = [replace(r, gate=0.0) for r in rivals]
    best = front(rivals)  # the fastest first, and ever closer
    near = [r for r in best if counted(r) <= counted(row)]
    far = [r for r in best if counted(r) > counted(row)]
    beside_ms = beside_error = speedup = interpolated = float("nan")
    beside = ""
    if near:
        beside, beside_ms, beside_error = label(near[0].family, near[0].options), near[0].ms_median, near[0].error
        speedup = beside_ms / row.ms_median
    if near and far:
        x = np.log([counted(near[0]), counted(far[-1])])
        y = np.log([near[0].ms_median, far[-1].ms_median])
        interpolated = float(np.exp(np.interp(np.log(counted(row)), x, y))) / row.ms_median
    found = SpeedUpRow(
        row.scene, row.family, row.options, row.frames, row.ms_median, row.error, int(row.passes), baselines,
        beside, beside_ms, beside_error, speedup, interpolated,
    )  # fmt: skip
    return rounded(found)


def speedups(rows: Sequence[SpeedAccuracyRow]) -> list[SpeedUpRow]:
    """Every method (and what ``--backend`` named) and horizon against every set of baselines that it is no part of."""
    return [
        against(row, rows, name)
        for row in rows
        if (row.family in METHODS or row.family not in (*FAMILIES, FLOOR))
        and row.frames in FRAMES
        and np.isfinite(row.ms_median)
        for name, families in BASELINES.items()
        if row.family not in families
    ]


def table(found: Sequence[SpeedUpRow]) -> str:
    """One line a method and horizon: the upper bound, in brackets the interpolated speed-up."""
    wide = max((len(label(f.family, f.options)) for f in found), default=0) + 2
    lines = [f"{'scene':11s}{'method':{wide}s}{'frames':>6s}" + "".join(f"{name:>18s}" for name in BASELINES)]
    cells = {(f.scene, f.family, f.options, f.frames, f.baselines): f for f in found}
    for row in {key[:4]: f for key, f in cells.items()}.values():
        at = [cells.get((row.scene, row.family, row.options, row.frames, name)) for name in BASELINES]
        name = label(row.family, row.options) + " *" * (not row.passes)
        lines.append(f"{row.scene:11s}{name:{wide}s}{row.frames:6d}" + "".join(f"{_cell(f):>18s}" for f in at))
    return "\n".join(lines)


def _cell(found: SpeedUpRow | None) -> str:
    if found is None:
        return ""
    if np.isnan(found.speedup):
        return "none as close"
    return f"{found.speedup:.3g}" + ("" if np.isnan(found.interpolated) else f" ({found.interpolated:.3g})")
