"""``minicloth bench transfer``: what a policy trained on a surrogate earns on the reference, beside one trained there.

Every participant trains the same small policy with the same episodes, seeds and candidates (``policies``, ``search``),
several times. Each policy then plays held-out seeds on the reference, and on its own backend: one that exploits its
surrogate earns more there. Run it with OMP_NUM_THREADS=1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter, process_time

import numpy as np
from tqdm import tqdm

from cloth_envs.grid import coarser
from cloth_envs.registry import load_task
from cloth_envs.world import World
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.participants import TRANSFER, Participant, extra
from training.bench.transfer.chart import STEM, draw
from training.bench.transfer.policies import FORMS, Form
from training.bench.transfer.rows import (
    EPISODE_KEY,
    RANDOM,
    REFERENCE,
    TRAINING_KEY,
    ZERO,
    EpisodeRow,
    TrainingRow,
    TransferRow,
    summaries,
    table,
)
from training.bench.transfer.search import train
from training.rollouts import play
from training.rows import Store

DURATION = 2.0  # s of an episode; the scenes' own last 4-8 s
POPULATION, EPISODES, GENERATIONS = 8, 2, 10
REPETITIONS, HELD_OUT = 3, range(16)  # training starts at FIRST_SEED
LONGER = {"closure local x4 longer": (4, 2)}  # times the episodes and the generations, as it is cheap
TRAININGS, EPISODE_STEM = "transfer_trainings", "transfer_episodes"


def make_world(scene: str, participant: Participant, members: int, coarse: int = 1) -> World:
    """``scene`` on the backend of ``participant``, on a grid ``coarse`` times coarser than its own."""
    return World(
        scene,
        num_envs=members,
        backend=participant.backend,
        backend_kwargs=participant.whole,
        resolution=coarser(load_task(scene).resolution, coarse),
    )


def trained(scene: str, participant: Participant, repetition: int, *, coarse: int, generations: int) -> TrainingRow:
    """One training, timed."""
    times, more = LONGER.get(participant.label, (1, 1))
    episodes, frames = POPULATION * EPISODES * times, round(DURATION / load_task(scene).frame_dt)
    wall, processor = perf_counter(), process_time()
    world = make_world(scene, participant, episodes, coarse)
    weights = train(
        world,
        FORMS[scene],
        frames=frames,
        generations=generations * more,
        population=POPULATION,
        seed=repetition,
    )
    return TrainingRow(
        scene,
        *world.scene.grid.shape,
        participant.label,
        repetition,
        episodes=episodes * generations * more,
        frames=frames,
        wall_s=round(perf_counter() - wall, 3),
        processor_s=round(process_time() - processor, 3),
        weights=" ".join(f"{w:.6g}" for w in weights),
    )


def actor(form: Form, policy: str, training: TrainingRow | None, world: World) -> Callable[[np.ndarray], np.ndarray]:
    """Actions for the batch of ``world`` by a trained policy, or by none."""
    size = (world.num_envs, len(world.task.actions))
    if training is not None:
        weights = np.tile(np.array(training.weights.split(), float), (world.num_envs, 1))
        return lambda obs: form.act(obs, weights)
    rng = np.random.default_rng(0)
    return lambda obs: rng.uniform(-1, 1, size) if policy == RANDOM else np.zeros(size)


def fill(
    scene: str,
    trainings: Store[TrainingRow],
    episodes: Store[EpisodeRow],
    participants: Sequence[Participant],
    *,
    coarse: int = 1,
    generations: int = GENERATIONS,
    seeds: Sequence[int] = HELD_OUT,
) -> None:
    """Train and score what the stores lack of one scene; the first of ``participants`` is the reference."""
    where, frames = (scene, *coarser(load_task(scene).resolution, coarse)), round(DURATION / load_task(scene).frame_dt)
    by_name = {p.label: p for p in participants}
    jobs = [(name, k) for k in range(REPETITIONS) for name in by_name]  # in turn: a busy moment hits all alike
    for name, k in tqdm(jobs, f"{scene}, training", disable=None):
        if (*where, name, k) not in trainings:
            trainings.add(trained(scene, by_name[name], k, coarse=coarse, generations=generations))
    found = {(t.policy, t.repetition): t for t in trainings.rows if (t.scene, t.rows, t.cols) == where}
    runs = [(policy, 0, REFERENCE) for policy in (ZERO, RANDOM)]
    runs += [(name, k, REFERENCE) for name, k in jobs] + [(name, k, name) for name, k in jobs if name != REFERENCE]
    worlds: dict[str, World] = {}
    for policy, k, on in tqdm(runs, f"{scene}, scoring", disable=None):
        if all((*where, policy, k, on, seed) in episodes for seed in seeds):
            continue
        world = worlds.setdefault(on, make_world(scene, by_name[on], len(seeds), coarse))
        rewards, failed = play(world, actor(FORMS[scene], policy, found.get((policy, k)), world), seeds, frames)
        episodes.add(
            *(
                EpisodeRow(*where, policy, k, on, seed, round(float(reward), 5), int(bad))
                for seed, reward, bad in zip(seeds, rewards, failed, strict=True)
            )
        )


def measure(session: Session) -> None:
    """All scenes that the session asks for; of a quick one the first, on a coarse grid, for few generations."""
    coarse, generations, seeds = (4, 3, HELD_OUT[:4]) if session.quick else (1, GENERATIONS, HELD_OUT)
    session.about |= {
        "threads": 1,
        "episode_s": DURATION,
        "population": POPULATION,
        "repetitions": REPETITIONS,
        "held_out": list(seeds),
    }
    trainings, episodes = session.store(TRAININGS), session.store(EPISODE_STEM)
    participants = [*TRANSFER, *extra(session.given.backend)]
    for scene in session.scenes[:1] if session.quick else session.scenes:
        fill(scene, trainings, episodes, participants, coarse=coarse, generations=generations, seeds=seeds)
    session.store(STEM).replace(summaries(trainings.rows, episodes.rows))


BENCHMARK = Benchmark(
    name=STEM,
    about="What a policy trained on a surrogate earns on the reference, beside one trained there.",
    files={
        STEM: RowFile(TransferRow),
        TRAININGS: RowFile(TrainingRow, TRAINING_KEY),
        EPISODE_STEM: RowFile(EpisodeRow, EPISODE_KEY),
    },
    parts=[Part("Rewards a frame", (STEM,), table)],
    measure=measure,
    scenes=("Curtain", "Flag", "Collision"),  # the cheapest; the others are of the same kind, twice as long together
    charts={STEM: "Reward on the reference against training time, by what the policy was trained on"},
    draw=draw,
)
