"""Runs of the stability benchmark: states until the first failure, and why they failed next to the truth's."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from cloth_envs.backend import Backend
from cloth_envs.physics.laws.budget import budget, slow_motion
from cloth_envs.physics.laws.diagnostics import linear_momentum, penetration, strains
from cloth_envs.scene import Scene
from cloth_envs.state import State
from training.bench import measure
from training.bench.participants import truth
from training.bench.stability.rows import REASONS, Score
from training.bench.stability.worlds import Stage
from training.metrics.contact import crossing_triangles, tunnelled
from training.rollouts import nudge, stack_states

TRUTH = truth("half")
GATE = 0.5  # s; the mean height is compared until then, later it is chaos too
BUDGETED = 10  # frames: of a run's first ones the energy budget is made
BURST = 100.0  # strain of an edge: not a number yet, but no cloth either
HEIGHT = 0.05  # of the way that the mean height goes in 0.5 s
EARLY, ASTRAY = 0.2, 0.05  # s, of the length: mean distance of the vertices from the truth's
GAINED = 0.25  # of m g H: energy from nowhere, beyond what the truth's budget leaves over
STRAINED, LIVELY = 2.0, 2.0  # times the truth's strain and kinetic energy
SPARE = 1.0  # J/kg of kinetic energy, beyond a multiple of the truth's
DRIFT = 0.01  # of the sum of m |v| at the start: momentum from nowhere


@dataclass(frozen=True, eq=False)
class Run:
    """States of every frame, the start first, until the first failure."""

    scene: Scene
    states: list[State]
    failure: str = ""
    ms: float = float("nan")

    @property
    def rolled(self) -> State:
        """All frames as one batch."""
        return stack_states(self.states)

    @cached_property
    def strains(self) -> np.ndarray:
        """99th percentiles of strain and of its size at every frame, ``(2, T)``."""
        found = strains(self.scene.grid, self.rolled.positions)
        return np.stack([np.percentile(values, 99, axis=1) for values in (found, abs(found))])

    @cached_property
    def kinetic(self) -> np.ndarray:
        """Kinetic energy at every frame [J/kg]."""
        square = (self.rolled.velocities.astype(np.float64) ** 2).sum(1)
        return (square * self.scene.grid.areas).sum((1, 2)) / self.scene.grid.areas.sum() / 2

    @cached_property
    def drift(self) -> np.ndarray:
        """Energy from nowhere up to every frame over m g H, of the first frames; NaN where it is not defined."""
        scene, count = self.scene, min(BUDGETED, len(self.states) - 1)
        if scene.colliders or scene.windy or not scene.gravity or not count:
            return np.full(1, np.nan)
        rest = budget(scene, [stack_states(self.states[:count]), stack_states(self.states[1 : count + 1])]).rest
        scale = scene.mass.sum() * scene.gravity * scene.grid.height
        return np.concatenate([[0.0], np.cumsum(rest)]) / scale

    @cached_property
    def momentum(self) -> np.ndarray:
        """Its change up to every frame over the sum of m |v| at the start, where no force acts from outside."""
        scene = self.scene
        if scene.gravity or scene.handles:
            return np.full(len(self.states), np.nan)
        p = linear_momentum(scene, self.rolled)
        scale = (scene.mass * np.linalg.norm(self.states[0].velocities[0].astype(np.float64), axis=0)).sum()
        return np.linalg.norm(p - p[0], axis=1) / scale

    @cached_property
    def heights(self) -> np.ndarray:
        areas = self.scene.grid.areas
        return (self.rolled.positions[:, 2].astype(np.float64) * areas).sum((1, 2)) / areas.sum()

    @cached_property
    def crossings(self) -> np.ndarray:
        """Pairs of the cloth's own triangles that cross at every frame."""
        return crossing_triangles(self.scene.grid, self.rolled.positions)

    @cached_property
    def passed(self) -> np.ndarray:
        """How many vertices and triangles bodies have gone through up to every frame."""
        found = np.zeros(len(self.states), np.int64)
        if self.scene.colliders and len(self.states) > 1:
            found[1:] = tunnelled(self.scene, [stack_states(self.states[:-1]), stack_states(self.states[1:])])
            found[1:] += [pierced(self.scene, *pair) for pair in pairwise(self.states)]
        return np.cumsum(found)


