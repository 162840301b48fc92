"""Rows of the peers benchmark: who is faster at equal error, the table, and the chart."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.style import COLORS, INK, MARKERS, limits
from training.bench.charts import SHADE, dress, grid, legend, save
from training.bench.peers.scenes import TITLES

STEM = "peers"
OWN = "MiniCloth"
TOLERANCE = 0.05  # of the truth's way, by which the mean height may lag or lead
EQUAL = 1.05  # errors within 5 % count as equal: single precision rounds differently in each engine


@dataclass(frozen=True)
class PeerRow:
    """One engine with one setting on one scene; ``instruction_set`` is that of our kernels.

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
    instruction_set: str
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


PEER_KEY = ("scene", "engine", "settings", "instruction_set")
BLUE, RED, GREEN, PINK, ORANGE, SKY = COLORS
STYLES = {
    "MiniCloth explicit": (BLUE, MARKERS[0]),
    "MiniCloth admm": (SKY, MARKERS[1]),
    "MiniCloth implicit": (GREEN, MARKERS[2]),
    "Taichi explicit": (RED, MARKERS[3]),
    "Taichi xpbd": (ORANGE, MARKERS[4]),
    "MuJoCo elastic": (PINK, MARKERS[5]),
    "MuJoCo membrane": (INK, MARKERS[0]),
    "MuJoCo membrane, no friction": (INK, MARKERS[1]),
    "MuJoCo edges": ("#7a858e", MARKERS[2]),
}
NOTE = (
    "Errors against the nearer of our truth and the engine's own model at a fine step. Hollow: in 0.5 s the mean "
    "height lags or leads by over 5 % of its way, or the run failed later. Grey: below the chaos floor."
)


def label(row: PeerRow) -> str:
    """``MuJoCo elastic substeps=2`` or ``MiniCloth explicit refine=1, avx2``."""
    options = json.loads(row.settings)
    name = options.pop("solver" if row.engine == OWN else "method", "")
    given = [f"{key}={value}" for key, value in options.items()]
    text = " ".join(filter(None, [row.engine, name, *given]))
    return f"{text}, {row.instruction_set}" if row.instruction_set else text


def levels_of(rows: Sequence[PeerRow]) -> list[str]:
    """The instruction sets that ours were measured with."""
    return list(dict.fromkeys(r.instruction_set for r in rows if r.engine == OWN))


def rivals(rows: Sequence[PeerRow], scene: str, level: str) -> list[tuple[PeerRow, PeerRow | None]]:
    """Every passing setting of a peer on ``scene``, and the fastest of ours that passes at no larger error."""
    mine = [r for r in rows if (r.scene, r.engine, r.instruction_set) == (scene, OWN, level) and r.passed]
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
        for level in levels_of(some):
            lines += compared(rivals(rows, scene, level))
    return "\n".join(lines)


def compared(pairs: Sequence[tuple[PeerRow, PeerRow | None]]) -> list[str]:
    """A line an engine that ours are compared with, and one a setting that none of ours is as near as."""
    lines = []
    for engine in dict.fromkeys(peer.engine for peer, _ in pairs):
        found = [(p, m) for p, m in pairs if p.engine == engine]
        won = [(p.ms / m.ms, p, m) for p, m in found if m]
        if won:
            ratio, peer, ours = min(won, key=lambda w: w[0])
            lines.append(f"at least {ratio:.1f} x faster than {label(peer)} (closest: {label(ours)})")
        lines += [f"none of ours is as near as {label(p)}" for p, m in found if m is None]
    return lines


def family(row: PeerRow) -> str:
    """The curve that a row belongs to."""
    options = json.loads(row.settings)
    name = " ".join(filter(None, [row.engine, options.get("method", options.get("solver"))]))
    return name + ", no friction" if options.get("passive") else name


def panel(axes: Any, rows: Sequence[PeerRow]) -> dict[str, Any]:
    """One scene; returns the legend's entries."""
    shown = [r for r in rows if np.isfinite(r.error) and r.error > 0]
    bottom, top = limits(min(r.error for r in shown), max(r.error for r in shown), 0.08)
    left, right = limits(min(r.ms for r in shown), max(r.ms for r in shown), 0.08)
    axes.set(xscale="log", yscale="log", xlim=(left, right), ylim=(bottom, top))
    if rows[0].floor_early_mm > bottom:
        axes.axhspan(bottom, rows[0].floor_early_mm, color=SHADE, alpha=0.4, lw=0, zorder=1)
    handles = {}
    for name in dict.fromkeys((*STYLES, *map(family, shown))):
        some = sorted((r for r in shown if family(r) == name), key=lambda r: r.ms)
        if some:
            color, marker = STYLES.get(name, (INK, "X"))
            look: dict[str, Any] = {"color": color, "marker": marker, "ms": 5.5, "mew": 0.9}
            (handles[name],) = axes.plot([r.ms for r in some], [r.error for r in some], lw=1.2, mec="white", **look)
            bad = [r for r in some if not r.passed]
            axes.plot([r.ms for r in bad], [r.error for r in bad], ls="", mfc="white", **look)
    dress(axes, TITLES[rows[0].scene])
    return handles


def draw(rows: Mapping[str, Sequence[Any]], folder: Path, setup: str) -> None:
    """Error against time a frame, a panel a scene; ours with the widest instructions."""
    all_rows: Sequence[PeerRow] = rows.get(STEM, ())
    widest = levels_of(all_rows)[-1:]
    shown = [r for r in all_rows if r.engine != OWN or r.instruction_set in widest]
    scenes = list(dict.fromkeys(r.scene for r in shown))
    if not scenes:
        return
    figure, panels = grid(len(scenes), "mean vertex error after 0.2 s [mm]")
    handles: dict[str, Any] = {}
    for axes, scene in zip(panels, scenes, strict=False):
        handles |= panel(axes, [r for r in shown if r.scene == scene])
    place = (panels[-1], "center left", 1) if len(panels) > len(scenes) else (figure, "outside upper center", 4)
    legend(place[0], handles, tuple(STYLES), *place[1:])
    figure.supxlabel("processor time for a frame, one thread [ms]", fontsize=8.5, color=INK)
    save(figure, f"{setup}. {NOTE}", folder, STEM)
