"""``minicloth bench agents``: schedules, points, equal budgets, interquartile means; nothing is measured twice."""

from __future__ import annotations

from dataclasses import replace
from json import loads
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

pytest.importorskip("torch", reason="needs the extra 'train'")

import torch

from cloth_envs.agents import LEARNED, NETWORKS, STAGES, load_policy, trained_on
from cloth_envs.commands.cli import main
from cloth_envs.evaluation import ALLOWED, play
from training.bench.agents import run as agents
from training.bench.agents.rows import MIXED_SAC, AgentRow, FloorRow, costs, interquartile, last, normalised, table
from training.rows import read_rows

ROW = AgentRow("Flag", "mixed", 0, 1, 50.0, 1000, 40, 0.3, 0.5, 0.01, 0.02, 0)
FLOORS = [FloorRow("Flag", "zero", 0.2, 0.0), FloorRow("Flag", "controller", 0.4, 0.5)]


def test_only_the_last_point_of_a_training_counts() -> None:
    rows = [replace(ROW, point=2, reward=0.4), ROW, replace(ROW, seed=1, reward=0.2)]
    assert sorted(r.reward for r in last(rows)) == [0.2, 0.4]
    assert normalised(rows, FLOORS) == {"mixed": {"Flag": [pytest.approx(1.0), pytest.approx(0.0)]}}


def test_interquartile_means_leave_out_what_is_far() -> None:
    values = {"a": [0.0, 1.0, 2.0, 3.0], "b": [100.0, 4.0, -50.0, 1.5]}
    assert interquartile(values)[0] == pytest.approx(np.mean([1, 1.5, 2, 3]))  # the middle four of eight
    assert np.isnan(interquartile({"a": [0.3], "b": [0.4]})[1:]).all()


def test_their_intervals_are_as_wide_as_many_repetitions_spread() -> None:
    """Of 5 trainings of 9 scenes, whose levels are no part of the spread; a bootstrap of 5 is narrower by (4/5)^.5."""
    rng, levels = np.random.default_rng(0), np.linspace(0, 1, 9)
    repeated = [{str(i): (m + 0.2 * rng.normal(size=5)).tolist() for i, m in enumerate(levels)} for _ in range(120)]
    means, lows, highs = np.array([interquartile(each) for each in repeated]).T
    spread = 2 * norm.ppf(0.975) * means.std(ddof=1) * 0.8**0.5
    error = 4 * spread / (2 * 119) ** 0.5  # four standard errors of a standard deviation
    assert np.mean(highs - lows) == pytest.approx(spread, abs=error)
    assert ((lows < means) & (means < highs)).all()


def test_tables_say_what_was_earned_and_what_it_cost() -> None:
    text = table([ROW, replace(ROW, seed=1, reward=0.5)], FLOORS)
    assert "0.40 ± 1.27" in text  # 12.7 of Student's t with one degree of freedom, times 0.1
    assert "2 trainings of 1 scenes" in text
    assert "no interval of one seed" in table([ROW], FLOORS)
    assert "4.0%" in costs([ROW])
    assert "+0.010 ± 0.020" in costs([ROW])


def test_schedules_share_out_the_time_and_end_where_it_counts() -> None:
    for stages in agents.SCHEDULES.values():
        assert sum(share for *_, share in stages) == pytest.approx(1)
    assert [name for name, *_ in agents.SCHEDULES["mixed"]] == ["miniature", "miniature", "reference"]


def test_a_mixed_schedule_has_the_physics_of_the_example() -> None:
    shares = [share for *_, share in agents.SCHEDULES[agents.MIXED]]
    for scene, first in (("Flag-v1", 4), ("Skirt-v1", 3)):
        stages = agents.stages_of(agents.MIXED, scene)
        assert [share for *_, share in stages] == shares
        assert [options.get("factor") for _, options, _ in stages] == [first, 2, None]
    assert agents.stages_of("miniature x4", "Skirt-v1") == agents.SCHEDULES["miniature x4"]
    (_, near, _), (_, nearer, _), (_, last, _) = agents.stages_of(agents.MIXED, "Hanging-v1")
    assert near == {"factor": 4, "scaling": "calibrated", "factors": {"compression": 0.01}}
    assert (nearer["factors"], last) == ({"compression": 0.03}, {})


