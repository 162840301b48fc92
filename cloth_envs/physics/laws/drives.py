"""How driven things move through a frame."""

from __future__ import annotations

import numpy as np


def hermite(
    s: float, frame: float, x0: np.ndarray, v0: np.ndarray, x1: np.ndarray, v1: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity at ``s`` in [0, 1] of the cubic from ``x0, v0`` to ``x1, v1`` in ``frame`` [s]."""
    x = (1 + 2 * s) * (1 - s) ** 2 * x0 + s * s * (3 - 2 * s) * x1
    x = x + frame * s * (1 - s) * ((1 - s) * v0 - s * v1)
    v = 6 * s * (1 - s) * (x1 - x0) / frame + (1 - s) * (1 - 3 * s) * v0 + s * (3 * s - 2) * v1
    return x, v
