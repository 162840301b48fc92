"""The tables and figures of Lee 2019 that need networks, ours beside the paper's.

Errors are mean distances of the vertices from the teacher's (P-ADMM, 10 iterations), in metres. "oracle" upscales the
teacher's own decimated positions, "free" a miniature that starts with the teacher and runs by itself, "windows" one
that starts again from the teacher's state every 20 frames. Tables 3 and 5 are eq. 4 on pairs of patches [m^2].
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.backend import Backend
from cloth_envs.files import read_json
from cloth_envs.progress import progress
from surrogates.checkpoint import WEIGHTS
from training.bench.papers import runs
from training.bench.papers.runs import READINGS, UNSCALED, UPSCALERS
from training.bench.participants import Participant
from training.generate import HISTORY, miniature
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
PAPER = {
    **{("T4", "Curtain", factor, "fc"): error for factor, (error, _) in TABLE_4.items()},
    **{("T7", scene, 2, UNSCALED): error for scene, (error, _) in TABLE_7.items()},
    **{("T7", scene, 2, "fc"): error for scene, (_, error) in TABLE_7.items()},
}


@dataclass(frozen=True)
class PublishedRow:
    """One number; ``options`` are the preset's that were changed, ``paper`` is what the paper has, or NaN."""

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


PUBLISHED_KEY = ("table", "scene", "options", "factor", "method", "protocol", "frames", "measure")


@dataclass(frozen=True)
class FrameErrorRow:
    """The error [m] in one frame, for the charts."""

    scene: str
    protocol: str
    method: str
    frame: int
    error: float


FRAME_KEY = ("scene", "protocol", "method", "frame")


def score(
    table: str, scene: str, factor: int, frames: int, options: Mapping[str, float], folder: Path | None = None
) -> tuple[list[PublishedRow], list[FrameErrorRow]]:
    """Rows of one run of the preset by every protocol and method, and its errors by frame."""
    run = runs.teacher(scene, frames, options)
    found: dict[tuple[str, str], np.ndarray] = {}
    ups = runs.upscalers(run, factor, UPSCALERS, folder)
    for protocol, states in (("oracle", runs.decimated(run, factor)), ("free", miniature(run, factor, 0, frames))):
        found |= {(protocol, name): runs.errors(run, up, states, factor) for name, up in ups.items()}
    if "hdnn" in ups:
        states = miniature(run, factor, 0, frames, **runs.unscaled(factor))
        found["free", UNSCALED] = runs.errors(run, ups["hdnn"], states, factor)
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
        for horizon in [h for h in HORIZONS if h == frames or (h < frames and protocol == "free")] or [frames]:
            whole = protocol == "free" and horizon == frames
            paper = PAPER.get((table, scene, factor, method), NAN) if whole else NAN
            own = table, scene, _text(options), factor, method, protocol, horizon
            rows.append(PublishedRow(*own, "error", float(errors[:horizon].mean()), paper))
        shown = [k for k in range(1, frames + 1) if k <= 20 or k % 4 == 0]
        points += [FrameErrorRow(scene, protocol, method, k, float(errors[k - 1])) for k in shown]
    return rows, points


