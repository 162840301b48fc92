"""The engine of all benchmarks: runs a participant from stretches of truth and tells errors, failures and time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from cloth_envs.backend import Backend
from cloth_envs.failure import Failures
from cloth_envs.registry import load_task
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from training import metrics
from training.bench.participants import FLOOR, NO_PHYSICS, Participant
from training.cache import digest
from training.metrics.contact import crossing_triangles
from training.metrics.errors import displacement_span, distances
from training.rollouts import Seconds, nudge, replay, stack_controls, stack_states
from training.rows import rounded
from training.truth import Case, load

HORIZONS = (1, 5, 10, 25)  # frames


@dataclass(frozen=True, eq=False)
class Windows:
    """B stretches of truth, the first window of every seed first. ``truth[t]`` is the batch after t frames."""

    scene: Scene
    seeds: tuple[int, ...]
    starts: tuple[int, ...]
    controls: list[Controls]
    truth: list[State]
    key: str

    @cached_property
    def span(self) -> np.ndarray:
        """Range of the truth's displacements from its mean, ``(3,)`` [m], for PSNR."""
        everything = np.concatenate([s.positions for s in self.truth])
        return displacement_span(everything, everything.mean(0))

    @cached_property
    def crossings(self) -> np.ndarray:
        """Pairs of crossing triangles at the end of every stretch, ``(B,)``."""
        return crossing_triangles(self.scene.grid, self.truth[-1].positions)

    def one(self, index: int) -> tuple[State, list[Controls]]:
        """Start and controls of one of the batch."""
        return self.truth[0].select([index]), [controls.select([index]) for controls in self.controls]

    def first(self, count: int) -> "Windows":
        """The first ``count`` of the batch."""
        if count >= len(self.seeds):
            return self
        controls = [controls.select(slice(count)) for controls in self.controls]
        truth = [state.select(slice(count)) for state in self.truth]
        return replace(self, seeds=self.seeds[:count], starts=self.starts[:count], controls=controls, truth=truth)


def gather(cases: Sequence[Case], starts: Sequence[int], frames: int, keep: Sequence[int], cache: Path) -> Windows:
    """Windows of ``frames`` frames from every start of every case, whose truths keep frames ``keep`` in ``cache``."""
    truths = [load(case, max(keep), keep, cache) for case in cases]
    members = [(truth, start) for start in starts for truth in truths]
    return Windows(
        truths[0].scene,
        tuple(case.seed for case in cases) * len(starts),
        tuple(start for _, start in members),
        [stack_controls([truth.controls[start + i] for truth, start in members]) for i in range(frames)],
        [stack_states([truth.states[start + i] for truth, start in members]) for i in range(frames + 1)],
        digest(*(truth.key for truth in truths)),
    )


@dataclass(frozen=True, eq=False)
class Run:
    """States after every frame, the start first; of each cloth ``"<reason> at frame <n>"``, why the participant was
    refused, or ``""``; and the time of every frame.
    """

    states: list[State]
    failures: list[str]
    seconds: list[Seconds]

    @property
    def ms(self) -> float:
        """Median of the processor's time for a frame [ms], NaN of none."""
        return 1e3 * float(np.median([s.cpu for s in self.seconds])) if self.seconds else float("nan")


def built(
    participant: Participant, scene: Scene, start: State | None = None, threads: int = 1, truth: Sequence[State] = ()
) -> Backend | str:
    """Its backend for the cloths of ``start`` (default: one), or the words with which it refused scene or start."""
    try:
        backend = participant.build(scene, start.batch if start else 1, threads, truth=truth)
        if start:
            backend.reset(start)
    except (ValueError, ImportError) as error:
        return f"refused: {error}"
    return backend


def run(
    backend: Backend | str,
    scene: Scene,
    start: State,
    controls: Sequence[Controls],
    *,
    physics: bool = True,
    stop: bool = False,
    slow: float = np.inf,
) -> Run:
    """Step ``backend`` from ``start``.

    Args:
        backend: or why there is none; then the run has its start only.
        physics: without, an edge too long or a jump of energy is no failure.
        stop: at the first failure, whose state is the last.
        slow: [s] of the processor; after a frame that took longer the run ends.
    """
    if isinstance(backend, str):
        return Run([start], [backend] * start.batch, [])
    found = Run([start], [""] * start.batch, [])
    failures = Failures(scene, load_task(scene.name).max_strain)
    for frame, (state, seconds) in enumerate(replay(backend, start, controls), 1):
        reasons = failures.check(found.states[-1], state)
        found.states.append(state.copy())
        found.seconds.append(seconds)
        for i, reason in reasons.items():
            if not found.failures[i] and (physics or reason == "non-finite"):
                found.failures[i] = f"{reason} at frame {frame}"
        if seconds.cpu > slow or (stop and any(found.failures)):
            break
    return found


