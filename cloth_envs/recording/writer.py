"""``RolloutWriter``: checks the frames of one scene and hands them to their file."""

import operator
import os
import sys
import weakref
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, NoReturn, SupportsIndex

import gymnasium as gym
import numpy as np

from cloth_envs.material import Material
from cloth_envs.recording.layout import CLOTH, PATHS
from cloth_envs.recording.spec import spec_texts
from cloth_envs.recording.trajectories import Start, Trajectories
from cloth_envs.scene import Scene
from cloth_envs.state import State


class RolloutWriter(AbstractContextManager["RolloutWriter"]):
    """Writes trajectories of one scene; use it as a context manager, or call ``close()``.

    What is forgotten is closed with the program; if its last frames can't be written then, stderr says so. Where the
    disk fails, the frames written before stay readable.

    Args:
        path: the file, usually ``*.h5``.
        source: an environment of this package, or a bare ``Scene``.
        actions: how many numbers an action has; taken from an environment.
        overwrite: replace an existing file, by ``close()``: until then it stays as it is, beside ``<path>.part``.
        steps: round positions and velocities to multiples of these [m], [m/s] and compress them, to keep much of it;
            powers of two are kept exactly. By default nothing is rounded.

    Raises:
        FileExistsError: the file exists and ``overwrite`` is false; it is untouched.
        OSError: the file can't be created there, or another program has it open.
        ValueError: an environment of another package, or steps that are not positive.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        source: gym.Env[Any, Any] | Scene,
        *,
        actions: int = 0,
        overwrite: bool = False,
        steps: tuple[float, float] | None = None,
    ) -> None:
        if steps is not None and not all(0 < step < np.inf for step in steps):
            raise ValueError(f"steps must be two positive numbers, got {steps!r}: leave them out to round nothing")
        self.path, about = Path(path), {"env_spec": ""}
        self.scene: Any = source if isinstance(source, Scene) else getattr(source.unwrapped, "scene", None)
        if not isinstance(self.scene, Scene):
            raise ValueError(f"{source} is no cloth environment: record one made by gym.make('MiniCloth-...')")
        if not isinstance(source, Scene):
            about = spec_texts(source)
            actions = int(np.prod(source.unwrapped.action_space.shape or ()))
        self._steps = dict(zip(CLOTH, steps, strict=True)) if steps else {}
        self._file = Trajectories(self.path, self.scene, actions, about, overwrite=overwrite, steps=steps)
        self._finish = weakref.finalize(self, _close_forgotten, self._file)
        self._begun = False
        self._next: dict[str, Any] | None = None  # a trajectory without frames so far

    def begin(
        self,
        seed: SupportsIndex | None = None,
        material: Material | None = None,
        start: Start | None = None,
        *,
        reset: bool = True,
    ) -> None:
        """Start the next trajectory, of ``material`` (default: the scene's), with the next frame.

        ``start`` is what ``env.unwrapped.get_state()`` gives there, for a replay; ``reset`` whether a reset began it.

        Raises:
            ValueError: a seed below 0, or the file is closed.
        """
        self._file.check_open()
        number = None if seed is None else operator.index(seed)
        if number is not None and number < 0:
            raise ValueError(f"a seed is a whole number of at least 0, got {number}")
        self._begun = True
        self._next = {"seed": number, "material": material or self.scene.material, "start": start, "reset": reset}

    def append(self, state: State, action: np.ndarray | None = None, reward: float = 0.0) -> None:
        """Add a frame (a copy is kept): ``state`` of a batch of one, the ``action`` that led to it and its ``reward``.

        Raises:
            RuntimeError: ``begin()`` has not been called.
            ValueError: a state of another size or finer dtype, or an action of the wrong length; nothing is added. Or
                the file is closed.
            OSError: the file can't be written; it is closed, and says what is kept.
        """
        self._file.check_open()
        if not self._begun:
            raise RuntimeError("call begin(seed) before the first append(state)")
        fields = self._file.lay_out(state.positions.dtype)
        arrays = state.arrays()
        parts = {path: arrays[name] for name, path in PATHS.items()}
        for name, paths in CLOTH.items():
            field = arrays[name]
            if name in self._steps:
                field = (np.round(field / self._steps[name]) * self._steps[name]).astype(field.dtype)
            parts |= {path: field[:, axis] for axis, path in enumerate(paths)}
        parts["scalars/reward"] = np.array([reward])
        if "actions" in fields:
            shape, _ = fields["actions"]
            parts["actions"] = np.zeros((1, *shape)) if action is None else np.asarray(action).reshape(1, -1)
        rows = {path: parts[path] for path in fields}
        for path, row in rows.items():
            shape, dtype = fields[path]
            if row.shape != (1, *shape):
                raise ValueError(
                    f"{path} of a frame has shape {row.shape}, this file needs {(1, *shape)}: one cloth of its scene"
                )
            if not np.can_cast(row.dtype, dtype):
                raise ValueError(
                    f"{path} of a frame is {row.dtype}, this file holds {dtype} since its first frame: record each "
                    "dtype to a file of its own"
                )
        if self._next is not None:
            self._file.begin(**self._next)
            self._next = None
        self._file.add({path: row[0] for path, row in rows.items()})

    def check_open(self) -> None:
        """Raises ValueError: the file is closed."""
        self._file.check_open()

    def close(self) -> None:
        """Write the last frames and close the file; calling it again does nothing.

        Raises:
            OSError: the file can't be written; says what is kept.
        """
        self._file.close()
        self._finish.detach()

    def __exit__(self, *error: object) -> None:
        self.close()

    def __reduce__(self) -> NoReturn:
        raise TypeError(f"what records to {self.path} can't be copied: copy the environment without its recorder")


def _close_forgotten(file: Trajectories) -> None:
    """Nobody is left to take an error: what it says goes to stderr."""
    try:
        file.close()
    except OSError as error:
        print(error, file=sys.stderr)
