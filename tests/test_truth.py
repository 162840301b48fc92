"""Truths are stored once, replay to themselves, and tell what is wrong from what is right."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cloth_envs.physics.laws.budget import slow_motion
from cloth_envs.physics.laws.drives import hermite
from training.bench.measure import built, run, vertex_error
from training.bench.participants import FAMILIES
from training.rollouts import replay, retime
from training.truth import Case, load


def test_a_weak_gravity_is_slow_motion_and_a_shift_is_an_error(tmp_path: Path) -> None:
    flag = load(Case("Flag", coarse=4), 13, range(14), tmp_path)
    true, worlds = (
        [flag.states[i] for i in range(14)],
        (flag.scene, replace(flag.scene, gravity=0.7 * flag.scene.gravity)),
    )
    good, weak = (run(built(FAMILIES["explicit"][0], scene), scene, true[0], flag.controls).states for scene in worlds)
    assert not slow_motion(flag.scene, weak, true).passed[0]
    assert slow_motion(flag.scene, good, true).passed[0]
    assert slow_motion(flag.scene, true, true).passed[0]
    assert vertex_error(flag.scene, weak[1], true[1]) > 10 * vertex_error(flag.scene, good[1], true[1])
    shifted = flag.states[13].copy()
    shifted.positions[:, 1] += 0.03
    assert vertex_error(flag.scene, shifted, flag.states[13]) == pytest.approx(0.03 / flag.scene.grid.length, rel=1e-12)


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
    recorded = Case("Flag", coarse=8).record(4, [0, 1, 2])
    scene, states, controls = recorded.scene, recorded.states, recorded.controls
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
