"""What ``info`` tells of a step, and the material as an observation."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import cloth_envs
from cloth_envs import EPISODE_FRAMES
from cloth_envs.policies import CONTROLLERS
from cloth_envs.scenes.flag import Flag
from cloth_envs.scenes.measures import tolerance, within
from cloth_envs.scenes.task import Episode
from cloth_envs.world import World

SMALL: dict[str, Any] = {"resolution": (13, 17)}
RANGES = {"areal_density": [0.15, 0.3], "drag": [0.2, 0.4]}
# Of each scene's docstring: the distance at which the reward's first part has fallen to a tenth.
MARGIN = {
    "Curtain": 0.3, "Collision": 0.2, "Pressure": 0.05, "Hanging": 0.5, "BallDrop": 0.35, "Draping": 0.5,
    "Hitting": 0.25, "Skirt": 0.025,
}  # fmt: skip
# The reward's first part at a distance, where it is made in another way.
FIRST: dict[str, Callable[[float], float]] = {
    "Flag": lambda away: 1 - away,
    "Flag-v1": lambda away: 1 - away,
    "Curtain-v1": lambda away: (0.1 ** ((away / 0.8) ** 2) + 0.1 ** ((away / 0.22) ** 2)) / 2,
    "Hanging-v1": lambda away: (0.1 ** (away**2) + 0.1 ** ((away / 0.25) ** 2)) / 2,
    "BallDrop-v1": lambda away: 0.25 + 0.75 * 0.1 ** ((away / 0.5) ** 2),
}
scenes = pytest.mark.parametrize("scene", EPISODE_FRAMES)


def made(scene: str, **options: Any) -> Any:
    return gym.make(cloth_envs.env_id(scene), disable_env_checker=True, **SMALL | options)


@scenes
def test_parts_make_the_reward_and_the_distance_its_first(scene: str) -> None:
    env = made(scene)
    task = env.unwrapped.task
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        for _ in range(6):
            observation, reward, *_, info = env.step(np.clip(CONTROLLERS[scene](observation), -1, 1))
            parts = [info[f"reward_{name}"] for name in task.parts]
            assert info.keys() == {f"reward_{n}" for n in task.parts} | {"success", "distance", "strain", "change"}
            assert all(type(value) is (bool if name == "success" else float) for name, value in info.items())
            assert reward == np.prod(parts)
            goal = parts[:-1] if scene.endswith("-v1") else parts
            assert info["success"] == all(part >= task.enough for part in goal)
            away = info["distance"]
            first = FIRST.get(scene, lambda far: 0.1 ** ((far / MARGIN[scene.removesuffix("-v1")]) ** 2))
            assert parts[0] == pytest.approx(first(away), rel=1e-6, abs=1e-12)
            assert -1 < info["strain"] < task.max_strain


def test_what_is_near_enough_earns_nine_tenths() -> None:
    for margin in (0.025, 0.5):
        assert tolerance(np.array([within(margin)]), margin) == pytest.approx(0.9)


def test_success_is_every_part_at_once() -> None:
    task = World("Curtain").task
    parts = np.array([[0.95, 0.95, 0.2], [0.95, 0.3, 0.95]])
    assert task.met(parts).tolist() == [True, False, False]


@pytest.mark.parametrize("frames", [7, 30])
def test_an_episodes_end_tells_its_final_second(frames: int) -> None:
    """Of 25 frames of 40 ms, or of all, where there are less; in single and vector environments."""
    single = made("Flag", max_episode_steps=frames)
    many = gym.make_vec(
        cloth_envs.env_id("Flag"), num_envs=2, max_episode_steps=frames, autoreset_mode="SameStep", **SMALL
    )
    single.reset(seed=1)
    many.reset(seed=0)
    for episode in range(2):
        rewards = []
        for frame in range(frames):
            _, reward, _, truncated, info = single.step(np.ones(2, np.float32))
            assert reward == np.prod([value for name, value in info.items() if name.startswith("reward_")])
            *_, infos = many.step(np.ones((2, 2), np.float32))
            rewards.append(reward)
            assert truncated == ("final_second" in info) == (frame == frames - 1)
        assert info["final_second"] == pytest.approx(np.mean(rewards[-25:]), rel=1e-12)
        assert infos["final_info"]["final_second"][1] == info["final_second"]
        single.reset()
        assert episode or rewards[-1] != rewards[0]


def test_a_copy_goes_on_with_its_last_second() -> None:
    env = made("Flag", max_episode_steps=9)
    env.reset(seed=0)
    for _ in range(5):
        env.step(np.ones(2, np.float32))
    twin = copy.deepcopy(env)
    for _ in range(4):
        (*_, one), (*_, other) = (e.step(np.ones(2, np.float32)) for e in (env, twin))
    assert one == other
    assert "final_second" in one


class Half(Flag):
    def reward(self, episode: Episode) -> np.ndarray:
        return 0.5 * super().reward(episode)


def test_a_reward_of_ones_own_has_no_parts_of_another() -> None:
    world, plain = World(Half, **SMALL), World("Flag", **SMALL)
    for each in (world, plain):
        each.reset({0: np.random.default_rng(0)})
        each.step(np.zeros((1, 2)))
    assert world.told.keys() == {"distance", "strain", "change"}
    assert world.rewards == 0.5 * plain.rewards


def test_a_task_with_neither_reward_nor_score_is_refused() -> None:
    class Nothing(Half):
        reward = cloth_envs.scenes.task.Task.reward
        score = cloth_envs.scenes.task.Task.score

    world = World(Nothing, **SMALL)
    world.reset({0: np.random.default_rng(0)})
    with pytest.raises(NotImplementedError, match="Nothing needs a score, or a reward"):
        world.step(np.zeros((1, 2)))


@scenes
def test_the_material_is_told_and_observed(scene: str) -> None:
    env, plain = made(scene, randomize=RANGES, observe_material=True), made(scene, randomize=RANGES)
    n, k = plain.observation_space.shape[0], len(env.unwrapped.task.extras)
    for seed in range(3):
        (seen, info), (without, _) = (e.reset(seed=seed) for e in (env, plain))
        material = env.unwrapped.world.materials[0]
        assert info["material"] == {name: getattr(material, name) for name in RANGES}
        assert env.observation_space.contains(seen)
        placed = [(info["material"][name] - low) / (high - low) * 2 - 1 for name, (low, high) in RANGES.items()]
        assert seen[n - k : n - k + 2] == pytest.approx(placed, abs=1e-6)
        assert np.array_equal(np.delete(seen, [n - k, n - k + 1]), without)
        assert np.array_equal(CONTROLLERS[scene](seen), CONTROLLERS[scene](without))
        assert env.step(env.action_space.sample())[4]["material"] == info["material"]


def test_the_material_is_a_part_of_mesh_observations() -> None:
    env = made("Flag", randomize=RANGES, observe_material=True, obs="mesh")
    seen, _ = env.reset(seed=0)
    assert seen.keys() == {"mesh", "task", "material"}
    assert env.observation_space.contains(seen)


def test_a_state_brings_its_material() -> None:
    options = {"randomize": RANGES, "observe_material": True}
    env, other = made("Flag", **options), made("Flag", **options)
    env.reset(seed=0)
    other.reset(seed=1)
    other.unwrapped.set_state(env.unwrapped.get_state())
    (one, *_, info), (two, *_, told) = (e.step(np.zeros(2, np.float32)) for e in (env, other))
    assert np.array_equal(one, two)
    assert info == told


def test_observing_what_does_not_vary_is_refused() -> None:
    with pytest.raises(ValueError, match="observe_material=True needs randomize"):
        made("Flag", observe_material=True)
