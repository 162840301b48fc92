"""``minicloth list``: what there is."""

import inspect

from cloth_envs.material import FABRICS
from cloth_envs.policies import POLICIES
from cloth_envs.presets import load_preset, presets_of
from cloth_envs.registry import EPISODE_FRAMES, PRESETS, SCENES, backend_names, env_id, load_backend, load_task


def table(rows: list[list[str]]) -> str:
    """Columns as wide as their longest entry."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return "\n".join(lines)


def about_backend(name: str) -> str:
    """The first line of a backend's docstring, or why it can't be used."""
    try:
        return (inspect.getdoc(load_backend(name)) or "").split("\n")[0]
    except (ValueError, ImportError) as error:
        return str(error)


def _default(value: float | str) -> str:
    """An option's default as text."""
    return f"{value:g}" if isinstance(value, float | int) else repr(value)


def everything() -> str:
    """Scenes, presets, backends, fabrics and policies as text."""
    scenes = [["scene", "grid", "frame", "episode", "action, each in [-1, 1]"]]
    for name in SCENES:
        task = load_task(name)
        rows, cols = task.resolution
        frames = EPISODE_FRAMES[name]
        episode = f"{frames} frames, {frames * task.frame_dt:g} s"
        scenes.append([name, f"{rows} x {cols}", f"{task.frame_dt * 1e3:g} ms", episode, ", ".join(task.actions)])
    presets = [["preset", "of the scenes", "grid", "options and defaults"]]
    for name, of in PRESETS.items():
        tasks = [load_preset(scene, name) for scene in of]
        grids = ", ".join(dict.fromkeys(f"{task.resolution[0]} x {task.resolution[1]}" for task in tasks))
        options = {option: value for task in tasks for option, value in task.options.items()}
        presets.append(
            [name, ", ".join(of), grids, ", ".join(f"{o} {_default(value)}" for o, value in options.items())]
        )
    backends = [[name, about_backend(name)] for name in backend_names()]
    fabrics = [["fabric", "kg/m^2", "stretch N/m", "shear N/m", "bend N m"]]
    for name, m in FABRICS.items():
        numbers = (m.areal_density, m.stretch_stiffness, m.shear_stiffness, m.bend_stiffness)
        fabrics.append([name, *(f"{value:g}" for value in numbers)])
    both = "Each is there as version 1 too, a task revised to be worth learning: Flag-v1, MiniCloth-Flag-v1 and so on."
    parts = [table(scenes), both, table(presets), table([["backend", ""], *backends]), table(fabrics)]
    parts.append(table([["policy", ""], *([name, text] for name, text in POLICIES.items())]))
    return "\n\n".join(parts)


def scene(name: str) -> str:
    """What one scene models, and its task. Raises ValueError: an unknown scene; the nearest match is named."""
    task = load_task(name)
    world = task.make_scene(resolution=task.resolution, material=task.material)
    parts = [env_id(name), world.describe(), inspect.getdoc(task) or ""]
    parts += [f'preset="{preset}"\n\n{inspect.getdoc(load_preset(name, preset))}' for preset in presets_of(name)]
    return "\n\n".join(parts)
