"""What trainings share: their command line, and how the weights of a scene at a grid factor are kept."""

from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from cloth_envs.machine import header
from cloth_envs.parsing import Parser
from cloth_envs.progress import announce
from cloth_envs.registry import SCENES
from surrogates.checkpoint import WEIGHTS, add_factor, written
from training.cache import cache_folder
from training.rows import read_names

Recipe = TypeVar("Recipe")


def read(
    name: str, about: str | None, recipe: type[Recipe], options: Mapping[str, str], argv: Sequence[str] | None,
    *, factors: Sequence[int] = (), flag: tuple[str, str] | None = None,
) -> tuple[Namespace, Recipe]:  # fmt: skip
    """The command line of ``minicloth train <name>``, and the recipe that it tells by ``options`` (what they are).

    Raises:
        ValueError: an unknown scene.
    """
    parser = Parser(prog=f"minicloth train {name}", description=about)
    parser.add_argument("--scenes", nargs="*", default=list(SCENES))
    if factors:
        parser.add_argument("--factors", nargs="*", type=int, default=list(factors), choices=[2, 3, 4])
    if flag:
        parser.add_argument(flag[0], action="store_true", help=flag[1])
    for option, text in options.items():
        default = getattr(recipe, option)
        parser.add_argument(f"--{option}", type=type(default), default=default, help=f"{text} (default {default})")
    add_out(parser, Path("weights"))
    parser.add_argument("--cache", type=Path, default=cache_folder(name.replace("-", "_")), help="folder of the data")
    given = parser.parse_args(argv)
    given.scenes = read_names(",".join(given.scenes), list(SCENES), "scene")
    return given, recipe(**{option: getattr(given, option) for option in options})


def add_out(parser: Parser, folder: Path) -> None:
    """The option ``--out``, by default ``folder``: what the package ships is replaced only where that is asked for."""
    about = f"folder of the weights (default {folder}; environments use those in {WEIGHTS})"
    parser.add_argument("--out", type=Path, default=folder, help=about)


def plan(name: str, what: str, out: Path, work: Path) -> None:
    """Say what ``name`` is going to fit and where it goes."""
    announce(
        f"{name}: {what}\nWeights go into {out}, data and what is half done into {work}; stopped by Ctrl-C, the same "
        "command goes on."
    )


def is_done(name: str, factor: int, settings: Mapping[str, Any], out: Path) -> bool:
    """Whether ``out`` holds weights that were trained so."""
    return written(name, out).card.get(str(factor), {}).get("trained with") == settings


def keep(
    name: str, factor: int, arrays: Mapping[str, np.ndarray], settings: Mapping[str, Any], seconds: float,
    errors: Mapping[str, Any], card: Mapping[str, Any], out: Path,
) -> None:  # fmt: skip
    """Write weights with a card that tells ``errors`` (what these are, and their values)."""
    about = {**errors, "trained with": settings, "seconds": round(seconds, 1), "machine": header()}
    add_factor(name, factor, arrays, about, {**card, "licence": "MIT"}, out)
    print(f"wrote {out / name}.safetensors: factor {factor}, {seconds:.0f} s, {errors}", flush=True)
