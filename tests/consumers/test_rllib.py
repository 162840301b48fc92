"""RLlib learns from single and from batched environments. Slow, and it pins Gymnasium: ``.ci/rllib`` runs this."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from readme import run_line

os.environ["RAY_AUTH_MODE"] = "disabled"  # a cluster of this machine; otherwise Ray leaves a token in the home folder
ray = pytest.importorskip("ray", reason="needs the extra 'rllib', which has an environment of its own: .ci/rllib")
pytestmark = pytest.mark.filterwarnings("ignore")  # Ray's own, of its next versions

MADE = {"resolution": (13, 9), "max_episode_steps": 40}


@pytest.fixture(scope="module", autouse=True)
def cluster() -> Iterator[None]:
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    yield
    ray.shutdown()


def train(config: Any, mode: str, runners: int) -> list[dict[str, Any]]:
    """The results of the environments in three iterations of PPO."""
    algorithm = (
        config.env_runners(num_env_runners=runners, num_envs_per_env_runner=2, gym_env_vectorize_mode=mode)
        .training(train_batch_size=256, minibatch_size=64, num_epochs=2)
        .debugging(seed=0)
        .build_algo()
    )
    try:
        return [algorithm.train()["env_runners"] for _ in range(3)]
    finally:
        algorithm.stop()


def flag() -> Any:
    from ray.rllib.algorithms.ppo import PPOConfig

    return PPOConfig().environment("cloth_envs:MiniCloth-Flag-v0", env_config=MADE)


def check(results: list[dict[str, Any]]) -> None:
    assert [result["num_env_steps_sampled_lifetime"] for result in results] == [256, 512, 768]
    for result in results:
        assert 40 <= result["episode_len_mean"] < 41  # RLlib now and then counts the step that resets
        assert 0 < result["episode_return_mean"] < 40


def test_a_batch_trains_as_single_environments_do() -> None:
    one_by_one, batch = (train(flag(), mode, 0) for mode in ("sync", "vector_entry_point"))
    check(batch)
    for a, b in zip(one_by_one, batch, strict=True):
        for name in ("episode_return_mean", "episode_len_mean"):
            assert a[name] == b[name]


def test_runners_in_other_processes() -> None:
    check(train(flag(), "vector_entry_point", 1))


def test_the_readmes_line() -> None:
    from ray.rllib.algorithms.ppo import PPOConfig

    results = train(run_line("config", PPOConfig=PPOConfig), "vector_entry_point", 0)
    assert results[-1]["num_env_steps_sampled_lifetime"] == 768
    assert np.isfinite(results[1]["episode_return_mean"])
