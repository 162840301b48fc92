"""Heat maps of ``minicloth bench stability``, drawn from its rows only: a panel an axis, a line a backend."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cloth_envs.style import INK
from training.bench.charts import COLUMNS, SOFT, grid, save
from training.bench.stability.rows import NOTE, REASONS, Mark, StabilityRow, marks
from training.bench.stability.worlds import AXES, DURATION, LENGTHS, Axis
from training.truth import DETAILED

LINE, HEAD = 0.158, 0.47  # inches: a line of a panel, what is around it
STEM, DETAIL = "stability", "stability_detail"
DARK = 0.45  # of the colours, above which letters are black


def draw(rows: Mapping[str, Sequence[StabilityRow]], folder: Path, setup: str) -> None:
    """A figure as wide as a page, and one of the scenes with super-resolution, which has other lines."""
    for detailed, stem in ((False, STEM), (True, DETAIL)):
        mine = [row for row in rows.get(STEM, []) if (row.scene in DETAILED) == detailed]
        if mine:
            _figure(mine, stem, folder, setup)


def _figure(mine: Sequence[StabilityRow], stem: str, folder: Path, setup: str) -> None:
    found, backends = marks(mine), list(dict.fromkeys(r.backend for r in mine))
    shown = [name for name in AXES if any(key[0] == name for key in found)]
    figure, panels = grid(len(shown), "", panel=LINE * len(backends) + HEAD, rest=0.0)
    figure.get_layout_engine().set(h_pad=0.05, w_pad=0.03, hspace=0.0, wspace=0.02)
    for number, (axes, name) in enumerate(zip(panels, shown, strict=False)):
        scenes = list(dict.fromkeys(r.scene for r in mine if r.axis == name))
        panel(axes, AXES[name], {key[1:]: m for key, m in found.items() if key[0] == name}, backends)
        axes.set_title(AXES[name].title, loc="left", fontsize=8, fontweight="bold", color=INK, pad=12)
        names = ", ".join(scenes) if len(scenes) < 4 else f"{len(scenes)} scenes"
        axes.annotate(names, (1.0, 1.0), (0, 12), xycoords="axes fraction", textcoords="offset points", ha="right",
                      fontsize=6.5, color=SOFT)  # fmt: skip
        if number % COLUMNS:
            axes.set_yticklabels([])
    count = len({r.seed for r in mine})
    seeds = f"{count} seed{'s' * (count > 1)} a scene"
    runs = f"Runs of {DURATION:g} s and {LENGTHS[-1]} frames (length, no force), {seeds}."
    save(figure, f"{setup}. {runs} {NOTE}", folder, stem, size=6.5)


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
