"""``minicloth generate SCENE``: trajectories of the preset's teacher, and runs of its miniature beside it.

Mass, spring constant and frame vary between trajectories, every second one moves by random smooth actions, every fifth
is held out. Stored are whole frames in HDF5 files, one a trajectory: the teacher's, and of every grid factor miniature
runs, started from the teacher again after every ``window`` frames. What is there is kept.
"""

import hashlib
import json
import sys
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cloth_envs.files import reading, write_bytes
from cloth_envs.grid import Grid
from cloth_envs.locks import alone_in
from cloth_envs.parsing import Parser
from cloth_envs.presets import load_preset, solver_of
from cloth_envs.progress import announce, progress
from cloth_envs.recording.pages import sealed
from cloth_envs.recording.stored import StoredFile
from cloth_envs.scenes.task import Task
from cloth_envs.state import State
from cloth_envs.world import World
from surrogates.miniature.coarse import CoarsePhysics, coarse_grid
from training.cache import cache_folder
from training.jobs import each
from training.rollouts import Recording, record, replay, seeded_actions
from training.superres.generate import main as synchronised

HISTORY = 3  # coarse states that an upscaler may read: two of the past, and the present
HELD_OUT_EVERY = 5  # one trajectory of so many
REMEDY = "remove it and run `minicloth generate` again"
STEPS = (0.75, 1.0, 1.0, 1.25)  # frames of a trajectory, of the scene's own; one of these at random


@dataclass(frozen=True)
class Plan:
    """What decides the data, but for how many trajectories there are. ``mass`` [kg], ``spring`` [N/m]: ranges."""

    scene: str
    preset: str = "lee2019"
    frames: int = 100
    window: int = 5
    factors: tuple[int, ...] = (2, 3, 4)
    mass: tuple[float, float] = (1.5, 4.5)
    spring: tuple[float, float] = (40.0, 150.0)
    seed: int = 0
    layout: int = 1

    def size(self, grid: Grid) -> int:
        """Bytes of a trajectory on ``grid``: float32 positions of the teacher and, window by window, its miniatures."""
        windows, vertices = self.frames // self.window, (self.frames + 1) * grid.vertices
        for factor in self.factors:
            vertices += windows * (HISTORY + self.window) * coarse_grid(grid, factor).vertices
        return 3 * 4 * vertices

    def text(self) -> str:
        """With what the preset's options are today: data of another reading of the paper are another plan's."""
        return json.dumps(asdict(self) | {"options": dict(load_preset(self.scene, self.preset).options)})


@dataclass(frozen=True)
class Draw:
    """One trajectory's own: ``mass`` [kg], ``spring`` [N/m], ``frame_dt`` [s], how large its actions are."""

    mass: float
    spring: float
    frame_dt: float
    push: float


