"""``minicloth bench transfer``: what a policy trained on a surrogate earns on the reference, beside one trained there.

Every participant trains the same policy with the same episodes, seeds and noise, several times: a small one by
evolution (``policies``), and a network by proximal policy optimisation (``ppo``). Each then plays held-out seeds on the
reference, and on its own backend: one that exploits its surrogate earns more there. Run it with OMP_NUM_THREADS=1.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from time import perf_counter, process_time

import numpy as np
import torch

from cloth_envs.grid import coarser
from cloth_envs.progress import progress
from cloth_envs.registry import load_task
from cloth_envs.world import World
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.participants import TRANSFER, Participant, extra
from training.bench.transfer import ppo, results
from training.bench.transfer.policies import FORMS, train
from training.bench.transfer.results import (
    CMA_ES,
    PPO,
    RANDOM,
    REFERENCE,
    STEM,
    ZERO,
    EpisodeRow,
    TrainingRow,
    TransferRow,
)
from training.rollouts import play
from training.rows import read_names

DURATION = 2.0  # s of an episode; the scenes' own last 4-8 s
POPULATION, EPISODES, GENERATIONS = 8, 2, 10
REPETITIONS, HELD_OUT = {CMA_ES: 3, PPO: 1}, range(16)  # training starts at FIRST_SEED
LONGER = {"miniature x4 longer": (2, 2)}  # times the episodes and the generations, as it is cheap
MEMBERS = 32  # that PPO plays at once
NETWORKS = ("reference", "miniature x2", "miniature x4")  # what PPO trains on, and what --backend names
SCENES = ("Curtain", "Collision")  # Flag's rewards hardly tell policies apart, the others take twice the time or more
TRAININGS, EPISODE_STEM = "transfer_trainings", "transfer_episodes"
TRAINING_KEY = ("scene", "rows", "cols", "learner", "policy", "repetition")
Act = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Work:
    """How much is done, on grids ``coarse`` times coarser than the scenes' own."""

    coarse: int
    generations: int
    recipe: ppo.Recipe
    seeds: Sequence[int]


FULL = Work(1, GENERATIONS, ppo.Recipe(), HELD_OUT)
QUICK = Work(4, 3, ppo.Recipe(updates=2), HELD_OUT[:4])


def frames_of(scene: str) -> int:
    """Frames of an episode."""
    return round(DURATION / load_task(scene).frame_dt)


def make_world(scene: str, participant: Participant, members: int, coarse: int) -> World:
    """``scene`` on the backend of ``participant``, on a grid ``coarse`` times coarser than its own."""
    shape, kwargs = coarser(load_task(scene).resolution, coarse), participant.whole
    return World(scene, num_envs=members, backend=participant.backend, backend_kwargs=kwargs, resolution=shape)


def trained(scene: str, one: Participant, learner: str, repetition: int, work: Work) -> tuple[TrainingRow, Act]:
    """One training, timed, and what acts by it."""
    times, more = LONGER.get(one.label, (1, 1))
    members = MEMBERS if learner == PPO else POPULATION * EPISODES * times
    frames, wall, processor = frames_of(scene), perf_counter(), process_time()
    world, text = make_world(scene, one, members, work.coarse), ""
    act: Act
    if learner == PPO:
        act, played = ppo.train(world, work.recipe, frames=frames, seed=repetition).act, members * work.recipe.updates
    else:
        counts = {"frames": frames, "generations": work.generations * more, "population": POPULATION}
        weights = train(world, FORMS[scene], **counts, seed=repetition)
        act, played = by_weights(scene, weights), members * work.generations * more
        text = " ".join(f"{w:.6g}" for w in weights)
    taken = round(perf_counter() - wall, 3), round(process_time() - processor, 3)
    shape = world.scene.grid.shape
    return TrainingRow(scene, *shape, one.label, repetition, played, frames, *taken, text, learner), act


