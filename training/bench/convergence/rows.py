"""Rows of the convergence benchmark: errors against a limit, the ladders that they make, and the chaos floor."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from training.bench.participants import FLOOR, label
from training.rows import read_rows

DATA = Path(__file__).parents[3] / "docs" / "data" / "chaos_floor.csv"


@dataclass(frozen=True)
class ConvergenceRow:
    """``error``: mean distance of the vertices from the limit after ``frames``, over the cloth's longer side."""

    scene: str
    rows: int
    cols: int
    solver: str
    options: str
    seed: int
    frames: int
    truth: str
    step_ms: float
    ms: float
    error: float
    failure: str


CONVERGENCE_KEY = ("scene", "solver", "options", "seed", "truth")


@dataclass(frozen=True)
class ChaosRow:
    """What became of a nudge after ``frames``, over the cloth's longer side: ``error`` is the mean distance of the
    vertices, ``height`` the difference of the mean height, without its sign.
    """

    scene: str
    rows: int
    cols: int
    seed: int
    frames: int
    seconds: float
    error: float
    error_m: float
    height: float


CHAOS_KEY = ("scene", "rows", "cols", "seed", "frames")


@dataclass(frozen=True)
class Ladder:
    """Errors along one option, the others fixed.

    ``order`` is the slope of the errors' logarithms over the last three rungs; NaN along iterations and tolerances,
    where what the step leaves is what remains.
    """

    scene: str
    solver: str
    option: str
    others: str
    values: tuple[float, ...]
    errors: tuple[float, ...]
    order: float


def ladders(points: Sequence[ConvergenceRow]) -> list[Ladder]:
    """All options that take three values or more while the others stay; errors are means over the seeds."""
    out = []
    for scene, solver in dict.fromkeys((p.scene, p.solver) for p in points if p.solver != FLOOR):
        mine = [p for p in points if (p.scene, p.solver) == (scene, solver)]
        errors = {o: float(np.mean([p.error for p in mine if p.options == o])) for o in {p.options for p in mine}}
        groups: dict[tuple[str, str], dict[float, float]] = {}
        for options, error in errors.items():
            parsed: dict[str, Any] = json.loads(options)
            for name, value in parsed.items():
                if not isinstance(value, str) and np.isfinite(error):
                    others = json.dumps({k: v for k, v in parsed.items() if k != name})
                    groups.setdefault((name, others), {})[float(value)] = error
        for (name, others), found in sorted(groups.items()):
            values = sorted(found, reverse=name == "tolerance")
            if len(values) >= 3:
                rung = [found[v] for v in values]
                fits = name in ("refine", "substeps") and np.isfinite(rung[-3:]).all()
                order = -float(np.polyfit(np.log(values[-3:]), np.log(rung[-3:]), 1)[0]) if fits else np.nan
                out.append(Ladder(scene, solver, name, others, tuple(values), tuple(rung), order))
    return out


def convergence_table(points: Sequence[ConvergenceRow]) -> str:
    """Ladders and, for each scene, how near every solver comes to the limit."""
    lines = []
    found = ladders(points)
    for scene in dict.fromkeys(p.scene for p in points):
        mine = [p for p in points if p.scene == scene]
        floor = np.mean([p.error for p in mine if p.solver == FLOOR])
        shape = f"{mine[0].rows} x {mine[0].cols}"
        lines.append(f"\n{scene}, {shape}, error after {mine[0].frames} frames [%]; chaos floor {100 * floor:.1g}")
        for ladder in (x for x in found if x.scene == scene):
            values = "  ".join(f"{v:g}: {100 * e:.2g}" for v, e in zip(ladder.values, ladder.errors, strict=True))
            order = f"   order {ladder.order:.2f}" if np.isfinite(ladder.order) else ""
            lines.append(f"  {label(ladder.solver, ladder.others):50s} {ladder.option:10s} {values}{order}")
        for solver in dict.fromkeys(p.solver for p in mine if p.solver != FLOOR):
            best = min(
                (p for p in mine if p.solver == solver and np.isfinite(p.error)), key=lambda p: p.error, default=None
            )
            lines += [f"  {label(solver, p.options)}: {p.failure}" for p in mine if p.solver == solver and p.failure]
            if best:
                lines.append(
                    f"  nearest: {label(solver, best.options)}, {100 * best.error:.2g} % (step {best.step_ms:.3g} ms)"
                )
    return "\n".join(lines)


def floor(scene: str, frames: float, *, quantile: float = 0.5, path: Path = DATA) -> float:
    """Error that the smallest of differences grows to after ``frames``, over the cloth's longer side.

    The quantile over the seeds, interpolated between the measured frames on logarithmic axes; at the scene's own
    resolution. An error claimed after ``frames`` frames means nothing below it.

    Raises:
        ValueError: not measured for this scene, or for so many frames.
        FileNotFoundError: no data; `minicloth bench convergence` makes them.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no chaos floor in {path}: run `minicloth bench convergence --out FOLDER`")
    rows = [row for row in read_rows(path, ChaosRow) if row.scene == scene]
    known = sorted({row.frames for row in rows})
    if not known or not known[0] <= frames <= known[-1]:
        raise ValueError(f"the chaos floor of {scene!r} is known at frames {known}, not at {frames}")
    at = [np.quantile([row.error for row in rows if row.frames == f], quantile) for f in known]
    return float(np.exp(np.interp(np.log(frames), np.log(known), np.log(at))))


def chaos_table(rows: Sequence[ChaosRow]) -> str:
    """Median and range over the seeds, in % of the cloth's length."""
    frames = sorted({row.frames for row in rows})
    lines = [f"{'scene':10s} {'seeds':>5s}" + "".join(f"{f'{f} fr.':>27s}" for f in frames)]
    for scene in dict.fromkeys(row.scene for row in rows):
        line = f"{scene:10s} {len({row.seed for row in rows if row.scene == scene}):5d}"
        for f in frames:
            found = [100 * row.error for row in rows if row.scene == scene and row.frames == f]
            line += f"{f'{np.median(found):.2g} ({min(found):.2g}-{max(found):.2g})':>27s}" if found else " " * 27
        lines.append(line)
    return "\n".join(lines)
