"""The open file of a ``RolloutWriter``: takes whole frames, and puts them onto the disk chunk by chunk."""

import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cloth_envs.files import cannot_write, final_path
from cloth_envs.locks import lock
from cloth_envs.material import PROPERTIES, Material
from cloth_envs.recording.image import Image
from cloth_envs.recording.layout import CLOTH, PATHS, RESET, SEEDED, lay_out
from cloth_envs.scene import Scene

CHUNK_BYTES = 2**19  # of positions or of velocities
MOST_FRAMES = 32  # in a chunk: what a killed writer can lose
Field = tuple[tuple[int, ...], np.dtype]  # shape and dtype
Start = Mapping[str, np.ndarray]  # what ``get_state`` gives


class Trajectories:
    """Written under the name ``path``, or to ``<path>.part`` where ``path`` is to be replaced in the end.

    Raises:
        FileExistsError: the file exists and ``overwrite`` is false.
        OSError: it can't be written, or another program has it open; it stays as it is.
    """

    def __init__(
        self,
        path: Path,
        scene: Scene,
        actions: int,
        about: Mapping[str, str],
        *,
        overwrite: bool,
        steps: tuple[float, float] | None = None,
    ) -> None:
        self.path, self._scene, self._actions, self._about, self._steps = path, scene, actions, about, steps
        if os.path.isfile(path) and not overwrite:
            raise FileExistsError(f"{path} exists and stays as it is: choose another name or pass overwrite=True")
        self._target = final_path(path)
        self._place = self._target.with_name(self._target.name + ".part") if self._target.exists() else self._target
        try:
            if self._place != self._target:
                with self._target.open("rb") as old:
                    lock(old)
            self._image = Image(self._place)
        except OSError as error:
            raise cannot_write(path, error) from error
        self._stored = self._kept = 0  # frames that HDF5 has, and those that are on the disk
        self._frames: dict[str, h5py.Dataset] = {}  # a value a frame
        self._columns: dict[str, h5py.Dataset] = {}  # a value a trajectory
        self.fields: dict[str, Field] = {}
        self._rows: dict[str, list[np.ndarray]] = {}
        self._trajectory, self._written = -1, 0
        self._file: h5py.File | None = None
        self.open = True

    def check_open(self) -> None:
        """Raises ValueError: the file is closed."""
        if not self.open:
            raise ValueError(f"{self.path} is closed: make a new recorder, with a file of its own, to record more")

    def lay_out(self, dtype: np.dtype) -> dict[str, Field]:
        """What a frame has, by path; made for a cloth of ``dtype`` when first asked for."""
        if self._file is None:
            vertex = 3 * dtype.itemsize
            self._chunk = int(np.clip(CHUNK_BYTES // (vertex * self._scene.grid.vertices), 1, MOST_FRAMES))
            with h5py.File(self._image, "w", libver=("v108", "v108")):
                pass  # a superblock that does not mark a file as open, so that any reader takes what a writer left
            self._file = file = h5py.File(self._image, "r+", libver="latest")
            own: dict[str, Any] = {"actions": self._actions, "about": self._about, "steps": self._steps}
            lay_out(file, self._scene, dtype=dtype, chunk=self._chunk, **own)
            paths = (*CLOTH["positions"], *CLOTH["velocities"], *PATHS.values(), "actions", "scalars/reward")
            self._frames = {path: file[path] for path in paths if path in file}
            columns = (*(f"scalars/{name}" for name in PROPERTIES), "seeds", "began", "frames")
            self._columns = {path: file[path] for path in columns}
            self.fields = {path: (dataset.shape[2:], dataset.dtype) for path, dataset in self._frames.items()}
            self._image.counter = file["commits"].id.get_offset()
        return self.fields

    def begin(self, seed: int | None, material: Material, start: Start | None, *, reset: bool) -> None:
        """Count a trajectory without frames, after ``lay_out``. Raises OSError: it can't be written."""
        with self._disk() as file:
            self._store()
            self._add_trajectory(file, seed, material, start, reset)
            self._commit(file)

    def _add_trajectory(
        self, file: h5py.File, seed: int | None, material: Material, start: Start | None, reset: bool
    ) -> None:
        self._trajectory, self._written = self._trajectory + 1, 0
        count = self._trajectory + 1
        values: dict[str, Any] = {f"scalars/{name}": getattr(material, name) for name in PROPERTIES}
        values |= {"frames": 0, "began": RESET * reset + SEEDED * (seed is not None)}
        for path, value in values.items():
            self._columns[path].resize((count,))
            self._columns[path][-1] = value
        words, seeds = _words(seed or 0), self._columns["seeds"]
        seeds.resize((count, max(len(words), seeds.shape[1])))
        seeds[-1, : len(words)] = words
        for dataset in self._frames.values():
            dataset.resize((count, *dataset.shape[1:]))
        if start is not None:
            packed = BytesIO()
            np.savez(packed, **start)  # type: ignore[arg-type]
            data = np.frombuffer(packed.getvalue(), np.uint8)
            place = f"starts/{self._trajectory}"
            file.create_dataset(place, data=data, chunks=data.shape, fletcher32=True).attrs["units"] = "1"
        file.attrs.modify("n_trajectories", count)

    def add(self, rows: Mapping[str, np.ndarray]) -> None:
        """Keep a copy of one frame's ``rows`` by path; a full chunk goes to the disk. Raises OSError: it can't."""
        for path, row in rows.items():
            self._rows.setdefault(path, []).append(np.array(row))
        if len(self._rows["scalars/reward"]) >= self._chunk:
            with self._disk() as file:
                self._store()
                self._commit(file)

    def _store(self) -> None:
        """Hand to HDF5 what has been gathered."""
        if not self._rows:
            return
        begin, end = self._written, self._written + len(self._rows["scalars/reward"])
        for path, dataset in self._frames.items():
            dataset.resize((dataset.shape[0], max(dataset.shape[1], end), *dataset.shape[2:]))
            dataset[self._trajectory, begin:end] = np.stack(self._rows[path])
        self._columns["frames"][self._trajectory] = end
        self._stored += end - begin
        self._rows, self._written = {}, end

    def _commit(self, file: h5py.File) -> None:
        file.flush()
        self._image.commit()
        self._kept = self._stored

    @contextmanager
    def _disk(self) -> Iterator[h5py.File]:
        """The file, which is given up when the disk fails. Raises OSError: says what is kept."""
        try:
            yield self._file
        except (OSError, RuntimeError, KeyError) as error:
            cause = self._image.failed or error  # HDF5 tells what it made of it
            if not isinstance(cause, OSError):
                raise
            raise self._give_up(cause) from error

    def close(self) -> None:
        """Write the last frames and close the file, once; a fork of the writer's process leaves it alone.

        Raises:
            OSError: it can't be written; says what is kept.
        """
        if not self.open or not self._image.mine:
            return
        self.lay_out(np.dtype(np.float32))
        with self._disk() as file:
            self._store()
            file.close()
            self._image.finish()
            if self._place != self._target:
                shutil.copymode(self._target, self._place)
                self._place.replace(self._target)
            self._image.close()
        self.open = False

    def _give_up(self, error: OSError) -> OSError:
        """Close without another word, remove a file that holds nothing. Returns what to raise."""
        self.open = False
        there = False
        with suppress(OSError):
            there = self._image.there
        with suppress(OSError, RuntimeError, KeyError):
            if self._file is not None:
                self._file.close()
        with suppress(OSError):
            self._image.close()
        beside = self._place != self._target
        kept = f"{self.path} is as it was" if beside and self.path.exists() else ""
        if not (there and self._image.mine):
            pass  # of another process, or gone
        elif self._kept or (self._image.commits and not beside):
            kept = f"{self._place} keeps the {self._kept} frames flushed before" + (kept and f", {kept}")
        else:
            with suppress(OSError):
                self._place.unlink()
        return cannot_write(self.path, error, kept)


def _words(number: int) -> np.ndarray:
    """A whole number that is not negative, in words of 64 bits, the lowest first."""
    length = max(1, -(-number.bit_length() // 64))
    return np.frombuffer(number.to_bytes(8 * length, "little"), "<u8")
