"""Symmetries: mirrored, transposed, turned and shifted worlds do the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from worlds import flat, simulate

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.scene import Air, Collider, Scene
from cloth_envs.state import Controls, State

CLOTH = Material(0.2, 300.0, 90.0, 1e-4, 5e-5, 0.5)
FRAMES = 10
# 0.2 s of a folding sheet multiply a rounding error (eps of 1 m) by less than 1e4.
CLOSE = 1e4 * np.finfo(np.float64).eps


def draped(grid: Grid) -> tuple[Scene, State, Controls]:
    """A sheet pinned at the first row's ends that falls onto a sphere in its middle plane."""
    scene = Scene("drape", grid, CLOTH, 0.02, handles=(0, grid.cols - 1), colliders=(Collider("sphere", 0.12, 0.3),))
    centre = np.full((1, 1, 2, 3), [grid.width / 2, -0.6 * grid.height, -0.16])
    state = State.still(flat(grid), centre)
    return scene, state, Controls.hold(state, scene.handles)


def moved(state: State, controls: Controls, turn: np.ndarray, shift: np.ndarray) -> tuple[State, Controls]:
    """The world turned by the matrix ``turn``, then shifted."""

    def cloth(a: np.ndarray, by: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.einsum("ij,bjrc->birc", turn, a) + by[:, None, None])

    state = replace(
        state,
        positions=cloth(state.positions, shift),
        velocities=cloth(state.velocities, 0 * shift),
        colliders=state.colliders @ turn.T + shift,
        collider_velocities=state.collider_velocities @ turn.T,
    )
    controls = Controls(
        handle_positions=controls.handle_positions @ turn.T + shift,
        handle_velocities=controls.handle_velocities @ turn.T,
        colliders=controls.colliders @ turn.T + shift,
        collider_velocities=controls.collider_velocities @ turn.T,
        wind=controls.wind @ turn.T,
        pressure=controls.pressure,
    )
    return state, controls


@pytest.mark.parametrize("cols", [10, 11])
def test_a_mirrored_scene_stays_mirrored(cols: int) -> None:
    grid = Grid(9, cols, 0.5, 0.6)
    scene, state, controls = draped(grid)
    end = simulate(scene, state, controls, FRAMES).positions[0]
    mirrored = end[:, :, ::-1] * [[[-1]], [[1]], [[1]]] + [[[grid.width]], [[0]], [[0]]]
    np.testing.assert_allclose(end, mirrored, atol=CLOSE)
    assert np.ptp(end[2]) > 0.05  # it moved


def test_the_transposed_grid_does_the_same() -> None:
    grid = Grid(7, 10, 0.4, 0.6)
    other = Grid(10, 7, 0.6, 0.4)
    scene = Scene("drape", grid, CLOTH, 0.02, handles=(0,), air=Air(max_wind=12.0), pressure=True)
    state = State.still(flat(grid))
    controls = Controls.hold(state, scene.handles)
    controls.wind[:] = [1.0, 2.0, 3.0]
    controls.pressure[:] = 2.0
    end = simulate(scene, state, controls, FRAMES).positions[0]
    # The same points; turned over, so that the triangles' normals and with them the pressure change sign.
    turned = State.still(np.ascontiguousarray(state.positions.transpose(0, 1, 3, 2)))
    controls.pressure[:] = -2.0
    swapped = simulate(replace(scene, grid=other), turned, controls, FRAMES).positions[0]
    np.testing.assert_allclose(swapped.transpose(0, 2, 1), end, atol=CLOSE)


def test_air_on_a_mirrored_scene_is_mirrored() -> None:
    grid = Grid(9, 9, 0.5, 0.5)
    scene = Scene("flag", grid, CLOTH, 0.02, handles=tuple(range(9)), air=Air(max_wind=12.0), pressure=True)
    state = State.still(flat(grid))
    controls = Controls.hold(state, scene.handles)
    controls.wind[:], controls.pressure[:] = [0.0, 1.0, 3.0], 2.0
    end = simulate(scene, state, controls, FRAMES // 2).positions[0]
    mirrored = end[:, :, ::-1] * [[[-1]], [[1]], [[1]]] + [[[grid.width]], [[0]], [[0]]]
    np.testing.assert_allclose(end, mirrored, atol=CLOSE)
    assert abs(end - state.positions[0]).max() > 0.01  # the wind did blow


@pytest.mark.parametrize("angle", [np.pi / 2, 0.7])
def test_turning_the_world_about_the_vertical_turns_the_motion(angle: float) -> None:
    scene, state, controls = draped(Grid(9, 8, 0.5, 0.6))
    scene = replace(scene, air=Air(max_wind=12.0), pressure=True)
    controls.wind[:] = [1.0, 4.0, 0.5]
    controls.pressure[:] = 3.0
    controls.handle_positions[..., 1] += 0.01
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    shift = np.array([0.3, -1.1, 0.4])
    end = simulate(scene, state, controls, FRAMES)
    expected, _ = moved(end, controls, turn, shift)
    got = simulate(scene, *moved(state, controls, turn, shift), FRAMES)
    for name in ("positions", "velocities", "colliders"):
        np.testing.assert_allclose(getattr(got, name), getattr(expected, name), atol=100 * CLOSE, err_msg=name)
