"""``minicloth bench solvers``: the instrument works end to end, goes on where it stopped, and can fail."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from cloth_envs.backend import Backend
from cloth_envs.physics.laws.budget import slow_motion
from cloth_envs.physics.laws.drives import hermite
from cloth_envs.registry import SCENES
from cloth_envs.scene import Scene
from training.bench import cost, summary, sweep, verdict
from training.bench.configurations import Config, choose, label
from training.bench.convergence import chaos
from training.bench.convergence import run as convergence
from training.bench.solvers import main, measure, parse
from training.bench.truth import Case, Truth, length, load, record, replay, retime, vertex_error
from training.rows import Store, read_rows

EXPLICIT = Config("explicit", {})


class Wrong(Config):
    """Explicit in another world than it is asked for: ``options`` are changes of the scene."""

    def build(self, scene: Scene) -> Backend:
        return EXPLICIT.build(replace(scene, **self.options))


@pytest.fixture(scope="module")
def flag(tmp_path_factory: pytest.TempPathFactory) -> Truth:
    return load(Case("Flag", coarse=4), 13, range(14), tmp_path_factory.mktemp("cache"))


def test_the_stored_chaos_floor_grows_with_time() -> None:
    rows = read_rows(chaos.DATA, chaos.Floor)
    assert {row.scene for row in rows} == set(SCENES)
    for scene in SCENES:
        assert len({row.seed for row in rows if row.scene == scene}) >= 5
        found = [chaos.floor(scene, frames) for frames in chaos.FRAMES]
        # The nudge rings off before it grows, so one frame may lie over five; rounding to 2e-16 is far below.
        assert all(1e-9 < error < 1 for error in found)
        assert chaos.floor(scene, 7) == pytest.approx(
            np.exp(np.interp(np.log(7), np.log([5, 10]), np.log(found[1:3]))), rel=1e-12
        )
        assert chaos.floor(scene, 10, quantile=0.0) <= chaos.floor(scene, 10) <= chaos.floor(scene, 10, quantile=1.0)
    for scene in ("Curtain", "Flag", "Collision"):  # driven and folded: chaos
        found = [chaos.floor(scene, frames) for frames in chaos.FRAMES]
        assert found[0] < found[1] < found[2] < found[3]
    with pytest.raises(ValueError, match="known at frames"):
        chaos.floor("Flag", 500)
    with pytest.raises(FileNotFoundError, match="bench solvers"):
        chaos.floor("Flag", 5, path=Path("nowhere.csv"))


def test_quick_run_end_to_end_and_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweep, "AXES", {"stiffness": (0.5, 1), "frame": (0.5, 2), "mass": (2,), "wind": (0, 3)})
    out = tmp_path / "out"
    argv = ["--quick", "--scenes", "Flag", "--solvers", "explicit", "--out", str(out), "--cache", str(tmp_path / "c")]
    measure(parse(argv))
    text = capsys.readouterr().out
    assert "quick" in text
    assert json.loads((out / "solvers.json").read_text())["quick"] is True
    tables = {path.name: path.read_text() for path in out.glob("*.csv")}
    assert sorted(tables) == [
        *("chaos_floor.csv", "solvers.csv", "solvers_convergence.csv", "solvers_runs.csv", "solvers_sweep.csv"),
    ]
    assert ElementTree.parse(out / "solvers.svg").getroot().tag.endswith("svg")
    assert (out / "solvers.png").stat().st_size > 10_000
    with (out / "solvers.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [label(row["solver"], row["options"]) for row in rows] == ["explicit", "explicit refine=4"]
    coarse, fine = rows
    assert float(fine["error_1_percent"]) < 0.5 * float(coarse["error_1_percent"])
    assert float(coarse["ms_q1"]) <= float(coarse["ms_median"]) <= float(coarse["ms_q3"])
    # First order, three rungs of 1, 1/2, 1/4 of a step against 1/64: the slope is at most 0.08 over.
    (ladder,) = convergence.ladders(read_rows(out / "solvers_convergence.csv", convergence.Point))
    assert ladder.order == pytest.approx(1, abs=0.2)
    assert {row.outcome for row in read_rows(out / "solvers_sweep.csv", sweep.Cell)} == {"ok"}
    # Nothing is measured twice.
    measure(parse(argv))
    assert {path.name: path.read_text() for path in out.glob("*.csv")} == tables


def test_a_weak_gravity_is_slow_motion_and_a_shift_is_an_error(flag: Truth) -> None:
    weak = replace(flag.scene, gravity=0.7 * flag.scene.gravity)
    frames = [flag.states[0]]
    frames += [state.copy() for state, _ in replay(EXPLICIT.build(weak), flag.states[0], flag.controls)]
    true = [flag.states[i] for i in range(14)]
    assert not slow_motion(flag.scene, frames, true).passed[0]
    assert slow_motion(flag.scene, true, true).passed[0]
    runs = [cost.window(flag, 0, 13, EXPLICIT, EXPLICIT.build(scene), Case("Flag")) for scene in (flag.scene, weak)]
    good, bad = (summary.summaries([run])[0] for run in runs)
    assert abs(good.slow) < cost.TOLERANCE < bad.slow
    assert bad.error_1_percent > 10 * good.error_1_percent
    shifted = flag.states[13].copy()
    shifted.positions[:, 1] += 0.03
    assert vertex_error(flag.scene, shifted, flag.states[13]) == pytest.approx(0.03 / length(flag.scene), rel=1e-12)


def test_outcomes_of_the_sweep(flag: Truth) -> None:
    scene, controls = sweep.world(flag, "mass", 1 / 3, 13)
    assert scene.material.areal_density == pytest.approx(flag.scene.material.areal_density / 3)
    true = verdict.trajectory(verdict.TRUTH.build(scene), scene, flag.states[0], controls)[0]

    def outcome(config: Config) -> verdict.Verdict:
        return verdict.judge(config, scene, flag.states[0], controls, true, seed=0)

    assert outcome(EXPLICIT).outcome == "ok"
    refused = outcome(Config("explicit", {"substeps": 1}))
    assert refused.outcome == "refused"
    assert "use at least" in refused.detail
    assert outcome(Wrong("explicit", {"gravity": 3.0})).outcome == "slow"
    assert outcome(Wrong("explicit", {"gravity": 15.0})).outcome == "fast"
    soft = scene.material.with_changes(stretch_stiffness=5.0)
    assert outcome(Wrong("explicit", {"material": soft})).outcome == "strained"
    snapped = outcome(Wrong("explicit", {"material": soft.with_changes(stretch_stiffness=0.01)}))
    assert snapped.outcome == "failed"
    assert "overstretch at frame" in snapped.detail


def test_truth_is_stored_once_and_replays_to_itself(tmp_path: Path) -> None:
    case = Case("Collision", coarse=8)
    truth = load(case, 4, [0, 1, 4], tmp_path)
    (file,) = tmp_path.iterdir()
    stamp = file.stat().st_mtime_ns
    again = load(case, 4, [0, 1, 4], tmp_path)
    assert file.stat().st_mtime_ns == stamp
    assert again.key == truth.key
    assert load(replace(case, seed=1), 4, [0, 1, 4], tmp_path).key != truth.key
    for frame in (1, 4):
        np.testing.assert_array_equal(again.states[frame].positions, truth.states[frame].positions)
    backend = case.world().backend
    states = [state.copy() for state, _ in replay(backend, again.states[0], again.controls)]
    np.testing.assert_array_equal(states[0].positions, truth.states[1].positions)
    np.testing.assert_array_equal(states[-1].positions, truth.states[4].positions)


def test_retimed_controls_lie_on_the_same_cubics() -> None:
    scene, states, controls = record(Case("Flag", coarse=8), 4, [0, 1, 2])
    half = retime(scene, states[0], controls, 0.5)
    assert len(half) == 8
    np.testing.assert_array_equal(half[1].handle_positions, controls[0].handle_positions)
    then = (states[1].positions, states[1].velocities)
    held = [a.reshape(1, 3, -1)[..., list(scene.handles)].transpose(0, 2, 1) for a in then]
    x, v = hermite(0.5, scene.frame_dt, held[0], held[1], controls[1].handle_positions, controls[1].handle_velocities)
    np.testing.assert_allclose(half[2].handle_positions, x, atol=1e-12)
    np.testing.assert_allclose(half[2].handle_velocities, v, atol=1e-12)
    double = retime(scene, states[0], controls, 2)
    assert len(double) == 2
    np.testing.assert_array_equal(double[0].handle_positions, controls[1].handle_positions)
    np.testing.assert_allclose(double[0].wind, (controls[0].wind + controls[1].wind) / 2, rtol=1e-15)


def test_store_goes_on_and_refuses_other_columns(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    row = chaos.Floor("Flag", 3, 3, 0, 1, 0.04, 1e-6, 1.5e-6, float("nan"))
    Store(path, chaos.Floor, chaos.KEY).add(row)
    store = Store(path, chaos.Floor, chaos.KEY)
    assert ("Flag", 3, 3, 0, 1) in store
    store.add(replace(row, error=2e-6))
    (found,) = read_rows(path, chaos.Floor)
    assert found.error == 2e-6
    assert np.isnan(found.height)
    assert not Store(path, chaos.Floor, chaos.KEY, fresh=True).rows
    with pytest.raises(ValueError, match="--out"):
        read_rows(path, cost.Run)


def test_choose_leaves_out_what_is_not_installed() -> None:
    table = {"explicit": [{}, {"refine": 2}, {"refine": 4}], "quantum": [{}]}
    assert [c.text for c in choose(table, None, 2)] == ["{}", '{"refine": 4}']
    assert choose(table, ["quantum"]) == []


def test_mistakes_name_the_nearest() -> None:
    with pytest.raises(ValueError, match="Did you mean 'sweep'"):
        parse(["--parts", "sweeps"])
    with pytest.raises(ValueError, match="Did you mean 'Flag'"):
        main(["--scenes", "Flagg"])
