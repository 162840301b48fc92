"""Scenes and backends by name. To add one, add one line here."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from cloth_envs.naming import unknown_name

# name -> "module:Task class"; the Gymnasium id is MiniCloth-<name>-v0.
SCENES: dict[str, str] = {
    "Curtain": "cloth_envs.scenes.curtain:Curtain",
    "Flag": "cloth_envs.scenes.flag:Flag",
    "Collision": "cloth_envs.scenes.collision:Collision",
    "Pressure": "cloth_envs.scenes.pressure:Pressure",
    "Hanging": "cloth_envs.scenes.hanging:Hanging",
    "BallDrop": "cloth_envs.scenes.ball_drop:BallDrop",
}

# Frames of an episode, kept here so that registering with Gymnasium imports no scene.
EPISODE_FRAMES: dict[str, int] = {
    "Curtain": 200,
    "Flag": 200,
    "Collision": 200,
    "Pressure": 250,
    "Hanging": 250,
    "BallDrop": 200,
}

# preset -> scene -> "module:Task class", resolved on use; see cloth_envs.presets.
PRESETS: dict[str, dict[str, str]] = {
    "lee2019": {
        "Curtain": "cloth_envs.presets.lee2019:Curtain2019",
        "Flag": "cloth_envs.presets.lee2019:Flag2019",
        "Collision": "cloth_envs.presets.lee2019:Collision2019",
    },
    "zhao2024": {
        "Pressure": "cloth_envs.presets.zhao2024:Blow2024",
        "Hanging": "cloth_envs.presets.zhao2024:Hang2024",
        "BallDrop": "cloth_envs.presets.zhao2024:Ball2024",
    },
    "zhao2024-fall": {"Pressure": "cloth_envs.presets.zhao2024:Fall2024"},
}

# name -> "module:class or function that makes a Backend", resolved on use.
BACKENDS: dict[str, str] = {
    "cnn": "surrogates.cell.backend:cnn",
    "reference": "cloth_envs.physics.solver:reference",
    "miniature": "surrogates.miniature.backend:MiniatureBackend",
}


def env_id(scene: str) -> str:
    """The Gymnasium id of a scene."""
    return f"MiniCloth-{scene}-v0"


def _load(table: dict[str, str], what: str, name: object) -> Any:
    if not isinstance(name, str) or name not in table:
        raise unknown_name(what, name, table)
    module, attribute = table[name].split(":")
    return getattr(import_module(module), attribute)


def load_task(name: str) -> Any:
    """The Task class of a scene.

    Raises:
        ValueError: unknown scene; the nearest match is named.
    """
    return _load(SCENES, "scene", name)


def load_backend(name: str) -> Any:
    """The Backend class of a name.

    Raises:
        ValueError: unknown backend; the nearest match is named.
    """
    return _load(BACKENDS, "backend", name)
