"""Generated data: whole shards only, resumable, and split so that no trajectory is on both sides."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from cloth_envs.presets.lee2019 import Flag2019
from surrogates.miniature.backend import MiniatureBackend
from surrogates.miniature.coarse import coarse_grid
from training import generate as module
from training.generate import Plan, draw, generate, main, simulate, task_of
from training.upscaler.data import Pairs, data_hash, read, shards

PLAN = Plan("Flag", frames=6, window=3, factors=(2,))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("flag")
    assert generate(PLAN, path, 10) == 10
    return path


def test_a_killed_writer_leaves_whole_shards_and_the_next_one_goes_on(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Killed(Exception):
        pass

    whole = module.miniature_runs

    def dies(*given: Any) -> np.ndarray:
        if len(list(tmp_path.glob("*.h5"))) == 2:
            raise Killed
        return whole(*given)

    monkeypatch.setattr(module, "miniature_runs", dies)
    with pytest.raises(Killed):
        generate(PLAN, tmp_path, 4)
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["00000.h5", "00001.h5"]
    monkeypatch.undo()
    times = [(tmp_path / f"0000{k}.h5").stat().st_mtime_ns for k in range(2)]
    assert generate(PLAN, tmp_path, 4) == 2
    assert times == [(tmp_path / f"0000{k}.h5").stat().st_mtime_ns for k in range(2)]
    assert not list(tmp_path.glob("*.part"))
    for k in range(4):  # the same as without a break
        with h5py.File(tmp_path / f"0000{k}.h5") as file, h5py.File(folder / f"0000{k}.h5") as other:
            np.testing.assert_array_equal(file["positions"][:], other["positions"][:])
            np.testing.assert_array_equal(file["real/2"][:], other["real/2"][:])
    with pytest.raises(ValueError, match="data of another plan"):
        generate(Plan("Flag", frames=5, window=5), tmp_path, 4)
    monkeypatch.setattr(Flag2019, "options", {**Flag2019.options, "bending": 0.0})  # the paper is read otherwise
    with pytest.raises(ValueError, match="data of another plan"):
        generate(PLAN, tmp_path, 4)


def test_damaged_shards_are_made_again(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Not only the first one is looked at, and what a killed process left is no shard."""
    copied = [shutil.copy(folder / f"0000{k}.h5", tmp_path) for k in range(5)]
    whole = Path(copied[1]).read_bytes()
    for k, content in ((1, b""), (2, whole[:5000]), (3, bytes(len(whole)))):
        Path(copied[k]).write_bytes(content)
    for left in ("00001.77.part.h5", "00001.h5.77.part", "notes.h5"):
        (tmp_path / left).write_bytes(b"half")
    assert generate(PLAN, tmp_path, 5) == 3
    said = capsys.readouterr().err
    assert [f"0000{k}.h5 is damaged: it is made again" in said for k in range(5)] == [False, True, True, True, False]
    assert data_hash([Path(path) for path in copied]) == data_hash(sorted(folder.glob("*.h5"))[:5])
    assert not (tmp_path / "00001.h5.77.part").exists()
    assert [path.name for path in shards(tmp_path, held_out=True)] == ["00004.h5"]


def test_processes_write_what_one_process_writes(folder: Path, tmp_path: Path) -> None:
    assert generate(PLAN, tmp_path, 2, workers=2) == 2
    assert data_hash(sorted(tmp_path.glob("*.h5"))) == data_hash(sorted(folder.glob("*.h5"))[:2])


def test_the_split_shares_no_trajectory(folder: Path) -> None:
    learn, test = ({int(path.stem) for path in shards(folder, held_out=held)} for held in (False, True))
    assert test == {4, 9}
    assert learn | test == set(range(10))
    assert not learn & test
    values = [read(p, 2).fine[-1] for p in sorted(folder.glob("*.h5"))]
    distinct = [np.abs(a - b).max() for i, a in enumerate(values) for b in values[:i]]
    assert min(distinct) > 1e-4  # other masses, springs, frames and actions
    with pytest.raises(ValueError, match="minicloth generate"):
        shards(folder / "nothing", held_out=True)


