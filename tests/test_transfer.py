"""``minicloth bench transfer``: the search finds optima, policies are scored fairly, rows say what was earned."""

from __future__ import annotations

import csv
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import gymnasium as gym
import numpy as np
import pytest
import torch
from scipy.stats import t as student

import cloth_envs
from cloth_envs.registry import SCENES
from cloth_envs.world import World
from training.bench.transfer import ppo
from training.bench.transfer import run as transfer
from training.bench.transfer.policies import FIRST_SEED, FORMS, cma_es, train
from training.bench.transfer.results import (
    CMA_ES,
    PPO,
    RANDOM,
    REFERENCE,
    ZERO,
    EpisodeRow,
    TrainingRow,
    half_width,
    summaries,
    table,
)
from training.rollouts import play


def small(members: int, scene: str = "Flag") -> World:
    return World(scene, num_envs=members, resolution=(5, 7))


@pytest.mark.parametrize("seed", range(3))
def test_the_search_finds_the_top_of_a_ridge(seed: int) -> None:
    """Axes' curvatures from 1 to 1000: without learning their ratio, 200 generations of 9 stay far away."""
    curvature = 10.0 ** np.linspace(0, 3, 6)
    top = cma_es(lambda x, _: -(curvature * (x - 1) ** 2).sum(1), 6, population=9, generations=200, seed=seed)
    np.testing.assert_allclose(top, 1, atol=1e-3)


@pytest.mark.parametrize("scene", list(SCENES))
def test_policies_act_within_bounds_and_nothing_weighs_nothing(scene: str) -> None:
    world, form = World(scene, num_envs=3, resolution=(9, 9)), FORMS[scene]
    world.reset({i: np.random.default_rng(i) for i in range(3)})
    obs = world.observe()
    assert not form.act(obs, np.zeros((3, form.size))).any()
    weights = np.random.default_rng(0).normal(size=(3, form.size))
    actions = form.act(obs, weights)
    assert actions.shape == (3, len(world.task.actions))
    assert np.isfinite(actions).all()
    # Every weight counts somewhere: moving ones (a start at rest has features that are zero).
    obs = obs + np.random.default_rng(1).normal(size=obs.shape)
    actions = form.act(obs, weights)
    for i in range(form.size):
        changed = weights.copy()
        changed[:, i] += 0.1
        assert (form.act(obs, changed) != actions).any()
    # Members do not see each other.
    np.testing.assert_allclose(form.act(obs[1:2], weights[1:2]), actions[1:2], rtol=1e-6, atol=1e-7)


def test_the_flag_s_policy_turns_with_the_world() -> None:
    rng = np.random.default_rng(0)
    obs, weights = rng.normal(size=(4, 128)), rng.normal(size=(4, FORMS["Flag"].size))
    obs[:, -2:] /= np.linalg.norm(obs[:, -2:], axis=1, keepdims=True)
    turned = obs.copy()
    fields, seen = turned[:, :120].reshape(4, 2, 3, 20), obs[:, :120].reshape(4, 2, 3, 20)
    fields[:, :, 0], fields[:, :, 1] = -seen[:, :, 1], seen[:, :, 0]  # a quarter turn; x, y -> -y, x
    turned[:, 120::2], turned[:, 121::2] = -obs[:, 121::2], obs[:, 120::2]
    before, after = (FORMS["Flag"].act(o, weights) for o in (obs, turned))
    np.testing.assert_allclose(after, np.stack([-before[:, 1], before[:, 0]], 1), rtol=1e-9, atol=1e-12)


def test_earnings_are_those_of_the_environment() -> None:
    found, failed = play(small(2), lambda obs: np.full((2, 2), 0.5), [3, 5], 6)
    env = gym.make(cloth_envs.env_id("Flag"), resolution=(5, 7))
    for seed, value in zip((3, 5), found, strict=True):
        env.reset(seed=seed)
        assert value == pytest.approx(np.mean([float(env.step(np.full(2, 0.5))[1]) for _ in range(6)]), rel=1e-12)
    env.close()
    assert not failed.any()


