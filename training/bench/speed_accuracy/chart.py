"""Charts of ``minicloth bench speed-accuracy``: error against wall-clock time a frame, drawn from its rows only."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.style import INK, limits
from training.bench.charts import SHADE, SOFT, dress, grid, legend, save
from training.bench.participants import FLOOR, ORACLE
from training.bench.speed_accuracy.rows import SpeedAccuracyRow, factor_of, front

YELLOW = "#f6e8b1"
OTHERS = ("#8b1a1a", "#5f7a00", "#4d4d4d", "#00868b")  # of what is not among CURVES
MOST = 120.0  # % of the length; what is farther off is not drawn
OVERVIEW_FRAMES = 5
TICKS = [first * 10.0**power for power in range(-3, 4) for first in (1, 2, 5)]  # ms


@dataclass(frozen=True)
class Curve:
    """How a family is drawn (dotted: small); colours are Okabe & Ito's (2008), distinct for every colour vision."""

    name: str
    color: str
    marker: str
    line: str = "-"
    ring: bool = False  # large and open, around what lies at the same place


CURVES = {
    "explicit": Curve("explicit, full grid", "#0072B2", "o"),
    "admm": Curve("P-ADMM, 1-100 iterations", "#009E73", "D"),
    "admm substeps": Curve("P-ADMM, 4 and 16 substeps", "#009E73", "d", "--"),
    "miniature seed": Curve("miniature, seed scaling", "#CC79A7", "s"),
    "miniature similar": Curve("miniature, similar (coarse + bicubic)", "#E69F00", "^"),
    "miniature rule": Curve("miniature, rule (tension field)", "#777777", "X"),
    "miniature calibrated": Curve("miniature, calibrated", "#D55E00", "P"),
    "miniature closure": Curve("closure, bicubic", "#000000", "p"),
    "closure ridge": Curve("closure, ridge upscaler", "#000000", "1", ":"),
    "miniature": Curve("miniature, as it comes (closure, network)", "#000000", "*", "--"),
    "closure learned": Curve("closure, learned correction", "#D81B60", "P", "--"),
    "cnn": Curve("physics-embedded CNN, full grid", "#4B0082", "h", ring=True),
    "mfsr": Curve("super-resolution (mfsr)", "#D81B60", "v"),
    "coarse bilinear": Curve("coarse + bilinear", "#8a6d1f", "1", ":"),
}
ORDER = [curve.name for curve in CURVES.values()]
STEM, ERROR = "speed_accuracy", "mean vertex error [% of length]"
LINES = {"repeat last frame": "last frame again", "constant velocity": "constant velocity"}
LABELLED = "miniature"  # whose points tell their grid factor
BEYOND = ("implicit", "implicit substeps")  # far to the right of all others, in docs/solvers.md


def curves(rows: Sequence[SpeedAccuracyRow]) -> dict[str, Curve]:
    """``CURVES``, and one for every family that is not among them: what ``--backend`` named."""
    others = dict.fromkeys(r.family for r in rows if r.family not in (*CURVES, *LINES, *BEYOND, ORACLE, FLOOR))
    return CURVES | {name: Curve(name, OTHERS[i % len(OTHERS)], "<", "-.") for i, name in enumerate(others)}


def _curve(axes: Any, curve: Curve, rows: Sequence[SpeedAccuracyRow]) -> Any:
    """Points of one family joined in the order of their time; returns its entry of the legend."""
    from matplotlib.lines import Line2D

    x, y = [r.ms_median for r in rows], [r.error for r in rows]
    small = curve.line == ":"
    look: dict[str, Any] = {"color": curve.color, "ls": curve.line, "lw": 0.8 if small else 1.3}
    edge = curve.color if curve.marker == "1" else "white"
    dot: dict[str, Any] = {"marker": curve.marker, "ms": 4 if small else 5.5, "mec": edge, "mew": 0.7}
    if curve.ring:
        dot |= {"ms": 9.5, "mfc": "none", "mec": curve.color, "mew": 1.3}
    whole = [i for i, row in enumerate(rows) if not row.failure]  # the others are means of what survived
    axes.plot([x[i] for i in whole], [y[i] for i in whole], zorder=3, **look)
    axes.hlines(y, [r.ms_q1 for r in rows], [r.ms_q3 for r in rows], color=curve.color, lw=0.8, zorder=3)
    failed, late = {"marker": "x", "mec": curve.color}, {"mfc": "white", "mec": curve.color, "mew": 1.0}
    for row, *at in zip(rows, x, y, strict=True):
        own = failed if row.failure else {} if row.passes or curve.ring else late
        axes.plot(*at, color=curve.color, zorder=4, **dot | own)
    return Line2D([], [], **look, **dot)