def draw(plan: Plan, index: int) -> Draw:
    """Trajectory ``index``'s, from the plan's seed: mass and spring evenly on a logarithmic scale."""
    rng = np.random.default_rng((plan.seed, index))
    mass, spring = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in (plan.mass, plan.spring))
    dt = load_preset(plan.scene, plan.preset).frame_dt * float(rng.choice(STEPS))
    return Draw(mass, spring, dt, float(rng.uniform(0.3, 1.0)) * (index // HELD_OUT_EVERY % 2))


def task_of(scene: str, preset: str, own: Draw) -> Task:
    """The preset's task with this mass, spring constant and frame."""
    cls: Any = load_preset(scene, {"name": preset, "mass": own.mass, "spring": own.spring})
    cls = type(cls.__name__, (cls,), {"frame_dt": own.frame_dt})
    return cls(cls.make_scene(resolution=cls.resolution, material=cls.material))


def simulate(task: Task, preset: str, rng: np.random.Generator, frames: int, push: float = 0.0) -> Recording:
    """The teacher's states and controls of every frame, under actions of size ``push``.

    Raises:
        ValueError: the teacher failed.
    """
    world = World(type(task), preset=preset)

    def actions() -> Iterator[np.ndarray]:
        yield from push * seeded_actions(world, [int(rng.integers(2**31))], ["smooth"], frames)

    run = record(world, actions(), range(frames + 1), seeds=[rng])
    if run.failures[0]:
        raise ValueError(f"the teacher of {task.scene.name} failed ({run.failures[0]}): use another --seed")
    return run


def miniature(
    run: Recording, factor: int, first: int, frames: int, preset: str = "lee2019", **options: Any
) -> list[State]:
    """Coarse states from the teacher's after ``first`` frames on: two of the past, the start, and ``frames`` more."""
    solver = dict(solver_of(preset))
    coarse = CoarsePhysics(run.scene, factor=factor, solver=solver.pop("solver", "explicit"), options=solver, **options)
    coarse.frames = HISTORY + frames
    deque(replay(coarse, run.states[first], run.controls[first : first + frames]), 0)
    return coarse.history


def miniature_runs(plan: Plan, run: Recording, factor: int) -> np.ndarray:
    """Coarse positions ``(windows, 3 + window, 3, h, w)`` of a miniature in every window."""
    starts = range(0, plan.frames - plan.window + 1, plan.window)
    runs = [miniature(run, factor, first, plan.window, plan.preset) for first in starts]
    return np.stack([np.concatenate([state.positions for state in states]) for states in runs])


def write_shard(plan: Plan, folder: Path, index: int) -> None:
    """Simulate one trajectory and store it; the file appears under its name only when it is whole."""
    path, own = folder / f"{index:05d}.h5", draw(plan, index)
    rng = np.random.default_rng((plan.seed, index, 1))
    run = simulate(task_of(plan.scene, plan.preset, own), plan.preset, rng, plan.frames, own.push)
    positions = np.concatenate([state.positions for state in run.states.values()])
    content = BytesIO()  # HDF5 can't stand a full disk
    with h5py.File(content, "w", libver=("v108", "v108")) as file:
        arrays = {"positions": positions} | {f"real/{n}": miniature_runs(plan, run, n) for n in plan.factors}
        for name, array in arrays.items():
            file.create_dataset(name, data=array, chunks=array.shape, fletcher32=True)
        sha256 = hashlib.sha256(positions.tobytes()).hexdigest()
        file.attrs.update(plan=plan.text(), index=index, sha256=sha256, **asdict(own))
    for left in folder.glob(f"{path.name}.*.part"):  # by a process that was killed
        left.unlink()
    write_bytes(path, sealed(content.getvalue()))


@contextmanager
def open_shard(path: Path) -> Iterator[h5py.File]:
    """A shard to read, every byte of which has its checksum. Raises ValueError: damaged, OSError: it can't be read."""
    with reading(path, REMEDY), StoredFile(path) as disk, h5py.File(disk, "r") as file:
        yield file


def shard_files(folder: Path) -> list[Path]:
    """The shards of a folder in order, and no other files that may be there."""
    return sorted(path for path in folder.glob("*.h5") if path.stem.isdecimal())


def missing(plan: Plan, folder: Path, count: int) -> list[int]:
    """Which of the first ``count`` trajectories are not there, or so damaged that they don't say what they are.

    Raises:
        ValueError: the folder holds data of another plan.
    """
    whole = set()
    for path in shard_files(folder):
        try:
            with open_shard(path) as file:
                found = file.attrs["plan"]
        except ValueError:
            continue
        if found != plan.text():
            raise ValueError(f"{folder} holds data of another plan: choose another --out, or remove it")
        whole.add(int(path.stem))
    return [k for k in range(count) if k not in whole]


def generate(plan: Plan, folder: Path, count: int, workers: int = 1) -> int:
    """Write what is missing of ``count`` trajectories, over ``workers`` processes. Returns how many those were.

    Raises:
        ValueError: the folder holds data of another plan, or the teacher failed.
        OSError: another program makes data there, or they can't be written.
    """
    with alone_in(folder):
        wanted = missing(plan, folder, count)
        for path in (folder / f"{k:05d}.h5" for k in wanted):
            if path.exists():
                announce(f"{path} is damaged: it is made again")
        written = each(partial(write_shard, plan, folder), wanted, workers)
        deque(progress(written, f"{plan.scene}, new trajectories", len(wanted)), 0)
    return len(wanted)


def data_folder(scene: str, preset: str) -> Path:
    """Where data goes by default, among the user's caches."""
    return cache_folder("pairs") / preset / scene.lower()


def main(argv: Sequence[str] | None = None) -> int:
    """Write the trajectories. Returns the exit code."""
    words = sys.argv[1:] if argv is None else argv
    if any(word.split("=")[0] == "--pairs" for word in words):
        return synchronised(words)
    parser = Parser(prog="minicloth generate", description=__doc__)
    parser.add_argument("scene", metavar="SCENE", help="Curtain, Flag or Collision")
    parser.add_argument("--pairs", metavar="synchronised", help="pairs of another kind, of any scene: see its --help")
    parser.add_argument("--preset", default="lee2019", help="a preset with mass and spring as options (lee2019)")
    counts = {"trajectories": (60, "in all, with those that are there"), "frames": (100, "of each")}
    counts |= {"window": (5, "frames of a miniature run"), "workers": (1, "processes")}
    for name, (default, about) in counts.items():
        parser.add_argument(f"--{name}", type=int, default=default, help=f"{about} (default {default})")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="folder of the files (default: in the user's cache)")
    options = parser.parse_args(words)
    for name in counts:
        if getattr(options, name) < 1:
            parser.error(f"--{name} must be at least 1")
    if options.window > options.frames:
        parser.error("--window must be at most --frames")
    cls: Any = load_preset(options.scene, options.preset)
    if not {"mass", "spring"} <= set(cls.options):
        parser.error(f"preset {options.preset} has no mass and spring to vary: use lee2019")
    plan = Plan(options.scene, options.preset, options.frames, options.window, seed=options.seed)
    folder = options.out or data_folder(options.scene, options.preset)
    grid = cls.make_scene(resolution=cls.resolution, material=cls.material).grid
    pairs = (grid.rows - 2) * (grid.cols - 2) * options.frames * options.trajectories
    there = options.trajectories - len(missing(plan, folder, options.trajectories))
    announce(
        f"{options.scene}, preset {options.preset}: {options.trajectories} trajectories of {options.frames} frames, "
        f"{there} of them there already; {pairs:,} pairs at factor 2, about "
        f"{options.trajectories * plan.size(grid) / 1e6:,.0f} MB in {folder}\n"
        "Stopped by Ctrl-C, the same command goes on."
    )
    new = generate(plan, folder, options.trajectories, options.workers)
    print(f"{folder}: {new} new of {options.trajectories} trajectories, {pairs:,} pairs at factor 2")
    return 0
