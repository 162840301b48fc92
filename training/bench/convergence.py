"""``minicloth bench convergence``: how solvers approach one limit, and how far nudged truths part (chaos).

Windows of 5 frames are shorter than chaos; every solver is refined in every way that it has. Rows that are in --out
already are kept; --fresh measures again.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.physics.truth import TRUTHS
from cloth_envs.progress import progress
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.measure import built, run, vertex_error
from training.bench.participants import CONVERGENCE, FLOOR, Participant, extra, label, truth
from training.rollouts import NUDGE, nudge
from training.rows import read_names, read_rows
from training.truth import Case, Truth, load

DATA = Path(__file__).parents[2] / "docs" / "data" / "chaos_floor.csv"
LIMIT, CHAOS = "limit", "g1"  # truths: that all solvers approach, and that is nudged
FRAMES = 5  # of a window
START = 1.0  # s of the episode
COARSE = 2  # grids of half the resolution: the limit in the step does not ask for a fine one
SLOW = 1.0  # s of the processor for a frame; slower ones are left out and say so
AFTER = (1, 5, 10, 25, 50)  # frames at which the nudge is looked at
CHAOS_SEEDS = 5
CONVERGED, FLOORS = "convergence", "chaos_floor"
NUDGED = replace(truth(LIMIT), options=TRUTHS[LIMIT])


@dataclass(frozen=True)
class ConvergenceRow:
    """``error``: mean distance of the vertices from the limit after ``frames``, over the cloth's longer side."""

    scene: str
    rows: int
    cols: int
    solver: str
    options: str
    seed: int
    frames: int
    truth: str
    step_ms: float
    ms: float
    error: float
    failure: str


@dataclass(frozen=True)
class ChaosRow:
    """What became of a nudge after ``frames``, over the cloth's longer side: ``error`` is the mean distance of the
    vertices, ``height`` the difference of the mean height, without its sign.
    """

    scene: str
    rows: int
    cols: int
    seed: int
    frames: int
    seconds: float
    error: float
    error_m: float
    height: float


@dataclass(frozen=True)
class Ladder:
    """Errors along one option, the others fixed.

    ``order`` is the slope of the errors' logarithms over the last three rungs; NaN along iterations and tolerances,
    where what the step leaves is what remains.
    """

    scene: str
    solver: str
    option: str
    others: str
    values: Sequence[float]
    errors: Sequence[float]
    order: float


def ladders(points: Sequence[ConvergenceRow]) -> list[Ladder]:
    """All options that take three values or more while the others stay; errors are means over the seeds."""
    out = []
    for scene, solver in dict.fromkeys((p.scene, p.solver) for p in points if p.solver != FLOOR):
        mine = [p for p in points if (p.scene, p.solver) == (scene, solver)]
        errors = {o: float(np.mean([p.error for p in mine if p.options == o])) for o in {p.options for p in mine}}
        groups: dict[tuple[str, str], dict[float, float]] = {}
        for options, error in errors.items():
            parsed: dict[str, Any] = json.loads(options)
            for name, value in parsed.items():
                if not isinstance(value, str) and np.isfinite(error):
                    others = json.dumps({k: v for k, v in parsed.items() if k != name})
                    groups.setdefault((name, others), {})[float(value)] = error
        for (name, others), found in sorted(groups.items()):
            values = sorted(found, reverse=name == "tolerance")
            if len(values) >= 3:
                rung = [found[v] for v in values]
                fits = name in ("refine", "substeps") and np.isfinite(rung[-3:]).all()
                order = -float(np.polyfit(np.log(values[-3:]), np.log(rung[-3:]), 1)[0]) if fits else np.nan
                out.append(Ladder(scene, solver, name, others, values, rung, order))
    return out


def convergence_table(points: Sequence[ConvergenceRow]) -> str:
    """Ladders and, for each scene, how near every solver comes to the limit."""
    lines = []
    for scene in dict.fromkeys(p.scene for p in points):
        mine = [p for p in points if p.scene == scene]
        near = np.mean([p.error for p in mine if p.solver == FLOOR])
        shape = f"{mine[0].rows} x {mine[0].cols}"
        lines.append(f"\n{scene}, {shape}, error after {mine[0].frames} frames [%]; chaos floor {100 * near:.1g}")
        for ladder in ladders(mine):
            values = "  ".join(f"{v:g}: {100 * e:.2g}" for v, e in zip(ladder.values, ladder.errors, strict=True))
            order = f"   order {ladder.order:.2f}" if np.isfinite(ladder.order) else ""
            lines.append(f"  {label(ladder.solver, ladder.others):50s} {ladder.option:10s} {values}{order}")
        for solver in dict.fromkeys(p.solver for p in mine if p.solver != FLOOR):
            own = [p for p in mine if p.solver == solver]
            lines += [f"  {label(solver, p.options)}: {p.failure}" for p in own if p.failure]
            for best in sorted((p for p in own if np.isfinite(p.error)), key=lambda p: p.error)[:1]:
                step = f"(step {best.step_ms:.3g} ms)"
                lines.append(f"  nearest: {label(solver, best.options)}, {100 * best.error:.2g} % {step}")
    return "\n".join(lines)


def chaos_table(rows: Sequence[ChaosRow]) -> str:
    """Median and range over the seeds, in % of the cloth's length."""
    frames = sorted({row.frames for row in rows})
    lines = [f"{'scene':10s} {'seeds':>5s}" + "".join(f"{f'{f} fr.':>27s}" for f in frames)]
    for scene in dict.fromkeys(row.scene for row in rows):
        line = f"{scene:10s} {len({row.seed for row in rows if row.scene == scene}):5d}"
        for f in frames:
            found = [100 * row.error for row in rows if row.scene == scene and row.frames == f]
            line += f"{f'{np.median(found):.2g} ({min(found):.2g}-{max(found):.2g})':>27s}" if found else " " * 27
        lines.append(line)
    return "\n".join(lines)


