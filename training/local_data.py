"""Data of the local upscalers: real runs of the miniature, restarted from truth, and the truth beside them.

Truth is the explicit reference at its default step in float32. Some of the episodes have the scene's own material, the
others one with random areal density and stretch stiffness.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.utils.seeding import np_random

from cloth_envs.material import Material
from cloth_envs.policies import open_loop
from cloth_envs.resample import Resampler
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from surrogates.miniature.backend import MiniatureBackend
from surrogates.miniature.coarse import coarse_grid
from surrogates.upscale.local_features import NODES, cells, features, flat_features, spacing, stiffness_numbers
from surrogates.upscale.patches import dense_grid

FRAMES = (1, 2, 3, 5, 7)  # after a restart, at which pairs are taken
STARTS = (10, 25, 40, 55, 70, 85, 100)  # frames of an episode, at which windows begin
RANGE = (0.5, 2.0)  # of areal density and stretch stiffness over the scene's own


@dataclass(frozen=True)
class Windows:
    """N windows: the coarse cloth after each of ``FRAMES`` and the truth at that time.

    Attributes:
        coarse: factor -> ``(N, len(FRAMES), 3, h, w)``. truth: ``(N, len(FRAMES), 3, H, W)``, float32 [m].
        materials: of every window.
    """

    scene: Scene
    coarse: dict[int, np.ndarray]
    truth: np.ndarray
    materials: list[Material]

    @property
    def key(self) -> str:
        """Sixteen digits that tell the content."""
        parts = [self.truth, *(self.coarse[factor] for factor in sorted(self.coarse))]
        return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()[:16]


def varied(scene: Scene) -> dict[str, tuple[float, float]]:
    """The ranges of a world's ``randomize`` for materials of training."""
    names = "areal_density", "stretch_stiffness"
    return {
        name: (RANGE[0] * getattr(scene.material, name), RANGE[1] * getattr(scene.material, name)) for name in names
    }


def simulate(
    scene: str,
    seeds: Sequence[int],
    factors: Sequence[int],
    *,
    randomize: Mapping[str, Sequence[float]] | None = None,
    starts: Sequence[int] = STARTS,
    scaling: str = "calibrated",
    **options: Any,
) -> Windows:
    """Run the truth of every seed under smooth actions, and miniatures from each of ``starts``.

    Episodes that fail are left out. ``options`` go to the world (``resolution``).
    """
    world = World(scene, num_envs=len(seeds), randomize=randomize, **options)
    world.reset({i: np_random(seed)[0] for i, seed in enumerate(seeds)})
    last, actions = max(starts) + max(FRAMES), len(world.task.actions)
    frames = max(last, 200)
    policy = np.stack([open_loop("smooth", frames, actions, world.scene.frame_dt, seed) for seed in seeds], 1)
    controls: list[Controls] = []
    advance = world.backend.advance

    def recorded(given: Controls) -> State:
        controls.append(Controls(**{name: np.array(value) for name, value in vars(given).items()}))
        return advance(given)

    world.backend.advance = recorded  # type: ignore[assignment,method-assign]
    kept = {start + frame for start in starts for frame in (0, *FRAMES)}
    states, good = {}, np.ones(len(seeds), bool)
    for frame in range(1, last + 1):
        good &= [not reason for reason in world.step(policy[frame - 1])[1]]
        if frame in kept:
            states[frame] = world.state.copy()
    members = np.flatnonzero(good).tolist()
    materials = [world.materials[i] for i in members]
    coarse = {
        factor: np.concatenate(
            [_window(world.scene, states[s], controls[s:], materials, members, factor, scaling) for s in starts]
        )
        for factor in factors
    }
    truth = [np.stack([states[start + f].positions[members] for f in FRAMES], 1) for start in starts]
    return Windows(world.scene, coarse, np.concatenate(truth), materials * len(starts))


