"""``minicloth bench convergence``: the instrument works end to end, goes on where it stopped, and can fail."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from training.bench import convergence
from training.bench.benchmark import MEASURED, find
from training.bench.convergence import AFTER, DATA, ChaosRow, ConvergenceRow, floor, ladders
from training.rows import Store, read_rows

main = find("convergence").main
CHAOS_KEY = find("convergence").files["chaos_floor"].key


def test_the_stored_chaos_floor_grows_with_time(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = read_rows(DATA, ChaosRow)
    assert {row.scene for row in rows} == set(MEASURED)
    for scene in MEASURED:
        assert len({row.seed for row in rows if row.scene == scene}) >= 5
        found = [floor(scene, frames) for frames in AFTER]
        # The nudge rings off before it grows, so one frame may lie over five; rounding to 2e-16 is far below.
        assert all(1e-9 < error < 1 for error in found)
        assert floor(scene, 7) == pytest.approx(
            np.exp(np.interp(np.log(7), np.log([5, 10]), np.log(found[1:3]))), rel=1e-12
        )
        seeds = [row.error for row in rows if (row.scene, row.frames) == (scene, 10)]
        assert min(seeds) <= floor(scene, 10) <= max(seeds)
    for scene in ("Curtain", "Flag", "Collision"):  # driven and folded: chaos
        found = [floor(scene, frames) for frames in AFTER]
        assert found[0] < found[1] < found[2] < found[3]
    with pytest.raises(ValueError, match="known at frames"):
        floor("Flag", 500)
    monkeypatch.setattr(convergence, "DATA", Path("nowhere.csv"))
    with pytest.raises(FileNotFoundError, match="bench convergence"):
        floor("Flag", 5)


def test_quick_run_end_to_end_and_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    argv = ["--quick", "--scenes", "Flag", "--families", "explicit", "--backend", 'reference={"solver": "admm"}']
    argv += ["--out", str(out), "--cache", str(tmp_path / "c")]
    assert main(argv) == 0
    assert "QUICK" in capsys.readouterr().out
    assert json.loads((out / "convergence.json").read_text())["quick"] is True
    tables = {path.name: path.read_text() for path in out.glob("*.csv")}
    assert sorted(tables) == ["chaos_floor.csv", "convergence.csv"]
    # Between the first order of dashpots and the second of all else.
    (ladder,) = ladders(read_rows(out / "convergence.csv", ConvergenceRow))
    assert 0.9 < ladder.order < 2.2
    solvers = {row.solver for row in read_rows(out / "convergence.csv", ConvergenceRow)}
    assert solvers == {"chaos floor", "explicit", "reference"}
    # Nothing is measured twice.
    assert main(argv) == 0
    assert {path.name: path.read_text() for path in out.glob("*.csv")} == tables


def test_store_goes_on_and_refuses_other_columns(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    row = ChaosRow("Flag", 3, 3, 0, 1, 0.04, 1e-6, 1.5e-6, float("nan"))
    Store(path, ChaosRow, CHAOS_KEY).add(row)
    store = Store(path, ChaosRow, CHAOS_KEY)
    assert ("Flag", 3, 3, 0, 1) in store
    store.add(replace(row, error=2e-6))
    (found,) = read_rows(path, ChaosRow)
    assert found.error == 2e-6
    assert np.isnan(found.height)
    assert not Store(path, ChaosRow, CHAOS_KEY, fresh=True).rows
    with pytest.raises(ValueError, match="--out"):
        read_rows(path, ConvergenceRow)


def test_mistakes_name_the_nearest() -> None:
    with pytest.raises(ValueError, match="Did you mean 'implicit'"):
        main(["--families", "implicitt"])
    with pytest.raises(ValueError, match="Did you mean 'Flag'"):
        main(["--scenes", "Flagg"])
