"""What the charts of all benchmarks have in common: the width of a page, panels, axes, notes, files."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cloth_envs.files import replacing
from cloth_envs.style import GRID, INK, import_figure

WIDTH, COLUMNS, PANEL = 7.2, 2, 2.55  # inches: the width of a page, and the height of a panel
SHADE, SOFT = "#b9c2c9", "#66727c"


def grid(count: int, ylabel: str, *, panel: float = PANEL, rest: float = 0.5) -> tuple[Any, list[Any]]:
    """A page-wide figure of at least ``count`` panels, ``panel`` inches high; ``ylabel`` is told once a line."""
    high = -(-count // COLUMNS)
    figure = import_figure()(figsize=(WIDTH, panel * high + rest), layout="constrained")
    figure.get_layout_engine().set(hspace=0.04, wspace=0.04)
    panels = figure.subplots(high, COLUMNS, squeeze=False).ravel().tolist()
    for axes in panels[count:]:
        axes.set_axis_off()
    for axes in panels[:count:COLUMNS]:
        axes.set_ylabel(ylabel, fontsize=7.5, color=INK)
    return figure, panels


def dress(axes: Any, title: str) -> None:
    """Title, ticks in plain numbers, and grid lines."""
    axes.set_title(title, loc="left", fontsize=9, fontweight="bold", color=INK, pad=4)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.set_minor_formatter(lambda value, _: "")
    axes.grid(True, which="major", color=GRID, lw=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=INK, which="both", labelsize=7.5)
    axes.tick_params(which="minor", length=1.5)


def legend(place: Any, handles: dict[str, Any], order: Sequence[str], where: str, columns: int) -> None:
    """What the curves are, those of ``order`` first, on a figure or in an empty panel."""
    names = [name for name in dict.fromkeys((*order, *handles)) if name in handles]
    place.legend(
        [handles[name] for name in names], names, loc=where, ncols=columns, frameon=False, fontsize=7.5,
        handlelength=3, columnspacing=1.6, labelspacing=0.6, labelcolor=INK,
    )  # fmt: skip


def save(figure: Any, note: str, folder: Path, stem: str, *, size: float = 7.0) -> None:
    """``note`` below the panels, then ``stem.png`` and ``stem.svg``."""
    text = "\n".join(textwrap.wrap(note, 140))
    figure.text(0.005, -0.008, text, fontsize=size, color=SOFT, va="top", ha="left", linespacing=1.35)
    for kind in ("png", "svg"):
        with replacing(folder / f"{stem}.{kind}") as part:
            figure.savefig(part, dpi=200, bbox_inches="tight", pad_inches=0.1, facecolor="white")