def test_a_run_is_scored_at_its_points_and_goes_on_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(agents, "HELD_OUT", range(2))
    monkeypatch.setattr(agents, "CERTIFIED", range(2, 4))
    stages = [("miniature", {"factor": 4}, 0.5), ("miniature", {"factor": 3}, 0.5)]
    monkeypatch.setattr(agents, "SCHEDULES", {"one": [("miniature", {"factor": 4}, 1.0)], "both": stages})
    work = agents.Work(5.0, 2, 3)
    monkeypatch.setattr(agents, "Work", lambda *_: work)
    words = ["--scenes", "Pressure", "--schedules", "one,both", "--out", str(tmp_path), "--quick"]
    words += ["--policies", str(tmp_path / "policies")]
    assert agents.BENCHMARK.main(words) == 0
    rows = read_rows(tmp_path / "agents.csv", AgentRow)
    assert [(r.schedule, r.point) for r in rows] == [("one", 1), ("one", 2), ("both", 1), ("both", 2)]
    assert rows[3].frames > rows[2].frames  # each stage has an update
    for early, late in (rows[:2], rows[2:]):
        assert 0 < early.frames <= late.frames  # on a busy machine an update takes half of the budget
        assert 0 < early.processor_s <= late.processor_s
        assert late.processor_s >= work.seconds
        assert early.gap_half == 0 < late.gap_half
        assert late.reference_frames == 0
        assert 0 < late.reward < 1
    assert (tmp_path / "agents.png").stat().st_size > 1000
    card = loads((tmp_path / "policies" / "Pressure.json").read_text())
    assert (card["schedule"], card["reward"], card["frames"]) == ("both", rows[3].reward, rows[3].frames)
    policy = load_policy(str(tmp_path / "policies" / "Pressure.safetensors"), "Pressure")
    true = play("Pressure", policy, agents.CERTIFIED, frames=3)
    assert true.reward.mean() == pytest.approx(rows[3].reward, abs=1e-4)
    before = (tmp_path / "agents.csv").read_bytes()
    monkeypatch.setattr(agents, "Training", None)  # none is made
    assert agents.BENCHMARK.main(words) == 0
    assert (tmp_path / "agents.csv").read_bytes() == before
    assert "both" in capsys.readouterr().out


def test_networks_that_ship_are_as_their_cards_say(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Episodes of the quickest, some seeds of its card: as far from its mean as seeds are."""
    assert {path.stem for path in NETWORKS.glob("*.json")} == {path.stem for path in NETWORKS.glob("*.safetensors")}
    card = loads((NETWORKS / "Collision-v1.json").read_text())
    for name in agents.TASKS:
        told = loads((NETWORKS / f"{name}.json").read_text())
        assert trained_on(LEARNED, name) == agents.example().stages(name)[0][:2]
        assert told["gap"] <= ALLOWED
        assert told["failed"] == 0
    for content in ("{}", "[]", "no JSON", f'{{"{STAGES}": [["miniature"]]}}'):
        (tmp_path / "mine.json").write_text(content)
        with pytest.raises(ValueError, match=r"mine.json is no card of a network.*give --train-backend"):
            trained_on(str(tmp_path / "mine.safetensors"), "Collision-v1")
    assert trained_on("zero", "Collision-v1") is trained_on("there.safetensors", "Collision-v1") is None
    found = play("Collision-v1", load_policy(LEARNED, "Collision-v1"), agents.CERTIFIED[:6])
    assert abs(found.reward.mean() - card["reward"]) < 4 * found.reward.std() / 6**0.5 + 0.02
    assert main(["rollout", "Collision-v1", "--policy", "ppo", "--frames", "3"]) == 0
    assert "mean reward" in capsys.readouterr().out
    with pytest.raises(ValueError, match="no network ships for Flag, there are"):
        load_policy(LEARNED, "Flag")


def test_sac_learns_what_it_plays_and_plays_noise_that_lasts() -> None:
    pytest.importorskip("stable_baselines3", reason="needs the extra 'rl'")
    learner = agents.learner_of(MIXED_SAC)
    for number, (backend, options) in enumerate([("miniature", {"factor": 4}), ("reference", {})]):
        learner.begin("Pressure", backend, options, number)
        assert learner.go_on(0.5 * number) == 2048
        assert learner.end() == 0
    model, policy, env, hidden = learner.model, learner.policy(), learner.env, learner.told.hidden
    assert model.replay_buffer.size() == 2 * 2048 / 32  # what it played on the first is kept
    assert model.actor.optimizer.param_groups[0]["lr"] == pytest.approx(0.55e-3)
    seen = np.random.default_rng(0).normal(size=(64, learner.told.venv.observation_space.shape[0]))
    told = env.normalize_obs(seen[:, hidden:])
    np.testing.assert_allclose(policy(seen), model.predict(told, deterministic=True)[0], atol=1e-5)
    seen[:, :hidden] += 1.0  # keypoints, which it does not see
    np.testing.assert_allclose(policy(seen), model.predict(told, deterministic=True)[0], atol=1e-5)
    still = np.repeat(told[:1], 256, axis=0)
    model.noise = torch.zeros(())
    played = np.arctanh(np.array([model.predict(still)[0] for _ in range(200)], np.float64))
    played -= played.mean(0)
    lasting = (played[1:] * played[:-1]).mean() / played.var()
    assert lasting == pytest.approx(0.8, abs=0.02)  # a standard error of 51,200 numbers that last is 0.003


def test_frames_of_the_reference_are_counted() -> None:
    training = agents.Training()
    points = list(training.run("Pressure", [("reference", {}, 1.0)], 0, 0.1, 1))
    assert points == [1]
    assert training.reference_frames == training.frames == 32 * 128
