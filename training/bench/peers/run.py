"""``minicloth bench peers``: MuJoCo, Taichi and our solvers on the same three scenes, in one run.

Errors are taken against two runs: our truth, and the engine's own model at a much finer step, so that no engine is
blamed for modelling another cloth; comparisons use the smaller. Times are processor times of one thread, since on a
busy machine the wall clock (also stored) punishes those whose frames are long; engines take turns. Ours run with AVX2
and AVX-512, where the processor has them, each in a process of its own.
"""

import argparse
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import replace
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np

from cloth_envs.backend import Backend
from cloth_envs.extras import install
from cloth_envs.naming import resolve
from cloth_envs.physics.truth import TRUTHS
from cloth_envs.progress import progress
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.levels import levels, process
from training.bench.participants import Participant, extra
from training.bench.peers.batch import BATCH_KEY, BATCH_STEM, BatchRow, batch_table, measure_batch
from training.bench.peers.results import OWN, PEER_KEY, STEM, PeerRow, draw, table
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
CONTACT = [{"method": "membrane", "substeps": n, "passive": True} for n in (1, 2)]
# MuJoCo's own models at a fine step [s]. Taichi's kernels compute our forces: our truth is theirs (XPBD in single
# precision gets worse again below a step of a quarter of a millisecond). With friction a step of MuJoCo's shell with
# bending takes a second on C, its fine run minutes: left out there.
FINE: list[Options] = [{"method": "membrane", "passive": True}, {"method": "membrane"}, {"method": "elastic"}]
FINE_STEP = 2.5e-3


def setting(engine: str, options: Options) -> Participant:
    """An engine with one setting."""
    return Participant(engine, CLASSES.get(engine, "reference"), options)


def make(chosen: Participant, setup: Setup) -> Backend:
    """The engine for one cloth: ours, a peer, or a backend that ``--backend`` named."""
    if chosen.family not in CLASSES:
        return chosen.build(setup.scene)
    peer: Backend = resolve(chosen.backend)(setup, **chosen.options)
    return peer


def missing(engine: str) -> str:
    """Why ``engine`` can't take part, or nothing."""
    if engine in CLASSES and find_spec(engine.lower()) is None:
        return f"{engine} is not installed: {install('peers')}"
    return ""


def entries(scene: str, engines: Sequence[str], *, quick: bool) -> list[Participant]:
    """All that is run on ``scene``; a third of it where it is to be ``quick``."""
    found = []
    for engine in engines:
        contact = CONTACT if scene == "C" and engine == "MuJoCo" else ()
        found += [setting(engine, options) for options in (*SETTINGS[engine][:: 3 if quick else 1], *contact)]
    return [p for p in found if p.options.get("solver") != "implicit" or find_spec("cholespy")]


def own_truths(setup: Setup) -> list[tuple[Options, Trace]]:
    """Runs of MuJoCo's own models at a fine step, where they are worth their time."""
    found, substeps = [], round(setup.scene.frame_dt / FINE_STEP)
    for options in FINE:
        if options["method"] != "elastic" if setup.scene.name == "C" else not options.get("passive"):
            fine = setting("MuJoCo", {**options, "substeps": substeps})
            found.append((options, follow(setup, make(fine, setup))))
    return found


class Entrant(NamedTuple):
    """A setting of an engine, and the process that it runs in; peers run in this one."""

    chosen: Participant
    level: str = ""
    pool: Executor | None = None


def run(setup: Setup, chosen: Participant, limit: float = np.inf) -> tuple[int, Trace]:
    """The substeps of a frame, and one run of an engine that was warmed up before."""
    return turn(setup, make(chosen, setup), limit)


def turn(setup: Setup, engine: Backend, limit: float = np.inf) -> tuple[int, Trace]:
    """The same of an engine that is there."""
    follow(setup, engine, seconds=setup.scene.frame_dt)
    trace = follow(setup, engine, limit=limit)
    return int(np.max(getattr(engine, "substeps", 1))), trace


def runner(setup: Setup, entrant: Entrant) -> Callable[[float], tuple[int, Trace]]:
    """What runs it once, until it has taken a limit [s]. A peer is built once: Taichi compiles for seconds."""
    chosen, _, pool = entrant
    if pool:
        return lambda limit: pool.submit(run, setup, chosen, limit).result()
    engine = make(chosen, setup)
    return lambda limit: turn(setup, engine, limit)


