"""What became of a run, next to the truth of the same world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cloth_envs.failure import Failures
from cloth_envs.physics.laws.budget import slow_motion
from cloth_envs.physics.laws.diagnostics import energy, strain
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from training.bench.configurations import Config
from training.bench.convergence.chaos import NUDGE, nudged
from training.bench.cost import TOLERANCE, build, milliseconds
from training.bench.truth import length, mean_height, replay, vertex_error

TRUTH = Config("explicit", {"dtype": "float64", "refine": 2})
GATE = 0.5  # s; the mean height is compared until then, later it is chaos too
STRAINED, LIVELY = 2.0, 2.0  # times the truth's strain and kinetic energy
MARKS = {
    "ok": ".",
    "slow": "s",
    "fast": "f",
    "chaotic": "?",
    "strained": "x",
    "lively": "l",
    "refused": "R",
    "failed": "F",
}


@dataclass(frozen=True)
class Verdict:
    """``outcome``, and ``detail`` in words. NaN where there is nothing to compare.

    - ok
    - slow, fast: the mean height lags or leads the truth's by more than 5 % of its way within 0.5 s
    - chaotic: so it is, but the truth nudged by a millionth does half as much
    - lively: kinetic energy at the end over twice the truth's and 1 J/kg
    - strained: p99 strain at the end over twice the truth's and 5 points
    - refused: the solver says what it can't; failed: non-finite, overstretch or a jump of energy

    ``height`` is the mean height's largest difference over its way, ``error`` the mean distance of the vertices at the
    end over the cloth's longer side; ``p99`` and ``kinetic`` [J/kg] are the run's and the truth's at the end.
    """

    outcome: str
    detail: str = ""
    ms: float = np.nan
    p99: float = np.nan
    p99_truth: float = np.nan
    kinetic: float = np.nan
    kinetic_truth: float = np.nan
    height: float = np.nan
    error: float = np.nan


def trajectory(
    backend: Any, scene: Scene, start: State, controls: Sequence[Controls]
) -> tuple[list[State], list[float], str]:
    """States, the start first, until the first failure; the processor's times of frames [s]; the failure."""
    states, failures = [start], Failures(scene)
    times: list[float] = []
    for frame, (state, time) in enumerate(replay(backend, start, controls), 1):
        reason = failures.check(states[-1], state)[0]
        if reason:
            return states, times, f"{reason} at frame {frame}"
        states.append(state.copy())
        times.append(time.cpu)
    return states, times, ""


def judge(
    config: Config, scene: Scene, start: State, controls: Sequence[Controls], true: Sequence[State], *, seed: int
) -> Verdict:
    """Run ``config`` from ``start`` and compare it with the states ``true`` of the same world, the start first."""
    backend = build(config, scene)
    if isinstance(backend, str):
        return Verdict("refused", backend)
    states, times, failure = trajectory(backend, scene, start, controls)
    ms = milliseconds(times)
    if failure:
        return Verdict("failed", failure, ms)
    if len(true) != len(states):
        return Verdict("ok", "there is no truth to compare with", ms)
    ends = states[-1], true[-1]
    p99, p99_true = (float(strain(scene.grid, state.positions).p99[0]) for state in ends)
    kinetic, kinetic_true = (float(energy(scene, state).kinetic[0] / scene.mass.sum()) for state in ends)
    early = true[: round(GATE / scene.frame_dt) + 1]
    gate = slow_motion(scene, states[: len(early)], early, tolerance=TOLERANCE)
    outcome = detail = ""
    if p99 > STRAINED * p99_true + 0.05:
        outcome, detail = "strained", f"p99 strain {p99:.2g}, truth {p99_true:.2g}"
    elif kinetic > LIVELY * kinetic_true + 1:
        outcome, detail = "lively", f"{kinetic:.2g} J/kg, truth {kinetic_true:.2g}"
    elif not gate.passed[0]:
        lags = gate.difference[0] * (mean_height(scene, start) - mean_height(scene, early[-1])) > 0
        loose = chaotic(scene, start, controls[: len(early) - 1], early, seed)
        outcome = "chaotic" if loose else "slow" if lags else "fast"
        detail = f"mean height off by {1e3 * gate.difference[0]:.1f} mm, way {1e3 * gate.fall[0]:.0f} mm"
    return Verdict(
        outcome or "ok", detail, ms, p99, p99_true, kinetic, kinetic_true,
        float(gate.fraction[0]), vertex_error(scene, *ends),
    )  # fmt: skip


def chaotic(scene: Scene, start: State, controls: Sequence[Controls], true: Sequence[State], seed: int) -> bool:
    """Whether a nudge of the start alone takes the truth's mean height half as far off as is not let pass."""
    rng = np.random.default_rng(seed)
    other = nudged(start, scene.handles, NUDGE * length(scene), rng)
    states = trajectory(TRUTH.build(scene), scene, other, controls)[0]
    return len(states) < len(true) or not slow_motion(scene, states, true, tolerance=TOLERANCE / 2).passed[0]
