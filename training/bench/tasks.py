"""``minicloth bench tasks``: what both versions of every task pay those who learn nothing.

No action, random ones and the controllers play on the reference. The planner plays on a miniature, which is its model
too, beside the controller there on the same seeds: by how much a task can be done better than by hand.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gymnasium.utils.seeding import np_random

from cloth_envs.agents import NAMED, load_policy
from cloth_envs.evaluation import Interval, Played, play
from cloth_envs.progress import progress
from cloth_envs.registry import EPISODE_FRAMES
from cloth_envs.world import World
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.planner import Budget, Planner
from training.rows import rounded

STEM, PLANNER = "tasks", "planner"
SEEDS = range(7100, 7120)
REFERENCE = ("reference", dict[str, int]())
MODELS = {"miniature x4": ("miniature", {"factor": 4}), "reference": REFERENCE}


@dataclass(frozen=True)
class TaskRow:
    """What ``who`` earns in a ``task`` on some ``physics``: means of ``episodes``, of a seed each.

    ``half`` is half of the 95 % interval of the ``reward`` a frame. ``success`` is the share of episodes whose last
    frame is one, ``change`` the mean change of an action from frame to frame, ``failed`` the share that failed.
    """

    task: str
    physics: str
    who: str
    episodes: int
    reward: float
    half: float
    last_second: float
    success: float
    change: float
    failed: float


def as_row(task: str, physics: str, who: str, played: Played) -> TaskRow:
    """The row of some episodes."""
    earned = Interval.of(played.reward)
    second, success, change = (float(part.mean()) for part in (played.last_second, played.success, played.change))
    own = task, physics, who, len(played.reward)
    return rounded(TaskRow(*own, earned.mean, earned.half, second, success, change, played.failed))


def planned(task: str, physics: str, seeds: Sequence[int], frames: int, budget: Budget) -> Played:
    """Episodes of a planner, one after the other, in worlds of the physics that is its model."""
    backend, options = MODELS[physics]
    played, failures = [], list[str | None]()
    for seed in seeds:
        world = World(task, backend=backend, backend_kwargs=options)
        world.reset({0: np_random(seed)[0]})
        planner = Planner(task, backend, options, budget, seed)
        rewards, moves, failure = np.zeros(frames), np.zeros((frames, len(world.task.actions))), None
        for frame in progress(range(frames), f"{task} planned on {physics}", unit="frame"):
            moves[frame] = planner(world)[0]
            earned, reasons = world.advance(moves[frame : frame + 1])
            failure = reasons.get(0)
            if failure:
                break
            rewards[frame] = earned[0]
        second, met = rewards[-round(1 / world.scene.frame_dt) :], not failure and world.told["success"][0]
        change, saturated = abs(np.diff(moves, axis=0)).mean(), (abs(moves) >= 1).mean()
        played.append((rewards.mean(), second.mean(), met, change, saturated))
        failures.append(failure)
    reward, last_second, success, changed, bound = np.array(played, float).T
    return Played(reward, last_second, success > 0, failures, changed, bound)


def measure(session: Session) -> None:
    """What the rows lack: floors on the reference, then the planner and the controller beside it."""
    given, store = session.given, session.store(STEM)
    budget = Budget(given.members, given.horizon)
    session.about |= {"seeds": list(SEEDS), "planned": given.planned, "budget": vars(budget), "model": given.model}
    for task in session.scenes:
        frames = 20 if session.quick else EPISODE_FRAMES[task]
        seeds = SEEDS[:2] if session.quick else SEEDS
        few, (backend, options) = seeds[: given.planned], MODELS[given.model]
        hand = load_policy("controller", task)
        for who in NAMED:
            if (task, "reference", who, len(seeds)) not in store:
                store.add(as_row(task, "reference", who, play(task, load_policy(who, task), seeds, frames=frames)))
        if few and (task, given.model, "controller", len(few)) not in store:
            played = play(task, hand, few, frames=frames, backend=backend, backend_kwargs=options)
            store.add(as_row(task, given.model, "controller", played))
        if few and (task, given.model, PLANNER, len(few)) not in store:
            store.add(as_row(task, given.model, PLANNER, planned(task, given.model, few, frames, budget)))


def table(rows: Sequence[TaskRow]) -> str:
    """A line a row."""
    lines = [f"{'':60s}{'reward':>18s}{'last second':>13s}{'success':>9s}{'change':>8s}{'failed':>8s}"]
    for r in rows:
        name = f"{r.task}, {r.who}, {r.physics} ({r.episodes})"
        earned = f"{r.reward:.3f} ± {r.half:.3f}"
        lines.append(f"{name:60s}{earned:>18s}{r.last_second:13.3f}{r.success:9.0%}{r.change:8.3f}{r.failed:8.0%}")
    return "\n".join(lines)


def options(parser: argparse.ArgumentParser) -> None:
    """Its own."""
    parser.add_argument("--planned", type=int, default=2, help="episodes of the planner in each task (default 2)")
    parser.add_argument("--model", default="miniature x4", choices=list(MODELS), help="physics that it plans on and in")
    parser.add_argument("--members", type=int, default=16, help="plans that it tries in every frame (default 16)")
    parser.add_argument("--horizon", type=int, default=16, help="frames of a plan (default 16)")


BENCHMARK = Benchmark(
    name=STEM,
    about="What no action, random ones, controllers and a planner earn in both versions of the tasks.",
    files={STEM: RowFile(TaskRow, ("task", "physics", "who", "episodes"))},
    parts=[Part("Reward a frame", (STEM,), table)],
    measure=measure,
    scenes=tuple(EPISODE_FRAMES),
    known=tuple(EPISODE_FRAMES),
    options=options,
)
