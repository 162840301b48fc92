"""Pictures follow from scene, start and state: not from the pictures before them, nor from who took them."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import AddRenderObservation

import cloth_envs
from cloth_envs.rendering import Renderer

SMALL = {"resolution": (9, 9), "disable_env_checker": True}
MODES = ["rgb_array", "depth_array"]
WAYS: dict[str, Callable[[Any], Any]] = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
}


def make(scene: str = "Flag", mode: str = "rgb_array", **options: Any) -> Any:
    return gym.make(cloth_envs.env_id(scene), render_mode=mode, **SMALL, **options)


def play(env: Any, frames: int, *, seed: int | None = None, watched: bool = False) -> np.ndarray:
    """The last picture of ``frames`` frames, after a reset if there is a seed."""
    if seed is not None:
        env.reset(seed=seed)
    for _ in range(frames):
        if watched:
            env.render()
        env.step(np.full(env.action_space.shape, 0.5))
    return env.render()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("scene", cloth_envs.SCENES)
def test_a_picture_does_not_depend_on_those_before(scene: str, mode: str) -> None:
    watched, unseen = make(scene, mode), make(scene, mode)
    play(watched, 2, seed=1, watched=True)
    once = play(unseen, 3, seed=2)
    np.testing.assert_array_equal(play(watched, 3, seed=2, watched=True), once)
    np.testing.assert_array_equal(play(unseen, 3, seed=2), once)
    assert (play(watched, 0, seed=1) != once).any()
    watched.close(), unseen.close()


def test_observations_in_pixels_are_those_of_the_seed() -> None:
    first, other = AddRenderObservation(make()), AddRenderObservation(make())  # both have drawn a random start
    seen = first.reset(seed=3)[0]
    np.testing.assert_array_equal(other.reset(seed=3)[0], seen)
    first.reset()
    first.step(first.action_space.sample())
    np.testing.assert_array_equal(first.reset(seed=3)[0], seen)
    action = np.full(first.action_space.shape, 0.5)
    np.testing.assert_array_equal(first.step(action)[0], other.step(action)[0])
    first.close(), other.close()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("way", WAYS)
def test_copies_draw_the_same(way: str, mode: str) -> None:
    env = make("Hanging", mode)
    play(env, 12, seed=4, watched=True)
    twin = WAYS[way](env)
    for _ in range(2):
        np.testing.assert_array_equal(play(env, 2), play(twin, 2))
        env.reset(), twin.reset()
    env.close(), twin.close()


@pytest.mark.parametrize("mode", MODES)
def test_a_state_is_framed_by_the_last_reset(mode: str) -> None:
    env, other = make(mode=mode), make(mode=mode)
    picture = play(env, 5, seed=5)
    play(other, 1, seed=6)
    other.reset(seed=5)
    other.unwrapped.set_state(env.unwrapped.get_state())
    np.testing.assert_array_equal(other.render(), picture)
    env.close(), other.close()


def test_a_state_without_a_reset_is_framed_by_itself() -> None:
    env, watched, unseen = make(), make().unwrapped, make().unwrapped
    env.reset(seed=7)
    state, start = env.unwrapped.get_state(), env.unwrapped.state.copy()
    play(env, 5)
    for each in (watched, unseen):
        each.set_state(state)
        if each is watched:
            each.render()
        each.set_state(env.unwrapped.get_state())
    picture = watched.render()
    np.testing.assert_array_equal(unseen.render(), picture)
    renderer = Renderer(env.unwrapped.scene)
    marks, met = env.unwrapped.world.goal(0)
    drawn = renderer.draw(env.unwrapped.state, start=start, marks=marks, met=met)
    np.testing.assert_array_equal(drawn, picture)
    for each in (env, watched, unseen, renderer):
        each.close()


def test_the_camera_that_followed_comes_back() -> None:
    env = make()
    env.reset(seed=8)
    state, far = env.unwrapped.state.copy(), env.unwrapped.state.copy()
    far.positions[:, :2] += 3.0
    renderers = [Renderer(env.unwrapped.scene, width=160, height=120) for _ in range(3)]
    for shown in (state, far):
        renderers[0].draw(shown)
    np.testing.assert_array_equal(renderers[0].draw(state), renderers[1].draw(state))
    np.testing.assert_array_equal(renderers[0].draw(far), renderers[2].draw(far, start=state))
    for renderer in renderers:
        renderer.close()


def test_another_start_keeps_the_window() -> None:
    env = make()
    env.reset(seed=0)
    renderer = Renderer(env.unwrapped.scene, views=2, captions=["a", "b"], color="strain", width=320, height=120)
    first = [env.unwrapped.state.copy()] * 2
    picture = renderer.draw(first, start=first)
    plotter, actors = renderer._canvas.plotter, len(renderer._canvas.plotter.actors)
    env.reset(seed=1)
    second = [env.unwrapped.state.copy()] * 2
    assert (renderer.draw(first, start=second) != picture).mean() > 0.02
    np.testing.assert_array_equal(renderer.draw(first, start=first), picture)
    assert renderer._canvas.plotter is plotter
    assert len(plotter.actors) == actors
    renderer.close()


def test_a_start_that_does_not_fit_is_refused() -> None:
    env = make()
    env.reset(seed=0)
    state = env.unwrapped.state.copy()
    renderer = Renderer(env.unwrapped.scene, width=160, height=120)
    picture = renderer.draw(state)
    coarse, broken = state.copy(), state.copy()
    coarse.positions = coarse.positions[..., ::2, ::2]
    broken.positions[0, 0, 0, 0] = np.nan
    for start, said in ((coarse, "another Renderer"), (broken, "not finite"), ([state, state], "2 states for 1 views")):
        with pytest.raises(ValueError, match=said):
            renderer.draw(state, start=start)
    np.testing.assert_array_equal(renderer.draw(state), picture)
    renderer.close()
