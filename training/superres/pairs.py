"""Synchronised pairs on disk: a coarse and a fine recording of every sequence, in ``train`` and ``test``."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.recording import Rollout
from cloth_envs.registry import SCENES
from cloth_envs.scene import Scene
from surrogates.superres.network import OWN
from training.cache import cache_folder

SPLITS = ("train", "test")


def pairs_folder(scene: str, own: bool = False) -> Path:
    """Where a scene's pairs are unless told otherwise: those of the paper, or of its ``own`` grid."""
    return cache_folder("synchronised") / (scene.lower() + OWN * own)


def place(folder: Path, split: str, number: int) -> Path:
    """The fine recording of a sequence; the coarse one is ``twin`` of it."""
    return folder / split / "fine" / f"{number:03d}.h5"


def twin(path: Path) -> Path:
    """The coarse recording beside a fine one."""
    return path.parent.parent / "coarse" / path.name


def sequences(folder: Path, split: str) -> list[Path]:
    """The fine recordings of ``"train"`` or ``"test"``, in order. Raises ValueError: there are none."""
    found = sorted((folder / split / "fine").glob("[0-9]*.h5"))
    if not found:
        scene = next((name for name in SCENES if name.lower() == folder.name.removesuffix(OWN)), "SCENE")
        command = f"minicloth generate {scene} --pairs synchronised{' --own' * folder.name.endswith(OWN)}"
        raise ValueError(f"no pairs for {split} in {folder}: run `{command}`")
    return found


@dataclass(frozen=True)
class Run:
    """One cloth's frames: ``positions`` [m] and ``velocities`` [m/s] ``(T, H, W, 3)`` in float32."""

    scene: Scene
    positions: np.ndarray
    velocities: np.ndarray

    @property
    def rest(self) -> np.ndarray:
        """The cloth unloaded, ``(H, W, 3)`` [m]: flat, its first row above; a tube as a round cylinder."""
        return rest(self.scene.grid)


@dataclass(frozen=True)
class Pair:
    """A sequence's two cloths, and the ends of its bodies' axes ``(T, C, 2, 3)`` [m]."""

    number: int
    coarse: Run
    fine: Run
    bodies: np.ndarray


def rest(grid: Grid) -> np.ndarray:
    """A cloth at rest lengths, ``(H, W, 3)`` [m]: flat, with columns along x and rows down z; a tube a cylinder."""
    z, x = np.meshgrid(-grid.row_spacing * np.arange(grid.rows), grid.col_spacing * np.arange(grid.cols), indexing="ij")
    if not grid.periodic:
        return np.stack([x, np.zeros_like(x), z], -1)
    radius = grid.col_spacing / (2 * np.sin(np.pi / grid.cols))
    return np.stack([radius * np.cos(2 * np.pi * x / grid.width), radius * np.sin(2 * np.pi * x / grid.width), z], -1)


def read(path: Path, frames: slice = slice(None)) -> Pair:
    """The pair of a fine recording, or some of its frames (0 is the start).

    Raises:
        FileNotFoundError: one of the two is not there.
        ValueError: one is damaged, they are not of one sequence, ``path`` is no fine one, or ``frames`` has none.
    """
    if path.parent.name != "fine":
        raise ValueError(f"{path} is no fine recording of a pair: give one that sequences() tells")
    (coarse, _, number), (fine, bodies, own) = _run(twin(path), frames), _run(path, frames)
    if number != own or len(coarse.positions) != len(fine.positions):
        raise ValueError(f"{path} and {twin(path)} are not of one sequence: remove both and generate the pairs again")
    return Pair(own, coarse, fine, bodies)


def _run(path: Path, frames: slice) -> tuple[Run, np.ndarray, int]:
    """A recording's cloth, its bodies, and the number of its sequence."""
    with Rollout.open(path) as rollout:
        states = [rollout.state(frame) for frame in range(rollout.length())[frames]]
        number = rollout.seeds[0]
        if not states or number is None:
            raise ValueError(f"{path} has {rollout.length()} frames, none of them in {frames}, or is of no sequence")
        cloth = (np.stack([s.positions[0] for s in states]), np.stack([s.velocities[0] for s in states]))
        last = (np.ascontiguousarray(np.moveaxis(field, 1, -1)) for field in cloth)
        return Run(rollout.scene, *last), np.concatenate([state.colliders for state in states]), number
