"""How far a surrogate's rewards are from the reference's, measured in one vector environment.

Half of the members have one backend, half the other; equal seeds and equal actions make pairs of them.
"""

from __future__ import annotations

import argparse
from typing import Any

import gymnasium as gym
import numpy as np

import cloth_envs
from cloth_envs.backend import parse_backend

HELD = 5  # frames for which a random action is held


def gaps(scene: str, backend: str, options: dict[str, Any], *, pairs: int, frames: int) -> np.ndarray:
    """Rewards of ``backend`` less the reference's, ``(frames, pairs)``; NaN from where one of a pair failed."""
    env = gym.make_vec(
        cloth_envs.env_id(scene),
        num_envs=2 * pairs,
        backend=[backend] * pairs + ["reference"] * pairs,
        backend_kwargs=[options] * pairs + [{}] * pairs,
        max_episode_steps=-1,
    )
    env.reset(seed=[*range(pairs)] * 2)
    rng, failed, found = np.random.default_rng(0), np.zeros(pairs, bool), np.zeros((frames, pairs))
    for frame in range(frames):
        if frame % HELD == 0:
            actions = rng.uniform(-1, 1, (pairs, *(env.single_action_space.shape or ())))
        _, rewards, terminated, *_ = env.step(np.concatenate([actions, actions]).astype(np.float32))
        surrogate, reference = rewards.reshape(2, pairs)
        failed |= terminated.reshape(2, pairs).any(0)
        found[frame] = np.where(failed, np.nan, surrogate - reference)
    env.close()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--backend", default='miniature={"factor": 4}', metavar="NAME[=JSON]")
    parser.add_argument("--pairs", type=int, default=8)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("scenes", nargs="*", default=["Flag"])
    options = parser.parse_args()
    for scene in options.scenes:
        found = gaps(scene, *parse_backend(options.backend), pairs=options.pairs, frames=options.frames)
        means = np.nanmean(found, 0)  # of each pair
        error = means.std(ddof=1) / len(means) ** 0.5
        print(
            f"{scene}: {options.backend} pays {means.mean():+.4f} ± {error:.4f} more a frame than the reference; "
            f"a single frame's reward is off by {np.nanmean(abs(found)):.4f}"
        )


if __name__ == "__main__":
    main()
