"""The preset "zhao2024" against the author's loop (Zhao 2024, eqs 1-5), written here in plain Python."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from math import exp, sqrt

import numpy as np
import pytest

from cloth_envs.grid import Grid
from cloth_envs.physics.particles.solver import ParticleSolver, mass_spring_cell
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.cell.compiled import CellNet
from training.cell.data import case

CASES = ("fall", "blow")
STEPS = 960  # 0.3 s
STENCIL = [(i, j) for i, j in product(range(-2, 3), repeat=2) if (i, j) != (0, 0) and (abs(i) + abs(j) <= 2)]
AROUND = [(0, 1), (-1, 0), (0, -1), (1, 0)]  # counter-clockwise, rows run downwards


def author(scene: Scene, start: State, pressure: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities ``(3, H, W)`` after ``steps``: velocities change in place, row by row."""
    net, (rows, cols) = scene.particles, scene.grid.shape
    assert net is not None
    y, c, h, m = net.stiffness, net.dashpot, net.sim_dt, net.node_mass
    x, v = (a[0].reshape(3, -1).T.tolist() for a in (start.positions, start.velocities))
    links: list[list[tuple[int, float]]] = []
    corners: list[list[tuple[int, int]]] = []
    for i, j in product(range(rows), range(cols)):
        place = {(a, b): (i + a) * cols + j + b for a, b in STENCIL if 0 <= i + a < rows and 0 <= j + b < cols}
        links.append([(k, net.spacing * sqrt(a * a + b * b)) for (a, b), k in place.items()])
        ring = [place.get(offset, -1) for offset in AROUND]
        corners.append([(a, b) for a, b in zip(ring, ring[1:] + ring[:1], strict=True) if min(a, b) >= 0])
    for _ in range(steps):
        for own in v:
            own[2] -= h * scene.gravity
        for (x0, x1, x2), own, linked, cornered in zip(x, v, links, corners, strict=True):
            v0, v1, v2 = own
            f0 = f1 = f2 = 0.0
            for k, rest in linked:
                (a0, a1, a2), (b0, b1, b2) = x[k], v[k]
                r0, r1, r2 = x0 - a0, x1 - a1, x2 - a2
                length = sqrt(r0 * r0 + r1 * r1 + r2 * r2)
                along = ((v0 - b0) * r0 + (v1 - b1) * r1 + (v2 - b2) * r2) / length
                pull = (y * (length / rest - 1) + c * along) / length
                f0, f1, f2 = f0 - pull * r0, f1 - pull * r1, f2 - pull * r2
            for a, b in cornered if pressure else ():
                a0, a1, a2 = x[a][0] - x0, x[a][1] - x1, x[a][2] - x2
                b0, b1, b2 = x[b][0] - x0, x[b][1] - x1, x[b][2] - x2
                f0 += pressure * (a1 * b2 - a2 * b1)
                f1 += pressure * (a2 * b0 - a0 * b2)
                f2 += pressure * (a0 * b1 - a1 * b0)
            own[:] = v0 + h / m * f0, v1 + h / m * f1, v2 + h / m * f2
        for own in v:
            own[:] = (exp(-net.drag * h) * u for u in own)
        for k in scene.handles:
            v[k] = [0.0, 0.0, 0.0]
        for place_, own in zip(x, v, strict=True):
            place_[:] = (p + h * u for p, u in zip(place_, own, strict=True))
    one, other = (np.array(a).T.reshape(3, rows, cols) for a in (x, v))
    return one, other


def animation(solver: ParticleSolver, start: State, pressure: float, frames: int = 1) -> State:
    """The last of ``frames`` of a solver."""
    solver.reset(start)
    controls = Controls.hold(start, solver.scene.handles)
    controls.pressure[:] = pressure
    for _ in range(frames):
        state = solver.advance(controls)
    return state


def small(name: str, side: int = 10) -> tuple[Scene, State, float]:
    """The case on ``side`` x ``side`` particles of the same settings, its frame 0.3 s."""
    given = case(name)
    net = given.scene.particles
    assert net is not None
    pins = np.flatnonzero(np.pad(np.zeros((side - 2, side - 2), bool), 1, constant_values=True))
    grid = Grid(side, side, (side - 1) * net.spacing, (side - 1) * net.spacing)
    scene = replace(given.scene, grid=grid, handles=tuple(pins.tolist()), frame_dt=STEPS * net.sim_dt)
    start = State.still(given.start.positions[..., :side, :side])
    return scene, start, float(given.controls.pressure[0])


@pytest.mark.parametrize("name", CASES)
def test_a_small_net_follows_the_authors_loop(name: str) -> None:
    scene, start, pressure = small(name)
    want, _ = author(scene, start, pressure, STEPS)
    moved = abs(want - start.positions[0]).max()
    in_place = animation(ParticleSolver(scene, dtype="float64"), start, pressure).positions[0]
    old = animation(CellNet(scene, mass_spring_cell(scene), dtype="float64"), start, pressure).positions[0]
    # Rounding: a step's 1e-16 of a position is not amplified by a stable step, 960 of them add up.
    assert abs(in_place - want).max() < STEPS * np.finfo(float).eps
    assert moved > 1e-3
    # It is the order that does it: all from old velocities, as a convolution has it, is another animation.
    assert abs(old - want).max() > 1e-5


@pytest.mark.parametrize("name", CASES)
def test_the_preset_follows_the_authors_loop(name: str) -> None:
    """Two steps of the whole net from a tenth of a second after the start."""
    given, steps = case(name), 2
    pressure, net = float(given.controls.pressure[0]), given.scene.particles
    assert net is not None
    begun = animation(ParticleSolver(given.scene, dtype="float64"), given.start, pressure, frames=5)
    scene = replace(given.scene, frame_dt=steps * net.sim_dt)
    _, want = author(scene, begun, pressure, steps)
    in_place = animation(ParticleSolver(scene, dtype="float64"), begun, pressure).velocities[0]
    old = animation(CellNet(scene, mass_spring_cell(scene), dtype="float64"), begun, pressure).velocities[0]
    # A rounding of a position of 1 m becomes h Y / (L m) = 400 1/s times it from each of 12 springs, in each step.
    assert abs(in_place - want).max() < steps * 12 * 400 * np.finfo(float).eps
    assert abs(old - want).max() > 1e-4