def timed(setup: Setup, entrants: Sequence[Entrant], budget: float) -> list[tuple[int, Trace, np.ndarray]]:
    """Of each the substeps, its first run and the seconds of all frames ``(frames, 2)``; repeated runs take turns.

    Each runs once at least, five times at most, and as long as its runs took less than ``budget`` seconds together.
    """
    runners = [runner(setup, one) for one in entrants]
    first = [go(LIMIT) for go in progress(runners, f"{setup.scene.name}: first runs", unit="engine")]
    seconds = [[trace.seconds] for _, trace in first]
    for _ in progress(range(4), f"{setup.scene.name}: again", unit="round"):
        for go, (_, trace), times in zip(runners, first, seconds, strict=True):
            if not trace.failure and sum(t[:, 0].sum() for t in times) <= budget:
                times.append(go(np.inf)[1].seconds)
    return [(n, trace, np.concatenate(times)) for (n, trace), times in zip(first, seconds, strict=True)]


def measure_scene(
    setup: Setup, entrants: Sequence[Entrant], own: Sequence[tuple[Options, Trace]], budget: float
) -> list[PeerRow]:
    """All ``entrants`` on one scene, against our truth and those of ``own`` that they are a coarser step of."""
    ours = setting(OWN, TRUTH)
    true = follow(setup, make(ours, setup))
    near = replace(setup, start=nudge(setup.start, setup.scene, 0))
    floor = follow(near, make(ours, near))
    rows = []
    for (one, level, _), (substeps, trace, seconds) in zip(entrants, timed(setup, entrants, budget), strict=True):
        mine = (t for options, t in own if one.family == "MuJoCo" and options.items() <= one.options.items())
        truths = true, next(mine, Trace())
        wall, cpu = 1e3 * seconds.T
        compared = [(trace, truth) for truth in truths] + [(floor, true)]
        errors = [error_mm(*pair) for a, b in compared for pair in ((a.early, b.early), (a.late, b.late))]
        step, quartiles = 1e3 * setup.scene.frame_dt / substeps, np.percentile(cpu, [25, 50, 75]).tolist()
        lags = [lag(setup, trace.late, truth.late) for truth in truths]
        strains = [p99(setup, x.late) for x in (trace, true)]
        values = [*quartiles, float(np.median(wall)), *errors[:4], *lags, *strains, *errors[4:]]
        about: list[Any] = [setup.scene.name, *setup.scene.grid.shape, one.family, one.text, level, step, len(cpu)]
        rows.append(PeerRow(*[*about, *values, trace.failure]))
    return rows


def measure(session: Session) -> None:
    """Every scene of which something is missing, all of it in one run: its times are to be compared."""
    for reason in filter(None, map(missing, SETTINGS)):
        print(f"skipped: {reason}")
    engines = [engine for engine in SETTINGS if not missing(engine)]
    session.about |= {
        "threads": 1,
        "engines": ", ".join(f"{engine} {version(engine.lower())}" for engine in engines if engine != OWN),
        "budget_s": session.given.budget,
        "omp_num_threads": os.environ.get("OMP_NUM_THREADS", "unset"),
        "early_s": EARLY,
        "late_s": LATE,
    }
    store, batches = session.store(STEM), session.store(BATCH_STEM)
    with ExitStack() as stack:
        pools = {level: stack.enter_context(process(level)) for level in wide()}
        for name in session.scenes:
            chosen = [*entries(name, engines, quick=session.quick), *extra(session.given.backend)]
            entrants = list(placed(chosen, pools))
            if not all((name, e.chosen.family, e.chosen.text, e.level) in store for e in entrants):
                setup = build(name, QUICK if session.quick else 1)
                own = own_truths(setup) if "MuJoCo" in engines and not session.quick else []
                store.add(*measure_scene(setup, entrants, own, session.given.budget))
                batches.add(*measure_batch(setup, store.rows, pools))


def wide() -> list[str]:
    """The instruction sets that are compared: AVX2 and AVX-512, or the only one that there is."""
    return levels()[1:] or levels()


def placed(chosen: Sequence[Participant], pools: Mapping[str, Executor]) -> Iterator[Entrant]:
    """Ours in every one of ``pools``, peers here."""
    for one in chosen:
        if one.family in CLASSES:
            yield Entrant(one)
        else:
            yield from (Entrant(one, level, pool) for level, pool in pools.items())


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--budget", type=float, default=8.0, help="seconds for the runs of one setting (default 8)")


BENCHMARK = Benchmark(
    name=STEM,
    about="MuJoCo, Taichi and our solvers on the same three scenes, in one run.",
    files={STEM: RowFile(PeerRow, PEER_KEY), BATCH_STEM: RowFile(BatchRow, BATCH_KEY)},
    parts=[
        Part("Engines", (STEM,), table),
        Part("Batches: processor time (wall clock) for a frame of one cloth", (BATCH_STEM,), batch_table),
    ],
    measure=measure,
    scenes=NAMES,
    known=NAMES,
    charts={STEM: "Error against milliseconds a frame, by engine, a panel a scene"},
    draw=draw,
    options=_options,
)
