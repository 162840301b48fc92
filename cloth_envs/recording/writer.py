"""``RolloutWriter``: gathers frames and writes them chunk by chunk; ``RecordRollout``: those of an environment."""

import os
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import gymnasium as gym
import h5py
import numpy as np

from cloth_envs.files import cannot_write
from cloth_envs.material import PROPERTIES, Material
from cloth_envs.recording.layout import PATHS, lay_out
from cloth_envs.scene import Scene
from cloth_envs.state import State

CHUNK_BYTES = 2**19  # of one field
MOST_FRAMES = 32  # in a chunk: what a killed writer can lose


class RolloutWriter(AbstractContextManager["RolloutWriter"]):
    """Writes trajectories of one scene; use it as a context manager, or call ``close()``.

    Args:
        path: the file, usually ``*.h5``.
        source: an environment of this package, or a bare ``Scene``.
        actions: how many numbers an action has; taken from an environment.
        overwrite: replace an existing file.

    Raises:
        FileExistsError: the file exists and ``overwrite`` is false; it is untouched.
        OSError: the file can't be created there.
        ValueError: an environment of another package.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        source: gym.Env[Any, Any] | Scene,
        *,
        actions: int = 0,
        overwrite: bool = False,
    ) -> None:
        self.path = Path(path)
        self._actions, self._spec = actions, ""
        self.scene: Any = source if isinstance(source, Scene) else getattr(source.unwrapped, "scene", None)
        if not isinstance(self.scene, Scene):
            raise ValueError(f"{source} is no cloth environment: record one made by gym.make('MiniCloth-...')")
        if not isinstance(source, Scene):
            self._spec = "" if source.spec is None else source.spec.to_json()
            self._actions = int(np.prod(source.action_space.shape or ()))
        if self.path.exists() and not overwrite:
            raise FileExistsError(f"{self.path} exists and stays as it is: choose another name or pass overwrite=True")
        try:
            self._file = h5py.File(self.path, "w", libver="latest")
        except OSError as error:
            raise cannot_write(self.path, error) from error
        self._frames: dict[str, h5py.Dataset] = {}
        self._rows: dict[str, list[np.ndarray]] = {}
        self._next: tuple[int, Material] | None = None  # seed and material of a trajectory without frames so far
        self._trajectory, self._written = -1, 0

    def begin(self, seed: int | None = None, material: Material | None = None) -> None:
        """Start the next trajectory, of ``material`` (default: the scene's), with the next frame."""
        self._write()
        self._next = (-1 if seed is None else seed, material or self.scene.material)

    def _lay_out(self, dtype: np.dtype) -> None:
        """Make the datasets of a cloth of ``dtype``; from here on a reader may look in."""
        vertex = 3 * dtype.itemsize
        self._chunk = int(np.clip(CHUNK_BYTES // (vertex * self.scene.grid.vertices), 1, MOST_FRAMES))
        lay_out(self._file, self.scene, dtype=dtype, chunk=self._chunk, actions=self._actions, env_spec=self._spec)
        self._frames = {p: self._file[p] for p in (*PATHS.values(), "actions", "scalars/reward") if p in self._file}
        self._file.swmr_mode = True

    def _add_trajectory(self, seed: int, material: Material) -> None:
        self._trajectory += 1
        self._written = 0
        count = self._trajectory + 1
        values = {f"scalars/{name}": getattr(material, name) for name in PROPERTIES} | {"seeds": seed, "frames": 0}
        for path, value in values.items():
            self._file[path].resize((count,))
            self._file[path][-1] = value
        for dataset in self._frames.values():
            dataset.resize((count, *dataset.shape[1:]))
        self._file.attrs.modify("n_trajectories", count)
        self._file.flush()

    def append(self, state: State, action: np.ndarray | None = None, reward: float = 0.0) -> None:
        """Add a frame (a copy is kept): ``state`` of a batch of one, the ``action`` that led to it and its ``reward``.

        Raises:
            RuntimeError: ``begin()`` has not been called.
            ValueError: a state of another size or finer dtype, or an action of the wrong length; nothing is added.
        """
        if self._trajectory < 0 and self._next is None:
            raise RuntimeError("call begin(seed) before the first append(state)")
        if not self._frames:
            self._lay_out(state.positions.dtype)
        parts = {PATHS[name]: value for name, value in state.arrays().items()}
        for path in ("t1_fields/positions", "t1_fields/velocities"):
            parts[path] = parts[path].transpose(0, 2, 3, 1)
        parts["scalars/reward"] = np.array([reward])
        if "actions" in self._frames:
            length = self._frames["actions"].shape[2]
            parts["actions"] = np.zeros((1, length)) if action is None else np.asarray(action).reshape(1, -1)
        rows = {path: parts[path] for path in self._frames}
        for path, row in rows.items():
            expected = (1, *self._frames[path].shape[2:])
            if row.shape != expected:
                raise ValueError(
                    f"{path} of a frame has shape {row.shape}, this file needs {expected}: one cloth of its scene"
                )
            if not np.can_cast(row.dtype, self._frames[path].dtype):
                raise ValueError(
                    f"{path} of a frame is {row.dtype}, this file holds {self._frames[path].dtype} since its first "
                    "frame: record each dtype to a file of its own"
                )
        if self._next is not None:
            self._add_trajectory(*self._next)
            self._next = None
        for path, row in rows.items():
            self._rows.setdefault(path, []).append(np.array(row[0]))
        if len(self._rows["scalars/reward"]) >= self._chunk:
            self._write()

    def _write(self) -> None:
        """Write what has been gathered, then count it."""
        if not self._rows:
            return
        begin, end = self._written, self._written + len(self._rows["scalars/reward"])
        for path, dataset in self._frames.items():
            dataset.resize((dataset.shape[0], max(dataset.shape[1], end), *dataset.shape[2:]))
            dataset[self._trajectory, begin:end] = np.stack(self._rows[path])
        self._file.flush()
        self._file["frames"][self._trajectory] = end
        self._file.flush()
        self._rows, self._written = {}, end

    def close(self) -> None:
        """Write the last frames and close the file; calling it again does nothing."""
        if self._file:
            if not self._frames:
                self._lay_out(np.dtype(np.float32))
            self._write()
            self._file.close()

    def __exit__(self, *error: object) -> None:
        self.close()


class RecordRollout(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Records every episode of a single environment to ``path``; see ``RolloutWriter``.

    Example: ``env = RecordRollout(gym.make("MiniCloth-Flag-v0"), "flag.h5")``.
    """

    def __init__(self, env: gym.Env[Any, Any], path: str, *, overwrite: bool = False) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, path=str(path), overwrite=overwrite)
        super().__init__(env)
        self.writer = RolloutWriter(path, env, overwrite=overwrite)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        result = self.env.reset(seed=seed, options=options)
        cloth: Any = self.env.unwrapped
        values = cloth.get_state()["materials"][0].tolist()
        self.writer.begin(seed, Material(**dict(zip(PROPERTIES, values, strict=True))))
        self.writer.append(cloth.state)
        return result

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        result = self.env.step(action)
        cloth: Any = self.env.unwrapped
        self.writer.append(cloth.state, action, float(result[1]))
        return result

    def close(self) -> None:
        self.writer.close()
        self.env.close()
