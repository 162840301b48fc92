"""``minicloth compare``: one scene, several backends or resolutions, side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tqdm import tqdm

from cloth_envs.commands import chart, tables
from cloth_envs.commands.entries import choose_entries
from cloth_envs.commands.film import film
from cloth_envs.commands.measure import compare
from cloth_envs.commands.outputs import import_imageio
from cloth_envs.files import check_folder
from cloth_envs.policies import open_loop
from cloth_envs.registry import load_task
from cloth_envs.rendering.renderer import import_pyvista
from cloth_envs.style import import_figure

FRAMES, HORIZON = 120, 10


def compare_scene(
    scene: str,
    *,
    backends: Sequence[str] = (),
    resolutions: Sequence[str] = (),
    frames: int = FRAMES,
    seed: int = 0,
    policy: str = "smooth",
    material: str | Mapping[str, float] | None = None,
    horizon: int = HORIZON,
    out: str | None = None,
    video: bool = True,
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
    with tqdm(total=2 + len(chosen), desc="physics", disable=None) as bar:

        def report(stage: str) -> None:
            bar.set_postfix_str(stage)
            bar.update()

        result = compare(
            scene, chosen, actions, seed=seed, material=material, resolution=task.resolution, report=report
        )
    fabric = "" if material is None else f", material {material}"
    setup = f"{scene}, {frames} frames of {task.frame_dt * 1e3:g} ms, seed {seed}, {policy} actions{fabric}"
    stem = folder / f"compare_{scene.lower()}"
    table, notes = tables.markdown(result), tables.notes(result, setup)
    tables.write_csv(result, stem.with_suffix(".csv"))
    stem.with_suffix(".md").write_text(f"# {scene}: speed and error\n\n{table}\n\n{notes}")
    nearest = max((h for h in result.horizons if h <= horizon), default=result.horizons[0])
    chart.draw(result, [stem.with_suffix(".png"), stem.with_suffix(".svg")], horizon=nearest, setup=setup)
    if video:
        film(result, stem.with_suffix(".mp4"))
    kinds = "csv,md,png,svg" + (",mp4" if video else "")
    return f"{table}\n\n{notes}\nwrote {stem}.{{{kinds}}}"
