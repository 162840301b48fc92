"""``minicloth bench speed-accuracy``: error against wall-clock time a frame, every method swept into a curve.

Short windows restart every method from the truth; its error is scored after 1, 5, 10 and 25 frames. Long runs are
compared by statistics. Rows that are in --out already are kept; --fresh measures again. Run it with OMP_NUM_THREADS=1:
times are of one thread.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from cloth_envs.registry import SCENES
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.clock import COST_KEY, RUN_MS, RUNS, SLOW, TOO_SLOW, CostRow, costs
from training.bench.measure import ERROR_KEY, HORIZONS, ErrorRow, errors
from training.bench.participants import FAMILIES, FLOOR, ORACLE, THREADED, Participant, extra, swept, truth
from training.bench.speed_accuracy.chart import OVERVIEW_FRAMES, STEM, draw
from training.bench.speed_accuracy.long import BURN_IN, LongRow, gate_frames, long_runs
from training.bench.speed_accuracy.rows import SpeedAccuracyRow, claims, summaries, table
from training.bench.speed_accuracy.speedup import SpeedUpRow, speedups
from training.bench.speed_accuracy.speedup import table as speedup_table
from training.bench.windows import Windows, gather
from training.rows import Store, read_names
from training.truth import Case, load

SEEDS = (200, 201, 202, 203, 204)  # held out: the miniature was calibrated on 100..103
FRAMES, STARTS = 125, (25, 50, 100)  # of an episode's truth; frames at which the windows begin
TRUTH = "fine"  # finer than G1: explicit at a quarter of its step would be compared with itself
# Seconds for one method's windows of a scene, and for its long runs. Slower ones do less: at least one window and the
# frames of the height gate; the rows say how many.
BUDGET, QUICK_BUDGET = 8.0, 0.4
BATCH = 16
FLOOR_RUNS = 2  # long runs of the chaos floor
WINDOWS, COST, LONG, SPEEDUP = (f"{STEM}_{name}" for name in ("windows", "cost", "long", "speedup"))


@dataclass(frozen=True)
class Stores:
    """Where rows go."""

    windows: Store[ErrorRow]
    cost: Store[CostRow]
    long: Store[LongRow]

    def cost_of(self, participant: Participant, scene: str) -> float:
        """Milliseconds of a frame of one cloth, NaN if it was not timed."""
        key = scene, participant.family, participant.text, 1
        ms = [c.ms_median for c in self.cost.rows if (c.scene, c.family, c.options, c.batch) == key]
        return ms[0] if ms else float("nan")


def _prepare(job: tuple[Case, int, Path]) -> None:
    case, last, cache = job
    load(case, last, range(last + 1), cache)


def prepare(cases: Sequence[Case], last: int, cache: Path, processes: int) -> None:
    """Compute the truths that ``cache`` lacks, several at once."""
    jobs = [(case, last, cache) for case in cases]
    if processes < 2:
        for job in tqdm(jobs, desc="truth", disable=None):
            _prepare(job)
        return
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        list(tqdm(pool.map(_prepare, jobs), total=len(jobs), desc="truth", disable=None))


def affordable(ms: float, frames: int, batch: int, budget: float) -> int:
    """How many of ``batch`` windows of ``frames`` fit into the ``budget`` [s]; all of a method that is not slow."""
    return batch if not ms > SLOW * budget / BUDGET else min(batch, int(budget * 1e3 / (ms * frames)))


def time(
    windows: Windows, participants: Sequence[Participant], stores: Stores, again: set[tuple[str, str]], runs: int,
    budget: float,
) -> None:  # fmt: skip
    """Time what the store lacks of one scene, and what was refused before."""
    where = windows.scene.name, *windows.scene.grid.shape
    for batch, threads in ((1, 1), (BATCH, 1), (BATCH, 2)):
        missing = [
            p
            for p in participants
            if p.family != ORACLE and (batch == 1 or p.family in THREADED)
            if (*where, p.family, p.text, batch, threads) not in stores.cost or (p.family, p.text) in again
        ]
        if missing:
            count, run_ms = runs if batch == 1 else 3, RUN_MS * budget / BUDGET
            stores.cost.add(*costs(missing, windows, batch=batch, threads=threads, runs=count, run_ms=run_ms))


def score(
    windows: Windows, long: Windows, participants: Sequence[Participant], stores: Stores, *, runs: int, budget: float,
    horizons: Sequence[int] = HORIZONS, burn_in: int = BURN_IN,
) -> None:  # fmt: skip
    """Measure what the stores lack of one scene."""
    name, shape = windows.scene.name, windows.scene.grid.shape
    again = {(r.family, r.options) for r in stores.windows.rows if r.scene == name and "refused" in r.failure}
    time(windows, participants, stores, again, runs, budget)
    bar = tqdm([truth(TRUTH), *participants], desc=name, disable=None)
    for participant in bar:
        bar.set_postfix_str(participant.label)
        ms, floor = stores.cost_of(participant, name), participant.family == FLOOR
        if ms > TOO_SLOW:
            tqdm.write(f"{name}: {participant.label} takes {ms:.0f} ms a frame: left out")
            continue
        threads = (os.cpu_count() or 1) if floor else 1  # as slow as the truth
        own = participant.family, participant.text
        count = len(long.seeds) if floor else affordable(ms, len(windows.controls), len(windows.seeds), budget)
        part = windows.first(max(1, count))
        keys = [(name, *shape, *own, seed, frames, part.key) for seed in set(part.seeds) for frames in horizons]
        if own in again or not all(key in stores.windows for key in keys):
            stores.windows.add(*errors(participant, part, threads, horizons))
        count = FLOOR_RUNS if floor else affordable(ms, len(long.controls), len(long.seeds), budget)
        whole = long.first(count) if count else long.first(1).until(gate_frames(long.scene))
        keys = [(name, *shape, *own, seed, len(whole.controls), long.key) for seed in whole.seeds]
        if own in again or not all(key in stores.long for key in keys):
            stores.long.add(*long_runs(participant, whole, threads, burn_in))


def measure(session: Session) -> None:
    """Errors, times and long runs of every scene, and what they amount to."""
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
        "long_frames": last,
        "truth": f"explicit, {TRUTH}: {truth(TRUTH).fixed}",
        "timed_runs": runs,
    }
    if session.about["omp_num_threads"] != "1":
        print("OMP_NUM_THREADS is not 1: times may not be of one thread")
    stores = Stores(session.store(WINDOWS), session.store(COST), session.store(LONG))
    cases = {scene: [Case(scene, seed, 4 if quick else 1, TRUTH) for seed in seeds] for scene in session.scenes}
    prepare([c for group in cases.values() for c in group], last, cache, 1 if quick else os.cpu_count() or 1)
    for group in cases.values():
        windows, long = gather(group, starts, max(HORIZONS), last, cache), gather(group, (0,), last, last, cache)
        score(windows, long, participants, stores, runs=runs, budget=budget)
    rows = summaries(stores.windows.rows, stores.cost.rows, stores.long.rows)
    session.store(STEM).replace(rows)
    session.store(SPEEDUP).replace(speedups(rows))


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--families", help="of methods; default all: " + ", ".join(FAMILIES))


BENCHMARK = Benchmark(
    name="speed-accuracy",
    about="Error against wall-clock time a frame, every method swept into a curve.",
    files={
        STEM: RowFile(SpeedAccuracyRow),
        SPEEDUP: RowFile(SpeedUpRow),
        WINDOWS: RowFile(ErrorRow, ERROR_KEY),
        COST: RowFile(CostRow, COST_KEY),
        LONG: RowFile(LongRow, ERROR_KEY),
    },
    parts=[
        Part("Methods", (STEM,), table),
        Part(
            f"Miniature, error after {OVERVIEW_FRAMES} frames and time against explicit at full resolution "
            "(upscaling included)", (STEM,), claims,
        ),
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
    options=_options,
)  # fmt: skip
