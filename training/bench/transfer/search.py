"""Policies trained by evolution: CMA-ES."""

from __future__ import annotations

import numpy as np

from cloth_envs.world import World
from training.bench.transfer.policies import Form
from training.rollouts import play

FIRST_SEED = 10_000  # of training; held-out seeds are below


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
