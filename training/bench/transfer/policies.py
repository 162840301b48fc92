"""Small policies, ``tanh`` of a few weighted features of the default observation, trained by evolution: CMA-ES.

Features are about 1 in size and turn with the cloth where the scene does; zero weights are no action. ``weights`` are
``(B, n)``, a policy for every member of the batch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from cloth_envs.world import World
from training.rollouts import play

FIRST_SEED = 10_000  # of training; held-out seeds are below


def _act(weights: np.ndarray, *components: Sequence[np.ndarray]) -> np.ndarray:
    """Actions ``(B, A)``: of each component its features ``(B,)`` with the next of ``weights``."""
    ends = np.cumsum([len(features) for features in components])[:-1]
    parts = zip(np.split(weights, ends, 1), components, strict=True)
    return np.stack([np.tanh((mine * np.stack(features, 1)).sum(1)) for mine, features in parts], 1)


def _points(obs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities of the 20 keypoints, ``(B, 3, 20)``; an observation starts with them."""
    both = obs[:, :120].reshape(len(obs), 2, 3, 20)
    return both[:, 0], both[:, 1]


def curtain(obs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Along the rail by what is missing of the target, across it by where the lower curtain is and goes."""
    positions, velocities = _points(obs)
    rail, along, across, covered, target = obs[:, -5:].T
    sway, speed = positions[:, 1, 8:].mean(1) - rail, velocities[:, 1, 8:].mean(1)
    return _act(weights, [3 * (target - covered), 2 * along], [speed, 3 * sway, 3 * rail, across])


def flag(obs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Across and along the line of sight, by the pole, the fly's end and the wind in these directions."""
    pole, speed, wind, onlooker = np.split(obs[:, -8:], 4, 1)
    across = np.stack([-onlooker[:, 1], onlooker[:, 0]], 1)
    end, end_speed = (points.reshape(-1, 3, 4, 5)[:, :2, :, -1].mean(2) for points in _points(obs))
    parts = [pole / 1.5, speed / 2.5, (end - pole) / 1.5, end_speed / 2.5, wind / 4.0]
    moves = _act(weights, *([(part * line).sum(1) for part in parts] for line in (across, onlooker)))
    return moves[:, :1] * across + moves[:, 1:] * onlooker


def collision(obs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """By the way to the goal, the ball's velocity and, forwards, by how far the cloth is pressed."""
    ball, speed, goal = np.split(obs[:, -9:], 3, 1)
    pressed = 3 * (_points(obs)[0][:, 1, 4:].max(1) - goal[:, 1])
    x, y, z = zip((3 * (goal - ball)).T, speed.T, strict=True)
    return _act(weights, x, [*y, pressed, np.ones(len(obs))], z)


def pressure(obs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """By the target, its cube and rate, and the apex's velocity; its height would excite the drum."""
    _, velocity, _, target, soon = obs[:, -5:].T
    wanted = (target + soon) / 2 / 0.15
    return _act(weights, [wanted, wanted**3, soon - target, 0.1 * velocity])


def hanging(obs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Level by the way from the corner to the goal, the lag and the velocity of the middle; upright by the height."""
    corner, velocity, middle, swing, goal = np.split(obs[:, -16:-1], 5, 1)
    parts = [2 * (goal - corner), 2 * (middle - corner), swing, velocity]
    x, y = ([part[:, axis] for part in parts] for axis in (0, 1))
    both = np.concatenate([weights[:, :4], weights], 1)  # x and y share theirs
    return _act(both, x, y, [2 * (goal - middle)[:, 2], velocity[:, 2]])


def ball_drop(obs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """By the way to below the middle, its drift and the ball's velocity, each alone and while the cloth is high."""
    ball, speed, middle, drift = obs[:, -10:-8], obs[:, -8:-6], obs[:, -6:-3], obs[:, -3:-1]
    high = np.tanh((middle[:, 2] - 0.65) / 0.1)
    parts = [5 * (middle[:, :2] - ball), 3 * drift, speed]
    parts += [part * high[:, None] for part in parts[:2]]
    return _act(np.tile(weights, 2), *([part[:, axis] for part in parts] for axis in (0, 1)))


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


class CmaEs:
    """Covariance matrix adaptation with Hansen's default constants (2016, arXiv:1604.00772).

    Maximises: ``ask`` draws ``population`` points ``(population, n)``, ``tell`` takes their values. ``mean`` is the
    estimate; under noise it is a better one than the best point seen.
    """

    def __init__(self, size: int, *, population: int, sigma: float, seed: int) -> None:
        n, best = size, population // 2
        weights = np.log((population + 1) / 2) - np.log(np.arange(1, best + 1))
        self.weights = weights / weights.sum()
        self.mean, self.sigma, self.covariance = np.zeros(n), sigma, np.eye(n)
        self._rng, self._population = np.random.default_rng(seed), population
        self._path, self._step_path = np.zeros(n), np.zeros(n)
        self._mass = m = 1 / (self.weights**2).sum()
        self._cc = (4 + m / n) / (n + 4 + 2 * m / n)
        self._cs = (m + 2) / (n + m + 5)
        self._c1 = 2 / ((n + 1.3) ** 2 + m)
        self._cm = min(1 - self._c1, 2 * (m - 2 + 1 / m) / ((n + 2) ** 2 + m))
        self._damp = 1 + 2 * max(0.0, np.sqrt((m - 1) / (n + 1)) - 1) + self._cs
        self._length = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))  # of a normal vector
        self._generation = 0

    def ask(self) -> np.ndarray:
        values, self._axes = np.linalg.eigh(self.covariance)
        self._scales = np.sqrt(np.maximum(values, 1e-20))
        normal = self._rng.normal(size=(self._population, len(self.mean)))
        self._steps = (normal * self._scales) @ self._axes.T
        return self.mean + self.sigma * self._steps

    def tell(self, values: np.ndarray) -> None:
        self._generation += 1
        steps = self._steps[np.argsort(-values, kind="stable")[: len(self.weights)]]
        step = self.weights @ steps
        self.mean = self.mean + self.sigma * step
        cs, cc = self._cs, self._cc
        white = self._axes @ ((self._axes.T @ step) / self._scales)
        self._step_path = (1 - cs) * self._step_path + np.sqrt(cs * (2 - cs) * self._mass) * white
        size = np.linalg.norm(self._step_path)
        usual = np.sqrt(1 - (1 - cs) ** (2 * self._generation)) * (1.4 + 2 / (len(step) + 1)) * self._length
        moves = float(size < usual)  # stalled while the step size grows fast
        self._path = (1 - cc) * self._path + moves * np.sqrt(cc * (2 - cc) * self._mass) * step
        kept = 1 - self._c1 - self._cm + (1 - moves) * self._c1 * cc * (2 - cc)
        self.covariance = (
            kept * self.covariance
            + self._c1 * np.outer(self._path, self._path)
            + self._cm * (steps.T * self.weights) @ steps
        )
        self.sigma *= np.exp(min(1.0, cs / self._damp * (size / self._length - 1)))


def train(world: World, form: Form, *, frames: int, generations: int, population: int, seed: int) -> np.ndarray:
    """Weights of a policy after ``generations`` of ``population`` candidates that share the members of ``world``.

    All candidates of a generation play the same seeds, the next one plays others. Those and the candidates' noise
    follow from ``seed``, whatever the physics.
    """
    search, episodes = CmaEs(form.size, population=population, sigma=1.0, seed=seed), world.num_envs // population
    for generation in range(generations):
        each = np.repeat(search.ask(), episodes, 0)
        first = FIRST_SEED * (seed + 1) + generation * episodes
        seeds = list(range(first, first + episodes)) * population
        found, _ = play(world, lambda obs, each=each: form.act(obs, each), seeds, frames)  # type: ignore[misc]
        search.tell(found.reshape(population, episodes).mean(1))
    return search.mean
