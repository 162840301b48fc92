"""What a policy earns on one physics and on another from the same seeds, and how sure that is."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.utils.seeding import np_random
from scipy import stats

from cloth_envs.progress import progress
from cloth_envs.registry import EPISODE_FRAMES
from cloth_envs.vector_env import threaded
from cloth_envs.world import World

Policy = Callable[[Any], np.ndarray]  # observations of a batch -> actions (B, A), clipped to [-1, 1] then
ALLOWED = 0.03  # reward a frame that a policy may earn more on its own physics, before that is called exploiting it


@dataclass(frozen=True)
class Played:
    """One episode from each of B seeds, arrays ``(B,)``.

    Attributes:
        reward: mean of all frames; a failed episode earns nothing from then on. last_second: of the last second.
        success: in the last frame. failures: why each failed, or None.
        change: mean absolute change of an action from frame to frame. saturated: share of actions at a bound.
    """

    reward: np.ndarray
    last_second: np.ndarray
    success: np.ndarray
    failures: list[str | None]
    change: np.ndarray
    saturated: np.ndarray

    @property
    def failed(self) -> float:
        """The share of episodes that failed."""
        return sum(why is not None for why in self.failures) / len(self.failures)

    @property
    def failed_at_most(self) -> float:
        """What the share of failing episodes is surely below (95 %, Clopper and Pearson), however few were played."""
        count = sum(why is not None for why in self.failures)
        return float(stats.binomtest(count, len(self.failures), alternative="less").proportion_ci(0.95).high)


def play(scene: str, policy: Policy, seeds: Sequence[int], *, frames: int | None = None, **options: Any) -> Played:
    """One episode of the scene's length, or of ``frames``, from each of ``seeds``; ``options`` are the world's.

    All processors at hand step them, unless ``backend_kwargs`` have other ``threads``; results are the same.

    Raises:
        ValueError: bad options, or a policy whose actions don't fit.
    """
    world = World(scene, num_envs=len(seeds), **threaded(options, len(seeds)))
    world.reset({i: np_random(seed)[0] for i, seed in enumerate(seeds)})
    count = frames or EPISODE_FRAMES[scene]
    rewards, moves = np.zeros((count, len(seeds))), np.zeros((count, len(seeds), len(world.task.actions)))
    failures: list[str | None] = [None] * len(seeds)
    success = np.zeros(len(seeds), bool)
    for frame in progress(range(count), f"{scene} on {world.backends[0]}", unit="frame"):
        moves[frame] = _chosen(world, policy(world.observe()), frame)
        earned, reasons = world.advance(moves[frame])
        failures = [old or reasons.get(i) for i, old in enumerate(failures)]
        alive = np.array([why is None for why in failures])
        rewards[frame] = earned * alive
        success = world.told.get("success", success) & alive
    second = rewards[-max(1, round(1 / world.scene.frame_dt)) :]
    change = abs(np.diff(moves, axis=0)).mean((0, 2)) if count > 1 else np.zeros(len(seeds))
    return Played(rewards.mean(0), second.mean(0), success, failures, change, (abs(moves) >= 1).mean((0, 2)))


def _chosen(world: World, actions: Any, frame: int) -> np.ndarray:
    """Actions ``(B, A)`` in [-1, 1]. Raises ValueError: not numbers, not finite, or of another shape."""
    try:
        chosen = world.read(actions)
    except ValueError as error:
        raise ValueError(f"the policy in frame {frame} on {world.backends[0]}: {error}") from error
    if not np.isfinite(chosen).all():
        raise ValueError(f"the policy's actions in frame {frame} on {world.backends[0]} hold NaN or infinity")
    return chosen.clip(-1, 1)


@dataclass(frozen=True)
class Interval:
    """A mean and half of its 95 % interval (Student's)."""

    mean: float
    half: float

    @classmethod
    def of(cls, values: np.ndarray) -> "Interval":
        """Of ``values`` ``(B,)``; of a single one the half is infinite."""
        n = len(values)
        half = stats.t.ppf(0.975, n - 1) * values.std(ddof=1) / n**0.5 if n > 1 else np.inf
        return cls(float(values.mean()), float(half))

    def __str__(self) -> str:
        return f"{self.mean:.3f} ± {self.half:.3f}"


@dataclass(frozen=True)
class Verdict:
    """A policy on the physics that it was trained on, ``own``, and on the one that counts, ``true``: equal seeds."""

    own: Played
    true: Played

    @property
    def gap(self) -> Interval:
        """What it earns more on its own: the mean of differences seed by seed, which share starts and goals."""
        return Interval.of(self.own.reward - self.true.reward)

    @property
    def unpaired(self) -> float:
        """Half of the interval that the same episodes give with other seeds on each (Welch's)."""
        (a, b), n = (self.own.reward, self.true.reward), len(self.own.reward)
        if n < 2:
            return float("inf")
        va, vb = a.var(ddof=1) / n, b.var(ddof=1) / n
        if va + vb == 0:
            return 0.0
        return float(stats.t.ppf(0.975, (n - 1) * (va + vb) ** 2 / (va**2 + vb**2)) * (va + vb) ** 0.5)

    def warnings(self, beside: Mapping[str, "Verdict"]) -> list[str]:
        """What to beware of; ``beside`` are policies by name that were not trained on that physics."""
        found, gap, own, true = [], self.gap, self.own, self.true
        if gap.mean - gap.half > ALLOWED:
            found.append(f"it exploits its physics: it earns {gap} a frame more there, surely over {ALLOWED}")
        elif gap.mean + gap.half > ALLOWED:
            found.append(f"the gap may be over {ALLOWED}: take more seeds")
        for name, other in beside.items():
            more = Interval.of(own.reward - true.reward - other.own.reward + other.true.reward)
            if more.mean - more.half > 0:
                found.append(f"its gap is {more} larger than that of {name}: the physics alone does not explain it")
        if true.failed or own.failed:
            found.append(f"it fails in {true.failed:.0%} of the episodes that count, in {own.failed:.0%} of its own")
        return found
