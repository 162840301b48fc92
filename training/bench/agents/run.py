"""``minicloth bench agents``: what the shipped example's agents earn on the reference, by what they were trained on.

Every training has the same processor time, the learner of ``examples/train_ppo.py``, and a schedule of physics: one
alone, or miniatures first and the reference last, which ``mixed sac`` has with SAC of Stable-Baselines3. At some points
of it the policy plays held-out seeds on the reference, which its time does not hold. Run it with OMP_NUM_THREADS=1.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from time import process_time
from typing import Any, Protocol

import torch
from safetensors.numpy import save

from cloth_envs.agents import STAGES, load_policy
from cloth_envs.evaluation import Policy, Verdict, play
from cloth_envs.files import check_folder, write_bytes, write_text
from cloth_envs.naming import REVISED
from cloth_envs.progress import progress
from cloth_envs.registry import EPISODE_FRAMES, SCENES
from training.bench.agents.chart import draw
from training.bench.agents.ppo import Ppo, example
from training.bench.agents.rows import (
    FLOOR_STEM,
    HAND,
    MIXED,
    MIXED_SAC,
    REFERENCE,
    STEM,
    ZERO,
    AgentRow,
    FloorRow,
    costs,
    table,
)
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.rows import read_names, rounded

Stage = tuple[str, dict[str, Any], float]  # backend, its options, share of the time
X4: tuple[str, dict[str, Any]] = ("miniature", {"factor": 4})
X2: tuple[str, dict[str, Any]] = ("miniature", {"factor": 2})
OF_EXAMPLE: Sequence[Stage] = [(*X4, 0.75), (*X2, 0.2), ("reference", {}, 0.05)]  # but its physics
SCHEDULES: dict[str, Sequence[Stage]] = {
    "miniature x4": [(*X4, 1.0)],
    MIXED: OF_EXAMPLE,
    MIXED_SAC: OF_EXAMPLE,
    "miniature x2": [(*X2, 1.0)],
    REFERENCE: [("reference", {}, 1.0)],
}
HELD_OUT = range(900_000, 900_008)  # seeds at the points of a training
CERTIFIED = range(900_500, 900_532)  # and at its end
TASKS = tuple(name + REVISED for name in SCENES)
KEY = ("scene", "schedule", "seed", "point")


@dataclass(frozen=True)
class Work:
    """Processor time of a training [s], at how many points of it policies are scored, over how many ``frames`` (None:
    whole episodes).
    """

    seconds: float
    points: int
    frames: int | None = None


class Learner(Protocol):
    """What trains a policy, from physics to physics."""

    what: str  # of cards

    def begin(self, scene: str, backend: str, options: dict[str, Any], seed: int) -> None:
        """Go over to other physics, whose members draw by ``seed``."""

    def go_on(self, done: float) -> int:
        """Play and learn for a while, ``done`` being the share of the training that is over; frames played."""

    def end(self) -> int:
        """Leave the physics; episodes that failed in it."""

    def weights(self) -> dict[str, torch.Tensor]:
        """Of the policy, as ``load_policy`` reads them."""

    def policy(self) -> Policy:
        """What it does now, without noise."""


def learner_of(schedule: str) -> Learner:
    """A new one. Raises ImportError: Stable-Baselines3, which SAC is of, is missing."""
    if schedule != MIXED_SAC:
        return Ppo()
    from training.bench.agents.sac import Sac

    return Sac()


def stages_of(schedule: str, scene: str) -> Sequence[Stage]:
    """Those of a schedule; a mixed one has the example's physics of this scene."""
    stages = SCHEDULES[schedule]
    if stages is not OF_EXAMPLE:
        return stages
    own = example().stages(scene)
    return [(backend, options, share) for (backend, options, _), (*_, share) in zip(own, stages, strict=True)]


@dataclass
class Training:
    """One training as far as it is: its learner, processor time [s], frames, those of the reference, failures."""

    learner: Learner = field(default_factory=Ppo)
    seconds: float = 0.0
    frames: int = 0
    reference_frames: int = 0
    failed: int = 0

    def run(self, scene: str, stages: Sequence[Stage], seed: int, budget: float, points: int) -> Iterator[int]:
        """Train, and stop at each of ``points`` even parts of the ``budget`` [s]."""
        until, point = 0.0, 1
        torch.manual_seed(seed)
        for number, (backend, options, share) in enumerate(stages):
            self.learner.begin(scene, backend, {**options, "threads": 1}, 10_000 * (seed + 1) + 1_000 * number)
            until += share * budget
            while self.seconds < until - 1e-9:
                began = process_time()
                frames = self.learner.go_on(min(self.seconds / budget, 1.0))
                self.seconds += process_time() - began
                self.frames += frames
                self.reference_frames += frames * (backend == "reference")
                if point < points and self.seconds >= point * budget / points:
                    yield point
                    point += 1
            self.failed += self.learner.end()
        yield points


