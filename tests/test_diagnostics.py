"""Diagnostics against cases worked out by hand, two different cloths at once."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from _minicloth_kernels import inspect

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.laws.budget import budget, implicit_residual, slow_motion
from cloth_envs.physics.laws.diagnostics import (
    angular_momentum,
    depths,
    energy,
    linear_momentum,
    penetration,
    strain,
)
from cloth_envs.scene import Air, Collider, Scene
from cloth_envs.state import Controls, State

GRID = Grid(3, 3, 1.0, 1.0)  # masses: corners 1/16, sides 1/8, middle 1/4 of the sheet's
SHEETS = [Material(0.2, 500.0, 150.0, 1e-3, 1e-3, 0.5), Material(0.4, 90.0, 10.0, 2e-3, 2e-3, 2.0)]
RHO, Y, G, B, DAMPING, DRAG, *_ = (
    np.array(values) for values in zip(*(m.as_dict().values() for m in SHEETS), strict=True)
)
SMOOTH = [m.with_changes(drag=0.0) for m in SHEETS]
SCENE = Scene("desk", GRID, SHEETS[0], 0.1)
ALL = tuple(range(9))
EXACT = {"rtol": 1e-12, "atol": 1e-12}  # sums of a few dozen numbers of order 1 to 1000


def sheet(z: float = 0.0, centre: tuple[float, float] = (0.0, 0.0)) -> State:
    """Two flat unit sheets at height ``z`` whose triangles face upwards."""
    x = np.zeros((2, 3, 3, 3))
    x[:, 0] = centre[0] + np.array([-0.5, 0.0, 0.5])
    x[:, 1] = centre[1] + np.array([[0.5], [0.0], [-0.5]])
    x[:, 2] = z
    return State.still(x)


def later(state: State, dt: float) -> State:
    """The same cloth ``dt`` [s] later."""
    after = state.copy()
    after.time += dt
    return after


def test_energy_terms() -> None:
    e, height = 0.1, 2.0
    state = sheet(height)
    state.positions[:, :2] *= 1 + e
    state.velocities[:] = np.reshape([1.0, 2.0, 2.0], (3, 1, 1))
    state.pressure[:] = [3.0, -5.0]
    found = energy(replace(SCENE, pressure=True), state, SHEETS)
    np.testing.assert_allclose(found.kinetic, RHO * 9 / 2, **EXACT)
    np.testing.assert_allclose(found.gravity, RHO * 9.81 * height, **EXACT)
    # Threads: Y e^2 / 2 per area and direction. A cell's diagonals: 2 springs G d^2 / (2 a^2) = G, each G (d e)^2 / 2,
    # together 2 G e^2 a^2.
    np.testing.assert_allclose(found.springs, (Y + 2 * G) * e**2, **EXACT)
    np.testing.assert_allclose(found.bending, 0, **EXACT)
    # A cone from the origin: area times height over 3.
    np.testing.assert_allclose(found.pressure, -state.pressure * (1 + e) ** 2 * height / 3, **EXACT)
    np.testing.assert_allclose(found.mechanical, found.kinetic + found.gravity + found.springs, **EXACT)
    assert (energy(SCENE, state, SHEETS).pressure == 0).all()
    state.positions[:, 2] = 0.3 * state.positions[:, 0] ** 2 / 2 / (1 + e) ** 2
    # Curvature 0.3 at the three middles of rows, whose strips are 1/4, 1/2, 1/4 m wide and 1/2 m long.
    np.testing.assert_allclose(energy(SCENE, state, SHEETS).bending, B * 0.3**2 / 2 * 0.5, **EXACT)


def test_momenta() -> None:
    spin, drift, centre = 3.0, np.array([1.0, -2.0, 0.5]), (0.3, 0.7)
    state = sheet(0.0, centre)
    arm = state.positions - np.reshape([*centre, 0.0], (3, 1, 1))
    state.velocities[:, 0], state.velocities[:, 1] = -spin * arm[:, 1], spin * arm[:, 0]
    inertia = 0.25 * RHO  # 4 corners of 1/16 at r^2 = 1/2, 4 sides of 1/8 at 1/4
    own = inertia[:, None] * [0, 0, spin]
    np.testing.assert_allclose(linear_momentum(SCENE, state, SHEETS), 0, **EXACT)
    np.testing.assert_allclose(angular_momentum(SCENE, state, SHEETS), own, **EXACT)
    state.velocities += drift[:, None, None]
    np.testing.assert_allclose(linear_momentum(SCENE, state, SHEETS), RHO[:, None] * drift, **EXACT)
    orbit = RHO[:, None] * np.cross([*centre, 0.0], drift)
    np.testing.assert_allclose(angular_momentum(SCENE, state, SHEETS), own + orbit, **EXACT)
    np.testing.assert_allclose(angular_momentum(SCENE, state, SHEETS, about=[*centre, 0.0]), own, **EXACT)


def test_strain_statistics() -> None:
    x = sheet().positions
    x[0, 0] *= 1.1  # 6 of the 12 edges
    x[1, 0] += 0.2 * x[1, 1]
    found = strain(GRID, x)
    tilted = np.hypot(1, 0.2) - 1
    np.testing.assert_allclose(found.mean, [0.05, tilted / 2], **EXACT)
    np.testing.assert_allclose(found.p99, [0.1, tilted], **EXACT)
    np.testing.assert_allclose(found.max, [0.1, tilted], **EXACT)
    # A cell leans by 0.2: one diagonal spans (1.2, 1), the other (0.8, 1).
    long, short = np.hypot(1.2, 1) / 2**0.5 - 1, 1 - np.hypot(0.8, 1) / 2**0.5
    shear = strain(GRID, x, shear=True)
    np.testing.assert_allclose(shear.max[1], max(long, short), **EXACT)
    np.testing.assert_allclose(shear.mean[1], (long + short) / 2, **EXACT)
    x[0, 0, 0, 0] = np.nan
    assert np.isnan(strain(GRID, x).max[0])
    assert np.isfinite(strain(GRID, x).max[1])


def test_penetration_keeps_the_thickness() -> None:
    bodies = (Collider("plane"), Collider("sphere", 0.3), Collider("capsule", 0.2))
    scene = replace(SCENE, colliders=bodies, thickness=0.01, handles=(0,))
    state = sheet(0.004)
    far = [9.0, 9.0, 9.0]
    state.colliders = np.tile(np.array([[[0, 0, 0], [0, 0, 1]], [far, far], [far, far]], float), (2, 1, 1, 1))
    state.collider_velocities = np.zeros_like(state.colliders)
    state.positions[0, 2, 2, 2] = 0.5  # one of the first cloth is clear of the plane
    state.positions[1, 2] = 1.0
    state.colliders[1, 1] = [0, 0, 0.75]  # 0.25 below the middle, sqrt(0.25^2 + 0.5^2) from the sides
    state.colliders[1, 2] = [[0.5, -0.1, 0.95], [0.5, 0.1, 0.95]]  # 0.05 below the right side
    found = penetration(scene, state)
    np.testing.assert_allclose(found.count, [7, 2])  # the handle does not count
    np.testing.assert_allclose(found.max, [0.006, 0.16], **EXACT)
    np.testing.assert_allclose(found.mean, [0.006, (0.06 + 0.16) / 2], **EXACT)
    np.testing.assert_allclose(penetration(scene, state, thickness=0.0).count, [0, 2])
    assert penetration(scene, state, tolerance=0.007).count[0] == 0
    assert (depths(SCENE, state) == -np.inf).all()
    assert (penetration(SCENE, state).max == 0).all()


def test_work_on_a_sheet_that_is_carried() -> None:
    up, dt, blow = 2.0, 0.1, 5.0
    wind = Air(tangential=0.0)
    scene = replace(SCENE, handles=ALL, air=wind, pressure=True)
    before = sheet()
    before.velocities[:, 2] = up
    after = later(before, dt)
    after.positions[:, 2] += up * dt
    after.wind[:, 2], after.pressure[:] = blow, [3.0, -4.0]
    found = budget(scene, [before, after], SHEETS)
    np.testing.assert_allclose(found.gained, RHO * 9.81 * up * dt, **EXACT)
    np.testing.assert_allclose(found.air, 0.5 * 1.2 * 1.5 * (blow - up) ** 2 * up * dt, **EXACT)
    np.testing.assert_allclose(found.pressure, after.pressure * up * dt, **EXACT)
    np.testing.assert_allclose(found.drag, RHO * DRAG * up**2 * dt, **EXACT)
    np.testing.assert_allclose(found.damping, 0, **EXACT)
    # The hand that carries it pays weight and drag, less what the air gives.
    np.testing.assert_allclose(found.handles, found.gained + found.drag - found.air - found.pressure, **EXACT)
    np.testing.assert_allclose(found.rest, 0, atol=1e-12)
    twice = budget(scene, [before, after, later(after, 0.0)], SHEETS)
    np.testing.assert_allclose(twice.handles, found.handles, **EXACT)


def test_a_driven_handle_is_paid_its_kinetic_energy() -> None:
    scene = replace(SCENE, handles=ALL, gravity=0.0)
    before, after = sheet(), later(sheet(), 0.1)
    after.velocities[:, 0] = 3.0
    found = budget(scene, [before, after], SMOOTH)
    np.testing.assert_allclose(found.handles, RHO * 9 / 2, **EXACT)
    np.testing.assert_allclose(found.rest, 0, atol=1e-12)


def test_loss_in_dashpots() -> None:
    rate, dt = 4.0, 0.1
    before = sheet()
    before.velocities[:, 0] = rate * before.positions[:, 0]
    found = budget(SCENE, [before, later(before, dt)], SMOOTH)
    # As the spring energy at strain 1 and twice that: threads damping Y rate^2 per area; a diagonal grows at half
    # the rate, 2 springs of constant G: 2 damping G (rate d / 2)^2 = damping G rate^2 a^2 a cell.
    np.testing.assert_allclose(found.damping, DAMPING * (Y + G) * rate**2 * dt, **EXACT)


def test_the_budget_of_a_simulation_closes_and_notices_a_wrong_gravity() -> None:
    grid = Grid(6, 7, 0.5, 0.6)
    rests, gained = [], 0.0
    for steps in (100, 200):
        material = Material(0.2, 100.0, 30.0, 1e-4, 1e-3, 0.8)
        scene = Scene("swing", grid, material, 0.125 / steps, handles=(0, 6), air=Air(max_wind=12.0))
        x = np.zeros((1, 3, 6, 7))
        x[0, 0], x[0, 1] = np.linspace(0, 0.6, 7), -np.linspace(0, 0.5, 6)[:, None]
        state = State.still(x)
        backend = ExplicitSolver(scene, dtype="float64", substeps=1, held=1)
        backend.reset(state)
        states = [backend.state.copy()]
        for step in range(steps):
            controls = Controls.hold(state, scene.handles)
            t = (step + 1) * scene.frame_dt
            controls.handle_positions[..., 2] += 2 * t * t  # the handles are lifted
            controls.handle_velocities[..., 2] = 4 * t
            controls.wind[:] = [1.0, 3.0, 0.5]
            states.append(backend.advance(controls).copy())
        found = budget(scene, states)
        rests.append(float(found.rest[0]))
        gained = float(found.handles[0])
        wrong = budget(replace(scene, gravity=9.0), states)
    # Velocity Verlet leaves errors of second order in h: less than can be told from those of the rule that sums powers.
    assert max(map(abs, rests)) < 1e-3 * abs(gained)
    assert abs(wrong.rest[0]) > 3 * abs(rests[1])


def test_residual_of_an_implicit_step() -> None:
    h = 0.01
    before = sheet()
    after = later(before, h)
    after.velocities[:, 2] = (-9.81 * h / (1 + DRAG * h))[:, None, None]
    after.positions[:] += h * after.velocities
    np.testing.assert_allclose(implicit_residual(SCENE, before, after, SHEETS), 0, atol=1e-12)
    # A sheet that hangs in the air lacks its weight.
    np.testing.assert_allclose(implicit_residual(SCENE, before, later(before, h), SHEETS), 1, **EXACT)
    # Only its middle does, a quarter of the mass; in a vacuum the rest falls too slowly by the drag's share.
    after.velocities[1, 2, 1, 1] = 0.0
    found = implicit_residual(SCENE, before, after, [m.with_changes(damping=0) for m in SMOOTH])
    slow = 1 - 1 / (1 + DRAG * h)
    np.testing.assert_allclose(found, [slow[0], 0.25 + 0.75 * slow[1]], **EXACT)
    # In contact nobody knows the force.
    on_table = replace(SCENE, colliders=(Collider("plane"),), thickness=0.01)
    resting = sheet(0.01)
    resting.colliders = np.tile(np.array([[0, 0, 0], [0, 0, 1.0]]), (2, 1, 1, 1))
    assert (implicit_residual(on_table, resting, later(resting, h), SHEETS) == 0).all()


def test_slow_motion_gate() -> None:
    start, converged, run = sheet(0.0), sheet(-1.0), sheet(0.0)
    run.positions[0, 2], run.positions[1, 2] = -0.97, -0.9
    found = slow_motion(SCENE, [start, run], [start, converged], tolerance=0.05)
    np.testing.assert_allclose(found.difference, [0.03, 0.1], **EXACT)
    np.testing.assert_allclose(found.fall, 1, **EXACT)
    np.testing.assert_allclose(found.fraction, [0.03, 0.1], **EXACT)
    assert found.passed.tolist() == [True, False]
    # It is the worst moment that counts, and a cloth that rests has no fall: then 5 % of its length.
    there_and_back = slow_motion(SCENE, [start, run, start], [start, converged, start])
    np.testing.assert_allclose(there_and_back.fraction, found.fraction, **EXACT)
    resting = slow_motion(SCENE, [start, sheet(0.001)], [start, start])
    np.testing.assert_allclose(resting.fraction, 0.001 / 0.05, **EXACT)
    run.positions[0, 2, 0, 0] = np.nan
    assert not slow_motion(SCENE, [start, run], [start, converged]).passed[0]


def test_mistakes_say_what_to_give() -> None:
    state = sheet()
    with pytest.raises(ValueError, match="one for each"):
        energy(SCENE, state, SHEETS[:1])
    with pytest.raises(ValueError, match="at least two"):
        budget(SCENE, [state])
    with pytest.raises(ValueError, match="start first"):
        slow_motion(SCENE, [state, state], [state])


def test_a_net_of_particles_is_refused() -> None:
    scene = gym.make("MiniCloth-Pressure-v0", preset="zhao2024").unwrapped.scene
    with pytest.raises(ValueError, match="net of particles"):
        energy(scene, State.still(np.zeros((1, 3, *scene.grid.shape))))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("shape", [(5, 7), (4, 37)])  # rows shorter and longer than any vector
def test_the_compiled_check_is_the_largest_strain_and_the_energy(
    dtype: str, periodic: bool, shape: tuple[int, int]
) -> None:
    grid = Grid(*shape, 0.5, 0.8, periodic=periodic)
    x, v = np.random.default_rng(0).normal(size=(2, 2, 3, *grid.shape)).astype(dtype)
    x[1, 2, 3, 4] = np.nan
    (finite, largest, kinetic), (broken, _, _) = inspect(x, v, grid.row_spacing, grid.col_spacing, periodic)
    along = (np.roll(x[0], -1, 2) - x[0])[..., : None if periodic else -1]
    edges = [
        np.linalg.norm(along, axis=0) / grid.col_spacing,
        np.linalg.norm(np.diff(x[0], axis=1), axis=0) / grid.row_spacing,
    ]
    tolerance = 3 * grid.vertices * float(np.finfo(dtype).eps)  # a sum of squares of all components
    assert largest + 1 == pytest.approx(max(edge.max() for edge in edges), rel=tolerance)
    assert kinetic == pytest.approx(0.5 * np.square(v[0].astype(float)).sum() / grid.vertices, rel=tolerance)
    assert finite
    assert not broken
