"""Coarse cloths of a closure that start again from the truth, and the truth beside them: what ``"mfsr"`` learns there.

A closure's coarse cloth moves as the fine one does on average, and is what ``backend="mfsr"`` steps where a scene has
one. Of tracked pairs (``pairs``) its network would learn wrinkles alone; from these it learns what the coarse cloth
misses in a few frames as well, as ``"local"`` does, from runs of the same seeds.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch

from cloth_envs.scene import Scene
from cloth_envs.state import State
from cloth_envs.world import World
from surrogates.miniature.coarse import CoarsePhysics
from surrogates.superres.features import FRAMES, SCALE
from training.cache import cached_arrays, digest
from training.rollouts import record, replay, seeded_actions
from training.superres.frames import Around, Frames, around

POLICIES = ("smooth", "random", "smooth", "bang-bang")
STARTS = (10, 25, 40, 55, 70, 85, 100)  # frames of an episode
AFTER = 6  # frames after a start that are read
BEFORE = FRAMES - 2  # frames of the past that the coarse cloth begins with, beside the start
SCALING = "closure"
SEEDS = range(1000, 1032), range(200, 206)  # to learn from and to test on, as of "local"


def simulate(scene: str, seeds: Sequence[int], starts: Sequence[int] = STARTS) -> dict[str, np.ndarray]:
    """Runs of the truth under POLICIES in turn, and of coarse cloths from each of ``starts``; ``N`` frames in all.

    Returns:
        ``coarse`` ``(N, 3, h, w)``, ``fine`` ``(N, 3, H, W)`` and ``bodies`` ``(N, C, 2, 3)`` [m] in float32, and
        ``run`` ``(N,)``, which numbers the starts. Episodes that fail are left out.
    """
    world = World(scene, num_envs=len(seeds))
    actions = seeded_actions(world, seeds, POLICIES, max(starts) + AFTER)
    shown = range(-BEFORE, AFTER + 1)
    run = record(world, actions, [start + frame for start in starts for frame in shown], seeds=seeds)
    run = run.only(run.good)
    cloth = coarse_cloth(run.scene, len(run.materials))
    found = []
    for start in starts:
        path: list[State] = []
        for state, _ in replay(cloth, run.states[start], run.controls[start : start + AFTER], run.materials):
            path += [state] if path else cloth.history  # at the first frame with what comes before it
        truth = [run.states[start + frame] for frame in shown]
        parts = [[s.positions for s in path], [s.positions for s in truth], [s.colliders for s in truth]]
        found.append([np.stack(part, 1).astype(np.float32) for part in parts])
    coarse, fine, bodies = (np.concatenate(part) for part in zip(*found, strict=True))
    numbers = np.repeat(np.arange(len(fine)), len(shown))
    whole = {"coarse": coarse, "fine": fine, "bodies": bodies}
    return {name: a.reshape(len(numbers), *a.shape[2:]) for name, a in whole.items()} | {"run": numbers}


def coarse_cloth(scene: Scene, num_envs: int = 1) -> CoarsePhysics:
    """The coarse cloths of ``scene``, which remember as many frames as are read."""
    cloth = CoarsePhysics(scene, num_envs=num_envs, factor=SCALE, scaling=SCALING)
    cloth.frames = FRAMES
    return cloth


def restarts(scene: str, seeds: Sequence[int], cache: Path) -> dict[str, np.ndarray]:
    """``simulate`` of a scene, kept in ``cache``: a stopped training finds its data again."""
    fine = World(scene).scene
    key = digest(fine, coarse_cloth(fine).scene, seeds, POLICIES, STARTS, AFTER)
    return cached_arrays(cache / f"{scene}_{key}.npz", lambda: simulate(scene, seeds))


def frames_of(scene: Scene, found: Mapping[str, np.ndarray]) -> tuple[Frames, Around]:
    """The frames of ``simulate``, and what is around the coarse cloths, of the fine ``scene``."""
    few = coarse_cloth(scene).scene
    coarse, fine, run = (torch.from_numpy(found[name]) for name in ("coarse", "fine", "run"))
    frames = Frames(coarse, fine, run, few.grid, scene.grid, scene.frame_dt)
    return frames, around([few] * len(np.unique(found["run"])), found["bodies"])
