"""``minicloth bench peers``: MuJoCo, Taichi and our solvers on the same three scenes, in one run.

Errors are taken against two runs: our truth, and the engine's own model at a much finer step, so that no engine is
blamed for modelling another cloth; comparisons use the smaller. Times are processor times of one thread, since on a
busy machine the wall clock (also stored) punishes those whose frames are long; engines take turns.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path as Folder
from typing import Any

import numpy as np
from tqdm import tqdm

from cloth_envs.extras import install
from cloth_envs.machine import header
from cloth_envs.physics.solver import SOLVERS
from cloth_envs.registry import make_backend
from training.bench.convergence.chaos import NUDGE, nudged
from training.bench.peers import scenes as peers_scenes
from training.bench.peers.chart import draw
from training.bench.peers.rows import OWN, Row, table
from training.bench.peers.scenes import EARLY, LATE, NAMES, Engine, Own, Path, Setup, error_mm, follow, lag, p99
from training.bench.throughput.run import write_rows
from training.bench.truth import length

Options = Mapping[str, Any]
CLASSES = {"Taichi": "training.bench.peers.taichi:TaichiCloth", "MuJoCo": "training.bench.peers.mujoco:MujocoCloth"}
TRUTH: Options = {"solver": "explicit", "dtype": "float64", "refine": 4}
# Settings that were tried and left out: MuJoCo's CG (as slow as Newton: without constraints both factorise the same
# matrix), its tolerance and iterations without contact (no effect), edge constraints at steps over 4 ms or time
# constants over 8 ms (strains over 20 %), XPBD at fewer than 40 substeps with one iteration (breaks).
SETTINGS: dict[str, Sequence[Options]] = {
    OWN: [
        *({"solver": "explicit", "refine": n} for n in (1, 2, 4)),
        *({"solver": "admm", "iterations": i, "substeps": n} for i, n in ((3, 1), (10, 1), (10, 2), (10, 4), (10, 8))),
        {"solver": "implicit"},
    ],
    "Taichi": [
        *({"method": "explicit", "refine": n} for n in (0.85, 1, 2)),
        *(
            {"method": "xpbd", "substeps": n, "iterations": i}
            for n, i in ((10, 4), (20, 4), (40, 1), (80, 1), (160, 1))
        ),
    ],
    "MuJoCo": [
        *({"method": "elastic", "substeps": n} for n in (1, 2, 4)),
        *({"method": "membrane", "substeps": n} for n in (1, 2, 4)),
        {"method": "edges", "substeps": 20, "solver": "CG", "iterations": 20},
    ],
}
# On C only: contact without friction, the cheaper of MuJoCo's.
CONTACT: dict[str, Sequence[Options]] = {
    "MuJoCo": [{"method": "membrane", "substeps": n, "passive": True} for n in (1, 2)]
}
# An engine's own model at a fine step [s], by what tells its models apart. Taichi's kernels compute our forces: our
# truth is theirs (XPBD in single precision gets worse again below a step of a quarter of a millisecond). With
# friction a step of MuJoCo's shell with bending takes a second on C, its fine run minutes: left out there.
FINE: dict[str, Sequence[tuple[Options, float]]] = {
    "MuJoCo": [
        ({"method": "membrane", "passive": True}, 2.5e-3),
        ({"method": "membrane"}, 2.5e-3),
        ({"method": "elastic"}, 2.5e-3),
    ],
}


def engine_class(engine: str) -> Callable[..., Engine]:
    """What builds a peer: ``(setup, **options)``."""
    module, name = CLASSES[engine].split(":")
    found: Callable[..., Engine] = getattr(import_module(module), name)
    return found


def make(engine: str, setup: Setup, options: Options) -> Engine:
    """``engine`` with ``options``, ready at the scene's start."""
    if engine == OWN:
        return Own(setup, make_backend("reference", setup.scene, backend_kwargs=options))
    return engine_class(engine)(setup, **options)


def missing(engine: str) -> str:
    """Why ``engine`` can't take part, or nothing."""
    if engine != OWN and find_spec(engine.lower()) is None:
        return f"{engine} is not installed: {install('peers')}"
    return ""


def available(options: Options) -> bool:
    """A solver of ours that this installation has."""
    return (
        "solver" not in options
        or options["solver"] not in ("admm", "implicit")
        or (options["solver"] in SOLVERS and find_spec(SOLVERS[options["solver"]].split(":")[0]) is not None)
    )


def _takes_part(setup: Setup, fine: Options) -> bool:
    """Whether an own truth is worth its time on this scene."""
    if setup.name == "C":
        return bool(fine["method"] != "elastic")
    return not fine.get("passive")


