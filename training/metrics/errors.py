"""How far a cloth is from the truth. Positions are ``(..., 3, H, W)`` [m]; results keep the leading axes.

PSNR and VMSE follow Chen et al. 2020, ``largest`` Zhao 2024.
"""

from typing import NamedTuple

import numpy as np

PLACES = (-2, -1)  # the axes of the vertices


def distances(positions: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Distance of every vertex from the truth's, ``(..., H, W)`` [m].

    Raises:
        ValueError: different shapes.
    """
    if positions.shape != truth.shape:
        raise ValueError(f"positions have shape {positions.shape}, the truth {truth.shape}: resample one to the other")
    return np.sqrt((np.subtract(positions, truth, dtype=np.float64) ** 2).sum(-3))


class VertexError(NamedTuple):
    """Mean, 95th percentile and maximum over the vertices [% of the cloth's length]."""

    mean: np.ndarray
    p95: np.ndarray
    max: np.ndarray


def vertex_error(positions: np.ndarray, truth: np.ndarray, length: float) -> VertexError:
    """Statistics of ``distances`` in % of ``length``, the cloth's longer side [m]."""
    part = 100 / length * distances(positions, truth)
    return VertexError(part.mean(PLACES), np.percentile(part, 95, axis=PLACES), part.max(PLACES))


def relative_l2(positions: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """``|x - y| / |y - mean(y)|``: the truth is measured from its centroid, so the origin does not matter."""
    size = np.sqrt(((truth - truth.mean(PLACES, dtype=np.float64, keepdims=True)) ** 2).sum((-3, *PLACES)))
    return np.sqrt(vmse(positions, truth) * np.prod(truth.shape[-2:])) / size


def vmse(positions: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Mean squared vertex error, ``mean |x - y|^2`` [m^2]."""
    return (distances(positions, truth) ** 2).mean(PLACES)


def psnr(positions: np.ndarray, truth: np.ndarray, span: np.ndarray | float) -> np.ndarray:
    """``10 log10(1 / MSE)`` [dB] over vertices and axes of displacements that ``span`` takes to [0, 1].

    ``span`` [m], one number or ``(3,)``, is that of ``displacement_span``. Equal positions give infinity.

    Raises:
        ValueError: a span that is not positive.
    """
    width = np.broadcast_to(np.asarray(span, np.float64), (3,))
    if not (width > 0).all():
        raise ValueError(f"span must be positive along every axis, got {span}: take it over moving cloths")
    gap = np.subtract(positions, truth, dtype=np.float64) / width[:, None, None]
    with np.errstate(divide="ignore"):
        return -10 * np.log10((gap**2).mean((-3, *PLACES)))


def displacement_span(positions: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Largest less least displacement from ``rest`` ``(3, H, W)`` over all of ``positions``, ``(3,)`` [m]."""
    moved = np.moveaxis(positions - rest, -3, 0).reshape(3, -1)
    return np.ptp(moved, axis=1)


def largest(positions: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """``max |dx|`` over vertices and axes [m]."""
    return np.abs(np.subtract(positions, truth, dtype=np.float64)).max((-3, *PLACES))


def flicker(positions: np.ndarray, truth: np.ndarray, frame_dt: float) -> np.ndarray:
    """Error of the acceleration ``(x[t+1] - 2 x[t] + x[t-1]) / frame_dt^2`` [m/s^2], mean over vertices.

    ``positions`` are ``(T, ..., 3, H, W)``, frames first; the result is ``(T - 2, ...)``.

    Raises:
        ValueError: fewer than three frames.
    """
    if len(positions) < 3:
        raise ValueError(f"an acceleration needs three frames, got {len(positions)}")
    bend = np.diff(np.subtract(positions, truth, dtype=np.float64), 2, axis=0) / frame_dt**2
    return np.sqrt((bend**2).sum(-3)).mean(PLACES)
