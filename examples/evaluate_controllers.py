"""What doing nothing, random actions and the hand-written controllers earn: the table of docs/scenes.md."""

from __future__ import annotations

import argparse

import gymnasium as gym
import numpy as np

import cloth_envs
from cloth_envs.policies import CONTROLLERS


def evaluate(scene: str, policy: str, *, episodes: int, frames: int | None = None) -> np.ndarray:
    """Mean reward per frame of ``episodes`` seeds under ``"zero"``, ``"random"`` or ``"controller"``."""
    frames = frames or cloth_envs.EPISODE_FRAMES[scene]
    env = gym.make(cloth_envs.env_id(scene), disable_env_checker=True)
    returns = np.zeros(episodes)
    for seed in range(episodes):
        obs, _ = env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        for _ in range(frames):
            action = np.zeros(env.action_space.shape or ())
            if policy == "random":
                action = rng.uniform(-1, 1, action.shape)
            elif policy == "controller":
                action = np.clip(CONTROLLERS[scene](obs), -1, 1)
            obs, reward, terminated, truncated, _ = env.step(action)
            returns[seed] += float(reward) / frames
            if terminated or truncated:
                break
    env.close()
    return returns


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--frames", type=int, help="of an episode (default: the scene's)")
    parser.add_argument("scenes", nargs="*", default=list(CONTROLLERS))
    options = parser.parse_args()
    policies = ("zero", "random", "controller")
    print("| scene | " + " | ".join(policies) + " |\n|---|" + "---|" * len(policies))
    for scene in options.scenes or CONTROLLERS:
        cells = []
        for policy in policies:
            returns = evaluate(scene, policy, episodes=options.episodes, frames=options.frames)
            cells.append(f"{returns.mean():.2f} ± {returns.std(ddof=1) / len(returns) ** 0.5:.2f}")
        print(f"| {scene} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
