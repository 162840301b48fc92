"""``minicloth bench speed-accuracy``: error against wall-clock time a frame, every method swept into a curve.

Short windows restart every method from the truth; its error is scored after 1, 5, 10 and 25 frames. Long runs are
compared by statistics. Rows that are in --out already are kept; --fresh measures again. Run it with OMP_NUM_THREADS=1:
times are of one thread.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import subprocess
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

from tqdm import tqdm

from cloth_envs.machine import header
from cloth_envs.registry import SCENES
from training.bench.measure import (
    HORIZONS,
    LONG_KEY,
    SCORE_KEY,
    Long,
    Score,
    gate_frames,
    long_run,
    score,
)
from training.bench.participants import FAMILIES, FLOOR, ORACLE, THREADED, Method, choose, label
from training.bench.speed_accuracy import chart as charts
from training.bench.speed_accuracy import speedup as speed_accuracy_speedup
from training.bench.speed_accuracy.cost import COST_KEY, RUN_MS, RUNS, SLOW, TOO_SLOW, Cost, cost
from training.bench.speed_accuracy.rows import Summary, claims, summaries, table
from training.bench.throughput.run import write_rows
from training.bench.truth import Case, cache_folder, load
from training.bench.windows import REFINE, Windows, gather
from training.rows import Store, read_names, read_rows

SEEDS = (200, 201, 202, 203, 204)  # held out: the miniature was calibrated on 100..103
FRAMES, STARTS = 125, (25, 50, 100)  # of an episode's truth; frames at which the windows begin
# Seconds for one method's windows of a scene, and for its long runs. Slower ones do less: at least one window and the
# frames of the height gate; the rows say how many.
BUDGET, QUICK_BUDGET = 8.0, 0.4
BATCH = 16
FLOOR_RUNS = 2  # long runs of the chaos floor


def parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(prog="minicloth bench speed-accuracy", description=__doc__)
    top.add_argument("--scenes", default=",".join(SCENES), help="default: all")
    top.add_argument("--families", help="of methods; default all: " + ", ".join(FAMILIES))
    top.add_argument("--quick", action="store_true", help="coarse grids, few settings, in 2 minutes; says so")
    top.add_argument("--out", type=Path, help="folder for rows (CSV), their header (JSON) and charts")
    top.add_argument("--images", type=Path, help="another folder for the charts")
    top.add_argument("--chart-only", action="store_true", help="draw what --out holds, measure nothing")
    top.add_argument("--cache", type=Path, help="folder of the truths (default: in the user's caches)")
    top.add_argument("--fresh", action="store_true", help="measure again what --out holds")
    return top


def revision() -> str:
    """The commit that this code is at, with ``-dirty`` where files differ from it; empty outside a checkout."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
    found = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=False)
    return found.stdout.strip()


def _prepare(job: tuple[Case, int, Path]) -> None:
    case, last, cache = job
    load(replace(case, refine=REFINE), last, range(last + 1), cache)


def prepare(cases: Sequence[Case], last: int, cache: Path, processes: int) -> None:
    """Compute the truths that ``cache`` lacks, several at once."""
    jobs = [(case, last, cache) for case in cases]
    bar = tqdm(total=len(jobs), desc="truth", disable=None)
    if processes < 2:
        for job in jobs:
            _prepare(job)
            bar.update()
        return
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        for _ in pool.map(_prepare, jobs):
            bar.update()


def affordable(method: Method, costs: Sequence[Cost], scene: str, frames: int, batch: int, budget: float) -> int:
    """How many of ``batch`` windows of ``frames`` fit into the ``budget`` [s]; all of a method that is not slow."""
    key = scene, method.family, method.text, 1
    ms = [c.ms_median for c in costs if (c.scene, c.family, c.options, c.batch) == key]
    if not ms or not ms[0] > SLOW * budget / BUDGET:
        return batch
    return min(batch, int(budget * 1e3 / (ms[0] * frames)))


def measure(
    windows: Windows,
    long: Windows,
    methods: Sequence[Method],
    stores: tuple[Store[Score], Store[Cost], Store[Long]],
    *,
    runs: int,
    budget: float,
    horizons: Sequence[int] = HORIZONS,
    burn_in: int = 25,
) -> None:
    """Measure what the stores lack of one scene."""
    scores, costs, longs = stores
    name, shape = windows.scene.name, windows.scene.grid.shape
    refused = {(r.family, r.options) for r in scores.rows if r.scene == name and "refused" in r.failure}
    timed = [m for m in methods if m.family != ORACLE]
    for batch, threads in ((1, 1), (BATCH, 1), (BATCH, 2)):
        wanted = [m for m in timed if batch == 1 or m.family in THREADED]
        missing = [
            m
            for m in wanted
            if (name, *shape, m.family, m.text, batch, threads) not in costs or (m.family, m.text) in refused
        ]
        if missing:
            costs.add(
                *cost(
                    missing,
                    windows,
                    batch=batch,
                    threads=threads,
                    runs=runs if batch == 1 else 3,
                    run_ms=RUN_MS * budget / BUDGET,
                )
            )
    with tqdm(total=len(methods) + 1, desc=name, disable=None) as bar:
        for method in [Method(FLOOR), *methods]:
            bar.set_postfix_str(label(method.family, method.text))
            bar.update()
            own = [c for c in costs.rows if (c.scene, c.family, c.options) == (name, method.family, method.text)]
            if any(c.ms_median > TOO_SLOW for c in own):
                tqdm.write(
                    f"{name}: {label(method.family, method.text)} takes {own[0].ms_median:.0f} ms a frame: left out"
                )
                continue
            threads = (os.cpu_count() or 1) if method.family == FLOOR else 1
            key, again = (name, *shape, method.family, method.text), (method.family, method.text) in refused
            count = affordable(method, costs.rows, name, len(windows.controls), len(windows.seeds), budget)
            if method.family == FLOOR:  # as slow as the truth
                count = len(long.seeds)
            part = windows.first(max(1, count))
            if again or not all((*key, s, h, part.key) in scores for s in set(part.seeds) for h in horizons):
                scores.add(*score(method, part, threads, horizons))
            count = affordable(method, costs.rows, name, len(long.controls), len(long.seeds), budget)
            if method.family == FLOOR:
                count = FLOOR_RUNS
            whole = long.first(count) if count else long.first(1).until(gate_frames(long.scene))
            frames = len(whole.controls)
            if again or not all((*key, s, frames, long.key) in longs for s in whole.seeds):
                longs.add(*long_run(method, whole, threads, burn_in))


