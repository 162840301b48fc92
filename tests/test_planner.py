"""The planner: what it tries leaves the world as it is, and what it does pays; ``minicloth bench tasks``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cloth_envs.policies import CONTROLLERS
from cloth_envs.world import World
from training.bench.tasks import BENCHMARK, TaskRow
from training.planner import Budget, Planner, repeated
from training.rows import read_rows

X4 = {"backend": "miniature", "backend_kwargs": {"factor": 4}}
BUDGET = Budget(members=8, horizon=8)


def begun(scene: str) -> World:
    world = World(scene, **X4)
    world.reset({0: np.random.default_rng(3)})
    return world


def test_planning_changes_nothing_and_is_the_same_again() -> None:
    world = begun("Flag-v1")
    before = world.get_state()
    plans = [Planner("Flag-v1", budget=BUDGET)(world) for _ in range(2)]
    assert np.array_equal(*plans)
    assert (abs(plans[0]) <= 1).all()
    after = world.get_state()
    assert all(np.array_equal(before[name], after[name]) for name in before)


def test_a_plan_of_a_true_model_earns_what_it_promised() -> None:
    """The plan without noise, played in the world, earns what its member did in the model, to rounding of lanes."""
    world, planner = begun("Pressure-v1"), Planner("Pressure-v1", budget=BUDGET)
    for _ in range(3):
        world.advance(planner(world))
    planner.model.set_state(repeated(world.get_state(), BUDGET.members))
    plans, earned = planner._tried()
    rewards = [world.advance(action[None])[0][0] for action in plans[0]]
    assert np.mean(rewards) == pytest.approx(earned[0], abs=1e-6)


def test_it_earns_more_than_the_controller_where_looking_ahead_pays() -> None:
    """On the flag, whose controller is a habit: half a second of plans, over 25 frames."""
    earned = {}
    for who in ("planner", "controller"):
        world, planner, total = begun("Flag"), Planner("Flag", budget=Budget(12, 12)), 0.0
        for _ in range(25):
            action = planner(world) if who == "planner" else np.clip(CONTROLLERS["Flag"](world.observe()), -1, 1)
            total += world.advance(action)[0][0] / 25
        earned[who] = total
    assert earned["planner"] > earned["controller"] + 0.02, earned


def test_its_rows_are_measured_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--quick", "--scenes", "Pressure-v1", "--planned", "2", "--members", "4", "--horizon", "4"]
    assert BENCHMARK.main([*words, "--out", str(tmp_path)]) == 0
    rows = read_rows(tmp_path / "tasks.csv", TaskRow)
    assert [(r.who, r.physics) for r in rows] == [
        *((who, "reference") for who in ("zero", "random", "controller")),
        *((who, "miniature x4") for who in ("controller", "planner")),
    ]
    assert all(0 <= r.reward <= 1 and r.failed == 0 for r in rows)
    capsys.readouterr()
    assert BENCHMARK.main([*words, "--out", str(tmp_path)]) == 0
    assert read_rows(tmp_path / "tasks.csv", TaskRow) == rows
    assert "planner, miniature x4 (2)" in capsys.readouterr().out