def pierced(scene: Scene, before: State, after: State) -> int:
    """Triangles that the middle of a ball or capsule's end went through between two states of one cloth.

    All move in straight lines; the time of a crossing is taken from the signed volumes at both ends. A ball thinner
    than a cell touches no vertex and is found here only.
    """
    count, triangles = 0, scene.grid.triangles
    x0, x1 = (s.positions[0].astype(np.float64).reshape(3, -1).T for s in (before, after))
    for number, body in enumerate(scene.colliders):
        if body.kind == "plane":
            continue
        for end in range(1 if body.kind == "sphere" else 2):
            near = [x - s.colliders[0, number, end] for x, s in ((x0, before), (x1, after))]
            (a, b, c), later = (x[triangles].transpose(1, 0, 2) for x in near)
            s0, s1 = ((a * np.cross(b, c)).sum(-1) for a, b, c in ((a, b, c), later))
            crossing = np.flatnonzero(s0 * s1 < 0)
            t = (s0[crossing] / (s0[crossing] - s1[crossing]))[:, None]
            a, b, c = ((1 - t) * x[crossing] + t * y[crossing] for x, y in zip((a, b, c), later, strict=True))
            parts = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])
            count += int(((parts * parts.sum(0)).sum(-1) > 0).all(0).sum())
    return count


def run(backend: Backend | str, stage: Stage) -> Run:
    """Step ``stage`` until the first failure; one that was refused has its start only."""
    scene, found = stage.scene, measure.run(backend, stage.scene, stage.start, stage.controls, stop=True)
    (reason,), states = found.failures, found.states
    if not reason or isinstance(backend, str):
        return Run(scene, states, reason, found.ms)
    kind, burst = reason.split(" at ")[0], strains(scene.grid, states[-1].positions).max() > BURST
    return Run(scene, states[:-1], "blow-up" if burst or kind == "non-finite" else kind, found.ms)


def truths(stage: Stage, seed: int) -> tuple[Run, Run]:
    """The truth of a world, explicit at half the stable step, and that of its start nudged by a millionth (0.5 s)."""
    push, early = nudge(stage.start, stage.scene, seed), frames_in(GATE, stage.scene)
    near = Stage(stage.scene, push, stage.controls[:early])
    return run(measure.built(TRUTH, stage.scene), stage), run(measure.built(TRUTH, stage.scene), near)


def frames_in(seconds: float, scene: Scene) -> int:
    """How many frames that is, one at least."""
    return max(1, round(seconds / scene.frame_dt))


def gate(found: Run, true: Run, frames: int) -> tuple[float, float, np.ndarray]:
    """Largest difference of the mean heights within 0.5 s over the truth's way, that difference [m], and by frame."""
    count = min(frames_in(GATE, true.scene), frames, len(found.states) - 1, len(true.states) - 1) + 1
    if count < 2:
        return float("nan"), float("nan"), np.zeros(0)
    worst = slow_motion(true.scene, found.states[:count], true.states[:count])
    fraction, difference = float(worst.fraction[0]), float(worst.difference[0])
    gaps = abs(found.heights[:count] - true.heights[:count])
    return fraction, difference, gaps * (fraction / max(abs(difference), 1e-300))


