"""Scenes and backends by name. To add one of this package, add one line here; others register from outside."""

import re
from collections.abc import Mapping
from importlib.metadata import entry_points
from inspect import signature
from typing import Any

from cloth_envs.backend import Backend, BackendFactory, check_keywords
from cloth_envs.naming import REVISED, resolve, unknown_name
from cloth_envs.scene import Scene

# name -> "module:Task class"; the Gymnasium ids are MiniCloth-<name>-v0 and, of the task as revised, -v1.
SCENES: dict[str, str] = {
    "Curtain": "cloth_envs.scenes.curtain:Curtain",
    "Flag": "cloth_envs.scenes.flag:Flag",
    "Collision": "cloth_envs.scenes.collision:Collision",
    "Pressure": "cloth_envs.scenes.pressure:Pressure",
    "Hanging": "cloth_envs.scenes.hanging:Hanging",
    "BallDrop": "cloth_envs.scenes.ball_drop:BallDrop",
    "Draping": "cloth_envs.scenes.draping:Draping",
    "Hitting": "cloth_envs.scenes.hitting:Hitting",
    "Skirt": "cloth_envs.scenes.skirt:Skirt",
}

# task, as Flag or Flag-v1 -> frames of an episode, kept here so that registering with Gymnasium imports no scene.
EPISODE_FRAMES: dict[str, int] = {
    name + version: {"Pressure": 250, "Hanging": 250, "Skirt": 400}.get(name, 200)
    for version in ("", REVISED)
    for name in SCENES
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
    "chen2020": {
        "Draping": "cloth_envs.presets.chen2020:Draping2020",
        "Hitting": "cloth_envs.presets.chen2020:Hitting2020",
        "Skirt": "cloth_envs.presets.chen2020:Skirt2020",
    },
}

# name -> what makes a Backend, or "module:class or function", resolved on use. Installed packages add theirs under
# GROUP, anybody by register_backend.
BACKENDS: dict[str, BackendFactory | str] = {
    "auto": "surrogates.auto.backend:AutoBackend",
    "cnn": "surrogates.cell.backend:cnn",
    "reference": "cloth_envs.physics.solver:reference",
    "mfsr": "surrogates.superres.backend:MfsrBackend",
    "miniature": "surrogates.miniature.make:miniature",
}
GROUP = "minicloth.backends"  # entry points: name -> module:attribute


def env_id(scene: str) -> str:
    """The Gymnasium id of a scene's task, which is named as ``Flag`` or ``Flag-v1``."""
    return f"MiniCloth-{scene}" if scene.endswith(REVISED) else f"MiniCloth-{scene}-v0"


def load_task(name: str) -> type[Any]:
    """The ``scenes.task.Task`` class of a scene, or of its revision as ``Flag-v1``.

    Raises:
        ValueError: unknown scene; the nearest match is named.
    """
    if not isinstance(name, str) or name not in EPISODE_FRAMES:
        short = re.fullmatch(r"(?:MiniCloth-)?(.+?)(?:-v0)?", str(name))  # the id is what gym.make takes
        raise unknown_name("scene", name, EPISODE_FRAMES, meant=short[1] if short else None)
    task: type[Any] = resolve(SCENES[name.removesuffix(REVISED)])
    return task.revised() if name.endswith(REVISED) else task


def register_backend(name: str, factory: BackendFactory | str, *, overwrite: bool = False) -> None:
    """Give a backend a name in this process; then ``gym.make(..., backend=name)`` and all commands know it.

    Args:
        name: without ``:``, ``=`` and ``@``, which have a meaning where backends are named in a line.
        factory: ``(scene, *, num_envs, **options) -> Backend``, or ``"module:attribute"``, which is imported on use.
        overwrite: replace what has the name.

    Raises:
        ValueError: a name that is taken or can't be one, or a factory of another form.
    """
    if not isinstance(name, str) or not name or set(name) & set(":=@"):
        raise ValueError(f"a backend's name is text without ':', '=' and '@', got {name!r}")
    if name in BACKENDS and not overwrite:
        raise ValueError(f"there is a backend {name!r}: choose another name, or pass overwrite=True")
    if not isinstance(factory, str):
        _check_factory(name, factory)
    BACKENDS[name] = factory


def backend_names() -> list[str]:
    """All that ``backend=`` can be beside ``"module:attribute"``: those of ``BACKENDS``, then installed ones."""
    return list(dict.fromkeys([*BACKENDS, *sorted(entry_points(group=GROUP).names)]))


def load_backend(name: str) -> BackendFactory:
    """What makes the backend ``name``: one of ``BACKENDS``, of an installed package, or ``"module:attribute"``.

    Raises:
        ValueError: an unknown name (the nearest match is named), module or attribute, or no factory.
        ImportError: a module that can't be imported; of an installed package that is named.
    """
    if not isinstance(name, str):
        raise ValueError(
            f"backend must be a name or 'module:Class', or of make_vec a list of them, got {name!r}: register_backend "
            "names a class"
        )
    known = BACKENDS.get(name, name if ":" in name else None)
    factory = _installed(name) if known is None else resolve(known) if isinstance(known, str) else known
    _check_factory(name, factory)
    return factory


def make_backend(
    name: str, scene: Scene, *, num_envs: int = 1, backend_kwargs: Mapping[str, Any] | None = None
) -> Backend:
    """The backend ``name`` for a batch of ``num_envs`` cloths of ``scene``.

    Raises:
        ValueError, ImportError: see ``load_backend``; an unknown keyword (the nearest match is named), or a factory
            that fails with it or makes no backend.
    """
    factory, given = load_backend(name), {} if backend_kwargs is None else backend_kwargs
    check_keywords(factory, given, f"backend={name!r}")
    try:
        made = factory(scene, num_envs=num_envs, **given)
    except TypeError as error:
        raise ValueError(f"backend {name!r} can't be built with {dict(given)!r}: {error}") from error
    lacks = [method for method in ("reset", "advance") if not callable(getattr(made, method, None))]
    if lacks:
        raise ValueError(
            f"backend {name!r} made {made!r} without {', '.join(lacks)}: cloth_envs.backend.Backend says what one has"
        )
    return made


def _check_factory(name: str, factory: Any) -> None:
    try:
        signature(factory).bind(None, num_envs=1)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"backend {name!r} can't be built: it must be a class or function (scene, *, num_envs, **options), "
            f"all options with defaults, got {factory!r} ({error})"
        ) from error


def _installed(name: str) -> BackendFactory:
    points = {point.value: point for point in entry_points(group=GROUP, name=name)}
    if not points:
        raise unknown_name("backend", name, backend_names())
    packages = ", ".join(sorted(point.dist.name if point.dist else point.module for point in points.values()))
    if len(points) > 1:
        raise ValueError(f"{packages} each have a backend {name!r}: name one as {' or '.join(sorted(points))}")
    (value,) = points
    try:
        factory: BackendFactory = resolve(value)
    except (ImportError, ValueError) as error:
        raise ImportError(f"backend {name!r} of the installed package {packages}: {error}, or uninstall it") from error
    return factory
