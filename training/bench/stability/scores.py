"""What became of a run, and why it failed, next to the truth of the same world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cloth_envs.physics.laws.budget import slow_motion
from cloth_envs.physics.laws.diagnostics import penetration
from training.bench.measure import vertex_error
from training.bench.stability.runs import GATE, Run, frames_in
from training.rollouts import stack_states

HEIGHT = 0.05  # of the way that the mean height goes in 0.5 s
EARLY, ASTRAY = 0.2, 0.05  # s, of the length: mean distance of the vertices from the truth's
GAINED = 0.25  # of m g H: energy from nowhere, beyond what the truth's budget leaves over
STRAINED, LIVELY = 2.0, 2.0  # times the truth's strain and kinetic energy
SPARE = 1.0  # J/kg of kinetic energy, beyond a multiple of the truth's
DRIFT = 0.01  # of the sum of m |v| at the start: momentum from nowhere
# What a row says -> the short word of the chart. A run that has several is told the first of this list.
REASONS = {
    "refused": "refused",
    "blow-up": "blow-up",
    "overstretch": "stretch",
    "energy": "energy",
    "tunnelling": "tunnel",
    "momentum": "momentum",
    "slow motion": "slow",
    "fast motion": "fast",
    "error": "error",
    "strained": "strain",
    "energy drift": "drift",
}
SOFT = ("slow motion", "fast motion", "error", "strained", "energy drift")  # it is wrong, but it stands


@dataclass(frozen=True)
class Score:
    """One run up to ``frames``. NaN where a figure is not defined.

    Attributes:
        reason, detail: one of ``REASONS`` and in words, or empty.
        failed_at: time to failure [s], the run's length if there was none.
        p99: largest over the frames of the 99th percentile of the structural edges' ``|strain|``.
        drift: what the energy budget of the first 10 frames leaves over, ``(gained + losses - work) / (m g H)``,
            where it is largest; in scenes without bodies and wind, whose work in a frame is not known well enough.
            Powers are summed by the trapezoidal rule over frames: compare with the truth's.
        kinetic: largest over the frames [J/kg].
        momentum: drift over the sum of m |v| at the start, with no force from outside.
        depth: deepest in a body [m]. tunnelled: vertices and triangles that a body went through.
        gate: mean height's largest difference from the truth's in 0.5 s over its way; chaos: so for the truth nudged
            by a millionth. error: mean distance of the vertices after 0.2 s over the length.
        truth: why the truth itself failed, or empty.
    """

    frames: int
    reason: str
    detail: str
    failed_at: float
    ms: float
    p99: float
    p99_truth: float
    drift: float
    drift_truth: float
    kinetic: float
    kinetic_truth: float
    momentum: float
    depth: float
    tunnelled: int
    gate: float
    chaos: float
    error: float
    truth: str


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
    fraction, difference, gaps = gate(found, true, frames)
    chaos = gate(near, true, frames)[0]
    if np.isfinite(fraction):
        worst = int(gaps.argmax())
        slow = difference * (true.heights[worst] - true.heights[0]) < 0
        words = f"mean height off by {1e3 * difference:.1f} mm, {100 * fraction:.0f} % of its way"
        first("slow motion" if slow else "fast motion", gaps > max(HEIGHT, 2 * np.nan_to_num(chaos)), words)
    early, error = frames_in(EARLY, scene), float("nan")
    if common > early:
        error = vertex_error(scene, found.states[early], true.states[early])
    if error > ASTRAY:
        when["error"] = early, f"vertices {100 * error:.1f} % of the length off after {early * dt:.2g} s"
    if found.failure and len(found.states) <= frames:
        kind, _, words = found.failure.partition(": ")
        when[kind] = len(found.states) if kind != "refused" else 0, words or f"in frame {len(found.states)}"
    reason = next((name for name in REASONS if name in when), "")
    frame, detail = when.get(reason, (frames, ""))
    rolled = stack_states(found.states[:end])
    return Score(
        frames=frames,
        reason=reason,
        detail=detail,
        failed_at=frame * dt,
        ms=found.ms,
        p99=float(p99.max()),
        p99_truth=float(p99_true.max()),
        drift=_largest(drift),
        drift_truth=_largest(drift_true),
        kinetic=float(kinetic.max()),
        kinetic_truth=float(kinetic_true.max()),
        momentum=_largest(momentum),
        depth=float(penetration(scene, rolled, thickness=0.0).max.max()) if scene.colliders else float("nan"),
        tunnelled=int(passed[-1]),
        gate=fraction,
        chaos=chaos,
        error=error,
        truth=true.failure if len(true.states) <= frames else "",
    )


def _largest(values: np.ndarray) -> float:
    """The one that is farthest from 0."""
    return float(values[abs(values).argmax()]) if np.isfinite(values).all() else float("nan")
