"""``Rollout``: reads what ``RolloutWriter`` wrote."""

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cloth_envs.material import PROPERTIES, Material
from cloth_envs.recording.layout import LAYOUT_VERSION, PATHS, scene_from_json
from cloth_envs.state import State
from cloth_envs.version import __version__


def has_writer(path: Path) -> bool:
    """Whether the writer of this HDF5 file still runs or was killed; such a file opens in single-writer mode only.

    That mode reads damaged parts again and again, for ever, so the length is compared with the superblock here
    (HDF5 file format, version 3: byte 11 holds the flags, 28-35 the end of the file).

    Raises:
        OSError: the file is shorter than it was when its writer last flushed.
    """
    with path.open("rb") as file:
        head = file.read(48)
    if len(head) < 48 or not head.startswith(b"\x89HDF\r\n\x1a\n") or head[8] < 3 or not head[11]:
        return False
    if path.stat().st_size < int.from_bytes(head[28:36], "little"):
        raise OSError("shorter than its writer left it")
    return True


class Rollout(AbstractContextManager["Rollout"]):
    """A rollout file opened for reading, whole or cut off by a killed writer; made by ``Rollout.open``.

    Attributes:
        scene: the ``Scene``, rebuilt from the file alone.
        attributes: the file's attributes; ``env_spec`` is JSON for ``gymnasium.envs.registration.EnvSpec.from_json``.
        lengths: whole frames of every trajectory.
        seeds: of every trajectory, None where none was given.
    """

    def __init__(self, file: h5py.File) -> None:
        self._file = file
        self.attributes: dict[str, Any] = dict(file.attrs)
        handles = tuple(file["boundary_conditions/handles/vertices"][:].tolist())
        self.scene = scene_from_json(self.attributes["scene"], handles)
        self.lengths: list[int] = file["frames"][:].tolist()
        self.seeds: list[int | None] = [None if s < 0 else s for s in file["seeds"][: len(self.lengths)].tolist()]

    def __repr__(self) -> str:
        frames = ", ".join(map(str, self.lengths[:5])) + (", ..." if len(self.lengths) > 5 else "")
        return (
            f"<Rollout {self.scene.name} {self.scene.grid}, {len(self.lengths)} trajectories of {frames or 0} frames>"
        )

    def _repr_html_(self) -> str:
        """The last frame of the first trajectory that holds one."""
        from cloth_envs.rendering.notebook import card

        held = [number for number, length in enumerate(self.lengths) if length]
        shown = (
            self.state(self.lengths[held[0]] - 1, held[0]) if self._file and held else None
        )  # a closed file is false
        return card(repr(self), self.scene, shown)

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> "Rollout":
        """Open a file that ``RolloutWriter`` made.

        Raises:
            FileNotFoundError: no such file.
            ValueError: not HDF5 or cut short, not a rollout, or written by a newer package.
        """
        if not Path(path).is_file():
            raise FileNotFoundError(f"there is no file {path}: give the path of a rollout that RolloutWriter made")
        try:
            file = h5py.File(path, "r", swmr=has_writer(Path(path)))
        except OSError as error:
            raise ValueError(f"{path} is no HDF5 file or was cut short ({error}): copy or record it again") from error
        try:
            version = int(file.attrs.get("layout_version", 0))
            if version == 0:
                raise ValueError(f"{path} is HDF5 but no MiniCloth rollout: give a file that RolloutWriter made")
            if version > LAYOUT_VERSION:
                raise ValueError(
                    f"{path} has layout version {version}, MiniCloth {__version__} reads up to {LAYOUT_VERSION}: "
                    "read it with the version that wrote it, or a newer one"
                )
            return cls(file)
        except (KeyError, TypeError, OSError) as error:
            file.close()
            raise ValueError(f"{path} is a damaged rollout ({error}): copy or record it again") from error
        except ValueError:
            file.close()
            raise

    def length(self, trajectory: int = 0) -> int:
        """Whole frames of one trajectory. Raises ValueError: no such trajectory."""
        if not 0 <= trajectory < len(self.lengths):
            raise ValueError(
                f"there is no trajectory {trajectory}: the file holds {len(self.lengths)}, numbered from 0"
            )
        return self.lengths[trajectory]

    def actions(self, trajectory: int = 0) -> np.ndarray:
        """``(T, A)``; entry t led to frame t."""
        length = self.length(trajectory)
        if "actions" not in self._file:
            return np.zeros((length, 0))
        return self._file["actions"][trajectory, :length].astype(np.float64)

    def rewards(self, trajectory: int = 0) -> np.ndarray:
        """``(T,)``."""
        return self._file["scalars/reward"][trajectory, : self.length(trajectory)].astype(np.float64)

    def material(self, trajectory: int = 0) -> Material:
        """The material of one trajectory."""
        self.length(trajectory)
        return Material(**{name: float(self._file[f"scalars/{name}"][trajectory]) for name in PROPERTIES})

    def state(self, frame: int, trajectory: int = 0) -> State:
        """One frame, a batch of one. Raises ValueError: no such frame or trajectory."""
        length = self.length(trajectory)
        if not 0 <= frame < length:
            raise ValueError(f"there is no frame {frame}: trajectory {trajectory} holds {length}, numbered from 0")
        bodies = np.zeros((1, 0, 2, 3), self._file[PATHS["positions"]].dtype)
        parts = {
            name: self._file[path][trajectory, frame : frame + 1] if path in self._file else bodies
            for name, path in PATHS.items()
        }
        for name in ("positions", "velocities"):
            parts[name] = np.ascontiguousarray(parts[name].transpose(0, 3, 1, 2))
        parts |= {name: parts[name].astype(np.float64) for name in ("wind", "pressure")}
        return State(**parts)

    def states(self, trajectory: int = 0) -> Iterator[State]:
        """The frames of one trajectory in order, each a batch of one."""
        for frame in range(self.length(trajectory)):
            yield self.state(frame, trajectory)

    def close(self) -> None:
        self._file.close()

    def __exit__(self, *error: object) -> None:
        self.close()
