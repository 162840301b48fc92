"""Version 1 of the tasks: what of it is new, and that the rest is that of version 0."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import cloudpickle
import gymnasium as gym
import numpy as np
import pytest

import cloth_envs
from cloth_envs.registry import EPISODE_FRAMES, SCENES, load_task
from cloth_envs.scenes.ball_drop import BROUGHT, GOAL
from cloth_envs.scenes.hanging import NEARER
from cloth_envs.world import World

SMALL: dict[str, Any] = {"resolution": (13, 17)}
OTHERWISE = {"Pressure", "BallDrop"}  # whose cloth moves in another way too
scenes = pytest.mark.parametrize("scene", list(SCENES))


def world_of(scene: str, envs: int = 2) -> World:
    world = World(scene, num_envs=envs, **SMALL)
    world.reset({i: np.random.default_rng(i) for i in range(envs)})
    return world


@scenes
def test_the_cloth_moves_as_before_and_observations_end_as_before(scene: str) -> None:
    old, new = world_of(scene), world_of(f"{scene}-v1")
    rng, told = np.random.default_rng(0), len(new.task.extras) - len(new.task.actions) - len(new.task.ways)
    assert new.task.extras[-told:] == old.task.extras[:told]
    for _ in range(4):
        actions = rng.uniform(-1, 1, (2, len(old.task.actions)))
        for world in (old, new):
            world.advance(actions)
        if scene not in OTHERWISE:
            assert np.array_equal(old.state.positions, new.state.positions)
            points = 6 * len(old.task.keypoints)
            assert np.array_equal(old.observe()[:, :points], new.observe()[:, :points])
            assert np.array_equal(old.observe()[:, points : points + told], new.observe()[:, -told:])


@scenes
def test_the_last_action_is_told_and_its_change_is_priced(scene: str) -> None:
    world = world_of(f"{scene}-v1")
    first, size = 6 * len(world.task.keypoints), len(world.task.actions)
    before, rng = np.zeros((2, size)), np.random.default_rng(1)
    assert not world.observe()[:, first : first + size].any()
    for _ in range(3):
        actions = rng.uniform(-1.5, 1.5, (2, size))
        rewards, _ = world.advance(actions)
        now, told = actions.clip(-1, 1), world.told
        assert world.observe()[:, first : first + size] == pytest.approx(now, abs=1e-7)
        assert told["change"] == pytest.approx(abs(now - before).mean(1))
        assert told["reward_effort"] == pytest.approx(1 - told["change"] / 2)
        assert rewards == pytest.approx(np.prod([told[f"reward_{part}"] for part in world.task.parts], axis=0))
        before = now
    assert np.array_equal(world.task.reward(world.episode), rewards)
    world.reset({1: np.random.default_rng(5)})
    assert world.observe()[0, first : first + size] == pytest.approx(before[0], abs=1e-7)
    assert not world.observe()[1, first : first + size].any()


def test_turning_from_bound_to_bound_earns_nothing_and_staying_all() -> None:
    world = world_of("Flag-v1")
    for sign in (1, -1, 1):
        rewards, _ = world.advance(np.array([[1.0, 1.0], [sign, sign]]))
    assert rewards[1] == 0 < rewards[0] == world.told["reward_shown"][0]


def test_effort_has_no_say_in_success() -> None:
    task = world_of("Curtain-v1").task
    parts = np.array([[0.95, 0.95, 0.2], [0.95, 0.3, 0.95], [0.1, 1.0, 1.0]])
    assert task.met(parts).tolist() == [True, False, False]


@pytest.mark.parametrize("scene", ["Flag", "Flag-v1"])
def test_a_state_brings_its_last_action(scene: str) -> None:
    """So that the next frame's change is the same in it; in a copy too."""
    made, other = (gym.make(cloth_envs.env_id(scene), **SMALL) for _ in range(2))
    made.reset(seed=0)
    made.step(np.ones(2, np.float32))
    other.reset(seed=1)
    other.unwrapped.set_state(made.unwrapped.get_state())
    steps = [env.step(np.zeros(2, np.float32)) for env in (copy.deepcopy(made), other, made)]
    for observation, reward, *_, info in steps:
        assert info["change"] == 1.0
        assert reward == steps[0][1]
        assert np.array_equal(observation, steps[0][0])


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_an_episode_begins_without_an_action(mode: str) -> None:
    many = gym.make_vec("MiniCloth-Flag-v1", num_envs=2, max_episode_steps=3, autoreset_mode=mode, **SMALL)
    many.reset(seed=0)
    ones = np.ones((2, 2), np.float32)
    changes = []
    for _ in range(5):
        *_, infos = many.step(ones)
        changes.append(infos.get("final_info", infos).get("change", [None])[0])
    assert changes == ([1, 0, 0, None, 1] if mode == "NextStep" else [1, 0, 0, 1, 0])


