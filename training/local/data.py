"""Data of the local upscalers: real runs of the miniature, restarted from truth, and the truth beside them.

Truth is the explicit reference at its default step in float32, of the scene's own material or a random one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.material import Material
from cloth_envs.presets import load_preset
from cloth_envs.resample import Resampler
from cloth_envs.scene import Scene
from cloth_envs.world import World
from surrogates.miniature.coarse import CoarsePhysics, coarse_grid
from surrogates.upscale.local_features import NODES, cells, features, flat_features, spacing, stiffness_numbers
from surrogates.upscale.patches import dense_grid
from training.cache import cached_arrays, digest
from training.rollouts import record, replay, seeded_actions
from training.upscaler.data import read

FRAMES = (1, 2, 3, 5, 7)  # after a restart, at which pairs are taken
STARTS = (10, 25, 40, 55, 70, 85, 100)  # frames of an episode, at which windows begin
POLICIES = ("smooth", "random", "smooth", "bang-bang")
RANGE = (0.5, 2.0)  # of areal density and stretch stiffness over the scene's own


@dataclass(frozen=True)
class Windows:
    """N windows: the coarse cloth after each of ``FRAMES`` by factor, ``(N, len(FRAMES), 3, h, w)``, and the truth.

    Positions are in float32 [m].
    """

    scene: Scene
    coarse: dict[int, np.ndarray]
    truth: np.ndarray
    materials: list[Material]

    @property
    def key(self) -> str:
        """Sixteen digits that tell the content."""
        return digest(self.truth, *(self.coarse[factor] for factor in sorted(self.coarse)))


def of_teacher(scene: str, preset: str, paths: Sequence[Path]) -> Windows:
    """Stored trajectories at factor 2, as many frames a window as ``FRAMES`` has, down-sampled instead of simulated."""
    fine, materials, length = [], [], len(FRAMES)
    for path in paths:
        one = read(path, 2)
        task = load_preset(scene, {"name": preset, "mass": one.mass, "spring": one.spring})
        fine.append(one.fine[1 : 1 + (len(one.fine) - 1) // length * length].reshape(-1, length, *one.fine.shape[1:]))
        materials += [task.material] * len(fine[-1])
    task, truth = load_preset(scene, preset), np.concatenate(fine)
    described = task.make_scene(resolution=task.resolution, material=task.material)
    return Windows(described, {2: truth[..., ::2, ::2]}, truth, materials)


def varied(scene: Scene) -> dict[str, tuple[float, float]]:
    """The ranges of a world's ``randomize`` for materials of training."""
    own = {name: getattr(scene.material, name) for name in ("areal_density", "stretch_stiffness")}
    return {name: (RANGE[0] * value, RANGE[1] * value) for name, value in own.items()}


def simulate(
    scene: str, seeds: Sequence[int], factors: Sequence[int], *, starts: Sequence[int] = STARTS,
    scaling: str = "closure", **options: Any,
) -> Windows:  # fmt: skip
    """Run the truth of every seed under POLICIES in turn, and miniatures from each of ``starts``.

    Episodes that fail are left out. ``options`` go to the world (``randomize``, ``resolution``).
    """
    world = World(scene, num_envs=len(seeds), **options)
    actions = seeded_actions(world, seeds, POLICIES, max(starts) + max(FRAMES))
    run = record(world, actions, [start + frame for start in starts for frame in (0, *FRAMES)], seeds=seeds)
    run = run.only(run.good)
    coarse: dict[int, np.ndarray] = {}
    for factor in factors:
        cloth = CoarsePhysics(run.scene, num_envs=len(run.materials), factor=factor, scaling=scaling)
        found = []
        for start in starts:
            after = replay(cloth, run.states[start], run.controls[start : start + max(FRAMES)], run.materials)
            found.append(np.stack([state.positions for frame, (state, _) in enumerate(after, 1) if frame in FRAMES], 1))
        coarse[factor] = np.concatenate(found)
    truth = [np.stack([run.states[start + f].positions for f in FRAMES], 1) for start in starts]
    return Windows(run.scene, coarse, np.concatenate(truth), run.materials * len(starts))


def join(parts: Sequence[Windows]) -> Windows:
    """Windows of one scene, one after the other."""
    coarse = {factor: np.concatenate([part.coarse[factor] for part in parts]) for factor in parts[0].coarse}
    truth = np.concatenate([part.truth for part in parts])
    return Windows(parts[0].scene, coarse, truth, [m for part in parts for m in part.materials])


def cached(scene: Scene, path: Path, make: Callable[[], Windows]) -> Windows:
    """``make()`` of ``scene``, kept at ``path`` (``.npz``): a stopped training finds its data again."""

    def arrays() -> dict[str, np.ndarray]:
        made = make()
        rows = np.array([list(material.as_dict().values()) for material in made.materials])
        return {"truth": made.truth, "materials": rows} | {str(factor): x for factor, x in made.coarse.items()}

    kept = cached_arrays(path, arrays)
    materials = [Material(*row) for row in kept.pop("materials").tolist()]
    truth = kept.pop("truth")
    return Windows(scene, {int(factor): x for factor, x in kept.items()}, truth, materials)


@dataclass(frozen=True)
class Pairs:
    """P patches: features less those of the flat sheet ``(P, 36)``, answers ``(P, 27)`` and weights ``(P,)``."""

    x: np.ndarray
    y: np.ndarray
    weight: np.ndarray
    numbers: np.ndarray  # stiffness numbers (P, 2)


def small(scene: Scene, factor: int) -> Scene:
    """The scene on the coarse grid."""
    return replace(scene, grid=coarse_grid(scene.grid, factor), handles=(), grips=())


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
            x, truth = (np.ascontiguousarray(a[part, frame]) for a in (data.coarse[factor], data.truth))
            gap, (read, turn) = decimate(truth) - bicubic(x), features(x, unit)
            chosen = np.flatnonzero(rng.random(read.shape[0] * read.shape[1]) < share)
            wanted = (turn @ cells(gap) / np.float32(unit)).reshape(-1, 3, NODES)[chosen]
            size += float(np.sqrt((wanted**2).sum(1)).mean(1).sum())
            rows = np.repeat(numbers[part], read.shape[1], 0)[chosen]
            parts.append((read.reshape(-1, read.shape[-1])[chosen] - flat, wanted.reshape(len(chosen), -1), rows))
        count = sum(len(part[0]) for part in parts[begin:])
        parts[begin:] = [(*part, np.full(len(part[0]), count / size)) for part in parts[begin:]]
    x, y, rows, weight = (np.concatenate([part[k] for part in parts]).astype(np.float32) for k in range(4))
    return Pairs(x, y, weight, rows)