def panel(axes: Any, rows: Sequence[SpeedAccuracyRow]) -> dict[str, Any]:
    """Draw one scene at one horizon; returns the legend's entries."""
    looks = curves(rows)
    rows = [r for r in rows if 0 < r.error <= MOST and r.survived]
    shown = [r for r in rows if r.family in looks and np.isfinite(r.ms_median)]
    axes.set_xscale("log")
    axes.set_yscale("log")
    handles: dict[str, Any] = {}
    if not shown:
        axes.text(0.5, 0.5, "no rows", transform=axes.transAxes, ha="center", color=SOFT, fontsize=8)
        return handles
    for family, curve in looks.items():
        mine = sorted((r for r in shown if r.family == family), key=lambda r: r.ms_median)
        if mine:
            handles[curve.name] = _curve(axes, curve, mine)
    floor = max([r.floor for r in rows])
    values = [r.error for r in rows if r.family in looks or r.family in LINES]
    oracle = [r for r in rows if r.family == ORACLE]
    low = min([*values, *(r.error for r in oracle)])
    bottom, top = limits(low, max(values), 0.06)
    axes.set_ylim(bottom, top)
    left, right = limits(min(r.ms_median for r in shown), max(r.ms_median for r in shown), 0.07)
    axes.set_xlim(left, right)
    axes.set_xticks([tick for tick in TICKS if left <= tick <= right])
    if floor > bottom:
        axes.axhspan(bottom, floor, color=SHADE, alpha=0.5, lw=0, zorder=1)
    if floor > 0:
        axes.set_title(f"chaos floor {floor:.{1 if floor < 1 else 2}g} %", loc="right", fontsize=6.5, color=SOFT, pad=4)
    best = front(rows)
    if len(best) > 1:
        axes.step([r.ms_median for r in best], [r.error for r in best], where="post", color=YELLOW, lw=4,
                  zorder=1.5, solid_capstyle="round", solid_joinstyle="round")  # fmt: skip
    _beside(axes, rows, oracle)
    return handles


def _beside(axes: Any, rows: Sequence[SpeedAccuracyRow], oracle: Sequence[SpeedAccuracyRow]) -> None:
    """What has no place on the axis of time: extrapolations and the oracle as lines, and the labels of factors."""
    from matplotlib.patheffects import withStroke

    halo = [withStroke(linewidth=2, foreground="white")]
    left, right = axes.get_xlim()

    def tell(text: str, at: tuple[float, float], off: tuple[float, float], ha: str, va: str, color: str = INK) -> None:
        axes.annotate(text, at, off, textcoords="offset points", ha=ha, va=va, fontsize=6.5, color=color,
                      path_effects=halo, zorder=5)  # fmt: skip

    highest = max((r.error for r in rows if r.family in LINES), default=np.nan)
    for r in rows:
        if r.family in LINES:
            axes.axhline(r.error, color=SOFT, ls=(0, (1, 2)), lw=0.9, zorder=2)
            off, va = (1.5, "bottom") if r.error == highest else (-2, "top")
            tell(LINES[r.family], (right, r.error), (-2, off), "right", va, SOFT)
        if r.family == LABELLED and np.isfinite(r.ms_median):
            tell(f"\u00d7{factor_of(r.options):g}", (r.ms_median, r.error), (-3, -4), "right", "top")
    for r in oracle:
        axes.plot([left, left * (right / left) ** 0.045], [r.error] * 2, color=INK, lw=1.4, zorder=4, clip_on=False)
        tell(f"\u00d7{factor_of(r.options):g}", (left * (right / left) ** 0.05, r.error), (1, 0), "left", "center")


NOTE = (
    "Lower left is better; implicit solvers, over 60 ms a frame, are not shown. Yellow: the front. Bars: quartiles of "
    "the time. Hollow: the mean height is off by over 5 % of its way. Cross: up to half of the windows failed, mean of "
    "the others. "
    "\u00d72: grid factor. Ticks at the left edge: the exact coarse cloth, bicubic: what interpolation alone loses. "
    "Grey: below the chaos floor, errors mean nothing. Hexagon: the CNN, to the bit the reference inside."
)


def draw(rows: Mapping[str, Sequence[SpeedAccuracyRow]], folder: Path, setup: str) -> None:
    """A chart a scene, a panel a horizon; and one of all scenes after 5 frames."""
    found = rows.get(STEM, [])
    names = list(dict.fromkeys(row.scene for row in found))
    for name in names:
        at = {h: [r for r in found if (r.scene, r.frames) == (name, h)] for h in sorted({r.frames for r in found})}
        parts = [(f"{name}, after {h} frame{'s' * (h > 1)}", mine) for h, mine in at.items() if mine]
        _figure(parts, f"{STEM}_{name.lower()}", folder, setup)
    h = OVERVIEW_FRAMES
    alike = [(f"{n}, after {h} frames", [r for r in found if (r.scene, r.frames) == (n, h)]) for n in names]
    if alike:
        _figure(alike, STEM, folder, setup)


def _figure(parts: Sequence[tuple[str, Sequence[SpeedAccuracyRow]]], stem: str, folder: Path, setup: str) -> None:
    """A panel for each title and rows."""
    figure, panels = grid(len(parts), ERROR)
    handles: dict[str, Any] = {}
    for axes, (title, rows) in zip(panels, parts, strict=False):
        handles |= panel(axes, rows)
        dress(axes, title)
    if len(panels) > len(parts):
        legend(panels[-1], handles, ORDER, "center left", 1)
    else:
        legend(figure, handles, ORDER, "outside upper center", 3)
    figure.supxlabel("wall-clock time of a simulated frame, one thread [ms]", fontsize=8.5, color=INK)
    save(figure, f"{setup}. {NOTE}", folder, stem)
