"""The chart of ``minicloth bench solvers``: error against time a frame, one panel a scene; drawn from rows only."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.style import COLORS, GRID, INK, MARKERS, import_figure, limits
from training.bench.configurations import COST
from training.bench.cost import TOLERANCE
from training.bench.summary import Summary

COLUMNS, WIDTH, PANEL = 3, 7.2, 2.6  # inches: the width of a page


def families(rows: Sequence[Summary]) -> dict[str, list[Summary]]:
    """Rows of a solver and its scheme, in the order of their time; a curve joins those that no faster one beats."""
    out: dict[str, list[Summary]] = {}
    for row in sorted(rows, key=lambda r: r.ms_median):
        scheme = json.loads(row.options).get("scheme")
        out.setdefault(row.solver + (f", {scheme}" if scheme else ""), []).append(row)
    return dict(sorted(out.items(), key=lambda item: list(COST).index(item[1][0].solver)))


def draw(
    rows: Sequence[Summary], floors: Mapping[str, float], paths: Sequence[Path], *, frames: int, note: str
) -> None:
    """Write the chart to each of ``paths``.

    Args:
        floors: chaos floor after ``frames`` by scene, over the cloth's length.
        frames: 1, 5 or 10; which error is drawn.
    """
    figure_class = import_figure()
    from matplotlib.lines import Line2D

    scenes = list(dict.fromkeys(r.scene for r in rows))
    high = -(-len(scenes) // COLUMNS)
    figure = figure_class(figsize=(WIDTH, PANEL * high + 0.5), layout="constrained")
    panels = figure.subplots(high, min(COLUMNS, len(scenes)), squeeze=False).ravel()
    names = list(families(rows))
    handles = {}
    for axes, scene in zip(panels, scenes, strict=False):
        mine = [r for r in rows if r.scene == scene]
        errors = []
        axes.set_xscale("log")
        axes.set_yscale("log")
        for name, family in families(mine).items():
            color, marker = COLORS[names.index(name) % len(COLORS)], MARKERS[names.index(name) % len(MARKERS)]
            shown = [r for r in family if np.isfinite(_error(r, frames))]
            x, y = [r.ms_median for r in shown], [_error(r, frames) for r in shown]
            errors += y
            style: dict[str, Any] = {"color": color, "marker": marker, "ms": 5, "mec": "white", "mew": 0.6}
            axes.plot(x, y, ls="", zorder=3, **style)
            on = [i for i in range(len(y)) if y[i] == min(y[: i + 1])]
            axes.plot([x[i] for i in on], [y[i] for i in on], color=color, lw=1.2, zorder=2)
            handles[name] = Line2D([], [], lw=1.2, **style)
            late = [r for r in shown if r.failure or abs(r.slow) > TOLERANCE]
            axes.plot(
                [r.ms_median for r in late], [_error(r, frames) for r in late],
                ls="", marker=marker, ms=5, mfc="white", mec=color, mew=1.1, zorder=4,
            )  # fmt: skip
        low = 100 * floors[scene] if scene in floors else min(errors)
        axes.set_ylim(limits(min(low, *errors), max(errors)))
        axes.set_xlim(limits(np.nanmin([r.ms_median for r in mine]), np.nanmax([r.ms_median for r in mine])))
        if scene in floors:
            bottom = axes.get_ylim()[0]
            axes.axhspan(bottom, low, color="#9aa5ae", alpha=0.35, lw=0, zorder=1)
            place = (0.98, (bottom * low) ** 0.5)
            axes.text(
                *place, "chaos", transform=axes.get_yaxis_transform(), ha="right", va="center", fontsize=7, color=INK
            )
        axes.set_title(scene, loc="left", fontsize=9.5, fontweight="bold", color=INK)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(lambda value, _: f"{value:g}")
            axis.set_minor_formatter(few if np.ptp(np.log10(axis.get_view_interval())) < 2 else "")
        axes.grid(True, which="major", color=GRID, lw=0.7)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(colors=INK, which="both", labelsize=8)
    for axes in panels[len(scenes) :]:
        axes.set_axis_off()
    for axes in panels[:: min(COLUMNS, len(scenes))]:
        axes.set_ylabel(f"error after {frames} fr. [% of length]", fontsize=8, color=INK)
    figure.supxlabel("processor time for a frame, one thread [ms]", fontsize=8.5, color=INK)
    figure.legend(
        handles.values(), handles.keys(), loc="outside upper center", ncols=len(handles), frameon=False, fontsize=8.5
    )
    figure.text(0.0, -0.01, note, fontsize=7, color=INK, va="top", ha="left")
    for path in paths:
        figure.savefig(path, dpi=200, bbox_inches="tight", pad_inches=0.1, facecolor="white")


def few(value: float, _: int) -> str:
    """A label for 3 between the decades."""
    return f"{value:g}" if round(value / 10 ** np.floor(np.log10(value) + 1e-9)) == 3 else ""


def _error(row: Summary, frames: int) -> float:
    return float(getattr(row, f"error_{frames}_percent"))
