"""Pictures of figures 10, 11, 12 and 15 of Lee 2019: the teacher's cloth beside those that it is compared with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from cloth_envs.state import State
from training.bench.papers.runs import HISTORY, decimated, miniature, teacher, unscaled, upscalers
from training.rollouts import Recording
from training.upscaler.recipes import work_folder

# Scene, the preset's options, how many frames.
SHOWN: tuple[tuple[str, dict[str, float], int], ...] = (
    ("Curtain", {}, 30),
    ("Flag", {}, 60),
    ("Collision", {}, 50),
    ("Flag", {"wind": -12.0}, 60),
)
COLUMNS = (
    "P-ADMM, the teacher",
    "H-DNN-like",
    "network, real miniature",
    "network, oracle inputs",
    "bicubic (flag: local network), oracle",
)
SIZE, TITLE = (300, 225), 22  # pixels


def positions(run: Recording, frames: int) -> list[np.ndarray]:
    """The cloth ``(1, 3, H, W)`` of each column after ``frames`` frames."""
    up = upscalers(run, 2, ("bicubic", "hdnn", "fc"), work_folder() / "weights")
    alone, real, oracle = (
        states[: HISTORY + frames][-HISTORY:]
        for states in (miniature(run, 2, 0, frames, **unscaled(2)), miniature(run, 2, 0, frames), decimated(run, 2))
    )
    wanted = (("hdnn", alone), ("fc", real), ("fc", oracle), ("local" if "local" in up else "bicubic", oracle))
    inferred = [up[name].positions(states) for name, states in wanted]
    return [run.states[frames].positions, *inferred]


def draw(path: Path) -> None:
    """A row for each of ``SHOWN``, a column for each of ``COLUMNS``."""
    from cloth_envs.rendering import Renderer

    width, height = SIZE
    sheet = Image.new("RGB", (width * len(COLUMNS), TITLE + height * len(SHOWN)), "white")
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(14)
    for column, name in enumerate(COLUMNS):
        pen.text((width * column + 6, 3), name, "#2b3640", font)
    for row, (scene, options, frames) in enumerate(SHOWN):
        run = teacher(scene, frames, options)
        renderer: Any = Renderer(run.scene)
        at: State = run.states[frames]
        for column, field in enumerate(positions(run, frames)):
            picture = Image.fromarray(renderer.draw(replace(at, positions=field))).resize(
                SIZE, Image.Resampling.LANCZOS
            )
            sheet.paste(picture, (width * column, TITLE + height * row))
        renderer.close()
        note = f"{scene}, frame {frames}" + (", wind turned round" if options else "")
        pen.text((6, TITLE + height * row + 4), note, "#2b3640", font)
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path, optimize=True)
