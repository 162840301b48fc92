"""Folds and wrinkles: normals, curvature, bending energy, spectrum. Positions are ``(..., 3, H, W)`` [m]."""

import numpy as np
from scipy.fft import dctn

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.laws.sheet import bend_energy


def _step(x: np.ndarray, axis: int, periodic: bool) -> np.ndarray:
    """Next vertex less the one before; at open ends the vertex itself stands for the missing one."""
    if periodic:
        return np.roll(x, -1, axis) - np.roll(x, 1, axis)
    index = np.arange(x.shape[axis])
    return np.take(x, np.minimum(index + 1, index[-1]), axis) - np.take(x, np.maximum(index - 1, 0), axis)


def normals(grid: Grid, positions: np.ndarray) -> np.ndarray:
    """Unit vertex normals, ``(..., 3, H, W)``: the area-weighted mean of the triangles between the four neighbours.

    Their sum is ``(right - left) x (down - up)``, turned as those of ``grid.triangles``.
    """
    x = positions.astype(np.float64)
    normal = np.cross(_step(x, -2, False), _step(x, -1, grid.periodic), axis=-3)
    return normal / np.linalg.norm(normal, axis=-3, keepdims=True)


def normal_angle(grid: Grid, positions: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Mean angle between the vertex normals of both, ``(...)`` [degrees]."""
    n, m = normals(grid, positions), normals(grid, truth)
    # Exact at small angles too, where the arc cosine of the product is not.
    return np.degrees(2 * np.arctan2(*(np.linalg.norm(n + sign * m, axis=-3) for sign in (-1, 1)))).mean((-2, -1))


def mean_curvature(grid: Grid, positions: np.ndarray) -> np.ndarray:
    """``(x_uu + x_vv) . n / 2`` at the inner vertices, ``(..., H - 2, W')`` [1/m].

    ``u`` and ``v`` are lengths on the sheet at rest, so this is the mean curvature of a sheet that hardly stretches.
    """
    x, cols = positions.astype(np.float64), slice(None) if grid.periodic else slice(1, -1)
    along = (np.roll(x, -1, -1) - 2 * x + np.roll(x, 1, -1)) / grid.col_spacing**2
    down = np.diff(x, 2, axis=-2) / grid.row_spacing**2
    bend = along[..., 1:-1, cols] + down[..., cols]
    return (bend * normals(grid, x)[..., 1:-1, cols]).sum(-3) / 2


def curvature_distance(grid: Grid, positions: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Distance of the two histograms of mean curvature, ``(...)`` [1/m]: how far curvature must be moved, on average.

    The Wasserstein distance; for samples of equal number the mean distance of the sorted ones, without bins.
    """
    a, b = (np.sort(mean_curvature(grid, x).reshape(*x.shape[:-3], -1)) for x in (positions, truth))
    return np.abs(a - b).mean(-1)


def bending_ratio(grid: Grid, positions: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Bending energy over the truth's, ``(...)``: below 1 too smooth, above too wrinkled; NaN where that is flat."""
    found, true = (
        bend_energy(grid, [Material()] * int(np.prod(x.shape[:-3])), x.reshape(-1, *x.shape[-3:]))
        for x in (positions, truth)
    )
    ratio = np.divide(found, true, out=np.full_like(found, np.nan), where=true > 0)
    return ratio.reshape(positions.shape[:-3])


def fine_detail(grid: Grid, positions: np.ndarray, factor: float) -> np.ndarray:
    """Root-mean-square of the out-of-plane displacement that is too fine for a grid ``factor`` times coarser, [m].

    Of the cosine transform of the displacement from the best plane, the modes with more half waves along rows or
    columns than the coarse grid has cells (its Nyquist wave).

    Raises:
        ValueError: a tube, which is out of every plane.
    """
    if grid.periodic:
        raise ValueError("fine_detail needs an open sheet: a tube is out of every plane")
    x = positions.astype(np.float64)
    x = x - x.mean((-2, -1), keepdims=True)
    flat = x.reshape(*x.shape[:-2], -1)
    across = np.linalg.eigh(flat @ np.swapaxes(flat, -1, -2))[1][..., 0]  # the direction of least spread
    modes = dctn(np.einsum("...a,...ahw->...hw", across, x), axes=(-2, -1), norm="ortho")
    row, col = (int(cells / factor + 1e-9) for cells in grid.cells)
    modes[..., : row + 1, : col + 1] = 0.0
    return np.sqrt((modes**2).mean((-2, -1)))


def detail_ratio(grid: Grid, positions: np.ndarray, truth: np.ndarray, factor: float) -> np.ndarray:
    """``fine_detail`` over the truth's, ``(...)``; NaN where the truth has none, and of a tube."""
    if grid.periodic:
        return np.full(positions.shape[:-3], np.nan)
    found, true = (fine_detail(grid, x, factor) for x in (positions, truth))
    return np.divide(found, true, out=np.full_like(found, np.nan), where=true > 0)