def fill(session: Session, scene: str, schedule: str, seed: int, work: Work) -> None:
    """Train once and score what the session's stores lack of it."""
    store, floors = session.store(STEM), session.store(FLOOR_STEM)
    for who in (ZERO, HAND):
        if (scene, who) not in floors:
            found = play(scene, load_policy(who, scene), CERTIFIED, frames=work.frames)
            floors.add(FloorRow(scene, who, round(found.reward.mean(), 4), round(found.success.mean(), 4)))
    if (scene, schedule, seed, work.points) in store:
        return
    training, stages, rows = Training(learner_of(schedule)), stages_of(schedule, scene), []
    for point in training.run(scene, stages, seed, work.seconds, work.points):
        seeds = CERTIFIED if point == work.points else HELD_OUT
        true = play(scene, training.learner.policy(), seeds, frames=work.frames)
        gap = (0.0, 0.0)
        if point == work.points and stages[0][0] != "reference":
            backend, options, _ = stages[0]
            own = play(
                scene, training.learner.policy(), seeds, frames=work.frames, backend=backend, backend_kwargs=options
            )
            verdict = Verdict(own, true)
            gap = verdict.gap.mean, verdict.gap.half
        cost = round(training.seconds, 1), training.frames, training.reference_frames
        earned = float(true.reward.mean()), float(true.success.mean())
        rows.append(rounded(AgentRow(scene, schedule, seed, point, *cost, *earned, *gap, training.failed)))
    store.add(*rows)
    if session.given.policies is not None:
        name = scene if seed == 0 else f"{scene}_{seed}"
        keep(training.learner, rows[-1], session.given.policies / f"{name}.safetensors", stages)


def keep(learner: Learner, row: AgentRow, path: Path, stages: Sequence[Stage]) -> None:
    """Write a policy, for ``load_policy``, and beside it a card with what was measured of it."""
    write_bytes(path, save({name: value.float().numpy() for name, value in learner.weights().items()}))
    card = {"what": learner.what, "licence": "MIT", STAGES: stages}
    write_text(path.with_suffix(".json"), json.dumps(card | asdict(row), indent=1) + "\n")


def measure(session: Session) -> None:
    """All trainings that the session asks for, seed by seed, so that what is stopped has whole seeds."""
    given = session.given
    work = Work(4.0, 2, 20) if session.quick else Work(given.seconds, 5)
    names = read_names(given.schedules, list(SCHEDULES), "schedule")
    if given.policies is not None:
        check_folder(given.policies)
    held_out = {"held_out": list(HELD_OUT), "certified": [CERTIFIED[0], CERTIFIED[-1]]}
    session.about |= {"threads": 1, "seconds": work.seconds, **held_out, "schedules": SCHEDULES}
    torch.set_num_threads(1)
    scenes = session.scenes[:1] if session.quick else session.scenes
    jobs = [(s, n, seed) for seed in range(1 if session.quick else given.seeds) for n in names for s in scenes]
    for scene, name, seed in progress(jobs, "trainings", name=lambda job: ", ".join(map(str, job))):
        fill(session, scene, name, seed, work)


def options(parser: argparse.ArgumentParser) -> None:
    """Its own."""
    parser.add_argument("--seeds", type=int, default=5, help="trainings of each scene and schedule (default 5)")
    parser.add_argument("--seconds", type=float, default=130.0, help="processor time of a training (default 130)")
    parser.add_argument("--policies", type=Path, metavar="DIR", help="keep policies there, for minicloth evaluate")
    parser.add_argument("--schedules", default=",".join(SCHEDULES), help="default: %(default)s")


BENCHMARK = Benchmark(
    name=STEM,
    about="What agents earn on the reference, by the physics that they were trained on.",
    files={STEM: RowFile(AgentRow, KEY), FLOOR_STEM: RowFile(FloorRow, ("scene", "who"))},
    parts=[
        Part("Reward a frame on the reference", (STEM, FLOOR_STEM), table),
        Part("Costs, gaps and successes of trainings", (STEM,), costs),
    ],
    measure=measure,
    scenes=TASKS,
    known=tuple(EPISODE_FRAMES),
    pieces=[("--scenes", scene, "--schedules", name) for name in SCHEDULES for scene in TASKS],
    charts={STEM: "Reward on the reference against training time, by what agents were trained on"},
    draw=draw,
    options=options,
)
