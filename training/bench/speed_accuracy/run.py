"""``minicloth bench speed-accuracy``: error against wall-clock time a frame, every method swept into a curve.

Short windows restart every method from the truth; its error is scored after 1, 5, 10 and 25 frames. Rows that are in
--out already are kept; --fresh measures again. Run it with OMP_NUM_THREADS=1: times are of one thread.
"""

import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from pathlib import Path

from cloth_envs.progress import progress, say
from cloth_envs.registry import SCENES
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.clock import RUN_MS, RUNS, SLOW, TOO_SLOW, CostRow, costs
from training.bench.measure import ERROR_KEY, HORIZONS, ErrorRow, Windows, errors, gather
from training.bench.participants import FAMILIES, FLOOR, ORACLE, THREADED, Participant, extra, swept, truth
from training.bench.speed_accuracy.chart import OVERVIEW_FRAMES, STEM, draw
from training.bench.speed_accuracy.rows import GateRow, SpeedAccuracyRow, gate_frames, gates, summaries, table
from training.bench.speed_accuracy.speedup import SpeedUpRow, speedups
from training.bench.speed_accuracy.speedup import table as speedup_table
from training.rows import read_names
from training.truth import Case, load

SEEDS = (200, 201, 202, 203, 204)  # held out: the miniature was calibrated on 100..103
FRAMES, STARTS = 125, (25, 50, 100)  # of an episode's truth; frames at which the windows begin
TRUTH = "fine"  # finer than G1: explicit at a quarter of its step would be compared with itself
# Seconds for one method's windows of a scene, and for its falls. Slower ones do less: at least one of both; the rows
# say how many.
BUDGET, QUICK_BUDGET = 8.0, 0.4
BATCH = 16
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


def affordable(ms: float, frames: int, batch: int, budget: float) -> int:
    """How many of ``batch`` windows of ``frames`` fit into the ``budget`` [s]; all of a method that is not slow."""
    return batch if not ms > SLOW * budget / BUDGET else min(batch, int(budget * 1e3 / (ms * frames)))


def score(
    windows: Windows, falls: Windows, participants: Sequence[Participant], session: Session, *, runs: int, budget: float
) -> None:
    """Measure what the stores lack of one scene, and what was refused before."""
    scored, timed, gated = (session.store(stem) for stem in (WINDOWS, COST, FALLS))
    name, shape = windows.scene.name, windows.scene.grid.shape
    again = {(r.family, r.options) for r in scored.rows if r.scene == name and "refused" in r.failure}
    for batch, threads in ((1, 1), (BATCH, 1), (BATCH, 2)):
        missing = [
            p
            for p in participants
            if p.family != ORACLE and (batch == 1 or p.family in THREADED)
            if (name, *shape, p.family, p.text, batch, threads) not in timed or (p.family, p.text) in again
        ]
        if missing:
            count, run_ms = runs if batch == 1 else 3, RUN_MS * budget / BUDGET
            timed.add(*costs(missing, windows, batch=batch, threads=threads, runs=count, run_ms=run_ms))
    times = {(c.family, c.options): c.ms_median for c in timed.rows if (c.scene, c.batch) == (name, 1)}
    for participant in progress([truth(TRUTH), *participants], name, unit="method", name=lambda p: p.label):
        own, floor = (participant.family, participant.text), participant.family == FLOOR
        ms = times.get(own, float("nan"))
        if ms > TOO_SLOW:
            say(f"{name}: {participant.label} takes {ms:.0f} ms a frame: left out")
            continue
        threads = (os.cpu_count() or 1) if floor else 1  # as slow as the truth
        count = len(falls.seeds) if floor else affordable(ms, len(windows.controls), len(windows.seeds), budget)
        part = windows.first(max(1, count))
        keys = [(name, *shape, *own, seed, frames, part.key) for seed in set(part.seeds) for frames in HORIZONS]
        if own in again or not all(key in scored for key in keys):
            scored.add(*errors(participant, part, threads))
        if floor:
            continue
        whole = falls.first(max(1, affordable(ms, len(falls.controls), len(falls.seeds), budget)))
        keys = [(name, *shape, *own, seed, len(whole.controls), whole.key) for seed in whole.seeds]
        if own in again or not all(key in gated for key in keys):
            gated.add(*gates(participant, whole))


def measure(session: Session) -> None:
    """Errors, times and height gates of every scene, and what they amount to."""
    quick, cache = session.quick, session.cache("truth")
    seeds, last, starts = (SEEDS[:2], 60, (25, 35)) if quick else (SEEDS, FRAMES, STARTS)
    runs, budget = (5, QUICK_BUDGET) if quick else (RUNS, BUDGET)
    families = session.given.families
    chosen = None if families is None else read_names(families, list(FAMILIES), "family")
    participants = [*swept(chosen, quick=quick), *extra(session.given.backend)]
    session.about |= {
        "threads": 1,
        "omp_num_threads": os.environ.get("OMP_NUM_THREADS", "unset"),
        "seeds": seeds,
        "starts": starts,
        "horizons": HORIZONS,
        "truth": f"explicit, {TRUTH}: {truth(TRUTH).fixed}",
        "timed_runs": runs,
    }
    if session.about["omp_num_threads"] != "1":
        print("OMP_NUM_THREADS is not 1: times may not be of one thread")
    cases = [[Case(scene, seed, 4 if quick else 1, TRUTH) for seed in seeds] for scene in session.scenes]
    prepare([case for group in cases for case in group], last, cache, 1 if quick else os.cpu_count() or 1)
    for group in cases:
        windows = gather(group, starts, max(HORIZONS), range(last + 1), cache)
        falls = gather(group, (0,), gate_frames(windows.scene), range(last + 1), cache)
        score(windows, falls, participants, session, runs=runs, budget=budget)
    rows = summaries(*(session.store(stem).rows for stem in (WINDOWS, COST, FALLS)))
    session.store(STEM).replace(rows)
    session.store(SPEEDUP).replace(speedups(rows))


BENCHMARK = Benchmark(
    name="speed-accuracy",
    about="Error against wall-clock time a frame, every method swept into a curve.",
    files={
        STEM: RowFile(SpeedAccuracyRow),
        SPEEDUP: RowFile(SpeedUpRow),
        WINDOWS: RowFile(ErrorRow, ERROR_KEY),
        COST: RowFile(CostRow, ("scene", "rows", "cols", "family", "options", "batch", "threads")),
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
    charts={
        STEM: f"All scenes: error after {OVERVIEW_FRAMES} frames against milliseconds a frame, by method",
        **{f"{STEM}_{s.lower()}": f"{s}: errors against milliseconds a frame, by method" for s in SCENES},
    },
    draw=draw,
    options=lambda parser: parser.add_argument("--families", help="of methods; default all: " + ", ".join(FAMILIES)),
)  # fmt: skip
