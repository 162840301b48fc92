"""Every compiled copy of a measure or drive computes what its NumPy source says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cloth_envs.scenes import drives, measures
from cloth_envs.scenes.compiled import TWINS

BATCH, ROWS, COLS = 3, 5, 4
# Sums of at most 20 float64 numbers of size 1: each addition rounds by at most eps, so 20 eps; 10 times that for the
# library functions (exp, sin, cos, sqrt: some ulp each).
TOLERANCE = 200 * np.finfo(float).eps


def arguments(name: str, dtype: type, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    """Calls that go through every branch of the function ``name``, on a random cloth."""
    cloth, speed = (rng.uniform(-1, 1, (BATCH, 3, ROWS, COLS)).astype(dtype) for _ in range(2))
    some, others = rng.permutation(ROWS * COLS).astype(np.int32)[:14].reshape(2, 7)
    tones, time = rng.uniform(0, 6, (BATCH, 2, 2, 4)), rng.uniform(0, 4, BATCH)
    bodies = rng.uniform(-1, 1, (BATCH, 2, 2, 3)).astype(dtype)
    at, now = cloth[:, :2, 0, -1], speed[:, :2, 0, -1]
    box = (np.full(2, -0.6), np.full(2, 0.5), np.array([1.0, 3.0]))
    actions = rng.uniform(-2, 2, (BATCH, 2))
    handles, velocities = rng.uniform(-1, 1, (2, BATCH, 7, 3))
    return {
        "tolerance": [(at[:, 0], 0.3), (at[:, 0], 0.3, 0.25), (at, 0.5), (at, 0.5, 0.25)],
        "mean_point": [(cloth, some)],
        "root_mean_square": [(cloth, some), (cloth, some, 1, 2)],
        "mean_span": [(cloth, some, others)],
        "loop_area": [(cloth, some)],
        "largest_stretch": [(cloth, some, others, rng.uniform(0.5, 1, 7))],
        "columns": [(at, now, time, cloth[:, 0, 0, 0])],
        "gather": [(cloth, speed, some, rng.uniform(-1, 1, (BATCH, 3)).astype("f4"), np.full(45, 0.5, np.float32))],
        "clip_actions": [(actions,), (actions * np.nan,), (actions / 0.0,)],
        "ramp": [(3 * time - 4, 5.0)],
        "along": [(handles[:, 0], at.astype(float))],
        "push": [(bodies.astype(float), np.zeros((BATCH, 2, 2, 3)), actions, 2 * actions)],
        "pump": [(time, actions[:, 0], 40.0, 0.3)],
        "tick": [(np.arange(BATCH), 0.04, time)],
        "hold": [(cloth, some, bodies), (cloth, some[:0], bodies[:, :0])],
        "drive": [(at, now, actions, *box, change, 0.1, 0.02) for change in (0.1, 10.0)],
        "carry": [(handles, velocities, actions, 2 * actions, rng.uniform(0, 1, (7, 2)))],
        "gust": [
            (tones, time[:, None] + [[0.0, 0.1]]),
            (tones, time[:, None]),
            (tones[:, :, :1].copy(), time[:, None]),
        ],
        "gusty_wind": [(tones, time, speed[:, 0, 0, 0].astype(float), time[::-1], 0.5, 0.4)],
    }[name]


@pytest.mark.filterwarnings("ignore:divide by zero")
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", list(TWINS))
def test_compiled_copies_agree_with_their_source(name: str, dtype: type) -> None:
    function = getattr(measures, name, None) or getattr(drives, name)
    assert function is not TWINS[name]
    for call in arguments(name, dtype, np.random.default_rng(0)):
        mine, twins = ([np.copy(a) if isinstance(a, np.ndarray) else a for a in call] for _ in range(2))
        found, expected = function(*mine), TWINS[name](*twins)
        if expected is None and found is None:  # what is written in place
            found, expected = mine, twins
        for a, b in zip(*(r if isinstance(r, (tuple, list)) else [r] for r in (found, expected)), strict=True):
            assert np.asarray(a).dtype == np.asarray(b).dtype
            np.testing.assert_allclose(a, b, rtol=TOLERANCE, atol=TOLERANCE)


def test_tolerance_is_one_at_zero_and_a_tenth_at_the_margin() -> None:
    np.testing.assert_allclose(measures.tolerance(np.array([0.0, 0.3, -0.3]), 0.3), [1.0, 0.1, 0.1], rtol=1e-12)
    np.testing.assert_allclose(measures.tolerance(np.array([0.3]), 0.3, 0.25), [0.25 + 0.75 * 0.1], rtol=1e-12)
    np.testing.assert_allclose(measures.tolerance(np.array([[3.0, 4.0]]), 5.0), [0.1], rtol=1e-12)
