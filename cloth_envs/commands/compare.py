"""``minicloth compare``: one scene, several backends or resolutions, side by side."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.commands import chart, tables
from cloth_envs.commands.entries import choose_entries
from cloth_envs.commands.measure import REPEATS, Comparison, compare
from cloth_envs.commands.outputs import fixed_camera, import_imageio, open_video
from cloth_envs.files import check_folder, write_text
from cloth_envs.naming import counted
from cloth_envs.policies import open_loop
from cloth_envs.progress import announce, progress
from cloth_envs.registry import load_task
from cloth_envs.rendering import Renderer
from cloth_envs.rendering.canvas import CAPTION_HEIGHT, import_pyvista
from cloth_envs.style import import_figure

VIEW = 480, 480  # pixels of one picture
ABREAST = 4  # pictures in a row


def compare_scene(
    scene: str,
    *,
    backends: Sequence[str],
    resolutions: Sequence[str],
    frames: int,
    seed: int,
    policy: str,
    material: str | Mapping[str, float] | None,
    self_contact: bool | None,
    horizon: int,
    out: str | None,
    video: bool,
) -> str:
    """Measure, then film; writes ``compare_<scene>.csv .md .png .svg .mp4`` and returns the table.

    Raises:
        ValueError, OSError, ImportError: a bad name or number, a folder that can't be written, a package
            that is missing; nothing has been simulated by then.
    """
    chosen = choose_entries(scene, backends=backends, resolutions=resolutions)
    task = load_task(scene)
    actions = open_loop(policy, frames, len(task.actions), task.frame_dt, seed)
    folder = check_folder(out or f"compare_{scene.lower()}")
    import_figure()
    if video:
        import_imageio()
        import_pyvista()
    stem = folder / f"compare_{scene.lower()}"
    kinds = ["csv", "md", "png", "svg"] + (["mp4"] if video else [])
    old = [kind for kind in kinds if stem.with_suffix(f".{kind}").exists()]
    announce(
        f"{scene}: {', '.join(entry.label for entry in chosen)} over {counted(frames, 'frame')} beside the truth, each "
        f"timed {REPEATS} times; table, chart{' and video' if video else ''} go into {folder} in the end"
        + (f", which replaces {stem}.{{{','.join(old)}}}" if old else "")
    )
    result = compare(
        scene, chosen, actions, seed=seed, material=material, self_contact=self_contact, resolution=task.resolution
    )
    fabric = "" if material is None else f", material {material}"
    fabric += {None: "", True: ", with self-contact", False: ", without self-contact"}[self_contact]
    setup = f"{scene}, {frames} frames of {task.frame_dt * 1e3:g} ms, seed {seed}, {policy} actions{fabric}"
    table, notes = tables.markdown(result), tables.notes(result, setup)
    tables.write_csv(result, stem.with_suffix(".csv"))
    write_text(stem.with_suffix(".md"), f"# {scene}: speed and error\n\n{table}\n\n{notes}")
    nearest = max((h for h in result.horizons if h <= horizon), default=result.horizons[0])
    chart.draw(result, [stem.with_suffix(".png"), stem.with_suffix(".svg")], horizon=nearest, setup=setup)
    if video:
        film(result, stem.with_suffix(".mp4"))
    return f"{table}\n\n{notes}\nwrote {stem}.{{{','.join(kinds)}}}"


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
    with open_video(path, 1 / comparison.scene.frame_dt) as add:
        for frame in progress(range(frames), "video", unit="frame"):
            lines = []
            for row, renderer in zip(rows, renderers, strict=True):
                line = renderer.draw([result.states[min(frame, len(result.states) - 1)] for result in row])
                empty = VIEW[0] * columns - line.shape[1]
                lines.append(np.pad(line, ((0, 0), (0, empty), (0, 0)), constant_values=255))
            add(np.concatenate(lines, 0))
    for renderer in renderers:
        renderer.close()
