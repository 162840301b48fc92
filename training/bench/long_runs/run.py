"""``minicloth bench long-runs``: whole episodes beside the reference's, each statistic apart.

Reference, nudged reference and surrogates play equal seeds by equal actions. What an agent observes and earns, heights,
energies and strains are compared as distributions, folds and motion as spectra; the nudged reference tells how far the
reference is from itself.
"""

import json

from cloth_envs.progress import progress
from cloth_envs.world import World
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.long_runs.chart import SPECTRA, STEM, draw
from training.bench.long_runs.episodes import Episodes, names, watch
from training.bench.long_runs.rows import LongRow, SpectrumRow, compare, spectra, summary, table
from training.bench.participants import FLOOR, LONG_RUNS, Participant, extra
from training.rollouts import seeded_actions

ACTIONS = ("smooth", "random", "bang-bang")
SEEDS, FRAMES, BURN_IN = range(900, 906), 175, 25
KEY = ("scene", "backend", "options", "actions")


def measure(session: Session) -> None:
    """Every scene, kind of action and backend that is missing."""
    participants = [*LONG_RUNS, *extra(session.given.backend)]
    store, powers = session.store(STEM), session.store(SPECTRA)
    seeds, frames = (SEEDS[:2], 60) if session.quick else (SEEDS, FRAMES)
    session.about |= {"seeds": list(seeds), "frames": frames, "burn_in": BURN_IN, "actions": ACTIONS}
    for scene, actions in progress([(scene, kind) for scene in session.scenes for kind in ACTIONS], STEM, name=str):
        missing = [one for one in participants if (scene, one.label, json.dumps(one.whole), actions) not in store]
        if not missing:
            continue

        def play(one: Participant, *, nudged: bool = False, scene: str = scene, kind: str = actions) -> Episodes:
            world = World(scene, num_envs=len(seeds), backend=one.backend, backend_kwargs=one.whole)
            moves = seeded_actions(world, seeds, [kind], frames)
            return watch(world, moves, seeds, BURN_IN, nudged=nudged)

        world = World(scene)
        told = names(world), world.scene.grid.length
        truth, floor = play(LONG_RUNS[0]), play(LONG_RUNS[0], nudged=True)
        powers.add(*spectra((scene, "reference", "{}", actions), truth, world.scene.frame_dt))
        for one in missing:
            found = floor if one.family == FLOOR else play(one)
            key = scene, one.label, json.dumps(one.whole), actions
            powers.add(*spectra(key, found, world.scene.frame_dt))
            store.add(compare(key, found, truth, floor, *told))


BENCHMARK = Benchmark(
    name="long-runs",
    about="Observations, rewards, energies, strains and spectra of whole episodes beside the reference's.",
    files={STEM: RowFile(LongRow, KEY), SPECTRA: RowFile(SpectrumRow, (*KEY, "kind", "at"))},
    parts=[
        Part("Episodes beside the reference's", (STEM,), table),
        Part("The same, means over kinds of action", (STEM,), summary),
    ],
    measure=measure,
    charts={STEM: "Spectra of folds and of motion over the reference's"},
    draw=draw,
)
