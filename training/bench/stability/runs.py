"""Runs of the stability benchmark: states until the first failure, and what can be told of them by frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from cloth_envs.backend import Backend
from cloth_envs.physics.laws.budget import budget
from cloth_envs.physics.laws.diagnostics import linear_momentum, strains
from cloth_envs.scene import Scene
from cloth_envs.state import State
from training.bench import measure
from training.bench.participants import truth
from training.bench.stability.worlds import Stage
from training.metrics.contact import tunnelled
from training.rollouts import nudge, stack_states

TRUTH = truth("half")
GATE = 0.5  # s; the mean height is compared until then, later it is chaos too
BUDGETED = 10  # frames: of a run's first ones the energy budget is made
BURST = 100.0  # strain of an edge: not a number yet, but no cloth either
_FAILURES = {"non-finite": "blow-up", "overstretch": "overstretch", "energy": "energy"}


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
        if scene.colliders or scene.wind or not scene.gravity or not count:
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
            s0, s1 = (_volume(*corners) for corners in ((a, b, c), later))
            crossing = np.flatnonzero(s0 * s1 < 0)
            t = (s0[crossing] / (s0[crossing] - s1[crossing]))[:, None]
            a, b, c = ((1 - t) * x[crossing] + t * y[crossing] for x, y in zip((a, b, c), later, strict=True))
            parts = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])
            count += int(((parts * parts.sum(0)).sum(-1) > 0).all(0).sum())
    return count


def _volume(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    return (a * np.cross(b, c)).sum(-1)


def run(backend: Backend | str, stage: Stage) -> Run:
    """Step ``stage`` until the first failure; one that was refused has its start only."""
    scene, found = stage.scene, measure.run(backend, stage.scene, stage.start, stage.controls, stop=True)
    (reason,), states = found.failures, found.states
    if not reason or isinstance(backend, str):
        return Run(scene, states, reason, found.ms)
    kind = "blow-up" if strains(scene.grid, states[-1].positions).max() > BURST else _FAILURES[reason.split(" at ")[0]]
    return Run(scene, states[:-1], kind, found.ms)


def truths(stage: Stage, seed: int) -> tuple[Run, Run]:
    """The truth of a world, explicit at half the stable step, and that of its start nudged by a millionth (0.5 s)."""
    push, early = nudge(stage.start, stage.scene, seed), frames_in(GATE, stage.scene)
    near = Stage(stage.scene, push, stage.controls[:early])
    return run(measure.built(TRUTH, stage.scene), stage), run(measure.built(TRUTH, stage.scene), near)


def frames_in(seconds: float, scene: Scene) -> int:
    """How many frames that is, one at least."""
    return max(1, round(seconds / scene.frame_dt))
