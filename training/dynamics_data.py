"""Truth on coarse grids for the correction of the dynamics: every frame of seeded episodes, and what drove them."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from gymnasium.utils.seeding import np_random

from cloth_envs.policies import open_loop
from cloth_envs.resample import resample
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from surrogates.miniature.coarse import CoarsePhysics, coarse_grid
from surrogates.miniature.correction import Correction
from training.bench.truth import length

FRAMES, SETTLE = 110, 10  # of an episode; the first are left out, as they are for upscalers


@dataclass(frozen=True)
class Episodes:
    """T frames of B cloths, on every coarse grid.

    Attributes:
        positions, velocities: factor -> ``(T, B, 3, h, w)``, float32 [m], [m/s], after each frame.
        controls: of each frame, ``(T, B, ...)``.
    """

    scene: Scene
    positions: dict[int, np.ndarray]
    velocities: dict[int, np.ndarray]
    controls: dict[str, np.ndarray]

    def state(self, factor: int, frame: np.ndarray, member: np.ndarray) -> State:
        """The coarse cloths after frame ``frame[i]`` of episode ``member[i]``."""
        at, driven = (frame, member), self.controls
        return State(
            self.positions[factor][at], self.velocities[factor][at],
            driven["colliders"][at].astype(np.float32), driven["collider_velocities"][at].astype(np.float32),
            driven["wind"][at], driven["pressure"][at], np.zeros(len(frame)),
        )  # fmt: skip

    def given(self, frame: np.ndarray, member: np.ndarray) -> Controls:
        return Controls(**{name: np.ascontiguousarray(values[frame, member]) for name, values in self.controls.items()})

    def starts(self, horizon: int, every: int) -> tuple[np.ndarray, np.ndarray]:
        """Frames and members of windows of ``horizon`` frames, ``every`` so many frames."""
        frames, members = np.indices((len(range(SETTLE, FRAMES - horizon, every)), len(self.controls["pressure"][0])))
        return SETTLE + every * frames.ravel(), members.ravel()


def simulate(scene: str, seeds: Sequence[int], factors: Sequence[int], policies: Sequence[str]) -> Episodes:
    """Run the scene at full resolution at its largest stable step; episodes that fail are left out.

    ``policies`` take turns over the seeds.
    """
    world = World(scene, num_envs=len(seeds))
    world.reset({i: np_random(seed)[0] for i, seed in enumerate(seeds)})
    size, frame_dt = len(world.task.actions), world.scene.frame_dt
    turns = [policies[i % len(policies)] for i in range(len(seeds))]
    chosen = [open_loop(policy, FRAMES, size, frame_dt, seed) for policy, seed in zip(turns, seeds, strict=True)]
    actions = np.stack(chosen, 1)
    given: list[Controls] = []
    advance = world.backend.advance

    def recorded(controls: Controls) -> State:
        given.append(Controls(**{name: np.array(value) for name, value in vars(controls).items()}))
        return advance(controls)

    world.backend.advance = recorded  # type: ignore[method-assign]
    grids = {factor: coarse_grid(world.scene.grid, factor) for factor in factors}
    cloth: dict[tuple[str, int], list[np.ndarray]] = {(n, f): [] for n in ("positions", "velocities") for f in factors}
    good = np.ones(len(seeds), bool)
    for frame in range(FRAMES):
        good &= [not reason for reason in world.step(actions[frame])[1]]
        for (name, factor), kept in cloth.items():
            kept.append(resample(getattr(world.state, name), world.scene.grid, grids[factor]).astype(np.float32))
    arrays = {key: np.stack(kept)[:, good] for key, kept in cloth.items()}
    controls = {f.name: np.stack([getattr(c, f.name) for c in given])[:, good] for f in fields(Controls)}
    positions, velocities = ({f: arrays[name, f] for f in factors} for name in ("positions", "velocities"))
    return Episodes(world.scene, positions, velocities, controls)


def episodes(
    scene: str, seeds: Sequence[int], factors: Sequence[int], policies: Sequence[str], folder: Path
) -> Episodes:
    """``simulate``, kept in ``folder`` under a name that tells the scene as it is."""
    described = World(scene).scene
    mark = hashlib.sha256(repr((described, list(seeds), list(factors), list(policies), FRAMES)).encode()).hexdigest()[
        :12
    ]
    path = folder / f"{scene}_{mark}.npz"
    if not path.is_file():
        made = simulate(scene, seeds, factors, policies)
        arrays = {f"controls.{name}": a for name, a in made.controls.items()}
        for factor in factors:
            arrays |= {f"x.{factor}": made.positions[factor], f"v.{factor}": made.velocities[factor]}
        folder.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part.npz")
        np.savez(part, **arrays)  # type: ignore[arg-type]
        part.replace(path)
    with np.load(path) as file:
        arrays = dict(file)
    x, v = ({factor: arrays[f"{kind}.{factor}"] for factor in factors} for kind in "xv")
    return Episodes(described, x, v, {f.name: arrays[f"controls.{f.name}"] for f in fields(Controls)})


class Course:
    """Windows of ``data`` at one factor, run by the miniature, with a correction or without."""

    def __init__(self, data: Episodes, factor: int, scaling: str, correction: Correction | None = None) -> None:
        self.data, self.factor, self.scaling, self.correction = data, factor, scaling, correction
        self._physics: dict[int, CoarsePhysics] = {}

    def physics(self, count: int) -> CoarsePhysics:
        if count not in self._physics:
            made = CoarsePhysics(self.data.scene, num_envs=count, factor=self.factor, scaling=self.scaling)
            self._physics[count] = made
        return self._physics[count]

    def run(
        self, start: State, frame: np.ndarray, member: np.ndarray, horizon: int
    ) -> tuple[list[State], list[tuple[np.ndarray, np.ndarray]]]:
        """States after each of ``horizon`` frames from ``start``, which the truth had after ``frame``.

        With them what the correction read, and its axes.
        """
        coarse = self.physics(len(frame))
        coarse.start(start, self.data.given(frame, member).handle_positions)
        before, states, seen = coarse.state, [], []
        for k in range(1, horizon + 1):
            after = coarse.advance(self.data.given(frame + k, member))
            if self.correction is not None:
                seen.append(self.correction.features(before, after))
                self.correction.apply(after, *seen[-1])
            states.append(after)
            before = after
        return states, seen

    def gaps(self, frame: np.ndarray, member: np.ndarray, horizon: int) -> np.ndarray:
        """Mean distance of vertices from the truth's, and of velocities, after each frame, ``(2, horizon)``."""
        states, _ = self.run(self.data.state(self.factor, frame, member), frame, member, horizon)
        found = []
        for k, state in enumerate(states, 1):
            truth = self.data.state(self.factor, frame + k, member)
            pairs = (state.positions, truth.positions), (state.velocities, truth.velocities)
            found.append([np.sqrt(((a - b) ** 2).sum(1)).mean((1, 2)) for a, b in pairs])
        return np.array(found).mean(2).T

    def errors(self, horizon: int) -> np.ndarray:
        """Mean vertex error after each frame of windows all over the episodes, % of the cloth's length."""
        return 100 * self.gaps(*self.data.starts(horizon, 5), horizon)[0] / length(self.data.scene)
