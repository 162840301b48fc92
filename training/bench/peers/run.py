"""``minicloth bench peers``: MuJoCo, Taichi and our solvers on the same three scenes, in one run.

Errors are taken against two runs: our truth, and the engine's own model at a much finer step, so that no engine is
blamed for modelling another cloth; comparisons use the smaller. Times are processor times of one thread, since on a
busy machine the wall clock (also stored) punishes those whose frames are long; engines take turns.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from cloth_envs.backend import Backend
from cloth_envs.extras import install
from cloth_envs.naming import resolve
from cloth_envs.physics.truth import TRUTHS
from cloth_envs.registry import make_backend
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.participants import extra
from training.bench.peers.chart import STEM, draw
from training.bench.peers.rows import OWN, PEER_KEY, PeerRow, table
from training.bench.peers.scenes import EARLY, LATE, NAMES, Setup, Trace, build, error_mm, follow, lag, p99
from training.rollouts import nudge

Options = Mapping[str, Any]
CLASSES = {"Taichi": "training.bench.peers.taichi:TaichiCloth", "MuJoCo": "training.bench.peers.mujoco:MujocoCloth"}
TRUTH: Options = {"solver": "explicit", **TRUTHS["g1"]}
LIMIT, QUICK = 30.0, 4  # s after which a run is stopped; grids are so many times coarser
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


class Entry(NamedTuple):
    """An engine with one setting."""

    engine: str
    options: Options


def make(entry: Entry, setup: Setup) -> Backend:
    """The engine of ``entry`` for one cloth: ours, a peer, or a backend that ``--backend`` named."""
    if entry.engine in CLASSES:
        peer: Backend = resolve(CLASSES[entry.engine])(setup, **entry.options)
        return peer
    name = "reference" if entry.engine == OWN else entry.engine
    return make_backend(name, setup.scene, backend_kwargs=entry.options)


def missing(engine: str) -> str:
    """Why ``engine`` can't take part, or nothing."""
    if engine in CLASSES and find_spec(engine.lower()) is None:
        return f"{engine} is not installed: {install('peers')}"
    return ""


def entries(scene: str, engines: Sequence[str], *, quick: bool) -> list[Entry]:
    """All that is run on ``scene``; a third of it where it is to be ``quick``."""
    found = []
    for engine in engines:
        contact = CONTACT.get(engine, ()) if scene == "C" else ()
        found += [Entry(engine, options) for options in (*SETTINGS[engine][:: 3 if quick else 1], *contact)]
    return [e for e in found if e.options.get("solver") != "implicit" or find_spec("cholespy")]


def own_truths(setup: Setup, engines: Sequence[str]) -> list[tuple[Entry, Trace]]:
    """Runs of the engines' own models at a fine step, where they are worth their time."""
    found = []
    for engine in engines:
        for options, step in FINE.get(engine, ()):
            if options["method"] != "elastic" if setup.name == "C" else not options.get("passive"):
                fine = Entry(engine, {**options, "substeps": round(setup.scene.frame_dt / step)})
                found.append((Entry(engine, options), follow(setup, make(fine, setup))))
    return found


def timed(setup: Setup, chosen: Sequence[Entry], budget: float) -> list[tuple[int, Trace, np.ndarray]]:
    """Of each the substeps, its first run and the seconds of all frames ``(frames, 2)``; repeated runs take turns.

    Each runs once at least, five times at most, and as long as its runs took less than ``budget`` seconds together.
    """
    engines = [make(entry, setup) for entry in chosen]
    first = []
    for engine in tqdm(engines, desc=f"{setup.name}: engines", disable=None):
        follow(setup, engine, seconds=setup.scene.frame_dt)  # warms up
        first.append(follow(setup, engine, limit=LIMIT))
    seconds = [[trace.seconds] for trace in first]
    for _ in tqdm(range(4), desc=f"{setup.name}: again", disable=None):
        for engine, trace, times in zip(engines, first, seconds, strict=True):
            if not trace.failure and sum(t[:, 0].sum() for t in times) <= budget:
                times.append(follow(setup, engine).seconds)
    substeps = [int(np.max(getattr(engine, "substeps", 1))) for engine in engines]
    return [(n, trace, np.concatenate(times)) for n, trace, times in zip(substeps, first, seconds, strict=True)]