def score(found: Run, true: Run, near: Run, frames: int) -> Score:
    """The first ``frames`` of ``found`` against the truth and the nudged truth."""
    scene, dt, end = found.scene, found.scene.frame_dt, frames + 1
    common = min(end, len(found.states), len(true.states))
    (stretch, p99), (stretch_true, p99_true) = (r.strains[:, :end] for r in (found, true))
    drift, drift_true = found.drift[:end], true.drift[:end]
    kinetic, kinetic_true = found.kinetic[:end], true.kinetic[:end]
    momentum, passed = found.momentum[:end], found.passed[:end]
    when: dict[str, tuple[int, str]] = {}  # reason -> frame, words

    def first(reason: str, bad: np.ndarray, words: str) -> None:
        if bad.any():
            when[reason] = int(bad.argmax()), words

    limit = STRAINED * np.maximum.accumulate(stretch_true)[:common] + 0.05
    words = f"p99 strain {stretch.max():.2g}, truth {stretch_true.max():.2g}"
    first("strained", stretch[:common] > limit, words)
    limit = LIVELY * np.maximum.accumulate(kinetic_true)[:common] + SPARE
    first("energy", kinetic[:common] > limit, f"{kinetic.max():.2g} J/kg, truth {kinetic_true.max():.2g}")
    both = min(len(drift), len(drift_true))
    gained = drift[:both] - np.maximum.accumulate(np.maximum(drift_true[:both], 0)) > GAINED
    first("energy drift", gained, f"{np.nan_to_num(drift).max():.2g} m g H from nowhere")
    first("tunnelling", passed > 0, f"{passed[-1]} vertices or triangles, truth {true.passed[:end][-1]}")
    first("momentum", momentum > DRIFT, f"drift {np.nan_to_num(momentum).max():.2g} of the sum of m |v|")
    crossings, crossings_true = found.crossings[:end], true.crossings[:end]
    if scene.self_contact is not None:
        crossing = (crossings[:common] > 0) & (np.maximum.accumulate(crossings_true)[:common] == 0)
        first("crossing", crossing, f"{crossings.max()} pairs of triangles cross, truth {crossings_true.max()}")
    fraction, difference, gaps = gate(found, true, frames)
    chaos = gate(near, true, frames)[0]
    if np.isfinite(fraction):
        worst = int(gaps.argmax())
        slow = difference * (true.heights[worst] - true.heights[0]) < 0
        words = f"mean height off by {1e3 * difference:.1f} mm, {100 * fraction:.0f} % of its way"
        first("slow motion" if slow else "fast motion", gaps > max(HEIGHT, 2 * np.nan_to_num(chaos)), words)
    early, error = frames_in(EARLY, scene), float("nan")
    if common > early:
        error = measure.vertex_error(scene, found.states[early], true.states[early])
    if error > ASTRAY:
        when["error"] = early, f"vertices {100 * error:.1f} % of the length off after {early * dt:.2g} s"
    if found.failure and len(found.states) <= frames:
        kind, _, words = found.failure.partition(": ")
        when[kind] = len(found.states) if kind != "refused" else 0, words or f"in frame {len(found.states)}"
    reason = next((name for name in REASONS if name in when), "")
    frame, detail = when.get(reason, (frames, ""))
    # Of each the one that is farthest from 0.
    peaks = {"p99": p99, "p99_truth": p99_true, "drift": drift, "drift_truth": drift_true, "momentum": momentum}
    peaks |= {"kinetic": kinetic, "kinetic_truth": kinetic_true}
    deepest = penetration(scene, stack_states(found.states[:end]), thickness=0.0).max.max()
    return Score(
        frames=frames,
        reason=reason,
        detail=detail,
        failed_at=frame * dt,
        ms=found.ms,
        **{name: float(v[abs(v).argmax()]) if np.isfinite(v).all() else float("nan") for name, v in peaks.items()},
        depth=float(deepest) if scene.colliders else float("nan"),
        tunnelled=int(passed[-1]),
        gate=fraction,
        chaos=chaos,
        error=error,
        truth=true.failure if len(true.states) <= frames else "",
        crossings=float(crossings.max()),
        crossings_truth=float(crossings_true.max()),
    )
