"""Vector environments on the device of their backend are those on the host: here of tensors on the processor."""

from __future__ import annotations

import copy
import math
import pickle
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import cloth_envs
from cloth_envs.failure import Failures
from cloth_envs.scenes.drives import GUST_TONES

torch = pytest.importorskip("torch", reason="needs the extra 'train'")
from torch.overrides import TorchFunctionMode  # noqa: E402

N, LIMIT, FRAMES = 3, 6, 14  # members; frames of an episode; frames stepped
SMALL = {"num_envs": N, "resolution": (13, 9), "randomize": {"areal_density": [0.15, 0.3]}}
THERE = {"backend": "on_tensors:Explicit"}
# The strain at which some members fail and others reach LIMIT.
FRAIL = {"Curtain": 0.025, "Flag": 0.05, "Collision": 0.03, "Pressure": 0.03, "Hanging": 0.14, "BallDrop": 0.002}
CLOSE = {"rtol": 1e-5, "atol": 1e-5}


@pytest.fixture(autouse=True)
def backends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parent)


def made(scene: str, **options: Any) -> Any:
    return gym.make_vec(cloth_envs.env_id(scene), **SMALL | options)


def pair(scene: str, **options: Any) -> tuple[Any, Any]:
    """The environment on the host, and the one in tensors."""
    return made(scene, **options), made(scene, **options, **THERE, output="torch")


def assert_same(there: Any, here: Any) -> None:
    """Equal to rounding, tensors or arrays, whatever they are in."""
    if isinstance(here, dict):
        assert there.keys() == here.keys()
        for name, value in here.items():
            assert_same(there[name], value)
    elif isinstance(here, tuple) or (isinstance(here, np.ndarray) and here.dtype == object):
        for a, b in zip(there, here, strict=True):
            assert_same(a, b)
    elif isinstance(here, (np.ndarray, float, torch.Tensor)):
        found = np.asarray(there)
        assert found.dtype == np.asarray(here).dtype
        np.testing.assert_allclose(found, here, **CLOSE)
    else:
        assert there == here


def actions_of(env: Any, rng: np.random.Generator) -> np.ndarray:
    return rng.choice([-1.0, 1.0], env.action_space.shape).astype(np.float32)


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.value)
@pytest.mark.parametrize("scene", cloth_envs.SCENES)
def test_episodes_are_those_of_the_host(scene: str, mode: AutoresetMode) -> None:
    here, there = pair(scene, autoreset_mode=mode.value, max_episode_steps=LIMIT)
    for env in (here, there):
        env.world.failures = Failures(env.scene, FRAIL[scene])
    assert_same(there.reset(seed=1)[0], here.reset(seed=1)[0])
    rng = np.random.default_rng(0)
    failures = truncations = 0
    for _ in range(FRAMES):
        actions = actions_of(here, rng)
        answers, expected = there.step(torch.from_numpy(actions)), here.step(actions)
        assert all(isinstance(part, torch.Tensor) for part in answers[:4])
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
        env.world.failures = Failures(env.scene, FRAIL["Flag"])
        env.reset(seed=1)
    rng = np.random.default_rng(0)
    for _ in range(FRAMES):
        actions = actions_of(told, rng)
        answers, expected = silent.step(actions), told.step(actions)
        failed += answers[2].sum()
        assert_same(answers, expected)
    assert failed > 0


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
    here, there = pair("Hanging", max_episode_steps=LIMIT)
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
    own = {"resolution": (13, 9), "render_mode": "depth_array"}
    here, there = (gym.make("MiniCloth-BallDrop-v0", **own, **more) for more in ({}, THERE))
    assert_same(there.reset(seed=1)[0], here.reset(seed=1)[0])
    for _ in range(3):
        action = np.full(2, 0.5, np.float32)
        assert_same(there.step(action), here.step(action))
    assert_same(there.unwrapped.positions, here.unwrapped.positions)
    assert_same(there.render(), here.render())
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


class Watching(TorchFunctionMode):
    """Counts the calls of torch that are no views, and keeps what they bring from one side to the other."""

    VIEWS = ("__get__", "__getitem__", "__len__", "reshape", "permute", "unbind", "detach", "size", "dim", "expand")
    CROSSINGS = (
        "cpu",
        "numpy",
        "tolist",
        "item",
        "__bool__",
        "__array__",
        "nonzero",
        "tensor",
        "from_numpy",
    )

    def __init__(self) -> None:
        super().__init__()
        self.count, self.sent = 0, []

    def __torch_function__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        self.count += function.__name__ not in self.VIEWS
        if function.__name__ in self.CROSSINGS:
            self.sent.append((function.__name__, torch.Size(np.shape(args[0])).numel()))
        return function(*args, **kwargs or {})


@pytest.mark.parametrize("scene", cloth_envs.SCENES)
def test_a_step_is_few_operations_of_which_two_flags_come_back(scene: str) -> None:
    """On a GPU each costs a launch, and what comes back waits for all of them."""
    counts = []
    for n in (2, 5):
        env = made(scene, num_envs=n, backend="on_tensors:Still", output="torch", randomize=None)
        env.reset(seed=0)
        actions = torch.zeros(env.action_space.shape)
        with Watching() as watched:
            env.step(actions)
        assert watched.sent == [("tolist", 2)]
        counts.append(watched.count)
    assert counts[0] == counts[1]
    assert counts[0] < 160


def test_a_reset_in_a_step_sends_no_more_than_the_members_that_it_starts() -> None:
    env = made("Flag", num_envs=50, backend="on_tensors:Still", output="torch", randomize=None, max_episode_steps=3)
    env.reset(seed=0)
    actions = torch.zeros(env.action_space.shape)
    for _ in range(2):
        env.step(actions)
    env.reset(options={"reset_mask": np.arange(50) != 7})
    for frame in (3, 0):  # of the member left out: its last one, and the start of its next episode
        with Watching() as watched:
            env.step(actions)
        assert env.world.frames[7] == frame
        assert max(size for _, size in watched.sent) <= 2 * 2 * GUST_TONES  # the tones of one member's gusts
