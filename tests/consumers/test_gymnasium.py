"""Gymnasium's wrappers of vectors, and its own vector environments in other processes.

Its checker and the wrappers of single environments are in ``tests/test_env.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_match import check_environments_match
from gymnasium.wrappers import vector as wrappers

import cloth_envs

FLAG = cloth_envs.env_id("Flag")
SMALL = {"resolution": (13, 9)}
WRAPPERS: list[Callable[[Any], Any]] = [
    wrappers.ClipAction,
    lambda env: wrappers.ClipReward(env, 0.0, 0.5),
    wrappers.DictInfoToList,
    wrappers.FlattenObservation,
    wrappers.NormalizeReward,
    wrappers.RecordEpisodeStatistics,
    lambda env: wrappers.RescaleAction(env, np.float32(-2), np.float32(2)),
]
CASES = [
    *((make, obs) for make in WRAPPERS for obs in ("keypoints", "mesh")),
    (wrappers.NormalizeObservation, "keypoints"),  # of arrays only
    (lambda env: wrappers.FilterObservation(env, ["mesh"]), "mesh"),  # of dicts only
]


@pytest.mark.parametrize(("wrapper", "obs"), CASES)
def test_wrappers_of_vectors(wrapper: Callable[[Any], Any], obs: str) -> None:
    env = wrapper(gym.make_vec(FLAG, num_envs=3, obs=obs, max_episode_steps=3, **SMALL))
    observation, _ = env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(5):
        assert env.observation_space.contains(observation)
        observation, rewards, *_ = env.step(env.action_space.sample())
        assert np.isfinite(rewards).all()
    env.close()


def test_statistics_of_episodes_are_those_of_single_environments() -> None:
    many = wrappers.RecordEpisodeStatistics(gym.make_vec(FLAG, num_envs=2, max_episode_steps=4, **SMALL))
    ones = [gym.make(FLAG, max_episode_steps=4, **SMALL) for _ in range(2)]
    many.reset(seed=5)
    for i, env in enumerate(ones):
        env.reset(seed=5 + i)
    actions = np.full((2, 2), 0.7, np.float32)
    returns = np.zeros(2)
    for _ in range(4):
        *_, infos = many.step(actions)
        returns += [env.step(action)[1] for env, action in zip(ones, actions, strict=True)]
    assert infos["episode"]["r"].tolist() == returns.tolist()
    assert infos["episode"]["l"].tolist() == [4, 4]


@pytest.mark.parametrize("start_method", ["spawn", "forkserver"])
def test_environments_in_other_processes_are_our_vector(start_method: str) -> None:
    there = gym.vector.AsyncVectorEnv([partial(gym.make, f"cloth_envs:{FLAG}", **SMALL)] * 2, context=start_method)
    here = gym.make_vec(FLAG, num_envs=2, **SMALL)
    try:
        assert np.array_equal(there.reset(seed=2)[0], here.reset(seed=2)[0])
        actions = np.full((2, 2), 0.4, np.float32)
        for _ in range(3):
            for a, b in zip(there.step(actions)[:4], here.step(actions)[:4], strict=True):
                assert np.array_equal(a, b)
    finally:
        there.close()


def test_physics_is_another_word_for_backend() -> None:
    options = {"factor": 4}
    check_environments_match(
        gym.make(FLAG, backend="miniature", backend_kwargs=options, **SMALL),
        gym.make(FLAG, physics="miniature", physics_kwargs=options, **SMALL),
        num_steps=5,
        seed=0,
    )
    many = gym.make_vec(FLAG, num_envs=2, backend="miniature", physics="miniature", physics_kwargs=options, **SMALL)
    assert many.unwrapped.world.backend.factor == 4


@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
def test_two_words_that_differ_are_refused(make: Callable[..., Any]) -> None:
    with pytest.raises(ValueError, match="physics= is another word for backend=: give one of 'cnn' and 'miniature'"):
        make(FLAG, backend="cnn", physics="miniature")
    with pytest.raises(ValueError, match="physics_kwargs= is another word for backend_kwargs="):
        make(FLAG, backend_kwargs={"solver": "admm"}, physics_kwargs={"solver": "implicit"})
    with pytest.raises(ValueError, match="'miniature'"):
        make(FLAG, physics="minature")
