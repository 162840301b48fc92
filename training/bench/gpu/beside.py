"""Whether a card does what the processor does: frames, failures, statistics, and long runs without NaN."""

from collections import Counter
from typing import Any

import numpy as np
import torch

from cloth_envs.failure import find
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.vector_env import ClothVectorEnv
from training.bench.gpu.measure import cores, name_of
from training.bench.gpu.rows import EqualRow, SoundRow

FRAMES, EPISODE = 5, 100


def _distances(a: np.ndarray, b: np.ndarray, length: float) -> tuple[float, float]:
    """Root of the mean square, and the largest, distance of vertices [% of length]."""
    squares = ((a.astype(float) - b) ** 2).sum(1)
    return 100 * float(np.sqrt(squares.mean())) / length, 100 * float(np.sqrt(squares.max())) / length


def equal(scene: str, device: str, members: int, *, seed: int, episode: int = EPISODE) -> EqualRow:
    """Frames of equal states by equal controls, then an episode by equal actions."""
    there: dict[str, Any] = {"backend": "cnn", "backend_kwargs": {"device": device}}
    card: Any = ClothVectorEnv(scene, num_envs=members, **there)
    here: Any = ClothVectorEnv(
        scene, num_envs=members, backend="cnn", self_contact=False, backend_kwargs={"threads": cores()}
    )
    exact = ExplicitSolver(here.world.scene, num_envs=members, dtype="float64", threads=cores())
    actions = np.random.default_rng(seed).uniform(-1, 1, (episode, *card.action_space.shape)).astype(np.float32)
    for env in (card, here):
        env.reset(seed=seed)
    exact.reset(here.world.state)
    found = (np.nan, np.nan, np.nan, np.nan)
    alike, height = True, here.world.scene.grid.height
    energies: list[list[np.ndarray]] = [[], []]
    for frame, action in enumerate(actions, 1):
        ended = [env.step(action)[2] for env in (card, here)]
        if frame <= FRAMES:
            alike &= bool((ended[0] == ended[1]).all())
            exact.advance(here.world.controls)
        if frame == FRAMES:
            x = here.state.positions
            found = (*_distances(card.state.positions, x, height), *_distances(x, exact.state.positions, height))
        for kept, env in zip(energies, (card, here), strict=True):
            kept.append(np.array([kinetic for *_, kinetic in find(env.world.scene.grid, env.state)]))
    own, true = (np.mean(kept, 0) for kept in energies)
    half = members // 2
    return EqualRow(
        scene, name_of(card.world.device), members, FRAMES, *found, alike, episode, float(own.mean() / true.mean()),
        float(true[:half].mean() / true[half:].mean()),
    )  # fmt: skip


def sound(scene: str, device: str, members: int, steps: int, *, seed: int) -> SoundRow:
    """At least ``steps`` of members by new random actions each step; what is observed must lie in its space."""
    world: Any = ClothVectorEnv(
        scene, num_envs=members, output="torch", autoreset_mode="NextStep", max_episode_steps=200, backend="cnn",
        backend_kwargs={"device": device},
    )  # fmt: skip
    world.reset(seed=seed)
    there = world.world.device
    generator = torch.Generator(there).manual_seed(seed)
    high = torch.as_tensor(world.single_observation_space.high, device=there)
    ended, wrong, frames = Counter[str](), torch.zeros((), dtype=torch.int64, device=there), -(-steps // members)
    for _ in range(frames):
        actions = 2 * torch.rand(world.action_space.shape, generator=generator, device=there) - 1
        observed, rewards, _, _, info = world.step(actions)
        fits = (observed.abs() <= high).all(1) & (rewards >= 0) & (rewards <= 1)
        wrong += (~fits).sum()
        ended.update(reason for reason in info.get("failure", ()) if reason)
    return SoundRow(
        scene, name_of(there), members, frames * members, ended["overstretch"], ended["energy"], ended["non-finite"],
        int(wrong),
    )  # fmt: skip
