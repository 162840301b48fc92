"""Small policies to train: ``tanh`` of a few weighted features of the default observation, one function a scene.

Features are about 1 in size and turn with the cloth where the scene does; zero weights are no action. ``weights`` are
``(B, n)``, a policy for every member of the batch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np


def _mix(weights: np.ndarray, *features: np.ndarray) -> np.ndarray:
    """One component of the action, ``(B,)``."""
    return np.tanh((weights * np.stack(features, 1)).sum(1))


def _points(obs: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities of the keypoints, ``(B, 3, count)``; an observation starts with them."""
    both = obs[:, : 6 * count].reshape(len(obs), 2, 3, count)
    return both[:, 0], both[:, 1]


def curtain(obs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Along the rail by what is missing of the target, across it by where the lower curtain is and goes."""
    positions, velocities = _points(obs, 20)
    rail, along, across, covered, target = obs[:, -5:].T
    sway, speed = positions[:, 1, 8:].mean(1) - rail, velocities[:, 1, 8:].mean(1)
    return np.stack(
        [
            _mix(weights[:, :2], 3 * (target - covered), 2 * along),
            _mix(weights[:, 2:], speed, 3 * sway, 3 * rail, across),
        ],
        1,
    )


def flag(obs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Across and along the line of sight, by the pole, the fly's end and the wind in these directions."""
    positions, velocities = _points(obs, 20)
    pole, speed, wind, onlooker = np.split(obs[:, -8:], 4, 1)
    across = np.stack([-onlooker[:, 1], onlooker[:, 0]], 1)
    end = positions.reshape(-1, 3, 4, 5)[:, :2, :, -1].mean(2) - pole
    end_speed = velocities.reshape(-1, 3, 4, 5)[:, :2, :, -1].mean(2)
    parts = [pole / 1.5, speed / 2.5, end / 1.5, end_speed / 2.5, wind / 4.0]
    moves = [
        _mix(w, *((part * line).sum(1) for part in parts))
        for w, line in ((weights[:, :5], across), (weights[:, 5:], onlooker))
    ]
    return moves[0][:, None] * across + moves[1][:, None] * onlooker


def collision(obs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """By the way to the goal, the ball's velocity and, forwards, by how far the cloth is pressed."""
    positions, _ = _points(obs, 20)
    ball, speed, goal = np.split(obs[:, -9:], 3, 1)
    away, pressed = 3 * (goal - ball), 3 * (positions[:, 1, 4:].max(1) - goal[:, 1])
    return np.stack(
        [
            _mix(weights[:, :2], away[:, 0], speed[:, 0]),
            _mix(weights[:, 2:6], away[:, 1], speed[:, 1], pressed, np.ones(len(obs))),
            _mix(weights[:, 6:], away[:, 2], speed[:, 2]),
        ],
        1,
    )


def pressure(obs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """By the target, its cube and rate, and the apex's velocity; its height would excite the drum."""
    _, velocity, _, target, soon = obs[:, -5:].T
    wanted = (target + soon) / 2 / 0.15
    return _mix(weights, wanted, wanted**3, soon - target, 0.1 * velocity)[:, None]


def hanging(obs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Level by the way from the corner to the goal, the lag and the velocity of the middle; upright by the height."""
    corner, velocity, middle, swing, goal = np.split(obs[:, -16:-1], 5, 1)
    parts = [2 * (goal - corner), 2 * (middle - corner), swing, velocity]
    level = [_mix(weights[:, :4], *(part[:, axis] for part in parts)) for axis in (0, 1)]
    return np.stack([*level, _mix(weights[:, 4:], 2 * (goal - middle)[:, 2], velocity[:, 2])], 1)


def ball_drop(obs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """By the way to below the middle, its drift and the ball's velocity, each alone and while the cloth is high."""
    ball, speed, middle, drift = obs[:, -10:-8], obs[:, -8:-6], obs[:, -6:-3], obs[:, -3:-1]
    high = np.tanh((middle[:, 2] - 0.65) / 0.1)
    parts = [5 * (middle[:, :2] - ball), 3 * drift, speed]
    parts += [part * high[:, None] for part in parts[:2]]
    return np.stack([_mix(weights, *(part[:, axis] for part in parts)) for axis in (0, 1)], 1)


class Form(NamedTuple):
    """A policy's function and how many weights it has."""

    act: Callable[[np.ndarray, np.ndarray], np.ndarray]
    size: int


FORMS: Mapping[str, Form] = {
    "Curtain": Form(curtain, 6),
    "Flag": Form(flag, 10),
    "Collision": Form(collision, 8),
    "Pressure": Form(pressure, 4),
    "Hanging": Form(hanging, 6),
    "BallDrop": Form(ball_drop, 5),
}
