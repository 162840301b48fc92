"""What is printed of things is one line; notebooks get a picture."""

import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import cloth_envs
from cloth_envs.recording import RecordRollout, Rollout
from cloth_envs.state import Cloth, LazyState, State
from training.cache import digest


def make(**options: object) -> gym.Env:
    return gym.make(cloth_envs.env_id("Flag"), resolution=(9, 13), **options)


@pytest.mark.parametrize("options", [{}, {"backend": "miniature", "backend_kwargs": {"factor": 4}}])
def test_everything_prints_in_a_line(options: dict, tmp_path: Path) -> None:
    env = RecordRollout(make(**options), str(tmp_path / "a.h5"))
    own = env.unwrapped
    assert repr(own) == f"<ClothEnv Flag 9x13 {options.get('backend', 'reference')}, before reset()>"
    env.reset(seed=0)
    env.step(np.zeros(2))
    env.close()
    with Rollout.open(tmp_path / "a.h5") as rollout:
        many = gym.make_vec(cloth_envs.env_id("Flag"), num_envs=2)
        told = [repr(p) for p in (own, own.scene, own.state, own.world, own.task, own.world.controls, many, rollout)]
    assert all("\n" not in text and len(text) < 120 for text in told)
    assert told[0].endswith("frame 1>")
    assert "time 0.04 s" in told[2]
    assert told[7] == "<Rollout Flag 9x13, 1 trajectory of 2 frames>"
    assert ", 2 environments, " in told[6]
    assert repr(env).startswith("<RecordRollout<TimeLimit<")


def test_one_is_no_plural(tmp_path: Path) -> None:
    one = gym.make_vec(cloth_envs.env_id("Flag"), num_envs=1, resolution=(9, 13))
    assert ", 1 environment, " in repr(one)
    assert ", 1 environment, " in repr(one.unwrapped.world)
    env = RecordRollout(make(), str(tmp_path / "a.h5"))
    env.reset(seed=0)
    env.close()
    with Rollout.open(tmp_path / "a.h5") as rollout:
        assert repr(rollout) == "<Rollout Flag 9x13, 1 trajectory of 1 frame>"


def test_printing_computes_nothing() -> None:
    def never() -> Cloth:
        raise AssertionError

    assert "not read so far" in repr(LazyState(State.still(np.zeros((2, 3, 4, 5))), never))


def test_a_notebook_shows_a_picture_and_the_numbers() -> None:
    env = make().unwrapped
    assert "before reset()" in env._repr_html_()
    env.reset(seed=0)
    shown = env._repr_html_()
    assert 'src="data:image/png;base64,' in shown
    assert "frame 0" in shown


def test_a_notebook_shows_a_recording(tmp_path: Path) -> None:
    env = RecordRollout(make(), str(tmp_path / "a.h5"))
    env.reset(seed=0)
    env.close()
    with Rollout.open(tmp_path / "a.h5") as rollout:
        assert 'src="data:image/png;base64,' in rollout._repr_html_()
    assert "<Rollout" not in rollout._repr_html_()  # escaped
    assert "Rollout Flag" in rollout._repr_html_()


def test_numbers_alone_where_nothing_draws() -> None:
    code = """
import sys
sys.modules["pyvista"] = None
import cloth_envs, gymnasium as gym
env = gym.make("MiniCloth-Flag-v0", resolution=(9, 13)).unwrapped
env.reset(seed=0)
print(env._repr_html_())
"""
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "frame 0" in shown
    assert "<img" not in shown


def test_a_scene_is_known_by_all_that_it_says() -> None:
    scene = make().unwrapped.scene
    other = scene.with_material(scene.material.with_changes(drag=1.0))
    assert repr(scene) == repr(other)
    assert digest(scene) != digest(other)
