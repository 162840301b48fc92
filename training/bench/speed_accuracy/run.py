"""``minicloth bench speed-accuracy``: error against wall-clock time a frame, every method swept into a curve.

Short windows restart every method from the truth; its error is scored after 1, 5, 10 and 25 frames. Rows that are in
--out already are kept; --fresh measures again. Run it with OMP_NUM_THREADS=1: times are of one thread.
"""

import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from cloth_envs.physics.truth import TRUTHS
from cloth_envs.progress import progress, say
from cloth_envs.registry import SCENES
from training.bench.benchmark import MEASURED, Benchmark, Part, RowFile, Session
from training.bench.clock import RUN_MS, RUNS, SLOW, TOO_SLOW, CostRow, costs
from training.bench.measure import ERROR_KEY, HORIZONS, ErrorRow, Windows, errors, gather
from training.bench.participants import FAMILIES, FLOOR, ORACLE, Participant, extra, swept, takes_part, truth
from training.bench.speed_accuracy.chart import OVERVIEW_FRAMES, STEM, draw
from training.bench.speed_accuracy.rows import GateRow, SpeedAccuracyRow, gate_frames, gates, summaries, table
from training.bench.speed_accuracy.speedup import SpeedUpRow, speedups
from training.bench.speed_accuracy.speedup import table as speedup_table
from training.rows import read_names
from training.truth import DETAILED, Case, load, unseen

SEEDS = (1500, 1501, 1502, 1503, 1504)  # no fit has seen them, nor has a choice
FEW = 2  # of them on scenes with super-resolution
FRAMES, STARTS = 125, (25, 50, 100)  # of an episode's truth; frames at which the windows begin
# Finer than G1: explicit at a quarter of its step would be compared with itself. Scenes with super-resolution, whose
# frames take ten times as long, have G1 and no such setting.
TRUTH, COARSER = "fine", "g1"
# Seconds for one method's windows of a scene, and for its falls. Slower ones do less: at least one of both; the rows
# say how many.
BUDGET, QUICK_BUDGET = 8.0, 0.4
WINDOWS, COST, FALLS, SPEEDUP = (f"{STEM}_{name}" for name in ("windows", "cost", "gate", "speedup"))


def _prepare(job: tuple[Case, int, Path]) -> None:
    case, last, cache = job
    load(case, last, range(last + 1), cache)


def prepare(cases: Sequence[Case], last: int, cache: Path, processes: int) -> None:
    """Compute the truths that ``cache`` lacks, several at once."""
    jobs = [(case, last, cache) for case in cases]
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, spawn) if processes > 1 else nullcontext() as pool:
        list(progress(pool.map(_prepare, jobs) if pool else map(_prepare, jobs), "truth", len(jobs), unit="run"))


def truth_of(scene: str) -> str:
    """Which of ``TRUTHS`` is that of a scene."""
    return COARSER if scene in DETAILED else TRUTH


def affordable(ms: float, frames: int, batch: int, budget: float) -> int:
    """How many of ``batch`` windows of ``frames`` fit into the ``budget`` [s]; all of a method that is not slow."""
    return batch if not ms > SLOW * budget / BUDGET else min(batch, int(budget * 1e3 / (ms * frames)))


@dataclass(frozen=True, eq=False)
class Scope:
    """What a session covers: participants, truths (``cases`` of every scene up to frame ``last``), windows, effort."""

    participants: list[Participant]
    named: list[Participant]  # by --backend: on all scenes
    cases: list[list[Case]]
    last: int
    starts: Sequence[int]
    runs: int
    budget: float
    again: set[tuple[str, str, str]]  # scene, family and options of what was refused before

    def on(self, scene: str) -> list[Participant]:
        """Those that are measured on a scene."""
        finest = TRUTHS[truth_of(scene)]["refine"]
        swept = (p for p in self.participants if takes_part(p, scene) and p.options.get("refine", 1) < finest)
        return [*swept, *self.named]

    def windows(self, cases: Sequence[Case], cache: Path) -> Windows:
        """Those of one scene."""
        return gather(cases, self.starts, max(HORIZONS), range(self.last + 1), cache)


def scope(session: Session) -> Scope:
    """What ``session`` asks for; its truths are there afterwards."""
    quick, cache, given = session.quick, session.cache("truth"), session.given
    seeds, last, starts = (SEEDS[:2], 60, (25, 35)) if quick else (SEEDS, FRAMES, STARTS)
    runs, budget = (5, QUICK_BUDGET) if quick else (RUNS, BUDGET)
    chosen = None if given.families is None else read_names(given.families, list(FAMILIES), "family")
    participants, named = swept(chosen, quick=quick), extra(given.backend)
    session.about |= {
        "threads": 1,
        "omp_num_threads": os.environ.get("OMP_NUM_THREADS", "unset"),
        "seeds": seeds,
        "starts": starts,
        "horizons": HORIZONS,
        "truth": {scene: truth_of(scene) for scene in session.scenes},
        "timed_runs": runs,
    }
    cases = [
        [
            Case(scene, seed, 4 if quick else 1, truth_of(scene), sequence=unseen(scene))
            for seed in (seeds[:FEW] if scene in DETAILED else seeds)
        ]
        for scene in session.scenes
    ]
    prepare([case for group in cases for case in group], last, cache, 1 if quick else os.cpu_count() or 1)
    again = {(r.scene, r.family, r.options) for r in session.store(WINDOWS).rows if "refused" in r.failure}
    return Scope(participants, named, cases, last, starts, runs, budget, again)


