"""Convergence: every solver refined in every way it has, against one limit, over a window shorter than chaos."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from training.bench.configurations import Config, label
from training.bench.convergence.chaos import NUDGE, nudged
from training.bench.cost import build, milliseconds, substeps_of
from training.bench.truth import Case, length, load, replay, vertex_error
from training.rows import Store

LIMIT = 64  # the limit's substeps are the stable step over this
FRAMES = 5
START = 1.0  # s of the episode
COARSE = 2  # grids of half the resolution: the limit in the step does not ask for a fine one
SLOW = 1.0  # s of the processor for a frame; slower ones are left out and say so
FLOOR = "chaos floor"


@dataclass(frozen=True)
class Point:
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


KEY = ("scene", "solver", "options", "seed", "truth")


def run(store: Store[Point], cases: Sequence[Case], configs: Sequence[Config], cache: Path) -> None:
    """Measure what ``store`` lacks, and the chaos floor of the same windows."""
    with tqdm(total=len(cases) * (len(configs) + 1), desc="convergence", disable=None) as bar:
        for given in cases:
            case = replace(given, refine=LIMIT)
            begin = round(START / case.world().scene.frame_dt)
            truth = load(case, begin + FRAMES, [begin, begin + FRAMES], cache)
            scene, controls = truth.scene, truth.controls[begin:]
            nudge = nudged(truth.states[begin], scene.handles, NUDGE * length(scene), np.random.default_rng(case.seed))
            limit = Config("explicit", {"dtype": "float64", "refine": LIMIT})
            for name, config, start in [
                (FLOOR, limit, nudge),
                *((config.solver, config, truth.states[begin]) for config in configs),
            ]:
                bar.set_postfix_str(f"{case.scene} {label(name, config.text)}")
                bar.update()
                if (case.scene, name, config.text, case.seed, truth.key) in store:
                    continue
                backend, error, ms = build(config, scene), np.nan, np.nan
                failure = backend if isinstance(backend, str) else ""
                if not isinstance(backend, str):
                    frames = []
                    for frame in replay(backend, start, controls):
                        frames.append(frame)
                        if frame[1].cpu > SLOW:
                            break
                    ms = milliseconds([seconds.cpu for _, seconds in frames])
                    if len(frames) < FRAMES:
                        failure = f"left out: {frames[-1][1].cpu:.1f} s a frame"
                    else:
                        error = vertex_error(scene, frames[-1][0], truth.states[begin + FRAMES])
                        failure = "" if np.isfinite(error) else "non-finite"
                store.add(
                    Point(
                        case.scene,
                        *scene.grid.shape,
                        name,
                        config.text,
                        case.seed,
                        FRAMES,
                        truth.key,
                        1e3 * scene.frame_dt / max(substeps_of(config, backend), 1),
                        ms,
                        error,
                        failure,
                    )
                )


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


def ladders(points: Sequence[Point]) -> list[Ladder]:
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


def table(points: Sequence[Point]) -> str:
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
