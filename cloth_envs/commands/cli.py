"""The ``minicloth`` command; what it does is in ``cloth_envs.commands``, imported when it is asked for."""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

from cloth_envs.arguments import one_of
from cloth_envs.commands.parser import parser
from cloth_envs.extras import CHECKOUT, load, missing
from cloth_envs.naming import unknown_name

EXAMPLES = {
    "--material": '{"areal_density": 0.3}',
    "--preset": '{"name": "lee2019", "mass": 3}',
    "--randomize": '{"drag": [0.2, 0.8]}',
}  # of JSON


def _list(given: argparse.Namespace) -> str:
    from cloth_envs.commands import listing

    return listing.everything() if given.scene is None else listing.scene(given.scene)


def _rollout(given: argparse.Namespace) -> str:
    from cloth_envs.backend import parse_backend
    from cloth_envs.commands.entries import read_resolution
    from cloth_envs.commands.rollout import rollout
    from cloth_envs.places import check_backend_kwargs

    backend, options = parse_backend(given.backend)
    check_backend_kwargs(backend, options, shell=True)
    own = {"backend": backend, "backend_kwargs": options, "preset": _named(given.preset, "--preset")}
    if given.resolution is not None:
        own["resolution"] = read_resolution(given.resolution)
    return rollout(**_options(given) | own)


def _render(given: argparse.Namespace) -> str:
    from cloth_envs.commands.rollout import render

    return render(**_options(given))


def _export(given: argparse.Namespace) -> str:
    from cloth_envs.export import export

    return f"wrote {export(**_options(given))}"


def _compare(given: argparse.Namespace) -> str:
    from cloth_envs.commands.compare import compare_scene

    shapes = [shape.strip() for shape in given.resolutions.split(",") if shape.strip()]
    return compare_scene(**_options(given) | {"resolutions": shapes})


def _evaluate(given: argparse.Namespace) -> str:
    from cloth_envs.agents import trained_on
    from cloth_envs.backend import parse_backend, read_object
    from cloth_envs.commands.entries import read_resolution
    from cloth_envs.commands.evaluate import evaluate
    from cloth_envs.places import check_backend_kwargs

    options = _options(given) | {"preset": _named(given.preset, "--preset")}
    told, certify = options.pop("train_backend", None), parse_backend(options.pop("certify"))
    own = parse_backend(told) if told else trained_on(given.policy, given.scene) or ("miniature", {"factor": 4})
    physics = [own, certify]
    for name, kwargs in physics:
        check_backend_kwargs(name, kwargs, shell=True)
    if given.resolution is not None:
        options["resolution"] = read_resolution(given.resolution)
    if given.randomize is not None:
        options["randomize"] = read_object(given.randomize, "--randomize", EXAMPLES["--randomize"])
    return evaluate(**options, train=physics[0], certify=physics[1])


def _bench(given: argparse.Namespace) -> str:
    if given.benchmark is None:
        return load("training.menu:benchmarks")()
    if given.benchmark == "all":
        sys.exit(load("training.bench.everything:main")(given.options))
    sys.exit(load("training.bench.benchmark:find")(given.benchmark).main(given.options))


def _train(given: argparse.Namespace) -> str:
    if given.training is None:
        return load("training.menu:trainings")()
    table = load("training:TRAININGS")
    sys.exit(load(table[one_of("training", given.training, table)])(given.options))


def _generate(given: argparse.Namespace) -> str:
    if given.scene is None:
        return load("training.menu:teachers")()
    sys.exit(load("training.generate:main")([given.scene, *given.options]))


def _report(given: argparse.Namespace) -> str:
    write = load("training.bench.report.run:write")
    if given.out is None:
        raise ValueError("a report needs a name: write minicloth report --out OUT.html")
    own = CHECKOUT / "docs" / "data", CHECKOUT / "docs" / "images"
    data, images = own if given.data is None else (given.data, given.data)
    return write(data, given.images or images, given.out)


def _options(given: argparse.Namespace) -> dict[str, Any]:
    """What the command was given, by name; its material read."""
    options = {name: value for name, value in vars(given).items() if name != "run"}
    return options | ({"material": _named(given.material, "--material")} if "material" in options else {})


def _named(text: str | None, option: str) -> Any:
    """A fabric's or a preset's name, or a JSON object."""
    from cloth_envs.backend import read_object

    return read_object(text, option, EXAMPLES[option]) if text and text.lstrip().startswith("{") else text


RUNS: dict[str, Callable[[argparse.Namespace], str | None]] = {
    "list": _list,
    "rollout": _rollout,
    "render": _render,
    "export": _export,
    "compare": _compare,
    "evaluate": _evaluate,
    "bench": _bench,
    "report": _report,
    "generate": _generate,
    "train": _train,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command. Returns the exit code: 0, 2 for what the user can put right, 130 when interrupted."""
    words, top = list(sys.argv[1:] if argv is None else argv), parser(RUNS)
    if words and not words[0].startswith("-") and words[0] not in RUNS:
        top.error(str(unknown_name("command", words[0], RUNS)))
    if not words:
        top.print_help()
        return 0
    given = top.parse_args(words)
    try:
        text = given.run(given)
        if text:
            print(text, flush=True)
    except BrokenPipeError:  # whoever reads the output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (ValueError, OSError, ImportError) as error:
        text = missing("this command", error) if isinstance(error, ImportError) else str(error)
        print(f"minicloth: {text}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
