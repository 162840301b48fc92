"""Beside Chen et al. 2020: how published networks converge (fig. 13), from rows; pictures of cloths (figs. 9-12)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.utils.seeding import np_random
from PIL import Image, ImageDraw, ImageFont

from cloth_envs.files import replacing
from cloth_envs.progress import progress
from cloth_envs.state import State
from cloth_envs.style import INK, import_figure
from cloth_envs.world import World
from surrogates.superres.features import FRAMES, SCALE
from surrogates.superres.network import SuperResolution
from surrogates.superres.synchronised import Synchronised
from training.bench.charts import WIDTH, dress, legend, save
from training.superres.convergence import CONVERGENCE, FEATURES, ConvergenceRow

# network -> name, colour (Okabe & Ito 2008), line.
LOOKS = {
    "all": ("residual dense blocks (RDN), all losses", "#0072B2", "-"),
    "all-srresnet": ("SRResNet, all losses", "#D55E00", "--"),
    "d": ("RDN, displacements alone", "#56B4E9", ":"),
    "mesh-sr": ("mesh SR: SRResNet, displacements alone", "#E69F00", "-."),
}
NOTE = (
    "PSNR of normalised images of the sequences for testing, which plain interpolation has 59 dB of in displacement. "
    "Equal seconds on an H100 that others used too, at a rate that falls along a cosine: 1,031 to 2,444 steps, some "
    "30,000 in the paper. A feature is shown of networks that have it in their loss."
)
PICTURES = "superres_pictures"
# Scene, sequence for testing, frame, what of a square picture is shown: left, upper, right, lower share.
SHOWN = (
    ("Draping", 11, 50, (0.22, 0.02, 0.70, 0.66)),
    ("Hitting", 33, 34, (0.34, 0.08, 0.76, 0.64)),
    ("Hitting", 34, 60, (0.22, 0.08, 0.64, 0.64)),
    ("Skirt", 6, 60, (0.30, 0.32, 0.63, 0.76)),
)
COLUMNS = ("coarse cloth", "bicubic", "super-resolved (mfsr)", "fine, tracked")
SIZE, LARGE = (255, 340), 1200  # pixels: of a picture, of the square that it is cut from
TITLE, GAP = 28, 6  # pixels: a line of text, between columns


def draw(rows: Mapping[str, Sequence[Any]], folder: Path, setup: str) -> None:
    """A panel a feature, if there are rows of it."""
    found: Sequence[ConvergenceRow] = rows.get(CONVERGENCE, ())
    if not found:
        return
    figure = import_figure()(figsize=(WIDTH, 2.6), layout="constrained")
    handles: dict[str, Any] = {}
    for axes, feature in zip(figure.subplots(1, len(FEATURES), sharex=True), FEATURES, strict=True):
        for network, (name, color, line) in LOOKS.items():
            mine = [r for r in found if (r.network, r.feature, r.weighed) == (network, feature, 1)]
            if mine:
                at = [r.seconds for r in mine], [r.psnr for r in mine]
                (handles[name],) = axes.plot(*at, color=color, ls=line, lw=1.5)
        dress(axes, feature)
        axes.set_xlabel("seconds of training", fontsize=7.5, color=INK)
    figure.axes[0].set_ylabel("PSNR [dB]", fontsize=7.5, color=INK)
    legend(figure, handles, (), "outside upper center", 2)
    save(figure, NOTE, folder, CONVERGENCE)


def cloths(scene: str, sequence: int, frames: int) -> tuple[World, list[np.ndarray]]:
    """The world of a synchronised pair after so many frames, and the cloths of ``COLUMNS``, ``(1, 3, H, W)`` each."""
    backend = f"{Synchronised.__module__}:{Synchronised.__qualname__}"
    world = World(scene, preset={"name": "chen2020", "sequence": sequence}, backend=backend)
    world.reset({0: np_random(sequence)[0]})
    pair: Any = world.backend
    path: list[State] = []
    for _ in range(frames):
        world.step(np.zeros((1, len(world.task.actions))))
        path = [*path[1 - FRAMES :], pair.coarse.copy()]
    up, coarse = SuperResolution(pair.coarse_scene, world.scene, SCALE), path[-1].positions
    return world, [coarse, up.bicubic(coarse), up.positions(path), world.state.positions]


def pictures(folder: Path) -> None:
    """``superres_pictures.png``: a row for each of ``SHOWN``, a column for each of ``COLUMNS``."""
    from cloth_envs.rendering import Renderer

    (width, height), shown = SIZE, list(progress(SHOWN, PICTURES, unit="picture", name=lambda one: one[0]))
    right, below = width + GAP, height + TITLE
    sheet = Image.new("RGB", (right * len(COLUMNS) - GAP, TITLE + below * len(shown)), "white")
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(16)
    for column, name in enumerate(COLUMNS):
        pen.text((right * column + 4, 4), name, INK, font)
    for row, (scene, sequence, frames, corners) in enumerate(shown):
        (world, made), renderers = cloths(scene, sequence, frames), dict[tuple[int, ...], Any]()
        box: Any = tuple(round(LARGE * at) for at in corners)
        for column, cloth in enumerate(made):
            state = replace(world.state, positions=cloth, velocities=np.zeros_like(cloth))
            if cloth.shape not in renderers:
                renderers[cloth.shape] = Renderer(world.scene, width=LARGE, height=LARGE)
            pixels = renderers[cloth.shape].draw(state)
            picture = Image.fromarray(pixels).crop(box).resize(SIZE, Image.Resampling.LANCZOS)
            sheet.paste(picture, (right * column, 2 * TITLE + below * row))
        for renderer in renderers.values():
            renderer.close()
        pen.text((4, TITLE + below * row + 4), f"{scene}, sequence {sequence}, frame {frames}", INK, font)
    with replacing(folder / f"{PICTURES}.png") as part:
        sheet.quantize(256, kmeans=3).save(part, "png", optimize=True)
