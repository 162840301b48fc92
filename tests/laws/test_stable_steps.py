"""The explicit solver's steps hold stiff shear, free borders, damping, strips and coarse grids."""

from __future__ import annotations

import numpy as np
import pytest
from test_energy import mechanical
from worlds import flat, run

from cloth_envs.grid import Grid
from cloth_envs.material import FABRICS, Material
from cloth_envs.physics.explicit.bounds import FAST, LEVELS, UNDAMPED, stable_step
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.laws.stencil import edges
from cloth_envs.physics.solver import stiffness_bound
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State

STRIP, COARSE, SQUARE = Grid(3, 17, 0.125, 1.0), Grid(5, 5, 1.0, 1.0), Grid(25, 25, 1.0, 1.0)


def free(grid: Grid, material: Material) -> Scene:
    return Scene("free", grid, material, 0.02, gravity=0.0)


def kept(grid: Grid, degrees: float) -> np.ndarray:
    """Cells sheared with the lengths of their edges."""
    angle = np.radians(degrees)
    return flat(grid, down=(np.sin(angle), -np.cos(angle), 0))


def simple(grid: Grid, degrees: float) -> np.ndarray:
    """Rows slid along each other."""
    return flat(grid, down=(np.tan(np.radians(degrees)), -1, 0))


def zigzag(grid: Grid, degrees: float) -> np.ndarray:
    """Rows sheared one way and the other by turns."""
    x, rows = kept(grid, degrees), np.arange(grid.rows)[:, None]
    x[:, 0] -= 2 * (rows // 2) * grid.row_spacing * np.sin(np.radians(degrees))
    return x


def nearly_undamped(grid: Grid, material: Material) -> Material:
    """2 % above where it counts as damped."""
    frequency = np.sqrt(stiffness_bound(free(grid, material), material)[0])
    return material.with_changes(damping=1.02 * UNDAMPED / frequency)


def largest(grid: Grid, material: Material, x: np.ndarray) -> float:
    """Largest eigenvalue of ``M^-1 K`` in the plane of springs that act along themselves, by iteration [1/s^2]."""
    at, mass = x[0, :2].reshape(2, -1), grid.areas.ravel() * material.areal_density
    u, found = np.random.default_rng(0).normal(size=at.shape), 0.0
    for _ in range(300):
        force = np.zeros_like(u)
        for edge in edges(grid):
            d = at[:, edge.second] - at[:, edge.first]
            n = d / np.linalg.norm(d, axis=0)
            k = edge.weight * getattr(material, edge.modulus)
            pull = k * (n * (u[:, edge.second] - u[:, edge.first])).sum(0) * n
            force[:, edge.first] -= pull
            force[:, edge.second] += pull
        u = force / mass
        found = float(np.linalg.norm(u))
        u /= found
    return found


@pytest.mark.parametrize("degrees", [0.0, 29.5])
@pytest.mark.parametrize(
    ("grid", "material"),
    [
        (Grid(13, 13, 1.0, 1.0), Material(shear_stiffness=1500.0, damping=1e-3)),
        (STRIP, Material(shear_stiffness=1000.0, damping=5e-3)),
        (Grid(13, 13, 0.094, 0.094), FABRICS["denim"]),  # cells of a metre in 129 x 129
    ],
)
def test_a_step_holds_free_borders_and_damping_as_far_as_cells_are_sheared(
    grid: Grid, material: Material, degrees: float
) -> None:
    """``h^2 K + 2 h C <= 4 M``."""
    assert np.sin(np.radians(degrees)) < LEVELS[0][2]
    h, k = stable_step(free(grid, material), material), largest(grid, material, kept(grid, degrees))
    assert h * h * k + 2 * h * material.damping * k < 4


@pytest.mark.parametrize(
    ("grid", "material", "x", "frames"),
    [
        (SQUARE, Material(shear_stiffness=1500.0, damping=1e-3), flat(SQUARE), 50),
        (STRIP, Material(shear_stiffness=1000.0, damping=5e-3), flat(STRIP), 30),
        (SQUARE, Material(shear_stiffness=1500.0), kept(SQUARE, 10), 30),
        (STRIP, nearly_undamped(STRIP, Material()), kept(STRIP, 72), 40),
        (STRIP, FABRICS["silk"], zigzag(STRIP, 75), 20),
        (STRIP, FABRICS["wool"], zigzag(STRIP, 75), 20),
        (COARSE, FABRICS["leather"], simple(COARSE, 56), 30),
        (COARSE, FABRICS["wool"], simple(COARSE, 57), 30),
        (Grid(3, 3, 1.0, 1.0), FABRICS["wool"], simple(Grid(3, 3, 1.0, 1.0), 62), 30),
    ],
    ids=["flat", "flat strip", "stiff", "undamped strip", "zigzag silk", "zigzag wool", "leather", "wool", "3x3"],
)
def test_no_free_sheet_gains_energy(grid: Grid, material: Material, x: np.ndarray, frames: int) -> None:
    state = State.still(x + np.random.default_rng(1).normal(0, 1e-6, x.shape))
    total = mechanical(free(grid, material), run(free(grid, material), state, frames=frames)[0])
    assert total.max() == total[0]


def test_a_damped_sheet_held_sheared_stays_at_rest() -> None:
    """Its border is held at 29 degrees of shear, where it is in balance."""
    inside = np.zeros(SQUARE.shape, bool)
    inside[1:-1, 1:-1] = True
    held = tuple(np.flatnonzero(~inside).tolist())
    material = FABRICS["cotton"].with_changes(damping=1e-3)
    scene = Scene("held", SQUARE, material, 0.02, handles=held, gravity=0.0)
    x, random = kept(SQUARE, 29), np.random.default_rng(2)
    x[:, :2] += random.normal(0, 1e-6, x[:, :2].shape) * inside
    state = State.still(x)
    last = run(scene, state, Controls.hold(state, held), frames=60)[0][-1]
    assert abs(last.positions - kept(SQUARE, 29)).max() < 1e-5
    assert abs(last.velocities).max() < 1e-6


def test_frames_in_which_neighbours_part_fast_take_more_steps() -> None:
    """In a batch as alone, wherever the sheet as a whole goes."""
    scene = free(COARSE, FABRICS["leather"])
    wave = np.sqrt(scene.material.stretch_stiffness / scene.material.areal_density)
    state = State.still(np.repeat(flat(COARSE), 3, 0))
    state.velocities[0] += wave
    state.velocities[1, 2, 2, 2] = 1.1 * FAST * wave
    state.velocities[2, 2, 2, 2] = 0.9 * FAST * wave
    together = ExplicitSolver(scene, num_envs=3)
    together.reset(state)
    found = together.advance(Controls.hold(state, ()))
    least = together.substeps[0]
    assert together.last_cuts[0, 0] == together.last_cuts[2, 0] == least
    assert together.last_cuts[1, 0] > 2 * least
    for i in range(3):
        alone = ExplicitSolver(scene)
        alone.reset(state.select([i]))
        one = alone.advance(Controls.hold(alone.state, ()))
        np.testing.assert_array_equal(one.positions[0], found.positions[i])
        np.testing.assert_array_equal(one.velocities[0], found.velocities[i])
