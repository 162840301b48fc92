"""``minicloth bench transfer``: what a policy trained on a surrogate earns on the reference, beside one trained there.

Every backend trains the same small policy with the same episodes, seeds and candidates (``transfer_policies``,
``transfer_search``), several times. Each policy then plays held-out seeds on the reference, and on its own backend: one
that exploits its surrogate earns more there. Rows that are in --out already are kept. Run it with OMP_NUM_THREADS=1.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from tqdm import tqdm

from cloth_envs.grid import coarser
from cloth_envs.machine import header
from cloth_envs.registry import SCENES, load_task
from cloth_envs.world import World
from training.bench.throughput.run import write_rows
from training.bench.transfer import chart as transfer_chart
from training.bench.transfer.policies import FORMS, Form
from training.bench.transfer.rows import (
    EPISODE_KEY,
    RANDOM,
    REFERENCE,
    TRAINING_KEY,
    ZERO,
    Episode,
    Summary,
    Training,
    summaries,
    table,
)
from training.bench.transfer.search import Act, earn, train
from training.rows import Store, read_names, read_rows

# The cheapest; the others are scenes of the same kind and take twice as long together.
USUAL = ("Curtain", "Flag", "Collision")
DURATION = 2.0  # s of an episode; the scenes' own last 4-8 s
POPULATION, EPISODES, GENERATIONS = 8, 2, 10
REPETITIONS, HELD_OUT = 3, range(16)  # training starts at FIRST_SEED
LONGER = (4, 2)  # times the episodes and the generations, for a surrogate that is cheap
# What is trained on -> keywords of the miniature (None: the reference), and whether longer.
BACKENDS: dict[str, tuple[dict[str, object] | None, bool]] = {
    REFERENCE: (None, False),
    **{
        f"{scaling} x{factor}": ({"factor": factor, "scaling": scaling}, False)
        for scaling in ("similar", "calibrated", "closure")
        for factor in (2, 4)
    },
    **{
        f"closure local x4{words}": ({"factor": 4, "scaling": "closure", "upscaler": "local"}, longer)
        for words, longer in (("", False), (" longer", True))
    },
}


def make_world(scene: str, name: str, members: int, coarse: int = 1) -> World:
    """``scene`` on the backend ``name``, on a grid ``coarse`` times coarser than its own."""
    given = BACKENDS[name][0]
    return World(
        scene,
        num_envs=members,
        backend="reference" if given is None else "miniature",
        backend_kwargs=given or {},
        resolution=coarser(load_task(scene).resolution, coarse),
    )


def trained(scene: str, name: str, repetition: int, *, coarse: int, generations: int) -> Training:
    """One training, timed."""
    more = LONGER if BACKENDS[name][1] else (1, 1)
    episodes, generations = EPISODES * more[0], generations * more[1]
    shape, frames = coarser(load_task(scene).resolution, coarse), round(DURATION / load_task(scene).frame_dt)
    wall, processor = perf_counter(), process_time()
    weights = train(
        make_world(scene, name, POPULATION * episodes, coarse),
        FORMS[scene],
        frames=frames,
        generations=generations,
        population=POPULATION,
        seed=repetition,
    )
    return Training(
        scene=scene,
        rows=shape[0],
        cols=shape[1],
        policy=name,
        repetition=repetition,
        episodes=POPULATION * episodes * generations,
        frames=frames,
        wall_s=round(perf_counter() - wall, 3),
        processor_s=round(process_time() - processor, 3),
        weights=" ".join(f"{w:.6g}" for w in weights),
    )


def actor(form: Form, policy: str, training: Training | None, world: World) -> Act:
    """Actions for the batch of ``world`` by a trained policy, or by none."""
    size = (world.num_envs, len(world.task.actions))
    if training is not None:
        weights = np.tile(np.array(training.weights.split(), float), (world.num_envs, 1))
        return lambda obs: form.act(obs, weights)
    rng = np.random.default_rng(0)
    return lambda obs: rng.uniform(-1, 1, size) if policy == RANDOM else np.zeros(size)


def measure(
    scene: str,
    trainings: Store[Training],
    episodes: Store[Episode],
    *,
    coarse: int = 1,
    generations: int = GENERATIONS,
    seeds: Sequence[int] = HELD_OUT,
) -> None:
    """Train and score what the stores lack of one scene."""
    shape, frames = coarser(load_task(scene).resolution, coarse), round(DURATION / load_task(scene).frame_dt)
    where = scene, *shape
    jobs = [(name, k) for k in range(REPETITIONS) for name in BACKENDS]  # in turn: a busy moment hits all alike
    for name, k in tqdm(jobs, f"{scene}, training", disable=None):
        if (*where, name, k) not in trainings:
            trainings.add(trained(scene, name, k, coarse=coarse, generations=generations))
    found = {(t.policy, t.repetition): t for t in trainings.rows if (t.scene, t.rows, t.cols) == where}
    runs = [(policy, 0, REFERENCE) for policy in (ZERO, RANDOM)]
    runs += [(name, k, REFERENCE) for name, k in jobs] + [(name, k, name) for name, k in jobs if name != REFERENCE]
    worlds: dict[str, World] = {}
    for policy, k, on in tqdm(runs, f"{scene}, scoring", disable=None):
        if all((*where, policy, k, on, seed) in episodes for seed in seeds):
            continue
        world = worlds.setdefault(on, make_world(scene, on, len(seeds), coarse))
        rewards, failed = earn(world, actor(FORMS[scene], policy, found.get((policy, k)), world), seeds, frames)
        episodes.add(
            *(
                Episode(*where, policy, k, on, seed, round(float(reward), 5), int(bad))
                for seed, reward, bad in zip(seeds, rewards, failed, strict=True)
            )
        )


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="minicloth bench transfer", description=__doc__)
    parser.add_argument("--scenes", default=",".join(USUAL), help="of " + ", ".join(SCENES) + " (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="a coarse grid, one scene, few generations; says so")
    parser.add_argument("--out", type=Path, help="folder for rows (CSV), their header (JSON) and the chart")
    parser.add_argument("--images", type=Path, help="another folder for the chart")
    parser.add_argument("--chart-only", action="store_true", help="draw what --out holds, measure nothing")
    parser.add_argument("--fresh", action="store_true", help="measure again what --out holds")
    given = parser.parse_args(argv)
    scenes, out, quick = read_names(given.scenes, list(SCENES), "scene"), given.out, given.quick
    if given.chart_only:
        if out is None:
            raise ValueError("--chart-only needs --out, the folder that holds the rows")
        draw(
            read_rows(out / "transfer.csv", Summary),
            given.images or out,
            json.loads((out / "transfer.json").read_text()),
        )
        return 0
    if out:
        out.mkdir(parents=True, exist_ok=True)
    path = [out / name if out else None for name in ("transfer_trainings.csv", "transfer_episodes.csv")]
    trainings = Store(path[0], Training, TRAINING_KEY, fresh=given.fresh)
    episodes = Store(path[1], Episode, EPISODE_KEY, fresh=given.fresh)
    coarse, generations, seeds = (4, 3, HELD_OUT[:4]) if quick else (1, GENERATIONS, HELD_OUT)
    about = {
        **header(),
        "quick": quick,
        "threads": 1,
        "episode_s": DURATION,
        "population": POPULATION,
        "repetitions": REPETITIONS,
        "held_out": list(seeds),
    }
    print(f"{about['processor']}, one thread{', quick: a coarse grid, one scene, few generations' if quick else ''}")
    for scene in scenes[:1] if quick else scenes:
        measure(scene, trainings, episodes, coarse=coarse, generations=generations, seeds=seeds)
    here = {(scene, *coarser(load_task(scene).resolution, coarse)) for scene in SCENES}
    rows = summaries(
        [t for t in trainings.rows if (t.scene, t.rows, t.cols) in here],
        [e for e in episodes.rows if (e.scene, e.rows, e.cols) in here],
    )
    print(table(rows))
    if out:
        write_rows(out / "transfer.csv", rows)
        (out / "transfer.json").write_text(json.dumps(about, indent=2))
        draw(rows, given.images or out, about)
        print(f"rows in {out}")
    return 0


def draw(rows: Sequence[Summary], folder: Path, about: dict[str, object]) -> None:
    """The chart, from rows."""
    folder.mkdir(parents=True, exist_ok=True)
    setup = f"{about['processor']}, one thread{', QUICK: a coarse grid' if about['quick'] else ''}"
    transfer_chart.draw(rows, [folder / f"transfer.{kind}" for kind in ("png", "svg")], setup=setup)
