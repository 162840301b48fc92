"""Pairs of patches cut out of stored frames while a network learns; trajectories are split, never frames.

*Oracle* pairs take every window of the target, as Lee et al. 2019 did: their features are the target's own vertices,
``factor`` apart. *Real* pairs take the patches of the miniature's runs. *Triangles* are those of H-DNN, one level of
it: from the target at ``factor`` times its spacing to half of that.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.registry import load_task
from cloth_envs.resample import Resampler
from surrogates.miniature.coarse import coarse_grid
from surrogates.upscale.patches import FEATURES, Layout, combine, dense_grid, squares, triangles, windows
from training.cache import digest
from training.generate import HELD_OUT_EVERY, open_shard, shard_files

PAST = 2  # frames before the first one that is upscaled


@dataclass(frozen=True)
class Trajectory:
    """Of one shard: ``fine`` ``(T + 1, 3, H, W)`` and ``runs`` ``(windows, 3 + window, 3, h, w)`` positions [m]."""

    fine: np.ndarray
    runs: np.ndarray
    frame_dt: float
    mass: float
    spring: float


def shards(folder: Path, *, held_out: bool) -> list[Path]:
    """The shards to learn from, or those to test with: every fifth trajectory.

    Raises:
        ValueError: there are none.
    """
    last = HELD_OUT_EVERY - 1
    found = [path for path in shard_files(folder) if (int(path.stem) % HELD_OUT_EVERY == last) == held_out]
    if not found:
        raise ValueError(
            f"no trajectories to {'test with' if held_out else 'learn from'} in {folder}: "
            f"run `minicloth generate SCENE` for at least {HELD_OUT_EVERY} of them"
        )
    return found


def read(path: Path, factor: int) -> Trajectory:
    """One shard, with the miniature runs at ``factor``. Raises ValueError: it is damaged."""
    with open_shard(path) as file:
        own = (float(file.attrs[name]) for name in ("frame_dt", "mass", "spring"))
        return Trajectory(file["positions"][:], file[f"real/{factor}"][:], *own)


def data_hash(paths: Sequence[Path]) -> str:
    """Changes when a trajectory does. Raises ValueError: one is damaged."""
    known = []
    for path in paths:
        with open_shard(path) as file:
            known.append(str(file.attrs["sha256"]).encode())
    return digest(*known)


class Pairs:
    """Features (one of ``FEATURES``) and targets of all patches of some trajectories; ``inputs`` as above.

    Every position is kept once, frames one after the other with their vertices flat: ``_source``, where features come
    from, and ``_target``. ``_now`` and ``_then`` are the numbers that a frame has in the two.
    """

    def __init__(
        self, trajectories: Sequence[Trajectory], scene: str, factor: int, *, inputs: str, features: str = "frames"
    ) -> None:
        task = load_task(scene)
        fine = Grid(*task.resolution, *task.size)
        coarse, self.kind = coarse_grid(fine, factor), features
        dense = dense_grid(fine, coarse, factor)
        onto = None if dense.shape == fine.shape else Resampler(fine, dense)
        self.layout: Layout = {
            "oracle": lambda: windows(*dense.shape, factor),
            "real": lambda: squares(*coarse.shape, factor),
            "triangles": lambda: triangles(*coarse.shape),
        }[inputs]()
        sources, targets, now, then, dts = [], [], [], [], []
        at = base = 0
        for one in trajectories:
            target = one.fine if onto is None else onto(np.ascontiguousarray(one.fine, np.float32))
            runs = one.runs
            if inputs != "real":
                step = factor if inputs == "triangles" else 1
                level = target[:, :, ::step, ::step]
                runs = np.concatenate([np.repeat(level[:1], PAST, 0), level])[None]  # one that starts at rest
                target = target[:, :, :: max(step // 2, 1), :: max(step // 2, 1)]
            count, length = runs.shape[:2]
            now.append(at + np.add.outer(np.arange(count) * length, np.arange(PAST + 1, length)).ravel())
            then.append(base + 1 + np.arange(len(now[-1])))
            source, target = (
                np.ascontiguousarray(np.moveaxis(a, -3, -1), np.float32).reshape(-1, a.shape[-2] * a.shape[-1], 3)
                for a in (runs, target)
            )
            sources.append(source)
            targets.append(target)
            at, base = at + len(source), base + len(target)
            dts.append(np.full(len(now[-1]), one.frame_dt, np.float32))
        self._source, self._target = np.concatenate(sources), np.concatenate(targets)
        self._now, self._then, self._dt = np.concatenate(now), np.concatenate(then), np.concatenate(dts)

    def __len__(self) -> int:
        return len(self._now) * len(self.layout.corners)

    def draw(self, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
        """``count`` pairs at random: features ``(count, n)`` and targets ``(count, 3 p)`` [m], float32."""
        return self.pick(rng.integers(len(self), size=count))

    def pick(self, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The pairs of these numbers, below ``len(self)``."""
        frame, place = np.divmod(which, len(self.layout.corners))
        corners, points = self.layout.corners[place], self.layout.points[place]
        vertices, now = self._source.shape[1], self._now[frame][:, None]
        flat = self._source.reshape(-1, 3)
        past = reversed(range(FEATURES[self.kind][0]))
        frames = [flat.take((now - back) * vertices + corners, 0).reshape(len(which), -1) for back in past]
        goal = self._then[frame][:, None] * self._target.shape[1] + points
        y = self._target.reshape(-1, 3).take(goal, 0).reshape(len(which), -1)
        return combine(frames, self.kind, self._dt[frame][:, None]), y
