"""Small policies, ``tanh`` of a few weighted features of the default observation, trained by evolution: CMA-ES.

Features are about 1 in size and turn with the cloth where the scene does; zero weights are no action. ``weights`` are
``(B, n)``, a policy for every member of the batch.
"""

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


def draping(obs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """As ``hanging``, without a breeze."""
    return hanging(np.column_stack([obs, np.zeros(len(obs))]), weights)


def hitting(obs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """By the way from the ball to the target, what the vertex misses of it, the ball's velocity and the side."""
    ball, speed, vertex, _, target = np.split(obs[:, -15:], 5, 1)
    side = np.sign(target[:, 1])
    x, y, z = zip((3 * (target - ball)).T, (3 * (target - vertex)).T, speed.T, strict=True)
    return _act(weights, x, [*y, side], z)


def skirt(obs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Turning by the target, what the hem misses of it and the present rate; rising by height and speed."""
    turning, height, rising, hem, target = obs[:, -5:].T
    missing, wide = 20 * (target - hem), 20 * (target - 0.2)
    return _act(weights, [missing, wide, turning / 6, np.ones(len(obs))], [5 * height, 2 * rising, missing])


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
    "Draping": Form(draping, 6),
    "Hitting": Form(hitting, 10),
    "Skirt": Form(skirt, 7),
}


def cma_es(
    score: Callable[[np.ndarray, int], np.ndarray], size: int, *, population: int, generations: int, seed: int
) -> np.ndarray:
    """Maximise ``score(points (population, size), generation)``, values ``(population,)``, from around zero.

    Covariance matrix adaptation with Hansen's default constants (2016, arXiv:1604.00772). Returns the distribution's
    mean: under noise a better estimate than the best point seen.
    """
    n, best, rng = size, population // 2, np.random.default_rng(seed)
    weights = np.log((population + 1) / 2) - np.log(np.arange(1, best + 1))
    weights /= weights.sum()
    mean, sigma, covariance = np.zeros(n), 1.0, np.eye(n)
    path, step_path = np.zeros(n), np.zeros(n)
    m = 1 / (weights**2).sum()
    cc = (4 + m / n) / (n + 4 + 2 * m / n)
    cs = (m + 2) / (n + m + 5)
    c1 = 2 / ((n + 1.3) ** 2 + m)
    cm = min(1 - c1, 2 * (m - 2 + 1 / m) / ((n + 2) ** 2 + m))
    damp = 1 + 2 * max(0.0, np.sqrt((m - 1) / (n + 1)) - 1) + cs
    length = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))  # of a normal vector
    for generation in range(generations):
        values, axes = np.linalg.eigh(covariance)
        scales = np.sqrt(np.maximum(values, 1e-20))
        drawn = (rng.normal(size=(population, n)) * scales) @ axes.T
        found = score(mean + sigma * drawn, generation)
        steps = drawn[np.argsort(-found, kind="stable")[:best]]
        step = weights @ steps
        mean = mean + sigma * step
        white = axes @ ((axes.T @ step) / scales)
        step_path = (1 - cs) * step_path + np.sqrt(cs * (2 - cs) * m) * white
        far = np.linalg.norm(step_path)
        usual = np.sqrt(1 - (1 - cs) ** (2 * (generation + 1))) * (1.4 + 2 / (n + 1)) * length
        moves = float(far < usual)  # stalled while the step size grows fast
        path = (1 - cc) * path + moves * np.sqrt(cc * (2 - cc) * m) * step
        kept = 1 - c1 - cm + (1 - moves) * c1 * cc * (2 - cc)
        covariance = kept * covariance + c1 * np.outer(path, path) + cm * (steps.T * weights) @ steps
        sigma *= np.exp(min(1.0, cs / damp * (far / length - 1)))
    return mean


def train(world: World, form: Form, *, frames: int, generations: int, population: int, seed: int) -> np.ndarray:
    """Weights of a policy after ``generations`` of ``population`` candidates that share the members of ``world``.

    All candidates of a generation play the same seeds, the next one plays others. Those and the candidates' noise
    follow from ``seed``, whatever the physics.
    """
    episodes = world.num_envs // population

    def score(points: np.ndarray, generation: int) -> np.ndarray:
        each, first = np.repeat(points, episodes, 0), FIRST_SEED * (seed + 1) + generation * episodes
        seeds = list(range(first, first + episodes)) * population
        found, _ = play(world, lambda obs: form.act(obs, each), seeds, frames)
        return found.reshape(population, episodes).mean(1)

    return cma_es(score, form.size, population=population, generations=generations, seed=seed)
