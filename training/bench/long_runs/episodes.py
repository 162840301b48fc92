"""What is kept of whole episodes: what an agent observes and earns, and a few numbers of the cloth itself."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gymnasium.utils.seeding import np_random

from cloth_envs.physics.laws.diagnostics import strain
from cloth_envs.physics.laws.sheet import bend_energy, kinetic_energy
from cloth_envs.world import World
from training.metrics.spectra import in_space, in_time
from training.rollouts import nudge

TERMS = ("height", "bending", "kinetic", "strain")
EVERY = 5  # frames from one whose folds are looked at to the next
APART = 3  # vertices from one whose motion is looked at to the next: coarse ones and those between them


@dataclass(frozen=True)
class Episodes:
    """B episodes; all but the rewards are of the frames after the burn-in.

    Attributes:
        ended: which failed, ``(B,)``.
        rewards: of every frame, ``(T, B)``.
        observed: what an agent observes, ``(T', B, D)``.
        terms: mean height [m] and kinetic energy [J] of every frame; bending energy [J] and the 99th percentile of the
            structural edges' ``|strain|`` of every ``EVERY``-th, ``(T', B)``.
        space, time: spectra of ``metrics.spectra``, ``(BANDS, B)``.
    """

    ended: np.ndarray
    rewards: np.ndarray
    observed: np.ndarray
    terms: dict[str, np.ndarray]
    space: np.ndarray
    time: np.ndarray


def watch(world: World, actions: np.ndarray, seeds: Sequence[int], burn_in: int, *, nudged: bool = False) -> Episodes:
    """Play ``actions`` ``(T, B, A)``; ``nudged`` from starts that are off by ``rollouts.NUDGE``."""
    grid, sheets = world.scene.grid, world.materials
    share = grid.areas / grid.areas.sum()
    ended, rewards, observed, moves, space = np.zeros(len(seeds), bool), [], [], [], []
    terms: dict[str, list[np.ndarray]] = {name: [] for name in TERMS}
    world.reset({i: np_random(seed)[0] for i, seed in enumerate(seeds)})
    if nudged:
        start = nudge(world.state, world.scene, 0)
        for i in range(len(seeds)):
            world.set_positions(start.positions[i], start.velocities[i], i)
    for frame, action in enumerate(actions, 1):
        earned, reasons = world.step(action)
        ended |= [reason is not None for reason in reasons]
        rewards.append(earned)
        observation, x, v = world.observe(), world.state.positions, world.state.velocities
        if frame <= burn_in:
            continue
        observed.append(observation)
        moves.append(x[:, :, ::APART, ::APART].copy())
        terms["height"].append((x[:, 2] * share).sum((1, 2)))
        terms["kinetic"].append(kinetic_energy(grid, sheets, v))
        if frame % EVERY == 0:
            terms["bending"].append(bend_energy(grid, sheets, x))
            terms["strain"].append(strain(grid, x).p99)
            space.append(in_space(grid, x))
    return Episodes(
        ended, np.array(rewards), np.array(observed), {name: np.array(found) for name, found in terms.items()},
        np.mean(space, 0).T, in_time(np.array(moves), world.scene.frame_dt),
    )  # fmt: skip


def names(world: World) -> list[str]:
    """What the components of an observation are, ``"vz 7"`` the vertical velocity of keypoint 7."""
    axes = [f"{kind}{axis}" for kind in ("", "v") for axis in "xyz"]
    return [*(f"{axis} {i}" for axis in axes for i in range(len(world.task.keypoints))), *world.task.extras]
