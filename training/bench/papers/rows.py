"""Rows of what is set beside the papers' own figures, and their tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class TableRow:
    """Tables 4, 6 and 8 of Lee 2019 without networks: one miniature on one scene.

    Errors in metres; ``ms`` are medians of a frame, upscaling included.
    """

    table: int
    scene: str
    factor: int
    scaling: str
    upscaler: str
    frames: int
    oracle_error: float
    real_error: float
    ms: float
    teacher_ms: float
    paper_error: float
    paper_ms: float
    paper_teacher_ms: float


@dataclass(frozen=True)
class PublishedRow:
    """One number of the tables with networks.

    ``options`` are the preset's that were changed, ``paper`` is what the paper has, or NaN.
    """

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


@dataclass(frozen=True)
class CellRow:
    """One run of an animation of Zhao 2024; errors in % of a metre."""

    scene: str
    run: str
    dtype: str
    steps: int
    until_quarter_second: float
    until_half_second: float
    whole: float
    mean_at_end: float
    paper: float


CELL_KEY = ("scene", "run", "steps")


@dataclass(frozen=True)
class CellSpeedRow:
    """Steps per second of 128 x 128 particles, and over the simulator's."""

    engine: str
    dtype: str
    median: float
    best: float
    over_simulator: float
    paper: float


@dataclass(frozen=True)
class CellCheckRow:
    """A number that a claim rests on."""

    name: str
    scene: str
    value: float


@dataclass(frozen=True)
class GrowthRow:
    """The least growth of the worst mode in one step ``ratio`` times the explicit one by ``cells`` cells."""

    ratio: float
    cells: int
    growth: float


@dataclass(frozen=True)
class LargeStepRow:
    """A method on a scene: medians over seeds of errors [%] and of the time of a frame [ms]."""

    scene: str
    method: str
    ms: float
    error_1: float
    error_5: float
    error_10: float


def table_text(rows: Sequence[TableRow]) -> str:
    """A line for each miniature."""
    lines = []
    for table in (4, 6, 8):
        lines += [f"\nTable {table}: error [m] and ms a frame; speed-up over P-ADMM at full resolution"]
        lines += [f"{'':34s}{'oracle':>9s}{'real':>9s}{'paper':>9s}{'ms':>8s}{'paper':>7s}{'x':>6s}{'paper':>7s}"]
        for r in (row for row in rows if row.table == table):
            name = f"{r.scene} s={r.factor} {r.scaling} {r.upscaler}"
            lines.append(
                f"{name:34s}{r.oracle_error:9.1e}{r.real_error:9.1e}{r.paper_error:9.1e}{r.ms:8.3f}{r.paper_ms:7.1f}"
                f"{r.teacher_ms / r.ms:6.1f}{r.paper_teacher_ms / r.paper_ms:7.1f}"
            )
    return "\n".join(lines)


def published_text(rows: Sequence[PublishedRow]) -> str:
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


def cell_text(rows: Sequence[CellRow], speeds: Sequence[CellSpeedRow], checks: Sequence[CellCheckRow]) -> str:
    """Errors, speeds and checks of the physics-embedded CNN."""
    lines = [f"{'max |dx|, % of 1 m':42s}{'0.25 s':>10s}{'0.5 s':>10s}{'whole':>10s}{'mean':>10s}{'paper':>8s}"]
    for r in rows:
        numbers = (r.until_quarter_second, r.until_half_second, r.whole, r.mean_at_end)
        lines.append(f"{r.scene:5s} {r.run:36s}" + "".join(f"{n:10.2e}" for n in numbers) + f"{r.paper:8.3f}")
    lines.append(f"\n{'steps/s':24s}{'median':>9s}{'best':>9s}{'x simulator':>13s}{'paper':>8s}")
    lines += [
        f"{s.engine:16s}{s.dtype:8s}{s.median:9.0f}{s.best:9.0f}{s.over_simulator:13.2f}{s.paper:8.0f}" for s in speeds
    ]
    return "\n".join([*lines, "", *(f"{c.name}, {c.scene}: {c.value:.3g}" for c in checks)])


def large_step_text(rows: Sequence[LargeStepRow], bound: Sequence[GrowthRow]) -> str:
    """The bound, and what softening costs."""
    cells, ratios = (list(dict.fromkeys(getattr(g, name) for g in bound)) for name in ("cells", "ratio"))
    lines = ["least growth of the worst mode a step", f"{'R':>4s}" + "".join(f"{f'K={k}':>9s}" for k in cells)]
    lines += [f"{x:4g}" + "".join(f"{g.growth:9.3g}" for g in bound if g.ratio == x) for x in ratios]
    lines.append(f"\n{'':40s}{'ms':>8s}" + "".join(f"{f'{k} frames':>10s}" for k in (1, 5, 10)))
    for r in rows:
        lines.append(f"{r.scene:8s} {r.method:31s}{r.ms:8.2f}{r.error_1:10.4f}{r.error_5:10.4f}{r.error_10:10.4f}")
    return "\n".join(lines)
