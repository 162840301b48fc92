"""Truth on a coarse grid for the correction of the dynamics: every frame of seeded episodes, and what drove them."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path

import numpy as np

from cloth_envs.resample import on_grid
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from surrogates.miniature.coarse import CoarsePhysics, coarse_grid
from surrogates.miniature.correction import Correction
from training.cache import cached_arrays, digest
from training.rollouts import record, replay, seeded_actions

FRAMES, SETTLE = 110, 10  # of an episode; the first are left out, as they are for upscalers
Seen = tuple[np.ndarray, np.ndarray]  # what a correction reads: features of every vertex, and its axes


@dataclass(frozen=True)
class Episodes:
    """T frames of B cloths on the grid ``factor`` times coarser than that of ``scene``, and their controls.

    Arrays are ``(T, B, ...)``, after each frame; positions and velocities ``(T, B, 3, h, w)``, float32 [m], [m/s].
    """

    scene: Scene
    factor: int
    positions: np.ndarray
    velocities: np.ndarray
    controls: dict[str, np.ndarray]

    def state(self, frame: np.ndarray, member: np.ndarray) -> State:
        """The coarse cloths after frame ``frame[i]`` of episode ``member[i]``."""
        at, driven = (frame, member), self.controls
        return State(
            self.positions[at], self.velocities[at],
            driven["colliders"][at].astype(np.float32), driven["collider_velocities"][at].astype(np.float32),
            driven["wind"][at], driven["pressure"][at], np.zeros(len(frame)),
        )  # fmt: skip

    def given(self, frame: np.ndarray, member: np.ndarray) -> Controls:
        """The controls of these frames."""
        return Controls(**{name: np.ascontiguousarray(values[frame, member]) for name, values in self.controls.items()})

    def starts(self, horizon: int, every: int) -> tuple[np.ndarray, np.ndarray]:
        """Frames and members of windows of ``horizon`` frames, ``every`` so many frames."""
        frames, members = np.indices((len(range(SETTLE, FRAMES - horizon, every)), self.positions.shape[1]))
        return SETTLE + every * frames.ravel(), members.ravel()


def episodes(scene: str, seeds: Sequence[int], factor: int, policies: Sequence[str], folder: Path) -> Episodes:
    """Runs at full resolution at the largest stable step, kept in ``folder``; those that fail are left out.

    ``policies`` take turns over the seeds.
    """
    world = World(scene, num_envs=len(seeds))
    fine, coarse = world.scene.grid, coarse_grid(world.scene.grid, factor)

    def make() -> dict[str, np.ndarray]:
        actions = seeded_actions(world, seeds, policies, FRAMES, least=FRAMES)
        small = lambda state: on_grid(state, fine, coarse).astype(np.float32)  # noqa: E731
        run = record(world, actions, range(1, FRAMES + 1), seeds=seeds, take=small)
        run = run.only(run.good)
        x, v = (np.stack([getattr(s, name) for s in run.states.values()]) for name in ("positions", "velocities"))
        return {"x": x, "v": v} | {
            f.name: np.stack([getattr(c, f.name) for c in run.controls]) for f in fields(Controls)
        }

    key = digest(world.scene, list(seeds), factor, list(policies), FRAMES)
    kept = cached_arrays(folder / f"{scene}_{key}.npz", make)
    return Episodes(world.scene, factor, kept.pop("x"), kept.pop("v"), kept)


class Course:
    """Windows of ``data``, run by the miniature, with a correction or without."""

    def __init__(self, data: Episodes, scaling: str, correction: Correction | None = None) -> None:
        self.data, self.correction = data, correction
        self._physics = lru_cache(
            lambda count: CoarsePhysics(data.scene, num_envs=count, factor=data.factor, scaling=scaling)
        )

    def run(self, frame: np.ndarray, member: np.ndarray, horizon: int) -> tuple[list[State], list[Seen]]:
        """States after each of ``horizon`` frames from the truth after ``frame``; what the correction read."""
        data, coarse, states, seen = self.data, self._physics(len(frame)), [], []
        coarse.start(data.state(frame, member), data.given(frame, member).handle_positions)
        before = coarse.state
        for after, _ in replay(coarse, None, [data.given(frame + k, member) for k in range(1, horizon + 1)]):
            if self.correction is not None:
                seen.append(self.correction.features(before, after))
                self.correction.apply(after, *seen[-1])
            states.append(after)
            before = after
        return states, seen

    def gaps(self, frame: np.ndarray, member: np.ndarray, horizon: int) -> np.ndarray:
        """Mean distance of vertices from the truth's, and of velocities, after each frame, ``(2, horizon)``."""
        found = []
        for k, state in enumerate(self.run(frame, member, horizon)[0], 1):
            truth = self.data.state(frame + k, member)
            gaps = state.positions - truth.positions, state.velocities - truth.velocities
            found.append([np.sqrt((gap**2).sum(1)).mean((1, 2)) for gap in gaps])
        return np.array(found).mean(2).T

    def errors(self, horizon: int) -> np.ndarray:
        """Mean vertex error after each frame of windows all over the episodes, % of the cloth's length."""
        return 100 * self.gaps(*self.data.starts(horizon, 5), horizon)[0] / self.data.scene.grid.length
