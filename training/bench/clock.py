"""Time of the engine's participants: wall clock per simulated frame, end to end, on a machine that others share."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, islice, repeat

import numpy as np

from cloth_envs.backend import Backend
from cloth_envs.state import Controls, State
from training.bench.measure import Windows, built
from training.bench.participants import Participant
from training.rollouts import replay
from training.rows import rounded

RUNS, SLOW_RUNS = 30, 5  # timed, after one that warms up; of a participant that is SLOW
RUN_MS, LEAST, MOST = 15.0, 3, 400  # ms that a run is to last; frames in it at least and at most
SLOW, TOO_SLOW = 50.0, 1000.0  # ms a frame
BUSY = 0.95  # of a frame's wall clock that one thread computes; below, others had the processor


@dataclass(frozen=True)
class CostRow:
    """Wall clock of a simulated frame of one cloth [ms]: median and quartiles over ``runs``, which take turns at the
    windows, the best, and the medians of the coarse step and of the upscaling to positions and velocities.

    One thread computes. Frames in which another program had the processor are left out. Of ``disturbed`` runs, which
    had no others, the thread's own time counts: what the clock of an idle machine would show.
    """

    scene: str
    rows: int
    cols: int
    family: str
    options: str
    runs: int
    disturbed: int
    ms_q1: float
    ms_median: float
    ms_q3: float
    ms_best: float
    step_ms: float
    upscale_ms: float
    failure: str


def timed(backend: Backend, start: State, controls: Sequence[Controls], count: int) -> tuple[np.ndarray, bool]:
    """Median seconds of a frame, of its step and of its upscaling; and whether others disturbed every frame.

    Of ``count`` frames, from the start again where ``controls`` end.
    """
    frames = chain.from_iterable(replay(backend, *given) for given in repeat((start, controls)))
    wall, step, _, thread = np.array([seconds for _, seconds in islice(frames, count)]).T
    times, share = np.stack([wall, step, wall - step], 1), thread / wall
    good = share >= BUSY
    if good.any():
        return np.median(times[good], 0), False
    return np.median(times * share[:, None], 0), True


def costs(
    participants: Sequence[Participant], windows: Windows, *, runs: int = RUNS, run_ms: float = RUN_MS
) -> list[CostRow]:
    """Time ``participants`` in turn, so that a busy moment of the machine hits all alike; the too slow for a frame.

    Runs take turns at the windows too, all starts of a seed first: crumpled cloth takes longer.
    """
    scene, order = windows.scene, np.argsort(windows.seeds, kind="stable")
    backends = [built(participant, scene, windows.truth[0].select([0])) for participant in participants]
    times: list[list[np.ndarray]] = [[] for _ in participants]
    disturbed, count = [0] * len(participants), [0] * len(participants)
    for run in range(runs + 1):  # the first warms up
        start, controls = windows.one(order[(run - 1) % len(order)])
        for i, backend in enumerate(backends):
            ms = times[i][0][0] if times[i] else 0.0
            if isinstance(backend, str) or ms > TOO_SLOW or (ms > SLOW and run > SLOW_RUNS):
                continue
            taken, bad = timed(backend, start, controls, count[i] or 1)
            if run or taken[0] * 1e3 > TOO_SLOW:
                times[i].append(taken * 1e3)
                disturbed[i] += bad
            if not run:
                count[i] = int(np.clip(run_ms / (taken[0] * 1e3), LEAST, MOST))
    out = []
    for i, (participant, backend) in enumerate(zip(participants, backends, strict=True)):
        table = np.array(times[i]) if times[i] else np.full((1, 3), np.nan)
        q1, median, q3 = np.percentile(table[:, 0], [25, 50, 75])
        step, upscale = np.median(table[:, 1:], 0)
        row = CostRow(
            scene.name, *scene.grid.shape, participant.family, participant.text, len(times[i]),
            disturbed[i], float(q1), float(median), float(q3), float(table[:, 0].min()), float(step), float(upscale),
            failure=backend if isinstance(backend, str) else "",
        )  # fmt: skip
        out.append(rounded(row))
    return out
