"""``minicloth bench transfer``: what a policy trained on a surrogate earns on the reference, beside one trained there.

Every participant trains the same small policy with the same episodes, seeds and candidates (``policies``),
several times. Each policy then plays held-out seeds on the reference, and on its own backend: one that exploits its
surrogate earns more there. Run it with OMP_NUM_THREADS=1.
"""

from collections.abc import Callable, Sequence
from time import perf_counter, process_time

import numpy as np

from cloth_envs.grid import coarser
from cloth_envs.progress import progress
from cloth_envs.registry import load_task
from cloth_envs.world import World
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.participants import TRANSFER, Participant, extra
from training.bench.transfer import results
from training.bench.transfer.policies import FORMS, train
from training.bench.transfer.results import RANDOM, REFERENCE, STEM, ZERO, EpisodeRow, TrainingRow, TransferRow
from training.rollouts import play

DURATION = 2.0  # s of an episode; the scenes' own last 4-8 s
POPULATION, EPISODES, GENERATIONS = 8, 2, 10
REPETITIONS, HELD_OUT = 3, range(16)  # training starts at FIRST_SEED
LONGER = {"miniature x4 longer": (4, 2)}  # times the episodes and the generations, as it is cheap
TRAININGS, EPISODE_STEM = "transfer_trainings", "transfer_episodes"
TRAINING_KEY = ("scene", "rows", "cols", "policy", "repetition")


def make_world(scene: str, participant: Participant, members: int, coarse: int) -> World:
    """``scene`` on the backend of ``participant``, on a grid ``coarse`` times coarser than its own."""
    shape, kwargs = coarser(load_task(scene).resolution, coarse), participant.whole
    return World(scene, num_envs=members, backend=participant.backend, backend_kwargs=kwargs, resolution=shape)


def trained(scene: str, participant: Participant, repetition: int, coarse: int, generations: int) -> TrainingRow:
    """One training, timed."""
    times, more = LONGER.get(participant.label, (1, 1))
    episodes, frames = POPULATION * EPISODES * times, round(DURATION / load_task(scene).frame_dt)
    wall, processor = perf_counter(), process_time()
    world = make_world(scene, participant, episodes, coarse)
    counts = {"frames": frames, "generations": generations * more, "population": POPULATION}
    weights = train(world, FORMS[scene], **counts, seed=repetition)
    taken = round(perf_counter() - wall, 3), round(process_time() - processor, 3)
    played, text = episodes * generations * more, " ".join(f"{w:.6g}" for w in weights)
    return TrainingRow(scene, *world.scene.grid.shape, participant.label, repetition, played, frames, *taken, text)


def actor(policy: str, training: TrainingRow | None, world: World) -> Callable[[np.ndarray], np.ndarray]:
    """Actions for the batch of ``world`` by a trained policy, or by none."""
    size = (world.num_envs, len(world.task.actions))
    if training is not None:
        weights = np.tile(np.array(training.weights.split(), float), (world.num_envs, 1))
        return lambda obs: FORMS[training.scene].act(obs, weights)
    rng = np.random.default_rng(0)
    return lambda obs: rng.uniform(-1, 1, size) if policy == RANDOM else np.zeros(size)


def fill(session: Session, scene: str, coarse: int, generations: int, seeds: Sequence[int]) -> None:
    """Train and score what the session's stores lack of one scene."""
    trainings, episodes = session.store(TRAININGS), session.store(EPISODE_STEM)
    where, frames = (scene, *coarser(load_task(scene).resolution, coarse)), round(DURATION / load_task(scene).frame_dt)
    by_name = {p.label: p for p in (*TRANSFER, *extra(session.given.backend))}
    jobs = [(name, k) for k in range(REPETITIONS) for name in by_name]  # in turn: a busy moment hits all alike
    for name, k in progress(jobs, f"{scene}, training", unit="training"):
        if (*where, name, k) not in trainings:
            trainings.add(trained(scene, by_name[name], k, coarse, generations))
    found = {(t.policy, t.repetition): t for t in trainings.rows if (t.scene, t.rows, t.cols) == where}
    runs = [(policy, 0, REFERENCE) for policy in (ZERO, RANDOM)]
    runs += [(name, k, REFERENCE) for name, k in jobs] + [(name, k, name) for name, k in jobs if name != REFERENCE]
    worlds: dict[str, World] = {}
    for policy, k, on in progress(runs, f"{scene}, scoring", unit="run"):
        if all((*where, policy, k, on, seed) in episodes for seed in seeds):
            continue
        world = worlds.setdefault(on, make_world(scene, by_name[on], len(seeds), coarse))
        rewards, failed = play(world, actor(policy, found.get((policy, k)), world), seeds, frames)
        scores = zip(seeds, rewards.tolist(), failed.tolist(), strict=True)
        episodes.add(*(EpisodeRow(*where, policy, k, on, seed, round(r, 5), int(bad)) for seed, r, bad in scores))


def measure(session: Session) -> None:
    """All scenes that the session asks for; of a quick one the first, on a coarse grid, for few generations."""
    coarse, generations, seeds = (4, 3, HELD_OUT[:4]) if session.quick else (1, GENERATIONS, HELD_OUT)
    session.about |= {"threads": 1, "episode_s": DURATION, "population": POPULATION}
    session.about |= {"repetitions": REPETITIONS, "held_out": list(seeds)}
    for scene in session.scenes[:1] if session.quick else session.scenes:
        fill(session, scene, coarse, generations, seeds)
    rows = results.summaries(session.store(TRAININGS).rows, session.store(EPISODE_STEM).rows)
    session.store(STEM).replace(rows)


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
    scenes=("Curtain", "Flag", "Collision"),  # the cheapest; the others are of the same kind, twice as long together
    charts={STEM: "Reward on the reference against training time, by what the policy was trained on"},
    draw=results.draw,
)
