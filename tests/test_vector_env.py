"""The vector environment against single ones, and its three ways of resetting."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import cloth_envs
from cloth_envs.vector_env import ClothVectorEnv

SMALL = {"resolution": (13, 9), "randomize": {"areal_density": [0.15, 0.3]}}
N = 3


def vector(scene: str, **options: object) -> gym.vector.VectorEnv:
    return gym.make_vec(cloth_envs.env_id(scene), num_envs=N, **SMALL, **options)


@pytest.mark.parametrize("scene", list(cloth_envs.SCENES))
def test_members_are_bit_equal_to_single_environments(scene: str) -> None:
    many = vector(scene, backend_kwargs={"threads": 2})
    ones = [gym.make(cloth_envs.env_id(scene), **SMALL) for _ in range(N)]
    batch, _ = many.reset(seed=4)
    assert np.array_equal(batch, np.stack([env.reset(seed=4 + i)[0] for i, env in enumerate(ones)]))
    rng = np.random.default_rng(0)
    for _ in range(6):
        actions = rng.uniform(-1, 1, many.action_space.shape).astype(np.float32)
        batch, rewards, *_ = many.step(actions)
        singles = [env.step(action) for env, action in zip(ones, actions, strict=True)]
        assert np.array_equal(batch, np.stack([s[0] for s in singles]))
        assert rewards.tolist() == [s[1] for s in singles]
    many.close()


def test_a_surrogate_is_stepped_by_threads_too() -> None:
    options = {"backend": "miniature", "max_episode_steps": 5}
    many, one = (vector("Flag", backend_kwargs={"factor": 4, **more}, **options) for more in ({}, {"threads": 1}))
    assert np.array_equal(many.reset(seed=1)[0], one.reset(seed=1)[0])
    actions = np.full(many.action_space.shape, 0.5, np.float32)
    assert np.array_equal(many.step(actions)[0], one.step(actions)[0])


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("obs", ["keypoints", "mesh"])
def test_resets_agree_with_gymnasiums_own_vector_environment(mode: AutoresetMode, obs: str) -> None:
    ours = vector("Flag", max_episode_steps=3, autoreset_mode=mode.value, obs=obs)
    theirs = gym.make_vec(
        cloth_envs.env_id("Flag"), num_envs=N, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode},
        max_episode_steps=3, obs=obs, **SMALL,
    )  # fmt: skip
    assert ours.metadata["autoreset_mode"] is mode
    assert ours.observation_space == theirs.observation_space

    def same(a: object, b: object) -> bool:
        if isinstance(a, dict):
            return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
        if isinstance(a, np.ndarray) and a.dtype == object:
            return all(same(x, y) for x, y in zip(a, b, strict=True))
        return np.array_equal(a, b)

    assert same(ours.reset(seed=1)[0], theirs.reset(seed=1)[0])
    actions = np.zeros(ours.action_space.shape, np.float32)
    for _ in range(8):
        a, b = ours.step(actions), theirs.step(actions)
        for x, y in zip(a[:4], b[:4], strict=True):
            assert same(x, y)
        assert same(a[4].get("final_obs"), b[4].get("final_obs"))
        assert same(a[4].get("_final_obs"), b[4].get("_final_obs"))
        ended = a[2] | a[3]
        if mode is AutoresetMode.DISABLED and ended.any():
            with pytest.raises(RuntimeError, match="reset_mask"):
                ours.step(actions)
            again = {"reset_mask": ended}
            assert same(ours.reset(options=again)[0], theirs.reset(options=again)[0])


def test_state_continues() -> None:
    env, other = vector("BallDrop"), vector("BallDrop")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    other.reset(seed=9)
    other.set_state(env.get_state())
    actions = np.ones(env.action_space.shape, np.float32)
    assert np.array_equal(env.step(actions)[0], other.step(actions)[0])
    env.reset(options={"reset_mask": np.array([True, False, False])})
    other.reset(options={"reset_mask": np.array([True, False, False])})
    assert np.array_equal(env.step(actions)[0], other.step(actions)[0])


def test_a_failure_ends_one_member_only() -> None:
    env = vector("Flag")
    env.reset(seed=0)
    backend = env.unwrapped.world.backend
    advance = backend.advance

    def broken(controls):  # member 1 goes wrong
        state = advance(controls)
        state.positions[1, 0, 3, 3] = np.nan
        return state

    backend.advance = broken
    actions = np.zeros(env.action_space.shape, np.float32)
    obs, rewards, terminated, _, infos = env.step(actions)
    backend.advance = advance
    assert terminated.tolist() == [False, True, False]
    assert infos["failure"].tolist() == [None, "non-finite", None]
    assert infos["_failure"].tolist() == [False, True, False]
    assert np.isfinite(obs).all()
    assert rewards[1] == 0.0
    _, rewards, terminated, *_ = env.step(actions)  # next-step mode: member 1 starts anew
    assert not terminated.any()
    assert env.unwrapped.state.time.tolist() == [pytest.approx(0.08), 0.0, pytest.approx(0.08)]


def test_what_was_refused_can_be_closed() -> None:
    """Gymnasium 1.2 does so as it is dropped."""
    ClothVectorEnv.__new__(ClothVectorEnv).close()


def test_bad_arguments_name_the_remedy() -> None:
    with pytest.raises(ValueError, match="'SameStep'"):
        vector("Flag", autoreset_mode="Samestep")
    with pytest.raises(ValueError, match="num_envs"):
        gym.make_vec(cloth_envs.env_id("Flag"), num_envs=0)
    env = vector("Flag")
    with pytest.raises(ValueError, match="2 seeds for 3"):
        env.reset(seed=[1, 2])
    with pytest.raises(ValueError, match="reset_mask"):
        env.reset(options={"reset_mask": np.zeros(N, bool)})
