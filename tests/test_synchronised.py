"""Fine cloths that are pulled along with coarse ones, and their pairs on disk."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.utils.seeding import np_random

from cloth_envs.commands.cli import main
from cloth_envs.grid import Grid
from cloth_envs.locks import alone_in
from cloth_envs.material import Material
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.laws.tracking import mean_forces, shared_forces
from cloth_envs.registry import PRESETS
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from surrogates.superres.synchronised import Synchronised
from training.bench.synchronised.rows import FloorRow, TrackingRow, floor
from training.bench.synchronised.run import spikes
from training.jobs import each
from training.rows import read_rows
from training.superres import generate as module
from training.superres.generate import BACKEND, Plan, Protocol, generate
from training.superres.pairs import SPLITS, pairs_folder, read, rest, sequences, twin

OPEN, WIDE, TUBE = Grid(13, 9, 0.6, 0.4), Grid(9, 13, 0.4, 0.6), Grid(9, 16, 0.4, 0.8, periodic=True)
DT = 1e-6  # s of a frame: forces are what they are at its start, to this over the time in which anything moves


def waved(grid: Grid, seed: int, batch: int = 2) -> State:
    """Cloths near their rest shape, in motion."""
    rng = np.random.default_rng(seed)
    flat = np.moveaxis(rest(grid), -1, 0)
    state = State.still(np.stack([flat + 3e-3 * rng.normal(size=flat.shape) for _ in range(batch)]))
    state.velocities[:] = rng.normal(size=state.velocities.shape)
    return state


@pytest.mark.parametrize("grid", [OPEN, WIDE, TUBE], ids=["open", "wide", "tube"])
@pytest.mark.parametrize("tracking", ["mean", "seed"])
@pytest.mark.parametrize("batch", [1, 3])  # bands of one cloth, cloths in lanes
def test_the_kernel_pulls_as_its_twin_does(grid: Grid, tracking: str, batch: int) -> None:
    scene = Scene("Test", grid, Material(), DT, gravity=0.0)
    solver = Synchronised(scene, num_envs=batch, dtype="float64", tracking=tracking, levels=0.5)
    free = ExplicitSolver(scene, num_envs=batch, dtype="float64")
    start, other = waved(grid, 0, batch), waved(grid, 1, batch)
    controls, materials = Controls.hold(start, ()), [scene.material] * batch
    solver.reset(other)  # the coarse cloths are of others
    aim = solver.aims(solver.coarse)
    solver.disturb(start)
    free.reset(start)
    got = solver.advance(controls).velocities - free.advance(controls).velocities
    law: Any = mean_forces if tracking == "mean" else shared_forces
    given = (120.0, 0.7) if tracking == "mean" else (200.0, 0.7, 0.5)
    force = law(grid, solver.coarse_scene.grid, materials, start.positions, start.velocities, aim, *given)
    mass = scene.material.areal_density * grid.areas
    wanted = DT * force / mass
    np.testing.assert_allclose(got, wanted, atol=1e-3 * abs(wanted).max())
    assert abs(wanted).max() > 0.01 * DT


@pytest.mark.parametrize("grid", [OPEN, WIDE, TUBE], ids=["open", "wide", "tube"])
@pytest.mark.parametrize("tracking", ["mean", "seed"])
def test_members_of_a_batch_move_as_alone(grid: Grid, tracking: str) -> None:
    scene = Scene("Test", grid, Material(), 0.01)
    batch = Synchronised(scene, num_envs=3, tracking=tracking)
    start = State.still(waved(grid, 0, 3).positions)
    batch.reset(start)
    batch.reset(State.still(waved(grid, 1, 1).positions), which=[1])
    for _ in range(3):
        batch.advance(Controls.hold(start, ()))
    for i, positions in enumerate((start.positions[:1], waved(grid, 1, 1).positions, start.positions[2:])):
        alone = Synchronised(scene, tracking=tracking)
        alone.reset(State.still(positions))
        for _ in range(3):
            alone.advance(Controls.hold(State.still(positions), ()))
        np.testing.assert_array_equal(alone.state.positions[0], batch.state.positions[i])
        np.testing.assert_array_equal(alone.coarse.positions[0], batch.coarse.positions[i])


def test_means_follow_without_adding_momentum() -> None:
    """Where the coarse cloth is what the fine one's means are, nothing pulls; else what pulls adds up to the mean's."""
    scene = Scene("Test", OPEN, Material(), DT, gravity=0.0)
    solver = Synchronised(scene, num_envs=2, dtype="float64")
    solver.reset(waved(OPEN, 0))
    at, speed = solver.aims(solver.coarse)
    fine = solver.state.positions, solver.state.velocities
    force = mean_forces(OPEN, solver.coarse_scene.grid, [scene.material] * 2, *fine, (at + 0.01, speed), 120.0, 0.0)
    still = mean_forces(OPEN, solver.coarse_scene.grid, [scene.material] * 2, *fine, (at, speed), 120.0, 0.0)
    mass = (scene.material.areal_density * OPEN.areas).sum()
    np.testing.assert_allclose((force - still).sum((2, 3)), mass * 120.0**2 * 0.01, rtol=1e-9)


def swung(options: dict[str, Any], frames: int = 40) -> tuple[World, np.ndarray]:
    """Draping on a small grid, and the distance of vertices that both cloths share [mm]."""
    world = World("Draping", resolution=(33, 33), backend=BACKEND, backend_kwargs=options)
    world.reset({0: np_random(3)[0]})
    away = []
    for _ in range(frames):
        assert world.step(np.zeros((1, 3)))[1] == [None]
        cloths: Any = world.backend
        away.append(1e3 * np.linalg.norm(world.state.positions[0, :, ::4, ::4] - cloths.coarse.positions[0], axis=0))
    return world, np.array(away)


@pytest.mark.parametrize(("tracking", "cells"), [("mean", 0.1), ("seed", 0.2)])
def test_a_fine_cloth_stays_with_the_coarse_one(tracking: str, cells: float) -> None:
    world, away = swung({"tracking": tracking})
    _, free = swung({"rate": 1e-3})
    assert away[10:].mean() < cells * 125  # mm, the side of a coarse cell
    assert free[10:].mean() > 5 * away[10:].mean()
    assert world.crossings[0] == 0


def test_a_saved_pair_goes_on_bit_for_bit() -> None:
    world, _ = swung({}, 5)
    saved = world.get_state()
    world.step(np.zeros((1, 3)))
    positions = world.state.positions.copy()
    world.set_state(saved)
    world.step(np.zeros((1, 3)))
    np.testing.assert_array_equal(world.state.positions, positions)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tracking": "means"}, "tracking"),
        ({"rate": 0}, "rate must be a positive number"),
        ({"levels": -1}, "levels must be a number"),
        ({"tracking": "seed", "factor": 5}, "shares none"),
    ],
)
def test_bad_options_say_what_to_change(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        World("Draping", resolution=(33, 33), backend=BACKEND, backend_kwargs=options)


def test_a_broken_generator_restarts_its_sequence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan, numbers = Plan("Draping", 2), [0, 12]

    class Killed(Exception):
        pass

    whole = module.record

    def dies(world: World, *given: Any, **named: Any) -> Any:
        run = whole(world, *given, **named)
        if named["seeds"] == [12]:
            raise Killed
        return run

    monkeypatch.setattr(module, "record", dies)
    with pytest.raises(Killed):
        generate(plan, tmp_path, numbers)
    assert [path.name for path in sequences(tmp_path, "train")] == ["000.h5"]
    with pytest.raises(ValueError, match="no pairs for test"):
        sequences(tmp_path, "test")
    monkeypatch.undo()
    first = sequences(tmp_path, "train")[0].stat().st_mtime_ns
    assert generate(plan, tmp_path, numbers) == 1
    assert sequences(tmp_path, "train")[0].stat().st_mtime_ns == first
    assert not list(tmp_path.rglob("*.part"))
    sequences(tmp_path, "test")[0].write_bytes(b"")
    assert generate(plan, tmp_path, numbers, jobs=2) == 1
    with pytest.raises(ValueError, match="another plan"):
        generate(Plan("Draping", 3), tmp_path, numbers)
    pair = read(sequences(tmp_path, "test")[0])
    assert pair.number == 12
    assert pair.fine.positions.shape == pair.fine.velocities.shape == (3, 109, 105, 3)
    assert pair.coarse.positions.shape == (3, 28, 27, 3)
    np.testing.assert_array_equal(pair.fine.positions[0, ::4, ::4], pair.coarse.positions[0])  # rounded alike
    assert (pair.fine.positions * 2**17 % 1 == 0).all()
    assert json.loads((tmp_path / "plan.json").read_text()) == {**vars(plan)}
    assert twin(sequences(tmp_path, "test")[0]).is_file()
    np.testing.assert_array_equal(read(sequences(tmp_path, "test")[0], slice(2, 3)).bodies.shape, (1, 0, 2, 3))


def test_pairs_of_the_environments_own_grid_are_apart_from_the_papers(tmp_path: Path) -> None:
    plan = Plan("Draping", 2, own=True)
    generate(plan, tmp_path, [0, 10])
    for split, number in (("train", 0), ("test", 10)):
        pair = read(sequences(tmp_path, split)[0])
        assert pair.number == number
        assert (pair.fine.scene.grid.shape, pair.coarse.scene.grid.shape) == ((65, 65), (17, 17))
    assert np.abs(plan.actions(plan.world(0), 0)).max() > 0  # smooth ones
    with pytest.raises(ValueError, match="another plan"):
        generate(Plan("Draping", 2), tmp_path, [0])
    told = tmp_path / "plan.json"
    told.write_text(json.dumps(vars(Plan("Draping", 2))).replace(', "own": false', ""))  # of before there was this
    assert generate(Plan("Draping", 2), tmp_path, []) == 0
    assert pairs_folder("Draping") != pairs_folder("Draping", own=True)


def test_what_is_no_pair_is_not_read_as_one(tmp_path: Path) -> None:
    generate(Plan("Draping", 2), tmp_path, [0, 1])
    one, other = sequences(tmp_path, "train")
    with pytest.raises(ValueError, match="no fine recording"):
        read(twin(one))
    with pytest.raises(ValueError, match="none of them in"):
        read(one, slice(3, None))
    whole = twin(one).read_bytes()
    twin(one).write_bytes(twin(other).read_bytes())
    with pytest.raises(ValueError, match="not of one sequence"):
        read(one)
    twin(one).write_bytes(whole)
    assert read(one).number == 0
    twin(one).unlink()
    with pytest.raises(FileNotFoundError, match="coarse"):
        read(one)


def test_a_killed_process_is_told() -> None:
    """Of two that raise signals, 0 being none."""
    assert list(each(signal.raise_signal, [0, 0, 0], 2)) == [None] * 3
    with pytest.raises(ChildProcessError, match="fewer --jobs"):
        list(each(signal.raise_signal, [0, signal.SIGKILL, 0], 2))


@pytest.mark.parametrize(
    ("scene", "count", "train", "test"),
    [("Draping", 13, 10, 3), ("Hitting", 35, 31, 4), ("Hitting", 14, 10, 4), ("Skirt", 7, 5, 2), ("Flag", 2, 1, 1)],
)
def test_splits_are_of_whole_sequences(scene: str, count: int, train: int, test: int) -> None:
    protocol = Protocol.of(scene)
    split = [protocol.split(number) for number in protocol.first(count)]
    assert split == ["train"] * train + ["test"] * test


def test_spikes_are_what_shared_vertices_have_more_of() -> None:
    """On a wave the ratio is that of its curvature, nearly 1; vertices pulled out of a flat sheet have spikes."""
    grid = Grid(33, 33, 1.0, 1.0)
    x, z = np.meshgrid(np.linspace(0, 1, 33), np.linspace(0, 1, 33))
    ratio, rough = spikes(grid, np.stack([x, 0.05 * np.sin(7 * x), z]))
    wave = 0.05 * 7**2 * np.sin(7 * x[1:-1, 1:-1]) / (2 * 2 * 32**2)  # a second difference over 2 neighbours of 4
    assert ratio == pytest.approx(1, abs=0.05)
    assert rough == pytest.approx(np.sqrt((wave**2).mean()), rel=0.02)
    pulled = np.zeros((33, 33))
    pulled[::4, ::4] = 1e-3
    ratio, rough = spikes(grid, np.stack([x, pulled, z]))
    assert rough == pytest.approx(1e-3 / 4 * np.sqrt(224 / (31 * 31 - 49)), rel=1e-6)  # those beside 81
    assert ratio == pytest.approx(1e-3 / rough, rel=1e-6)


def test_the_benchmark_end_to_end_and_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["bench", "synchronised", "--quick", "--scenes", "Draping", "--out", str(tmp_path)]
    with pytest.raises(SystemExit, match="0"):
        main(argv)
    assert "mean " in capsys.readouterr().out
    rows = {row.tracking: row for row in read_rows(tmp_path / "tracking.csv", TrackingRow)}
    assert list(rows) == ["free", "mean", "seed", "springs"]
    assert rows["mean"].error < 2.0  # mm
    assert rows["mean"].spikes < rows["seed"].spikes
    (chance,) = read_rows(tmp_path / "tracking_floor.csv", FloorRow)
    assert 0 < chance.rms < chance.detail
    before = {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("*.csv")}
    with pytest.raises(SystemExit, match="0"):
        main(argv)
    assert {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("*.csv")} == before


def test_the_stored_floor_is_below_the_detail(monkeypatch: pytest.MonkeyPatch) -> None:
    for scene in PRESETS["chen2020"]:
        found = floor(scene)
        assert 0 < found["rms"] < found["detail"]
        assert found["normals"] > 0
    with pytest.raises(ValueError, match="not of 'Flag'"):
        floor("Flag")
    monkeypatch.setattr("training.bench.synchronised.rows.DATA", Path("nowhere.csv"))
    with pytest.raises(FileNotFoundError, match="minicloth bench synchronised"):
        floor("Draping")


def test_a_folder_is_one_programs_at_a_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["generate", "Flag", "--pairs", "synchronised", "--sequences=1", "--frames=1", f"--out={tmp_path}"]
    with alone_in(tmp_path):
        with pytest.raises(OSError, match="another program writes into"):
            generate(Plan("Draping", 1), tmp_path, [0])
        assert main(argv) == 2
        assert "choose another folder" in capsys.readouterr().err
        assert list(tmp_path.iterdir()) == []
    with pytest.raises(SystemExit, match="0"):
        main(argv)


def test_a_ray_cluster_makes_the_same(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    plan = Plan("Draping", 1)
    assert generate(plan, tmp_path / "ray", [0, 12], address="local") == 2
    assert generate(plan, tmp_path / "here", [0, 12]) == 2
    for split in SPLITS:
        ((one,), (other,)) = (sequences(tmp_path / folder, split) for folder in ("ray", "here"))
        np.testing.assert_array_equal(read(one).fine.positions, read(other).fine.positions)


def test_the_command_says_what_it_does(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["generate", "Flag", "--pairs", "synchronised", "--sequences=1", "--frames=2", f"--out={tmp_path}"])
    out, err = capsys.readouterr()
    assert "1 new of 1 sequences" in out
    assert "1 sequences of 2 frames" in err
    assert len(sequences(tmp_path, "train")) == 1
    with pytest.raises(SystemExit, match="2"):
        main(["generate", "Draping", "--pairs", "synchronised", "--sequences", "14"])
    assert "must be at most 13" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        main(["generate", "Skirt", "--pairs", "synchronised", "--frames", "801"])
    assert "--frames must be at most 800" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("folder", "words"),
    [("skirt", "Skirt --pairs synchronised`"), ("draping_own", "Draping --pairs synchronised --own`"), ("a", "SCENE ")],
)
def test_where_there_are_no_pairs_it_says_how_to_make_them(tmp_path: Path, folder: str, words: str) -> None:
    with pytest.raises(ValueError, match=f"run `minicloth generate {words}"):
        sequences(tmp_path / folder, "train")
