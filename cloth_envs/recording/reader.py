"""``Rollout``: reads what ``RolloutWriter`` wrote."""

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager
from io import BytesIO
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cloth_envs.arguments import as_whole
from cloth_envs.material import PROPERTIES, Material
from cloth_envs.naming import counted
from cloth_envs.recording.checked import CheckedFile
from cloth_envs.recording.layout import CLOTH, LAYOUT_VERSION, PATHS, RESET, SEEDED, scene_from_json
from cloth_envs.scene import Scene
from cloth_envs.state import State
from cloth_envs.version import __version__

BLOCK = 32  # frames that are read at once


class Rollout(AbstractContextManager["Rollout"]):
    """A rollout file opened for reading: whole, left by a killed writer or being written; made by ``Rollout.open``.

    What is read raises ValueError where the file is damaged or has been closed.

    Attributes:
        scene: the ``Scene``, rebuilt from the file alone.
        attributes: the file's attributes; ``env_spec`` is JSON for ``gymnasium.envs.registration.EnvSpec.from_json``.
        lengths: whole frames of every trajectory, at the time of opening.
        seeds: of every trajectory, None where none was given.
        resets: whether a reset began the trajectory; otherwise something changed the state in the middle of an episode.
    """

    def __init__(self, file: CheckedFile) -> None:
        self._file = file
        self.attributes: dict[str, Any] = file.read(lambda inside: dict(inside.attrs))
        self._version = int(self.attributes["layout_version"])
        self.scene: Scene
        self.lengths: list[int]
        self.scene, self.lengths, self.seeds, self.resets = file.read(self._look)

    def _look(self, file: h5py.File) -> tuple[Scene, list[int], list[int | None], list[bool]]:
        lengths, seeds = file["frames"][:].tolist(), file["seeds"][:]
        if self._version < 3:
            handles = tuple(file["boundary_conditions/handles/vertices"][:].tolist())
            scene = scene_from_json(self.attributes["scene"], handles)
            return scene, lengths, [None if s < 0 else s for s in seeds.tolist()], [True] * len(lengths)
        began = file["began"][:].tolist()
        numbers = [int.from_bytes(words.astype("<u8").tobytes(), "little") for words in seeds]
        given = [n if how & SEEDED else None for n, how in zip(numbers, began, strict=True)]
        return scene_from_json(self.attributes["scene"]), lengths, given, [bool(how & RESET) for how in began]

    def __repr__(self) -> str:
        frames = ", ".join(map(str, self.lengths[:5])) + (", ..." if len(self.lengths) > 5 else "")
        trajectories = counted(len(self.lengths), "trajectory", "trajectories")
        unit = "frame" if self.lengths == [1] else "frames"
        return f"<Rollout {self.scene.name} {self.scene.grid}, {trajectories} of {frames or 0} {unit}>"

    def _repr_html_(self) -> str:
        """The last frame of the first trajectory that holds one."""
        from cloth_envs.rendering.notebook import card

        held = next((number for number, length in enumerate(self.lengths) if length), None)
        try:
            last = None if held is None else self.state(self.lengths[held] - 1, held)
        except ValueError:  # closed meanwhile
            last = None
        return card(repr(self), self.scene, last)

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> "Rollout":
        """Open a file that ``RolloutWriter`` made, or is still writing.

        Raises:
            FileNotFoundError: no such file.
            OSError: it can't be opened or read: no permission, too many open files, a disk that fails.
            ValueError: not HDF5, cut short or damaged, not a rollout, or written by a newer package.
        """
        if not os.path.isfile(path):
            raise FileNotFoundError(f"there is no file {path}: give the path of a rollout that RolloutWriter made")
        file = CheckedFile(Path(path))
        try:
            version = file.read(lambda inside: int(inside.attrs.get("layout_version", 0)))
            if version == 0:
                raise ValueError(f"{path} is HDF5 but no MiniCloth rollout: give a file that RolloutWriter made")
            if version > LAYOUT_VERSION:
                raise ValueError(
                    f"{path} has layout version {version}, MiniCloth {__version__} reads up to {LAYOUT_VERSION}: "
                    "read it with the version that wrote it, or a newer one"
                )
            return cls(file)
        except ValueError:
            file.close()
            raise

    def length(self, trajectory: int = 0) -> int:
        """Whole frames of one trajectory. Raises ValueError: no such trajectory."""
        number = as_whole(trajectory)
        if number is None or not 0 <= number < len(self.lengths):
            raise ValueError(
                f"there is no trajectory {trajectory!r}: the file holds {len(self.lengths)}, numbered from 0"
            )
        return self.lengths[number]

    def actions(self, trajectory: int = 0) -> np.ndarray:
        """``(T, A)``; entry t led to frame t."""
        length = self.length(trajectory)

        def look(file: h5py.File) -> np.ndarray:
            return file["actions"][trajectory, :length] if "actions" in file else np.zeros((length, 0))

        return self._file.read(look).astype(np.float64)

    def rewards(self, trajectory: int = 0) -> np.ndarray:
        """``(T,)``."""
        length = self.length(trajectory)
        return self._file.read(lambda file: file["scalars/reward"][trajectory, :length]).astype(np.float64)

    def material(self, trajectory: int = 0) -> Material:
        """The material of one trajectory."""
        self.length(trajectory)

        def look(file: h5py.File) -> Material:
            kept = [name for name in PROPERTIES if f"scalars/{name}" in file]
            values = {name: float(file[f"scalars/{name}"][trajectory]) for name in kept}
            return Material(**{"twist": 0.0} | values)  # nothing resisted twist before files kept it

        return self._file.read(look)

    def start(self, trajectory: int = 0) -> dict[str, np.ndarray]:
        """What ``env.unwrapped.set_state`` takes, so that the trajectory's actions give its frames again, bit for bit.

        Raises:
            ValueError: no such trajectory, or its writer was given no start (files of layouts 1 and 2 have none).
        """
        self.length(trajectory)

        def look(file: h5py.File) -> dict[str, np.ndarray]:
            place = f"starts/{trajectory}"
            if place not in file:
                return {}
            with np.load(BytesIO(file[place][:].tobytes())) as parts:
                return dict(parts)

        found = self._file.read(look)
        if not found:
            raise ValueError(
                f"{self._file.path} does not say where trajectory {trajectory} began: reset to its seed instead"
            )
        return found

    def state(self, frame: int, trajectory: int = 0) -> State:
        """One frame, a batch of one. Raises ValueError: no such frame or trajectory."""
        length = self.length(trajectory)
        number = as_whole(frame)
        if number is None or not 0 <= number < length:
            raise ValueError(f"there is no frame {frame!r}: trajectory {trajectory} holds {length}, numbered from 0")
        return self._frames(trajectory, number, number + 1)

    def states(self, trajectory: int = 0) -> Iterator[State]:
        """The frames of one trajectory in order, each a batch of one."""
        length = self.length(trajectory)
        for begin in range(0, length, BLOCK):
            block = self._frames(trajectory, begin, min(begin + BLOCK, length))
            for frame in range(block.batch):
                self._file.check_open()
                yield block.select([frame])

    def _frames(self, trajectory: int, begin: int, end: int) -> State:
        """Frames ``begin`` to ``end`` as a batch."""

        def look(file: h5py.File) -> State:
            def of(path: str) -> np.ndarray:
                return file[path][trajectory, begin:end]

            cloth = {}
            for name, paths in CLOTH.items():
                if self._version < 3:
                    cloth[name] = np.ascontiguousarray(of(f"t1_fields/{name}").transpose(0, 3, 1, 2))
                else:
                    cloth[name] = np.stack([of(path) for path in paths], 1)
            none = np.zeros((end - begin, 0, 2, 3), cloth["positions"].dtype)  # bodies
            rest = {name: of(path) if path in file else none for name, path in PATHS.items()}
            rest |= {name: rest[name].astype(np.float64) for name in ("wind", "pressure")}
            return State(**cloth, **rest)

        return self._file.read(look)

    def close(self) -> None:
        self._file.close()

    def __exit__(self, *error: object) -> None:
        self.close()
