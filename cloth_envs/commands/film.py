"""The video of a comparison."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from cloth_envs.commands.measure import Comparison
from cloth_envs.commands.outputs import fixed_camera, open_video
from cloth_envs.rendering import Renderer
from cloth_envs.rendering.renderer import CAPTION_HEIGHT

VIEW = 480, 480  # pixels of one picture
ABREAST = 4  # pictures in a row


def film(comparison: Comparison, path: Path) -> None:
    """All free runs side by side, in rows of four, at the simulated speed; a failed run stands still."""
    results = comparison.results
    rows = [results[i : i + ABREAST] for i in range(0, len(results), ABREAST)]
    columns = len(rows[0])
    camera = fixed_camera(
        comparison.scene, [r.states for r in results], aspect=VIEW[0] / VIEW[1], below=CAPTION_HEIGHT / VIEW[1]
    )
    renderers = []
    for row in rows:
        captions = [f"{r.entry.label}\n{r.ms[1]:.2g} ms/frame{', ' + r.failure if r.failure else ''}" for r in row]
        size: dict[str, Any] = {"width": VIEW[0] * len(row), "height": VIEW[1], "camera": camera}
        renderers.append(Renderer(comparison.scene, views=len(row), captions=captions, **size))
    frames = max(len(result.states) for result in results)
    with open_video(path, 1 / comparison.scene.frame_dt) as stream:
        for frame in tqdm(range(frames), "video", unit="frame", disable=None):
            lines = []
            for row, renderer in zip(rows, renderers, strict=True):
                line = renderer.draw([result.states[min(frame, len(result.states) - 1)] for result in row])
                empty = VIEW[0] * columns - line.shape[1]
                lines.append(np.pad(line, ((0, 0), (0, empty), (0, 0)), constant_values=255))
            stream.append_data(np.concatenate(lines, 0))
    for renderer in renderers:
        renderer.close()