def by_weights(scene: str, weights: np.ndarray) -> Act:
    """What a small policy does for a batch of any size."""
    return lambda obs: FORMS[scene].act(obs, np.tile(weights, (len(obs), 1)))


def untrained(policy: str, actions: int) -> Act:
    """No action, or random ones."""
    rng = np.random.default_rng(0)
    return lambda obs: rng.uniform(-1, 1, (len(obs), actions)) if policy == RANDOM else np.zeros((len(obs), actions))


def fill(session: Session, scene: str, work: Work) -> None:
    """Train and score what the session's stores lack of one scene."""
    trainings, episodes, seeds = session.store(TRAININGS), session.store(EPISODE_STEM), work.seeds
    where, frames = (scene, *coarser(load_task(scene).resolution, work.coarse)), frames_of(scene)
    others = extra(session.given.backend)
    by_name = {p.label: p for p in (*TRANSFER, *others)}
    names = {CMA_ES: list(by_name), PPO: [*NETWORKS, *(p.label for p in others)]}
    worlds: dict[str, World] = {}

    def score(learner: str, policy: str, k: int, on: str, act: Act) -> None:
        world = worlds.setdefault(on, make_world(scene, by_name[on], len(seeds), work.coarse))
        rewards, failed = play(world, act, seeds, frames)
        found = zip(seeds, rewards.tolist(), failed.tolist(), strict=True)
        episodes.add(*(EpisodeRow(*where, policy, k, on, s, round(r, 5), int(bad), learner) for s, r, bad in found))

    size = len(load_task(scene).actions)
    for policy in (ZERO, RANDOM):
        if (*where, CMA_ES, policy, 0, REFERENCE, seeds[-1]) not in episodes:
            score(CMA_ES, policy, 0, REFERENCE, untrained(policy, size))
    # In turn: a busy moment hits all alike. A training is kept when it is scored, for networks are not.
    asked = read_names(session.given.learners, list(names), "learner")
    jobs = [(learner, name, k) for learner in asked for k in range(REPETITIONS[learner]) for name in names[learner]]
    for learner, name, k in progress(jobs, scene, unit="training", name=lambda job: f"{job[0]} {job[1]}"):
        if (*where, learner, name, k) not in trainings:
            row, act = trained(scene, by_name[name], learner, k, work)
            for on in dict.fromkeys((REFERENCE, name)):
                score(learner, name, k, on, act)
            trainings.add(row)


def measure(session: Session) -> None:
    """All scenes that the session asks for; of a quick one the first, on a coarse grid, for few generations."""
    work = QUICK if session.quick else FULL
    session.about |= {"threads": 1, "episode_s": DURATION, "population": POPULATION, "members": MEMBERS}
    session.about |= {"repetitions": REPETITIONS, "held_out": list(work.seeds), "ppo": asdict(work.recipe)}
    torch.set_num_threads(1)
    for scene in session.scenes[:1] if session.quick else session.scenes:
        fill(session, scene, work)
    session.store(STEM).replace(results.summaries(session.store(TRAININGS).rows, session.store(EPISODE_STEM).rows))


BENCHMARK = Benchmark(
    name=STEM,
    about="What a policy trained on a surrogate earns on the reference, beside one trained there.",
    files={
        STEM: RowFile(TransferRow),
        TRAININGS: RowFile(TrainingRow, TRAINING_KEY),
        EPISODE_STEM: RowFile(EpisodeRow, (*TRAINING_KEY, "scored_on", "seed")),
    },
    parts=[Part("Rewards a frame", (STEM,), results.table)],
    measure=measure,
    scenes=SCENES,
    pieces=[("--scenes", scene, "--learners", learner) for learner in (PPO, CMA_ES) for scene in SCENES],
    charts={STEM: "Reward on the reference against training time, by what the policy was trained on"},
    draw=results.draw,
    options=lambda parser: parser.add_argument("--learners", default=f"{CMA_ES},{PPO}", help="default %(default)s"),
)
