"""What is recorded is what was done: replaying any recording gives the same bits, on every scene and backend."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

import cloth_envs
from cloth_envs.recording import RecordRollout, Rollout

SMALL = {"resolution": (9, 13)}
BACKENDS: dict[str, dict[str, Any]] = {
    "explicit": {},
    "float64": {"backend_kwargs": {"dtype": "float64"}},
    "admm": {"backend_kwargs": {"solver": "admm"}},
    "implicit": {"backend_kwargs": {"solver": "implicit"}},
    "miniature": {"backend": "miniature"},
    "cnn": {"backend": "cnn"},
}
CASES = [(scene, {**SMALL, **options}) for scene in cloth_envs.SCENES for options in BACKENDS.values()]
CASES += [("Flag", {"preset": "lee2019", "resolution": (17, 25)}), ("Pressure", {"preset": "zhao2024"})]
CASES += [("Flag", {**SMALL, "randomize": {"areal_density": (0.1, 0.3)}, "obs": "mesh"})]


def replay(path: Path) -> None:
    """Every frame and reward of every trajectory again, of an environment that the file's spec makes."""
    with Rollout.open(path) as rollout:
        env: Any = gym.make(EnvSpec.from_json(rollout.attributes["env_spec"])).unwrapped
        env.reset(seed=12345)
        for trajectory, seed in enumerate(rollout.seeds):
            for begin in (lambda t=trajectory: env.set_state(rollout.start(t)), lambda s=seed: env.reset(seed=s)):
                if begin.__defaults__ == (None,):
                    continue  # no seed was given
                begin()
                recorded = zip(rollout.actions(trajectory), rollout.states(trajectory), strict=True)
                rewards = [0.0]
                for frame, (action, state) in enumerate(recorded):
                    if frame:
                        rewards.append(env.step(action)[1])
                    for name, value in env.world.state.arrays().items():
                        assert value.dtype == getattr(state, name).dtype
                        np.testing.assert_array_equal(value, getattr(state, name))
                np.testing.assert_array_equal(rollout.rewards(trajectory), rewards)


@pytest.mark.parametrize(("scene", "options"), CASES)
def test_replaying_a_recording_gives_the_same_bits(scene: str, options: dict[str, Any], tmp_path: Path) -> None:
    """With a seed, without one, and after the state was changed in the middle of an episode."""
    path = tmp_path / "a.h5"
    env = RecordRollout(gym.make(cloth_envs.env_id(scene), disable_env_checker=True, **options), str(path))
    cloth: Any = env.unwrapped
    rng = np.random.default_rng(1)

    def act(frames: int) -> None:
        for _ in range(frames):
            env.step(rng.uniform(-1.2, 1.2, env.action_space.shape))  # beyond the limits too

    env.reset(seed=2**65 + 1)
    act(4)
    env.reset()
    act(3)
    saved = cloth.get_state()
    cloth.set_positions(cloth.positions + np.float32(1e-3), cloth.velocities)
    act(2)
    cloth.set_state(saved)
    act(2)
    cloth.reset()
    act(2)
    cloth.step(np.zeros(env.action_space.shape))
    act(1)
    env.close()
    with Rollout.open(path) as rollout:
        assert rollout.lengths == [5, 4, 3, 3, 3, 2]
        assert rollout.seeds == [2**65 + 1, None, None, None, None, None]
        assert rollout.resets == [True, True, False, False, True, False]  # the fifth by a reset past the recorder
    replay(path)


class Twice(gym.Wrapper):
    """Every action two times."""

    def step(self, action: Any) -> Any:
        self.env.step(action)
        return self.env.step(action)


@pytest.mark.parametrize(
    "wrap",
    [
        lambda env: gym.wrappers.RescaleAction(env, np.zeros(2, "f"), np.ones(2, "f")),
        lambda env: gym.wrappers.RescaleAction(env, np.float32(-3), np.float32(3)),
        lambda env: gym.wrappers.TransformReward(env, lambda reward: 2 * reward),
        lambda env: gym.wrappers.Autoreset(gym.wrappers.TimeLimit(env, 3)),
        Twice,
    ],
)
@pytest.mark.parametrize("outside", [False, True])
def test_wrappers(wrap: Any, outside: bool, tmp_path: Path) -> None:
    """Recorded is what the cloth took and gave, whatever lies between it and the recorder."""
    path, env = tmp_path / "a.h5", gym.make("MiniCloth-Flag-v0", **SMALL)
    env = wrap(RecordRollout(env, str(path))) if outside else RecordRollout(wrap(env), str(path))
    env.reset(seed=4)
    env.action_space.seed(0)
    for _ in range(8):
        env.step(env.action_space.sample())
    env.close()
    replay(path)


@pytest.mark.parametrize("seed", [0, 2**63, 2**64 + 1, 10**30, 2**200, np.int64(7)])
def test_seeds_of_any_size(seed: Any, tmp_path: Path) -> None:
    env = RecordRollout(gym.make("MiniCloth-Flag-v0", **SMALL), str(tmp_path / "a.h5"))
    for one in (5, seed, None):
        env.reset(seed=one if one is None else int(one))
    env.writer.begin(seed)
    env.writer.append(env.unwrapped.world.state)
    with pytest.raises(ValueError, match="at least 0"):
        env.writer.begin(-1)
    env.close()
    with Rollout.open(tmp_path / "a.h5") as rollout:
        assert rollout.seeds == [5, seed, None, seed]
        assert all(one is None or type(one) is int for one in rollout.seeds)
        with pytest.raises(ValueError, match="does not say where trajectory 3 began"):
            rollout.start(3)


def test_numpy_in_the_arguments(tmp_path: Path) -> None:
    options: dict[str, Any] = {
        "resolution": (np.int64(9), np.int64(13)),
        "material": {"areal_density": np.float32(0.25)},
        "randomize": {"drag": (np.float32(0), np.float32(1))},
    }

    env = RecordRollout(gym.make("MiniCloth-Flag-v0", **options), str(tmp_path / "a.h5"))
    env.reset(seed=0)
    env.step(np.zeros(2))
    env.close()
    replay(tmp_path / "a.h5")


def test_only_the_text_of_a_spec_is_reduced(tmp_path: Path) -> None:
    """What JSON can't hold is named; the rest makes an environment."""
    env = gym.make("MiniCloth-Flag-v0", **SMALL)
    env.unwrapped.spec.kwargs["extra"] = object()
    env = RecordRollout(gym.wrappers.TransformReward(env, abs), str(tmp_path / "a.h5"))
    env.reset(seed=0)
    env.close()
    with Rollout.open(tmp_path / "a.h5") as rollout:
        assert rollout.attributes["env_spec_left_out"] == "extra"
        assert rollout.attributes["wrappers"].startswith("TransformReward, ")
        spec = EnvSpec.from_json(rollout.attributes["env_spec"])
        assert gym.make(spec).unwrapped.scene == rollout.scene
