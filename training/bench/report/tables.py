"""Tables of ``minicloth report`` that are shorter than those which the benchmarks print."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from training.bench.benchmark import Part
from training.bench.participants import FLOOR, ORACLE, label
from training.bench.report import page
from training.bench.speed_accuracy import rows as speed_accuracy
from training.bench.speed_accuracy import speedup
from training.bench.speed_accuracy.chart import OVERVIEW_FRAMES as FRAMES
from training.bench.speed_accuracy.rows import GATE, SpeedAccuracyRow, front
from training.bench.speed_accuracy.speedup import FITTED, SpeedUpRow
from training.bench.stability import rows as stability
from training.bench.stability.rows import StabilityRow, marks
from training.bench.stability.worlds import AXES


def shown(part: Part, rows: Sequence[Sequence[Any]]) -> str:
    """HTML of the rows of a part's files: a table of ``SHORTER``, or else what the benchmark prints."""
    return SHORTER[part.show](*rows) if part.show in SHORTER else page.text(part.show(*rows))


def scenes(rows: Sequence[SpeedAccuracyRow]) -> str:
    """A table a scene: who is how fast and how close after ``FRAMES`` frames, the fastest first."""
    out = []
    for scene in dict.fromkeys(r.scene for r in rows):
        mine = [r for r in rows if (r.scene, r.frames) == (scene, FRAMES) and r.family not in (ORACLE, FLOOR)]
        if not mine:
            continue
        mine.sort(key=lambda r: math.inf if math.isnan(r.ms_median) else r.ms_median)
        best = front(mine)
        full = next((r.ms_median for r in mine if (r.family, r.options) == ("explicit", "{}")), math.nan)
        cells = [
            (
                label(r.family, r.options) + " *" * (r in best),
                *(_short(x) for x in (r.ms_median, full / r.ms_median, r.error)),
                r.failure or (f"mean height off by {100 * r.gate:.0f} % of its way" if r.gate > GATE else ""),
            )
            for r in mine
        ]
        about = (
            f"{scene} after {FRAMES} frames; error in % of the cloth's length (chaos floor {_short(mine[0].floor)}), "
            "times over explicit at full resolution; *: nothing that passes is both faster and closer"
        )
        heads = ("method", "ms a frame", "x faster", "error %", "failure")
        out.append(page.fold(f"{scene}: {len(mine)} methods", page.table(about, heads, cells)))
    return "\n".join(out)


def learned(found: Sequence[SpeedUpRow]) -> str:
    """Speed-ups at equal error after ``FRAMES`` frames of methods that are no baseline themselves."""
    return page.pre(speedup.table([f for f in found if f.frames == FRAMES and f.family not in FITTED]))


def survived(rows: Sequence[StabilityRow]) -> str:
    """Which part of its runs a method survived, and passed, along each axis; rounded down."""
    found = marks(rows)
    axes = [axis for axis in AXES if any(key[0] == axis for key in found)]
    cells = []
    for backend in dict.fromkeys(key[1] for key in found):
        line = [backend]
        for axis in axes:
            some = [m for key, m in found.items() if key[:2] == (axis, backend)]
            runs = sum(m.runs for m in some)
            parts = (100 * sum(part) // runs for part in zip(*((m.survived, m.passed) for m in some), strict=True))
            line.append("{} ({})".format(*parts) if runs else "")
        cells.append(line)
    about = (
        "Runs [%] of all levels, scenes and seeds of an axis that survived, in brackets those that passed; a run that "
        "is only wrong survived"
    )
    return page.table(about, ["method", *axes], cells)


def _short(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "-"


# What a benchmark prints -> a shorter form of it.
SHORTER: Mapping[Callable[..., str], Callable[..., str]] = {
    speed_accuracy.table: scenes,
    speedup.table: learned,
    stability.table: lambda rows: survived(rows) + page.text(stability.table(rows)),
}
