"""``minicloth bench mesh``: the error of a mesh falls with its spacing, and the fine sheet drives the same cloth."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cloth_envs.registry import load_task
from cloth_envs.resample import on_grid
from training.bench.benchmark import find
from training.bench.mesh import compare, fine_windows
from training.bench.participants import MESH, Participant
from training.truth import Case, load

(CHANGED,) = (participant for participant in MESH if participant.family == "changed material")


def test_the_error_of_a_mesh_falls_as_the_square_of_its_spacing(tmp_path: Path) -> None:
    """The springs are a second-order scheme (4 a halving) where the sheet is smooth: taut, and without contact."""
    errors = []
    for coarse in (4, 2):
        windows = fine_windows([Case("Pressure", 200, coarse, "g2")], (10,), 8, tmp_path)
        (row,) = compare(windows, MESH[:1], (8,))
        assert not row.failure
        errors.append(row.error)
    assert 2**1.5 < errors[0] / errors[1] < 2**2.5


def test_windows_are_the_fine_sheet_at_common_vertices(tmp_path: Path) -> None:
    case = Case("Flag", 200, 4, "g2")
    windows = fine_windows([case], (2,), 3, tmp_path)
    truth = load(case, 5, range(2, 6), tmp_path)
    assert (
        windows.scene.grid.shape
        == load_task("Flag").make_scene(resolution=(5, 7), material=truth.scene.material).grid.shape
    )
    for frame in range(4):
        fine = truth.states[2 + frame]
        np.testing.assert_allclose(windows.truth[frame].positions, fine.positions[:, :, ::2, ::2], atol=1e-12)
        np.testing.assert_array_equal(windows.truth[frame].wind, fine.wind)
    # Every other handle of the pole, where the fine sheet was driven.
    driven = truth.controls[3].handle_positions[:, ::2]
    np.testing.assert_array_equal(np.sort(windows.controls[1].handle_positions, 1), np.sort(driven, 1))
    small = on_grid(truth.states[2], truth.scene.grid, windows.scene.grid)
    np.testing.assert_array_equal(small.positions, windows.truth[0].positions)


def test_a_changed_material_is_the_reference_with_it(tmp_path: Path) -> None:
    windows = fine_windows([Case("Flag", 200, 4, "g2")], (2,), 3, tmp_path)
    same, soft, plain = (
        compare(windows, [participant], (3,))[0].error
        for participant in (replace(CHANGED, options={"compression": 1.0}), CHANGED, Participant("explicit"))
    )
    assert same == plain
    assert soft != plain


def test_other_handles_on_the_fine_mesh_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="other handles"):  # four rings instead of seven
        fine_windows([Case("Curtain", 200, 4, "g2")], (1,), 1, tmp_path)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["--quick", "--scenes", "Pressure", "--out", str(tmp_path / "out"), "--cache", str(tmp_path)]
    assert find("mesh").main(argv) == 0
    assert "QUICK" in capsys.readouterr().out
    with (tmp_path / "out" / "mesh_error.csv").open(newline="") as file:
        rows = list(csv.DictReader(line for line in file if line[0] != "#"))
    assert {row["frames"] for row in rows} == {"1", "5", "10", "25"}
    assert {row["start"] for row in rows} == {"restart", "beginning"}
    assert len(rows) == 2 * 4 * len(MESH)
    assert all(float(row["error"]) > 0 for row in rows)
