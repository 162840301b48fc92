"""What is printed of things is one line; notebooks get a picture."""

import re
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest

import cloth_envs
from training.cache import digest


def make(**options: object) -> gym.Env:
    return gym.make(cloth_envs.env_id("Flag"), resolution=(9, 13), **options)


@pytest.mark.parametrize("options", [{}, {"backend": "miniature", "backend_kwargs": {"factor": 4}}])
def test_everything_prints_in_a_line(options: dict) -> None:
    env = make(**options)
    new = repr(env.unwrapped)
    assert "not reset yet" in new
    env.reset(seed=0)
    env.step(np.zeros(2))
    own = env.unwrapped
    lazy = own.world.state
    parts = own.scene, own.state, lazy, own.world, own.task, own, own.world.controls, own.scene.material
    told = [repr(part) for part in parts]
    assert all("\n" not in text for text in (new, *told))
    assert all(len(text) < 160 for text in told[:7])
    assert told[0] == "<Scene Flag, 9x13 vertices, 1 x 1.5 m>"
    assert "time 0.04 s" in told[2]
    assert ("not computed" in told[2]) == bool(options)  # and printing does not compute it
    assert re.fullmatch(r"<ClothEnv Flag 9x13, \w+.*, frame 1, 0.04 s, largest strain [\d.]+ %>", told[5])
    assert repr(env).startswith("<TimeLimit<")


def test_a_notebook_shows_a_picture_and_the_numbers() -> None:
    env = make().unwrapped
    assert "not reset yet" in env._repr_html_()
    env.reset(seed=0)
    shown = env._repr_html_()
    assert 'src="data:image/png;base64,' in shown
    assert "frame 0, 0 s" in shown


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
    assert "frame 0, 0 s" in shown
    assert "<img" not in shown


def test_a_scene_is_known_by_all_that_it_says() -> None:
    scene = make().unwrapped.scene
    other = scene.with_material(scene.material.with_changes(drag=1.0))
    assert repr(scene) == repr(other)
    assert digest(scene) != digest(other)
