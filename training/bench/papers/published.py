"""The tables and figures of seed 000 that need networks: ours beside the paper's, part of ``minicloth bench tables``.

Errors are mean distances of the vertices from the teacher's (P-ADMM, 10 iterations), in metres. Four protocols:

- *pairs*: eq. 4 on pairs of patches of held-out trajectories, as the paper's tables 3 and 5 have it, in m^2.
- *oracle*: the teacher's own positions, down-sampled and upscaled again, over ``frames`` frames.
- *free*: a miniature that starts with the teacher and runs by itself for ``frames`` frames; table 7.
- *windows*: held-out trajectories, the miniature started from the teacher's state again every 20 frames.

Rows "readings" are flags that differ in what the paper leaves open (``published_readings``).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from surrogates.checkpoint import WEIGHTS
from training.bench.papers.published_readings import READINGS, measured
from training.bench.papers.published_runs import (
    HISTORY,
    UNSCALED,
    UPSCALERS,
    Run,
    by_frame,
    decimated,
    held_out,
    milliseconds,
    miniature,
    nudged,
    teacher,
    teacher_again,
    unscaled,
    upscaled,
    upscalers,
)
from training.recipes.upscaler import FACTORS, SCENES, Recipe
from training.rows import Store

HORIZONS = (10, 14, 25, 100)  # frames of free runs
WINDOW, HELD_OUT = 20, 12
NAN = float("nan")
TABLE_3 = {"positions": (9.094e-5, 2.85e-4), "velocities": (8.876e-5, 2.778e-4), "frames": (8.856e-5, 2.691e-4)}
TABLE_4 = {2: 1.816e-3, 3: 2.916e-3, 4: 3.901e-3}
TABLE_5 = {
    (4, 32): (9.594e-6, 1.674e-4, 1.66e-5),
    (3, 64): (6.405e-6, 1.276e-4, 1.357e-5),
    (4, 64): (6.214e-6, 1.217e-4, 1.17e-5),
    (5, 64): (7.158e-6, 1.677e-4, 1.454e-5),
    (4, 128): (6.772e-6, 1.486e-4, 1.414e-5),
}
TABLE_7 = {"Curtain": (1.841e-3, 1.816e-3), "Flag": (2.492e-2, 7.767e-3), "Collision": (5.982e-3, 5.973e-3)}
TABLE_8 = {"Curtain": (72.8, 49.7, 37.5), "Flag": (33.2, 24.8, 18.1), "Collision": (50.2, 35.1, 33.2)}
VARIED = {"fig13": [{"mass": m} for m in (1.5, 3.0, 4.5)], "fig14": [{"spring": k} for k in (40.0, 70.0, 150.0)]}
TURNED = [{"wind": 12.0}, {"wind": -12.0}]


@dataclass(frozen=True)
class Row:
    """One number. ``options`` are the preset's that were changed, ``paper`` is what the paper has, or NaN."""

    table: str
    scene: str
    options: str
    factor: int
    method: str
    protocol: str
    frames: int
    measure: str
    value: float
    paper: float


KEY = ("table", "scene", "options", "factor", "method", "protocol", "frames", "measure")
POINT_KEY = ("scene", "protocol", "method", "frame")


@dataclass(frozen=True)
class Point:
    """The error [m] in one frame, for the charts."""

    scene: str
    protocol: str
    method: str
    frame: int
    error: float


def curves(run: Run, factor: int, extra: Path | None = None) -> dict[tuple[str, str], np.ndarray]:
    """Errors by frame of every protocol and method, of one run from its start."""
    frames, truth = len(run.controls), run.positions
    found: dict[tuple[str, str], np.ndarray] = {}
    sources = {"oracle": decimated(run, factor), "free": miniature(run, factor, 0, frames)}
    ups = upscalers(run, factor, UPSCALERS, extra)
    for protocol, states in sources.items():
        for name, up in ups.items():
            found[protocol, name] = by_frame(upscaled(run, up, states, factor), truth)
    if "hdnn" in ups:
        states = miniature(run, factor, 0, frames, **unscaled(factor))
        found["free", UNSCALED] = by_frame(upscaled(run, ups["hdnn"], states, factor), truth)
    return found


