"""Presets: a paper's own set-up as a variant of a scene. With zero actions it does what the paper's scene does."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from cloth_envs.arguments import as_number
from cloth_envs.naming import resolve, unknown_name
from cloth_envs.registry import PRESETS, load_task
from cloth_envs.scenes.task import Task

# preset -> options of the reference backend with which the paper ran, where a user chooses no solver.
SOLVER_OF: dict[str, dict[str, Any]] = {"lee2019": {"solver": "admm", "iterations": 10}}


def solver_of(preset: str | Mapping[str, Any] | None) -> dict[str, Any]:
    """Options of the reference backend that a preset's paper used; empty for the default solver."""
    name = preset["name"] if isinstance(preset, Mapping) else preset
    return SOLVER_OF.get(name, {}) if name else {}


def load_preset(scene: str, preset: str | Mapping[str, Any]) -> type[Task]:
    """The Task class of ``scene`` in a preset: its name, or ``{"name": ..., option: number or text}``.

    Raises:
        ValueError: an unknown scene, preset or option (the nearest match is named), a preset that this scene
            does not have, or an option that is no finite number (or no text, where its default is) or out of its range.
    """
    load_task(scene)
    options: dict[str, Any] = dict(preset) if isinstance(preset, Mapping) else {"name": preset}
    name = options.pop("name", None)
    if name is None:
        raise ValueError(f'a preset as a dict needs its name, such as {{"name": "lee2019"}}, got {preset!r}')
    if not isinstance(name, str) or name not in PRESETS:
        raise unknown_name("preset", name, PRESETS)
    if scene not in PRESETS[name]:
        own = presets_of(scene)
        has = f"has {', '.join(map(repr, own))}" if own else "has none"
        of = ", ".join(PRESETS[name])
        raise ValueError(f"preset {name!r} exists for {of}, {scene} {has}: choose another preset or scene")
    task: type[Task] = resolve(PRESETS[name][scene])
    for option, value in options.items():
        if not task.options:
            raise ValueError(f'preset {name!r} of {scene} has no options: write preset="{name}" without {option!r}')
        if option not in task.options:
            raise unknown_name(f"option of preset {name!r}:", option, task.options)
        if isinstance(task.options[option], str):
            if not isinstance(value, str):
                raise ValueError(f"preset {name!r} needs text as {option}, got {value!r}")
            continue
        number = as_number(value)
        if number is None or not np.isfinite(number):
            raise ValueError(f"preset {name!r} needs a finite number as {option}, got {value!r}")
        options[option] = number
    return task.with_options(**options) if options else task


def presets_of(scene: str) -> list[str]:
    """Names of the presets that a scene has."""
    return [name for name, scenes in PRESETS.items() if scene in scenes]


def preset_with(scene: object, chosen: object, option: str, value: object) -> dict[str, Any] | None:
    """``chosen``, or the first of a scene's presets where that is None, with one more option; None if none takes it."""
    given = dict(chosen) if isinstance(chosen, Mapping) else {} if chosen is None else {"name": chosen}
    own = presets_of(scene) if isinstance(scene, str) else []
    for name in own if chosen is None else [name for name in own if name == given.get("name")]:
        if option in resolve(PRESETS[name][str(scene)]).options:
            return {**given, "name": name, option: value}
    return None
