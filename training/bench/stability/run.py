"""``minicloth bench stability``: where methods fail. Frames, materials, wind, bodies, grids, long and wild runs.

Every participant runs the same worlds, a few levels along each axis; its runs are compared with the truth of the same
world and each failure names its reason. Rows that are in --out already are kept; --fresh measures again.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

from tqdm import tqdm

from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.measure import built
from training.bench.participants import STABILITY, Participant, extra
from training.bench.stability.chart import STEM, draw
from training.bench.stability.rows import KEY, Place, StabilityRow, table
from training.bench.stability.runs import BUDGETED, BURST, GATE, TRUTH, run, truths
from training.bench.stability.scores import ASTRAY, DRIFT, EARLY, GAINED, HEIGHT, LIVELY, SOFT, SPARE, STRAINED, score
from training.bench.stability.worlds import AXES, DURATION, Base
from training.rows import Store, read_names, rounded

SEEDS, QUICK_SEEDS = (300, 301, 302, 303, 304), (300,)  # held out: the miniature was calibrated on 100..103
QUICK = 2  # grids are so many times coarser


class World(NamedTuple):
    """One world, but for its grid."""

    axis: str
    level: float
    scene: str
    seed: int


def worlds(scenes: Sequence[str] | None, axes: Sequence[str], seeds: Sequence[int], *, ends: bool) -> list[World]:
    """Every world in ``scenes`` (default: each axis's usual ones), seed by seed; of the axes only the ``ends``."""
    return [
        World(name, level, scene, seed)
        for seed in seeds
        for name in axes
        for scene in AXES[name].of(scenes)
        for level in AXES[name].runs(ends=ends)
    ]


def options(participant: Participant) -> str:
    """All that its backend is given, as JSON, for a row."""
    return json.dumps(participant.whole)


def rows_of(world: World, participants: Sequence[Participant], coarse: int) -> list[StabilityRow]:
    """Run ``participants`` in ``world`` on a grid ``coarse`` times coarser, and its truth."""
    axis = AXES[world.axis]
    stage = axis.make(Base(world.scene, world.seed, coarse), world.level)
    true, near = truths(stage, world.seed)
    out = []
    for p in participants:
        found = run(built(p, stage.scene), stage)
        for level, frames in axis.marks(world.level, len(stage.controls)):
            place = Place(
                world.axis, level, world.scene, p.label, options(p), *stage.scene.grid.shape, stage.scene.frame_dt,
                world.seed,
            )  # fmt: skip
            out.append(StabilityRow(**asdict(place), **asdict(rounded(score(found, true, near, frames)))))
    return out


def fill(
    store: Store[StabilityRow], todo: Sequence[World], participants: Sequence[Participant], coarse: int = 1
) -> None:
    """Measure what ``store`` lacks of the worlds ``todo``, on grids ``coarse`` times coarser."""
    bar = tqdm(todo, desc=STEM, disable=None)
    for world in bar:
        bar.set_postfix_str(f"{world.scene} {world.axis} {AXES[world.axis].label(world.level)}")
        missing = [p for p in participants if (*world[:3], p.label, options(p), world.seed) not in store]
        for grid in dict.fromkeys(p.coarse for p in missing):
            store.add(*rows_of(world, [p for p in missing if p.coarse == grid], grid * coarse))


def measure(session: Session) -> None:
    """All worlds that the session asks for."""
    given, quick = session.given, session.quick
    axes = read_names(given.axes, list(AXES), "axis")
    participants = [*STABILITY, *extra(given.backend)]
    seeds = QUICK_SEEDS if quick else SEEDS
    session.about |= _about(participants, seeds, quick=quick)
    todo = worlds(None if given.scenes is None else session.scenes, axes, seeds, ends=quick)
    fill(session.store(STEM), todo, participants, QUICK if quick else 1)


def _about(participants: Sequence[Participant], seeds: Sequence[int], *, quick: bool) -> dict[str, Any]:
    return {
        "threads": 1,
        "omp_num_threads": os.environ.get("OMP_NUM_THREADS", "unset"),
        "seeds": seeds,
        "seconds": DURATION,
        "grid": f"the scene's, {QUICK} times coarser" if quick else "the scene's",
        "coarser": {p.label: p.coarse for p in participants if p.coarse > 1},
        "truth": f"explicit, float32, half the stable step, on each method's own grid: {TRUTH.fixed}",
        "soft": SOFT,
        "fails": {
            "blow-up": f"a value that is not finite, or an edge at {BURST:g} times its length",
            "overstretch": "an edge at twice its length",
            "energy": f"200 J/kg gained in a frame, or kinetic over {LIVELY:g} times the truth's + {SPARE:g} J/kg",
            "tunnelling": "a vertex or triangle that a body went through",
            "momentum": f"drift over {DRIFT:g} of the sum of m |v|, with no force from outside",
            "slow motion, fast motion": f"mean height off by over {HEIGHT:g} of its way within {GATE:g} s, and by "
            "twice the difference that a nudge of a millionth makes",
            "error": f"vertices off by over {ASTRAY:g} of the length after {EARLY:g} s",
            "strained": f"p99 strain over {STRAINED:g} times the truth's + 0.05",
            "energy drift": f"{GAINED:g} m g H from nowhere in {BUDGETED} frames beyond what the truth's budget leaves",
            "refused": "the backend can't; its words",
        },
    }


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--axes", default=",".join(AXES), help="default: all, " + ", ".join(AXES))


BENCHMARK = Benchmark(
    name=STEM,
    about="Where methods fail: frames, materials, wind, bodies, grids, long and wild runs.",
    files={STEM: RowFile(StabilityRow, KEY)},
    parts=[Part("By level: runs that passed / survived / all", (STEM,), table)],
    measure=measure,
    scenes=("Curtain", "Flag"),
    charts={STEM: "Heat maps of the runs that passed and survived: a panel an axis, a line a method"},
    draw=draw,
    options=_options,
)
