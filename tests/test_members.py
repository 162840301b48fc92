"""What users reach of the members of a vector environment, as of Gymnasium's own; first episodes that end apart."""

from __future__ import annotations

import copy
import gc
import weakref
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

N, SMALL = 3, {"resolution": (13, 9)}
MIXED: dict[str, Any] = {
    "backend": ["miniature", "reference", "miniature"],
    "backend_kwargs": [{"factor": 4}, {}, {"factor": 4}],
}
BACKENDS: list[dict[str, Any]] = [{}, {"backend": "miniature", "backend_kwargs": {"factor": 4}}, MIXED]


def vector(**options: Any) -> Any:
    return gym.make_vec("MiniCloth-Flag-v1", num_envs=N, **SMALL, **options)


def single(options: dict[str, Any], i: int = 0) -> Any:
    own = {name: value[i] if isinstance(value, list) else value for name, value in options.items()}
    return gym.make("MiniCloth-Flag-v1", **SMALL, **own)


def test_members_have_what_single_environments_have() -> None:
    ours, theirs = vector(), vector(vectorization_mode="sync")
    for env in (ours, theirs):
        env.reset(seed=5)
        env.step(np.ones((N, 2), np.float32))
    for name in ("positions", "velocities", "time", "np_random_seed", "render_mode"):
        for a, b in zip(ours.get_attr(name), theirs.get_attr(name), strict=True):
            assert np.array_equal(a, b), name
    assert ours.get_attr("action_space") == theirs.get_attr("action_space")
    assert ours.get_attr("observation_space") == theirs.get_attr("observation_space")
    assert ours.call("describe") == theirs.call("describe")
    assert [type(task) for task in ours.get_attr("task")] == [type(ours.unwrapped.task)] * N
    assert ours.np_random_seed == (5, 6, 7)
    a, b = ([rng.random() for rng in env.np_random] for env in (ours, theirs))
    assert a == b


def test_what_members_lack_is_named() -> None:
    env = vector()
    with pytest.raises(AttributeError, match="Did you mean 'positions'"):
        env.get_attr("position")
    with pytest.raises(AttributeError, match="task of members can't be set, np_random can"):
        env.set_attr("task", None)
    with pytest.raises(ValueError, match="2 for 3 environments"):
        env.set_attr("np_random", [1, 2])
    with pytest.raises(AttributeError, match="describe of members can't be set"):
        env.set_attr("describe", None)
    with pytest.raises(ValueError, match=r"numpy.random.default_rng\(0\), got 1"):
        env.set_attr("np_random", 1)
    with pytest.raises(ValueError, match="of 0 to 2, got -1"):
        env.unwrapped.get_state(member=-1)
    with pytest.raises(ValueError, match="of 0 to 2, got 3"):
        env.unwrapped.set_state({}, member=3)
    with pytest.raises(RuntimeError, match="call reset"):
        env.get_attr("positions")
    with pytest.raises(RuntimeError, match="call reset"):
        env.call("get_state")


def test_asking_members_keeps_no_environment() -> None:
    env = vector().unwrapped
    env.reset(seed=0)
    env.get_attr("positions")
    gone = weakref.ref(env)
    gc.disable()
    try:
        del env
        assert gone() is None
    finally:
        gc.enable()


def test_generators_can_be_given() -> None:
    a, b = vector(), vector()
    a.reset(seed=[4, 4, 4])
    b.set_attr("np_random", [np.random.default_rng(4) for _ in range(N)])
    assert np.array_equal(a.reset(seed=[4, 4, 4])[0], b.reset()[0])
    assert b.np_random_seed == (-1, -1, -1)


@pytest.mark.parametrize("options", BACKENDS)
def test_a_members_state_goes_on_alone_and_back(options: dict[str, Any]) -> None:
    many = vector(**options)
    many.reset(seed=1)
    actions = np.random.default_rng(0).uniform(-1, 1, (8, N, 2)).astype(np.float32)
    for action in actions[:3]:
        many.step(action)
    for i, state in enumerate(many.call("get_state")):
        alone = single(options, i)
        alone.reset(seed=9)
        alone.unwrapped.set_state(state)
        other = copy.deepcopy(many)
        for action in actions[3:5]:
            assert np.array_equal(other.step(action)[0][i], alone.step(action[i])[0])
        into = vector(**options)
        into.reset(seed=20)
        before = copy.deepcopy(into)
        into.unwrapped.set_state(alone.unwrapped.get_state(), member=i)
        for action in actions[5:]:
            a, b, c = (env.step(action)[:2] for env in (into, other, before))
            for field, same, old in zip(a, b, c, strict=True):
                assert np.array_equal(field[i], same[i])
                rest = np.arange(N) != i
                assert np.array_equal(field[rest], old[rest])


