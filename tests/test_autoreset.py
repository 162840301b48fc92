"""The three modes of ``make_vec`` against single environments that are reset by hand, bit for bit, on all backends."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import DictInfoToList

import cloth_envs
from cloth_envs.failure import Failures

N, LIMIT, FRAMES, SEED = 3, 6, 14, 1  # members; frames of an episode; frames stepped; first seed
NEXT, SAME, DISABLED = AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED
SMALL = {"resolution": (13, 9), "randomize": {"areal_density": [0.15, 0.3]}, "max_episode_steps": LIMIT}
# Scene and backend, and the strain at which some members fail and others reach LIMIT: on 9 x 13 vertices chance, of the
# miniature's three 0.117, 0.138 and 0.101.
Case = tuple[str, dict[str, Any], float]
LOCAL = {"scaling": "closure", "upscaler": "local"}
CASES: dict[str, Case] = {
    "explicit": ("Flag", {}, 0.05),
    "admm": ("Flag", {"backend_kwargs": {"solver": "admm"}}, 0.022),
    "implicit": ("Flag", {"backend_kwargs": {"solver": "implicit"}}, 0.045),
    "miniature": ("Flag", {"backend": "miniature", "backend_kwargs": LOCAL, "resolution": (9, 13)}, 0.06),
    "bicubic": ("Curtain", {"backend": "miniature", "backend_kwargs": {"upscaler": "bicubic"}}, 0.3),
    "cnn": ("Flag", {"backend": "cnn"}, 0.05),
    "torch": ("Flag", {"backend": "cnn", "backend_kwargs": {"engine": "torch"}, "resolution": (4, 5)}, 0.045),
    "own": ("Curtain", {"backend": "own_backend:Springs", "randomize": None}, 0.025),
    "mixed": (
        "Flag",
        {
            "backend": ["miniature", "reference", "miniature"],
            "backend_kwargs": [LOCAL, {"dtype": "float64"}, LOCAL],
            "resolution": (9, 13),
        },
        0.06,
    ),
    "many": (
        "Curtain",
        {"backend": ["reference", "miniature", "cnn"], "backend_kwargs": [{"solver": "admm"}, {"factor": 4}, None]},
        0.03,
    ),
    "Curtain": ("Curtain", {}, 0.025),
    "Collision": ("Collision", {}, 0.03),
    "Pressure": ("Pressure", {}, 0.03),
    "Hanging": ("Hanging", {}, 0.14),
    "BallDrop": ("BallDrop", {}, 0.002),
}


def frail(env: Any, strain: float) -> Any:
    """``env``, which ends an episode as overstretched beyond ``strain``."""
    env.unwrapped.world.failures = Failures(env.unwrapped.scene, strain)
    return env


class ByHand:
    """What Gymnasium's rules make of single environments."""

    def __init__(self, case: Case, mode: AutoresetMode) -> None:
        scene, options, strain = case
        own = [{n: o[i] if isinstance(o, list) else o for n, o in options.items()} for i in range(N)]
        self.envs = [frail(gym.make(cloth_envs.env_id(scene), **SMALL | o), strain) for o in own]
        self.mode, self.ended = mode, [False] * N

    def step(self, actions: np.ndarray) -> list[list[Any]]:
        """Observation, reward, terminated, truncated and info of every member."""
        answers = []
        for i, env in enumerate(self.envs):
            if self.ended[i] and self.mode is NEXT:
                observation, info = env.reset()
                answers.append([observation, 0.0, False, False, info])
            else:
                answers.append(list(env.step(actions[i])))
            self.ended[i] = answers[i][2] or answers[i][3]
            if self.ended[i] and self.mode is SAME:
                final = {"final_obs": answers[i][0], "final_info": answers[i][4]}
                answers[i][0], info = env.reset()
                answers[i][4] = final | info
        return answers

    def reset(self, which: np.ndarray, seed: int | None = None) -> tuple[list[np.ndarray], list[dict[str, Any]]]:
        """Observations of those, and infos of all."""
        seeds = [None if seed is None else seed + i for i in range(N)]
        answers = [env.reset(seed=seeds[i]) if which[i] else (None, {}) for i, env in enumerate(self.envs)]
        return [found for found, _ in answers if found is not None], [info for _, info in answers]


@pytest.fixture(autouse=True)
def examples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "examples")
    monkeypatch.setattr("cloth_envs.registry.BACKENDS", dict(cloth_envs.BACKENDS))
    monkeypatch.delitem(sys.modules, "own_backend", raising=False)


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.value)
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_members_are_single_environments(case: Case, mode: AutoresetMode) -> None:
    scene, options, strain = case
    many = gym.make_vec(cloth_envs.env_id(scene), num_envs=N, autoreset_mode=mode.value, **SMALL | options)
    many, ones = DictInfoToList(frail(many, strain)), ByHand(case, mode)
    first, infos = many.reset(seed=SEED)
    alone, told = ones.reset(np.ones(N, bool), SEED)
    assert np.array_equal(first, alone)
    assert list(infos) == told
    rng = np.random.default_rng(0)
    failures = truncations = 0
    for _ in range(FRAMES):
        actions = rng.choice([-1.0, 1.0], many.action_space.shape).astype(np.float32)
        found, rewards, terminated, truncated, infos = many.step(actions)
        for i, (observation, reward, *flags, info) in enumerate(ones.step(actions)):
            assert np.array_equal(found[i], observation)
            assert rewards[i] == reward
            assert [terminated[i], truncated[i]] == flags
            assert infos[i].keys() == info.keys()
            if "final_obs" in info:
                assert np.array_equal(infos[i]["final_obs"], info["final_obs"])
                assert infos[i]["final_info"] == info["final_info"]
            else:
                assert infos[i] == info
        failures, truncations = failures + terminated.sum(), truncations + (truncated & ~terminated).sum()
        ended = terminated | truncated
        if mode is DISABLED and ended.any():
            found, infos = many.reset(options={"reset_mask": ended})
            alone, told = ones.reset(ended)
            assert np.array_equal(found[ended], alone)
            assert list(infos) == told
    assert failures > 0
    assert truncations > 0
    assert failures + truncations > N  # some are in their third episode
