"""The chart of a comparison: speed against error, both on logarithmic axes."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.commands.measure import Comparison
from cloth_envs.commands.tables import machine
from cloth_envs.files import replacing
from cloth_envs.style import COLORS, GRID, INK, MARKERS, import_figure, limits, spread

WIDTH, HEIGHT = 7.2, 4.6  # inches: the width of a page
BARS = {"ms": 8, "mec": "white", "mew": 1.0, "elinewidth": 1.1, "capsize": 2.5, "zorder": 3}
RING = {"ms": 17, "mfc": "none", "mew": 1.6, "elinewidth": 1.1, "zorder": 2}  # around what it equals


def _two_and_five(value: float, _: int) -> str:
    """A label for every 2 and 5 between the decades."""
    return f"{value:g}" if round(value / 10 ** np.floor(np.log10(value) + 1e-9)) in (2, 5) else ""


def draw(comparison: Comparison, paths: Sequence[Path], *, horizon: int, setup: str) -> None:
    """Write the chart of errors ``horizon`` frames after a restart from the truth to ``paths`` (``.png``, ``.svg``).

    Entries that failed within the horizon, or don't differ from the truth, are named below the chart instead. What has
    the errors of an earlier entry, to the bit, is an open marker around it.
    """
    column = comparison.horizons.index(horizon)
    shown = [r for r in comparison.results if np.isfinite(r.errors[:, column]).all() and r.errors[:, column].min() > 0]
    left_out = [
        f"{r.entry.label} ({'failed' if np.isnan(r.errors[:, column]).any() else 'equals the truth'})"
        for r in comparison.results
        if not any(r is s for s in shown)
    ]
    labels = [r.entry.label for r in shown]
    twins = {one: other for one, other in comparison.twins.items() if one in labels}
    curves = list(dict.fromkeys(r.entry.curve for r in comparison.results))
    figure = import_figure()(figsize=(WIDTH, HEIGHT), layout="constrained")
    axes = figure.add_subplot()
    axes.set(xscale="log", yscale="log")
    times = np.array([r.ms for r in shown]).reshape(-1, 3)
    errors = np.array([100 * r.errors[:, column] for r in shown]).reshape(len(shown), -1)
    mean = errors.mean(1)
    for number, curve in enumerate(curves):
        mine = [i for i, r in enumerate(shown) if r.entry.curve == curve]
        color = COLORS[number % len(COLORS)]
        line = sorted(mine, key=lambda i: times[i, 1])
        axes.plot(times[line, 1], mean[line], color=color, lw=1.2, alpha=0.45, zorder=1)
        marker = MARKERS[number % len(MARKERS)]
        for i in mine:
            wide = np.abs(times[i, [0, 2]] - times[i, 1])[:, None]
            high = np.abs(np.array([errors[i].min(), errors[i].max()]) - mean[i])[:, None]
            twin = labels[i] in twins  # whose range of errors is drawn already
            look = RING | {"mec": color} if twin else BARS | {"yerr": high}
            axes.errorbar(times[i, 1], mean[i], xerr=wide, fmt=marker, color=color, **look)
    if shown:
        axes.set_xlim(limits(times[:, 0].min(), times[:, 2].max(), 0.16))
        axes.set_ylim(limits(errors.min(), errors.max()))
    seconds = horizon * comparison.scene.frame_dt
    frames = "1 frame" if horizon == 1 else f"{horizon} frames"
    axes.set_xlabel(f"time for a frame of {comparison.scene.frame_dt * 1e3:g} ms [ms], physics only (left is faster)")
    axes.set_ylabel("mean vertex error [% of cloth length]\n(lower is closer)")
    title = f"{comparison.scene.name}: speed against error after {frames} ({seconds:g} s)"
    axes.set_title(title, loc="left", fontweight="bold", color=INK)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        if np.ptp(np.log10(axis.get_view_interval())) < 3:
            axis.set_minor_formatter(_two_and_five)
    axes.tick_params(which="minor", labelsize=8)
    axes.grid(True, which="major", color=GRID, lw=0.8)
    axes.grid(True, which="minor", color=GRID, lw=0.4, alpha=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=INK, which="both")
    note = f"{setup}. {machine()}.\nBars: quartiles of the time; range of the error over "
    note += f"{len(comparison.starts)} restarts from the truth."
    for one, other in twins.items():
        note += f"\nOpen marker: {one} has the errors of {other}, to the bit."
    if left_out:
        note += f"\nNot shown: {', '.join(left_out)}."
    figure.text(0.0, -0.01, note, fontsize=7.5, color=INK, va="top", ha="left")
    figure.draw_without_rendering()
    if shown:
        own = [i for i, label in enumerate(labels) if label not in twins]
        _label(axes, [labels[i] for i in own], times[own, 1], mean[own], ringed=set(twins.values()))
        for i, label in enumerate(labels):
            if i not in own:
                _tell(axes, label, (times[i, 1], errors[i].max()), (0, 8), ha="center", va="bottom")
    for path in paths:
        with replacing(path) as part:
            figure.savefig(part, dpi=200, bbox_inches="tight", pad_inches=0.12, facecolor="white")


def _label(axes: Any, labels: list[str], x: np.ndarray, y: np.ndarray, *, ringed: set[str]) -> None:
    """Names beside the markers, moved apart, on the side that has more room; outside the open marker around some."""
    box = axes.get_window_extent()
    pixels = axes.transData.transform(np.stack([x, y], 1))
    dpi = axes.figure.dpi / 72
    right = pixels[:, 0] < box.x0 + 0.55 * box.width
    for side, align, sign, up in ((True, "left", 1, 6), (False, "right", -1, -7)):
        mine = np.flatnonzero(right == side)
        for i, at in zip(mine, spread(pixels[mine, 1], 13 * dpi), strict=True):
            offset = sign * (20 if labels[i] in ringed else 10), (at - pixels[i, 1]) / dpi + up
            _tell(axes, labels[i], (x[i], y[i]), offset, ha=align, va="center")


def _tell(axes: Any, text: str, at: tuple[float, float], offset: tuple[float, float], **align: str) -> None:
    """``text`` at an ``offset`` [points] of a point, legible over lines."""
    from matplotlib.patheffects import withStroke

    halo = [withStroke(linewidth=3, foreground="white")]
    look = {"fontsize": 9, "color": INK, "zorder": 4, "path_effects": halo}
    axes.annotate(text, at, offset, textcoords="offset points", **look, **align)