def follow(participant: Participant, windows: Windows, threads: int = 1) -> Run:
    """The run of ``participant`` over ``windows``; for the chaos floor the truth from a nudged start."""
    scene, start = windows.scene, windows.truth[0]
    if participant.family == FLOOR:
        start = nudge(start, scene, 0)
    backend = built(participant, scene, start, threads, windows.truth)
    return run(backend, scene, start, windows.controls, physics=participant.family not in NO_PHYSICS)


def failed_by(reason: str, frame: int) -> bool:
    """Whether a run that ended for ``reason`` had done so by ``frame``."""
    return bool(reason) and (" at frame " not in reason or int(reason.rsplit(" ", 1)[1]) <= frame)


def vertex_error(scene: Scene, state: State, truth: State) -> float:
    """Mean distance of the first cloth's vertices from those of the truth over the cloth's longer side."""
    return float(distances(state.positions[0], truth.positions[0]).mean() / scene.grid.length)


@dataclass(frozen=True)
class ErrorRow:
    """Metrics of ``training.metrics`` after ``frames``: means over the ``windows`` of one seed that did not fail.

    Errors are in % of the cloth's length; ``crossings``, pairs of triangles, are counted after the last frame.
    """

    scene: str
    rows: int
    cols: int
    family: str
    options: str
    seed: int
    frames: int
    truth: str
    windows: int
    error_mean: float
    error_p95: float
    error_max: float
    relative_l2: float
    psnr: float
    vmse: float
    max_dx: float
    normal_deg: float
    curvature: float
    bending_ratio: float
    detail_ratio: float
    depth_mean: float
    depth_max: float
    inside: float
    flicker: float
    tunnelled: float
    crossings: float
    crossings_truth: float
    failure: str


ERROR_KEY = ("scene", "rows", "cols", "family", "options", "seed", "frames", "truth")
MEASURED = [name for name, kind in get_type_hints(ErrorRow).items() if kind is float]


def errors(
    participant: Participant, windows: Windows, threads: int = 1, horizons: Sequence[int] = HORIZONS
) -> list[ErrorRow]:
    """Run the windows and compare them with the truth; one row for each seed and horizon."""
    scene, found, out = windows.scene, follow(participant, windows, threads), []
    for frames in horizons:
        values = _compared(found, windows, frames)
        for seed in dict.fromkeys(windows.seeds):
            mine = [i for i, s in enumerate(windows.seeds) if s == seed]
            bad = [found.failures[i] for i in mine if failed_by(found.failures[i], frames)]
            means: dict[str, Any] = {name: mean(value[mine]) for name, value in values.items()}
            row = ErrorRow(
                scene.name, *scene.grid.shape, participant.family, participant.text, seed, frames, windows.key,
                len(mine), **means, failure=f"{len(bad)} of {len(mine)}: {bad[0]}" if bad else "",
            )  # fmt: skip
            out.append(rounded(row))
    return out


def mean(values: Any) -> float:
    """Of those that are known."""
    known = np.asarray(values)[~np.isnan(values)]
    return float(known.mean()) if len(known) else float("nan")


def _compared(found: Run, windows: Windows, frames: int) -> dict[str, Any]:
    """``MEASURED`` of every window ``(B,)`` after ``frames``, NaN of those that failed."""
    values = {name: np.full(len(found.failures), np.nan) for name in MEASURED}
    good = np.flatnonzero([not failed_by(reason, frames) for reason in found.failures])
    if frames >= len(found.states) or not len(good):
        return values
    scene = windows.scene
    states, true = ([s.select(good) for s in part[: frames + 1]] for part in (found.states, windows.truth))
    told = metrics.at_frame(scene, states[-1], true[-1], span=windows.span)
    if frames >= 2:
        told |= metrics.over_frames(scene, states, true)
    for name, value in told.items():
        values[name][good] = value
    if frames == len(windows.controls):
        values["crossings"][good] = crossing_triangles(scene.grid, states[-1].positions)
        values["crossings_truth"][good] = windows.crossings[good]
    return values
