"""The chart of ``minicloth bench gpu``: steps a second by members, and what PPO earns by the clock."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cloth_envs.style import COLORS, INK, MARKERS
from training.bench.charts import dress, grid, legend, save
from training.bench.gpu.rows import GpuRow, LearnRow

STEM = "gpu"
NOTE = (
    "Steps of members a second by random actions, observations and rewards included; dashed: all threads of the "
    "processor beside the card, in the same call."
)


def panels_of(rows: Sequence[GpuRow]) -> dict[str, list[GpuRow]]:
    """Rows by backend."""
    return {name: [r for r in rows if r.backend == name] for name in dict.fromkeys(r.backend for r in rows)}


def plot(axes: Any, rows: Sequence[GpuRow], handles: dict[str, Any]) -> None:
    """Steps a second of every scene."""
    for number, scene in enumerate(dict.fromkeys(r.scene for r in rows)):
        mine = [r for r in rows if r.scene == scene]
        card = sorted((r for r in mine if r.where == "card"), key=lambda r: r.members)
        color, x = COLORS[number % len(COLORS)], [r.members for r in card]
        marker = MARKERS[number % len(MARKERS)]
        handles[scene] = axes.plot(x, [r.steps for r in card], color=color, marker=marker, ms=4, lw=1.3)[0]
        best = max((r.steps for r in mine if r.where == "processor"), default=None)
        if best and card:
            axes.plot([x[0], x[-1]], [best, best], color=color, ls=(0, (4, 2)), lw=0.9)
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")


def draw(rows: Mapping[str, Sequence[Any]], folder: Path, setup: str) -> None:
    """A panel for every backend and, where it was measured, one of what PPO earns by the clock."""
    found, learned = panels_of(rows.get("gpu", [])), rows.get("gpu_learning", [])
    if not found:
        return
    figure, panels = grid(len(found) + bool(learned), "steps a second", panel=3.0)
    handles: dict[str, Any] = {}
    for axes, (name, mine) in zip(panels, found.items(), strict=False):
        plot(axes, mine, handles)
        dress(axes, "Full resolution (cnn)" if name == "cnn" else name.replace(" x", " \u00d7").capitalize())
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
        axes.set_xlabel("members", fontsize=7.5, color=INK)
    if learned:
        _learning(panels[len(found)], learned, rows["gpu"])
    legend(figure, handles, list(handles), "outside upper center", 6)
    save(figure, f"{_cards(rows['gpu'])}; {setup}. {NOTE}", folder, STEM)


def _cards(rows: Sequence[GpuRow]) -> str:
    """The card, or each one with its scenes."""
    scenes: dict[str, dict[str, None]] = {}
    for row in rows:
        if row.where == "card":
            scenes.setdefault(row.device, {})[row.scene] = None
    told = scenes if len(scenes) < 2 else [f"{card} ({', '.join(mine)})" for card, mine in scenes.items()]
    return ", ".join(told)


def _learning(axes: Any, rows: Sequence[LearnRow], speeds: Sequence[GpuRow]) -> None:
    scenes, cards = list(dict.fromkeys(r.scene for r in speeds)), {r.device for r in speeds if r.where == "card"}
    for scene, device in dict.fromkeys((r.scene, r.device) for r in rows):
        mine, card = [r for r in rows if (r.scene, r.device) == (scene, device)], device in cards
        x, y = [r.seconds for r in mine], [r.reward for r in mine]
        dashes: Any = "-" if card else (0, (4, 2))
        axes.plot(x, y, color=COLORS[scenes.index(scene) % len(COLORS)], ls=dashes, lw=1.3)
        told = f"{mine[-1].members:,} on {'the card' if card else 'the processor'}"
        side: dict[str, Any] = {"ha": "right", "va": "bottom"} if card else {"ha": "left", "va": "center"}
        axes.annotate(
            told, (x[-1], y[-1]), (4 * (not card), 0), textcoords="offset points", **side, fontsize=6.5, color=INK
        )
    dress(axes, "PPO (64 x 64), members")
    axes.set_xlabel("seconds", fontsize=7.5, color=INK)
    axes.set_ylabel("reward a frame", fontsize=7.5, color=INK)
