"""Patches of the coarse cloth and of the fine one: cut out, put together again, and how well neighbours agree.

Lee, Oh & Lee 2019: the four corners of a 2 x 2 patch of the miniature, in up to three frames, are the features of a
network, the ``(s+1) x (s+1)`` vertices that they span in the target are its outputs. Patches share their borders, so
inner vertices of the target are inferred twice (on an edge) or four times (at a corner); they are averaged. Oh et al.
2018 have triangles instead, of three vertices and the midpoints of their three edges.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from cloth_envs.grid import Grid
from cloth_envs.resample import linear

# Feature sets of table 3: how many frames each reads, and how many numbers it makes of each vertex.
FEATURES = {"positions": (1, 3), "velocities": (2, 6), "frames": (3, 9)}


@dataclass(frozen=True)
class Layout:
    """Patches of two grids with flat vertices.

    Attributes:
        corners: vertices of the source that a patch is made from, ``(P, c)``.
        points: vertices of the target that it gives, ``(P, p)``.
        weights: linear interpolation from corners to points, ``(p, c)``.
        vertices: of the target.
    """

    corners: np.ndarray
    points: np.ndarray
    weights: np.ndarray
    vertices: int

    @cached_property
    def _average(self) -> csr_array:
        count = np.bincount(self.points.ravel(), minlength=self.vertices)
        shares = (1.0 / count[self.points]).astype(np.float32).ravel()
        place = self.points.ravel(), np.arange(self.points.size)
        return csr_array((shares, place), (self.vertices, self.points.size))

    def cut(self, field: np.ndarray) -> np.ndarray:
        """The corners in fields ``(B, 3, h, w)``: ``(B P, 3 c)``, corner by corner."""
        flat = np.ascontiguousarray(field.reshape(*field.shape[:2], -1).transpose(0, 2, 1))
        return flat.take(self.corners, 1).reshape(len(field) * len(self.corners), -1)

    def merge(self, patches: np.ndarray) -> np.ndarray:
        """What ``patches`` ``(B P, 3 p)`` say of each vertex, averaged, ``(B, 3, vertices)``; 0 if they do not."""
        each = patches.reshape(-1, self.points.size, 3)
        merged = np.empty((len(each), 3, self.vertices), patches.dtype)
        for out, one in zip(merged, each, strict=True):
            out[:] = (self._average @ one).T
        return merged

    def seam(self, patches: np.ndarray) -> float:
        """Mean distance [m] of what ``patches`` ``(B P, 3 p)`` say from the average, at vertices that several give."""
        mean = self.merge(patches).transpose(0, 2, 1)[:, self.points.ravel()]
        gap = np.linalg.norm(patches.reshape(mean.shape).astype(np.float64) - mean, axis=-1)
        several = np.bincount(self.points.ravel())[self.points.ravel()] > 1
        return float(gap[:, several].mean())


def squares(rows: int, cols: int, factor: int) -> Layout:
    """From each 2 x 2 patch of a coarse grid ``(rows, cols)`` to the ``(factor+1)^2`` vertices that it spans."""
    wide = factor * (cols - 1) + 1
    corners = np.add.outer(_block(rows - 1, cols - 1, cols), _block(2, 2, cols))
    points = np.add.outer(factor * _block(rows - 1, cols - 1, wide), _block(factor + 1, factor + 1, wide))
    return Layout(corners, points, _bilinear(factor), (factor * (rows - 1) + 1) * wide)


def windows(rows: int, cols: int, factor: int) -> Layout:
    """All windows of ``(factor+1)^2`` vertices of one grid, and their own four corners."""
    points = np.add.outer(_block(rows - factor, cols - factor, cols), _block(factor + 1, factor + 1, cols))
    ends = [0, factor, factor * (factor + 1), (factor + 1) ** 2 - 1]
    return Layout(points[:, ends], points, _bilinear(factor), rows * cols)


def triangles(rows: int, cols: int) -> Layout:
    """From the two triangles of each coarse cell to the midpoints of their edges, on the grid twice as fine.

    The second triangle of a cell is the first one turned by half a turn; both have their right angle second.
    """
    wide = 2 * cols - 1
    at = np.indices((rows - 1, cols - 1)).reshape(2, -1).T[:, None]  # (cells, 1, 2)
    first = np.array([[0, 0], [0, 1], [1, 1]])
    both = np.concatenate([at + first, at + 1 - first])  # (2 cells, 3, 2)
    mid = both + np.roll(both, -1, 1)  # rows and columns of the fine grid
    half = np.array([[0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [0.5, 0.0, 0.5]])
    return Layout(both @ [cols, 1], mid @ [wide, 1], half, (2 * rows - 1) * wide)


def _block(rows: int, cols: int, wide: int) -> np.ndarray:
    """The first ``rows`` and ``cols`` of vertices of a grid of ``wide`` columns."""
    return np.add.outer(np.arange(rows) * wide, np.arange(cols)).ravel()


def _bilinear(factor: int) -> np.ndarray:
    return np.kron(linear(2, factor + 1), linear(2, factor + 1))


def dense_grid(fine: Grid, coarse: Grid, factor: int) -> Grid:
    """The grid that merged patches have: ``factor`` cells for each of ``coarse``; mostly that is ``fine``."""
    return replace(fine, rows=factor * (coarse.rows - 1) + 1, cols=factor * (coarse.cols - 1) + 1)


def combine(frames: Sequence[np.ndarray], kind: str, dt: float | np.ndarray) -> np.ndarray:
    """The features of one of ``FEATURES`` from corners ``(N, 3 c)`` in the last frames, the newest last.

    The newest positions come last. Velocities are differences over ``dt`` [s], as P-ADMM has them.
    """
    if kind == "velocities":
        speed = (frames[-1] - frames[-2]) / np.asarray(dt, np.float32)
        return np.concatenate([speed, frames[-1]], -1)
    return np.concatenate(frames[-FEATURES[kind][0] :], -1)
