"""The tables and figures of Lee 2019 that need networks, ours beside the paper's.

Errors are mean distances of the vertices from the teacher's (P-ADMM, 10 iterations), in metres. Four protocols:

- *pairs*: eq. 4 on pairs of patches of held-out trajectories, as the paper's tables 3 and 5 have it, in m^2.
- *oracle*: the teacher's own positions, down-sampled and upscaled again, over ``frames`` frames.
- *free*: a miniature that starts with the teacher and runs by itself for ``frames`` frames; table 7.
- *windows*: held-out trajectories, the miniature started from the teacher's state again every 20 frames.

Rows "readings" are flags that differ in what the paper leaves open (``readings``).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from surrogates.checkpoint import WEIGHTS
from training.bench.papers import runs
from training.bench.papers.readings import READINGS, measured
from training.bench.papers.rows import FrameErrorRow, PublishedRow
from training.bench.participants import Participant
from training.rollouts import Recording
from training.rows import Store
from training.upscaler.recipes import FACTORS, SCENES, Recipe

HORIZONS = (10, 14, 25, 100)  # frames of free runs
WINDOW, HELD_OUT = 20, 12
NAN = float("nan")
TABLE_3 = {"positions": (9.094e-5, 2.85e-4), "velocities": (8.876e-5, 2.778e-4), "frames": (8.856e-5, 2.691e-4)}
# The paper's error and ms of a frame on its authors' machine; its own method is the miniature with a network.
TABLE_4 = {2: (1.816e-3, 37.5), 3: (2.916e-3, 19.1), 4: (3.901e-3, 16.2)}
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


def curves(run: Recording, factor: int, folder: Path | None = None) -> dict[tuple[str, str], np.ndarray]:
    """Errors by frame of every protocol and method, of one run from its start."""
    frames, truth = len(run.controls), runs.cloths(run)
    found: dict[tuple[str, str], np.ndarray] = {}
    sources = {"oracle": runs.decimated(run, factor), "free": runs.miniature(run, factor, 0, frames)}
    ups = runs.upscalers(run, factor, runs.UPSCALERS, folder)
    for protocol, states in sources.items():
        for name, up in ups.items():
            found[protocol, name] = runs.by_frame(runs.upscaled(run, up, states, factor), truth)
    if "hdnn" in ups:
        states = runs.miniature(run, factor, 0, frames, **runs.unscaled(factor))
        found["free", runs.UNSCALED] = runs.by_frame(runs.upscaled(run, ups["hdnn"], states, factor), truth)
    return found


def score(
    table: str, scene: str, factor: int, frames: int, options: Mapping[str, float], folder: Path | None = None
) -> tuple[list[PublishedRow], list[FrameErrorRow]]:
    """Rows of one run of the preset, and its errors by frame."""
    run = runs.teacher(scene, frames, options)
    found = curves(run, factor, folder)
    if table == "T7":
        found["free", "teacher nudged"] = runs.nudged(run)
        found["free", "teacher, 30 iterations"] = runs.teacher_again(run, iterations=30)
    return rows_of(table, scene, options, factor, found)


def rows_of(
    table: str, scene: str, options: Mapping[str, float], factor: int, curves: Mapping[tuple[str, str], np.ndarray]
) -> tuple[list[PublishedRow], list[FrameErrorRow]]:
    """Means of ``curves`` over some horizons (of the oracle over all frames), and their points for the chart."""
    rows: list[PublishedRow] = []
    points: list[FrameErrorRow] = []
    for (protocol, method), errors in curves.items():
        frames = len(errors)
        for horizon in [h for h in HORIZONS if h <= frames] or [frames]:
            if protocol == "oracle" and horizon < frames:
                continue
            paper = _paper(table, scene, factor, method) if protocol == "free" and horizon == frames else NAN
            value = float(errors[:horizon].mean())
            own = table, scene, _text(options), factor, method, protocol, horizon
            rows.append(PublishedRow(*own, "error", value, paper))
        shown = [k for k in range(1, frames + 1) if k <= 20 or k % 4 == 0]
        points += [FrameErrorRow(scene, protocol, method, k, float(errors[k - 1])) for k in shown]
    return rows, points


def _paper(table: str, scene: str, factor: int, method: str) -> float:
    if table == "T4" and scene == "Curtain" and method == "fc":
        return TABLE_4[factor][0]
    if table == "T7" and method in (runs.UNSCALED, "fc"):
        return TABLE_7[scene][method == "fc"]
    return NAN


def windows(scene: str, factor: int, count: int, folder: Path | None = None) -> Iterator[PublishedRow]:
    """Held-out trajectories: oracle, and real inputs started again every ``WINDOW`` frames; seams of the networks."""
    sums: dict[tuple[str, str, int, str], list[float]] = {}
    for run in runs.held_out(scene, count):
        truth, ups = runs.cloths(run), runs.upscalers(run, factor, runs.UPSCALERS, folder)
        firsts = range(0, len(truth) - WINDOW + 1, WINDOW)
        sources = {"oracle": [(0, runs.decimated(run, factor))]}
        sources["windows"] = [(first, runs.miniature(run, factor, first, WINDOW)) for first in firsts]
        for protocol, parts in sources.items():
            for name, up in ups.items():
                for first, states in parts:
                    fine = runs.upscaled(run, up, states, factor, first)
                    errors = runs.by_frame(fine, truth[first : first + len(fine)])
                    lengths = (1, 5, 10, WINDOW) if protocol == "windows" else (len(errors),)
                    for length in lengths:
                        value = float(errors[:length].mean())
                        sums.setdefault((name, protocol, length, "error"), []).append(value)
                    if hasattr(up, "seam"):
                        middle = states[: runs.HISTORY + len(errors) // 2]
                        sums.setdefault((name, protocol, len(errors), "seam"), []).append(
                            up.seam(middle[-runs.HISTORY :])
                        )
    for (name, protocol, frames, measure), values in sums.items():
        mean = float(np.mean(values))
        yield PublishedRow("held out", scene, "", factor, name, protocol, frames, measure, mean, NAN)


def speeds(scene: str, frames: int) -> Iterator[PublishedRow]:
    """Table 8: processor time of a frame, one thread."""
    ms = runs.milliseconds(runs.teacher(scene, frames), 2, runs.UPSCALERS)
    teacher_ms, hdnn_ms, fc_ms = TABLE_8[scene]
    paper = {"teacher": teacher_ms, "hdnn": hdnn_ms, "fc": fc_ms}
    for name, value in ms.items():
        known = paper.get(name, NAN)
        yield PublishedRow("T8", scene, "", 2, name, "free", frames, "ms", value, known)
        yield PublishedRow(
            "T8", scene, "", 2, name, "free", frames, "speed-up", ms["teacher"] / value, teacher_ms / known
        )


def pairs(folders: Sequence[Path]) -> Iterator[PublishedRow]:
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
            yield PublishedRow("T3", "Flag", features, 2, "fc", split, 1, "mse", found["mse"], known)
    for at, scene in enumerate(SCENES):
        wanted = [(f"{u}*FC-{v}", Recipe(scene, layers=u, width=v), known[at]) for (u, v), known in TABLE_5.items()]
        wanted += [("4*FC-64, random start", Recipe(scene, start="random"), NAN)]
        for name, recipe, number in wanted:
            if recipe in cards:
                value = cards[recipe]["held out"]["mse"]
                yield PublishedRow("T5", scene, name, 2, "fc", "held out", 1, "mse", value, number)
        if Recipe(scene) in cards:
            value = cards[Recipe(scene)]["held out"]["linear mse"]
            yield PublishedRow("T5", scene, "", 2, "bilinear", "held out", 1, "mse", value, NAN)


def fill(
    rows: Store[PublishedRow],
    points: Store[FrameErrorRow],
    scenes: Sequence[str] = SCENES,
    others: Sequence[Participant] = (),
    *,
    frames: int,
    count: int,
    folder: Path | None = None,
) -> None:
    """Add what is missing to ``rows`` and, of table 7's runs, to ``points``; tables 3 and 5 are read again.

    Args:
        rows, points: what there is.
        scenes: of the preset.
        others: backends that run freely beside table 7's.
        frames: of a run.
        count: of held-out trajectories.
        folder: of weights that are not shipped.
    """
    rows.add(*pairs([WEIGHTS, *([folder] if folder else [])]))
    wanted: list[tuple[str, str, int, Mapping[str, float]]] = []
    for scene in scenes:
        wanted += [("T7", scene, 2, {})] + [("T4", scene, factor, {}) for factor in FACTORS]
        wanted += [(figure, scene, 2, options) for figure, variants in VARIED.items() for options in variants]
    wanted += [("fig15", "Flag", 2, options) for options in TURNED if "Flag" in scenes]
    for table, scene, factor, options in tqdm(wanted, desc="tables with networks", disable=None):
        if not _known(rows, table, scene, _text(options), factor):
            new, by_frames = score(table, scene, factor, frames, options, folder if table in ("T7", "fig15") else None)
            rows.add(*new)
            if table == "T7":
                points.add(*by_frames)
    for options in READINGS if "Flag" in scenes else ():
        if not _known(rows, "readings", "Flag", _text(options), 2):
            rows.add(
                *(
                    PublishedRow("readings", "Flag", _text(options), 2, method, "free", frames, measure, value, NAN)
                    for (method, measure), value in measured(options, frames).items()
                )
            )
    for scene in scenes:
        if not _known(rows, "held out", scene, "", 2):
            rows.add(*windows(scene, 2, count, folder))
        if not _known(rows, "T8", scene, "", 2):
            rows.add(*speeds(scene, frames))
        for p in others:
            if not any((r.table, r.scene, r.method) == ("T7", scene, p.label) for r in rows.rows):
                run = runs.teacher(scene, frames)
                errors = runs.by_frame(runs.follow(run, p.build(run.scene))[0], runs.cloths(run))
                rows.add(*rows_of("T7", scene, {}, 2, {("free", p.label): errors})[0])


def _known(rows: Store[PublishedRow], *key: Any) -> bool:
    return any((r.table, r.scene, r.options, r.factor) == key for r in rows.rows)


def _text(options: Mapping[str, float]) -> str:
    return " ".join(f"{name}={value:g}" for name, value in options.items())
