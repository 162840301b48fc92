"""Rows of the stability benchmark: one for each run, put together by backend, axis and level."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from training.bench.stability.worlds import AXES
from training.truth import DETAILED

# What a row says -> the short word of the chart. A run that has several is told the first of this list.
REASONS = {
    "refused": "refused",
    "blow-up": "blow-up",
    "overstretch": "stretch",
    "energy": "energy",
    "tunnelling": "tunnel",
    "momentum": "momentum",
    "crossing": "cross",
    "slow motion": "slow",
    "fast motion": "fast",
    "error": "error",
    "strained": "strain",
    "energy drift": "drift",
}
SOFT = ("crossing", "slow motion", "fast motion", "error", "strained", "energy drift")  # it is wrong, but it stands
NOTE = (
    "Yellow: every run passed. Grey: all stand, but are wrong. Dark blue: none survived. Cells that lost runs tell the "
    "commonest reason (of those that did not survive, if there are any), and how many passed if some did. None "
    "survives blow-up (not finite), stretch (an edge at twice its length), energy (a jump, or twice the truth's "
    "kinetic energy and 1 J/kg), tunnel (a body went through the cloth), momentum (1 % from nowhere). Wrong are cross "
    "(folds pass through each other where the truth's don't, in scenes with self-contact), slow and fast (mean height "
    "behind or ahead by over 5 % of its way within 0.5 s), error (vertices 5 % of the length off "
    "after 0.2 s), strain (p99 over twice the truth's and 5 points), drift (0.25 m g H from nowhere). Truth: explicit "
    "at half its stable step, on the same grid; *: in some worlds of the cell it fails itself, and from then on there "
    "is nothing to compare with."
)


@dataclass(frozen=True)
class Score:
    """One run up to ``frames``. NaN where a figure is not defined.

    Attributes:
        reason, detail: one of ``REASONS`` and in words, or empty.
        failed_at: time to failure [s], the run's length if there was none.
        p99: largest over the frames of the 99th percentile of the structural edges' ``|strain|``.
        drift: what the energy budget of the first 10 frames leaves over, ``(gained + losses - work) / (m g H)``,
            where it is largest; in scenes without bodies and wind, whose work in a frame is not known well enough.
            Powers are summed by the trapezoidal rule over frames: compare with the truth's.
        kinetic: largest over the frames [J/kg].
        momentum: drift over the sum of m |v| at the start, with no force from outside.
        depth: deepest in a body [m]. tunnelled: vertices and triangles that a body went through.
        gate: mean height's largest difference from the truth's in 0.5 s over its way; chaos: so for the truth nudged
            by a millionth. error: mean distance of the vertices after 0.2 s over the length.
        truth: why the truth itself failed, or empty.
        crossings, crossings_truth: most pairs of the cloth's own triangles that cross in a frame.
    """

    frames: int
    reason: str
    detail: str
    failed_at: float
    ms: float
    p99: float
    p99_truth: float
    drift: float
    drift_truth: float
    kinetic: float
    kinetic_truth: float
    momentum: float
    depth: float
    tunnelled: int
    gate: float
    chaos: float
    error: float
    truth: str
    crossings: float = float("nan")
    crossings_truth: float = float("nan")


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


@dataclass(frozen=True)
class Mark:
    """Of all scenes and seeds at one level: how many ``passed`` and ``survived`` of ``runs``.

    What is merely wrong (``SOFT``) survived. ``reason`` is the commonest of those that did not survive, or else of
    those that did not pass; ``reasons`` counts them all, ``failed_at`` is their median time to failure [s]. In
    ``untold`` runs the truth itself failed: from then on there was nothing to compare with.
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
    """Runs that passed / survived / all, and the reasons of those that did not pass.

    Scenes with super-resolution, which have other methods, come after the others.
    """
    groups = ([r for r in rows if (r.scene in DETAILED) == detailed] for detailed in (False, True))
    return "\n".join(_lines(mine) for mine in groups if mine)


def _lines(rows: Sequence[StabilityRow]) -> str:
    found, lines = marks(rows), []
    backends = dict.fromkeys(r.backend for r in rows)
    for name, axis in AXES.items():
        levels = [level for level in axis.levels if any((name, b, float(level)) in found for b in backends)]
        if not levels:
            continue
        scenes = ", ".join(dict.fromkeys(r.scene for r in rows if r.axis == name))
        lines.append(f"\n{axis.title} ({scenes})")
        lines.append(f"{'':24s}" + "".join(f"{axis.label(level):>12s}" for level in levels))
        for backend in backends:
            some = [found.get((name, backend, float(level))) for level in levels]
            cells = (f"{m.passed}/{m.survived}/{m.runs}" if m else "" for m in some)
            lines.append(f"{backend:24s}" + "".join(f"{cell:>12s}" for cell in cells))
            lines += [
                f"{'':24s}  {axis.label(level)}: {m.reasons}, after {m.failed_at:.2g} s"
                + (f" (the truth fails in {m.untold})" if m.untold else "")
                for level, m in zip(levels, some, strict=True)
                if m and m.reasons
            ]
    return "\n".join(lines)
