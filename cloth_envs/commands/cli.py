"""The ``minicloth`` command; what it does is in ``cloth_envs.commands``, imported when it is asked for."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from cloth_envs.commands.checkout import load
from cloth_envs.commands.parser import parser
from cloth_envs.naming import unknown_name


def _list(given: argparse.Namespace) -> str:
    from cloth_envs.commands import listing

    return listing.everything() if given.scene is None else listing.scene(given.scene)


def _rollout(given: argparse.Namespace) -> str:
    from cloth_envs.backend import parse_backend
    from cloth_envs.commands.entries import read_resolution
    from cloth_envs.commands.rollout import rollout

    backend, options = parse_backend(given.backend)
    return rollout(
        given.scene,
        frames=given.frames,
        seed=given.seed,
        policy=given.policy,
        backend=backend,
        backend_kwargs=options,
        material=_named(given.material, "--material"),
        resolution=None if given.resolution is None else read_resolution(given.resolution),
        preset=_named(given.preset, "--preset"),
        video=given.video,
        images=given.images,
        hdf5=given.hdf5,
        strain=given.strain,
        overwrite=given.overwrite,
    )


def _render(given: argparse.Namespace) -> str:
    from cloth_envs.commands.rollout import render

    return render(given.file, trajectory=given.trajectory, video=given.video, images=given.images, strain=given.strain)


def _compare(given: argparse.Namespace) -> str:
    from cloth_envs.commands.compare import compare_scene

    return compare_scene(
        given.scene,
        backends=given.backend,
        resolutions=_names(given.resolutions),
        frames=given.frames,
        seed=given.seed,
        policy=given.policy,
        material=_named(given.material, "--material"),
        horizon=given.horizon,
        out=given.out,
        video=not given.no_video,
    )


def _bench(given: argparse.Namespace) -> NoReturn:
    sys.exit(load("training.bench.benchmark:find")(given.benchmark).main(given.options))


def _train(given: argparse.Namespace) -> NoReturn:
    _run("training", load("training:TRAININGS"), given.training, given.options)


def _generate(given: argparse.Namespace) -> NoReturn:
    sys.exit(load("training.generate:main")([given.scene, *given.options]))


def _report(given: argparse.Namespace) -> str:
    own = Path("docs/data"), Path("docs/images")
    data, images = own if given.data is None else (given.data, given.data)
    return load("training.bench.report.run:write")(data, given.images or images, given.out)


def _run(kind: str, table: Mapping[str, str], name: str, options: Sequence[str]) -> NoReturn:
    """Call ``main(options)`` of the module that ``table`` has for ``name``, and leave with what it returns."""
    if name not in table:
        raise unknown_name(kind, name, table)
    sys.exit(load(table[name])(options))


def _named(text: str | None, option: str) -> Any:
    """A fabric's or a preset's name, or a JSON object."""
    from cloth_envs.backend import read_object

    return read_object(text, option) if text and text.lstrip().startswith("{") else text


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


RUNS: dict[str, Callable[[argparse.Namespace], str | None]] = {
    "list": _list,
    "rollout": _rollout,
    "render": _render,
    "compare": _compare,
    "bench": _bench,
    "report": _report,
    "generate": _generate,
    "train": _train,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command. Returns the exit code: 0, 2 for what the user can put right, 130 when interrupted."""
    given = parser(RUNS).parse_args(argv)
    try:
        text = given.run(given)
        if text:
            print(text, flush=True)
    except BrokenPipeError:  # whoever reads the output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (ValueError, OSError, ImportError) as error:
        print(f"minicloth: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
