"""Vector environments on the device of their backend are those on the host."""

from __future__ import annotations

import copy
import math
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import cloth_envs

torch = pytest.importorskip("torch", reason="needs the extra 'train'")
from on_tensors import DEVICES, THERE, actions_of, assert_same, frail, made  # noqa: E402

LIMIT, FRAMES = 6, 14  # frames of an episode; frames stepped


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.value)
@pytest.mark.parametrize("scene", cloth_envs.EPISODE_FRAMES)
@pytest.mark.parametrize("device", DEVICES)
def test_episodes_are_those_of_the_host(device: str, scene: str, mode: AutoresetMode) -> None:
    own = {"autoreset_mode": mode.value, "max_episode_steps": LIMIT}
    here = frail(made(scene, **own))
    there = frail(made(scene, **own, **THERE, backend_kwargs={"device": device}, output="torch"))
    assert_same(there.reset(seed=1)[0], here.reset(seed=1)[0])
    rng = np.random.default_rng(0)
    failures = truncations = 0
    for _ in range(FRAMES):
        actions = actions_of(here, rng)
        answers, expected = there.step(torch.from_numpy(actions)), here.step(actions)
        assert all(part.device.type == device for part in answers[:4])
        assert_same(answers, expected)
        terminated, truncated = expected[2:4]
        failures, truncations = failures + terminated.sum(), truncations + (truncated & ~terminated).sum()
        ended = terminated | truncated
        if mode is AutoresetMode.DISABLED and ended.any():
            assert_same(*(env.reset(options={"reset_mask": ended}) for env in (there, here)))
    assert failures > 0
    assert truncations > 0


@pytest.mark.parametrize("obs", ["keypoints", "mesh"])
def test_arrays_come_out_by_default(obs: str) -> None:
    here, there = made("BallDrop", obs=obs), made("BallDrop", obs=obs, **THERE)
    assert_same(there.reset(seed=2), here.reset(seed=2))
    actions = np.full(here.action_space.shape, 0.5, np.float32)
    answers = there.step(actions)
    for found, wanted in zip(answers, here.step(actions), strict=True):
        assert_same(found, wanted)
        assert not isinstance(found, torch.Tensor)
    assert there.observation_space.contains(answers[0])
    assert_same(there.state.positions, here.state.positions)


@pytest.mark.parametrize("scene", ["Flag", "Collision", "Curtain"])
def test_a_preset_is_the_same_there(scene: str) -> None:
    own = {"preset": "lee2019", "randomize": None, "backend_kwargs": {"solver": "explicit"}}
    here = made(scene, **own)
    there = made(scene, **own | {"backend_kwargs": None}, **THERE)
    assert_same(there.reset(seed=2), here.reset(seed=2))
    for _ in range(2):
        actions = np.full(here.action_space.shape, -0.5, np.float32)
        assert_same(there.step(actions), here.step(actions))


def test_health_is_measured_where_none_is_told() -> None:
    told, silent = (made("Flag", **THERE, backend_kwargs={"told": told}, max_episode_steps=9) for told in (True, False))
    failed = 0
    for env in (told, silent):
        frail(env).reset(seed=1)
    rng = np.random.default_rng(0)
    for _ in range(FRAMES):
        actions = actions_of(told, rng)
        answers, expected = silent.step(actions), told.step(actions)
        failed += answers[2].sum()
        assert_same(answers, expected)
    assert failed > 0


@pytest.mark.parametrize("obs", ["keypoints", "mesh"])
@pytest.mark.parametrize("device", DEVICES)
def test_the_material_is_observed_there_too(device: str, obs: str) -> None:
    own = {"observe_material": True, "obs": obs, "autoreset_mode": "SameStep", "max_episode_steps": 2}
    here, there = made("Flag", **own), made("Flag", **own, **THERE, backend_kwargs={"device": device}, output="torch")
    assert_same(there.reset(seed=1), here.reset(seed=1))
    for _ in range(3):
        actions = np.ones(here.action_space.shape, np.float32)
        assert_same(there.step(torch.from_numpy(actions)), here.step(actions))


