"""TorchRL: its checks, and rollouts of its wrappers against our own environments."""

from __future__ import annotations

import multiprocessing
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from readme import run_line

import cloth_envs

SMALL = {"resolution": (13, 9)}
FLAG = cloth_envs.env_id("Flag")


@pytest.fixture(scope="module")
def envs() -> Any:
    """``torchrl.envs``; importing it makes "spawn" the start method of the whole process, which is taken back."""
    before = multiprocessing.get_start_method(allow_none=True)
    found = pytest.importorskip("torchrl.envs", reason="needs the extra 'test'")
    multiprocessing.set_start_method(before, force=True)
    return found


@pytest.mark.parametrize("obs", ["keypoints", "mesh"])
@pytest.mark.parametrize("scene", list(cloth_envs.EPISODE_FRAMES))
def test_specs_of_single_environments(envs: Any, scene: str, obs: str) -> None:
    envs.check_env_specs(envs.GymWrapper(gym.make(cloth_envs.env_id(scene), obs=obs, **SMALL)))


def replay(env: Any, actions: Any) -> tuple[np.ndarray, np.ndarray]:
    """Observations before each action, and rewards, ``(..., T, K)`` and ``(..., T)``.

    ``env`` is reset as TorchRL does: once more after the seed, and where all members have ended, in both modes.
    """
    env.reset(seed=0)
    observation, _ = env.reset()
    seen, rewards = [], []
    for action in actions.unbind(-2):
        seen.append(observation)
        observation, reward, terminated, truncated, _ = env.step(action.numpy())
        rewards.append(reward)
        if np.all(terminated | truncated):
            observation, _ = env.reset()
    return np.stack(seen, -2), np.stack(rewards, -1).astype(np.float32)


@pytest.mark.parametrize("mode", ["SameStep", "Disabled"])
def test_a_batch_is_ours(envs: Any, mode: str) -> None:
    made = {"num_envs": 3, "max_episode_steps": 4, "autoreset_mode": mode, **SMALL}
    batch = envs.GymWrapper(gym.make_vec(FLAG, **made))
    envs.check_env_specs(batch)
    batch.set_seed(0)
    trace = batch.rollout(10, break_when_any_done=False)
    assert trace["next", "truncated"].squeeze(-1).sum(-1).tolist() == [2, 2, 2]
    seen, rewards = replay(gym.make_vec(FLAG, **made), trace["action"])
    assert np.array_equal(trace["observation"].numpy(), seen)
    assert np.array_equal(trace["next", "reward"].squeeze(-1).numpy(), rewards)


@pytest.mark.parametrize("mode", ["SameStep", "Disabled"])
def test_specs_of_a_batch_of_meshes(envs: Any, mode: str) -> None:
    envs.check_env_specs(envs.GymWrapper(gym.make_vec(FLAG, num_envs=2, obs="mesh", autoreset_mode=mode, **SMALL)))


def test_the_readmes_environments(envs: Any) -> None:
    env = run_line("env", GymEnv=envs.GymEnv)
    envs.check_env_specs(env)
    env.set_seed(0)
    trace = env.rollout(5)
    seen, rewards = replay(gym.make(FLAG, backend="miniature"), trace["action"])
    assert np.array_equal(trace["observation"].numpy(), seen)
    assert np.array_equal(trace["next", "reward"].squeeze(-1).numpy(), rewards)

    many = run_line("many", GymWrapper=envs.GymWrapper, gym=gym)
    assert many.rollout(2)["next", "reward"].shape == (8, 2, 1)


def test_frames_are_skipped_and_pixels_drawn(envs: Any) -> None:
    """GymEnv tries keywords that an environment may lack, and goes by the TypeError that it gets."""
    pytest.importorskip("pyvista", reason="needs the extra 'render'")
    env = envs.GymEnv(FLAG, physics="miniature", frame_skip=2, from_pixels=True, pixels_only=False, **SMALL)
    trace = env.rollout(2)
    assert env._env.unwrapped.time == pytest.approx(4 * 0.04)
    assert trace["pixels"].shape == (2, 480, 640, 3)
    env.close()
