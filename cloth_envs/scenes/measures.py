"""What rewards and observations are made of: batched, with sums in float64.

Fields are ``(B, 3, H, W)``, vertices int32 numbers into the flat grid; NumPy arrays, or tensors of one device.
"""

from math import log, sqrt

import numpy as np
from array_api_compat import array_namespace

from cloth_envs.scenes.compiled import compiled


@compiled  # 3 us a call, two in most rewards
def tolerance(error: np.ndarray, margin: float, least: float = 0.0, /) -> np.ndarray:
    """1 where the error is 0, falling as a Gaussian to 0.1 where it is ``margin``; squeezed over ``least``; ``(B,)``.

    The error is ``(B,)``, or ``(B, n)``, of which the length counts.
    """
    xp = array_namespace(error)
    squares = xp.square(xp.astype(error, xp.float64) / margin)
    return least + (1.0 - least) * xp.exp(log(0.1) * (squares if squares.ndim == 1 else squares.sum(1)))


def broad_tolerance(error: np.ndarray, far: float, near: float) -> np.ndarray:
    """Half ``tolerance`` with a margin that is felt from ``far``, half with one that is sharp, ``near``; ``(B,)``."""
    return 0.5 * (tolerance(error, far) + tolerance(error, near))


@compiled  # 3 us
def ramp(value: np.ndarray, full: float, /) -> np.ndarray:
    """0 where the value ``(B,)`` is 0 or less, 1 where it is ``full`` or more, and even between; ``(B,)``."""
    return (value / full).clip(0.0, 1.0)


def within(margin: float, earned: float = 0.9) -> float:
    """The error at which ``tolerance`` with this margin has fallen to what is ``earned``."""
    return margin * sqrt(log(earned) / log(0.1))


def change(now: np.ndarray, before: np.ndarray | float) -> np.ndarray:
    """Mean absolute change of the components of vectors ``(B, n)``, ``(B,)``."""
    return abs(now - before).sum(1) / now.shape[1]


def length(vector: np.ndarray) -> np.ndarray:
    """Lengths of vectors ``(B, n)``, ``(B,)``."""
    return (vector * vector).sum(1) ** 0.5


@compiled  # 3 us
def along(vector: np.ndarray, direction: np.ndarray, /) -> np.ndarray:
    """The part of vectors ``(B, 3)`` along a level ``direction`` ``(B, 2)`` of length 1, ``(B,)``."""
    return vector[:, 0] * direction[:, 0] + vector[:, 1] * direction[:, 1]


def points(field: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """The field at some vertices, ``(B, 3, N)`` float64."""
    xp = array_namespace(field)
    return xp.astype(field.reshape(len(field), 3, -1)[:, :, vertices], xp.float64)


@compiled  # 8 us a call
def mean_point(field: np.ndarray, vertices: np.ndarray, /) -> np.ndarray:
    """Mean of the field over some vertices, ``(B, 3)``."""
    return points(field, vertices).mean(2)


@compiled  # 9 us
def root_mean_square(field: np.ndarray, vertices: np.ndarray, first: int = 0, last: int = 3, /) -> np.ndarray:
    """Root of the mean over some vertices of the squared length of components ``first`` to ``last - 1``, ``(B,)``."""
    xp = array_namespace(field)
    return xp.sqrt(xp.square(points(field, vertices)[:, first:last]).sum(1).mean(1))


@compiled  # 11 us a call, two of them on the curtain
def mean_span(positions: np.ndarray, first: np.ndarray, second: np.ndarray, /) -> np.ndarray:
    """Mean of ``x[second] - x[first]`` over pairs of vertices, ``(B, 3)`` [m]."""
    return (points(positions, second) - points(positions, first)).mean(2)


@compiled  # 56 us
def loop_area(positions: np.ndarray, loop: np.ndarray, /) -> np.ndarray:
    """Area vector ``sum x_i x x_(i+1) / 2`` of a closed line through vertices, ``(B, 3)`` [m^2]."""
    xp, line = array_namespace(positions), points(positions, loop)
    return xp.linalg.cross(line, xp.roll(line, -1, axis=2), axis=1).sum(2) / 2


@compiled  # 10 us
def largest_stretch(positions: np.ndarray, first: np.ndarray, second: np.ndarray, rest: np.ndarray, /) -> np.ndarray:
    """Largest distance over ``rest`` ``(P,)`` [m] of pairs of vertices, ``(B,)``."""
    xp = array_namespace(positions)
    lengths = xp.linalg.vector_norm(points(positions, second) - points(positions, first), axis=1)
    return xp.max(lengths / rest, axis=1)


@compiled  # 3 us
def columns(*parts: np.ndarray) -> np.ndarray:
    """Numbers ``(B,)`` or ``(B, n)`` side by side, float32: what ``Task.observe`` returns."""
    xp = array_namespace(*parts)
    return xp.concat([xp.astype(part.reshape(len(part), -1), xp.float32) for part in parts], axis=1)


@compiled  # 11 us
def gather(
    positions: np.ndarray, velocities: np.ndarray, vertices: np.ndarray, extras: np.ndarray, bound: np.ndarray, /
) -> np.ndarray:
    """Positions, then velocities of some vertices, then ``extras`` ``(B, K)``; clipped, ``(B, 6 N + K)`` float32."""
    fields = [field.reshape(len(field), 3, -1)[:, :, vertices] for field in (positions, velocities)]
    return columns(*(field.reshape(len(field), -1) for field in fields), extras).clip(-bound, bound)
