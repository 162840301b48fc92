"""Beside Lee 2019: errors by frame (figs. 9-12) and of variants (figs. 13-15), from rows only; pictures of cloths."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from PIL import Image, ImageDraw, ImageFont

from cloth_envs.style import INK, import_figure
from training.bench.charts import SHADE, WIDTH, dress, legend, save
from training.bench.papers import runs
from training.bench.papers.published import TABLE_7, FrameErrorRow, PublishedRow
from training.bench.papers.runs import UNSCALED
from training.generate import HISTORY, miniature
from training.upscaler.recipes import SCENES, work_folder

# method -> name, colour (Okabe & Ito 2008), marker, line.
LOOKS: dict[str, tuple[str, str, str, str]] = {
    "bilinear": ("bilinear", "#8a6d1f", "1", ":"),
    "bicubic": ("bicubic", "#E69F00", "^", "-"),
    "hdnn": ("triangle network, same miniature", "#CC79A7", "s", "-"),
    "fc": ("network, 4*FC-64", "#0072B2", "o", "-"),
    UNSCALED: ("H-DNN-like: triangle network, unscaled", "#D55E00", "P", "--"),
    "local": ("local network", "#009E73", "D", "-"),
}
WIDE = {"bicubic": 3.0, "hdnn": 2.0, "fc": 1.0}  # so that lines that coincide are seen
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
# Scene, the preset's options, how many frames.
SHOWN: list[tuple[str, dict[str, float], int]] = [("Curtain", {}, 30), ("Flag", {}, 60), ("Collision", {}, 50)]
SHOWN += [("Flag", {"wind": -12.0}, 60)]
COLUMNS = (
    "P-ADMM, the teacher",
    "H-DNN-like",
    "network, real miniature",
    "network, oracle inputs",
    "bicubic (flag: local network), oracle",
)
SIZE, TITLE = (300, 225), 22  # pixels


def draw(rows: Mapping[str, Sequence[Any]], folder: Path, setup: str) -> None:
    """Both charts, as far as there are rows."""
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
            curves: dict[str, list[tuple[int, float]]] = {}
            for p in sorted((p for p in mine if p.protocol == protocol), key=lambda p: p.frame):
                curves.setdefault(p.method, []).append((p.frame, p.error))
            for method, (name, color, _, line) in LOOKS.items():
                if method in curves:
                    style = {"color": color, "ls": line, "lw": WIDE.get(method, 1.3)}
                    (handles[name],) = axes.plot(*zip(*curves[method], strict=True), **style)
            if chaos := curves.get("teacher nudged"):
                axes.fill_between(*zip(*chaos, strict=True), 1e-9, color=SHADE, alpha=0.5, lw=0, zorder=1)
            for value in TABLE_7[scene] if protocol == "free" else ():
                axes.axhline(value, color=INK, ls=(0, (1, 2)), lw=1, zorder=2)
            axes.set(xlim=(0, 100), ylim=(max(bottom, 1e-5) / 1.5, top * 1.6))
            dress(axes, f"{scene}, {'oracle inputs' if protocol == 'oracle' else 'real miniature, free run'}")
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
                for protocol in ("free", "oracle"):
                    this = [r for r in mine if (r.table, r.method, r.protocol) == (table, method, protocol)]
                    if not this:
                        continue
                    style = {"mfc": color, "ls": line, "lw": 1.2, "ms": 3 + 1.6 * WIDE.get(method, 1.3)}
                    if protocol == "oracle":
                        style = {"mfc": "white", "ls": ":", "lw": 0.8, "ms": 5}
                    at = sorted((values.index(r.options), r.value) for r in this)
                    (drawn,) = axes.plot(*zip(*at, strict=True), color=color, marker=marker, mew=1, **style)
                    if protocol == "free":
                        handles[name] = drawn
            axes.set(xlim=(-0.3, len(values) - 0.7), ylim=(ends[0] / 1.5, ends[1] * 1.6))
            dress(axes, f"{scene}, {label}")
            axes.set_xticks(range(len(values)), [value.split("=")[1] for value in values])
    legend(figure, handles, (), "outside upper center", 3)
    save(figure, NOTE_VARIED, folder, "published_variants")


def _grid(rows: int, columns: int) -> tuple[Any, Any]:
    figure = import_figure()(figsize=(WIDTH, PANEL * rows + 0.7), layout="constrained")
    figure.get_layout_engine().set(hspace=0.05, wspace=0.04)
    panels = figure.subplots(rows, columns, squeeze=False)
    for axes in panels[:, 0]:
        axes.set_ylabel("mean vertex error [m]", fontsize=7.5, color=INK)
    return figure, panels


def pictures(path: Path) -> None:
    """Figures 10, 11, 12 and 15: a row for each of ``SHOWN``, a column for each of ``COLUMNS``."""
    from cloth_envs.rendering import Renderer

    width, height = SIZE
    sheet = Image.new("RGB", (width * len(COLUMNS), TITLE + height * len(SHOWN)), "white")
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(14)
    for column, name in enumerate(COLUMNS):
        pen.text((width * column + 6, 3), name, "#2b3640", font)
    for row, (scene, options, frames) in enumerate(SHOWN):
        run = runs.teacher(scene, frames, options)
        up = runs.upscalers(run, 2, ("bicubic", "hdnn", "fc"), work_folder() / "weights")
        real, oracle = miniature(run, 2, 0, frames), runs.decimated(run, 2)
        shown = [("hdnn", miniature(run, 2, 0, frames, **runs.unscaled(2))), ("fc", real), ("fc", oracle)]
        shown += [("local" if "local" in up else "bicubic", oracle)]
        cloths = [up[name].positions(states[: HISTORY + frames][-HISTORY:]) for name, states in shown]
        renderer: Any = Renderer(run.scene)
        for column, cloth in enumerate([run.states[frames].positions, *cloths]):
            pixels = renderer.draw(replace(run.states[frames], positions=cloth))
            picture = Image.fromarray(pixels).resize(SIZE, Image.Resampling.LANCZOS)
            sheet.paste(picture, (width * column, TITLE + height * row))
        renderer.close()
        note = f"{scene}, frame {frames}" + (", wind turned round" if options else "")
        pen.text((6, TITLE + height * row + 4), note, "#2b3640", font)
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path, optimize=True)