def test_a_members_state_may_be_of_another_backend() -> None:
    """What the member's own backend remembered of its last cloth is of no use then."""
    options = BACKENDS[1]
    many, reference, fresh = vector(**options), single({}), single(options)
    many.reset(seed=1)
    many.step(np.ones((N, 2), np.float32))
    reference.reset(seed=7)
    reference.step(np.ones(2, np.float32))
    fresh.reset(seed=0)
    state = reference.unwrapped.get_state()
    many.unwrapped.set_state(state, member=1)
    fresh.unwrapped.set_state(state)
    assert np.array_equal(many.get_attr("positions")[1], reference.unwrapped.positions)
    zeros = np.zeros((N, 2), np.float32)
    assert np.array_equal(many.step(zeros)[0][1], fresh.step(zeros[0])[0])


def test_bad_states_of_members_change_nothing() -> None:
    many = vector()
    many.reset(seed=1)
    before, state = many.unwrapped.get_state(), many.call("get_state")[0]
    for bad in ({}, state | {"frames": np.zeros(N, int)}, many.unwrapped.get_state()):
        with pytest.raises(ValueError, match=r"lacks|shape|unknown part"):
            many.unwrapped.set_state(bad, member=0)
    after = many.unwrapped.get_state()
    assert all(np.array_equal(before[name], after[name]) for name in before)


def test_all_members_may_go_on_from_one_state() -> None:
    many, one = vector(), single({})
    many.reset(seed=1)
    one.reset(seed=8)
    one.step(np.ones(2, np.float32))
    many.call("set_state", one.unwrapped.get_state())
    also = vector()
    also.reset(seed=2)
    also.unwrapped.set_state(one.unwrapped.get_state(), member=[0, 2])
    assert [(a == one.unwrapped.positions).all() for a in also.get_attr("positions")] == [True, False, True]
    observation, rewards, *_ = many.step(np.zeros((N, 2), np.float32))
    alone, reward, *_ = one.step(np.zeros(2, np.float32))
    assert np.array_equal(observation, np.stack([alone] * N))
    assert rewards.tolist() == [reward] * N


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_first_episodes_end_apart(mode: str) -> None:
    env = vector(desync=True, max_episode_steps=6, autoreset_mode=mode)
    assert np.array_equal(env.reset(seed=3)[0], vector(max_episode_steps=6).reset(seed=3)[0])
    zeros = np.zeros((N, 2), np.float32)
    ends: list[list[int]] = [[], [], []]
    for frame in range(1, 16):
        if frame == 3:  # members that go on from a state end as they would have
            state, env = env.unwrapped.get_state(), vector(desync=True, max_episode_steps=6, autoreset_mode=mode)
            env.unwrapped.set_state(state)
        for i in np.flatnonzero(env.step(zeros)[3]):
            ends[i].append(frame)
    between = 6 + (mode == "NextStep")
    assert ends == [list(range(first, 16, between)) for first in (6, 4, 2)]
    env.reset(seed=3)
    env.reset(options={"reset_mask": np.array([False, False, True])})
    assert [env.step(zeros)[3].tolist() for _ in range(4)][1:] == [[False] * 3, [False] * 3, [False, True, False]]


def test_desync_is_of_batches_that_end() -> None:
    with pytest.raises(ValueError, match="pass max_episode_steps"):
        vector(desync=True, max_episode_steps=-1)
    with pytest.raises(ValueError, match="desync must be True or False"):
        vector(desync=1)
    with pytest.raises(ValueError, match=r"gymnasium.make_vec\(id, desync=True\)"):
        gym.make("MiniCloth-Flag-v1", desync=True)
