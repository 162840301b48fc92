"""Heat maps of ``minicloth bench stability``, drawn from its rows only: a panel an axis, a line a backend."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cloth_envs.style import INK, import_figure
from training.bench.charts import COLUMNS, SOFT, WIDTH, save
from training.bench.stability.rows import Mark, StabilityRow, marks
from training.bench.stability.scores import REASONS
from training.bench.stability.worlds import AXES, DURATION, LENGTHS, Axis

LINE, HEAD = 0.158, 0.47  # inches: a line of a panel, what is around it
STEM = "stability"
DARK = 0.45  # of the colours, above which letters are black
NOTE = (
    "Yellow: every run passed. Grey: all stand, but are wrong. Dark blue: none survived. Cells that lost runs tell the "
    "commonest reason (of those that did not survive, if there are any), and how many passed if some did. None "
    "survives blow-up (not finite), stretch (an edge at twice its length), energy (a jump, or twice the truth's "
    "kinetic energy and 1 J/kg), tunnel (a body went through the cloth), momentum (1 % from nowhere). Wrong are slow "
    "and fast (mean height behind or ahead by over 5 % of its way within 0.5 s), error (vertices 5 % of the length off "
    "after 0.2 s), strain (p99 over twice the truth's and 5 points), drift (0.25 m g H from nowhere). Truth: explicit "
    "at half its stable step, on the same grid; *: in some worlds of the cell it fails itself, and from then on there "
    "is nothing to compare with."
)


def draw(rows: Mapping[str, Sequence[StabilityRow]], folder: Path, setup: str) -> None:
    """One figure as wide as a page."""
    if rows.get(STEM):
        _draw(rows[STEM], folder, setup)


def _draw(rows: Sequence[StabilityRow], folder: Path, setup: str) -> None:
    found = marks(rows)
    backends = list(dict.fromkeys(r.backend for r in rows))
    shown = [name for name in AXES if any(r.axis == name for r in rows)]
    high = -(-len(shown) // COLUMNS)
    figure = import_figure()(figsize=(WIDTH, high * (LINE * len(backends) + HEAD)), layout="constrained")
    figure.get_layout_engine().set(h_pad=0.05, w_pad=0.03, hspace=0.0, wspace=0.02)
    panels = figure.subplots(high, COLUMNS, squeeze=False).ravel().tolist()
    for axes in panels[len(shown) :]:
        axes.set_axis_off()
    for number, (axes, name) in enumerate(zip(panels, shown, strict=False)):
        scenes = list(dict.fromkeys(r.scene for r in rows if r.axis == name))
        panel(axes, AXES[name], {key[1:]: m for key, m in found.items() if key[0] == name}, backends)
        axes.set_title(AXES[name].title, loc="left", fontsize=8, fontweight="bold", color=INK, pad=12)
        names = ", ".join(scenes) if len(scenes) < 4 else f"{len(scenes)} scenes"
        axes.text(1.0, 1.13, names, transform=axes.transAxes, ha="right", fontsize=6.5, color=SOFT)
        if number % COLUMNS:
            axes.set_yticklabels([])
    seeds = len({r.seed for r in rows})
    how = (
        f"{setup}. Runs of {DURATION:g} s and {LENGTHS[-1]} frames (length, no force), {seeds} "
        f"seed{'s' * (seeds > 1)} a scene. "
    )
    save(figure, how + NOTE, folder, STEM, size=6.5)


def panel(axes: Any, axis: Axis, found: dict[tuple[str, float], Mark], backends: Sequence[str]) -> None:
    """Survived fractions of one axis, and why cells lost runs."""
    from matplotlib import colormaps

    colors = colormaps["cividis"]
    levels = [level for level in axis.levels if any((b, float(level)) in found for b in backends)]
    for row, backend in enumerate(backends):
        for col, level in enumerate(levels):
            mark = found.get((backend, float(level)))
            if mark is None:
                axes.text(col, row, "\u2013", ha="center", va="center", fontsize=6, color=SOFT)
                continue
            color = colors(mark.score)
            axes.fill([col - 0.5, col + 0.5, col + 0.5, col - 0.5], [row - 0.5, row - 0.5, row + 0.5, row + 0.5],
                      facecolor=color, edgecolor="white", lw=1.0)  # fmt: skip
            if mark.reason or mark.untold:
                text = REASONS.get(mark.reason, "") + "*" * bool(mark.untold)
                if mark.reason and mark.passed:
                    text += f" {mark.passed}/{mark.runs}"
                size = 4.7 if len(text) > 60 / len(levels) else 5.3
                axes.text(col, row, text, ha="center", va="center", fontsize=size,
                          color="black" if mark.score > DARK else "white")  # fmt: skip
    axes.set_xlim(-0.5, len(levels) - 0.5)
    axes.set_ylim(len(backends) - 0.5, -0.5)
    axes.set_xticks(range(len(levels)), [axis.label(level) for level in levels])
    axes.set_yticks(range(len(backends)), backends)
    axes.xaxis.tick_top()
    axes.tick_params(length=0, labelsize=6.5, colors=INK, pad=1.5)
    axes.spines[:].set_visible(False)
