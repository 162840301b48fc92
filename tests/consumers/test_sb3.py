"""Stable-Baselines3 learns on keypoints and on meshes, and steps environments in other processes.

Its checker runs on every scene in ``tests/test_env.py``.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from readme import run_line

import cloth_envs

sb3 = pytest.importorskip("stable_baselines3", reason="needs the extra 'rl'")
vec_env = pytest.importorskip("stable_baselines3.common.vec_env", reason="needs the extra 'rl'")

FLAG = cloth_envs.env_id("Flag")
SMALL = {"resolution": (13, 9)}
SHORT = {"n_steps": 64, "batch_size": 32, "n_epochs": 2, "seed": 0, "device": "cpu"}


@pytest.mark.parametrize(("obs", "policy"), [("keypoints", "MlpPolicy"), ("mesh", "MultiInputPolicy")])
def test_ppo_learns(obs: str, policy: str) -> None:
    model = sb3.PPO(policy, gym.make(FLAG, obs=obs, max_episode_steps=50, **SMALL), **SHORT)
    before = [weight.clone() for weight in model.policy.parameters()]
    model.learn(256)
    assert model.num_timesteps == 256
    assert all(weight.isfinite().all() for weight in model.policy.parameters())
    assert any((old != new).any() for old, new in zip(before, model.policy.parameters(), strict=True))
    episodes = model.ep_info_buffer
    assert [episode["l"] for episode in episodes] == [50] * 5
    assert all(0 < episode["r"] < 50 for episode in episodes)


def test_the_readmes_line() -> None:
    class Brief(sb3.PPO):  # type: ignore[misc,name-defined]
        def __init__(self, policy: str, env: gym.Env[Any, Any]) -> None:
            super().__init__(policy, env, **SHORT)

        def learn(self, total_timesteps: int) -> Any:
            assert total_timesteps == 20_000
            return super().learn(128)

    assert run_line("model", PPO=Brief, gym=gym).num_timesteps == 128


@pytest.mark.parametrize("start_method", ["spawn", "forkserver"])
def test_environments_in_other_processes_are_the_same(start_method: str) -> None:
    make = partial(gym.make, f"cloth_envs:{FLAG}", max_episode_steps=3, **SMALL)
    there, here = vec_env.SubprocVecEnv([make] * 2, start_method=start_method), vec_env.DummyVecEnv([make] * 2)
    try:
        for env in (there, here):
            env.seed(3)
        assert np.array_equal(there.reset(), here.reset())
        for _ in range(5):
            actions = np.full((2, 2), 0.3, np.float32)
            (seen, rewards, dones, infos), (seen_here, rewards_here, dones_here, infos_here) = (
                env.step(actions) for env in (there, here)
            )
            assert np.array_equal(seen, seen_here)
            assert np.array_equal(rewards.astype(np.float32), rewards_here)  # DummyVecEnv rounds them
            assert dones.tolist() == dones_here.tolist()
            for info, info_here in zip(infos, infos_here, strict=True):
                assert info.keys() == info_here.keys()
                assert np.array_equal(info.get("terminal_observation"), info_here.get("terminal_observation"))
    finally:
        there.close()


def test_its_wrappers_of_many_environments() -> None:
    many = vec_env.VecNormalize(vec_env.VecMonitor(vec_env.DummyVecEnv([partial(gym.make, FLAG, **SMALL)] * 2)))
    model = sb3.PPO("MlpPolicy", many, **{**SHORT, "n_steps": 16, "batch_size": 16}).learn(64)
    assert model.num_timesteps == 64
    assert np.isfinite(many.obs_rms.mean).all()
