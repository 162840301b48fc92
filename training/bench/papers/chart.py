"""Charts beside Lee 2019, drawn from rows only: errors by frame (figs. 9-12), and variants (figs. 13-15)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cloth_envs.style import INK, import_figure
from training.bench.charts import SHADE, WIDTH, dress, legend, save
from training.bench.papers.published import TABLE_7
from training.bench.papers.rows import FrameErrorRow, PublishedRow
from training.bench.papers.runs import UNSCALED
from training.upscaler.recipes import SCENES

# method -> name, colour (Okabe & Ito 2008), marker, line. Other upscalers take what is left.
LOOKS: dict[str, tuple[str, str, str, str]] = {
    "bilinear": ("bilinear", "#8a6d1f", "1", ":"),
    "bicubic": ("bicubic", "#E69F00", "^", "-"),
    "hdnn": ("triangle network, same miniature", "#CC79A7", "s", "-"),
    "fc": ("network, 4*FC-64", "#0072B2", "o", "-"),
    UNSCALED: ("H-DNN-like: triangle network, unscaled", "#D55E00", "P", "--"),
    "local": ("local network", "#009E73", "D", "-"),
    "ridge": ("ridge", "#56B4E9", "v", "-"),
}
WIDE = {"bicubic": 3.0, "hdnn": 2.0, "fc": 1.0}  # so that lines that coincide are seen
NUDGED = "teacher nudged"
VARIED = {"fig13": "mass [kg]", "fig14": "spring [N/m]", "fig15": "wind [m/s]"}
PANEL = 2.1  # inches, height of a panel
NOTE_FRAMES = (
    "Left: the teacher's own positions, down-sampled and upscaled. Right: the miniature runs by itself from the same "
    "start; all upscalers then err alike. Grey: what the teacher itself is off by when it starts 1 \u00b5m away; no "
    "error below it means anything. Dotted: means in table 7 of the paper, network (lower) and H-DNN (upper; one line "
    "where they are equal). Preset lee2019, factor 2."
)
NOTE_VARIED = (
    "Mean error over 100 frames, figs. 13-15 of the paper. Filled: real miniature, free run, where upscalers on the "
    "same miniature err alike; hollow: oracle inputs, the upscaling alone. The networks learnt a wind of 12 m/s and "
    "never saw -12."
)


def draw(rows: Mapping[str, Sequence[Any]], folder: Path, setup: str) -> None:
    """Both, as far as there are rows."""
    if rows.get("published_frames"):
        frames(rows["published_frames"], folder)
    if any(r.table in VARIED for r in rows.get("published", ())):
        variants(rows["published"], folder)


def frames(points: Sequence[FrameErrorRow], folder: Path) -> None:
    """A row a scene: the error by frame with oracle inputs and in a free run."""
    scenes = [s for s in SCENES if any(p.scene == s for p in points)]
    figure, panels = _grid(len(scenes), 2)
    handles: dict[str, Any] = {}
    for row, scene in zip(panels, scenes, strict=True):
        mine = [p for p in points if p.scene == scene]
        top, bottom = max(p.error for p in mine), min(p.error for p in mine if p.method in LOOKS and p.frame > 1)
        for axes, protocol in zip(row, ("oracle", "free"), strict=True):
            axes.set_yscale("log")
            for method, (name, color, _, line) in LOOKS.items():
                curve = sorted((p.frame, p.error) for p in mine if (p.protocol, p.method) == (protocol, method))
                if curve:
                    (handles[name],) = axes.plot(
                        *zip(*curve, strict=True), color=color, ls=line, lw=WIDE.get(method, 1.3)
                    )
            chaos = sorted((p.frame, p.error) for p in mine if (p.protocol, p.method) == (protocol, NUDGED))
            if chaos:
                axes.fill_between(*zip(*chaos, strict=True), 1e-9, color=SHADE, alpha=0.5, lw=0, zorder=1)
            for value in TABLE_7[scene] if protocol == "free" else ():
                axes.axhline(value, color=INK, ls=(0, (1, 2)), lw=1, zorder=2)
            axes.set_xlim(0, 100)
            axes.set_ylim(max(bottom, 1e-5) / 1.5, top * 1.6)
            dress(axes, f"{scene}, {'oracle inputs' if protocol == 'oracle' else 'real miniature, free run'}")
        row[0].set_ylabel("mean vertex error [m]", fontsize=7.5, color=INK)
    for axes in panels[-1]:
        axes.set_xlabel("frame", fontsize=7.5, color=INK)
    legend(figure, handles, (), "outside upper center", 3)
    save(figure, NOTE_FRAMES, folder, "published_frames")


def variants(rows: Sequence[PublishedRow], folder: Path) -> None:
    """Errors when mass, spring constant (a row a scene) and the flag's wind are changed."""
    longest = max(r.frames for r in rows if r.table in VARIED)
    free = [r for r in rows if r.table in VARIED and r.measure == "error" and r.frames == longest]
    scenes = [s for s in SCENES if any(r.scene == s for r in free)]
    figure, panels = _grid(len(scenes), 3)
    handles: dict[str, Any] = {}
    for row, scene in zip(panels, scenes, strict=True):
        mine = [r for r in free if r.scene == scene]
        ends = min(r.value for r in mine if r.method in LOOKS), max(r.value for r in mine)
        for axes, (table, label) in zip(row, VARIED.items(), strict=True):
            if table == "fig15" and scene != "Flag":
                axes.set_axis_off()
                continue
            values = list(dict.fromkeys(r.options for r in mine if r.table == table))
            axes.set_yscale("log")
            for method, (name, color, marker, line) in LOOKS.items():
                for protocol, fill in (("free", color), ("oracle", "white")):
                    this = [r for r in mine if (r.table, r.method, r.protocol) == (table, method, protocol)]
                    found = {r.options: r.value for r in this}
                    at = [k for k, value in enumerate(values) if value in found]
                    if not at:
                        continue
                    (drawn,) = axes.plot(
                        at, [found[values[k]] for k in at], color=color, marker=marker, mfc=fill, mew=1,
                        ms=5 if protocol == "oracle" else 3 + 1.6 * WIDE.get(method, 1.3),
                        ls=line if protocol == "free" else ":", lw=1.2 if protocol == "free" else 0.8,
                    )  # fmt: skip
                    if protocol == "free":
                        handles[name] = drawn
            axes.set_xlim(-0.3, len(values) - 0.7)
            axes.set_ylim(ends[0] / 1.5, ends[1] * 1.6)
            dress(axes, f"{scene}, {label}")
            axes.set_xticks(range(len(values)), [value.split("=")[1] for value in values])
        row[0].set_ylabel("mean vertex error [m]", fontsize=7.5, color=INK)
    legend(figure, handles, (), "outside upper center", 3)
    save(figure, NOTE_VARIED, folder, "published_variants")


def _grid(rows: int, columns: int) -> tuple[Any, Any]:
    figure = import_figure()(figsize=(WIDTH, PANEL * rows + 0.7), layout="constrained")
    figure.get_layout_engine().set(hspace=0.05, wspace=0.04)
    return figure, figure.subplots(rows, columns, squeeze=False)
