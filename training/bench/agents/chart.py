"""Learning curves: reward on the reference against the processor's time."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.style import COLORS, INK
from training.bench.agents.rows import FLOOR_STEM, HAND, MIXED, MIXED_SAC, REFERENCE, STEM, ZERO, AgentRow
from training.bench.charts import SOFT, dress, grid, legend, save

KNOWN = {REFERENCE: COLORS[0], "miniature x2": COLORS[1], "miniature x4": INK, MIXED: COLORS[2], MIXED_SAC: COLORS[4]}
DASHES = {ZERO: (0, (1, 2)), HAND: (0, (4, 2))}
NOTE = (
    "Networks of one size and one learner, PPO (examples/train_ppo.py), or SAC where it is named; reward on the "
    "reference, held-out seeds, which the time does not hold. Thin lines are single trainings, thick ones their mean. "
    "Upper left is better."
)


def curves(axes: Any, rows: Sequence[AgentRow], color: str) -> Any:
    """The trainings of one schedule and, of several, their mean; returns the legend's entry."""
    seeds = {
        seed: sorted((r for r in rows if r.seed == seed), key=lambda r: r.point) for seed in {r.seed for r in rows}
    }
    several = len(seeds) > 1
    for mine in seeds.values():
        x, y = [r.processor_s for r in mine], [r.reward for r in mine]
        (drawn,) = axes.plot(x, y, "o-", ms=2.5, color=color, lw=0.8 if several else 1.8, alpha=0.45 if several else 1)
    if several:
        points = sorted({r.point for r in rows})
        x, y = (
            [np.mean([getattr(r, n) for r in rows if r.point == p]) for p in points] for n in ("processor_s", "reward")
        )
        (drawn,) = axes.plot(x, y, color=color, lw=2.0)
    return drawn


def draw(rows: Mapping[str, Sequence[Any]], folder: Path, setup: str) -> None:
    """A panel a scene."""
    mine, floors = rows.get(STEM, ()), rows.get(FLOOR_STEM, ())
    shown = list(dict.fromkeys(r.scene for r in mine))
    if not shown:
        return
    figure, panels = grid(len(shown), "reward a frame")
    handles: dict[str, Any] = {}
    for axes, scene in zip(panels, shown, strict=False):
        there = [r for r in mine if r.scene == scene]
        for i, schedule in enumerate(dict.fromkeys(r.schedule for r in there)):
            color = KNOWN.get(schedule, COLORS[(i + 3) % len(COLORS)])
            handles[schedule] = curves(axes, [r for r in there if r.schedule == schedule], color)
        for floor in (f for f in floors if f.scene == scene):
            handles[floor.who] = axes.axhline(floor.reward, color=SOFT, ls=DASHES[floor.who], lw=1.0, zorder=1)
        axes.set(xlim=(0, None), ylim=(0, 1))
        dress(axes, scene)
    if len(panels) > len(shown):
        legend(panels[-1], handles, tuple(KNOWN), "center left", 1)
    else:
        legend(figure, handles, tuple(KNOWN), "outside upper center", 4)
    figure.supxlabel("processor time of the training, one thread [s]", fontsize=8.5, color=INK)
    save(figure, f"{setup}. {NOTE}", folder, STEM)
