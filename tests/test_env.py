"""The rules of Gymnasium that every scene keeps."""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import AddRenderObservation, FrameStackObservation, RecordVideo, TimeLimit

import cloth_envs
from cloth_envs.env import ClothEnv
from cloth_envs.scenes.task import Task

SCENES, TASKS = list(cloth_envs.SCENES), list(cloth_envs.EPISODE_FRAMES)
SMALL = {"resolution": (13, 9)}


def make(scene: str, **options: object) -> gym.Env:
    return gym.make(cloth_envs.env_id(scene), **options)


def rollout(env: gym.Env, frames: int, seed: int = 3) -> list[np.ndarray]:
    """Observations and rewards under seeded random actions."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(frames):
        action = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        obs, reward, *_ = env.step(action)
        out += [obs, np.float64(reward)]
    return out


@pytest.mark.parametrize("obs", ["keypoints", "mesh"])
@pytest.mark.parametrize("scene", TASKS)
def test_gymnasium_checker_is_clean(scene: str, obs: str) -> None:
    with make(scene, obs=obs, **SMALL) as env:
        check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("obs", ["keypoints", "mesh"])
@pytest.mark.parametrize("scene", TASKS)
def test_stable_baselines_checker_is_clean(scene: str, obs: str) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="needs the extra 'rl'")
    with make(scene, obs=obs, **SMALL) as env, warnings.catch_warnings():
        if obs == "mesh":  # its advice on camera images: a geometry image holds metres, not bytes
            warnings.filterwarnings("ignore", message=".*(seems that your observation|minimal resolution for an image)")
        checker.check_env(env.unwrapped, warn=True)


@pytest.mark.parametrize("scene", TASKS)
def test_spaces_seeds_and_types(scene: str) -> None:
    with make(scene) as env:
        first, info = env.reset(seed=7)
        assert info == {}
        assert env.observation_space.contains(first)
        assert np.isfinite(env.observation_space.high).all()
        obs, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert type(reward) is float
        assert 0 <= reward <= 1
        assert type(terminated) is bool
        assert type(truncated) is bool
        assert obs is not first
        assert not np.shares_memory(obs, env.step(env.action_space.sample())[0])
        other, _ = env.reset(seed=8)
        assert not np.array_equal(first, other)
        assert np.array_equal(first, env.reset(seed=7)[0])
        core = env.unwrapped
        assert core.positions.shape == (3, *core.scene.grid.shape)
        assert core.positions.dtype == core.velocities.dtype == np.float32
        assert core.time == 0.0


@pytest.mark.parametrize("obs", ["keypoints", "mesh"])
def test_observations_of_float64_physics_lie_in_the_space(obs: str) -> None:
    double, options = {"dtype": "float64"}, {"obs": obs, **SMALL}
    id_ = cloth_envs.env_id("Flag")
    one = make("Flag", backend_kwargs=double, **options)
    for env in (one, gym.make_vec(id_, num_envs=2, backend_kwargs=[{}, double], **options)):
        seen = [env.reset(seed=0)[0], env.step(env.action_space.sample())[0]]
        assert all(env.observation_space.contains(each) for each in seen)


@pytest.mark.parametrize("scene", SCENES)
def test_spec_round_trips_through_json(scene: str) -> None:
    options = {"material": {"fabric": "silk", "drag": 1.0}, "randomize": {"areal_density": [0.1, 0.2]}, **SMALL}
    with make(scene, obs="mesh", **options) as env:
        text = env.spec.to_json()
        env.reset(seed=0)
        want = rollout(env, 3)
    json.loads(text)
    with gym.make(gym.envs.registration.EnvSpec.from_json(text)) as again:
        again.reset(seed=0)
        got = rollout(again, 3)
    for a, b in zip(want, got, strict=True):
        assert all(np.array_equal(a[k], b[k]) for k in a) if isinstance(a, dict) else np.array_equal(a, b)


REPLAY = """
import sys, hashlib, numpy as np, gymnasium as gym, cloth_envs
env = gym.make("MiniCloth-{scene}-v0", backend_kwargs={{"threads": {threads}}})
digest = hashlib.sha256(env.reset(seed=5)[0].tobytes())
rng = np.random.default_rng(1)
for _ in range(10):
    obs, reward, *_ = env.step(rng.uniform(-1, 1, env.action_space.shape).astype(np.float32))
    digest.update(obs.tobytes() + np.float64(reward).tobytes())