def main(argv: list[str] | None = None) -> int:
    given = parser().parse_args(argv)
    scenes = read_names(given.scenes, list(SCENES), "scene")
    families = None if given.families is None else read_names(given.families, list(FAMILIES), "family")
    out, quick = given.out, given.quick
    if given.chart_only:
        if out is None:
            raise ValueError("--chart-only needs --out, the folder that holds the rows")
        about = json.loads((out / "speed_accuracy.json").read_text())
        rows = read_rows(out / "speed_accuracy.csv", Summary)
        draw(rows, given.images or out, about)
        write_speedups(rows, out)
        return 0
    if out:
        out.mkdir(parents=True, exist_ok=True)
    stores = tuple(
        Store(out / name if out else None, kind, key, fresh=given.fresh)
        for name, kind, key in (
            ("speed_accuracy_windows.csv", Score, SCORE_KEY),
            ("speed_accuracy_cost.csv", Cost, COST_KEY),
            ("speed_accuracy_long.csv", Long, LONG_KEY),
        )
    )
    seeds, last, starts = (SEEDS[:2], 60, (25, 35)) if quick else (SEEDS, FRAMES, STARTS)
    runs, budget = (5, QUICK_BUDGET) if quick else (RUNS, BUDGET)
    about = {
        **header(),
        "revision": revision(),
        "quick": quick,
        "threads": 1,
        "omp_num_threads": os.environ.get("OMP_NUM_THREADS", "unset"),
        "seeds": seeds,
        "starts": starts,
        "horizons": HORIZONS,
        "long_frames": last,
        "truth": f"explicit, float64, 1/{REFINE} of the stable step",
        "timed_runs": runs,
    }
    print(f"{about['processor']}, {about['cores']} cores{', quick: coarse grids, few settings' if quick else ''}")
    if about["omp_num_threads"] != "1":
        print("OMP_NUM_THREADS is not 1: times may not be of one thread")
    cases = {scene: [Case(scene, seed, 4 if quick else 1) for seed in seeds] for scene in scenes}
    cache = cache_folder(given.cache)
    prepare([c for group in cases.values() for c in group], last, cache, 1 if quick else os.cpu_count() or 1)
    for scene in scenes:
        windows = gather(cases[scene], starts, max(HORIZONS), last, cache)
        long = gather(cases[scene], (0,), last, last, cache)
        measure(windows, long, choose(families, quick=quick), stores, runs=runs, budget=budget)  # type: ignore[arg-type]
    rows = summaries(*(store.rows for store in stores))  # type: ignore[arg-type]
    print(table(rows))
    print(claims(rows))
    print(speed_accuracy_speedup.table(speed_accuracy_speedup.speedups(rows)))
    if out:
        write_rows(out / "speed_accuracy.csv", rows)
        (out / "speed_accuracy.json").write_text(json.dumps(about, indent=2))
        draw(rows, given.images or out, about)
        write_speedups(rows, out)
        print(f"rows in {out}")
    return 0


def write_speedups(rows: Sequence[Summary], out: Path) -> None:
    """Speed-ups at equal error, where ``rows`` have methods and baselines to compare."""
    found = speed_accuracy_speedup.speedups(rows)
    if found:
        write_rows(out / "speed_accuracy_speedup.csv", found)


def draw(rows: Sequence[Summary], folder: Path, about: dict[str, object]) -> None:
    """One chart a scene, and one of all scenes after 5 frames."""
    folder.mkdir(parents=True, exist_ok=True)
    setup = f"{about['processor']}, one thread{', QUICK: coarse grids' if about['quick'] else ''}"
    for scene in dict.fromkeys(row.scene for row in rows):
        stem = f"speed_accuracy_{scene.lower()}"
        charts.scene(rows, scene, [folder / f"{stem}.{kind}" for kind in ("png", "svg")], setup=setup)
    charts.overview(rows, [folder / f"speed_accuracy.{kind}" for kind in ("png", "svg")], setup=setup)