def test_a_failed_episode_earns_nothing_more() -> None:
    class Breaking:
        frame = 0

        def reset(self, rngs: Any) -> None:
            self.frame = 0

        def observe(self) -> np.ndarray:
            return np.zeros((2, 1))

        def step(self, actions: np.ndarray) -> tuple[np.ndarray, list[str | None]]:
            self.frame += 1
            return np.ones(2), ["overstretch" if self.frame == 3 else None, None]

    found, failed = play(Breaking(), lambda obs: obs, [0, 1], 8)  # type: ignore[arg-type]
    assert found.tolist() == [2 / 8, 1]
    assert failed.tolist() == [True, False]


def test_training_is_repeatable_and_plays_no_held_out_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    played: list[int] = []

    def watched(world: World, act: Any, seeds: Any, frames: int) -> Any:
        played.extend(seeds)
        return play(world, act, seeds, frames)

    monkeypatch.setattr("training.bench.transfer.policies.play", watched)
    options = {"frames": 3, "generations": 2, "population": 4, "seed": 1}
    runs = [train(small(8), FORMS["Flag"], **options) for _ in range(2)]
    np.testing.assert_array_equal(*runs)
    assert np.abs(runs[0]).max() > 0
    # Two seeds a generation, the same for its four candidates.
    assert played[:16] == [2 * FIRST_SEED, 2 * FIRST_SEED + 1] * 4 + [2 * FIRST_SEED + 2, 2 * FIRST_SEED + 3] * 4
    assert min(played) > max(transfer.HELD_OUT)


def test_intervals() -> None:
    """With one kind of variation it is Student's; two independent ones of equal size add up."""
    x = np.array([1.0, 2.0, 4.0, 7.0])
    alone = student.ppf(0.975, 3) * x.std(ddof=1) / 2
    assert half_width(x) == pytest.approx(alone)
    assert half_width(x, np.array([5.0])) == pytest.approx(alone)  # one training tells no spread
    assert half_width(x, x) == pytest.approx(student.ppf(0.975, 6) * x.std(ddof=1) / 2 * np.sqrt(2))
    assert half_width(np.ones(3)) == 0


def test_a_policy_that_exploits_its_surrogate_is_shown() -> None:
    def rows(policy: str, on: str, reward: float) -> list[EpisodeRow]:
        return [EpisodeRow("Flag", 5, 7, policy, k, on, s, reward, 0) for k in range(2) for s in range(3)]

    episodes = rows(ZERO, REFERENCE, 0.1) + rows(REFERENCE, REFERENCE, 0.6)
    episodes += rows("similar x4", REFERENCE, 0.2) + rows("similar x4", "similar x4", 0.9)
    trainings = [TrainingRow("Flag", 5, 7, "similar x4", k, 160, 50, 1.0 + k, 2.0 + k, "1 2") for k in range(2)]
    found = {row.policy: row for row in summaries(trainings, episodes)}
    bad = found["similar x4"]
    assert (bad.reference, bad.own, bad.trainings, bad.processor_s) == (0.2, 0.9, 2, 2.5)
    assert bad.flattery == pytest.approx(0.7)
    assert bad.gap == pytest.approx((0.2 - 0.6) / (0.6 - 0.1))
    assert (found[REFERENCE].gap, found[ZERO].gap) == (0, -1)
    assert "+0.700" in table(list(found.values()))


def test_gaps_are_within_a_learner() -> None:
    """Beside the reference's policy of the same learner, whatever another one earns."""
    told = {
        (CMA_ES, ZERO): 0.1,
        (CMA_ES, REFERENCE): 0.6,
        (CMA_ES, "miniature x4"): 0.5,
        (PPO, REFERENCE): 0.3,
        (PPO, "miniature x4"): 0.2,
    }
    episodes = [
        EpisodeRow("Flag", 5, 7, policy, k, REFERENCE, s, reward, 0, learner)
        for (learner, policy), reward in told.items()
        for k in range(2)
        for s in range(3)
    ]
    gaps = {(row.learner, row.policy): row.gap for row in summaries([], episodes)}
    assert gaps[CMA_ES, "miniature x4"] == pytest.approx(-0.1 / 0.5)
    assert gaps[PPO, "miniature x4"] == pytest.approx(-0.1 / 0.2)


