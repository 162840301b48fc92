"""Laws of a free sheet: fall, rest, momentum, drag."""

from __future__ import annotations

import numpy as np
import pytest
from worlds import THREADS, G, bumpy, centre, flat, run, simulate

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.scene import Collider, Scene
from cloth_envs.state import State

EPS = np.finfo(np.float64).eps
CLOTH = Material(0.2, 500.0, 150.0, 1e-4, damping=5e-5, drag=0)
GRIDS = [Grid(9, 8, 0.6, 0.9), Grid(7, 9, 0.6, 0.5, periodic=True)]


def moving(grid: Grid, seed: int = 0) -> State:
    """A crumpled sheet with random velocities of about 1 m/s."""
    state = State.still(bumpy(grid, seed, 0.3))
    state.velocities[:] = np.random.default_rng(seed).normal(size=state.velocities.shape)
    return state


@pytest.mark.parametrize("grid", GRIDS, ids=["sheet", "tube"])
def test_centre_of_mass_falls_freely_whatever_the_sheet_does(grid: Grid) -> None:
    scene = Scene("fall", grid, CLOTH, 0.02)
    states, h = run(scene, moving(grid), frames=10)
    t = 10 * scene.frame_dt
    start, speed = centre(scene, states)[0], centre(scene, states, "velocities")[0]
    fallen = centre(scene, states)[-1] - start - speed * t
    # Velocity Verlet is exact for a constant force. Roundoff: n steps of size eps |x|.
    round_off = t / h * EPS * abs(states[-1].positions).max()
    np.testing.assert_allclose(fallen, [0, 0, -G * t * t / 2], atol=round_off)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_flat_sheet_stays_at_rest(dtype: str) -> None:
    grid = Grid(9, 8, 0.6, 0.9)
    scene = Scene("rest", grid, CLOTH, 0.02, gravity=0.0)
    state = State.still(flat(grid))
    states, _ = run(scene, state, frames=50, dtype=dtype)
    # A rest length is off by eps |x|; the sheet relaxes towards lengths that differ by that much, so
    # vertices can move by eps |x| per edge, summed over a row, and oscillate about it: twice that.
    bound = 2 * max(grid.shape) * np.finfo(dtype).eps * abs(state.positions).max()
    assert abs(states[-1].positions - state.positions).max() <= bound


def test_a_sheet_on_a_plane_stays_at_rest() -> None:
    grid = Grid(9, 8, 0.6, 0.9)
    scene = Scene("rest", grid, CLOTH, 0.02, colliders=(Collider("plane", friction=0.3),))
    plane = np.array([[[[0, 0, 0], [0, 0, 1.0]]]])
    state = State.still(flat(grid, origin=(0, 0, scene.thickness)), plane)
    end = simulate(scene, state, frames=50)
    bound = 2 * max(grid.shape) * EPS * abs(state.positions).max()
    assert abs(end.positions - state.positions).max() <= bound


@pytest.mark.parametrize("grid", GRIDS, ids=["sheet", "tube"])
def test_momentum_and_angular_momentum_are_conserved(grid: Grid) -> None:
    scene = Scene("free", grid, CLOTH, 0.02, gravity=0.0)

    def momenta(state: State) -> tuple[np.ndarray, np.ndarray]:
        p = (scene.mass * state.velocities[0]).reshape(3, -1)
        return p.sum(1), np.cross(state.positions[0].reshape(3, -1), p, axis=0).sum(1)

    states, h = run(scene, moving(grid), frames=10, held=1)  # bending held for more turns a little late
    # Each substep rounds every vertex's momentum by eps m |v|, its arm by eps |x|. The velocity in a
    # substep also takes h F/m, F of about k L: what cancels in pairs is rounded by eps h k |x|.
    steps, x, v = 10 * scene.frame_dt / h, abs(states[-1].positions).max(), abs(states[0].velocities).max()
    scale = scene.mass.sum() * v + h * CLOTH.stretch_stiffness * x * grid.vertices**0.5
    for before, after, arm in zip(momenta(states[0]), momenta(states[-1]), (1.0, x), strict=True):
        np.testing.assert_allclose(after, before, atol=steps * EPS * scale * max(arm, 1))
        assert np.linalg.norm(before) > 1e-3


def test_damping_takes_energy_but_no_momentum() -> None:
    grid = Grid(7, 7, 0.6, 0.6)
    scene = Scene("free", grid, CLOTH.with_changes(damping=5e-3), 0.02, gravity=0.0)
    states, _ = run(scene, moving(grid), frames=5)
    first, last = (centre(scene, [s], "velocities")[0] for s in (states[0], states[-1]))
    np.testing.assert_allclose(last, first, atol=1e-12)
    assert (scene.mass * states[-1].velocities ** 2).sum() < 0.5 * (scene.mass * states[0].velocities ** 2).sum()


def test_drag_leads_to_the_terminal_velocity() -> None:
    grid, rate = Grid(5, 5, 0.4, 0.4), 4.0
    scene = Scene("drag", grid, THREADS.with_changes(drag=rate), 0.05)
    states, h = run(scene, State.still(flat(grid)), frames=100)
    t = np.arange(101) * scene.frame_dt
    speed = centre(scene, states, "velocities")[:, 2]
    # The drag factor is exact for a constant force: only roundoff is left, eps per substep.
    round_off = 4 * EPS * t[-1] / h * G / rate
    np.testing.assert_allclose(speed, -G / rate * (1 - np.exp(-rate * t)), atol=round_off)
    assert abs(speed[-1] + G / rate) <= G / rate * np.exp(-rate * t[-1]) + round_off
    # Positions are off by a share of (h rate)^2 of what they lag behind free flight.
    height = -G / rate * (t - (1 - np.exp(-rate * t)) / rate)
    off = centre(scene, states)[:, 2] - height
    np.testing.assert_allclose(off, 0, atol=h * h * G)
