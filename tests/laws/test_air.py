"""Laws of the wind on triangles: terminal velocity of falling cloth, and cloth carried by the wind."""

from __future__ import annotations

import numpy as np
from worlds import G, centre, flat, run, tube

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.scene import Air, Scene
from cloth_envs.state import Controls, State

AIR = Air(tangential=0.4)
CLOTH = Material(0.2, 500.0, 150.0, 1e-4, 5e-5, drag=0)


def test_a_flat_sheet_falls_at_its_terminal_velocity() -> None:
    grid = Grid(25, 25, 0.5, 0.5)
    scene = Scene("fall", grid, CLOTH, 0.02, air=AIR)
    states, h = run(scene, State.still(flat(grid)), frames=20)
    t = np.arange(21) * scene.frame_dt
    # m g = rho C_n A v^2 / 2, and on the way there v = v_t tanh(g t / v_t).
    terminal = (2 * 0.2 * G / (AIR.density * AIR.normal)) ** 0.5
    fall = -centre(scene, states, "velocities")[:, 2]
    # First-order steps: h g / 2 * max |v''| / g, under h g. Every vertex has the same force per mass.
    assert abs(fall - terminal * np.tanh(G * t / terminal)).max() <= h * G
    assert np.ptp(states[-1].positions[0, 2]) < 1e-12
    left = 2 * np.exp(-2 * G * t[-1] / terminal)
    assert abs(fall[-1] / terminal - 1) <= left + h * G / terminal
    assert left < 0.01
    assert abs(centre(scene, states)[:, :2] - centre(scene, states)[0, :2]).max() < h * G * t[-1]


def test_a_tube_falls_along_its_axis_by_tangential_drag() -> None:
    grid = Grid(6, 16, 0.4, 0.5, periodic=True)
    scene = Scene("sink", grid, CLOTH.with_changes(bend_stiffness=0), 0.02, air=AIR)
    state = State.still(tube(grid, grid.col_spacing / (2 * np.sin(np.pi / grid.cols))))
    states, h = run(scene, state, frames=60)
    t = np.arange(61) * scene.frame_dt
    terminal = (2 * 0.2 * G / (AIR.density * AIR.tangential)) ** 0.5
    fall = -centre(scene, states, "velocities")[:, 2]
    # Every vertex has the same force per mass here: only the step's error is left.
    assert abs(fall - terminal * np.tanh(G * t / terminal)).max() <= h * G
    spread = states[-1].velocities[0, 2]
    assert np.ptp(spread) < 1e-9


def test_wind_carries_a_tube_away() -> None:
    grid = Grid(6, 16, 0.4, 0.5, periodic=True)
    scene = Scene("carry", grid, CLOTH.with_changes(bend_stiffness=0), 0.02, air=AIR, gravity=0)
    state = State.still(tube(grid, grid.col_spacing / (2 * np.sin(np.pi / grid.cols))))
    controls = Controls.hold(state, ())
    wind = 5.0
    controls.wind[:, 2] = wind
    states, h = run(scene, state, controls, frames=60)
    t = np.arange(61) * scene.frame_dt
    # dv/dt = k (w - v)^2, k = rho C_t / (2 sigma): v = w - w / (1 + k w t).
    k = AIR.density * AIR.tangential / (2 * 0.2)
    speed = centre(scene, states, "velocities")[:, 2]
    assert abs(speed - wind + wind / (1 + k * wind * t)).max() <= h * k * wind**2
    assert speed[-1] > 0.8 * wind


def test_a_wind_that_the_sheet_moves_with_does_nothing() -> None:
    grid = Grid(6, 7, 0.4, 0.5)
    scene = Scene("drift", grid, CLOTH, 0.02, air=AIR, gravity=0)
    state = State.still(flat(grid))
    wind = np.array([1.0, -2.0, 3.0])
    state.velocities[:] = wind[:, None, None]
    controls = Controls.hold(state, ())
    controls.wind[:] = wind
    states, _ = run(scene, state, controls, frames=10)
    np.testing.assert_allclose(states[-1].velocities, state.velocities, atol=1e-12)
