"""The chart of the transfer benchmark: reward on the reference against training time, from its rows only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.style import COLORS, INK, limits, spread
from training.bench.charts import SOFT, dress, grid, legend, save
from training.bench.transfer.rows import RANDOM, REFERENCE, ZERO, TransferRow

STEM = "transfer"
# Okabe & Ito (2008), as the other charts have them.
KNOWN = {
    REFERENCE: "#0072B2",
    "similar": "#E69F00",
    "calibrated": "#D55E00",
    "closure": "#000000",
    "closure local": "#CC79A7",
}
MARKERS = {"": "o", "x2": "s", "x4": "^", "x4 longer": "*"}
FLOORS = {ZERO: (0, (4, 2)), RANDOM: (0, (1, 2))}
APART = 0.03  # of the axis: where times are nearly equal, points are moved this far apart
TICKS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500)  # s
NOTE = (
    "The same policy and seeds for all, {0} episodes ({1}: longer). Filled: reward on the reference, bars 95 % over "
    "seeds and trainings. Hollow: on the backend that it was trained on. Upper left is better. Points of nearly "
    "equal time are moved apart."
)


def curves(rows: Sequence[TransferRow]) -> dict[str, str]:
    """``KNOWN``, and a colour for what ``--backend`` named."""
    others = dict.fromkeys(split(r.policy)[0] for r in rows if r.trainings)
    return {name: COLORS[i % len(COLORS)] for i, name in enumerate(others)} | KNOWN


def split(policy: str) -> tuple[str, str]:
    """``"closure local x4 longer"`` as its backend and the rest."""
    name, cross, rest = policy.partition(" x")
    return name, f"x{rest}" if cross else ""


def panel(axes: Any, rows: Sequence[TransferRow], colors: Mapping[str, str]) -> dict[str, Any]:
    """One scene; returns the legend's entries."""
    handles: dict[str, Any] = {}
    axes.set_xscale("log")
    trained = [r for r in rows if r.trainings]
    times = np.array([r.processor_s for r in trained])
    left, right = np.log10(limits(times.min(), times.max(), 0.08))
    places = 10 ** spread(np.log10(times), APART * (right - left))
    for x, r in zip(places, trained, strict=True):
        name, rest = split(r.policy)
        color, marker = colors[name], MARKERS.get(rest, "X")
        size = 9 if marker == "*" else 6
        if r.policy != REFERENCE:
            axes.plot([x] * 2, [r.reference, r.own], color=color, lw=0.8, alpha=0.5, zorder=2)
            axes.plot(x, r.own, marker, ms=0.75 * size, mfc="white", mec=color, mew=1.0, zorder=5)
        handles[r.policy] = axes.errorbar(
            x, r.reference, yerr=r.reference_half, fmt=marker, color=color, ms=size, mec="white", mew=0.7,
            elinewidth=1.1, capsize=2.5, zorder=4,
        )  # fmt: skip
    for r in rows:
        if r.policy in FLOORS:
            line = axes.axhline(r.reference, color=SOFT, ls=FLOORS[r.policy], lw=1.0, zorder=1)
            handles[r.policy] = line
    axes.set_xlim(10**left, 10**right)
    axes.set_ylim(0, 1.08 * max(max(r.reference + r.reference_half, r.own) for r in rows))
    return handles


def draw(rows: Mapping[str, Sequence[TransferRow]], folder: Path, setup: str) -> None:
    """A panel a scene."""
    mine = rows.get(STEM, ())
    names = list(dict.fromkeys(r.scene for r in mine))
    if not names:
        return
    figure, panels = grid(len(names), "mean reward per frame")
    looks = curves(mine)
    handles: dict[str, Any] = {}
    for axes, name in zip(panels, names, strict=False):
        handles |= panel(axes, [r for r in mine if r.scene == name], looks)
        dress(axes, name)
        left, right = axes.get_xlim()
        axes.set_xticks([tick for tick in TICKS if left <= tick <= right])
    if len(panels) > len(names):
        legend(panels[-1], handles, (), "center left", 1)
    else:
        legend(figure, handles, (), "outside upper center", 4)
    figure.supxlabel("processor time of a training, one thread [s]", fontsize=8.5, color=INK)
    episodes = [r.episodes for r in mine if r.trainings]
    save(figure, f"{setup}. {NOTE.format(min(episodes), max(episodes))}", folder, STEM)
