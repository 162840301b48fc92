"""Fine cloths as sums of a coarse one's vertices and of what a network says of its cells: the matrices of that."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import csr_array, kron

from cloth_envs.grid import Grid
from cloth_envs.resample import weights
from surrogates.upscale.local import Local
from surrogates.upscale.patches import squares


def interpolation(source: Grid, target: Grid, kind: str = "cubic") -> csr_array:
    """Weights of the vertices of ``source`` at those of ``target``, ``(H W, h w)``."""
    return csr_array(kron(*(csr_array(matrix) for matrix in weights(source, target, kind)), format="csr"))


def nodes(upscaling: Local) -> csr_array:
    """Weights of what all cells say of their nodes in the fine cloth, ``(H W, cells 9)``; shared vertices average."""
    grid = upscaling.coarse.grid
    points = squares(*grid.shape, 2).points.ravel()
    last = interpolation(upscaling.half or upscaling.fine.grid, upscaling.fine.grid)
    shares = 1.0 / np.bincount(points)[points]
    return csr_array(last @ csr_array((shares, (points, np.arange(points.size))), (last.shape[1], points.size)))


def base(upscaling: Any) -> csr_array:
    """Weights of the coarse vertices in the fine cloth, without a network's part, ``(H W, h w)``."""
    coarse, fine = upscaling.coarse.grid, upscaling.fine.grid
    if not isinstance(upscaling, Local):
        return interpolation(coarse, fine, upscaling.kind)
    half = upscaling.half or fine
    return csr_array(interpolation(half, fine) @ interpolation(coarse, half))


def entries(matrix: csr_array) -> tuple[np.ndarray, np.ndarray]:
    """Columns, int32, and weights, float32, ``(most of a row, K)``, of a sparse matrix ``(K, n)``; zeros fill up.

    The e-th entries of all rows follow each other, so that threads of neighbouring rows read neighbouring numbers.
    """
    counts = np.diff(matrix.indptr)
    number = np.arange(matrix.nnz) - np.repeat(matrix.indptr[:-1], counts)
    row = np.repeat(np.arange(matrix.shape[0]), counts)
    columns, values = np.zeros((2, max(counts, default=0), matrix.shape[0]))
    columns[number, row], values[number, row] = matrix.indices, matrix.data
    return columns.astype(np.int32), values.astype(np.float32)


def packed(layers: Sequence[np.ndarray]) -> np.ndarray:
    """Weights ``(out, in)`` one layer after the other, float32; rows are filled up to a multiple of four numbers."""
    rows = [np.pad(layer, ((0, 0), (0, -layer.shape[1] % 4))).ravel() for layer in layers]
    return np.concatenate([np.zeros(0), *rows]).astype(np.float32)
