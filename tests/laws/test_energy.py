"""Energy balance, and the observed orders of convergence in the step and in the spacing."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest
from worlds import THREADS, flat, frequency, rates, run, simulate

from cloth_envs.grid import Grid
from cloth_envs.material import FABRICS, Material
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.laws.air import air_forces, pressure_forces
from cloth_envs.physics.laws.sheet import (
    bend_energy,
    damper_forces,
    gravity_energy,
    kinetic_energy,
    masses,
    spring_energy,
)
from cloth_envs.scene import Air, Scene
from cloth_envs.state import Controls, State

CLOTH = Material(0.2, 100.0, 30.0, 1e-4, damping=1e-3, drag=0.8)


def mechanical(scene: Scene, states: list[State]) -> np.ndarray:
    """Kinetic and elastic energy over time [J]."""
    grid, materials = scene.grid, [scene.material]
    return np.concatenate(
        [
            kinetic_energy(grid, materials, s.velocities)
            + spring_energy(grid, materials, s.positions)
            + bend_energy(grid, materials, s.positions)
            for s in states
        ]
    )


def balance(scene: Scene, states: list[State], controls: Controls) -> np.ndarray:
    """Energy + dissipated - work [J] over time; all steps' powers are summed by the trapezoidal rule."""
    grid, materials = scene.grid, [scene.material]
    energy, power = [], []
    free = np.ones(grid.vertices, bool)
    free[list(scene.handles)] = False
    free = free.reshape(grid.shape)
    for state in states:
        x, v = state.positions, state.velocities
        energy.append(
            kinetic_energy(grid, materials, v)
            + spring_energy(grid, materials, x)
            + bend_energy(grid, materials, x)
            + gravity_energy(grid, materials, x, scene.gravity)
        )
        force = damper_forces(grid, materials, x, v) + air_forces(scene, x, v, controls.wind)
        force -= scene.material.drag * masses(grid, materials) * v
        if scene.pressure:
            force += pressure_forces(grid, x, controls.pressure)
        power.append((force * v * free).sum((1, 2, 3)))
    total, work = np.array(energy)[:, 0], np.array(power)[:, 0]
    return total - np.concatenate([[0], np.cumsum((work[1:] + work[:-1]) / 2)]) * scene.frame_dt


def test_energy_balance_closes_as_the_step_shrinks() -> None:
    grid = Grid(6, 7, 0.5, 0.6)
    errors, spent = [], 0.0
    for steps in (200, 400, 800):
        scene = Scene("swing", grid, CLOTH, 0.25 / steps, handles=(0, 6), air=Air(max_wind=12.0), pressure=True)
        state = State.still(flat(grid))
        controls = Controls.hold(state, scene.handles)
        controls.wind[:] = [1.0, 3.0, 0.5]
        controls.pressure[:] = 1.0
        states, _ = run(scene, state, controls, steps, substeps=1, held=1)
        total = balance(scene, states, controls)
        errors.append(abs(total - total[0]).max())
        spent = np.ptp(gravity_energy(grid, [CLOTH], np.concatenate([s.positions for s in states]), 9.81))
    # Velocity Verlet follows an energy that differs from the true one by order h^2; the dashpots' share is of order h.
    assert (rates(errors) > 1.7).all()
    assert errors[-1] < 1e-4 * spent


def test_without_losses_energy_stays_for_thousands_of_steps() -> None:
    grid = Grid(5, 5, 0.4, 0.4)
    material = CLOTH.with_changes(damping=0.0, drag=0.0)
    drift = []
    for steps in (1, 2):
        scene = Scene("free", grid, material, 2e-3, gravity=0.0)
        state = State.still(flat(grid))
        state.velocities[:] = 0.2 * np.random.default_rng(0).normal(size=state.velocities.shape)
        states, _ = run(scene, state, frames=1000, substeps=steps)
        total = balance(scene, states, Controls.hold(state, ()))
        # It oscillates by w_max h / 2 of itself for each mode, w_max h <= 2, and does not drift.
        drift.append(abs(total[-200:].mean() / total[:200].mean() - 1))
        assert abs(total / total[0] - 1).max() < 1.0
    assert max(drift) < 0.05


