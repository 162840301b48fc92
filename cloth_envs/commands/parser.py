"""All commands of ``minicloth`` and their options."""

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

from cloth_envs.commands.mistakes import physics_or_material
from cloth_envs.parsing import Parser, whole
from cloth_envs.version import __version__


def _at_least(least: int) -> Callable[[str], int]:
    def number(text: str) -> int:
        value = whole(text)
        if value < least:
            raise argparse.ArgumentTypeError(f"must be at least {least}, got {value}")
        return value

    return number


def _episode(sub: Parser, policies: str = "zero, random, smooth (default) or bang-bang") -> None:
    sub.elsewhere = physics_or_material
    sub.add_argument("scene", metavar="SCENE", help="a scene's name, see `minicloth list`")
    sub.add_argument("--seed", type=_at_least(0), default=0, help="of the start and the actions (default 0)")
    sub.add_argument("--policy", default="smooth", help=policies)
    sub.add_argument("--material", help="a fabric's name, or JSON such as '{\"areal_density\": 0.3}'")
    sub.add_argument(
        "--self-contact",
        action=argparse.BooleanOptionalAction,
        help="whether folds keep out of each other (default: as the scene lists it)",
    )


def _pictures(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--video", metavar="OUT.mp4", help="H.264 video at the simulated speed")
    sub.add_argument("--images", metavar="DIR", help="one PNG a frame")
    sub.add_argument("--strain", action="store_true", help="colour the cloth by its strain")


def parser(runs: Mapping[str, Callable[[argparse.Namespace], str | None]]) -> Parser:
    """All commands and their options; ``runs`` has what each command does."""
    top = Parser("minicloth", description="Cloth scenes: list, simulate, draw, compare, measure.")
    top.add_argument("--version", action="version", version=f"minicloth {__version__}")
    commands = top.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def command(name: str, about: str) -> Parser:
        sub = commands.add_parser(name, help=about, description=about)
        sub.set_defaults(run=runs[name])
        return sub

    sub = command("list", "List scenes, presets, backends, fabrics and policies; or describe one scene.")
    sub.add_argument("--scene", metavar="SCENE", help="describe this scene and its task")

    sub = command("rollout", "Simulate one episode; draw it, record it.")
    _episode(
        sub,
        "zero, random, smooth (default), bang-bang, controller (the scene's, by hand), ppo (a network, for -v1), or as "
        "of `minicloth evaluate` module:function or a file, which sees keypoints",
    )
    sub.add_argument("--frames", type=_at_least(1), help="default: the scene's episode")
    sub.add_argument(
        "--backend",
        metavar="NAME[=JSON]",
        default="reference",
        help="which physics, such as 'miniature={\"factor\": 4}' or my_package.physics:MyBackend (default reference)",
    )
    sub.add_argument("--resolution", metavar="ROWSxCOLS", help="of the grid, at equal size and material")
    sub.add_argument("--preset", help='a paper\'s set-up by name, or JSON: \'{"name": "lee2019", "mass": 3}\'')
    _pictures(sub)
    sub.add_argument(
        "--goal", action=argparse.BooleanOptionalAction, default=True, help="draw what the task wants (default: yes)"
    )
    sub.add_argument("--caption", action="store_true", help="write reward and success under the pictures")
    sub.add_argument("--hdf5", metavar="OUT.h5", help="record the rollout")
    sub.add_argument("--overwrite", action="store_true", help="replace an existing HDF5 file")

    sub = command("render", "Draw a recorded rollout.")
    sub.add_argument("file", metavar="FILE", help="a rollout in HDF5")
    sub.add_argument("--trajectory", type=int, default=0, help="which one (default 0)")
    _pictures(sub)

    sub = command("export", "Write a recorded rollout for ParaView, Blender and others.")
    sub.add_argument("file", metavar="FILE", help="a rollout in HDF5")
    sub.add_argument("--format", required=True, metavar="FORMAT", help="vtk, gltf, ply or usd")
    sub.add_argument("--out", metavar="OUT", help="file, or folder for it (default: beside FILE)")
    sub.add_argument("--trajectory", type=int, default=0, help="which one (default 0)")
    sub.add_argument("--every", type=_at_least(1), default=1, metavar="K", help="each K-th frame (default 1: all)")

    sub = command("compare", "One scene with several backends or resolutions: video, table, chart.")
    _episode(sub)
    sub.add_argument("--frames", type=_at_least(1), default=120, help="length of the run (default 120)")
    sub.add_argument(
        "--backend",
        dest="backends",
        metavar="NAME[@RxC][=JSON]",
        action="append",
        default=[],
        help="at every resolution, or at its own; may repeat (none: four usual ones)",
    )
    sub.add_argument("--resolutions", metavar="RxC,RxC", default="", help="default: the scene's own")
    sub.add_argument(
        "--horizon", type=_at_least(1), default=10, help="of the chart's error [frames]: 1, 5, 10 (default) or 25"
    )
    sub.add_argument("--out", metavar="DIR", help="default ./compare_<scene>; files in it are replaced")
    sub.add_argument("--no-video", dest="video", action="store_false", help="table and chart only")

    sub = command("evaluate", "A policy on the physics it was trained on and on the one that counts, from equal seeds.")
    sub.add_argument(
        "policy",
        metavar="POLICY",
        help="controller, ppo, zero, random, module:function, or a file: .zip, .pt, .safetensors",
    )
    sub.add_argument("--scene", metavar="SCENE", required=True, help="a scene's name")
    sub.add_argument(
        "--train-backend",
        metavar="NAME[=JSON]",
        help="what it was trained on (default: as its card tells, or 'miniature={\"factor\": 4}')",
    )
    sub.add_argument("--certify", metavar="NAME[=JSON]", default="reference", help="what counts (default reference)")
    sub.add_argument("--seeds", type=_at_least(2), default=16, help="how many (default 16)")
    sub.add_argument("--first-seed", type=_at_least(0), default=900_000, help="the first of them (default 900000)")
    sub.add_argument("--frames", type=_at_least(1), help="default: the scene's episode")
    sub.add_argument("--beside", default="controller", help="others to compare with, by commas (default controller)")
    sub.add_argument("--obs", default="keypoints", help="what policies see: keypoints (default) or mesh")
    sub.add_argument("--material", help="a fabric's name, or JSON such as '{\"areal_density\": 0.3}'")
    sub.add_argument("--randomize", metavar="JSON", help="ranges of the material, such as '{\"drag\": [0.2, 0.8]}'")
    sub.add_argument("--observe-material", action="store_true", help="policies see what --randomize draws")
    sub.add_argument("--resolution", metavar="ROWSxCOLS", help="of the grid, at equal size and material")
    sub.add_argument("--preset", help='a paper\'s set-up by name, or JSON: \'{"name": "lee2019", "mass": 3}\'')
    sub.add_argument("--out", metavar="OUT.md", help="the page as a file too")

    sub = command("bench", "Run a benchmark; without NAME they are listed.")
    sub.add_argument("benchmark", metavar="NAME", nargs="?")
    sub.add_argument("options", nargs=argparse.REMAINDER, help="its own options, see `minicloth bench NAME --help`")

    sub = command("report", "One self-contained HTML page of what benchmarks wrote with --out.")
    sub.add_argument(
        "--data", type=Path, metavar="DIR", help="folder of their rows (default docs/data of the checkout)"
    )
    sub.add_argument(
        "--images", type=Path, metavar="DIR", help="of their charts (default --data, or docs/images for docs/data)"
    )
    sub.add_argument("--out", type=Path, metavar="OUT.html", help="the page, which must be named")

    sub = command("generate", "Simulate trajectories to learn from; goes on where it was stopped.")
    sub.add_argument("scene", metavar="SCENE", nargs="?", help="which; without it they are listed")
    sub.add_argument("options", nargs=argparse.REMAINDER, help="more, see `minicloth generate SCENE --help`")

    sub = command("train", "Train a network; without NAME they are listed. Goes on where it was stopped.")
    sub.add_argument("training", metavar="NAME", nargs="?")
    sub.add_argument("options", nargs=argparse.REMAINDER, help="its own options, see `minicloth train NAME --help`")
    return top
