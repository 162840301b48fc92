"""The chart of the peers benchmark: error against time a frame, one panel a scene; drawn from rows only."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.style import COLORS, INK, MARKERS, import_figure, limits, spread
from training.bench.charts import SHADE, dress, save
from training.bench.peers.rows import PeerRow
from training.bench.peers.scenes import TITLES

STEM = "peers"
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
WIDTH, HEIGHT = 10.5, 4.0  # inches


NOTE = (
    "Errors against the nearer of our truth and the engine's own model at a fine step. Hollow: in 0.5 s the mean "
    "height lags or leads by over 5 % of its way, or the run failed later. Grey: below the chaos floor."
)


def family(row: PeerRow) -> str:
    """The curve that a row belongs to."""
    options = json.loads(row.settings)
    name = " ".join(filter(None, [row.engine, options.get("method", options.get("solver"))]))
    return name + ", no friction" if options.get("passive") else name


def panel(axes: Any, rows: Sequence[PeerRow]) -> list[tuple[float, float, str, str]]:
    """One scene; returns the slow ends of its curves, their names and colours."""
    shown = [r for r in rows if np.isfinite(r.error) and r.error > 0]
    axes.set_xscale("log")
    axes.set_yscale("log")
    low, high = limits(min(r.ms for r in shown), max(r.ms for r in shown), 0.1)
    axes.set_xlim(low, high * (high / low) ** 0.62)  # room for the names
    axes.set_xticks([t for t in 10.0 ** np.arange(-3, 6) if low <= t <= high])
    axes.set_xticks([], minor=True)
    bottom, top = limits(min(r.error for r in shown), max(r.error for r in shown), 0.08)
    axes.set_ylim(bottom, top)
    if rows[0].floor_early_mm > bottom:
        axes.axhspan(bottom, rows[0].floor_early_mm, color=SHADE, alpha=0.4, lw=0, zorder=1)
    ends = []
    for name in dict.fromkeys((*STYLES, *map(family, shown))):
        some = sorted((r for r in shown if family(r) == name), key=lambda r: r.ms)
        if some:
            color, marker = STYLES.get(name, (INK, "X"))
            axes.plot([r.ms for r in some], [r.error for r in some], color=color, lw=1.2, alpha=0.7, zorder=2)
            for r in some:
                fill, edge = (color, "white") if r.passed else ("white", color)
                axes.plot(r.ms, r.error, marker, ms=6, mfc=fill, mec=edge, mew=0.9, zorder=3)
            ends.append((some[-1].ms, some[-1].error, name, color))
    return ends


def draw(rows: Mapping[str, Sequence[PeerRow]], folder: Path, setup: str) -> None:
    """A panel a scene, side by side."""
    scenes = list(dict.fromkeys(r.scene for r in rows.get(STEM, ())))
    if not scenes:
        return
    figure = import_figure()(figsize=(WIDTH, HEIGHT), layout="constrained")
    panels = figure.subplots(1, len(scenes), squeeze=False)[0]
    ends = [
        panel(axes, [r for r in rows[STEM] if r.scene == scene]) for axes, scene in zip(panels, scenes, strict=True)
    ]
    for axes, scene in zip(panels, scenes, strict=True):
        dress(axes, TITLES[scene])
    panels[0].set_ylabel("mean vertex error after 0.2 s [mm]", fontsize=9, color=INK)
    figure.supxlabel(
        "processor time for a frame, one thread [ms] (left is faster, down is closer)", fontsize=9, color=INK
    )
    figure.draw_without_rendering()
    for axes, names in zip(panels, ends, strict=True):
        _label(axes, names)
    save(figure, f"{setup}. {NOTE}", folder, STEM, size=7.5)


def _label(axes: Any, ends: Sequence[tuple[float, float, str, str]]) -> None:
    """The curves' names in a column at the right, each led to its curve's slow end."""
    pixels = axes.transData.transform([end[:2] for end in ends])
    dpi = axes.figure.dpi / 72
    column = pixels[:, 0].max() + 12 * dpi
    for (x, y, name, color), at in zip(ends, spread(pixels[:, 1], 10.5 * dpi), strict=True):
        place = axes.transData.inverted().transform((column, at))
        axes.annotate(
            name,
            (x, y),
            place,
            va="center",
            fontsize=7.5,
            color=color,
            zorder=4,
            arrowprops={"arrowstyle": "-", "color": color, "lw": 0.6, "alpha": 0.6, "shrinkA": 1, "shrinkB": 5},
        )
