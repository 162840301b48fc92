"""What an agent observes of a batch, and the spaces of it."""

from typing import Any

import numpy as np
from array_api_compat import array_namespace
from gymnasium import spaces

from cloth_envs.arguments import one_of
from cloth_envs.scenes.measures import columns, gather
from cloth_envs.scenes.task import Episode, Task

KINDS = ("keypoints", "mesh")
POSITION_BOUND = 20.0  # m; observations are clipped to it
VELOCITY_BOUND = 100.0  # m/s


class Observer:
    """Observations of one ``kind``: ``"keypoints"``, a flat Box, or ``"mesh"``, a Dict with the geometry image.

    With ``material``, properties ``(B, M)`` of each member's cloth that change in place, and their ``ranges``
    ``(2, M)``, there is beside the task's numbers where in its range each property is, from -1 to 1: before them, or
    as ``"material"``.

    Attributes:
        task: what the numbers are of. space: of one member. material: see above, or None.

    Raises:
        ValueError: another kind; the nearest match is named.
    """

    def __init__(
        self, task: Task, kind: str, material: np.ndarray | None = None, ranges: np.ndarray | None = None
    ) -> None:
        self.task, self._mesh = task, one_of("observation", kind, KINDS) == "mesh"
        self.material: Any = material
        if ranges is not None:
            self._middle, half = ranges.mean(0), (ranges[1] - ranges[0]) / 2
            self._half = np.where(half > 0, half, 1.0)
        n, k, m = len(task.keypoints), len(task.extras), 0 if material is None else material.shape[1]
        bounds = [POSITION_BOUND, VELOCITY_BOUND, 1.0, task.extras_bound]
        bound = self._bound = np.repeat(np.array(bounds, np.float32), [3 * n, 3 * n, m, k])
        self.space: spaces.Space[Any] = spaces.Box(-bound, bound, dtype=np.float32)
        if self._mesh:
            self._limit = np.repeat(np.array(bounds[:2], np.float32), 3)[:, None, None]
            limits = {"mesh": np.broadcast_to(self._limit, (6, *task.scene.grid.shape)), "task": bound[-k:]}
            if material is not None:
                limits["material"] = np.ones(m, np.float32)
            self.space = spaces.Dict({name: spaces.Box(-b, b, dtype=np.float32) for name, b in limits.items()})

    def __call__(self, episode: Episode) -> Any:
        """Observations of the batch, freshly allocated, in ``space`` with a leading axis."""
        state, extras = episode.state, self.task.numbers(episode)
        if self._mesh:
            xp = array_namespace(extras)
            mesh = xp.concat([xp.astype(field, xp.float32) for field in (state.positions, state.velocities)], axis=1)
            limit = self.task.extras_bound
            seen = {"mesh": mesh.clip(-self._limit, self._limit), "task": extras.clip(-limit, limit)}
            return seen if self.material is None else {"material": columns(self._placed()), **seen}
        if self.material is not None:
            extras = columns(self._placed(), extras)
        return gather(state.positions, state.velocities, self.task.keypoints, extras, self._bound)

    def _placed(self) -> Any:
        """Where in its range each property is, ``(B, M)`` in [-1, 1]."""
        return ((self.material - self._middle) / self._half).clip(-1.0, 1.0)


def member(observations: Any, i: int) -> Any:
    """What one environment of the batch observes."""
    return {name: part[i] for name, part in observations.items()} if isinstance(observations, dict) else observations[i]
