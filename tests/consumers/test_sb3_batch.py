"""The batched environment as Stable-Baselines3's ``VecEnv``: bit-equal to its own ``DummyVecEnv`` of single ones."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import cloth_envs
from cloth_envs.agents import load_policy
from cloth_envs.evaluation import play
from cloth_envs.failure import Failures

pytest.importorskip("stable_baselines3", reason="needs the extra 'rl'")

import stable_baselines3 as sb3
from stable_baselines3.common import vec_env
from stable_baselines3.common.evaluation import evaluate_policy

from cloth_envs.stable_baselines import ClothVecEnv

N, LIMIT, FRAMES = 3, 6, 18  # members; frames of an episode; frames stepped
FLAG = cloth_envs.env_id("Flag-v1")
SMALL: dict[str, Any] = {"resolution": (13, 9), "max_episode_steps": LIMIT}


def frail(env: Any, strain: float) -> Any:
    """``env``, which ends an episode as overstretched beyond ``strain``."""
    env.unwrapped.world.failures = Failures(env.unwrapped.scene, strain)
    return env


def same(ours: Any, theirs: Any) -> None:
    """Equal to the bit, of one type and, in infos, of one kind of number."""
    assert type(ours) is type(theirs)
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys()
        for name, value in ours.items():
            same(value, theirs[name])
    elif isinstance(ours, list):
        assert len(ours) == len(theirs)
        for mine, other in zip(ours, theirs, strict=True):
            same(mine, other)
    elif isinstance(ours, np.ndarray):
        assert ours.dtype == theirs.dtype
        np.testing.assert_array_equal(ours, theirs)
    else:
        assert ours == theirs


def as_dict(observations: Any) -> Any:
    return dict(observations) if isinstance(observations, dict) else observations  # theirs is ordered


@pytest.mark.parametrize(
    ("strain", "more"),  # at which some members fail and others reach LIMIT
    [
        (0.05, {}),
        (0.05, {"obs": "mesh", "randomize": {"areal_density": [0.15, 0.3]}, "observe_material": True}),
        (0.06, {"backend": "miniature", "resolution": (9, 13)}),
    ],
    ids=["keypoints", "mesh", "miniature"],
)
def test_it_gives_what_single_environments_give(strain: float, more: dict[str, Any]) -> None:
    options = {**SMALL, **more}
    ours = ClothVecEnv(FLAG, N, **options)
    theirs = vec_env.DummyVecEnv([lambda: frail(gym.make(FLAG, **options), strain)] * N)
    frail(ours.env, strain)
    assert (ours.observation_space, ours.action_space) == (theirs.observation_space, theirs.action_space)
    rng, ended, failed = np.random.default_rng(0), np.zeros(N, int), 0
    assert ours.seed(5) == theirs.seed(5) == [5, 6, 7]
    for frame in range(FRAMES):
        if frame in (0, 8):  # the second goes on with the members' own generators
            same(as_dict(ours.reset()), as_dict(theirs.reset()))
        actions = rng.uniform(-1, 1, (N, 2)).astype(np.float32)
        (seen, *rest), (seen_theirs, *rest_theirs) = ours.step(actions), theirs.step(actions)
        same(as_dict(seen), as_dict(seen_theirs))
        same(rest, rest_theirs)
        same(ours.reset_infos, theirs.reset_infos)
        ended += rest[1]
        failed += sum("failure" in info for info in rest[2])
        for done, info in zip(*rest[1:], strict=True):
            assert done == ("terminal_observation" in info) == (info["TimeLimit.truncated"] or "failure" in info)
    assert ended.min() >= 2
    assert 0 < failed < ended.sum()
    ours.close()


def test_members_are_reached_as_single_environments_are() -> None:
    ours, theirs = ClothVecEnv(FLAG, N, **SMALL), vec_env.DummyVecEnv([partial(gym.make, FLAG, **SMALL)] * N)
    for env in (ours, theirs):
        env.seed(0)
        env.reset()
    for indices in (None, 1, [2, 0]):
        same(ours.get_attr("positions", indices), theirs.get_attr("positions", indices))
        same(ours.env_method("get_state", indices=indices), theirs.env_method("get_state", indices=indices))
        assert ours.env_is_wrapped(gym.Wrapper, indices) == [False] * len(ours.get_attr("task", indices))
    moved = ours.get_attr("positions", 1)[0] + np.float32(0.1)
    for env in (ours, theirs):
        env.env_method("set_positions", moved, indices=1)
    same(ours.get_attr("positions"), theirs.get_attr("positions"))
    rng = np.random.default_rng(3)
    ours.set_attr("np_random", rng, indices=1)
    assert [one is rng for one in ours.get_attr("np_random")] == [False, True, False]
    assert ours.has_attr("scene")
    assert not ours.has_attr("scenery")
    for name in ("scene", "scenery"):
        with pytest.raises(AttributeError, match=name):
            ours.set_attr(name, 1)


def test_what_it_cannot_take_is_refused() -> None:
    for name, value in (("autoreset_mode", "NextStep"), ("output", "torch")):
        with pytest.raises(ValueError, match=f"leave {name} out"):
            ClothVecEnv(FLAG, N, **{name: value})
    env = ClothVecEnv(FLAG, N, **SMALL)
    env.set_options({"wind": 3})
    with pytest.raises(ValueError, match="no reset options, got 'wind'"):
        env.reset()


def test_pictures_are_tiled() -> None:
    pytest.importorskip("pyvista", reason="needs the extra 'render'")
    env = ClothVecEnv(FLAG, N, render_mode="rgb_array", **SMALL)
    env.reset()
    picture = env.render()
    assert picture.shape == (2 * 240, 2 * 320, 3)
    assert picture[:240, :320].std() > 1
    assert not picture[240:, 320:].any()  # there are three
    env.close()


@pytest.mark.parametrize("kind", ["PPO", "SAC"])
def test_learners_learn_go_on_and_are_evaluated(kind: str, tmp_path: Path) -> None:
    """In its wrappers, as on its own ``DummyVecEnv``; then saved, loaded, trained further and judged by ours."""
    size = {"PPO": {"n_steps": 16, "batch_size": 16, "n_epochs": 1}, "SAC": {"learning_starts": 12, "batch_size": 16}}
    learner, models = getattr(sb3, kind), []
    for env in (ClothVecEnv(FLAG, N, **SMALL), vec_env.DummyVecEnv([partial(gym.make, FLAG, **SMALL)] * N)):
        wrapped = vec_env.VecCheckNan(vec_env.VecMonitor(env), raise_exception=True)
        models.append(learner("MlpPolicy", wrapped, seed=0, device="cpu", **size[kind]).learn(48))
    ours, theirs = models
    assert [e["r"] for e in ours.ep_info_buffer] == [e["r"] for e in theirs.ep_info_buffer]
    assert len(ours.ep_info_buffer) == 3 * (48 // 3 // LIMIT)
    for mine, other in zip(ours.policy.parameters(), theirs.policy.parameters(), strict=True):
        assert (mine == other).all()
    assert np.isfinite(evaluate_policy(ours, ours.get_env(), n_eval_episodes=3)[0])
    ours.save(tmp_path / "model")
    again = learner.load(tmp_path / "model", env=ClothVecEnv(FLAG, N, **SMALL))
    assert again.learn(24, reset_num_timesteps=False).num_timesteps > 48
    policy = load_policy(str(tmp_path / "model.zip"), "Flag-v1")
    found = play("Flag-v1", policy, range(2), frames=3, resolution=(13, 9))
    assert found.reward.shape == (2,)
    seen = ours.get_env().reset()
    np.testing.assert_array_equal(policy(seen), ours.predict(seen, deterministic=True)[0])