@pytest.mark.parametrize(("field", "value", "reason"), [
    ("positions", math.nan, "non-finite"), ("positions", 1e3, "overstretch"), ("velocities", 1e3, "energy"),
])  # fmt: skip
def test_a_broken_member_is_put_back_and_the_others_go_on(field: str, value: float, reason: str) -> None:
    env = made("Flag", **THERE, output="torch", backend_kwargs={"told": False})
    before, _ = env.reset(seed=0)
    advance = env.world.backend.advance

    def broken(controls: Any) -> Any:
        state = advance(controls)
        getattr(state, field)[1, 0, -1] = value
        return state

    env.world.backend.advance = broken
    found, rewards, terminated, _, info = env.step(torch.zeros(env.action_space.shape))
    assert terminated.tolist() == [False, True, False]
    assert info["failure"].tolist() == [None, reason, None]
    assert rewards[1] == 0
    assert found.isfinite().all()
    vertices = 3 * len(env.world.task.keypoints)
    assert torch.equal(found[1, :vertices], before[1, :vertices])
    assert not torch.equal(found[0, :vertices], before[0, :vertices])


def test_what_was_given_stays_as_it_was() -> None:
    env = made("Flag", **THERE, output="torch")
    kept = [env.reset(seed=0)[0]]
    rng = np.random.default_rng(0)
    copies = [kept[0].clone()]
    for _ in range(3):
        answers = env.step(torch.from_numpy(actions_of(env, rng)))
        kept += answers[:4]
        copies += [part.clone() for part in answers[:4]]
    assert all(map(torch.equal, kept, copies))


def test_bad_actions_change_nothing() -> None:
    env, other = (made("Flag", **THERE, output="torch") for _ in range(2))
    good = torch.full(env.action_space.shape, 0.5)
    for each in (env, other):
        each.reset(seed=0)
        each.step(good)
    for bad, words in ((good * math.nan, "NaN or infinity"), (good[:1], "expected"), (good.numpy() * np.inf, "NaN")):
        with pytest.raises(ValueError, match=words):
            env.step(bad)
    for found, wanted in zip(env.get_state().values(), other.get_state().values(), strict=True):
        assert np.array_equal(found, wanted)
    for found, wanted in zip(env.step(good)[:4], other.step(good)[:4], strict=True):
        assert torch.equal(found, wanted)


@pytest.mark.parametrize("way", ["to the device", "to the host", "copied", "pickled"])
def test_a_saved_state_goes_on(way: str) -> None:
    here, there = made("Hanging", max_episode_steps=LIMIT), made("Hanging", max_episode_steps=LIMIT, **THERE)
    first, second = (here, there) if way == "to the device" else (there, here)
    first.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(4):
        first.step(actions_of(here, rng))
    if way == "copied":
        second = copy.deepcopy(first)
    elif way == "pickled":
        second = pickle.loads(pickle.dumps(first))
    else:
        second.set_state(first.get_state())
    for _ in range(5):  # through the end of their episodes
        actions = actions_of(here, rng)
        assert_same(second.step(actions), first.step(actions))


def test_a_single_environment_has_arrays() -> None:
    here, there = (gym.make("MiniCloth-BallDrop-v0", resolution=(13, 9), **more) for more in ({}, THERE))
    assert_same(there.reset(seed=1)[0], here.reset(seed=1)[0])
    for _ in range(3):
        action = np.full(2, 0.5, np.float32)
        assert_same(there.step(action), here.step(action))
    assert_same(there.unwrapped.positions, here.unwrapped.positions)
    assert_same(there.unwrapped.state.colliders, here.unwrapped.state.colliders)
    there.unwrapped.set_state(here.unwrapped.get_state())
    assert there.unwrapped.time == here.unwrapped.time


def test_output_says_what_it_needs() -> None:
    with pytest.raises(ValueError, match=r'output="torch" needs one backend on a device.*leave output out'):
        made("Flag", output="torch")
    with pytest.raises(ValueError, match=r"'torch'"):
        made("Flag", output="tensors")
    mixed = made("Flag", backend=["reference", "on_tensors:Explicit", "reference"])
    here = made("Flag")
    assert_same(mixed.reset(seed=0)[0], here.reset(seed=0)[0])
