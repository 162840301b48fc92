"""The chart of tracked cloths: how closely they follow, and by how much shared vertices stand out."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.style import COLORS, INK, MARKERS
from training.bench.charts import SHADE, dress, grid, legend, save
from training.bench.synchronised.rows import FREE, TRACKED, TrackingRow

STEM = "synchronised"
CHARTS = {STEM: "How closely fine cloths follow coarse ones, and the spikes that this costs"}
NAMES = {"mean": "local means", "seed": "springs and a coarse sheet (Chen et al. 2020)", "springs": "springs alone"}
NOTE = (
    "Error: mean distance of the vertices that both cloths share. Spikes: how far these lie from the mean of their "
    "neighbours over how far other vertices do (root mean squares); the grey line is a free cloth's. Small: test "
    "sequences, large: their means. "
)


def panel(axes: Any, rows: Sequence[TrackingRow]) -> dict[str, Any]:
    """One scene; returns the handles of the legend."""
    handles = {}
    axes.axhline(float(np.mean([r.spikes for r in rows if r.tracking == FREE])), color=SHADE, lw=2)
    for (tracking, name), color, marker in zip(NAMES.items(), COLORS, MARKERS, strict=False):
        found = np.array([(r.error, r.spikes) for r in rows if r.tracking == tracking])
        if not len(found):
            continue
        axes.scatter(*found.T, s=14, color=color, marker=marker, alpha=0.4, lw=0)
        handles[name] = axes.scatter(*found.mean(0), s=60, color=color, marker=marker, lw=0)
    return handles


def draw(rows: Mapping[str, list[Any]], folder: Path, setup: str) -> None:
    """``synchronised.png`` and ``.svg``."""
    tracked: list[TrackingRow] = rows.get(TRACKED, [])
    scenes = list(dict.fromkeys(row.scene for row in tracked))
    figure, panels = grid(len(scenes) + 1, "spikes")
    handles: dict[str, Any] = {}
    ends = [1.08 * np.nanmax([getattr(row, name) for row in tracked]) for name in ("error", "spikes")]
    for axes, scene in zip(panels, scenes, strict=False):
        handles |= panel(axes, [row for row in tracked if row.scene == scene])
        dress(axes, scene)
        axes.set_xlabel("error [mm]", fontsize=7.5, color=INK)
        axes.set_xlim(0, ends[0]), axes.set_ylim(0.8, ends[1])
    panels[len(scenes)].set_axis_off()
    legend(panels[len(scenes)], handles, list(NAMES.values()), "center left", 1)
    save(figure, NOTE + setup, folder, STEM)