def times(session: Session) -> None:
    """Times of a frame that the session's store lacks, and of what was refused before."""
    whole, timed = scope(session), session.store(COST)
    if session.about["omp_num_threads"] != "1":
        print("OMP_NUM_THREADS is not 1: times may not be of one thread")
    for cases in progress(whole.cases, "times", unit="scene", name=lambda one: one[0].scene):
        windows = whole.windows(cases, session.cache("truth"))
        name, shape = windows.scene.name, windows.scene.grid.shape
        missing = [
            p
            for p in whole.on(name)
            if p.family != ORACLE
            if (name, *shape, p.family, p.text) not in timed or (name, p.family, p.text) in whole.again
        ]
        if missing:
            timed.add(*costs(missing, windows, runs=whole.runs, run_ms=RUN_MS * whole.budget / BUDGET))


def measure(session: Session) -> None:
    """Errors and height gates of every scene, and what they amount to with the times."""
    whole = scope(session)
    for cases in whole.cases:
        score(session, whole, cases)
    rows = summaries(*(session.store(stem).rows for stem in (WINDOWS, COST, FALLS)))
    session.store(STEM).replace(rows)
    session.store(SPEEDUP).replace(speedups(rows))


def score(session: Session, whole: Scope, cases: Sequence[Case]) -> None:
    """Errors and height gates of one scene that the stores lack, and of what was refused before."""
    cache, budget = session.cache("truth"), whole.budget
    windows = whole.windows(cases, cache)
    falls = gather(cases, (0,), gate_frames(windows.scene), range(whole.last + 1), cache)
    scored, gated, name, shape = session.store(WINDOWS), session.store(FALLS), cases[0].scene, windows.scene.grid.shape
    taken = {(c.family, c.options): c.ms_median for c in session.store(COST).rows if c.scene == name}
    for participant in progress([truth(truth_of(name)), *whole.on(name)], name, unit="method", name=lambda p: p.label):
        own, floor = (participant.family, participant.text), participant.family == FLOOR
        ms, again = taken.get(own, float("nan")), (name, *own) in whole.again
        if ms > TOO_SLOW:
            say(f"{name}: {participant.label} takes {ms:.0f} ms a frame: left out")
            continue
        threads = (os.cpu_count() or 1) if floor else 1  # as slow as the truth
        count = len(falls.seeds) if floor else affordable(ms, len(windows.controls), len(windows.seeds), budget)
        part = windows.first(max(1, count))
        keys = [(name, *shape, *own, seed, frames, part.key) for seed in set(part.seeds) for frames in HORIZONS]
        if again or not all(key in scored for key in keys):
            scored.add(*errors(participant, part, threads))
        if floor:
            continue
        run = falls.first(max(1, affordable(ms, len(falls.controls), len(falls.seeds), budget)))
        keys = [(name, *shape, *own, seed, len(run.controls), run.key) for seed in run.seeds]
        if again or not all(key in gated for key in keys):
            gated.add(*gates(participant, run))


BENCHMARK = Benchmark(
    name="speed-accuracy",
    about="Error against wall-clock time a frame, every method swept into a curve.",
    files={
        STEM: RowFile(SpeedAccuracyRow),
        SPEEDUP: RowFile(SpeedUpRow),
        WINDOWS: RowFile(ErrorRow, ERROR_KEY),
        COST: RowFile(CostRow, ("scene", "rows", "cols", "family", "options")),
        FALLS: RowFile(GateRow, ERROR_KEY),
    },
    parts=[
        Part("Methods", (STEM,), table),
        Part(
            "Speed-up at equal error, at most (interpolated), over ever stronger baselines; *: fails the height gate",
            (SPEEDUP,), speedup_table,
        ),
    ],
    measure=measure,
    times=times,
    scenes=(*MEASURED, *DETAILED),
    charts={
        STEM: f"All scenes: error after {OVERVIEW_FRAMES} frames against milliseconds a frame, by method",
        **{f"{STEM}_{s.lower()}": f"{s}: errors against milliseconds a frame, by method" for s in SCENES},
    },
    draw=draw,
    options=lambda parser: parser.add_argument("--families", help="of methods; default all: " + ", ".join(FAMILIES)),
)  # fmt: skip