def floor(scene: str, frames: float) -> float:
    """Error that the smallest of differences grows to after ``frames``, over the cloth's longer side.

    The median over the seeds, interpolated between the measured frames on logarithmic axes; at the scene's own
    resolution. An error claimed after ``frames`` frames means nothing below it.

    Raises:
        ValueError: not measured for this scene, or for so many frames.
        FileNotFoundError: no data; `minicloth bench convergence` makes them.
    """
    if not DATA.is_file():
        raise FileNotFoundError(f"no chaos floor in {DATA}: run `minicloth bench convergence --out FOLDER`")
    rows = [row for row in read_rows(DATA, ChaosRow) if row.scene == scene]
    known = sorted({row.frames for row in rows})
    if not known or not known[0] <= frames <= known[-1]:
        raise ValueError(f"the chaos floor of {scene!r} is known at frames {known}, not at {frames}")
    at = [np.median([row.error for row in rows if row.frames == f]) for f in known]
    return float(np.exp(np.interp(np.log(frames), np.log(known), np.log(at))))


def converged(participant: Participant, case: Case, limit: Truth, begin: int) -> ConvergenceRow:
    """How near ``participant`` comes to the ``limit`` from its frame ``begin``."""
    scene, start = limit.scene, limit.states[begin]
    if participant.family == FLOOR:
        start = nudge(start, scene, case.seed)
    backend, error = built(participant, scene, start), np.nan
    found = run(backend, scene, start, limit.controls[begin:], slow=SLOW)
    failure, done = (backend if isinstance(backend, str) else ""), len(found.seconds)
    if done == FRAMES:
        error = vertex_error(scene, found.states[-1], limit.states[begin + FRAMES])
        failure = "" if np.isfinite(error) else "non-finite"
    elif done:
        failure = f"left out: {found.seconds[-1].cpu:.1f} s a frame"
    own: Any = 1 if isinstance(backend, str) else getattr(backend, "substeps", participant.options.get("substeps", 1))
    return ConvergenceRow(
        case.scene, *scene.grid.shape, participant.family, participant.text, case.seed, FRAMES, limit.key,
        1e3 * scene.frame_dt / max(int(np.max(own)), 1), found.ms, error, failure,
    )  # fmt: skip


def chaos(case: Case, after: Sequence[int]) -> list[ChaosRow]:
    """One seed: the truth and its nudged copy under the truth's controls."""
    settle = round(START / case.world().scene.frame_dt)
    true = case.record(settle + max(after), [settle, *(settle + f for f in after)])
    scene, out = true.scene, []
    start, length = nudge(true.states[settle], scene, case.seed), scene.grid.length
    other = run(built(truth(case.truth), scene), scene, start, true.controls[settle:]).states
    for frame in after:
        pair = other[frame], true.states[settle + frame]
        error = vertex_error(scene, *pair)
        a, b = (np.average(s.positions[0, 2].astype(np.float64), weights=scene.grid.areas) for s in pair)
        seconds, height = frame * scene.frame_dt, float(abs(a - b)) / length
        out.append(ChaosRow(case.scene, *scene.grid.shape, case.seed, frame, seconds, error, error * length, height))
    return out


def measure(session: Session) -> None:
    """Both, scene by scene."""
    quick, given = session.quick, session.given
    coarse, after = (4, AFTER[:3]) if quick else (1, AFTER)
    families = list(dict.fromkeys(p.family for p in CONVERGENCE))
    chosen = families if given.families is None else read_names(given.families, families, "family")
    participants = [*(p for p in CONVERGENCE if p.family in chosen), *extra(given.backend)]
    session.about |= {"threads": 1, "limit": str(truth(LIMIT).fixed), "nudge": NUDGE, "nudged": str(truth(CHAOS).fixed)}
    store, floors = session.store(CONVERGED), session.store(FLOORS)
    for scene in session.scenes:
        for case in [Case(scene, seed, coarse, CHAOS) for seed in range(2 if quick else CHAOS_SEEDS)]:
            shape = case.world().scene.grid.shape
            if not all((scene, *shape, case.seed, frame) in floors for frame in after):
                floors.add(*chaos(case, after))
    for scene in session.scenes[: 2 if quick else None]:
        case = Case(scene, 0, COARSE * coarse, LIMIT, self_contact=False)  # which one of the solvers has
        begin = round(START / case.world().scene.frame_dt)
        limit = load(case, begin + FRAMES, [begin, begin + FRAMES], session.cache("truth"))
        todo = [NUDGED, *participants]
        for participant in progress(todo, f"{scene}, convergence", unit="run", name=lambda p: p.label):
            if (scene, participant.family, participant.text, case.seed, limit.key) not in store:
                store.add(converged(participant, case, limit, begin))


BENCHMARK = Benchmark(
    name="convergence",
    about="How solvers approach one limit as they are refined, and how far nudged truths part.",
    files={
        CONVERGED: RowFile(ConvergenceRow, ("scene", "solver", "options", "seed", "truth")),
        FLOORS: RowFile(ChaosRow, ("scene", "rows", "cols", "seed", "frames")),
    },
    parts=[
        Part("Convergence", (CONVERGED,), convergence_table),
        Part(f"Chaos floor: truth against itself nudged by {NUDGE:g} of the length [%]", (FLOORS,), chaos_table),
    ],
    measure=measure,
    options=lambda parser: parser.add_argument("--families", help="some of the solvers; default: all"),
)