def test_mass_spring_frame_and_actions_vary_within_the_plan() -> None:
    own = [draw(PLAN, k) for k in range(40)]
    for values, (low, high) in (([d.mass for d in own], PLAN.mass), ([d.spring for d in own], PLAN.spring)):
        assert low <= min(values) < np.sqrt(low * high) < max(values) <= high
    assert {round(d.frame_dt / 0.04, 6) for d in own} == {0.75, 1.0, 1.25}
    assert sum(d.push == 0 for d in own) == 20
    held = [d.push == 0 for d in own[4::5]]
    assert any(held)
    assert not all(held)


def test_pairs_are_the_stored_frames(folder: Path) -> None:
    """Oracle features are the target's own vertices; real ones a miniature run that starts with the teacher."""
    one = read(folder / "00003.h5", 2)
    assert one.fine.shape == (7, 3, 33, 49)
    assert one.runs.shape == (2, 6, 3, 17, 25)
    own = draw(PLAN, 3)
    task = task_of("Flag", "lee2019", own)
    run = simulate(task, "lee2019", np.random.default_rng((0, 3, 1)), 6, own.push)
    states, controls = run.states, run.controls
    np.testing.assert_array_equal(np.concatenate([states[frame].positions for frame in range(7)]), one.fine)
    backend = MiniatureBackend(task.scene, solver="admm", solver_kwargs={"iterations": 10})
    backend.reset(states[3])
    backend.advance(controls[3])
    np.testing.assert_array_equal(one.runs[1, 3], backend.coarse.state.positions[0])
    np.testing.assert_array_equal(one.runs[1, 2], states[3].positions[0, :, ::2, ::2])
    # P-ADMM's velocity is the difference of positions over the frame, so the past is the frame before, to rounding.
    np.testing.assert_allclose(one.runs[1, 1], states[2].positions[0, :, ::2, ::2], rtol=0, atol=1e-6)

    oracle = Pairs([one], "Flag", 2, inputs="oracle")
    assert len(oracle) == 6 * 31 * 47
    x, y = oracle.pick(np.array([3 * 31 * 47 + 5 * 47 + 8]))  # frame 4, window at (5, 8)
    np.testing.assert_array_equal(x[0, 24:27], one.fine[4, :, 5, 8])
    np.testing.assert_array_equal(x[0, 12:15], one.fine[3, :, 5, 8])
    np.testing.assert_array_equal(y[0].reshape(3, 3, 3), one.fine[4, :, 5:8, 8:11].transpose(1, 2, 0))
    first, _ = oracle.pick(np.array([0]))
    np.testing.assert_array_equal(first[0, :12], first[0, 12:24])  # before the start it was at rest there

    real = Pairs([one], "Flag", 2, inputs="real")
    assert len(real) == 6 * 16 * 24
    x, y = real.pick(np.array([4 * 16 * 24 + 2 * 24 + 3]))  # frame 5, the second after the second start
    for part, frame in enumerate((2, 3, 4)):
        np.testing.assert_array_equal(x[0, 12 * part : 12 * part + 3], one.runs[1, frame, :, 2, 3])
    np.testing.assert_array_equal(y[0].reshape(3, 3, 3), one.fine[5, :, 4:7, 6:9].transpose(1, 2, 0))


def test_triangles_start_from_decimated_frames(folder: Path) -> None:
    one = read(folder / "00000.h5", 2)
    pairs = Pairs([one], "Flag", 4, inputs="triangles", features="positions")
    x, y = pairs.pick(np.array([0]))
    assert coarse_grid(load_grid(), 4).cells == (8, 12)
    np.testing.assert_array_equal(x[0].reshape(3, 3), [one.fine[1, :, r, c] for r, c in ((0, 0), (0, 4), (4, 4))])
    np.testing.assert_array_equal(y[0].reshape(3, 3), [one.fine[1, :, r, c] for r, c in ((0, 2), (2, 4), (2, 2))])


def load_grid() -> Any:
    return task_of("Flag", "lee2019", draw(PLAN, 0)).scene.grid


def test_the_command_says_what_it_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["Collision", "--trajectories", "1", "--frames", "2", "--window", "2", "--out", str(tmp_path)]
    assert main(argv) == 0
    assert f"{59 * 39 * 2:,} pairs" in capsys.readouterr().out
    assert main(argv) == 0
    assert "0 new of 1" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main([*argv, "--window", "3"])