def measure(setup: Setup, engines: Sequence[str], *, budget: float, limit: float, quick: bool) -> list[Row]:
    """All settings of ``engines`` on one scene.

    Args:
        budget: seconds for repeated runs of one setting; each runs once at least, five times at most.
        limit: seconds after which a run is stopped.
        quick: a third of the settings, no own truths.
    """
    true = follow(setup, make(OWN, setup, TRUTH))
    push = np.random.default_rng(0)
    near = replace(setup, start=nudged(setup.start, setup.scene.handles, NUDGE * length(setup.scene), push))
    floor = follow(near, make(OWN, near, TRUTH))
    chosen = [
        (engine, options)
        for engine in engines
        for options in (
            *SETTINGS[engine][:: 3 if quick else 1],
            *(CONTACT.get(engine, ()) if setup.name == "C" else ()),
        )
        if available(options)
    ]
    own: list[tuple[str, Options, Path]] = []
    fine = [] if quick else [(e, o, h) for e in engines for o, h in FINE.get(e, ()) if _takes_part(setup, o)]
    for engine, options, step in tqdm(fine, desc=f"{setup.name}: own truths", disable=None):
        substeps = round(setup.scene.frame_dt / step)
        own.append((engine, options, follow(setup, make(engine, setup, {**options, "substeps": substeps}))))
    built, first, seconds = [], [], []
    for engine, options in tqdm(chosen, desc=f"{setup.name}: engines", disable=None):
        built.append(make(engine, setup, options))
        follow(setup, built[-1], seconds=setup.scene.frame_dt)  # warms up
        first.append(follow(setup, built[-1], limit=limit))
        seconds.append([first[-1].seconds])
    for _ in tqdm(range(4), desc=f"{setup.name}: again", disable=None):
        for one, path, times in zip(built, first, seconds, strict=True):
            if not path.failure and sum(t[:, 0].sum() for t in times[1:]) + times[0][:, 0].sum() <= budget:
                times.append(follow(setup, one).seconds)
    rows = []
    for (engine, options), one, path, times in zip(chosen, built, first, seconds, strict=True):
        wall, cpu = 1e3 * np.concatenate(times).T
        mine = next((p for e, o, p in own if e == engine and o.items() <= options.items()), None)
        late, early = (mine.late, mine.early) if mine else (None, None)
        q1, median, q3 = np.percentile(cpu, [25, 50, 75])
        rows.append(
            Row(
                scene=setup.name,
                rows=setup.scene.grid.rows,
                cols=setup.scene.grid.cols,
                engine=engine,
                settings=json.dumps(dict(options)),
                step_ms=1e3 * setup.scene.frame_dt / one.substeps,
                frames=len(cpu),
                ms_q1=float(q1),
                ms=float(median),
                ms_q3=float(q3),
                wall_ms=float(np.median(wall)),
                early_mm=error_mm(setup, path.early, true.early),
                late_mm=error_mm(setup, path.late, true.late),
                own_early_mm=error_mm(setup, path.early, early),
                own_late_mm=error_mm(setup, path.late, late),
                lag=lag(setup, path.late, true.late),
                own_lag=lag(setup, path.late, late),
                p99=p99(setup, path.late),
                p99_truth=p99(setup, true.late),
                floor_early_mm=error_mm(setup, floor.early, true.early),
                floor_late_mm=error_mm(setup, floor.late, true.late),
                failure=path.failure,
            )
        )
    return rows


def parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(prog="minicloth bench peers", description=__doc__)
    top.add_argument("--scenes", default=",".join(NAMES), help="some of " + ", ".join(NAMES))
    top.add_argument("--quick", action="store_true", help="grids four times coarser, few settings; says so")
    top.add_argument("--budget", type=float, default=8.0, help="seconds for the runs of one setting (default 8)")
    top.add_argument("--out", type=Folder, help="folder for peers.csv, peers.json and the chart")
    return top


def main(argv: list[str] | None = None) -> int:
    given = parser().parse_args(argv)
    names = [name.strip() for name in given.scenes.split(",")]
    for name in names:
        if name not in NAMES:
            raise ValueError(f"--scenes takes some of {', '.join(NAMES)}, got {name!r}")
    engines = [engine for engine in SETTINGS if not missing(engine)]
    for engine in SETTINGS:
        if missing(engine):
            print(f"skipped: {missing(engine)}")
    about: dict[str, Any] = {**header(), "quick": given.quick, "threads": 1, "budget_s": given.budget}
    about |= {"omp_num_threads": os.environ.get("OMP_NUM_THREADS", "unset"), "early_s": EARLY, "late_s": LATE}
    for engine in engines[1:]:
        try:
            about[engine.lower()] = version(engine.lower())
        except PackageNotFoundError:
            about[engine.lower()] = "unknown"
    quick = ", QUICK: coarse grids, few settings" if given.quick else ""
    versions = ", ".join(f"{engine} {about[engine.lower()]}" for engine in engines[1:])
    note = f"{about['processor']}, one thread{quick}. {versions}"
    print(note)
    rows: list[Row] = []
    if given.out:
        given.out.mkdir(parents=True, exist_ok=True)
    for name in names:
        setup = peers_scenes.build(name, 4 if given.quick else 1)
        rows += measure(setup, engines, budget=given.budget, limit=30.0, quick=given.quick)
        print(table([r for r in rows if r.scene == name]), flush=True)
        if given.out:
            write_rows(given.out / "peers.csv", rows)
    if given.out:
        (given.out / "peers.json").write_text(json.dumps(about, indent=2))
        draw(rows, [given.out / f"peers.{kind}" for kind in ("png", "svg")], note=note)
        print(f"rows in {given.out / 'peers.csv'}")
    return 0
