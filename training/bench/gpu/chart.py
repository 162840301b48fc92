"""The chart of ``minicloth bench gpu``: steps a second by members, and what PPO earns by the clock."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cloth_envs.style import COLORS, INK, MARKERS
from training.bench.charts import dress, grid, legend, save
from training.bench.gpu.rows import GpuRow, LearnRow

STEM = "gpu"
NOTE = (
    "Steps of members a second by random actions, observations and rewards included; dashed: every core of the processor "
    "beside the card, in the same call. Right: the mean reward a frame of PPO (64 x 64) by seconds since its start."
)


def draw(rows: Mapping[str, Sequence[Any]], folder: Path, setup: str) -> None:
    """Two panels."""
    found: Sequence[GpuRow] = rows.get("gpu", [])
    learned: Sequence[LearnRow] = rows.get("gpu_learning", [])
    if not found:
        return
    figure, (speed, learning, *_) = grid(2, "steps a second", panel=3.0)
    handles: dict[str, Any] = {}
    names = list(dict.fromkeys((r.scene, r.backend) for r in found))
    for number, (scene, backend) in enumerate(names):
        mine = [r for r in found if (r.scene, r.backend) == (scene, backend)]
        card = sorted((r for r in mine if r.where == "card"), key=lambda r: r.members)
        look = {"color": COLORS[number % len(COLORS)], "marker": MARKERS[number % len(MARKERS)], "ms": 4, "lw": 1.3}
        line = speed.plot([r.members for r in card], [r.steps for r in card], **look)[0]
        handles[scene if backend == "cnn" else f"{scene}, {backend}"] = line
        best = max((r.steps for r in mine if r.where == "processor"), default=None)
        if best and card:
            ends = [card[0].members, card[-1].members]
            speed.plot(ends, [best, best], color=look["color"], ls="--", lw=0.9)
    speed.set_xscale("log", base=2)
    speed.set_yscale("log")
    dress(speed, "Environment steps a second")
    speed.yaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    speed.set_xlabel("members", fontsize=7.5, color=INK)
    for number, scene in enumerate(dict.fromkeys(r.scene for r in learned)):
        mine = [r for r in learned if r.scene == scene]
        color = handles[scene].get_color() if scene in handles else COLORS[number]
        learning.plot([r.seconds for r in mine], [r.reward for r in mine], color=color, lw=1.3)
        learning.annotate(scene, (mine[-1].seconds, mine[-1].reward), fontsize=7.5, color=INK, ha="right", va="bottom")
    dress(learning, "PPO: reward a frame")
    learning.set_xlabel("seconds", fontsize=7.5, color=INK)
    legend(figure, handles, list(handles), "outside upper center", 4)
    save(figure, f"{found[0].device}. {setup}. {NOTE}", folder, STEM)
