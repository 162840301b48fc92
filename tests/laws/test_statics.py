"""Laws of equilibrium: hanging, sagging and inflated sheets against closed forms.

Drag of twice the slowest frequency ``w`` (critical) leaves ``(1 + w t) exp(-w t)`` of the start's distance:
1e-7 after ``w t = 20``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.sparse.linalg import spsolve
from worlds import THREADS, G, flat, rates, run, settle, tube

from cloth_envs.grid import Grid
from cloth_envs.physics.implicit.prefactored import bending_matrix
from cloth_envs.physics.laws.air import pressure_forces
from cloth_envs.physics.laws.stencil import edges
from cloth_envs.physics.solver import pressure_bound
from cloth_envs.scene import Air, Scene
from cloth_envs.state import Controls, State

LEFT = 1e-7


def row_numbers(grid: Grid, *rows: int) -> tuple[int, ...]:
    return tuple(grid.index(row, col) for row in rows for col in range(grid.cols))


def test_a_hanging_strip_stretches_by_the_weight_below() -> None:
    grid, stiffness = Grid(9, 4, 0.8, 0.3), 20.0
    omega = np.pi / 2 / grid.height * (stiffness / 0.2) ** 0.5
    material = THREADS.with_changes(stretch_stiffness=stiffness, drag=2 * omega)
    scene = Scene("hang", grid, material, 0.05, handles=row_numbers(grid, 0))
    state = State.still(flat(grid, down=(0, 0, -1)))
    end = settle(scene, state, 20 / omega)
    s = np.arange(grid.rows) * grid.row_spacing
    # The lumped chain is exact at its vertices: each edge carries the weight below its middle.
    sag = 0.2 * G * (grid.height * s - s * s / 2) / stiffness
    np.testing.assert_allclose(state.positions[0, 2] - end.positions[0, 2], sag[:, None] + 0 * s[:4], atol=LEFT)
    np.testing.assert_allclose(end.positions[0, :2], state.positions[0, :2], atol=LEFT)


def catenary_error(rows: int, span: float = 0.8, stiffness: float = 500.0) -> float:
    """Largest distance [m] of a strip of length 1 hung between two pinned rows from the elastic catenary."""
    grid, weight = Grid(rows, 3, 1.0, 0.1), 0.2 * G
    material = THREADS.with_changes(stretch_stiffness=stiffness, drag=20.0)
    scene = Scene("catenary", grid, material, 0.05, handles=row_numbers(grid, 0, rows - 1))
    s = np.linspace(-0.5, 0.5, rows)
    # A V of the right length to start from.
    state = State.still(flat(grid, down=(1, 0, 0), right=(0, 1, 0)))
    state.positions[0, 0] = (span * s)[:, None]
    state.positions[0, 2] = ((abs(s) - 0.5) * (1 - span**2) ** 0.5)[:, None]
    end = settle(scene, state, 2.5)

    def x(s: np.ndarray | float, tension: float) -> np.ndarray | float:
        """Irvine 1981: rest arc length s from the lowest point, horizontal tension [N/m]."""
        return tension * s / stiffness + tension / weight * np.arcsinh(weight * s / tension)

    tension = brentq(lambda tension: x(0.5, tension) - span / 2, 1e-3, 1e3)
    z = weight * s**2 / (2 * stiffness) + tension / weight * np.sqrt(1 + (weight * s / tension) ** 2)
    expected = np.stack([x(s, tension), 0 * s, z - z[0]])
    off = end.positions[0, :, :, 1] - expected
    off[1] = 0
    return float(np.linalg.norm(off, axis=0).max())


def test_a_strip_between_two_pins_hangs_in_a_catenary() -> None:
    errors = [catenary_error(rows) for rows in (9, 17, 33)]
    # The lumped chain is the midpoint rule of the catenary's integrals: second order in the spacing,
    # with the constant s^2 / 24 |x''|, curvature |x''| <= weight / tension, about 2.4 / m here.
    assert (abs(rates(errors) - 2) < 0.2).all()
    assert errors[-1] < 2.4 * (1 / 32) ** 2 / 8


def cantilever(rows: int, length: float = 0.3, slope: float = 0.01) -> float:
    """Tip sag over ``q L^4 / (8 B)`` of a strip clamped by its first two rows; sag / L is about ``slope``."""
    # Two equal rows fix the slope half way between them: the free length starts there.
    spacing = length / (rows - 1.5)
    grid = Grid(rows, 3, spacing * (rows - 1), 0.06)
    bend = 0.2 * G * length**3 / (8 * slope)
    omega = 3.516 * (bend / (0.2 * length**4)) ** 0.5
    material = THREADS.with_changes(bend_stiffness=bend, drag=2 * omega)
    scene = Scene("cantilever", grid, material, 0.01, handles=row_numbers(grid, 0, 1))
    end = settle(scene, State.still(flat(grid, down=(1, 0, 0), right=(0, 1, 0))), 20 / omega)
    return float(-end.positions[0, 2, -1].mean() / (slope * length))


def test_cantilever_sag_is_that_of_a_beam_at_every_resolution() -> None:
    sags = np.array([cantilever(rows) for rows in (6, 11, 21)])
    spacing = 1 / (np.array([6, 11, 21]) - 1.5)
    # Second order in the spacing s: the sag is a double sum instead of an integral, error under
    # (s / L)^2; and the sag of 1 % shortens the strip's projection by (w / L)^2 of order 1e-4.
    assert (abs(sags - 1) <= spacing**2 + 2e-4).all()


def clamped_sag(rows: int, degrees: float, length: float = 0.3) -> float:
    """Sag over ``q L^4 / (384 B)`` in the middle of a band across a square sheet, clamped on either side of it."""
    grid, bend, angle = Grid(rows, rows, 1.0, 1.0), 0.1, np.radians(degrees)
    x, y = flat(grid)[0, :2]
    across = np.cos(angle) * (x - 0.5) + np.sin(angle) * (y + 0.5)
    free = (abs(across) < length / 2 - 1e-9).ravel()
    matrix = bending_matrix(grid, THREADS.with_changes(bend_stiffness=bend))[free][:, free]
    z = np.zeros(grid.vertices)
    z[free] = spsolve(matrix.tocsc(), -THREADS.areal_density * G * grid.areas.ravel()[free])
    # Two lines of held vertices fix the slope half way between them: a line farther than the free ones on each side.
    line = grid.row_spacing * (np.sqrt(0.5) if degrees == 45 else 1.0)
    clear = (2 * np.floor((length / 2 - 1e-9) / line) + 3) * line
    return float(-z[grid.vertices // 2] * 384 * bend / (THREADS.areal_density * G * clear**4))


def test_a_clamped_band_sags_alike_along_rows_and_on_the_bias() -> None:
    sags = np.array([[clamped_sag(rows, degrees) for degrees in (0, 45, 90)] for rows in (33, 65)])
    # Second order in the spacing s: the sag is a double sum instead of an integral, as the cantilever's.
    assert (abs(sags - 1) <= 2 * (np.array([[1 / 32], [1 / 64]]) / 0.3) ** 2).all()
    assert np.ptp(sags[-1]) < 0.03


def test_a_sheet_pinned_at_two_sides_bulges_into_an_arc() -> None:
    errors = []
    stiffness, pressure, width = 200.0, 1.8, 1.0
    # Arc of half angle a: T = p R = Y (a / sin a - 1), R = W / (2 sin a); sag = W / 2 tan(a / 2).
    # For small p this is a^3 = 3 p W / Y, sag = W a / 4.
    angle = brentq(lambda a: stiffness * (a / np.sin(a) - 1) - pressure * width / (2 * np.sin(a)), 1e-3, 1.0)
    assert angle == pytest.approx((3 * pressure * width / stiffness) ** (1 / 3), rel=angle**2)
    sag = width / 2 * np.tan(angle / 2)
    omega = np.pi / width * (pressure * width / 2 / np.sin(angle) / 0.2) ** 0.5
    for rows in (6, 11, 21):
        grid = Grid(rows, 5, width, 0.3)
        material = THREADS.with_changes(stretch_stiffness=stiffness, drag=2 * omega)
        scene = Scene("bulge", grid, material, 0.05, row_numbers(grid, 0, rows - 1), pressure=True, gravity=0)
        state = State.still(flat(grid))
        controls = Controls.hold(state, scene.handles)
        controls.pressure[:] = pressure
        end = settle(scene, state, 25 / omega, controls)
        y, z = end.positions[0, 1:]
        radius = width / 2 / np.sin(angle)
        errors.append(abs(np.hypot(y + width / 2, z - sag + radius) - radius)[:, 2].max())
        assert np.ptp(z, axis=1).max() < 1e-12  # straight across, borders too
    # A polygon in an arc, second order: an edge's arc is angle^2 W / (rows - 1)^2 / 4 high for a small
    # angle's radius W / (2 angle), and the polygon's own stretch adds as much.
    assert (abs(rates(errors) - 2) < 0.2).all()
    assert errors[-1] < sag / 20**2


def test_a_stretched_square_bulges_like_a_membrane() -> None:
    errors = []
    strain, stiffness, side, pressure = 0.1, 500.0, 0.5, 0.1
    tension = stiffness * strain / (1 + strain)  # per stretched width
    stretched = side * (1 + strain)
    # T laplacian(w) = -p on a square: w = 0.0736713 p L^2 / T in the middle (Timoshenko).
    law = 0.0736713 * pressure * stretched**2 / tension
    omega = 2**0.5 * np.pi / stretched * (tension / (0.2 / (1 + strain) ** 2)) ** 0.5
    for n in (5, 9, 17):
        grid = Grid(n, n, side, side)
        border = np.ones((n, n), bool)
        border[1:-1, 1:-1] = False
        scene = Scene(
            "membrane", grid, THREADS.with_changes(drag=2 * omega), 0.05, tuple(np.flatnonzero(border).tolist()),
            pressure=True, gravity=0,
        )  # fmt: skip
        state = State.still(flat(grid) * (1 + strain))
        controls = Controls.hold(state, scene.handles)
        controls.pressure[:] = pressure
        end = settle(scene, state, 20 / omega, controls)
        errors.append(abs(end.positions[0, 2, n // 2, n // 2] / law - 1))
    # The 5-point Laplacian is of second order; the membrane's slope (4 w / L)^2 / strain is the next term.
    assert (abs(rates(errors) - 2) < 0.3).all()
    assert errors[-1] < 2 / 16**2


def test_a_tube_under_pressure_widens_by_its_hoop_tension() -> None:
    stiffness, pressure = 100.0, -40.0  # the normals point inwards: a negative pressure inflates
    omega = (stiffness / 0.2) ** 0.5 / 0.2  # of breathing
    for n in (12, 24, 48):
        grid = Grid(5, n, 0.4, 2 * np.pi * 0.2, periodic=True)
        rest = grid.col_spacing / (2 * np.sin(np.pi / n))
        material = THREADS.with_changes(stretch_stiffness=stiffness, drag=2 * omega)
        scene = Scene("tube", grid, material, 0.02, pressure=True, gravity=0)
        state = State.still(tube(grid, rest))
        controls = Controls.hold(state, ())
        controls.pressure[:] = pressure
        end = settle(scene, state, 30 / omega, controls)
        radius = np.linalg.norm(end.positions[0, :2], axis=0)
        # All columns are alike.
        np.testing.assert_allclose(radius, radius[:, :1] + 0 * radius, rtol=LEFT)
        # A corner of the polygon: p e cos(pi/n) = 2 Y (e/L - 1) sin(pi/n), e its edge, L the rest length.
        polygon = rest / (1 + pressure * grid.col_spacing / (2 * stiffness * np.tan(np.pi / n)))
        np.testing.assert_allclose(radius, polygon, rtol=LEFT)
        # The tube: T = p R, so R = R0 / (1 - |p| R0 / Y); the polygon's R0 is larger by (pi/n)^2 / 6.
        assert radius.mean() == pytest.approx(0.2 / (1 + pressure * 0.2 / stiffness), rel=(np.pi / n) ** 2 / 6)


def test_an_open_tube_under_pressure_lives_or_bursts_aloud() -> None:
    """It drives itself about and stretches without bound in a vacuum; air limits that."""
    grid = Grid(5, 12, 0.4, 2 * np.pi * 0.2, periodic=True)
    material = THREADS.with_changes(stretch_stiffness=100.0, shear_stiffness=30.0, damping=5e-5)
    state = State.still(tube(grid, grid.col_spacing / (2 * np.sin(np.pi / grid.cols))))
    state.positions += 1e-3 * np.random.default_rng(0).normal(size=state.positions.shape)
    controls = Controls.hold(state, ())
    controls.pressure[:] = -400.0  # p R = 80 N/m of 100 N/m
    scene = Scene("tube", grid, material, 0.02, pressure=True, gravity=0.0)
    with pytest.raises(ValueError, match=r"a pressure of .* (burst the cloth|needs)"):
        run(scene, state, controls, 100)
    states, _ = run(replace(scene, air=Air()), state, controls, 100)
    x = np.concatenate([s.positions for s in states])
    assert abs(x - x.mean((2, 3), keepdims=True)).max() < 2 * grid.height


@pytest.mark.parametrize("pressure", [90.0, -90.0])
def test_a_sheet_bursts_aloud_under_little_pressure_too(pressure: float) -> None:
    grid = Grid(17, 17, 1.0, 1.0)
    scene = Scene(
        "sail",
        grid,
        THREADS.with_changes(stretch_stiffness=30.0, shear_stiffness=10.0, damping=5e-5),
        0.02,
        tuple(range(17)),
    )
    scene = replace(scene, pressure=True)
    state = State.still(flat(grid))
    state.positions += 1e-4 * np.random.default_rng(3).normal(size=state.positions.shape)
    controls = Controls.hold(state, scene.handles)
    controls.pressure[:] = pressure
    with pytest.raises(ValueError, match=f"a pressure of {abs(pressure):g} Pa burst the cloth"):
        run(scene, state, controls, 30)


@pytest.mark.parametrize("pressure", [50.0, 1e3, 1e4])
def test_the_step_allows_for_pressure(pressure: float) -> None:
    """The bound holds for the matrix itself: of a grid's random shapes with no edge longer than twice its length."""
    grid = Grid(4, 5, 0.3, 0.6)
    scene = Scene("pushed", grid, THREADS, 0.02, pressure=True)
    bound = pressure_bound(scene, THREADS, pressure)
    rng = np.random.default_rng(0)
    for spread in (0.0, 0.1, 0.4):
        x = flat(grid) + spread * grid.row_spacing * rng.normal(size=(1, 3, *grid.shape))
        ends = [x.reshape(3, -1)[:, e.second] - x.reshape(3, -1)[:, e.first] for e in edges(grid)]
        longest = max((np.linalg.norm(d, axis=0) / e.rest).max() for d, e in zip(ends, edges(grid), strict=True))
        x *= 2 / longest
        units = np.eye(3 * grid.vertices).reshape(-1, 3, *grid.shape)
        p = np.full(len(units), pressure)
        slope = pressure_forces(grid, x + units, p) - pressure_forces(grid, x - units, p)  # quadratic in x: exact
        root = np.sqrt(np.broadcast_to(scene.mass, (3, *grid.shape)).ravel())
        size = np.linalg.norm(slope.reshape(len(units), -1) / 2 / root / root[:, None], 2)
        assert 0.2 * bound < size < bound
