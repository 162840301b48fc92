"""``minicloth bench solvers``: accuracy per cost, convergence and limits of the reference solvers.

Parts: chaos (how far nudged truths part), convergence (all solvers meet in one limit), cost (error against time a
frame), sweep (where they fail). Rows that are in --out already are kept; --fresh measures again.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cloth_envs.machine import header
from cloth_envs.physics.solver import SOLVERS
from cloth_envs.registry import SCENES
from training.bench import cost, solver_chart, summary, sweep
from training.bench.configurations import CONVERGENCE, COST, SWEEP, choose
from training.bench.convergence import chaos
from training.bench.convergence import run as convergence
from training.bench.throughput.run import write_rows
from training.bench.truth import Case, cache_folder
from training.rows import Store, read_names

PARTS = ("chaos", "convergence", "cost", "sweep")
CHART_FRAMES = 5


def parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(prog="minicloth bench solvers", description=__doc__)
    top.add_argument("--parts", default=",".join(PARTS), help="some of " + ", ".join(PARTS))
    top.add_argument("--scenes", default=",".join(SCENES), help="default: all")
    top.add_argument("--solvers", help="default: all that are installed")
    top.add_argument("--seeds", type=int, help="episodes a scene (default 5 for chaos, 3 for cost, 1 otherwise)")
    top.add_argument("--quick", action="store_true", help="coarse grids and few settings, in 2 minutes; says so")
    top.add_argument("--out", type=Path, help="folder for rows (CSV), their header (JSON) and charts")
    top.add_argument("--cache", type=Path, help="folder of the truths (default: in the user's caches)")
    top.add_argument("--fresh", action="store_true", help="measure again what --out holds of these parts")
    return top


def main(argv: list[str] | None = None) -> int:
    """Run in a process of its own where linear algebra keeps to one thread, as times are of one."""
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    given = sys.argv[1:] if argv is None else argv
    parse(given)
    return subprocess.run([sys.executable, "-m", __name__, *given], env={**os.environ, **one}).returncode


def parse(argv: list[str]) -> argparse.Namespace:
    """The options, with names checked.

    Raises:
        ValueError: an unknown part, scene or solver.
    """
    given = parser().parse_args(argv)
    given.parts = read_names(given.parts, PARTS, "part")
    given.scenes = read_names(given.scenes, list(SCENES), "scene")
    given.solvers = None if given.solvers is None else read_names(given.solvers, list(SOLVERS), "solver")
    return given


def measure(given: argparse.Namespace) -> None:
    """All parts that are asked for, in this process."""
    parts, scenes, solvers = given.parts, given.scenes, given.solvers
    quick, out, cache = given.quick, given.out, cache_folder(given.cache)
    if out:
        out.mkdir(parents=True, exist_ok=True)
    coarse = 4 if quick else 1
    about = {**header(), "quick": quick, "threads": 1}
    print(f"{about['processor']}, {about['cores']} cores{', quick: coarse grids, few settings' if quick else ''}")

    def cases(default: int, coarse: int = coarse, which: Sequence[str] = scenes) -> list[Case]:
        return [Case(scene, seed, coarse) for scene in which for seed in range(given.seeds or default)]

    def path(name: str) -> Path | None:
        return out / name if out else None

    floor_rows: list[chaos.Floor] = []
    if "chaos" in parts:
        store = Store(path("chaos_floor.csv"), chaos.Floor, chaos.KEY, fresh=given.fresh)
        frames = chaos.FRAMES[:3] if quick else chaos.FRAMES
        chaos.run(store, cases(2 if quick else 5), frames)
        floor_rows = store.rows
        print(f"\nChaos floor: truth against itself nudged by {chaos.NUDGE:g} of its length, % of the length")
        print(chaos.table(floor_rows))
        if out:
            (out / "chaos_floor.json").write_text(json.dumps(about, indent=2))
    if "convergence" in parts:
        points = Store(path("solvers_convergence.csv"), convergence.Point, convergence.KEY, fresh=given.fresh)
        chosen = cases(1, convergence.COARSE * coarse, scenes[:2] if quick else scenes)
        convergence.run(points, chosen, choose(CONVERGENCE, solvers), cache)
        print("\nConvergence to one limit")
        print(convergence.table(points.rows))
    if "cost" in parts:
        runs = Store(path("solvers_runs.csv"), cost.Run, cost.KEY, fresh=given.fresh)
        starts = cost.STARTS[::2] if quick else cost.STARTS
        limit = 1.0 if quick else cost.LIMIT
        cost.run(runs, cases(1 if quick else 3), choose(COST, solvers, 2 if quick else 1), cache, starts, limit)
        summaries = summary.summaries(runs.rows)
        print("\nAccuracy per cost, one thread")
        print(summary.table(summaries))
        if out:
            write_rows(out / "solvers.csv", summaries)
            draw(summaries, floor_rows, out, str(about["processor"]), quick)
    if "sweep" in parts:
        grid = Store(path("solvers_sweep.csv"), sweep.Cell, sweep.KEY, fresh=given.fresh)
        sweep.run(grid, cases(1, sweep.COARSE * coarse), choose(SWEEP, solvers), cache, ends=quick)
        print("\nSweep")
        print(sweep.table(grid.rows))
    if out:
        (out / "solvers.json").write_text(json.dumps(about, indent=2))
        print(f"rows in {out}")


def draw(summaries: list[summary.Summary], rows: list[chaos.Floor], out: Path, processor: str, quick: bool) -> None:
    """The chart, with the floor of ``rows`` or, at full resolution, of the stored data."""
    floors = {}
    for scene in dict.fromkeys(s.scene for s in summaries):
        found = [r.error for r in rows if (r.scene, r.frames) == (scene, CHART_FRAMES)]
        if found:
            floors[scene] = float(np.median(found))
        elif not quick and chaos.DATA.is_file():
            floors[scene] = chaos.floor(scene, CHART_FRAMES)
    note = (
        f"Mean distance of the vertices from the truth, {CHART_FRAMES} frames after restarts from it. Hollow: within "
        "0.5 s a run failed, or the\nmean height lags (or leads) the truth's by over 5 % of its way. Grey: below the "
        "chaos floor, where errors mean nothing.\n"
        f"{processor}, one thread{'. QUICK: coarse grids, few settings' * quick}."
    )
    paths = [out / f"solvers.{kind}" for kind in ("png", "svg")]
    solver_chart.draw(summaries, floors, paths, frames=CHART_FRAMES, note=note)


if __name__ == "__main__":
    measure(parse(sys.argv[1:]))
