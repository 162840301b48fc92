"""One short line for everything that is printed, and a card for notebooks."""

import base64
import re
from io import BytesIO
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image

from cloth_envs.recording import RecordRollout, Rollout
from cloth_envs.rendering import notebook
from cloth_envs.state import LazyState, State
from training.cache import digest


def make(**options: object) -> gym.Env:
    return gym.make("MiniCloth-Flag-v0", resolution=(9, 13), disable_env_checker=True, **options)


def test_an_environment_tells_what_it_is_and_where() -> None:
    env = make(backend="miniature")
    cloth = env.unwrapped
    assert repr(cloth) == "<ClothEnv Flag 9x13 miniature, before reset()>"
    assert repr(cloth.world) == "<World Flag 9x13 miniature, 1 environments, before reset()>"
    env.reset(seed=0)
    env.step(env.action_space.sample())
    assert repr(cloth) == "<ClothEnv Flag 9x13 miniature, frame 1>"
    assert str(env) == "<TimeLimit<OrderEnforcing<ClothEnv<MiniCloth-Flag-v0>>>>"
    assert repr(cloth.scene) == "<Scene Flag, 1 x 1.5 m, 9x13, frame 40 ms>"
    assert repr(cloth.task) == "<Task Flag 9x13, actions pole velocity x, pole velocity y>"


def test_a_vector_environment_tells_its_frames() -> None:
    env = gym.make_vec("MiniCloth-Flag-v0", num_envs=2, resolution=(9, 13))
    assert repr(env.unwrapped) == "<ClothVectorEnv Flag 9x13 reference, 2 environments, before reset()>"
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.reset(options={"reset_mask": np.array([True, False])})
    assert repr(env.unwrapped) == "<ClothVectorEnv Flag 9x13 reference, 2 environments, frames 0 to 1>"


def test_a_state_prints_no_arrays_and_computes_nothing() -> None:
    state = State.still(np.zeros((2, 3, 4, 5), np.float32))
    assert repr(state) == "<State of 2 x 4x5 float32, time 0 s>"
    state.time[1] = 0.5
    assert repr(state) == "<State of 2 x 4x5 float32, time 0 to 0.5 s>"
    assert repr(State.still(np.zeros((0, 3, 4, 5)))) == "<State of 0 x 4x5 float64, time none s>"

    def compute(_: State) -> np.ndarray:
        raise AssertionError

    assert repr(LazyState(state, compute, compute)) == "<LazyState of 2, not read so far, time 0 to 0.5 s>"
    lazy = LazyState(state, lambda _: state.positions, compute)
    assert lazy.positions is state.positions
    assert repr(lazy) == "<LazyState of 2, read, time 0 to 0.5 s>"


def picture(html: str) -> np.ndarray:
    found = re.search(r'src="data:image/png;base64,([^"]+)"', html)
    assert found
    return np.array(Image.open(BytesIO(base64.b64decode(found[1]))))


def test_a_notebook_shows_picture_and_numbers(tmp_path: Path) -> None:
    env = RecordRollout(make(), str(tmp_path / "a.h5"))
    cloth = env.unwrapped
    assert cloth._repr_html_() == "<div><code>&lt;ClothEnv Flag 9x13 reference, before reset()&gt;</code></div>"
    env.reset(seed=0)
    for _ in range(2):
        env.step(env.action_space.sample())
    html = cloth._repr_html_()
    assert "frame 2" in html
    assert "time 0.08 s, largest strain" in html
    assert picture(html).shape == (180, 240, 3)
    assert picture(html).std() > 10
    env.close()
    with Rollout.open(tmp_path / "a.h5") as rollout:
        assert repr(rollout) == "<Rollout Flag 9x13, 1 trajectories of 3 frames>"
        np.testing.assert_array_equal(picture(rollout._repr_html_()), picture(html))
    assert "img" not in rollout._repr_html_()  # closed


@pytest.mark.parametrize("error", [ImportError("install it"), RuntimeError("forked"), ValueError("not finite")])
def test_without_a_picture_there_is_text(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(notebook.Renderer, "draw", fail)
    env = make()
    env.reset(seed=0)
    html = env.unwrapped._repr_html_()
    assert f"no picture: {error}" in html
    assert "largest strain" in html


def test_caches_still_know_a_scene_by_all_of_it() -> None:
    scene = make().unwrapped.scene
    other = scene.with_material(scene.material.with_changes(drag=2.0))
    assert repr(scene) == repr(other)
    assert len({digest(scene), digest(other), digest([scene]), digest([other])}) == 4