print(digest.hexdigest())
"""


def run_python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.mark.parametrize("scene", SCENES)
def test_replays_are_bit_equal_across_processes_and_threads(scene: str) -> None:
    assert run_python(REPLAY.format(scene=scene, threads=1)) == run_python(REPLAY.format(scene=scene, threads=2))


CONTINUE = """
import sys, numpy as np, gymnasium as gym, cloth_envs
env = gym.make("MiniCloth-{scene}-v0", randomize={{"areal_density": [0.15, 0.3]}}).unwrapped
env.set_state(dict(np.load({path!r})))
rng = np.random.default_rng(2)
out = [env.step(rng.uniform(-1, 1, env.action_space.shape).astype(np.float32))[0] for _ in range(8)]
out.append(env.reset()[0])
np.save({path!r} + ".out", np.stack(out))
"""


@pytest.mark.parametrize("scene", SCENES)
def test_another_process_continues_from_a_saved_state(scene: str, tmp_path: Path) -> None:
    path = str(tmp_path / "state.npz")
    env = make(scene, randomize={"areal_density": [0.15, 0.3]}).unwrapped
    env.reset(seed=11)
    rollout(env, 5)
    np.savez(path, **env.get_state())
    rng = np.random.default_rng(2)
    want = [env.step(rng.uniform(-1, 1, env.action_space.shape).astype(np.float32))[0] for _ in range(8)]
    want.append(env.reset()[0])  # the generator continues too
    run_python(CONTINUE.format(scene=scene, path=path))
    assert np.array_equal(np.stack(want), np.load(path + ".out.npy"))


def test_wrappers_work(tmp_path: Path) -> None:
    pytest.importorskip("pyvista", reason="needs the extra 'render'")
    env = make("Flag", render_mode="rgb_array", **SMALL)
    env = RecordVideo(
        FrameStackObservation(TimeLimit(env, 4), 3), str(tmp_path / "video"), episode_trigger=lambda n: True
    )
    obs, _ = env.reset(seed=0)
    assert obs.shape[0] == 3
    ended = False
    while not ended:
        *_, terminated, truncated, _ = env.step(env.action_space.sample())
        ended = terminated or truncated
    env.close()
    assert list(tmp_path.glob("video/*.mp4"))

    with AddRenderObservation(make("Flag", render_mode="rgb_array", **SMALL)) as env:
        image, _ = env.reset(seed=0)
        assert image.dtype == np.uint8
        assert image.std() > 5  # not a blank frame


def test_a_failed_simulation_ends_the_episode_with_its_last_good_state() -> None:
    env = make("Hanging", **SMALL).unwrapped
    env.reset(seed=0)
    stretched = env.positions
    stretched[:, 1:] += np.float32(0.9) * (stretched[:, 1:] - stretched[:, :1])
    env.set_positions(stretched)
    advance = env.world.backend.advance

    def spoil(value: float, field: str):  # a backend that goes wrong in its next frame
        def broken(controls):
            state = advance(controls)
            getattr(state, field)[0, :, 2, 2] = value
            return state

        return broken

    for value, field, reason in [
        (np.nan, "positions", "non-finite"),
        (np.inf, "velocities", "non-finite"),
        (9.0, "positions", "overstretch"),
        (5e3, "velocities", "energy"),
    ]:
        env.reset(seed=0)
        before = env.positions
        env.world.backend.advance = spoil(value, field)
        obs, reward, terminated, truncated, info = env.step(np.zeros(3, np.float32))
        env.world.backend.advance = advance
        assert (terminated, truncated, reward) == (True, False, 0.0)
        assert info.pop("strain") > (1 if reason != "energy" else 0)
        assert info.pop("distance") > 0
        nothing = {"reward_place": 0.0, "reward_calm": 0.0, "final_second": 0.0, "success": False, "change": 0.0}
        assert info == {"failure": reason, **nothing}
        assert np.isfinite(obs).all()
        assert np.array_equal(env.positions, before)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"scene": "Flagg"}, ["Flagg", "'Flag'"]),
        ({"backend": "referense"}, ["'reference'"]),
        ({"backend_kwargs": {"dtype": "float23"}}, ["'float32'"]),
        ({"backend_kwargs": {"thread": 2}}, ["solver='explicit'", "'threads'"]),
        ({"backend_kwargs": {"num_envs": 2}}, ["backend='reference'", "'num_envs'"]),
        ({"backend_kwargs": {"solver": "explicite"}}, ["solver", "'explicit'"]),
        ({"backend_kwargs": {"solver": 3}}, ["solver", "'explicit'"]),
        ({"backend_kwargs": {"threads": 0}}, ["threads", "at least 1"]),
        ({"backend_kwargs": {"substeps": 2}}, ["unstable", "at least"]),
        ({"obs": "keypoint"}, ["'keypoints'"]),
        ({"material": "coton"}, ["'cotton'"]),
        ({"material": {"areal_densty": 1.0}}, ["'areal_density'"]),
        ({"material": {"areal_density": -1.0}}, ["areal_density", "positive"]),
        ({"material": {"stretch_stiffness": float("nan")}}, ["stretch_stiffness", "finite"]),
        ({"material": {"stretch_stiffness": 1e12}}, ["substeps", "lower its stiffness"]),
        ({"material": 3}, ["fabric's name"]),
        ({"randomize": {"areal_density": [2.0, 1.0]}}, ["low <= high"]),
        ({"randomize": {"density": [1.0, 2.0]}}, ["'areal_density'"]),
        ({"resolution": (2, 9)}, ["3 x 3", "resolution"]),
        ({"resolution": (9.5, 9)}, ["whole numbers"]),
        ({"resolution": (10**6, 10**6)}, ["smaller resolution"]),
        ({"render_mode": "rgb"}, ["'rgb_array'"]),
    ],
)
def test_bad_arguments_name_the_remedy(options: dict[str, object], words: list[str]) -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        ClothEnv(**{"scene": "Flag", **options})
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_bad_actions_and_positions_leave_the_state_alone() -> None:
    env = make("Flag", **SMALL).unwrapped
    with pytest.raises(RuntimeError, match="reset"):
        env.step(np.zeros(2, np.float32))
    env.reset(seed=0)
    before = env.get_state()
    with pytest.raises(ValueError, match="NaN"):
        env.step(np.float32([0, np.nan]))
    with pytest.raises(ValueError, match=r"\(2,\): pole velocity x"):
        env.step(np.zeros(3, np.float32))
    with pytest.raises(ValueError, match="shape"):
        env.set_positions(np.zeros((3, 2, 2)))
    with pytest.raises(ValueError, match="another scene, preset, resolution or self_contact"):
        make("Flag", resolution=(9, 9)).unwrapped.set_state(before)
    assert all(np.array_equal(before[name], value) for name, value in env.get_state().items())


@pytest.mark.parametrize("scene", SCENES)
def test_every_fabric_and_a_description(scene: str) -> None:
    for fabric in cloth_envs.FABRICS:
        with make(scene, material=fabric, **SMALL) as env:
            env.reset(seed=0)
            rollout(env, 2)
    text = env.unwrapped.scene.describe()
    modelled, missing = text.split("not modelled:")
    assert "modelled: gravity" in modelled
    assert "quadratic bending; twist of an isotropic plate; air on cells" in modelled
    assert "(density 1.2 kg/m^3, normal 1.5, lift 1, tangential 0.02)" in modelled
    assert ("wind" in modelled) == (scene == "Flag")
    assert ("forces of the cloth on bodies" in missing) == bool(env.unwrapped.scene.colliders)
    assert isinstance(env.unwrapped.task, Task)
    for heading in ("Description", "Action Space", "Observation Space", "Rewards", "Starting State", "Episode End",
                    "Arguments", "What Is Modelled", "Version History"):  # fmt: skip
        assert f"## {heading}" in (env.unwrapped.task.__doc__ or "")
