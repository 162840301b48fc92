"""Copies of environments in mid-episode go on bit for bit, here and in other processes."""

import copy
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import cloudpickle
import gymnasium as gym
import numpy as np
import pytest

import cloth_envs
from cloth_envs.physics.explicit.solver import ExplicitSolver

SCENES = list(cloth_envs.SCENES)
SMALL = {"resolution": (13, 13), "randomize": {"areal_density": (0.1, 0.3)}}
BACKENDS: dict[str, dict[str, Any]] = {
    "reference": {},
    "float64": {"backend_kwargs": {"dtype": "float64"}},
    "admm": {"backend_kwargs": {"solver": "admm"}},
    "implicit": {"backend_kwargs": {"solver": "implicit"}},
    "miniature": {"backend": "miniature"},
    "corrected": {"scene": "Curtain", "backend": "miniature", "backend_kwargs": {"correction": "learned", "factor": 4}},
    "mfsr": {"backend": "mfsr"},
    "cnn": {"backend": "cnn"},
    "torch": {"backend": "cnn", "backend_kwargs": {"engine": "torch"}},
}
WAYS = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
    "cloudpickle": lambda env: cloudpickle.loads(cloudpickle.dumps(env)),
}


def begun(build: Any, scene: str = "Flag", **options: Any) -> Any:
    env = build(cloth_envs.env_id(scene), **{**SMALL, "max_episode_steps": 9, **options})
    env.reset(seed=1)
    for _ in range(5):
        env.step(np.full(env.action_space.shape, 0.3))
    return env


def future(env: Any) -> list[Any]:
    """Seven frames, over the end of the episode, and a new start."""
    seen = []
    for _ in range(7):
        obs, reward, terminated, truncated, _ = env.step(np.full(env.action_space.shape, -0.4))
        seen += [obs, reward, terminated, truncated]
    return [
        np.array(part) for part in (*seen, env.reset()[0], env.unwrapped.positions if isinstance(env, gym.Env) else 0)
    ]


def same(one: list[Any], other: list[Any]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("build", [gym.make, gym.make_vec])
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_copy_goes_on_bit_for_bit(backend: str, build: Any, way: str) -> None:
    env = begun(build, **BACKENDS[backend])
    twin = WAYS[way](env)
    seen = future(env)
    assert same(seen, future(twin))


@pytest.mark.parametrize("scene", SCENES)
def test_every_scene_copies(scene: str) -> None:
    for options in ({}, {"backend": "miniature"}, {"obs": "mesh"}):
        env = begun(gym.make, scene, **options)
        twin = copy.deepcopy(env)
        for _ in range(3):
            ahead = env.step(np.ones(env.action_space.shape))
            behind = twin.step(np.ones(env.action_space.shape))
        assert np.array_equal(env.unwrapped.positions, twin.unwrapped.positions)
        assert ahead[1:] == behind[1:]


def test_presets_and_new_environments_copy() -> None:
    env = begun(gym.make, "BallDrop", preset="zhao2024", resolution=None, randomize=None)
    assert same(future(copy.deepcopy(env)), future(env))
    new = gym.make(cloth_envs.env_id("Flag"), **SMALL)
    twin = copy.deepcopy(new)
    assert np.array_equal(new.reset(seed=3)[0], twin.reset(seed=3)[0])


def test_copies_are_apart() -> None:
    env = begun(gym.make, render_mode="rgb_array")
    picture = env.render()
    twin = copy.deepcopy(env)
    before = env.unwrapped.positions
    for _ in range(3):
        twin.step(np.ones(2))
    twin.action_space.seed(0)
    assert np.array_equal(env.unwrapped.positions, before)
    assert np.array_equal(copy.deepcopy(env).render(), picture)


@pytest.mark.parametrize("build", [gym.make, gym.make_vec])
def test_another_process_goes_on(build: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(cloth_envs.BACKENDS, "mine", ExplicitSolver)  # as register_backend does, for this test only
    for name, options in {**BACKENDS, "mine": {"backend": "mine"}}.items():
        (tmp_path / f"{name}.pkl").write_bytes(pickle.dumps(env := begun(build, **options)))
        (tmp_path / f"{name}.future").write_bytes(pickle.dumps(future(env)))
    code = """
import pickle, sys
from pathlib import Path
from test_copies import future, same
for path in sorted(Path(sys.argv[1]).glob("*.pkl")):
    env, told = (pickle.loads(file.read_bytes()) for file in (path, path.with_suffix(".future")))
    print(path.stem, same(future(env), told))
"""
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)],
        cwd=Path(__file__).parent, capture_output=True, text=True, check=True, timeout=300,
    )  # fmt: skip
    assert done.stdout.split() == [word for name in sorted([*BACKENDS, "mine"]) for word in (name, "True")], done.stdout
