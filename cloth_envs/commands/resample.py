"""A cloth on another grid: cubic interpolation along rows and columns."""

from __future__ import annotations

import numpy as np

from cloth_envs.grid import Grid


def cubic(old: int, new: int, *, periodic: bool = False) -> np.ndarray:
    """Weights ``(new, old)`` that resample ``old`` even samples at ``new`` even places of the same length.

    Keys' cubic convolution (1981, a = -1/2): exact for quadratics, third order, and equal to the sample at
    places that both share. Beyond an open end the samples are continued by a parabola (Keys' boundary
    condition, ``f[-1] = 3 f[0] - 3 f[1] + f[2]``).
    """
    cells = old if periodic else old - 1
    place = np.arange(new) * (cells / (new if periodic else new - 1))
    left = np.minimum(np.floor(place + 1e-9).astype(int), cells - 1)
    t = place - left
    kernel = 0.5 * np.stack([-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, -(t**2) + t**3], 1)
    weights = np.zeros((new, old + 2))  # one sample more at either end
    for offset in range(4):
        sample = (left + offset - 1) % old if periodic else left + offset - 1
        np.add.at(weights, (np.arange(new), sample + 1), kernel[:, offset])
    inner = weights[:, 1:-1]
    if not periodic:
        inner[:, :3] += weights[:, :1] * [3, -3, 1]
        inner[:, -3:] += weights[:, -1:] * [1, -3, 3]
    return inner


def resample(field: np.ndarray, source: Grid, target: Grid) -> np.ndarray:
    """``field`` ``(..., H, W)`` of ``source`` on the vertices of ``target``, float64 unless they are equal.

    A coarse grid whose spacing is a multiple just takes every n-th vertex.
    """
    if source.shape == target.shape:
        return field
    rows = cubic(source.rows, target.rows)
    cols = cubic(source.cols, target.cols, periodic=source.periodic)
    return np.einsum("rh,...hw,cw->...rc", rows, field, cols, optimize=True)
