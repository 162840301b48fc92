"""The ``minicloth`` command; what it does is in ``cloth_envs.commands``, imported when it is asked for."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from cloth_envs import __version__
from cloth_envs.naming import unknown_name

# name -> "module:main(argv)", imported on use; `training` may import cloth_envs, never the other way but here.
BENCHMARKS = {
    "mesh": "training.bench.mesh:main",
    "peers": "training.bench.peers.run:main",
    "solvers": "training.bench.solvers:main",
    "speed-accuracy": "training.bench.speed_accuracy.run:main",
    "tables": "training.bench.papers.run:main",
    "stability": "training.bench.stability.run:main",
    "throughput": "training.bench.throughput.run:main",
    "transfer": "training.bench.transfer.run:main",
}
TRAININGS = {
    "dynamics": "training.dynamics.train:main",
    "local": "training.local.train:main",
    "physics-cnn": "training.cell.train:main",
    "upscaler": "training.upscaler.train:main",
}


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
    _run("benchmark", BENCHMARKS, given.benchmark, given.options)


def _train(given: argparse.Namespace) -> NoReturn:
    _run("training", TRAININGS, given.training, given.options)


def _generate(given: argparse.Namespace) -> NoReturn:
    from training.generate import main as generate

    sys.exit(generate([given.scene, *given.options]))


def _report(given: argparse.Namespace) -> str:
    from training.bench.report.run import write

    own = Path("docs/data"), Path("docs/images")
    data, images = own if given.data is None else (given.data, given.data)
    return write(data, given.images or images, given.out)


def _run(kind: str, table: dict[str, str], name: str, options: Sequence[str]) -> NoReturn:
    """Call ``main(options)`` of the module that ``table`` has for ``name``, and leave with what it returns."""
    if name not in table:
        raise unknown_name(kind, name, table)
    module, function = table[name].split(":")
    sys.exit(getattr(import_module(module), function)(options))


def _named(text: str | None, option: str) -> Any:
    """A fabric's or a preset's name, or a JSON object."""
    from cloth_envs.backend import read_object

    return read_object(text, option) if text and text.lstrip().startswith("{") else text


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, got {value}")
    return value


def _seed(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"must not be negative, got {value}")
    return value


def parser() -> argparse.ArgumentParser:
    """All commands and their options."""
    top = argparse.ArgumentParser("minicloth", description="Cloth scenes: list, simulate, draw, compare, measure.")
    top.add_argument("--version", action="version", version=f"minicloth {__version__}")
    commands = top.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def command(name: str, run: Any, about: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=about, description=about)
        sub.set_defaults(run=run)
        return sub

    def episode(sub: argparse.ArgumentParser) -> None:
        sub.add_argument("scene", metavar="SCENE", help="a scene's name, see `minicloth list`")
        sub.add_argument("--seed", type=_seed, default=0, help="of the start and the actions (default 0)")
        sub.add_argument("--policy", default="smooth", help="zero, random, smooth (default) or bang-bang")
        sub.add_argument("--material", help="a fabric's name, or JSON such as '{\"areal_density\": 0.3}'")

    def pictures(sub: argparse.ArgumentParser) -> None:
        sub.add_argument("--video", metavar="OUT.mp4", help="H.264 video at the simulated speed")
        sub.add_argument("--images", metavar="DIR", help="one PNG a frame")
        sub.add_argument("--strain", action="store_true", help="colour the cloth by its strain")

    sub = command("list", _list, "List scenes, presets, backends, fabrics and policies; or describe one scene.")
    sub.add_argument("--scene", metavar="SCENE", help="describe this scene and its task")

    sub = command("rollout", _rollout, "Simulate one episode; draw it, record it.")
    episode(sub)
    sub.add_argument("--frames", type=_count, help="default: the scene's episode")
    sub.add_argument(
        "--backend",
        metavar="NAME[=JSON]",
        default="reference",
        help="which physics, such as 'miniature={\"factor\": 4}' or my_package.physics:MyBackend (default reference)",
    )
    sub.add_argument("--resolution", metavar="ROWSxCOLS", help="of the grid, at equal size and material")
    sub.add_argument("--preset", help='a paper\'s set-up by name, or JSON: \'{"name": "lee2019", "mass": 3}\'')
    pictures(sub)
    sub.add_argument("--hdf5", metavar="OUT.h5", help="record the rollout")
    sub.add_argument("--overwrite", action="store_true", help="replace an existing HDF5 file")

    sub = command("render", _render, "Draw a recorded rollout.")
    sub.add_argument("file", metavar="FILE", help="a rollout in HDF5")
    sub.add_argument("--trajectory", type=int, default=0, help="which one (default 0)")
    pictures(sub)

    sub = command("compare", _compare, "One scene with several backends or resolutions: video, table, chart.")
    episode(sub)
    sub.add_argument("--frames", type=_count, default=120, help="length of the run (default 120)")
    sub.add_argument(
        "--backend",
        metavar="NAME[@RxC][=JSON]",
        action="append",
        default=[],
        help="at every resolution, or at its own; may repeat (none: four usual ones)",
    )
    sub.add_argument("--resolutions", metavar="RxC,RxC", default="", help="default: the scene's own")
    sub.add_argument(
        "--horizon", type=_count, default=10, help="of the chart's error [frames]: 1, 5, 10 (default) or 25"
    )
    sub.add_argument("--out", metavar="DIR", help="default ./compare_<scene>; files in it are replaced")
    sub.add_argument("--no-video", action="store_true", help="table and chart only")

    sub = command("bench", _bench, "Run a benchmark: " + ", ".join(BENCHMARKS) + ".")
    sub.add_argument("benchmark", metavar="NAME")
    sub.add_argument("options", nargs=argparse.REMAINDER, help="its own options, see `minicloth bench NAME --help`")

    sub = command("report", _report, "One self-contained HTML page of what benchmarks wrote with --out.")
    sub.add_argument("--data", type=Path, metavar="DIR", help="folder of their rows (default docs/data)")
    sub.add_argument(
        "--images", type=Path, metavar="DIR", help="of their charts (default --data, or docs/images for docs/data)"
    )
    sub.add_argument("--out", type=Path, metavar="OUT.html", required=True, help="the page")

    sub = command("generate", _generate, "Simulate trajectories to learn from; goes on where it was stopped.")
    sub.add_argument("scene", metavar="SCENE", help="a scene that has the preset")
    sub.add_argument("options", nargs=argparse.REMAINDER, help="more, see `minicloth generate SCENE --help`")

    sub = command("train", _train, "Train a network: " + ", ".join(TRAININGS) + ". Goes on where it was stopped.")
    sub.add_argument("training", metavar="NAME")
    sub.add_argument("options", nargs=argparse.REMAINDER, help="its own options, see `minicloth train NAME --help`")
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command. Returns the exit code: 0, 2 for what the user can put right, 130 when interrupted."""
    given = parser().parse_args(argv)
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
