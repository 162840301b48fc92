"""``minicloth bench stability``: where methods fail. Frames, materials, wind, bodies, grids, long and wild runs.

Every participant runs the same worlds, a few levels along each axis; its runs are compared with the truth of the same
world and each failure names its reason. Rows that are in --out already are kept; --fresh measures again.
"""

import json
import os
from collections.abc import Sequence
from dataclasses import asdict

from cloth_envs.progress import progress
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.measure import built
from training.bench.participants import STABILITY, Participant, extra, takes_part
from training.bench.stability.chart import DETAIL, STEM, draw
from training.bench.stability.rows import NOTE, SOFT, StabilityRow, table
from training.bench.stability.runs import TRUTH, run, score, truths
from training.bench.stability.worlds import AXES, DURATION, Base
from training.rows import read_names, rounded
from training.truth import DETAILED

SEEDS, QUICK_SEEDS = (300, 301), (300,)  # held out: the miniature was calibrated on 100..103
QUICK = 2  # grids are so many times coarser
World = tuple[str, float, str, int]  # axis, level, scene and seed


def worlds(scenes: Sequence[str] | None, axes: Sequence[str], seeds: Sequence[int], *, ends: bool) -> list[World]:
    """Every world in ``scenes`` (default: each axis's usual ones), seed by seed; of the axes only the ``ends``.

    Those with super-resolution, whose truth takes ten times as long, have the first seed only.
    """
    return [
        (name, level, scene, seed)
        for seed in seeds
        for name in axes
        for scene in AXES[name].of(scenes)
        if seed == seeds[0] or scene not in DETAILED
        for level in AXES[name].runs(ends=ends)
    ]


def rows_of(world: World, participants: Sequence[Participant], coarse: int) -> list[StabilityRow]:
    """Run ``participants`` in ``world`` on a grid ``coarse`` times coarser, and its truth."""
    name, asked, scene, seed = world
    stage = AXES[name].make(Base(scene, seed, coarse), asked)
    true, near = truths(stage, seed)
    out = []
    for p in participants:
        found = run(built(p, stage.scene, stage.start), stage)
        for level, frames in AXES[name].marks(asked, len(stage.controls)):
            place = name, level, scene, p.label, json.dumps(p.whole), *stage.scene.grid.shape, stage.scene.frame_dt
            out.append(StabilityRow(*place, seed, **asdict(rounded(score(found, true, near, frames)))))
    return out


def measure(session: Session) -> None:
    """All worlds that the session asks for, on grids that are so many times coarser."""
    given, quick, store = session.given, session.quick, session.store(STEM)
    axes = read_names(given.axes, list(AXES), "axis")
    named = extra(given.backend)
    seeds, coarse = (QUICK_SEEDS, QUICK) if quick else (SEEDS, 1)
    session.about |= {
        "threads": 1,
        "omp_num_threads": os.environ.get("OMP_NUM_THREADS", "unset"),
        "seeds": seeds,
        "seconds": DURATION,
        "grid": f"the scene's, {QUICK} times coarser" if quick else "the scene's",
        "coarser": {p.label: p.coarse for p in (*STABILITY, *named) if p.coarse > 1},
        "truth": f"explicit, float32, half the stable step, on each method's own grid: {TRUTH.fixed}",
        "soft": SOFT,
        "fails": NOTE,
    }
    todo = worlds(None if given.scenes is None else session.scenes, axes, seeds, ends=quick)
    for name, level, scene, seed in progress(
        todo, STEM, unit="world", name=lambda one: f"{one[2]} {one[0]} {AXES[one[0]].label(one[1])}"
    ):
        own = [*(p for p in STABILITY if takes_part(p, scene)), *named]
        missing = [p for p in own if (name, level, scene, p.label, json.dumps(p.whole), seed) not in store]
        for grid in dict.fromkeys(p.coarse for p in missing):
            same = [p for p in missing if p.coarse == grid]
            store.add(*rows_of((name, level, scene, seed), same, grid * coarse))


BENCHMARK = Benchmark(
    name=STEM,
    about="Where methods fail: frames, materials, wind, bodies, grids, long and wild runs.",
    # The grid that was asked for is that of the level, so the rows' grid is no part of the key.
    files={STEM: RowFile(StabilityRow, ("axis", "level", "scene", "backend", "options", "seed"))},
    parts=[Part("By level: runs that passed / survived / all", (STEM,), table)],
    measure=measure,
    pieces=[("--axes", axis) for axis in AXES],
    scenes=("Curtain", "Flag"),
    charts={
        STEM: "Heat maps of the runs that passed and survived: a panel an axis, a line a method",
        DETAIL: f"The same of {', '.join(DETAILED)}",
    },
    draw=draw,
    options=lambda top: top.add_argument("--axes", default=",".join(AXES), help="default: all, " + ", ".join(AXES)),
)
