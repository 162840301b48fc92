"""Stretches of truth in a batch: where participants start, what drives them, and what they should become."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from training.cache import digest
from training.rollouts import stack_controls, stack_states
from training.truth import Case, Truth, load


@dataclass(frozen=True, eq=False)
class Windows:
    """B stretches of truth, the first window of every seed first. ``truth[t]`` is the batch after t frames."""

    scene: Scene
    seeds: tuple[int, ...]
    starts: tuple[int, ...]
    controls: list[Controls]
    truth: list[State]
    key: str

    def first(self, count: int) -> Windows:
        """The first ``count`` of the batch."""
        if count >= len(self.seeds):
            return self
        cut: list[Any] = []
        for items in (self.controls, self.truth):
            cut.append([type(i)(**{n: a[:count] for n, a in vars(i).items()}) for i in items])
        return replace(self, seeds=self.seeds[:count], starts=self.starts[:count], controls=cut[0], truth=cut[1])

    def until(self, frames: int) -> Windows:
        """The first ``frames`` of every stretch."""
        return replace(self, controls=self.controls[:frames], truth=self.truth[: frames + 1])


def cut(truths: Sequence[Truth], seeds: Sequence[int], starts: Sequence[int], frames: int) -> Windows:
    """Windows of ``frames`` frames from every start of every truth, whose seeds are ``seeds``."""
    members = [(truth, start) for start in starts for truth in truths]
    return Windows(
        truths[0].scene,
        tuple(seeds) * len(starts),
        tuple(start for _, start in members),
        [stack_controls([truth.controls[start + i] for truth, start in members]) for i in range(frames)],
        [stack_states([truth.states[start + i] for truth, start in members]) for i in range(frames + 1)],
        digest(*(truth.key for truth in truths)),
    )


def gather(cases: Sequence[Case], starts: Sequence[int], frames: int, last: int, cache: Path) -> Windows:
    """Windows of the ``cases``, whose truths reach to frame ``last`` and are kept in ``cache``."""
    truths = [load(case, last, range(last + 1), cache) for case in cases]
    return cut(truths, [case.seed for case in cases], starts, frames)