def measure_scene(
    setup: Setup, chosen: Sequence[Entry], own: Sequence[tuple[Entry, Trace]], budget: float
) -> list[PeerRow]:
    """All of ``chosen`` on one scene, against our truth and those of ``own`` that they are a coarser step of."""
    ours = Entry(OWN, TRUTH)
    true = follow(setup, make(ours, setup))
    near = replace(setup, start=nudge(setup.start, setup.scene, 0))
    floor = follow(near, make(ours, near))
    rows = []
    for entry, (substeps, trace, seconds) in zip(chosen, timed(setup, chosen, budget), strict=True):
        fine = next(
            (t for e, t in own if e.engine == entry.engine and e.options.items() <= entry.options.items()), None
        )
        late, early = (fine.late, fine.early) if fine else (None, None)
        wall, cpu = 1e3 * seconds.T
        q1, median, q3 = np.percentile(cpu, [25, 50, 75]).tolist()
        rows.append(
            PeerRow(
                setup.name,
                *setup.scene.grid.shape,
                entry.engine,
                json.dumps(dict(entry.options)),
                step_ms=1e3 * setup.scene.frame_dt / substeps,
                frames=len(cpu),
                ms_q1=q1,
                ms=median,
                ms_q3=q3,
                wall_ms=float(np.median(wall)),
                early_mm=error_mm(setup, trace.early, true.early),
                late_mm=error_mm(setup, trace.late, true.late),
                own_early_mm=error_mm(setup, trace.early, early),
                own_late_mm=error_mm(setup, trace.late, late),
                lag=lag(setup, trace.late, true.late),
                own_lag=lag(setup, trace.late, late),
                p99=p99(setup, trace.late),
                p99_truth=p99(setup, true.late),
                floor_early_mm=error_mm(setup, floor.early, true.early),
                floor_late_mm=error_mm(setup, floor.late, true.late),
                failure=trace.failure,
            )
        )
    return rows


def _version(engine: str) -> str:
    try:
        return version(engine.lower())
    except PackageNotFoundError:
        return "of unknown version"


def measure(session: Session) -> None:
    """Every scene of which something is missing, all of it in one run: its times are to be compared."""
    for reason in filter(None, map(missing, SETTINGS)):
        print(f"skipped: {reason}")
    engines = [engine for engine in SETTINGS if not missing(engine)]
    session.about |= {
        "threads": 1,
        "engines": ", ".join(f"{engine} {_version(engine)}" for engine in engines if engine != OWN),
        "budget_s": session.given.budget,
        "omp_num_threads": os.environ.get("OMP_NUM_THREADS", "unset"),
        "early_s": EARLY,
        "late_s": LATE,
    }
    store = session.store(STEM)
    others = [Entry(p.backend, p.options) for p in extra(session.given.backend)]
    for name in session.scenes:
        chosen = [*entries(name, engines, quick=session.quick), *others]
        if not all((name, e.engine, json.dumps(dict(e.options))) in store for e in chosen):
            setup = build(name, QUICK if session.quick else 1)
            own = [] if session.quick else own_truths(setup, engines)
            store.add(*measure_scene(setup, chosen, own, session.given.budget))


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--budget", type=float, default=8.0, help="seconds for the runs of one setting (default 8)")


BENCHMARK = Benchmark(
    name=STEM,
    about="MuJoCo, Taichi and our solvers on the same three scenes, in one run.",
    files={STEM: RowFile(PeerRow, PEER_KEY)},
    parts=[Part("Engines", (STEM,), table)],
    measure=measure,
    scenes=NAMES,
    known=NAMES,
    charts={STEM: "Error against milliseconds a frame, by engine, a panel a scene"},
    draw=draw,
    options=_options,
)
