"""What the agents' benchmark has measured, and the tables made of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import trim_mean

from cloth_envs.evaluation import Interval

STEM, FLOOR_STEM = "agents", "agents_floors"
REFERENCE, MIXED, MIXED_SAC, ZERO, HAND = "reference", "mixed", "mixed sac", "zero", "controller"
DRAWS = 2000  # of the bootstrap


@dataclass(frozen=True)
class AgentRow:
    """A policy at one ``point`` of a training (1 to the last): what it had cost, and what it earns on held-out seeds.

    ``reward`` is the mean a frame on the reference, ``success`` the share of episodes that end in it. ``gap`` is what
    the policy earns more, on the same seeds, on the physics that it began on, ``gap_half`` half of its 95 % interval;
    0 before the last point, which is scored on more seeds. ``failed`` counts episodes of the training that failed.
    """

    scene: str
    schedule: str
    seed: int
    point: int
    processor_s: float
    frames: int
    reference_frames: int
    reward: float
    success: float
    gap: float
    gap_half: float
    failed: int


@dataclass(frozen=True)
class FloorRow:
    """What ``who``, which learns nothing, earns on the seeds of the last point on the reference."""

    scene: str
    who: str
    reward: float
    success: float


def last(rows: Sequence[AgentRow]) -> list[AgentRow]:
    """Of every training the last point."""
    found = {(r.scene, r.schedule, r.seed): r for r in sorted(rows, key=lambda r: r.point)}
    return list(found.values())


def normalised(rows: Sequence[AgentRow], floors: Sequence[FloorRow]) -> dict[str, dict[str, list[float]]]:
    """By schedule and scene the rewards of trainings, 0 as no action earns and 1 as the controller."""
    known = {(f.scene, f.who): f.reward for f in floors}
    found: dict[str, dict[str, list[float]]] = {}
    for r in last(rows):
        zero, hand = known[r.scene, ZERO], known[r.scene, HAND]
        found.setdefault(r.schedule, {}).setdefault(r.scene, []).append((r.reward - zero) / (hand - zero))
    return found


def interquartile(by_scene: dict[str, list[float]], seed: int = 0) -> tuple[float, float, float]:
    """Interquartile mean over all trainings and its 95 % interval, by a bootstrap within each scene.

    As Agarwal et al. 2021 (arXiv:2108.13264) have it. Of one training a scene there is no interval: NaN.
    """
    runs = [np.array(values) for values in by_scene.values()]
    mean = float(trim_mean(np.concatenate(runs), 0.25))
    if min(map(len, runs)) < 2:
        return mean, np.nan, np.nan
    rng = np.random.default_rng(seed)
    drawn = np.concatenate([rng.choice(r, (DRAWS, len(r))) for r in runs], axis=1)
    low, high = np.percentile(trim_mean(drawn, 0.25, axis=1), [2.5, 97.5])
    return mean, float(low), float(high)


def table(rows: Sequence[AgentRow], floors: Sequence[FloorRow]) -> str:
    """Rewards on the reference by scene, a column a schedule; then the interquartile means."""
    ended, schedules = last(rows), list(dict.fromkeys(r.schedule for r in rows))
    known = {(f.scene, f.who): f for f in floors}
    width = max(len(name) for name in schedules) + 8
    lines = [f"{'':10s}{ZERO:>12s}{HAND:>12s}" + "".join(f"{name:>{width}s}" for name in schedules)]
    for scene in dict.fromkeys(r.scene for r in rows):
        cells = [f"{known[scene, who].reward:.2f}" for who in (ZERO, HAND)]
        line = f"{scene:10s}" + "".join(f"{cell:>12s}" for cell in cells)
        for schedule in schedules:
            mine = np.array([r.reward for r in ended if (r.scene, r.schedule) == (scene, schedule)])
            half = Interval.of(mine).half if len(mine) > 1 else np.nan
            text = "" if not len(mine) else f"{mine.mean():.2f}" + (f" ± {half:.2f}" if len(mine) > 1 else "")
            line += f"{text:>{width}s}"
        lines.append(line)
    lines.append("interquartile mean over scenes and trainings, 0 is no action and 1 the controller:")
    for schedule, by_scene in normalised(rows, floors).items():
        mean, low, high = interquartile(by_scene)
        count = sum(map(len, by_scene.values()))
        interval = "no interval of one seed" if np.isnan(low) else f"95 % {low:.2f} to {high:.2f}"
        lines.append(f"  {schedule:16s}{mean:6.2f}  ({interval}; {count} trainings of {len(by_scene)} scenes)")
    return "\n".join(lines)


def costs(rows: Sequence[AgentRow]) -> str:
    """What the trainings took, the share of the reference's frames in them, gaps and successes."""
    lines = [f"{'':28s}{'seconds':>9s}{'frames':>10s}{'reference':>11s}{'success':>9s}{'gap':>17s}{'failed':>8s}"]
    for r in last(rows):
        share, gap = r.reference_frames / r.frames, f"{r.gap:+.3f} ± {r.gap_half:.3f}"
        name = f"{r.scene}, {r.schedule}, {r.seed}"
        lines.append(
            f"{name:28s}{r.processor_s:9.0f}{r.frames:10d}{share:11.1%}{r.success:9.0%}{gap:>17s}{r.failed:8d}"
        )
    return "\n".join(lines)
