"""Which grid folds need: the word about coarser ones, and the sheets at rest on finer and finer grids."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

from cloth_envs.folds import bending_length, needed
from cloth_envs.grid import Grid
from cloth_envs.material import FABRICS, Material, warn_once
from training.bench import folds as bench

CURTAIN = "MiniCloth-Curtain-v0"


@pytest.fixture(autouse=True)
def coarse_grids_are_meant() -> None:
    """Not here. Nothing has been told so far in this process."""
    warn_once.cache_clear()


def test_a_chosen_grid_that_is_too_coarse_is_told_of_once_with_one_that_is_not() -> None:
    length = bending_length(Material())
    assert length == pytest.approx((2e-5 / (0.2 * 9.81)) ** (1 / 3))
    with pytest.warns(UserWarning, match=r"37x25 .* 2\.2 cm: choose resolution=\(71, 48\)") as told:
        gym.make(CURTAIN, resolution=(37, 25), disable_env_checker=True)
    assert [each.category for each in told].count(UserWarning) == 1  # beside Gymnasium's, of every v0
    gym.make_vec(CURTAIN, num_envs=2, resolution=(37, 25))  # warnings are errors here
    rows, cols = needed(Grid(3, 3, 1.5, 1.0), Material())
    assert 1.5 / (rows - 1) <= length < 1.5 / (rows - 2)
    for options in ({}, {"resolution": (rows, cols)}, {"material": "silk"}, {"resolution": (12, 9), "material": BOARD}):
        gym.make(CURTAIN, disable_env_checker=True, **options)


BOARD = Material(areal_density=0.2, bend_stiffness=0.009)


def test_a_fabric_needs_a_grid_of_its_own() -> None:
    grid = Grid(5, 5, 1.0, 1.0)
    assert needed(grid, FABRICS["silk"]) > needed(grid, FABRICS["denim"]) > needed(grid, FABRICS["leather"])


def test_folds_around_a_border_are_counted() -> None:
    grid = Grid(41, 41, 1.0, 1.0)
    r, c = np.indices(grid.shape)
    x = np.stack([c * grid.col_spacing - 0.5, 0.5 - r * grid.row_spacing, np.zeros(grid.shape)])
    x[:2] *= np.abs(x[:2]).max(0) / np.maximum(np.hypot(*x[:2]), 1e-9)  # squares become circles
    x[:2] *= 1 + 0.1 * np.cos(7 * np.arctan2(x[1], x[0]))
    assert bench.folds(grid, x) == 7


def test_quick_run(tmp_path: object, capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.BENCHMARK.main(["--quick", "--scenes", "BallDrop", "--out", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert "length/spacing" in text
    assert "QUICK" in text
    rows = bench.BENCHMARK.main(
        ["--quick", "--scenes", "BallDrop", "--out", str(tmp_path)]
    )  # nothing is measured twice
    assert rows == 0