def test_ball_drop_starts_beside_the_ball_and_ends_elsewhere() -> None:
    task = load_task("BallDrop-v1")
    made = task(task.make_scene(resolution=(13, 17), material=task.material))
    for seed in range(50):
        start = made.start(np.random.default_rng(seed))
        assert 0.35 <= np.hypot(*start.positions[:2].mean((1, 2))) <= 0.6
        assert GOAL[0] <= np.hypot(*start.memory["goal"]) <= GOAL[1]


def test_collision_tells_no_goal_for_the_ball() -> None:
    assert not [name for name in load_task("Collision-v1").extras if name.startswith("goal")]


def test_the_net_of_collision_is_where_the_cloth_should_be() -> None:
    """The ball's goal, which isn't told, isn't drawn; dots lie on the net where the cloth has its shape."""
    world = world_of("Collision-v1", 1)
    for shaped in (False, True):
        dots, net = [], []
        for mark in world.goal(0)[0]:
            assert mark.kind in ("dot", "line")
            (dots if mark.kind == "dot" else net).append(mark.points)
        corners = np.concatenate(net[:4])  # of rows
        assert len(dots) == len(corners) == 16
        off = np.concatenate(dots) - corners
        assert not off[:, [0, 2]].any()
        assert (not off.any()) == shaped
        world.episode.memory["shape"][:] = world.episode.cloth[:, 1, world.task.shaped]


def test_a_ball_behind_the_cloth_is_drawn() -> None:
    world = world_of("Hitting-v1", 1)
    circles = [mark for mark in world.goal(0)[0] if mark.kind == "line" and mark.own]
    assert len(circles) == 3
    for circle in circles:
        away = np.linalg.norm(circle.points - world.state.colliders[0, 0, 0], axis=1)
        np.testing.assert_allclose(away, world.task.radius, rtol=1e-5)


@pytest.mark.parametrize("pickler", [pickle, cloudpickle])
def test_classes_that_are_made_by_a_call_are_pickled(pickler: Any) -> None:
    """So that other processes can be asked for their ``task``, as Gymnasium's do."""
    flag = load_task("Flag-v1")
    assert pickle.loads(pickler.dumps(flag)).extras == flag.extras
    assert pickle.loads(pickle.dumps(flag)) is flag
    for scene, preset, option in (
        ("Flag", {"name": "lee2019", "mass": 3.0}, "mass"),
        ("Hitting", {"name": "chen2020", "sequence": 3}, "sequence"),
        ("Skirt", {"name": "chen2020", "tempo": 0.5}, "tempo"),
    ):
        made = World(scene, preset=preset).task
        again = pickle.loads(pickler.dumps(made))
        assert again.options == made.options
        assert again.options[option] == preset[option]
        assert made.scene.driven_by == again.scene.driven_by == ""
        assert type(again).__module__ == type(made).__module__ != "abc"


@pytest.mark.parametrize("version", ["", "-v1"])
@scenes
def test_the_docstring_tells_parts_and_extras_of_its_own_version(scene: str, version: str) -> None:
    task = load_task(scene + version)
    text = " ".join((task.__doc__ or "").split())
    assert f"On every step: {', '.join(f'`reward_{part}`' for part in task.parts)}, whose" in text
    assert f"The extras, in order: {', '.join(task.extras)}." in text
    assert f"is at least {task.enough:g};" in text
    assert ("every part but" in text) == bool(version)


def test_both_versions_have_names_ids_and_episodes() -> None:
    assert list(EPISODE_FRAMES) == [*SCENES, *(f"{name}-v1" for name in SCENES)]
    assert cloth_envs.env_id("Flag") == "MiniCloth-Flag-v0"
    assert cloth_envs.env_id("Flag-v1") == "MiniCloth-Flag-v1"
    assert load_task("Flag-v1") is load_task("Flag-v1")
    with pytest.raises(ValueError, match="Did you mean 'Flag-v1'"):
        World("MiniCloth-Flag-v1")
    with pytest.raises(ValueError, match="Flag-v1 has none: choose another preset or scene"):
        World("Flag-v1", preset="lee2019")
    with pytest.raises(ValueError, match="another scene"):
        world_of("Flag").set_state(world_of("Flag-v1").get_state())


@pytest.mark.parametrize(("scene", "near"), [("Hanging-v1", NEARER), ("BallDrop-v1", BROUGHT)])
def test_marks_show_what_is_near_enough(scene: str, near: float) -> None:
    """Where the part that the distance makes falls below what success asks for."""
    world = world_of(scene)
    middle = world.task.middle(world.episode)
    for away, enough in ((0.99 * near, True), (1.01 * near, False)):
        goal = world.episode.memory["goal"]
        goal[:] = middle[:, : goal.shape[1]]
        goal[:, 0] += away
        assert ((world.task.score(world.episode)[1] >= world.task.enough) == enough).all()