def test_generalised_advantages_by_hand() -> None:
    """Two frames; the second member is over after the first: neither later reward nor later value counts for it."""
    rewards, alive = torch.tensor([[1.0, 1.0], [2.0, 9.0]]), torch.tensor([[1.0, 0.0], [1.0, 0.0]])
    values = torch.tensor([[0.5, 0.5], [1.0, 7.0], [4.0, 7.0]])
    last = 2 + 0.5 * 4 - 1
    found = ppo.advantages(rewards, values, alive, 0.5, 0.5)
    assert found[:, 0].tolist() == [1 + 0.5 * 1 - 0.5 + 0.25 * last, last]
    assert found[0, 1] == 1 - 0.5


def test_running_moments_are_those_of_all_rows() -> None:
    rows = np.random.default_rng(0).normal(3, 2, (40, 2))
    seen = ppo.Running(2)
    for part in np.split(rows, [7, 8, 30]):
        seen.add(torch.as_tensor(part))
    np.testing.assert_allclose(seen.mean, rows.mean(0))
    np.testing.assert_allclose(seen.spread, rows.std(0), rtol=1e-6)


class Follow:
    """A world without cloth: reward 1 less the distance of the action from what is observed."""

    num_envs, frame, device = 16, 0, None

    def __init__(self) -> None:
        self.task, self.scene = SimpleNamespace(actions=["x"]), SimpleNamespace(frame_dt=0.04)

    def reset(self, rngs: Any) -> None:
        self.wanted = np.array([rng.uniform(-0.8, 0.8) for rng in rngs.values()])

    def observe(self) -> np.ndarray:
        return self.wanted[:, None]

    def read(self, actions: np.ndarray) -> np.ndarray:
        return actions

    def advance(self, actions: np.ndarray) -> tuple[np.ndarray, dict[int, str]]:
        return 1 - abs(actions[:, 0] - self.wanted), {}


def test_ppo_learns_and_is_repeatable() -> None:
    """It is off by less than half of what no action is, 0.44 in the mean of these."""
    agents = [ppo.train(Follow(), ppo.Recipe(updates=15, epochs=15), frames=25, seed=1) for _ in range(2)]  # type: ignore[arg-type]
    wanted = np.linspace(-0.8, 0.8, 9)
    first, second = (agent.act(wanted[:, None])[:, 0] for agent in agents)
    np.testing.assert_array_equal(first, second)
    assert abs(first - wanted).mean() < 0.22
    assert agents[0].act(np.array([[50.0]])) <= 1


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    few = [p for p in transfer.TRANSFER if p.label in (REFERENCE, "miniature x4")]
    monkeypatch.setattr(transfer, "TRANSFER", few)
    monkeypatch.setattr(transfer, "NETWORKS", [p.label for p in few])
    argv = ["--quick", "--out", str(tmp_path), "--backend", 'miniature={"factor": 3}']
    assert transfer.BENCHMARK.main(argv) == 0
    assert "QUICK" in capsys.readouterr().out
    with (tmp_path / "transfer.csv").open(newline="") as file:
        found = [(row["policy"], row["learner"]) for row in csv.DictReader(line for line in file if line[0] != "#")]
    trained = [REFERENCE, "miniature x4", "miniature x3"]
    assert found == [
        (name, learner) for learner in (CMA_ES, PPO) for name in [ZERO, RANDOM] * (learner == CMA_ES) + trained
    ]
    tables = {path.name: path.read_text() for path in tmp_path.glob("*.csv")}
    assert transfer.BENCHMARK.main(argv) == 0  # nothing is measured twice
    assert {path.name: path.read_text() for path in tmp_path.glob("*.csv")} == tables
    assert transfer.BENCHMARK.main(["--chart-only", "--out", str(tmp_path), "--images", str(tmp_path / "images")]) == 0
    assert ElementTree.parse(tmp_path / "images" / "transfer.svg").getroot().tag.endswith("svg")
    with pytest.raises(ValueError, match="--out"):
        transfer.BENCHMARK.main(["--chart-only"])