@pytest.mark.parametrize("fabric", [*FABRICS, "heavily damped"])
def test_no_fabric_gains_energy_at_its_largest_step(fabric: str) -> None:
    grid = Grid(9, 17, 0.5, 0.4)
    material = FABRICS.get(fabric, Material(damping=2e-3))
    scene = Scene("free", grid, material, 0.02, gravity=0.0)
    state = State.still(flat(grid))
    state.velocities[:] = 0.2 * np.random.default_rng(0).normal(size=state.velocities.shape)
    states, _ = run(scene, state, frames=100, dtype="float32")
    first, last = mechanical(scene, [states[0], states[-1]])
    # Dashpots and drag only take; an unstable mode would multiply by more than e in each of thousands of steps.
    assert last < first


@pytest.mark.parametrize(("bend", "damping", "frames"), [(1e-3, 0.0, 50), (1e-3, 1e-5, 150), (2e-5, 0.0, 600)])
def test_no_hardly_damped_sheet_gains_energy_at_its_largest_step(bend: float, damping: float, frames: int) -> None:
    grid = Grid(17, 17, 1.0, 1.0)
    scene = Scene("free", grid, Material(bend_stiffness=bend, damping=damping), 0.02, gravity=0.0)
    random, state = np.random.default_rng(6), State.still(flat(grid))
    state.positions += random.normal(0, 2e-3, state.positions.shape)
    state.velocities[:] = random.normal(0, 0.3, state.positions.shape)
    total = mechanical(scene, run(scene, state, frames=frames)[0])
    assert total.max() == total[0]
    assert total[-20:].mean() < 1.05 * total[1:21].mean()  # at any time in an oscillation


NEARLY_UNDAMPED = Material(damping=9e-6)  # 2 % above where ``directed_bound`` counts it as damped


@pytest.mark.parametrize(
    ("degrees", "material"),
    [
        (30, Material(shear_stiffness=1.0)),
        (60, Material(shear_stiffness=1.0)),
        (60, Material(shear_stiffness=0.0)),
        (80, Material(shear_stiffness=0.1)),
        (50, FABRICS["silk"]),
        (80, FABRICS["silk"]),
        (70, FABRICS["wool"]),
        (65, NEARLY_UNDAMPED),
        (80, NEARLY_UNDAMPED),
    ],
)
def test_no_sheared_sheet_gains_energy_at_its_largest_step(degrees: float, material: Material) -> None:
    grid, angle = Grid(17, 17, 1.0, 1.0), np.radians(degrees)
    scene = Scene("free", grid, material, 0.02, gravity=0.0)
    state = State.still(flat(grid, down=(np.sin(angle), -np.cos(angle), 0)))
    state.positions += np.random.default_rng(4).normal(0, 1e-5, state.positions.shape)
    total = mechanical(scene, run(scene, state, frames=40)[0])
    assert (total[1:] < total[0]).all()


def shearing(rate: float) -> State:
    """A flat sheet whose rows slide along each other at ``rate`` [1/s]."""
    state = State.still(flat(Grid(17, 17, 1.0, 1.0)))
    state.velocities[:, 0] = rate * (state.positions[:, 1] + 0.5)
    state.velocities += np.random.default_rng(3).normal(0, 1e-3, state.velocities.shape)
    return state


@pytest.mark.parametrize("fabric", ["silk", "wool"])
def test_no_sheet_that_is_sheared_within_a_frame_gains_energy(fabric: str) -> None:
    scene = Scene("free", Grid(17, 17, 1.0, 1.0), FABRICS[fabric], 0.04, gravity=0.0)
    total = mechanical(scene, run(scene, shearing(100.0), frames=25)[0])
    assert (total[1:] < total[0]).all()


