"""Spectra: how fine the folds of a cloth are, and how fast it moves. They compare statistics, whatever the frame."""

import numpy as np
from scipy.fft import dct, rfft
from scipy.signal import welch

from cloth_envs.grid import Grid

BANDS = 16  # of equal width up to the Nyquist limit, in space and in time


def in_space(grid: Grid, positions: np.ndarray) -> np.ndarray:
    """Power of the curvature along rows by fineness, ``(..., BANDS)`` [1/m^2] of ``(..., 3, H, W)``.

    The cosine transform (of a tube Fourier's) of the second differences, which a stretch or a turn of the whole sheet
    leaves alone. A band is the mean of modes within ``1 / BANDS`` of the Nyquist limit, where neighbours alternate.

    Raises:
        ValueError: fewer columns than every band has a mode of.
    """
    if grid.cols < 2 * BANDS:
        raise ValueError(f"a spectrum in space needs {2 * BANDS} columns, the grid has {grid.cols}")
    x = positions.astype(np.float64)
    if grid.periodic:
        bend = np.roll(x, -1, -1) - 2 * x + np.roll(x, 1, -1)
        modes = np.abs(rfft(bend, axis=-1, norm="ortho"))[..., 1:]  # around a tube the curvature's mean is none
        fineness = np.arange(1, modes.shape[-1] + 1) / (grid.cols / 2)
    else:
        modes = dct(np.diff(x, 2, axis=-1), axis=-1, norm="ortho")
        fineness = np.arange(modes.shape[-1]) / modes.shape[-1]
    power = ((modes / grid.col_spacing**2) ** 2).sum(-3).mean(-2)
    band = np.maximum(np.ceil(fineness * BANDS).astype(int) - 1, 0)
    return np.stack([power[..., band == i].mean(-1) for i in range(BANDS)], -1)


def in_time(positions: np.ndarray, frame_dt: float) -> np.ndarray:
    """Power of the vertices' velocities by frequency, ``(BANDS, B)`` [m^2/s^2/Hz] of ``(T, B, 3, ...)``.

    Velocities are differences of frames, so that flicker counts; the periodogram is averaged over stretches (Welch
    1967). Band ``i`` of ``BANDS`` is about ``(i + 1) / BANDS`` of half a frame's rate.

    Raises:
        ValueError: fewer frames than a stretch has.
    """
    if len(positions) <= 2 * BANDS:
        raise ValueError(f"a spectrum in time needs more than {2 * BANDS} frames, got {len(positions)}")
    speed = np.diff(positions.astype(np.float64), axis=0) / frame_dt
    power = welch(speed, 1 / frame_dt, nperseg=2 * BANDS, axis=0)[1][1:]
    return power.reshape(*power.shape[:3], -1).mean(-1).sum(-1)


def apart(power: np.ndarray, truth: np.ndarray) -> float:
    """Root-mean-square over bands of the ratio of two spectra [dB] (log-spectral distance, Gray & Markel 1976)."""
    return float(np.sqrt(((10 * np.log10(power / truth)) ** 2).mean()))
