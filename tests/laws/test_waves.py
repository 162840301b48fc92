"""Laws of small vibrations: wave speed, pendulums, convergence in the spacing."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import j0
from worlds import THREADS, G, flat, frequency, rates, run, tube

from cloth_envs.grid import Grid
from cloth_envs.scene import Scene
from cloth_envs.state import State

WAVE = (THREADS.stretch_stiffness / THREADS.areal_density) ** 0.5


def longitudinal(grid: Grid, axis: int) -> tuple[float, float, float]:
    """Frequency of the first free-free stretching mode along rows' (0) or columns' (1) steps, its ``q``, and h."""
    length, n = ((grid.height, grid.rows), (grid.width, grid.cols))[axis]
    mode = np.cos(np.pi * np.arange(n) / (n - 1))
    mode = mode[:, None] if axis == 0 else mode[None, :]
    scene = Scene("wave", grid, THREADS, length / WAVE / 8, gravity=0.0)
    state = State.still(flat(grid))
    along = state.positions[0, 1 - axis]  # rows step along -y, columns along x
    rest = along.copy()
    along += 1e-3 * length * mode
    states, h = run(scene, state, frames=40)
    signal = np.array([(scene.mass * mode * (s.positions[0, 1 - axis] - rest)).sum() for s in states])
    return frequency(signal, scene.frame_dt), np.pi / length, h


@pytest.mark.parametrize("axis", [0, 1])
def test_longitudinal_waves_run_at_the_root_of_stiffness_over_density(axis: int) -> None:
    errors = []
    for n in (6, 11, 21):
        grid = Grid(n, n + 3, 0.5, 0.8)
        spacing = (grid.row_spacing, grid.col_spacing)[axis]
        omega, q, h = longitudinal(grid, axis)
        # Dispersion of a lattice, sin(q s / 2) / (q s / 2) = 1 - (q s)^2 / 24, and of symplectic Euler,
        # sin(w h / 2) / (w h / 2): the first slows, the second quickens; 1e-8 for higher orders' cross terms.
        error = omega / q / WAVE - 1
        expected = np.sin(q * spacing / 2) / (q * spacing / 2)
        expected = np.arcsin(expected * WAVE * q * h / 2) / (WAVE * q * h / 2)
        assert error == pytest.approx(expected - 1, abs=1e-8)
        assert abs(error) <= (q * spacing) ** 2 / 24 + (omega * h) ** 2 / 24
        errors.append(abs(error))
    assert errors[-1] < 1e-3


def test_torsion_of_a_tube_runs_at_the_root_of_shear_stiffness_over_density() -> None:
    shear, radius = 80.0, 0.1
    speed = (shear / THREADS.areal_density) ** 0.5
    errors = []
    for rows, cols in ((6, 8), (11, 16), (21, 32)):
        grid = Grid(rows, cols, 0.5, 2 * np.pi * radius, periodic=True)
        q, side = np.pi / grid.height, np.pi / cols
        scene = Scene("torsion", grid, THREADS.with_changes(shear_stiffness=shear), 1 / (q * speed), gravity=0.0)
        mode = np.cos(np.pi * np.arange(rows) / (rows - 1))[:, None]
        x, y, z = tube(grid, grid.col_spacing / (2 * np.sin(side)))[0]
        twist = 1e-5 * mode
        state = State.still(
            np.stack([x * np.cos(twist) - y * np.sin(twist), y * np.cos(twist) + x * np.sin(twist), z])[None]
        )
        states, h = run(scene, state, frames=20)
        signal = np.array([(mode * (x * s.positions[0, 1] - y * s.positions[0, 0])).sum() for s in states])
        omega = frequency(signal, scene.frame_dt)
        errors.append(abs(omega / (q * speed) - 1))
        # A diagonal leans by half a corner, cos(pi / cols), off both of its vertices' tangents; the lattice
        # and the step act as above. The twist is second order in everything else: 1e-5 squared.
        lattice = np.cos(side) * 2 / grid.row_spacing * np.sin(q * grid.row_spacing / 2) * speed
        assert omega == pytest.approx(np.arcsin(lattice * h / 2) * 2 / h, rel=1e-7)
    assert (abs(rates(errors) - 2) < 0.1).all()
    assert errors[-1] < (np.pi / 32) ** 2 / 2 + (np.pi / 20) ** 2 / 24


def pendulum(rows: int, bend: float, shape: np.ndarray, length: float = 0.5, amplitude: float = 0.02) -> float:
    """Frequency of a narrow strip hinged at its first row, started at ``amplitude`` times ``shape`` (rows)."""
    grid = Grid(rows, 3, length, 0.06)
    material = THREADS.with_changes(stretch_stiffness=5000.0, bend_stiffness=bend, damping=1e-5)
    period = 2 * np.pi * (2 * length / (3 * G)) ** 0.5
    scene = Scene("pendulum", grid, material, period / 40, handles=(0, 1, 2))
    state = State.still(flat(grid, down=(0, 0, -1), right=(0, 1, 0)))
    # Lean without stretching: every edge keeps its length.
    lean = np.diff(amplitude * length * shape) / grid.row_spacing
    state.positions[0, 0] = np.concatenate([[0], np.cumsum(lean * grid.row_spacing)])[:, None]
    state.positions[0, 2] = np.concatenate([[0], np.cumsum(-grid.row_spacing * np.sqrt(1 - lean**2))])[:, None]
    states, _ = run(scene, state, frames=80)
    signal = np.array([(scene.mass * shape[:, None] * s.positions[0, 0]).sum() for s in states])
    return frequency(signal, scene.frame_dt)


def test_a_stiff_narrow_strip_swings_like_a_rod() -> None:
    length, bend, amplitude, rows = 0.5, 1.0, 0.02, 9
    omega = pendulum(rows, bend, np.linspace(0, 1, rows))
    law = (1.5 * G / length) ** 0.5
    # - lumping: sum m z^2 / sum m z of half masses at the end is (1 + (s/L)^2 / 2) 2 L / 3
    # - bending: the hinged-free rod's first flexible mode, w1^2 = 3.927^4 B / (rho L^4), mixes in: (w0/w1)^2
    # - amplitude a: a^2 / 16; stretch rho g L / (2 Y) lengthens the rod; h: (w h)^2 / 24 is far smaller.
    flexible = 3.927**4 * bend / (THREADS.areal_density * length**4)
    tolerance = 0.25 / (rows - 1) ** 2 + law**2 / flexible + amplitude**2 / 16
    tolerance += THREADS.areal_density * G * length / (2 * 5000.0)
    assert omega == pytest.approx(law, rel=tolerance)
    lumped = law * (1 + 0.5 / (rows - 1) ** 2) ** -0.5
    assert omega == pytest.approx(lumped, rel=tolerance - 0.25 / (rows - 1) ** 2)


def test_a_limp_strip_swings_like_a_hanging_chain() -> None:
    errors = []
    for rows in (9, 17, 33):
        # Chain of length L: x = J0(2.4048 sqrt(1 - s/L)), w = 2.4048 / 2 sqrt(g / L) (D. Bernoulli 1733).
        shape = j0(2.404825557695773 * np.sqrt(1 - np.linspace(0, 1, rows)))
        omega = pendulum(rows, 0.0, shape, amplitude=0.005)
        errors.append(abs(omega / (2.404825557695773 / 2 * (G / 0.5) ** 0.5) - 1))
    # Midpoint sums along the chain: second order in the spacing.
    assert (abs(rates(errors) - 2) < 0.3).all()
    assert errors[-1] < 1e-3
