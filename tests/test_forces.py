"""The twin's forces: gradients of their energies, balanced inside the cloth, equal to the sheet's continuum."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.laws.air import OWN, air_forces, pressure_energy, pressure_forces
from cloth_envs.physics.laws.sheet import (
    bend_energy,
    bend_forces,
    damper_forces,
    gravity_energy,
    gravity_forces,
    spring_energy,
    spring_forces,
)
from cloth_envs.physics.laws.stencil import edges
from cloth_envs.scene import Air, Scene

EPS = np.finfo(np.float64).eps
GRIDS = {
    "sheet": Grid(5, 6, 0.5, 0.9),
    "smallest": Grid(3, 3, 0.2, 0.3),
    "tube": Grid(4, 7, 0.5, 0.8, periodic=True),
    "smallest tube": Grid(3, 3, 0.2, 0.3, periodic=True),
}
SHEETS = [
    Material(0.2, 500.0, 150.0, 1e-3, 1e-3),
    Material(0.4, 90.0, 10.0, 2e-4, 1e-4, compression=0.2, buckling_strain=0.1, post_buckling=0.3),
]
PRESSURE = np.array([3.0, -7.0])
Energy = Callable[[Grid, np.ndarray], np.ndarray]
TERMS: dict[str, tuple[Energy, Energy]] = {
    "springs": (
        lambda g, x: spring_forces(g, SHEETS, x),
        lambda g, x: spring_energy(g, SHEETS, x),
    ),
    "bending": (lambda g, x: bend_forces(g, SHEETS, x), lambda g, x: bend_energy(g, SHEETS, x)),
    "gravity": (
        lambda g, x: gravity_forces(g, SHEETS, x, 9.81),
        lambda g, x: gravity_energy(g, SHEETS, x, 9.81),
    ),
    "pressure": (
        lambda g, x: pressure_forces(g, x, PRESSURE),
        lambda g, x: pressure_energy(g, x, PRESSURE),
    ),
}


def crumpled(grid: Grid, seed: int = 0) -> np.ndarray:
    """Random points ``(2, 3, H, W)`` [m], no edge shorter than a third of a spacing."""
    rng = np.random.default_rng(seed)
    while True:
        x = 0.5 * rng.normal(size=(2, 3, *grid.shape))
        flat = x.reshape(2, 3, -1)
        ends = [flat[..., edge.second] - flat[..., edge.first] for edge in edges(grid)]
        if min(np.linalg.norm(d, axis=1).min() for d in ends) > min(grid.row_spacing, grid.col_spacing) / 3:
            return x


@pytest.mark.parametrize("term", TERMS)
@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
def test_force_is_the_negative_gradient_of_the_energy(grid: Grid, term: str) -> None:
    force, energy = TERMS[term]
    x = crumpled(grid)
    rng = np.random.default_rng(1)
    e = 1e-3 * min(grid.row_spacing, grid.col_spacing)
    for _ in range(8):
        u = rng.normal(size=x.shape)
        if term == "pressure":  # the border of an open sheet takes part in p V but in no force
            u[:, :, [0, -1]] = 0
            if not grid.periodic:
                u[..., [0, -1]] = 0

        def slope(e: float, u: np.ndarray = u) -> np.ndarray:
            return (energy(grid, x + e * u) - energy(grid, x - e * u)) / (2 * e)

        # Richardson: the error e^2 of a central difference cancels, (e / |d|)^4 of the terms' size is left.
        numeric = (4 * slope(e / 2) - slope(e)) / 3
        work = (force(grid, x) * u).sum((1, 2, 3))
        size = abs(force(grid, x) * u).sum((1, 2, 3))
        round_off = 64 * EPS * abs(energy(grid, x)) / e
        assert (abs(numeric + work) <= (10 * 1e-3 * 3) ** 4 * size + round_off).all()


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
def test_inner_forces_have_no_sum_and_no_torque(grid: Grid) -> None:
    x, v = crumpled(grid), crumpled(grid, 3)
    for force in (
        spring_forces(grid, SHEETS, x),
        damper_forces(grid, SHEETS, x, v),
        bend_forces(grid, SHEETS, x),
    ):
        scale = abs(force).sum() * abs(x).max()
        assert abs(force).max() > 1e-3
        assert abs(force.sum((2, 3))).max() <= EPS * scale * 4
        assert abs(np.cross(x, force, axis=1).sum((2, 3))).max() <= EPS * scale * 4


def test_dampers_are_the_gradient_of_half_the_dissipation() -> None:
    grid = GRIDS["sheet"]
    x, v, u = crumpled(grid), crumpled(grid, 3), crumpled(grid, 4)

    def power(v: np.ndarray) -> np.ndarray:
        return -(damper_forces(grid, SHEETS, x, v) * v).sum((1, 2, 3))

    # The power is quadratic in v, so a central difference over any step is exact.
    slope = (power(v + u) - power(v - u)) / 2
    work = (damper_forces(grid, SHEETS, x, v) * u).sum((1, 2, 3))
    assert (power(v) > 0).all()
    np.testing.assert_allclose(slope / 2, -work, atol=64 * EPS * power(abs(v) + abs(u)).max())
    turning = np.cross(np.array([0.3, -0.2, 0.5]), x, axisb=1, axisc=1)  # a rigid turn stretches nothing
    assert abs(damper_forces(grid, SHEETS, x, turning)).max() <= 1e-12 * 500


@pytest.mark.parametrize("shape", [(5, 6), (9, 16), (33, 20)])
def test_energy_of_an_even_strain_is_that_of_the_sheet(shape: tuple[int, int]) -> None:
    grid, material, strain = Grid(*shape, 0.5, 0.9), Material(0.2, 500.0, 150.0, 0.0), 1e-4
    r, c = np.indices(shape)
    rest = np.stack([c * grid.col_spacing, r * grid.row_spacing, 0.0 * r])[None]
    area = 0.5 * 0.9
    for i, j in ((0, 0), (1, 1), (0, 1), (1, 0)):
        gradient = np.eye(3)
        gradient[i, j] += strain
        energy = spring_energy(grid, [material], np.einsum("ij,bjrc->birc", gradient, rest))[0]
        if i != j:
            expected = material.shear_stiffness * strain**2 / 2 * area
        else:  # a diagonal stretches by strain * cos^2, and two springs G d^2 / (2 a b) share a cell
            side, other = (grid.col_spacing, grid.row_spacing)[:: 1 - 2 * i]
            shared = material.shear_stiffness * (side / other) ** 2
            expected = (material.stretch_stiffness + shared) * strain**2 / 2 * area
        # Threads turn with the shear: (strain^2 / 2)^2 Y, and lengths are quadratic: relative strain.
        assert energy == pytest.approx(expected, rel=4 * strain)


@pytest.mark.parametrize("cols", [12, 24, 48])
def test_bending_a_tube_costs_that_of_a_sheet(cols: int) -> None:
    radius = 0.2
    grid = Grid(5, cols, 0.5, 2 * np.pi * radius, periodic=True)
    angle = 2 * np.pi * np.arange(cols) / cols
    x = np.zeros((1, 3, 5, cols))
    x[0, 0], x[0, 1] = radius * np.cos(angle), radius * np.sin(angle)
    x[0, 2] = (np.arange(5) * grid.row_spacing)[:, None]
    energy = bend_energy(grid, [Material(bend_stiffness=1e-3)], x)[0]
    # |x_- - 2 x + x_+| = 4 R sin^2(t / 2) for an angle t, against R t^2: relative t^2 / 12, twice in a square.
    expected = 1e-3 / 2 / radius**2 * 0.5 * grid.width
    assert energy == pytest.approx(expected, rel=(2 * np.pi / cols) ** 2 / 6)


def test_wind_on_a_flat_sheet() -> None:
    grid = Grid(4, 5, 0.6, 0.8)
    scene = Scene("wind", grid, SHEETS[0], 0.02, air=Air(1.2, normal=1.5, lift=0.7, tangential=0.1))
    r, c = np.indices(grid.shape)
    x = np.stack([c * grid.col_spacing, -r * grid.row_spacing, 0.0 * r])[None]
    still = np.zeros_like(x)
    for wind in ([0.0, 0, 3], [2.0, 0, 0], [2.0, -1, -3]):
        force = air_forces(scene, x, still, np.array([wind])).sum((2, 3))[0]
        across, along = np.array([0, 0, wind[2]]), np.array([wind[0], wind[1], 0])
        expected = (1.5 * np.linalg.norm(across) + 0.7 * np.linalg.norm(along)) * across
        expected += 0.1 * np.linalg.norm(along) * along
        np.testing.assert_allclose(force, 1.2 / 2 * 0.6 * 0.8 * expected, atol=1e-14)
        moved = np.reshape(wind, (1, 3, 1, 1)) + still  # only the relative velocity counts
        same = air_forces(scene, x, still, np.array([wind]))
        np.testing.assert_allclose(air_forces(scene, x, -moved, np.zeros((1, 3))), same, atol=1e-14)
        np.testing.assert_allclose(air_forces(scene, x, moved, np.array([wind])), 0, atol=1e-14)


def test_still_air_only_takes_energy() -> None:
    grid = GRIDS["sheet"]
    scene = Scene("wind", grid, SHEETS[0], 0.02, air=Air(normal=0.4, tangential=0.9))
    x, v = crumpled(grid), crumpled(grid, 3)
    # On a cell f . v_mean <= 0, a quarter at each corner; what is beyond the mean is only slowed.
    assert ((air_forces(scene, x, v, np.zeros((2, 3))) * v).sum((1, 2, 3)) < 0).all()


def test_the_air_damps_waves_of_two_cells() -> None:
    """The mean velocity of a cell knows nothing of them."""
    grid = GRIDS["sheet"]
    scene = Scene("wind", grid, SHEETS[0], 0.02, air=Air(1.2, normal=1.5, lift=0.7, tangential=0.1))
    r, c = np.indices(grid.shape)
    x = np.stack([c * grid.col_spacing, -r * grid.row_spacing, 0.0 * r])[None]
    wind = np.array([[2.0, 0.0, 3.0]])
    rate = 1.2 / 2 * (1.5 * 3 + 0.7 * 2) * grid.row_spacing * grid.col_spacing
    plain = air_forces(scene, x, np.zeros_like(x), wind)
    for wave in ((-1.0) ** (r + c), (-1.0) ** r, (-1.0) ** c):
        for axis in range(3):
            v = np.zeros_like(x)
            v[0, axis] = wave
            change = air_forces(scene, x, v, wind) - plain
            np.testing.assert_allclose(change[..., 1:-1, 1:-1], -OWN * rate * v[..., 1:-1, 1:-1], atol=1e-14)


def test_pressure_pushes_along_the_normal() -> None:
    grid = Grid(4, 5, 0.6, 0.8)
    r, c = np.indices(grid.shape)
    x = np.stack([c * grid.col_spacing, -r * grid.row_spacing, 0.0 * r])[None]
    force = pressure_forces(grid, x, np.array([7.0]))
    np.testing.assert_allclose(force.sum((2, 3))[0], [0, 0, 7.0 * 0.6 * 0.8], atol=1e-14)
    np.testing.assert_allclose(force[0, 2, 1:-1, 1:-1], 7.0 * grid.row_spacing * grid.col_spacing)


@pytest.mark.parametrize("shape", [(5, 6), (9, 16)])
def test_twist_costs_what_that_of_a_plate_does(shape: tuple[int, int]) -> None:
    grid, stiffness, twist = Grid(*shape, 0.5, 0.9), 1e-3, 0.7
    r, c = np.indices(shape)
    z = twist * (r * grid.row_spacing) * (c * grid.col_spacing)
    x = np.stack([c * grid.col_spacing, r * grid.row_spacing, z])[None]
    # B/2 (k_xx^2 + k_yy^2 + 2 k_xy^2) per area; on a grid z = k x y has the mixed difference k a b exactly.
    energy = bend_energy(grid, [Material(bend_stiffness=stiffness)], x)[0]
    assert energy == pytest.approx(stiffness * twist**2 * 0.5 * 0.9, rel=1e-10)
    assert bend_energy(grid, [Material(bend_stiffness=stiffness, twist=0.0)], x)[0] == pytest.approx(0, abs=1e-15)


@pytest.mark.parametrize("degrees", [0.0, 20.0, 45.0, 90.0])
def test_a_cylinder_costs_the_same_in_every_direction(degrees: float) -> None:
    n, curvature, angle = 41, 0.1, np.radians(degrees)
    grid = Grid(n, n, 1.0, 1.0)
    r, c = np.indices(grid.shape) * grid.row_spacing
    z = curvature / 2 * (np.cos(angle) * c + np.sin(angle) * r) ** 2
    energy = bend_energy(grid, [Material(bend_stiffness=1e-3)], np.stack([c, r, z])[None])[0]
    # Second differences end a spacing before the border: 1/40 of the area has none of one kind.
    assert energy == pytest.approx(1e-3 / 2 * curvature**2, rel=1.001 / 40)
