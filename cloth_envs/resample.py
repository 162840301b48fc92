"""A cloth on another grid: interpolation along rows and columns, by one small matrix each."""

import _minicloth_kernels as kernels
import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.state import State


def linear(old: int, new: int, *, periodic: bool = False) -> np.ndarray:
    """Weights ``(new, old)`` of piecewise linear interpolation."""
    left, t = _places(old, new, periodic)
    weights = np.zeros((new, old))
    weights[np.arange(new), left] = 1 - t
    weights[np.arange(new), (left + 1) % old] += t
    return weights


def quadratic(old: int, new: int, *, periodic: bool = False) -> np.ndarray:
    """Weights ``(new, old)`` of the parabola through the three samples around the nearest one (third order)."""
    left, t = _places(old, new, periodic)
    middle = left + (t > 0.5)
    if not periodic:
        middle = np.clip(middle, 1, old - 2)
    t = left + t - middle
    weights = np.zeros((new, old))
    for offset, value in ((-1, t * (t - 1) / 2), (0, 1 - t * t), (1, t * (t + 1) / 2)):
        weights[np.arange(new), (middle + offset) % old] += value
    return weights


def cubic(old: int, new: int, *, periodic: bool = False) -> np.ndarray:
    """Weights ``(new, old)`` that resample ``old`` even samples at ``new`` even places of the same length.

    Keys' cubic convolution (1981, a = -1/2): exact for quadratics, third order, and equal to the sample at
    places that both share. Beyond an open end the samples are continued by a parabola (Keys' boundary
    condition, ``f[-1] = 3 f[0] - 3 f[1] + f[2]``).
    """
    left, t = _places(old, new, periodic)
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


def _places(old: int, new: int, periodic: bool) -> tuple[np.ndarray, np.ndarray]:
    """The sample left of every new place, and how far on it lies in spacings; exactly 0 or 1 at samples."""
    steps, cells = (new, old) if periodic else (new - 1, old - 1)
    left, rest = np.divmod(np.arange(new) * cells, steps)
    on_last = left == cells if not periodic else np.zeros(new, bool)
    return np.where(on_last, cells - 1, left), np.where(on_last, 1.0, rest / steps)


KINDS = {"linear": linear, "quadratic": quadratic, "cubic": cubic}


def weights(source: Grid, target: Grid, kind: str = "cubic") -> tuple[np.ndarray, np.ndarray]:
    """Matrices for rows ``(H', H)`` and columns ``(W', W)`` that take fields of ``source`` to ``target``."""
    interpolate = KINDS[kind]
    columns = interpolate(source.cols, target.cols, periodic=source.periodic)
    return interpolate(source.rows, target.rows), columns


def means(fine: Grid, coarse: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Matrices for rows ``(h, H)`` and columns ``(w, W)`` that take fields of ``fine`` to local means at ``coarse``.

    Weighted by area and by the hats that interpolate linearly between coarse vertices, so that spreading by these hats
    what acts on the means acts on the cloth as a potential would.
    """
    edge = np.array([0.5, *np.ones(fine.rows - 2), 0.5]), np.ones(fine.cols)
    if not fine.periodic:
        edge[1][[0, -1]] = 0.5
    rows, columns = (hats.T * share for hats, share in zip(weights(coarse, fine, "linear"), edge, strict=True))
    return rows / rows.sum(1, keepdims=True), columns / columns.sum(1, keepdims=True)


class Resampler:
    """The compiled way of float32 fields ``(B, K, H, W)`` from ``source`` to ``target``; exact at shared vertices.

    Attributes:
        kernel: what does it, for other kernels that go on with it.
    """

    def __init__(self, source: Grid, target: Grid, kind: str = "cubic") -> None:
        self._shape = target.shape
        taps = [taps for matrix in weights(source, target, kind) for taps in _taps(matrix)]
        self.kernel = kernels.Resample(*source.shape, *taps)

    def __call__(self, field: np.ndarray) -> np.ndarray:
        """``field`` on the target's vertices, ``(B, K, H', W')``."""
        out = np.empty((*field.shape[:2], *self._shape), np.float32)
        self.kernel(field, out)
        return out


def _taps(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Old places and their weights for every new one, ``(taps, new)`` each, padded by weights of 0 nearby."""
    count = int((matrix != 0).sum(1).max())
    away = abs(np.arange(matrix.shape[1]) - abs(matrix).argmax(1)[:, None])
    index = np.sort(np.argsort(np.where(matrix != 0, -1, away), axis=1, kind="stable")[:, :count], axis=1)
    weight = np.take_along_axis(matrix, index, 1)
    return np.ascontiguousarray(index.T, np.int32), np.ascontiguousarray(weight.T, np.float32)


def resample(field: np.ndarray, source: Grid, target: Grid) -> np.ndarray:
    """``field`` ``(..., H, W)`` of ``source`` on the vertices of ``target``, float64 unless they are equal.

    A coarse grid whose spacing is a multiple just takes every n-th vertex.
    """
    if source.shape == target.shape:
        return field
    rows, cols = weights(source, target)
    return np.einsum("rh,...hw,cw->...rc", rows, field, cols, optimize=True)


def on_grid(state: State, source: Grid, target: Grid) -> State:
    """``state``, its cloth of ``source`` on the vertices of ``target``."""
    cloth = {n: np.ascontiguousarray(resample(getattr(state, n), source, target)) for n in ("positions", "velocities")}
    return State(**(state.arrays() | cloth))
