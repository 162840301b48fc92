"""Rows of the transfer benchmark: trainings, episodes, and both put together with their intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

REFERENCE, ZERO, RANDOM = "reference", "zero action", "random action"


@dataclass(frozen=True)
class TrainingRow:
    """One training: on what (``policy``), how many episodes of how many frames, its time, and what it found."""

    scene: str
    rows: int
    cols: int
    policy: str
    repetition: int
    episodes: int
    frames: int
    wall_s: float
    processor_s: float
    weights: str


TRAINING_KEY = ("scene", "rows", "cols", "policy", "repetition")


@dataclass(frozen=True)
class EpisodeRow:
    """Mean reward per frame of a policy on one held-out seed, on the backend ``scored_on``; ``failed`` is 0 or 1."""

    scene: str
    rows: int
    cols: int
    policy: str
    repetition: int
    scored_on: str
    seed: int
    reward: float
    failed: int


EPISODE_KEY = ("scene", "rows", "cols", "policy", "repetition", "scored_on", "seed")


@dataclass(frozen=True)
class TransferRow:
    """A policy's rewards per frame on the reference and on its own backend, with half widths of 95 % intervals over
    seeds and trainings. Time is the median of the trainings.

    ``gap`` is the reward on the reference less that of the policy trained there, over what the latter earns
    more than no action. ``flattery`` is the reward on its own backend less that on the reference. ``failed`` counts
    episodes on the reference.
    """

    scene: str
    policy: str
    trainings: int
    episodes: int
    wall_s: float
    processor_s: float
    seeds: int
    reference: float
    reference_half: float
    own: float
    own_half: float
    flattery: float
    flattery_half: float
    gap: float
    gap_half: float
    failed: int


def half_width(seeds: np.ndarray, *trainings: np.ndarray) -> float:
    """Half of the 95 % interval of a mean that varies with ``seeds`` ``(S,)`` and with ``trainings`` ``(R,)`` each.

    Variances of the means add up; Student's t with the degrees of freedom of Welch and Satterthwaite.
    """
    parts = [(x.var(ddof=1) / len(x), len(x) - 1) for x in (seeds, *trainings) if len(x) > 1]
    variance = sum(v for v, _ in parts)
    if variance == 0:
        return 0.0
    freedom = variance**2 / sum(v**2 / n for v, n in parts)
    return float(student.ppf(0.975, freedom) * np.sqrt(variance))


def summaries(trainings: Sequence[TrainingRow], episodes: Sequence[EpisodeRow]) -> list[TransferRow]:
    """One row for each scene and policy of one resolution; what a stopped run left unfinished is passed over."""
    rewards: dict[tuple[str, str, str], dict[tuple[int, int], float]] = {}
    for e in episodes:
        rewards.setdefault((e.scene, e.policy, e.scored_on), {})[e.repetition, e.seed] = e.reward
    scores = {}
    for key, found in rewards.items():
        rows, cols = (sorted({k[i] for k in found}) for i in (0, 1))
        if len(found) == len(rows) * len(cols):
            scores[key] = np.array([[found[row, col] for col in cols] for row in rows])  # (R, S)
    out = []
    for scene, policy in dict.fromkeys((e.scene, e.policy) for e in episodes):
        if not {(scene, p, REFERENCE) for p in (policy, ZERO, REFERENCE)} <= scores.keys():
            continue
        there = scores[scene, policy, REFERENCE]
        own = scores.get((scene, policy, policy), there)
        best, nothing = scores[scene, REFERENCE, REFERENCE], scores[scene, ZERO, REFERENCE]
        scale = best.mean() - nothing.mean()
        mine = [t for t in trainings if (t.scene, t.policy) == (scene, policy)]
        flattery = own - there
        numbers = {
            "reference": there.mean(),
            "reference_half": half_width(there.mean(0), there.mean(1)),
            "own": own.mean(),
            "own_half": half_width(own.mean(0), own.mean(1)),
            "flattery": flattery.mean(),
            "flattery_half": half_width(flattery.mean(0), flattery.mean(1)),
            "gap": (there.mean() - best.mean()) / scale,
            "gap_half": half_width(there.mean(0) - best.mean(0), there.mean(1), best.mean(1)) / abs(scale)
            if policy != REFERENCE
            else 0.0,
            "wall_s": np.median([t.wall_s for t in mine]) if mine else 0.0,
            "processor_s": np.median([t.processor_s for t in mine]) if mine else 0.0,
        }
        out.append(
            TransferRow(
                scene=scene,
                policy=policy,
                trainings=len(mine),
                episodes=mine[0].episodes if mine else 0,
                seeds=there.shape[1],
                failed=sum(
                    e.failed for e in episodes if (e.scene, e.policy, e.scored_on) == (scene, policy, REFERENCE)
                ),
                **{name: float(f"{value:.4g}") for name, value in numbers.items()},
            )
        )
    return out


def table(rows: Sequence[TransferRow]) -> str:
    """Rewards per frame, one line a policy."""
    lines = []
    for scene in dict.fromkeys(r.scene for r in rows):
        lines.append(
            f"\n{scene:26s}{'episodes':>9s}{'seconds':>9s}{'on the reference':>18s}{'on its own':>16s}{'flattery':>18s}"
            f"{'gap':>16s}"
        )
        for r in (r for r in rows if r.scene == scene):
            trained = f"{r.episodes:9d}{r.processor_s:9.2f}" if r.trainings else " " * 18
            there, own = f"{r.reference:.3f} ± {r.reference_half:.3f}", f"{r.own:.3f} ± {r.own_half:.3f}"
            flattery, gap = f"{r.flattery:+.3f} ± {r.flattery_half:.3f}", f"{r.gap:+.2f} ± {r.gap_half:.2f}"
            if r.policy in (REFERENCE, ZERO, RANDOM):
                own = flattery = ""
            bad = f"  {r.failed} failed" if r.failed else ""
            lines.append(f"{r.policy:26s}{trained}{there:>18s}{own:>16s}{flattery:>18s}{gap:>16s}{bad}")
    return "\n".join(lines)
