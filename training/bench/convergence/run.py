"""``minicloth bench convergence``: how solvers approach one limit, and how far nudged truths part (chaos).

Windows of 5 frames are shorter than chaos; every solver is refined in every way that it has. Rows that are in --out
already are kept; --fresh measures again.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from cloth_envs.physics.truth import TRUTHS
from cloth_envs.state import State
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.convergence.rows import (
    CHAOS_KEY,
    CONVERGENCE_KEY,
    ChaosRow,
    ConvergenceRow,
    chaos_table,
    convergence_table,
)
from training.bench.measure import built, run, vertex_error
from training.bench.participants import CONVERGENCE, FLOOR, Participant, extra, truth
from training.rollouts import NUDGE, nudge
from training.rows import Store, read_names
from training.truth import Case, Truth, load

LIMIT, CHAOS = "limit", "g1"  # truths: that all solvers approach, and that is nudged
FRAMES = 5  # of a window
START = 1.0  # s of the episode
COARSE = 2  # grids of half the resolution: the limit in the step does not ask for a fine one
SLOW = 1.0  # s of the processor for a frame; slower ones are left out and say so
AFTER = (1, 5, 10, 25, 50)  # frames at which the nudge is looked at
SEEDS, CHAOS_SEEDS = 1, 5
CONVERGED, FLOORS = "convergence", "chaos_floor"
NUDGED = replace(truth(LIMIT), options=TRUTHS[LIMIT])


def converge(
    store: Store[ConvergenceRow], cases: Sequence[Case], participants: Sequence[Participant], cache: Path
) -> None:
    """Measure what ``store`` lacks, and the chaos floor of the same windows."""
    for case in cases:
        begin = round(START / case.world().scene.frame_dt)
        limit = load(case, begin + FRAMES, [begin, begin + FRAMES], cache)
        bar = tqdm([NUDGED, *participants], desc=f"{case.scene}, convergence", disable=None)
        for participant in bar:
            bar.set_postfix_str(participant.label)
            if (case.scene, participant.family, participant.text, case.seed, limit.key) not in store:
                store.add(_converged(participant, case, limit, begin))


def _converged(participant: Participant, case: Case, limit: Truth, begin: int) -> ConvergenceRow:
    scene, start = limit.scene, limit.states[begin]
    if participant.family == FLOOR:
        start = nudge(start, scene, case.seed)
    backend, error = built(participant, scene), np.nan
    found = run(backend, scene, start, limit.controls[begin:], slow=SLOW)
    failure, done = (backend if isinstance(backend, str) else ""), len(found.seconds)
    if done == FRAMES:
        error = vertex_error(scene, found.states[-1], limit.states[begin + FRAMES])
        failure = "" if np.isfinite(error) else "non-finite"
    elif done:
        failure = f"left out: {found.seconds[-1].cpu:.1f} s a frame"
    return ConvergenceRow(
        case.scene, *scene.grid.shape, participant.family, participant.text, case.seed, FRAMES, limit.key,
        1e3 * scene.frame_dt / max(_substeps(participant, backend), 1), found.ms, error, failure,
    )  # fmt: skip


def _substeps(participant: Participant, backend: Any) -> int:
    """Per frame; 0 of a solver that refused."""
    if isinstance(backend, str):
        return 0
    own: Any = getattr(backend, "substeps", participant.options.get("substeps", 1))
    return int(np.max(own))


def chaos(case: Case, after: Sequence[int] = AFTER) -> list[ChaosRow]:
    """One seed: the truth and its nudged copy under the truth's controls."""
    settle = round(START / case.world().scene.frame_dt)
    true = case.record(settle + max(after), [settle, *(settle + f for f in after)])
    scene, states, out = true.scene, true.states, []
    start = nudge(states[settle], scene, case.seed)
    other = run(built(truth(case.truth), scene), scene, start, true.controls[settle:]).states
    for frame in after:
        now = states[settle + frame]
        error = vertex_error(scene, other[frame], now)
        height = abs(_height(other[frame], scene.grid.areas) - _height(now, scene.grid.areas)) / scene.grid.length
        seconds, metres = frame * scene.frame_dt, error * scene.grid.length
        out.append(ChaosRow(case.scene, *scene.grid.shape, case.seed, frame, seconds, error, metres, height))
    return out


def _height(state: State, areas: np.ndarray) -> float:
    """Of the first cloth's centre of mass [m]."""
    return float(np.average(state.positions[0, 2].astype(np.float64), weights=areas))


def measure(session: Session) -> None:
    """Both, scene by scene."""
    quick, given = session.quick, session.given
    coarse, after = (4, AFTER[:3]) if quick else (1, AFTER)
    families = list(dict.fromkeys(p.family for p in CONVERGENCE))
    chosen = families if given.families is None else read_names(given.families, families, "family")
    participants = [*(p for p in CONVERGENCE if p.family in chosen), *extra(given.backend)]
    session.about |= {"threads": 1, "limit": str(truth(LIMIT).fixed), "nudge": NUDGE, "nudged": str(truth(CHAOS).fixed)}
    floors = session.store(FLOORS)
    for scene in session.scenes:
        for case in [Case(scene, seed, coarse, CHAOS) for seed in range(2 if quick else CHAOS_SEEDS)]:
            shape = case.world().scene.grid.shape
            if not all((scene, *shape, case.seed, frame) in floors for frame in after):
                floors.add(*chaos(case, after))
    cases = [Case(scene, seed, COARSE * coarse, LIMIT) for scene in session.scenes for seed in range(SEEDS)]
    converge(session.store(CONVERGED), cases[:2] if quick else cases, participants, session.cache("truth"))


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--families", help="some of the solvers; default: all")


BENCHMARK = Benchmark(
    name="convergence",
    about="How solvers approach one limit as they are refined, and how far nudged truths part.",
    files={CONVERGED: RowFile(ConvergenceRow, CONVERGENCE_KEY), FLOORS: RowFile(ChaosRow, CHAOS_KEY)},
    parts=[
        Part("Convergence", (CONVERGED,), convergence_table),
        Part(f"Chaos floor: truth against itself nudged by {NUDGE:g} of the length [%]", (FLOORS,), chaos_table),
    ],
    measure=measure,
    options=_options,
)
