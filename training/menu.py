"""What ``minicloth bench`` and ``minicloth train`` list when they are given no name."""

import ast
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

from cloth_envs.presets import load_preset
from cloth_envs.registry import PRESETS
from training import TRAININGS
from training.bench.benchmark import BENCHMARKS


def about(module: str) -> str:
    """What a module's docstring says of its command; read, not imported: the module may need what is missing."""
    spec = find_spec(module)
    text = ast.get_docstring(ast.parse(Path(spec.origin).read_text(encoding="utf-8"))) if spec and spec.origin else None
    return (text or "").split("\n")[0].partition(": ")[2]


def menu(command: str, table: Mapping[str, str]) -> str:
    """A line for each name of ``table``, which holds its module."""
    width = max(map(len, table))
    lines = [f"  {name:{width}}  {about(module.partition(':')[0])}" for name, module in table.items()]
    return "\n".join([f"usage: minicloth {command} NAME [options], where NAME is one of", *lines])


def benchmarks() -> str:
    """The menu of ``minicloth bench``."""
    return menu("bench", {**BENCHMARKS, "all": "training.bench.everything"})


def trainings() -> str:
    """The menu of ``minicloth train``."""
    return menu("train", TRAININGS)


def teachers() -> str:
    """What ``minicloth generate`` can be given."""
    found = [
        f"{scene} (--preset {preset})"
        for preset, scenes in PRESETS.items()
        for scene in scenes
        if {"mass", "spring"} <= set(load_preset(scene, preset).options)
    ]
    head = "usage: minicloth generate SCENE [options], where SCENE is any with --pairs synchronised, else one of"
    return "\n  ".join([head, *found])
