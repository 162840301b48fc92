"""``minicloth generate SCENE``: trajectories of a teacher at full resolution, and miniature runs beside it.

The teacher is what the preset's paper ran (P-ADMM with 10 iterations for "lee2019"). Mass, spring constant and frame
vary between trajectories, every second one moves by random smooth actions. Frames are stored, not pairs: ``dataset``
cuts these out as they are needed. For every grid factor there are two inputs, never mixed:

- *oracle*: the teacher's own positions, down-sampled; nothing is stored for it.
- *real*: miniature runs (similar scaling, the teacher's solver and controls), started from the teacher's state again
  after every ``window`` frames.

One HDF5 file, a shard, holds one trajectory. It is renamed when it is whole, so a killed writer leaves good shards,
and the next call goes on after them. Every fifth trajectory is held out.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from tqdm import tqdm

from cloth_envs.presets import load_preset, solver_of
from cloth_envs.scenes.task import Task
from cloth_envs.world import World
from surrogates.miniature.coarse import CoarsePhysics
from training.cache import cache_folder
from training.rollouts import Recording, record, replay, seeded_actions

LAYOUT = 1
HELD_OUT_EVERY = 5  # one trajectory of so many
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
    layout: int = LAYOUT

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
    world = World(type(task), backend_kwargs=solver_of(preset))

    def actions() -> Iterator[np.ndarray]:
        yield from push * seeded_actions(world, [int(rng.integers(2**31))], ["smooth"], frames)

    run = record(world, actions(), range(frames + 1), seeds=[rng])
    if run.failures[0]:
        raise ValueError(f"the teacher of {task.scene.name} failed ({run.failures[0]}): use another --seed")
    return run


def miniature_runs(plan: Plan, run: Recording, factor: int) -> np.ndarray:
    """Coarse positions ``(windows, 3 + window, 3, h, w)``: two frames of the past, the start, and a miniature run.

    The past is what the backend starts from: where the start came from at its velocity.
    """
    options = dict(solver_of(plan.preset))
    coarse = CoarsePhysics(run.scene, factor=factor, solver=options.pop("solver", "explicit"), options=options)
    coarse.frames, runs = 3 + plan.window, []
    for first in range(0, plan.frames - plan.window + 1, plan.window):
        deque(replay(coarse, run.states[first], run.controls[first : first + plan.window]), 0)
        runs.append(np.concatenate([state.positions for state in coarse.history]))
    return np.stack(runs)


def write_shard(plan: Plan, folder: Path, index: int) -> Path:
    """Simulate one trajectory and store it; the file appears under its name only when it is whole.

    Raises:
        ValueError: the teacher failed.
    """
    path, own = folder / f"{index:05d}.h5", draw(plan, index)
    task = task_of(plan.scene, plan.preset, own)
    rng = np.random.default_rng((plan.seed, index, 1))
    run = simulate(task, plan.preset, rng, plan.frames, own.push)
    positions = np.concatenate([state.positions for state in run.states.values()])
    part = path.with_suffix(".part")
    with h5py.File(part, "w") as file:
        file["positions"] = positions
        for factor in plan.factors:
            file[f"real/{factor}"] = miniature_runs(plan, run, factor)
        digest = hashlib.sha256(positions.tobytes()).hexdigest()
        file.attrs.update(plan=plan.text(), index=index, sha256=digest, **asdict(own))
    part.replace(path)
    return path


def missing(plan: Plan, folder: Path, count: int) -> list[int]:
    """Which of the first ``count`` trajectories are not there yet.

    Raises:
        ValueError: the folder holds data of another plan.
    """
    for path in sorted(folder.glob("*.h5"))[:1]:
        with h5py.File(path) as file:
            if file.attrs["plan"] != plan.text():
                raise ValueError(f"{folder} holds data of another plan: choose another --out, or remove it")
    return [k for k in range(count) if not (folder / f"{k:05d}.h5").is_file()]


def generate(plan: Plan, folder: Path, count: int, workers: int = 1) -> int:
    """Write what is missing of ``count`` trajectories, over ``workers`` processes. Returns how many those were."""
    folder.mkdir(parents=True, exist_ok=True)
    wanted = missing(plan, folder, count)
    job = partial(write_shard, plan, folder)
    with tqdm(total=len(wanted), desc=f"{plan.scene} trajectories", disable=None) as bar:
        if workers == 1:
            for index in wanted:
                job(index)
                bar.update()
        elif wanted:
            with get_context("spawn").Pool(min(workers, len(wanted))) as pool:
                for _ in pool.imap_unordered(job, wanted):
                    bar.update()
    return len(wanted)


def data_folder(scene: str, preset: str) -> Path:
    """Where data goes by default, among the user's caches."""
    return cache_folder("pairs") / preset / scene.lower()


def main(argv: Sequence[str] | None = None) -> int:
    """Write the trajectories. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="minicloth generate", description=__doc__)
    parser.add_argument("scene", metavar="SCENE", help="Curtain, Flag or Collision")
    parser.add_argument("--preset", default="lee2019", help="a preset with mass and spring as options (lee2019)")
    parser.add_argument("--trajectories", type=int, default=60, help="in all, with those that are there (default 60)")
    parser.add_argument("--frames", type=int, default=100, help="of each (default 100)")
    parser.add_argument("--window", type=int, default=5, help="frames of a miniature run (default 5)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1, help="processes (default 1)")
    parser.add_argument("--out", type=Path, help="folder of the shards (default: in the user's cache)")
    options = parser.parse_args(argv)
    for name in ("trajectories", "frames", "window", "workers"):
        if getattr(options, name) < 1:
            parser.error(f"--{name} must be at least 1")
    if options.window > options.frames:
        parser.error("--window must be at most --frames")
    cls: Any = load_preset(options.scene, options.preset)
    if not {"mass", "spring"} <= set(cls.options):
        parser.error(f"preset {options.preset} has no mass and spring to vary: use lee2019")
    plan = Plan(options.scene, options.preset, options.frames, options.window, seed=options.seed)
    folder = options.out or data_folder(options.scene, options.preset)
    new = generate(plan, folder, options.trajectories, options.workers)
    grid = cls.make_scene(resolution=cls.resolution, material=cls.material).grid
    pairs = (grid.rows - 2) * (grid.cols - 2) * options.frames * options.trajectories
    print(f"{folder}: {new} new of {options.trajectories} trajectories, {pairs:,} pairs at factor 2")
    return 0
