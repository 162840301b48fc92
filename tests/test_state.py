"""What a saved state must be to be taken, and that one which is refused changes nothing."""

import json
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import cloth_envs
from cloth_envs.material import PROPERTIES

SCENES = list(cloth_envs.SCENES)
SMALL = {"resolution": (13, 13)}
BACKENDS = [{}, {"backend_kwargs": {"solver": "admm"}}, {"backend": "miniature"}, {"backend": "cnn"}]


def make(scene: str, **options: object) -> gym.Env:
    env = gym.make(cloth_envs.env_id(scene), disable_env_checker=True, **SMALL | options)
    env.reset(seed=0)
    env.step(np.full(env.action_space.shape, 0.3))
    return env


def refused(env: gym.Env, state: object, words: str = ".") -> None:
    before = env.unwrapped.get_state()
    with pytest.raises(ValueError, match=words):
        env.unwrapped.set_state(state)
    after = env.unwrapped.get_state()
    assert all(np.array_equal(before[name], after[name]) for name in before | after)


@pytest.mark.parametrize("options", BACKENDS)
@pytest.mark.parametrize("scene", SCENES)
def test_every_part_is_checked_before_anything_changes(scene: str, options: dict) -> None:
    env = make(scene, **options)
    good = env.unwrapped.get_state()
    for name, value in good.items():
        if name == "backend":  # who made it is no part of what decides the future
            continue
        refused(env, {n: a for n, a in good.items() if n != name})
        refused(env, good | {name: np.stack([value, value])})
        if value.dtype.kind == "f" and value.size:
            for bad in (np.nan, np.inf, -np.inf):
                spoilt = value.copy()
                spoilt.flat[value.size // 2] = bad
                refused(env, good | {name: spoilt}, f"{name} must be finite")
    env.unwrapped.set_state(good)


def test_what_is_no_state_is_refused_in_a_sentence() -> None:
    env = make("Collision")
    good = env.unwrapped.get_state()
    refused(env, None, "dict that get_state")
    refused(env, good | {"memory.gaol": np.zeros(1)}, "memory.goal")
    refused(env, good | {"state.positions": np.full(good["state.positions"].shape, 1e300)}, "1e.06")
    refused(env, good | {"state.positions": "here"}, "shape")
    refused(env, good | {"memory.goal": np.full(good["memory.goal"].shape, 1e300)}, "1e.06")
    for kind in (int, np.uint8, np.float16, complex, object):
        refused(env, good | {"state.positions": good["state.positions"].astype(kind)}, "float32 or float64")
    refused(env, good | {"state.positions": np.ma.masked_array(good["state.positions"], mask=True)}, "masked")
    refused(env, {**good, 5: np.zeros(1)}, "5")
    refused(env, {}, "lacks scene")
    refused(env, good | {"frames": good["frames"] + 0.5}, "whole numbers")
    refused(env, good | {"frames": good["frames"] - 9}, "at least 0")
    refused(env, good | {"state.time": good["state.time"] + 1.0}, "frames times")
    refused(env, good | {"rng": np.array(["{}"])}, "rng")
    refused(env, good | {"rng": np.array(["not JSON"])}, "rng")
    refused(env, good | {"rng": np.array([json.dumps({"bit_generator": "Nothing"})])}, "rng")
    told = json.loads(str(good["rng"][0]))
    for part in ({"inc": 0}, {"inc": 4}, {"state": -1}, {"state": 2**130}, {"state": 1.5}, {"state": True}):
        refused(env, good | {"rng": np.array([json.dumps(told | {"state": told["state"] | part})])}, "rng")
    for part in ({"has_uint32": 2}, {"has_uint32": True}, {"uinteger": 1.5}, {"uinteger": 2**40}):
        refused(env, good | {"rng": np.array([json.dumps(told | part)])}, "rng")
    refused(env, good | {"scene": np.array("[]")}, "scene")


@pytest.mark.parametrize("scene", SCENES)
def test_states_of_other_scenes_presets_and_resolutions_are_refused(scene: str) -> None:
    env = make(scene)
    for other in SCENES:
        if other != scene:
            refused(env, make(other).unwrapped.get_state(), "another scene")
    refused(env, make(scene, resolution=(13, 15)).unwrapped.get_state(), "another scene")
    preset = "lee2019" if scene in cloth_envs.registry.PRESETS["lee2019"] else None
    if preset:
        refused(env, make(scene, preset=preset).unwrapped.get_state(), "another scene")
    env.unwrapped.set_state(make(scene, material="silk").unwrapped.get_state())  # a material is part of a state


@pytest.mark.parametrize(
    ("options", "name", "value"),
    [
        ({}, "stretch_stiffness", 1e9),
        ({}, "areal_density", -1.0),
        ({"backend_kwargs": {"substeps": 300}}, "stretch_stiffness", 1e5),
        ({"backend_kwargs": {"solver": "admm"}}, "compression", 0.5),
        ({"backend_kwargs": {"solver": "admm"}}, "stretch_stiffness", 1e200),
        ({"backend_kwargs": {"solver": "admm"}}, "areal_density", 1e-6),
        ({"backend_kwargs": {"solver": "admm"}}, "damping", 1e3),
        ({"backend_kwargs": {"solver": "implicit"}}, "bend_stiffness", 1e15),
        ({"backend": "miniature"}, "stretch_stiffness", 1e11),
        ({"backend": "cnn"}, "stretch_stiffness", 1e11),
    ],
)
def test_a_material_that_the_solver_cant_step_is_refused(options: dict, name: str, value: float) -> None:
    env = make("Flag", **options)
    state = env.unwrapped.get_state()
    state["materials"][0, PROPERTIES.index(name)] = value
    refused(env, state)
    with pytest.raises(ValueError, match=f"randomize.*{name}"):
        make("Flag", **options, randomize={name: tuple(sorted((0.1, value)))})


def test_ranges_are_checked_at_their_corners() -> None:
    light, stiff = {"areal_density": (0.005, 0.2)}, {"stretch_stiffness": (500.0, 1e5)}
    for ranges in (light, stiff):
        make("Flag", randomize=ranges, resolution=(33, 49))
    for build in (gym.make, gym.make_vec):
        with pytest.raises(ValueError, match=r"areal_density.*stretch_stiffness.*substeps"):
            build(cloth_envs.env_id("Flag"), randomize=light | stiff)


@pytest.mark.parametrize("state", [None, 5, "x", np.zeros(3), {}, {5: np.zeros(1)}])
def test_vector_environments_refuse_in_a_sentence_too(state: object) -> None:
    env = gym.make_vec(cloth_envs.env_id("Flag"), num_envs=2, **SMALL)
    env.reset(seed=0)
    good = env.unwrapped.get_state()
    refused(env, state, "get_state")
    for ended in ([0.5, 0], [0, 2], ["a", "b"], [True]):
        refused(env, good | {"ended": np.array(ended)}, "ended")


@pytest.mark.parametrize("positions", [1e300, np.nan, np.inf, 1e7])
def test_placing_a_cloth_nowhere_is_refused(positions: float) -> None:
    env = make("Flag").unwrapped
    before = env.positions
    wrong = np.full(before.shape, positions)
    for where in ({"positions": wrong}, {"positions": before, "velocities": wrong}):
        with pytest.raises(ValueError, match="must"):
            env.set_positions(**where)
    with pytest.raises(ValueError, match="shape"):
        env.set_positions("here")
    assert np.array_equal(env.positions, before)


class Odd:
    def __array__(self, *_: object, **__: object) -> np.ndarray:
        raise TypeError("no numbers")


def test_whatever_reading_a_state_raises_is_a_valueerror(tmp_path: Path) -> None:
    good = make("Flag", backend="miniature").unwrapped.get_state()
    np.savez(tmp_path / "s.npz", **good)
    content = bytearray((tmp_path / "s.npz").read_bytes())
    content[content.find(b"state.velocities.npy") + 400] ^= 255
    (tmp_path / "damaged.npz").write_bytes(content)
    for change in (
        np.load(tmp_path / "damaged.npz"),
        good | {"rng": np.array(['{"bit_generator": "BitGenerator", "state": {}}'])},
        good | {"rng": np.array(["[" * 100_000])},
        good | {"scene": np.array("[" * 100_000)},
        good | {"state.wind": Odd()},
        good | {"backend.positions": np.full_like(good["backend.positions"], 1e30)},
    ):
        env = gym.make(cloth_envs.env_id("Flag"), backend="miniature", **SMALL).unwrapped
        with pytest.raises(ValueError, match=r"."):
            env.set_state(change)
        assert not env.world.started


def test_a_refused_state_leaves_a_new_environment_new() -> None:
    env = gym.make(cloth_envs.env_id("Flag"), **SMALL).unwrapped
    with pytest.raises(ValueError, match="scene"):
        env.set_state({})
    with pytest.raises(RuntimeError, match="reset"):
        env.step(np.zeros(2))
    env.set_state(make("Flag").unwrapped.get_state())
    env.step(np.zeros(2))


@pytest.mark.parametrize("options", BACKENDS)
def test_the_state_is_read_only(options: dict) -> None:
    for env in (
        make("Collision", **options).unwrapped,
        gym.make_vec(cloth_envs.env_id("Collision"), **SMALL | options),
    ):
        env.reset(seed=0)
        env.step(np.zeros(env.action_space.shape))
        before = env.get_state()
        for value in env.state.arrays().values():
            with pytest.raises(ValueError, match="read-only"):
                value[:] = 1.0
        assert all(np.array_equal(before[name], value) for name, value in env.get_state().items())
        env.state.copy().positions[:] = 0.0


def test_any_generator_is_saved() -> None:
    env, other = make("Flag"), make("Flag")
    env.unwrapped.np_random = np.random.Generator(np.random.MT19937(5))
    env.reset()
    other.unwrapped.set_state(env.unwrapped.get_state())
    assert np.array_equal(env.reset()[0], other.reset()[0])


def frames_left(env: gym.Env | gym.vector.VectorEnv) -> int:
    for count in range(1, 99):
        if np.all(env.step(np.zeros(env.action_space.shape))[3]):
            return count
    return 99


@pytest.mark.parametrize("build", [gym.make, gym.make_vec])
def test_the_time_limit_goes_back_with_the_state(build) -> None:
    def new() -> gym.Env | gym.vector.VectorEnv:
        env = build(cloth_envs.env_id("Flag"), max_episode_steps=12, **SMALL)
        env.reset(seed=0)
        return env

    env, saved = new(), {}
    for frame in range(12):
        saved[frame] = env.unwrapped.get_state()
        env.step(np.zeros(env.action_space.shape))
    for at in (11, 3, 8, 0):  # in the environment that has ended, and in a new one
        for target in (env, new()):
            target.unwrapped.set_state(saved[at])
            assert frames_left(target) == 12 - at
    env.reset()
    assert frames_left(env) == 12


@pytest.mark.parametrize("wrong", [{"seed": "a"}, {"seed": -1}, {"options": {"mask": 1}}])
def test_a_refused_reset_leaves_the_time_limit(wrong: dict) -> None:
    env = gym.make(cloth_envs.env_id("Flag"), max_episode_steps=10, **SMALL)
    env.reset(seed=0)
    for _ in range(4):
        env.step(np.zeros(2))
    with pytest.raises(ValueError, match=r"seed|mask"):
        env.reset(**wrong)
    assert frames_left(env) == 6


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_a_rounded_time_becomes_exact(kind: type) -> None:
    env = make("Flag")
    env.step(np.zeros(2))
    env.step(np.zeros(2))
    state = env.unwrapped.get_state()
    env.unwrapped.set_state(state | {"state.time": (state["state.time"] * (1 + 1e-9)).astype(kind)})
    assert env.unwrapped.time == 3 * env.unwrapped.scene.frame_dt


def test_time_is_frames_times_the_frame() -> None:
    for env in (make("Flag"), gym.make_vec(cloth_envs.env_id("Flag"), max_episode_steps=None, **SMALL)):
        env.reset(seed=0)
        state, dt = env.unwrapped.get_state(), env.unwrapped.scene.frame_dt
        state["frames"][:] = 10**6 - 3
        state["state.time"][:] = (10**6 - 3) * dt
        env.unwrapped.set_state(state)
        for frame in range(10**6 - 2, 10**6 + 9):
            env.step(np.zeros(env.action_space.shape))
            assert env.unwrapped.state.time[0] == frame * dt