def score(
    table: str, scene: str, factor: int, frames: int, options: Mapping[str, float], extra: Path | None = None
) -> tuple[list[Row], list[Point]]:
    """Rows of one run of the preset, and its errors by frame."""
    run = teacher(scene, frames, options)
    found = curves(run, factor, extra)
    if table == "T7":
        found["free", "teacher nudged"] = nudged(run)
        found["free", "teacher, 30 iterations"] = teacher_again(run, iterations=30)
    rows: list[Row] = []
    points: list[Point] = []
    for (protocol, method), errors in found.items():
        for horizon in [h for h in HORIZONS if h <= frames] or [frames]:
            if protocol == "oracle" and horizon < frames:
                continue
            paper = _paper(table, scene, factor, method) if protocol == "free" and horizon == frames else NAN
            value = float(errors[:horizon].mean())
            rows.append(Row(table, scene, _text(options), factor, method, protocol, horizon, "error", value, paper))
        shown = [k for k in range(1, len(errors) + 1) if k <= 20 or k % 4 == 0]
        points += [Point(scene, protocol, method, k, float(errors[k - 1])) for k in shown]
    return rows, points


def _paper(table: str, scene: str, factor: int, method: str) -> float:
    if table == "T4" and scene == "Curtain" and method == "fc":
        return TABLE_4[factor]
    if table == "T7" and method in (UNSCALED, "fc"):
        return TABLE_7[scene][method == "fc"]
    return NAN


