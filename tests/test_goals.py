"""Goals in pictures: every scene's, seen by their colours; of vector environments; under a caption."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import imageio.v2 as imageio
import numpy as np
import pytest

import cloth_envs
from cloth_envs import EPISODE_FRAMES
from cloth_envs.commands.outputs import fixed_camera
from cloth_envs.commands.rollout import rollout
from cloth_envs.marks import Mark, ghost
from cloth_envs.presets import PRESETS
from cloth_envs.rendering import Renderer
from cloth_envs.rendering.canvas import CAPTION_HEIGHT
from cloth_envs.rendering.framing import VIEW_ANGLE
from cloth_envs.world import World

SMALL: dict[str, Any] = {"resolution": (13, 17), "disable_env_checker": True, "render_mode": "rgb_array"}


def coloured(picture: np.ndarray, met: bool) -> int:
    """Pixels of the violet of a goal, or of the green of one that is met."""
    red, green, blue = (picture[..., i].astype(int) for i in range(3))
    return int(((green > red + 45) & (green > blue + 25) if met else (blue > green + 60) & (red > green + 20)).sum())


@pytest.mark.parametrize("scene", EPISODE_FRAMES)
def test_every_goal_is_seen_and_turns_green(scene: str, monkeypatch: pytest.MonkeyPatch) -> None:
    env: Any = gym.make(cloth_envs.env_id(scene), **SMALL)
    env.reset(seed=0)
    task = env.unwrapped.task
    monkeypatch.setattr(type(task), "enough", 1.1)
    missed = env.render()
    monkeypatch.setattr(type(task), "enough", 0.0)
    met = env.render()
    monkeypatch.setattr(env.unwrapped, "show_goal", False)
    bare = env.render()
    env.close()
    assert coloured(missed, False) > 60 > 5 > coloured(bare, False)
    assert coloured(met, True) > 60 > 5 > coloured(bare, True)


@pytest.mark.parametrize(("preset", "scene"), [(p, s) for p, of in PRESETS.items() for s in of])
def test_presets_have_marks_of_their_own_goal(preset: str, scene: str) -> None:
    world = World(scene, preset=preset)
    world.reset({0: np.random.default_rng(0)})
    marks, met = world.goal(0)
    assert marks
    assert all(np.isfinite(mark.points).all() and mark.points.shape[1:] == (3,) for mark in marks)
    assert type(met) is bool


def test_a_curtains_mark_spans_what_is_measured() -> None:
    """From the fixed side's mean, which swings away from 0, over as much as is to be covered."""
    world = World("Curtain", resolution=(13, 17))
    world.reset({0: np.random.default_rng(8000)})
    for _ in range(30):
        world.step(np.array([[-1.0, 1.0]]))
    (begin, end, _), covered = world.goal(0)[0][0].points[:, 0], world.task.covered(world.episode)[0]
    width, edges = world.scene.grid.width, world.state.positions[0, 0][:, [0, -1]]
    ours = edges[np.unique(world.task.keypoints // world.scene.grid.cols)].mean(0)
    assert begin == pytest.approx(ours[0], abs=1e-6)
    assert abs(begin) > 1e-3
    assert end - begin == pytest.approx(world.episode.memory["target"][0] * width)
    assert ours[1] - end == pytest.approx((covered - world.episode.memory["target"][0]) * width, abs=1e-6)


def test_marks_of_another_kind_take_the_place_of_the_last() -> None:
    world = World("Hanging", resolution=(13, 17))
    world.reset({0: np.random.default_rng(0)})
    renderer, at = Renderer(world.scene), world.state.positions[0].mean((1, 2))[None]
    ghost, line = Mark("ghost", at, radius=0.2), Mark("line", np.concatenate([at, at + 0.3]))
    first, other, again = (renderer.draw(world.state, marks=[mark]) for mark in (ghost, line, ghost))
    bare = renderer.draw(world.state)
    renderer.close()
    assert np.array_equal(first, again)
    assert (first != other).any()
    assert coloured(other, False) > 60 > 5 > coloured(bare, False)


def test_depth_shows_no_marks() -> None:
    world = World("Hanging", resolution=(13, 17))
    world.reset({0: np.random.default_rng(0)})
    renderer = Renderer(world.scene)
    before = renderer.depth(world.state)
    renderer.draw(world.state, marks=world.goal(0)[0])
    np.testing.assert_array_equal(renderer.depth(world.state), before)
    renderer.close()


def test_members_of_a_vector_environment_are_drawn_as_each_alone() -> None:
    many: Any = gym.make_vec(
        cloth_envs.env_id("Hitting"), num_envs=2, render_mode="rgb_array", resolution=(13, 17),
        max_episode_steps=2, autoreset_mode="SameStep",
    )  # fmt: skip
    many.reset(seed=0)
    first = many.render()
    assert [picture.shape for picture in first] == [(240, 320, 3)] * 2
    assert (first[0] != first[1]).any()
    for _ in range(3):
        many.step(np.ones(many.action_space.shape, np.float32))
    member = World("Hitting", resolution=(13, 17))
    many.reset(seed=[None, 7], options={"reset_mask": np.array([False, True])})
    member.reset({0: gym.utils.seeding.np_random(7)[0]})
    marks, met = member.goal(0)
    renderer = Renderer(member.scene, width=320, height=240)
    np.testing.assert_array_equal(
        many.render()[1], renderer.draw(member.state, start=member.state, marks=marks, met=met)
    )
    renderer.close()
    many.close()


def test_a_caption_tells_reward_and_success(tmp_path: Path) -> None:
    said = {}
    for caption in (True, False):
        folder = tmp_path / str(caption)
        said[caption] = rollout(
            "Hanging", frames=1, seed=0, policy="controller", video=None, images=str(folder), hdf5=None, strain=False,
            overwrite=False, caption=caption, resolution=(13, 17),
        )  # fmt: skip
    assert ", no success at the end" in said[True]
    pictures = [imageio.imread(tmp_path / name / "frame_00001.png") for name in ("True", "False")]
    lower = [picture[-34:].astype(int) for picture in pictures]
    assert (lower[0].max(2) < 90).sum() > 100 > (lower[1].max(2) < 90).sum()  # letters


def test_a_goal_is_inside_the_pictures_of_a_rollout() -> None:
    """Above the caption, as what the cloth does is; a ghost with its radius."""
    world = World("Hanging", resolution=(13, 17))
    world.reset({0: np.random.default_rng(0)})
    goal, radius, below = np.array([2.0, 1.0, -2.0]), 0.3, 0.1
    marks = [ghost(goal, radius)]
    camera = fixed_camera(world.scene, [[world.state]], aspect=4 / 3, below=below, marks=marks)
    towards = camera.towards / np.linalg.norm(camera.towards)
    right = np.cross(camera.up, towards)
    seen = goal + radius * np.array([[0, 0, 0], right, -right, camera.up, np.negative(camera.up)]) - camera.position
    tall = np.tan(np.deg2rad(VIEW_ANGLE / 2)) * -(seen @ towards)
    assert (abs(seen @ right) <= 4 / 3 * tall).all()
    assert (seen @ np.array(camera.up) <= tall).all()
    assert (seen @ np.array(camera.up) >= (2 * below - 1) * tall).all()


def test_the_wind_s_arrow_lies_above_the_caption() -> None:
    """It stays near the camera where the pole is walked away from it."""
    world = World("Flag", resolution=(13, 17))
    world.reset({0: np.random.default_rng(0)})
    near, far = world.state.copy(), world.state.copy()
    towards = fixed_camera(world.scene, [[near]], aspect=4 / 3).towards[:2]
    towards /= np.linalg.norm(towards)
    far.positions[:, :2] -= 3 * towards[:, None, None]
    near.wind[:, :2] = far.wind[:, :2] = 4 * towards
    camera = fixed_camera(world.scene, [[near, far]], aspect=4 / 3, below=CAPTION_HEIGHT / 480)
    renderer = Renderer(world.scene, camera=camera, captions=["reward"])
    picture = [renderer.draw(state).astype(int) for state in (near, far)][1]
    renderer.close()
    arrow = picture[..., 2] - picture[..., 0] > 80
    assert arrow.sum() > 200
    assert not arrow[-CAPTION_HEIGHT:].any()


def test_the_longest_caption_fits(tmp_path: Path) -> None:
    rollout(
        "BallDrop-v1", frames=1, seed=0, policy="zero", video=None, images=str(tmp_path), hdf5=None, strain=False,
        overwrite=False, caption=True, resolution=(13, 17),
    )  # fmt: skip
    letters = imageio.imread(tmp_path / "frame_00001.png")[-34:].astype(int).max(2) < 90
    assert letters.any()
    assert not letters[:, :8].any()
    assert not letters[:, -8:].any()


def test_new_captions_need_room() -> None:
    world = World("Hanging", resolution=(13, 17))
    world.reset({0: np.random.default_rng(0)})
    with pytest.raises(ValueError, match="new captions take the place"):
        Renderer(world.scene).draw(world.state, captions=["now"])


def test_a_state_set_before_any_reset_frames_the_pictures_of_members() -> None:
    many: Any = [
        gym.make_vec(cloth_envs.env_id("Hanging"), num_envs=2, render_mode="rgb_array", resolution=(13, 17))
        for _ in range(2)
    ]
    source = gym.make_vec(cloth_envs.env_id("Hanging"), num_envs=2, resolution=(13, 17))
    source.reset(seed=8000)
    for looked, each in zip((True, False), many, strict=True):
        each.set_state(source.get_state())
        if looked:
            each.render()
        for _ in range(40):
            each.step(np.ones(each.action_space.shape, np.float32))
    one, other = (each.render() for each in many)
    assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
    for each in many:
        each.close()


def test_an_unknown_policy_of_a_rollout_is_told_of_controllers() -> None:
    with pytest.raises(ValueError, match="Did you mean 'controller'"):
        rollout(
            "Hanging", frames=1, seed=0, policy="controler", video=None, images=None, hdf5=None, strain=False,
            overwrite=False,
        )  # fmt: skip