def test_steps_follow_each_sheets_own_shear() -> None:
    """In a batch, with threads and from a saved state alike."""
    scene = Scene("free", Grid(17, 17, 1.0, 1.0), FABRICS["silk"], 0.04, gravity=0.0)
    states = [shearing(100.0), shearing(1.0)]
    batch = states[0].select([0, 0])
    batch.assign([1], states[1])
    together = ExplicitSolver(scene, num_envs=2, threads=2)
    together.reset(batch)
    alone = [ExplicitSolver(scene) for _ in states]
    for solver, state in zip(alone, states, strict=True):
        solver.reset(state)
    for _ in range(3):
        both = together.advance(Controls.hold(together.state, ()))
        for i, solver in enumerate(alone):
            one = solver.advance(Controls.hold(solver.state, ()))
            np.testing.assert_array_equal(both.positions[i], one.positions[0])
            assert together.last_cuts[i].tolist() == solver.last_cuts[0].tolist()
            solver.reset(one.copy())
    assert together.last_cuts[0, 0] > together.last_cuts[1, 0] == together.substeps[1]


def test_a_frame_that_is_not_finite_is_stepped_again() -> None:
    scene = Scene("free", Grid(17, 17, 1.0, 1.0), Material(), 0.04, gravity=0.0)
    states = []
    for share in (1, 5):
        solver = ExplicitSolver(scene)
        solver.reset(shearing(1.0))
        solver.cuts[:, 0] //= share  # the step is sharp to 0.9
        states.append(solver.advance(Controls.hold(solver.state, ())))
    assert solver.last_cuts[0, 0] > solver.substeps[0]
    np.testing.assert_allclose(states[1].positions, states[0].positions, atol=1e-4)


def convergence(material: Material, air: Air | None, numbers: Sequence[int]) -> np.ndarray:
    """How far ends with successive ``numbers`` of substeps are apart, which shrinks like the error itself [m]."""
    grid = Grid(7, 6, 0.5, 0.6)
    scene = Scene("swing", grid, material, 0.05, handles=(0, 5), air=air)
    state = State.still(flat(grid))
    controls = Controls.hold(state, scene.handles)
    controls.wind[:] = [0.5, 3.0, 1.0]
    controls.handle_positions[..., 1] += 0.02
    ends = [simulate(scene, state, controls, 3, substeps=n).positions for n in numbers]
    return np.array([abs(a - b).max() for a, b in itertools.pairwise(ends)])


def test_positions_converge_in_the_step() -> None:
    numbers = (80, 160, 320, 640, 1280)
    undamped = CLOTH.with_changes(damping=0.0)
    assert (abs(rates(convergence(undamped, None, numbers)) - 2) < 0.08).all()
    # Dashpots see velocities of half a substep before, and the air at a frame's start doesn't know yet how velocities
    # change: their shares are of first order.
    for material, air in ((CLOTH, None), (undamped, Air(max_wind=12.0))):
        assert rates(convergence(material, air, numbers)).mean() > 0.9


def test_a_plucked_sheet_converges_at_second_order_in_the_spacing() -> None:
    errors = []
    strain, amplitude = 0.1, 1e-4
    side = 0.5 * (1 + strain)
    # Tension Y e per rest width is Y e / (1 + e) per stretched width, density rho / (1 + e)^2.
    speed = (THREADS.stretch_stiffness * strain * (1 + strain) / THREADS.areal_density) ** 0.5
    omega = 2**0.5 * np.pi / side * speed
    for n in (5, 9, 17, 33):
        grid = Grid(n, n, 0.5, 0.5)
        border = np.ones((n, n), bool)
        border[1:-1, 1:-1] = False
        held = tuple(np.flatnonzero(border).tolist())
        scene = Scene("drum", grid, THREADS, 2 * np.pi / omega / 12, held, gravity=0.0)
        state = State.still(flat(grid) * (1 + strain))
        line = np.sin(np.pi * np.arange(n) / (n - 1))
        shape = np.outer(line, line)
        state.positions[0, 2] = amplitude * shape
        states, _ = run(scene, state, frames=36, substeps=200)
        measured = frequency(np.array([(s.positions[0, 2] * shape).sum() for s in states]), scene.frame_dt)
        errors.append(abs(measured / omega - 1))
    # Lattice and step: w = w0 (1 - (q s)^2 / 24 + (w h)^2 / 24), q = pi / side.
    assert (abs(rates(errors) - 2) < 0.1).all()
    assert errors[-1] < (np.pi / 32) ** 2 / 24 * 1.01