def _window(
    scene: Scene,
    start: State,
    controls: Sequence[Controls],
    materials: Sequence[Material],
    members: Sequence[int],
    factor: int,
    scaling: str,
) -> np.ndarray:
    """Coarse positions at ``FRAMES``, ``(B, len(FRAMES), 3, h, w)``."""
    backend = MiniatureBackend(scene, num_envs=len(members), factor=factor, scaling=scaling)
    backend.reset(start.select(list(members)), materials)
    found = []
    for frame, given in enumerate(controls[: max(FRAMES)], 1):
        backend.advance(replace(given, **{name: value[list(members)] for name, value in vars(given).items()}))
        if frame in FRAMES:
            found.append(backend.coarse.state.positions.copy())
    return np.stack(found, 1)


def join(parts: Sequence[Windows]) -> Windows:
    """Windows of one scene, one after the other."""
    coarse = {factor: np.concatenate([part.coarse[factor] for part in parts]) for factor in parts[0].coarse}
    truth = np.concatenate([part.truth for part in parts])
    return Windows(parts[0].scene, coarse, truth, [m for part in parts for m in part.materials])


def cached(name: str, folder: Path, make: Any) -> Windows:
    """``make()``, kept in ``folder``: a stopped training finds its data again."""
    path = folder / f"{name}.npz"
    if path.is_file():
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
        materials = [Material(*row) for row in arrays.pop("materials").tolist()]
        scene = World(name.split("_")[0]).scene
        truth = arrays.pop("truth")
        return Windows(scene, {int(factor): value for factor, value in arrays.items()}, truth, materials)
    windows = make()
    folder.mkdir(parents=True, exist_ok=True)
    rows = np.array([list(m.as_dict().values()) for m in windows.materials])
    np.savez(path, truth=windows.truth, materials=rows, **{str(f): x for f, x in windows.coarse.items()})
    return windows


@dataclass(frozen=True)
class Pairs:
    """P patches: features less those of the flat sheet ``(P, 36)``, answers ``(P, 27)`` and weights ``(P,)``."""

    x: np.ndarray
    y: np.ndarray
    weight: np.ndarray
    numbers: np.ndarray  # stiffness numbers (P, 2)


def small(scene: Scene, factor: int) -> Scene:
    """The scene on the coarse grid."""
    return replace(scene, grid=coarse_grid(scene.grid, factor), handles=())


def pairs(data: Windows, factor: int, most: int, seed: int = 0) -> Pairs:
    """At most ``most`` patches, as many of every frame."""
    rng, coarse = np.random.default_rng((seed, factor)), small(data.scene, factor)
    grid, unit = coarse.grid, spacing(coarse.grid)
    double = dense_grid(data.scene.grid, grid, 2)
    decimate, bicubic = Resampler(data.scene.grid, double), Resampler(grid, double)
    numbers, flat = stiffness_numbers(coarse, data.materials), flat_features(grid)
    parts: list[tuple[np.ndarray, ...]] = []
    share = most / (len(FRAMES) * len(data.truth) * grid.cells[0] * grid.cells[1])
    for frame in range(len(FRAMES)):
        size, begin = 0.0, len(parts)
        for window in range(0, len(data.truth), 64):
            part = slice(window, window + 64)
            x = np.ascontiguousarray(data.coarse[factor][part, frame])
            truth = np.ascontiguousarray(data.truth[part, frame])
            gap = decimate(truth) - bicubic(x)
            read, turn = features(x, unit)
            chosen = np.flatnonzero(rng.random(read.shape[0] * read.shape[1]) < share)
            wanted = (turn @ cells(gap) / np.float32(unit)).reshape(-1, 3, NODES)[chosen]
            size += float(np.sqrt((wanted**2).sum(1)).mean(1).sum())
            rows = np.repeat(numbers[part], read.shape[1], 0)[chosen]
            parts.append((read.reshape(-1, read.shape[-1])[chosen] - flat, wanted.reshape(len(chosen), -1), rows))
        count = sum(len(part[0]) for part in parts[begin:])
        parts[begin:] = [(*part, np.full(len(part[0]), count / size)) for part in parts[begin:]]
    x, y, rows, weight = (np.concatenate([part[k] for part in parts]).astype(np.float32) for k in range(4))
    return Pairs(x, y, weight, rows)
