"""The chart of ``minicloth bench peers``: error against time a frame, one panel a scene; drawn from rows only."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.style import COLORS, GRID, INK, MARKERS, import_figure, limits, spread
from training.bench.peers.scenes import TITLES

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


def family(engine: str, settings: str) -> str:
    """The curve that a row belongs to."""
    options = json.loads(settings)
    name = f"{engine} {options.get('method', options.get('solver'))}"
    return name + ", no friction" if options.get("passive") else name


def draw(rows: Sequence[Any], paths: Sequence[Path], *, note: str) -> None:
    """Write the chart of ``rows`` (``peers.Row``) to each of ``paths``."""
    scenes = list(dict.fromkeys(r.scene for r in rows))
    figure = import_figure()(figsize=(WIDTH, HEIGHT), layout="constrained")
    panels = figure.subplots(1, len(scenes), squeeze=False)[0]
    shown = [r for r in rows if np.isfinite(r.error) and r.error > 0]
    for axes, scene in zip(panels, scenes, strict=True):
        mine = [r for r in shown if r.scene == scene]
        axes.set_xscale("log")
        axes.set_yscale("log")
        low, high = limits(min(r.ms for r in mine), max(r.ms for r in mine), 0.1)
        axes.set_xlim(low, high * (high / low) ** 0.62)  # room for the names
        axes.set_xticks([t for t in 10.0 ** np.arange(-3, 6) if low <= t <= high])
        axes.set_xticks([], minor=True)
        axes.set_ylim(limits(min(r.error for r in mine), max(r.error for r in mine), 0.08))
        floor = next(r.floor_early_mm for r in rows if r.scene == scene)
        if floor > axes.get_ylim()[0]:
            axes.axhspan(axes.get_ylim()[0], floor, color="#9aa5ae", alpha=0.3, lw=0, zorder=1)
        ends = []
        for name, (color, marker) in STYLES.items():
            some = sorted((r for r in mine if family(r.engine, r.settings) == name), key=lambda r: r.ms)
            if not some:
                continue
            x, y = [r.ms for r in some], [r.error for r in some]
            axes.plot(x, y, color=color, lw=1.2, alpha=0.7, zorder=2)
            for r in some:
                fill = color if r.passed else "white"
                axes.plot(r.ms, r.error, marker, ms=6, mfc=fill, mec="white" if r.passed else color, mew=0.9, zorder=3)
            ends.append((x[-1], y[-1], name, color))
        axes.set_title(TITLES[scene], loc="left", fontsize=10, fontweight="bold", color=INK)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(lambda value, _: f"{value:g}")
            axis.set_minor_formatter(lambda value, _: "")
        axes.grid(True, which="major", color=GRID, lw=0.7)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(colors=INK, which="both", labelsize=8)
        axes.ends = ends
    panels[0].set_ylabel("mean vertex error after 0.2 s [mm]", fontsize=9, color=INK)
    figure.supxlabel(
        "processor time for a frame, one thread [ms] (left is faster, down is closer)", fontsize=9, color=INK
    )
    text = (
        f"{note}.\nErrors against the nearer of our truth and the engine's own model at a fine step. Hollow: in 0.5 s "
        "the mean height lags or leads by over 5 % of its way, or the run failed later. Grey: below the chaos floor."
    )
    figure.text(0.0, -0.01, text, fontsize=7.5, color=INK, va="top", ha="left")
    figure.draw_without_rendering()
    for axes in panels:
        _label(axes)
    for path in paths:
        figure.savefig(path, dpi=200, bbox_inches="tight", pad_inches=0.12, facecolor="white")


def _label(axes: Any) -> None:
    """The curves' names in a column at the right, each led to its curve's slow end."""
    pixels = axes.transData.transform([end[:2] for end in axes.ends])
    dpi = axes.figure.dpi / 72
    column = pixels[:, 0].max() + 12 * dpi
    for (x, y, name, color), at in zip(axes.ends, spread(pixels[:, 1], 10.5 * dpi), strict=True):
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
