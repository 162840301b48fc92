"""Minari: episodes are recorded, read back, and their environment is recovered."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from readme import run_line

import cloth_envs

minari = pytest.importorskip("minari", reason="needs the extra 'test'")

FLAG = cloth_envs.env_id("Flag")
MADE = {"resolution": (13, 9), "randomize": {"areal_density": (0.1, 0.3)}, "max_episode_steps": 5}
ABOUT = {
    "algorithm_name": "random",
    "author": "MiniCloth developers",
    "author_email": "nobody@example.org",
    "code_permalink": "none",
    "description": "three short episodes",
}
pytestmark = [
    pytest.mark.filterwarnings("ignore:.*eval_env. is set to None"),  # it is the recorded one then
    pytest.mark.filterwarnings("ignore:Implicitly cleaning up:ResourceWarning"),  # Minari's temporary folders
]


@pytest.fixture(autouse=True)
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    yield
    gc.collect()  # its collectors go while the filter holds


def same(a: Any, b: Any) -> bool:
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[name], b[name]) for name in a)
    return np.array_equal(a, b)


def frame(observations: Any, i: int) -> Any:
    return {name: part[i] for name, part in observations.items()} if isinstance(observations, dict) else observations[i]


def collect(env: gym.Env[Any, Any], seeds: range) -> None:
    env.action_space.seed(0)
    for seed in seeds:
        env.reset(seed=seed)
        ended = False
        while not ended:
            _, _, terminated, truncated, _ = env.step(env.action_space.sample())
            ended = terminated or truncated


def replays(dataset: Any, seeds: range) -> None:
    """The recovered environment, reset with the same seeds, does what the data set holds."""
    with dataset.recover_environment() as env:
        for episode, seed in zip(dataset, seeds, strict=True):
            assert same(env.reset(seed=seed)[0], frame(episode.observations, 0))
            for i, action in enumerate(episode.actions):
                observation, reward, terminated, truncated, _ = env.step(action)
                assert same(observation, frame(episode.observations, i + 1))
                assert [reward, terminated, truncated] == [
                    episode.rewards[i],
                    episode.terminations[i],
                    episode.truncations[i],
                ]


@pytest.mark.parametrize("physics", ["reference", "miniature"])
@pytest.mark.parametrize("obs", ["keypoints", "mesh"])
def test_a_collected_data_set_recovers_its_environment(obs: str, physics: str) -> None:
    pytest.importorskip("jax", reason="needs minari[create] of the extra 'test'")
    env = minari.DataCollector(gym.make(FLAG, obs=obs, physics=physics, **MADE))
    collect(env, range(3))
    env.create_dataset("minicloth/flag-v0", **ABOUT)
    env.close()
    dataset = minari.load_dataset("minicloth/flag-v0")
    assert (dataset.total_episodes, dataset.total_steps) == (3, 15)
    assert dataset.env_spec.to_json() == gym.make(FLAG, obs=obs, physics=physics, **MADE).spec.to_json()
    replays(dataset, range(3))


def test_the_readmes_line() -> None:
    pytest.importorskip("jax", reason="needs minari[create] of the extra 'test'")
    env = run_line("record", DataCollector=minari.DataCollector, gym=gym)
    collect(env, range(1))
    env.create_dataset("minicloth/short-v0", **ABOUT)
    env.close()
    replays(minari.load_dataset("minicloth/short-v0"), range(1))


def test_a_data_set_from_buffers_recovers_its_environment() -> None:
    from minari.data_collector.episode_buffer import EpisodeBuffer

    env = gym.make(FLAG, **MADE)
    env.action_space.seed(1)
    buffers = []
    for seed in range(2):
        buffer = EpisodeBuffer(id=seed, seed=seed, observations=[env.reset(seed=seed)[0]], actions=[])
        for _ in range(5):
            buffer.actions.append(env.action_space.sample())
            observation, reward, terminated, truncated, _ = env.step(buffer.actions[-1])
            buffer.observations.append(observation)
            for kept, value in (
                (buffer.rewards, reward), (buffer.terminations, terminated), (buffer.truncations, truncated),
            ):  # fmt: skip
                kept.append(value)
        buffers.append(buffer)
    dataset = minari.create_dataset_from_buffers("minicloth/buffers-v0", buffers, env=env, **ABOUT)
    assert dataset.total_steps == 10
    replays(minari.load_dataset("minicloth/buffers-v0"), range(2))