def windows(scene: str, factor: int, count: int, folder: Path | None = None) -> Iterator[PublishedRow]:
    """Held-out trajectories: oracle, and real inputs started again every ``WINDOW`` frames; seams of the networks."""
    sums: dict[tuple[str, str, int, str], list[float]] = {}
    for run in runs.held_out(scene, count):
        parts = [("oracle", 0, runs.decimated(run, factor))]
        for first in range(0, len(run.controls) - WINDOW + 1, WINDOW):
            parts.append(("windows", first, miniature(run, factor, first, WINDOW)))
        ups = runs.upscalers(run, factor, UPSCALERS, folder)
        for (protocol, first, states), (name, up) in product(parts, ups.items()):
            errors = runs.errors(run, up, states, factor, first)
            for length in (1, 5, 10, WINDOW) if protocol == "windows" else (len(errors),):
                sums.setdefault((name, protocol, length, "error"), []).append(float(errors[:length].mean()))
            if hasattr(up, "seam"):
                middle = states[: HISTORY + len(errors) // 2]
                seam = up.seam(middle[-HISTORY:])
                sums.setdefault((name, protocol, len(errors), "seam"), []).append(seam)
    for (name, protocol, frames, measure), values in sums.items():
        mean = float(np.mean(values))
        yield PublishedRow("held out", scene, "", factor, name, protocol, frames, measure, mean, NAN)


def speeds(scene: str, frames: int) -> Iterator[PublishedRow]:
    """Table 8: processor time of a frame, one thread, the teacher's and that of miniatures; the best of five passes."""
    run = runs.teacher(scene, frames)
    backends: dict[str, Backend] = {"teacher": runs.solver(run.scene)}
    for up in UPSCALERS:
        with suppress(ValueError):  # no weights for this scene
            options = runs.unscaled(2) if up == "hdnn" else {}
            backends[up] = runs.shrunk(run.scene, 2, upscaler=up, **options)
    passes = [{name: 1e3 * float(np.median(runs.follow(run, b)[1])) for name, b in backends.items()} for _ in range(5)]
    ms = {name: min(found[name] for found in passes) for name in backends}
    paper = dict(zip(("teacher", "hdnn", "fc"), TABLE_8[scene], strict=True))
    for name, value in ms.items():
        own, known = ("T8", scene, "", 2, name, "free", frames), paper.get(name, NAN)
        yield PublishedRow(*own, "ms", value, known)
        yield PublishedRow(*own, "speed-up", ms["teacher"] / value, paper["teacher"] / known)


def pairs(folders: Sequence[Path]) -> Iterator[PublishedRow]:
    """Tables 3 and 5 from the cards of trained networks, with bilinear interpolation on the same pairs."""
    cards: dict[Recipe, Any] = {}
    for path in (path for folder in folders for path in sorted(folder.glob("fc_*.json"))):
        card = read_json(path, "recipe", "errors", remedy="restore it, or train the network anew")
        about = {name: value for name, value in card["recipe"].items() if name != "name"}
        cards.setdefault(Recipe(**about), card["errors"])
    for features, paper in TABLE_3.items():
        errors = cards.get(Recipe("Flag", features=features), {})
        for split, known in zip(("learnt from", "held out"), paper, strict=True) if errors else ():
            yield PublishedRow("T3", "Flag", features, 2, "fc", split, 1, "mse", errors[split]["mse"], known)
    for at, scene in enumerate(SCENES):
        wanted = [(f"{u}*FC-{v}", Recipe(scene, layers=u, width=v), known[at]) for (u, v), known in TABLE_5.items()]
        wanted += [("4*FC-64, random start", Recipe(scene, start="random"), NAN), ("", Recipe(scene), NAN)]
        for name, recipe, number in (w for w in wanted if w[1] in cards):
            method, kind = ("fc", "mse") if name else ("bilinear", "linear mse")
            value = cards[recipe]["held out"][kind]
            yield PublishedRow("T5", scene, name, 2, method, "held out", 1, "mse", value, number)


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

    Runs have ``frames`` frames; ``count`` trajectories are held out; ``others`` run freely beside table 7's;
    ``folder`` holds weights that are not shipped.
    """
    rows.add(*pairs([WEIGHTS, *([folder] if folder else [])]))
    wanted: list[tuple[str, str, int, Mapping[str, float]]] = []
    for scene in scenes:
        wanted += [("T7", scene, 2, {})] + [("T4", scene, factor, {}) for factor in FACTORS]
        wanted += [(figure, scene, 2, options) for figure, variants in VARIED.items() for options in variants]
    wanted += [("fig15", "Flag", 2, options) for options in TURNED if "Flag" in scenes]
    for table, scene, factor, options in progress(wanted, "tables with networks", unit="run"):
        if not _known(rows, table=table, scene=scene, options=_text(options), factor=factor):
            new, by_frames = score(table, scene, factor, frames, options, folder if table in ("T7", "fig15") else None)
            rows.add(*new)
            if table == "T7":
                points.add(*by_frames)
    for options in READINGS if "Flag" in scenes else ():
        own = "readings", "Flag", _text(options), 2
        if not _known(rows, table="readings", options=_text(options)):
            found = runs.measured(options, frames)
            rows.add(*(PublishedRow(*own, name, "free", frames, what, x, NAN) for (name, what), x in found.items()))
    for scene in scenes:
        if not _known(rows, table="held out", scene=scene):
            rows.add(*windows(scene, 2, count, folder))
        if not _known(rows, table="T8", scene=scene):
            rows.add(*speeds(scene, frames))
        for p in others:
            if not _known(rows, table="T7", scene=scene, method=p.label):
                run = runs.teacher(scene, frames)
                errors = runs.by_frame(runs.follow(run, p.build(run.scene))[0], runs.cloths(run))
                rows.add(*rows_of("T7", scene, {}, 2, {("free", p.label): errors})[0])


def _known(rows: Store[PublishedRow], **key: Any) -> bool:
    return any(all(getattr(r, name) == value for name, value in key.items()) for r in rows.rows)


def _text(options: Mapping[str, float]) -> str:
    return " ".join(f"{name}={value:g}" for name, value in options.items())


def table(rows: Sequence[PublishedRow]) -> str:
    """A line for each method, its numbers by protocol and frames."""
    lines, last = [], ""
    groups: dict[tuple[Any, ...], list[PublishedRow]] = {}
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
