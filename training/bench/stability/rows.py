"""Rows of the stability benchmark: one for each run, put together by backend, axis and level."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from training.bench.stability.scores import REASONS, SOFT, Score
from training.bench.stability.worlds import AXES


@dataclass(frozen=True)
class Place:
    """Which run: ``level`` along ``axis`` (its number in the list of actions), grid, backend and its options."""

    axis: str
    level: float
    scene: str
    backend: str
    options: str
    rows: int
    cols: int
    frame_dt: float
    seed: int


@dataclass(frozen=True)
class StabilityRow(Score, Place):
    """A run and its score."""


# The grid that was asked for is that of the level, so the rows' grid is no part of it.
KEY = ("axis", "level", "scene", "backend", "options", "seed")


@dataclass(frozen=True)
class Mark:
    """Of all scenes and seeds at one level: how many ``passed`` and ``survived`` of ``runs``.

    What is merely wrong (``SOFT``) survived. ``reason`` is the commonest of those that did not survive, or else of
    those that did not pass; ``reasons``
    counts them all, ``failed_at`` is their median time to failure [s]. In ``untold`` runs the truth itself failed:
    from then on there was nothing to compare with.
    """

    passed: int
    survived: int
    runs: int
    reason: str
    reasons: str
    failed_at: float
    untold: int

    @property
    def score(self) -> float:
        """1 where all passed, 0 where none survived; a run that is merely wrong counts half."""
        return (self.passed + self.survived) / (2 * self.runs)


def marks(rows: Sequence[StabilityRow]) -> dict[tuple[str, str, float], Mark]:
    """(axis, backend, level) -> Mark; ties go to the graver reason."""
    groups: dict[tuple[str, str, float], list[StabilityRow]] = {}
    for row in rows:
        groups.setdefault((row.axis, row.backend, row.level), []).append(row)
    order = list(REASONS)
    out = {}
    for key, mine in groups.items():
        failed = [r for r in mine if r.reason]
        counts = Counter(sorted((r.reason for r in failed), key=order.index)).most_common()
        out[key] = Mark(
            len(mine) - len(failed),
            len(mine) - sum(r.reason not in SOFT for r in failed),
            len(mine),
            next((name for name, _ in counts if name not in SOFT), counts[0][0] if counts else ""),
            ", ".join(f"{name} {n}" for name, n in counts),
            float(np.median([r.failed_at for r in failed])) if failed else float("nan"),
            sum(bool(r.truth) for r in mine),
        )
    return out


def table(rows: Sequence[StabilityRow]) -> str:
    """Runs that passed / survived / all, and the reasons of those that did not pass."""
    found, lines = marks(rows), []
    backends = list(dict.fromkeys(r.backend for r in rows))
    for name, axis in AXES.items():
        mine = [r for r in rows if r.axis == name]
        if not mine:
            continue
        levels = [level for level in axis.levels if any(r.level == float(level) for r in mine)]
        scenes = ", ".join(dict.fromkeys(r.scene for r in mine))
        lines.append(f"\n{axis.title} ({scenes})")
        lines.append(f"{'':24s}" + "".join(f"{axis.label(level):>12s}" for level in levels))
        for backend in backends:
            some = [found.get((name, backend, float(level))) for level in levels]
            lines.append(
                f"{backend:24s}" + "".join(f"{f'{m.passed}/{m.survived}/{m.runs}' if m else '':>12s}" for m in some)
            )
            lines += [
                f"{'':24s}  {axis.label(level)}: {m.reasons}, after {m.failed_at:.2g} s"
                + (f" (the truth fails in {m.untold})" if m.untold else "")
                for level, m in zip(levels, some, strict=True)
                if m and m.reasons
            ]
    return "\n".join(lines)
