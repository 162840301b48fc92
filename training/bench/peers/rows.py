"""Rows of the peers benchmark: who is faster at equal error, and the table."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from training.bench.peers.scenes import TITLES

OWN = "MiniCloth"
TOLERANCE = 0.05  # of the truth's way, by which the mean height may lag or lead
EQUAL = 1.05  # errors within 5 % count as equal: single precision rounds differently in each engine


@dataclass(frozen=True)
class PeerRow:
    """One engine with one setting on one scene.

    ``ms``: processor time a frame, median over ``frames`` of one or more runs, with its quartiles; ``wall_ms`` the
    median wall clock. Errors [mm] are mean distances of the vertices after 0.2 and 0.5 s, against our truth and
    (``own_``) the engine's own; ``lag`` is the part of the truth's way that the mean height lags behind after 0.5 s;
    ``p99`` the 99th percentile of the strain there. NaN where not measured.
    """

    scene: str
    rows: int
    cols: int
    engine: str
    settings: str
    step_ms: float
    frames: int
    ms_q1: float
    ms: float
    ms_q3: float
    wall_ms: float
    early_mm: float
    late_mm: float
    own_early_mm: float
    own_late_mm: float
    lag: float
    own_lag: float
    p99: float
    p99_truth: float
    floor_early_mm: float
    floor_late_mm: float
    failure: str

    @property
    def error(self) -> float:
        """The smaller of the early errors."""
        return float(np.nanmin([self.early_mm, self.own_early_mm])) if np.isfinite(self.early_mm) else float("nan")

    @property
    def passed(self) -> bool:
        """No failure, and the mean height is right by one of the truths."""
        lags = [abs(x) for x in (self.lag, self.own_lag) if np.isfinite(x)]
        return not self.failure and bool(lags) and min(lags) <= TOLERANCE


PEER_KEY = ("scene", "engine", "settings")


def label(row: PeerRow) -> str:
    """``MuJoCo elastic substeps=2``."""
    options = json.loads(row.settings)
    name = options.pop("solver" if row.engine == OWN else "method", "")
    return " ".join(filter(None, [row.engine, name, *(f"{key}={value}" for key, value in options.items())]))


def rivals(rows: Sequence[PeerRow], scene: str) -> list[tuple[PeerRow, PeerRow | None]]:
    """Every passing setting of a peer on ``scene``, and the fastest of ours that passes at no larger error."""
    mine = [r for r in rows if r.scene == scene and r.engine == OWN and r.passed]
    out = []
    for peer in (r for r in rows if r.scene == scene and r.engine != OWN and r.passed):
        # Errors below the chaos floor say nothing: there both count as equal.
        better = [r for r in mine if r.error <= max(EQUAL * peer.error, r.floor_early_mm)]
        out.append((peer, min(better, key=lambda r: r.ms, default=None)))
    return out


def table(rows: Sequence[PeerRow]) -> str:
    """All rows, and what the comparisons come to."""
    lines = []
    for scene in dict.fromkeys(r.scene for r in rows):
        some = [r for r in rows if r.scene == scene]
        lines += [
            f"\n{TITLES[scene]}, {some[0].rows} x {some[0].cols}; nudged truth: {some[0].floor_early_mm:.2g}, "
            f"{some[0].floor_late_mm:.2g} mm; p99 strain of the truth {100 * some[0].p99_truth:.2f} %",
            f"{'':62s}{'ms/frame (quartiles)':>24s}{'wall':>7s}{'error mm':>9s}{'0.5 s':>7s}{'own':>7s}{'0.5 s':>7s}"
            f"{'lag %':>7s}{'own':>6s}{'p99 %':>7s}",
        ]
        for r in some:
            gate = "" if r.passed else r.failure or "SLOW"
            lines.append(
                f"{label(r):62s}{f'{r.ms:.3g} ({r.ms_q1:.3g}-{r.ms_q3:.3g})':>24s}{r.wall_ms:7.3g}{r.early_mm:9.3g}"
                f"{r.late_mm:7.3g}{r.own_early_mm:7.3g}{r.own_late_mm:7.3g}{100 * r.lag:7.1f}{100 * r.own_lag:6.1f}"
                f"{100 * r.p99:7.2f}  {gate}"
            )
        pairs = rivals(rows, scene)
        for engine in dict.fromkeys(peer.engine for peer, _ in pairs):
            found = [(p, m) for p, m in pairs if p.engine == engine]
            won = [(p.ms / m.ms, p, m) for p, m in found if m]
            if won:
                ratio, peer, ours = min(won, key=lambda w: w[0])
                lines.append(f"at least {ratio:.1f} x faster than {label(peer)} (closest: {label(ours)})")
            for peer, _ in ((p, m) for p, m in found if m is None):
                lines.append(f"none of ours is as near as {label(peer)}")
    return "\n".join(lines)