def windows(scene: str, factor: int, count: int, extra: Path | None = None) -> Iterator[Row]:
    """Held-out trajectories: oracle, and real inputs started again every ``WINDOW`` frames; seams of the networks."""
    sums: dict[tuple[str, str, int, str], list[float]] = {}
    for run in held_out(scene, count):
        truth, ups = run.positions, upscalers(run, factor, UPSCALERS, extra)
        firsts = range(0, len(truth) - WINDOW + 1, WINDOW)
        sources = {"oracle": [(0, decimated(run, factor))]}
        sources["windows"] = [(first, miniature(run, factor, first, WINDOW)) for first in firsts]
        for protocol, parts in sources.items():
            for name, up in ups.items():
                for first, states in parts:
                    fine = upscaled(run, up, states, factor, first)
                    errors = by_frame(fine, truth[first : first + len(fine)])
                    lengths = (1, 5, 10, WINDOW) if protocol == "windows" else (len(errors),)
                    for length in lengths:
                        value = float(errors[:length].mean())
                        sums.setdefault((name, protocol, length, "error"), []).append(value)
                    if hasattr(up, "seam"):
                        middle = states[: HISTORY + len(errors) // 2]
                        sums.setdefault((name, protocol, len(errors), "seam"), []).append(up.seam(middle[-HISTORY:]))
    for (name, protocol, frames, measure), values in sums.items():
        mean = float(np.mean(values))
        yield Row("held out", scene, "", factor, name, protocol, frames, measure, mean, NAN)


def readings(options: Mapping[str, float], frames: int) -> Iterator[Row]:
    """Another flag: what ``published_readings.measured`` says of it."""
    for (method, measure), value in measured(options, frames).items():
        yield Row("readings", "Flag", _text(options), 2, method, "free", frames, measure, value, NAN)


def speeds(scene: str, frames: int) -> Iterator[Row]:
    """Table 8: processor time of a frame, one thread."""
    ms = milliseconds(teacher(scene, frames), 2, UPSCALERS)
    teacher_ms, hdnn_ms, fc_ms = TABLE_8[scene]
    paper = {"teacher": teacher_ms, "hdnn": hdnn_ms, "fc": fc_ms}
    for name, value in ms.items():
        known = paper.get(name, NAN)
        yield Row("T8", scene, "", 2, name, "free", frames, "ms", value, known)
        yield Row("T8", scene, "", 2, name, "free", frames, "speed-up", ms["teacher"] / value, teacher_ms / known)


def pairs(folders: Sequence[Path]) -> Iterator[Row]:
    """Tables 3 and 5 from the cards of trained networks, with bilinear interpolation on the same pairs."""
    cards: dict[Recipe, Any] = {}
    for folder in folders:
        for path in sorted(folder.glob("fc_*.json")):
            card = json.loads(path.read_text())
            about = {name: value for name, value in card["recipe"].items() if name != "name"}
            cards.setdefault(Recipe(**about), card["errors"])
    for features, paper in TABLE_3.items():
        errors = cards.get(Recipe("Flag", features=features), {})
        for split, found in ((s, errors[s]) for s in ("learnt from", "held out") if errors):
            known = paper[split == "held out"]
            yield Row("T3", "Flag", features, 2, "fc", split, 1, "mse", found["mse"], known)
    for at, scene in enumerate(SCENES):
        wanted = [(f"{u}*FC-{v}", Recipe(scene, layers=u, width=v), known[at]) for (u, v), known in TABLE_5.items()]
        wanted += [("4*FC-64, random start", Recipe(scene, start="random"), NAN)]
        for name, recipe, number in wanted:
            if recipe in cards:
                value = cards[recipe]["held out"]["mse"]
                yield Row("T5", scene, name, 2, "fc", "held out", 1, "mse", value, number)
        if Recipe(scene) in cards:
            value = cards[Recipe(scene)]["held out"]["linear mse"]
            yield Row("T5", scene, "", 2, "bilinear", "held out", 1, "mse", value, NAN)


def measure(rows: Store[Row], points: Store[Point], *, frames: int, count: int, extra: Path | None = None) -> None:
    """Add what is missing to ``rows`` and, of table 7's runs, to ``points``; tables 3 and 5 are read again."""
    rows.add(*pairs([WEIGHTS, *([extra] if extra else [])]))
    wanted: list[tuple[str, str, int, Mapping[str, float]]] = []
    for scene in SCENES:
        wanted += [("T7", scene, 2, {})] + [("T4", scene, factor, {}) for factor in FACTORS]
        wanted += [(figure, scene, 2, options) for figure, variants in VARIED.items() for options in variants]
    wanted += [("fig15", "Flag", 2, options) for options in TURNED]
    for table, scene, factor, options in tqdm(wanted, desc="tables with networks", disable=None):
        if not _known(rows, table, scene, _text(options), factor):
            new, by_frames = score(table, scene, factor, frames, options, extra if table in ("T7", "fig15") else None)
            rows.add(*new)
            if table == "T7":
                points.add(*by_frames)
    for options in READINGS:
        if not _known(rows, "readings", "Flag", _text(options), 2):
            rows.add(*readings(options, frames))
    for scene in SCENES:
        if not _known(rows, "held out", scene, "", 2):
            rows.add(*windows(scene, 2, count, extra))
        if not _known(rows, "T8", scene, "", 2):
            rows.add(*speeds(scene, frames))


def _known(rows: Store[Row], *key: Any) -> bool:
    return any((r.table, r.scene, r.options, r.factor) == key for r in rows.rows)


def _text(options: Mapping[str, float]) -> str:
    return " ".join(f"{name}={value:g}" for name, value in options.items())


def text(rows: Sequence[Row]) -> str:
    """The tables for people: a line for each method, its numbers by protocol and frames."""
    lines, last = [], ""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    order = list(dict.fromkeys(r.table for r in rows))
    for r in sorted(rows, key=lambda r: order.index(r.table)):
        groups.setdefault((r.table, r.scene, r.options, r.factor, r.method), []).append(r)
    for (table, scene, options, factor, method), found in groups.items():
        if table != last:
            lines.append(f"\n{table}: errors in m, mse in m^2 (paper in brackets)")
            last = table
        numbers = [
            f"{r.protocol} {r.frames}: {r.value:.3g} {'' if r.measure == 'error' else r.measure}".rstrip()
            + (f" ({r.paper:.4g})" if np.isfinite(r.paper) else "")
            for r in found
        ]
        lines.append(f"{f'{scene} s={factor} {options} {method}':44s} " + ", ".join(numbers))
    return "\n".join(lines)
