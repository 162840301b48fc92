"""What scenes start from: lines that are bowed at rest length."""

import numpy as np


def bow(cells: int, ratio: float) -> np.ndarray:
    """A bowed line of ``cells`` unit edges whose ends are ``ratio * cells`` apart, ``(2, cells + 1)``.

    Along and across the straight line between the ends. The slope angle is a half cosine wave, so the
    mean of its cosine is ``ratio`` (J0 of the largest angle, for many cells); every edge has length 1.
    """
    wave = np.cos(np.pi * (np.arange(cells) + 0.5) / cells)
    steepest = np.linspace(0.0, 2.2, 221)
    shortened = np.cos(steepest[:, None] * wave).mean(1)
    slope = np.interp(-ratio, -shortened, steepest) * wave
    path = np.zeros((2, cells + 1))
    np.cumsum([np.cos(slope), np.sin(slope)], axis=1, out=path[:, 1:])
    return path
