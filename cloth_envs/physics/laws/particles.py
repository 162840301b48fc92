"""The plain NumPy twin of the particle kernel: the definition of its step, and the tests' oracle.

Arrays are ``(B, 3, H, W)`` as in ``State``; forces are in newtons, energies ``(B,)`` in joules, all in float64.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from cloth_envs.physics.laws.drives import bodies_at, put_handles
from cloth_envs.physics.particles.solver import NEIGHBOURS, Cell, net_of, steps_a_frame
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State


def pairs(rows: int, cols: int) -> Iterator[tuple[int, tuple[Any, ...], tuple[Any, ...]]]:
    """For every class of neighbours: its number, the particles that have one, and those neighbours, as indices."""
    for number, (down, right) in enumerate(NEIGHBOURS.tolist()):
        own = (..., slice(max(0, -down), rows - max(0, down)), slice(max(0, -right), cols - max(0, right)))
        other = (..., slice(max(0, down), rows - max(0, -down)), slice(max(0, right), cols - max(0, -right)))
        yield number, own, other


def link_forces(coefficients: np.ndarray, eps: float, d: np.ndarray, w: np.ndarray) -> np.ndarray:
    """``alpha d + beta n + gamma (w . n) n`` of neighbours ``d`` away that move with ``w``, both ``(B, 3, ...)``."""
    alpha, beta, gamma = coefficients
    n = d / np.sqrt((d * d).sum(1, keepdims=True) + eps)
    return alpha * d + beta * n + gamma * (w * n).sum(1, keepdims=True) * n


def cell_forces(cell: Cell, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """``sum_c [alpha_c d_c + beta_c n_c + gamma_c (w_c . n_c) n_c] + bias``; see ``Cell``."""
    out = np.zeros(x.shape) + cell.bias[:, None, None]
    for c, own, other in pairs(*x.shape[2:]):
        out[own] += link_forces(cell.coefficients[c], cell.eps, x[other] - x[own], v[other] - v[own])
    return out


def spring_energy(scene: Scene, x: np.ndarray) -> np.ndarray:
    """``sum Y (|d| - L)^2 / (2 L)`` over springs; each is seen from both ends."""
    total, spacing = np.zeros(len(x)), [scene.grid.row_spacing, scene.grid.col_spacing]
    for c, own, other in pairs(*scene.grid.shape):
        rest = np.hypot(*(NEIGHBOURS[c] * spacing))
        length = np.linalg.norm(x[other] - x[own], axis=1)
        total += net_of(scene).stiffness * ((length - rest) ** 2).sum((1, 2)) / (4 * rest)
    return total


def pressure_forces(x: np.ndarray, pressure: np.ndarray) -> np.ndarray:
    """``p`` ``(B,)`` times the sum of ``r_a x r_b`` (eq. 3) over the pairs of nearest neighbours that exist."""
    wide = np.pad(x, ((0, 0), (0, 0), (1, 1), (1, 1)), mode="edge")  # a missing neighbour is the particle: r = 0
    # right, up, left, down: counter-clockwise where rows run downwards
    around = [r - x for r in (wide[..., 1:-1, 2:], wide[..., :-2, 1:-1], wide[..., 1:-1, :-2], wide[..., 2:, 1:-1])]
    p = pressure[:, None, None, None]
    return np.sum([p * np.cross(a, b, axis=1) for a, b in zip(around, around[1:] + around[:1], strict=True)], 0)


def hit_ball(
    x: np.ndarray, v: np.ndarray, centre: np.ndarray, velocity: np.ndarray, radius: float, keep: float
) -> np.ndarray:
    """Velocities after a step inside a ball at ``centre`` ``(B, 3)``: no inward part, then ``keep`` of the rest."""
    d, u = x - centre[:, :, None, None], v - velocity[:, :, None, None]
    away = np.sqrt((d * d).sum(1, keepdims=True))
    n = d / np.where(away > 0, away, 1)
    left = keep * (u - np.minimum((u * n).sum(1, keepdims=True), 0) * n)
    return np.where(away < radius, left + velocity[:, :, None, None], v)


def kicked_in_place(cell: Cell, x: np.ndarray, v: np.ndarray, kick: float, others: np.ndarray) -> np.ndarray:
    """Velocities after the author's loop: row by row, particle after particle gets ``kick`` (h / m) times its force.

    Its dashpots see the new velocities of those before it. The bias, gravity, acts on all before the loop.
    """
    v = v + kick * cell.bias[:, None, None]
    rows, cols = x.shape[2:]
    for r, c in np.ndindex(rows, cols):
        there = np.add(NEIGHBOURS, [r, c])
        found = ((there >= 0) & (there < [rows, cols])).all(1)
        own, other = (..., r, c, None), (..., *there[found].T)
        force = link_forces(cell.coefficients[found].T, cell.eps, x[other] - x[own], v[other] - v[own]).sum(-1)
        v[..., r, c] += kick * (force + others[..., r, c])
    return v


def step(
    scene: Scene, state: State, controls: Controls, cell: Cell, refine: int = 1, *, in_place: bool = True
) -> State:
    """One frame in the author's order: forces, drag, balls, ``x += h v``, and handles on their cubics; float64.

    Without ``in_place`` all forces are those of the velocities before the step, as a convolution's are.
    """
    net, steps = net_of(scene), steps_a_frame(scene) * refine
    old, now, h = state.astype(np.float64), state.astype(np.float64), scene.frame_dt / steps
    kick = h / net.node_mass
    for k in range(steps):
        x, v = now.positions, now.velocities
        others = pressure_forces(x, controls.pressure) if scene.pressure else np.zeros(x.shape)
        v = kicked_in_place(cell, x, v, kick, others) if in_place else v + kick * (cell_forces(cell, x, v) + others)
        v = v * np.exp(-net.drag * h)
        at, speed = bodies_at(scene, old, controls, k / steps)
        for i, body in enumerate(scene.colliders):
            v = hit_ball(x, v, at[:, i, 0], speed[:, i, 0], body.radius, net.keep ** (1 / refine))
        now.positions, now.velocities = x + h * v, v
        put_handles(scene, old, now, controls, (k + 1) / steps, np.zeros(old.batch), h)
    now.colliders, now.collider_velocities = controls.colliders.copy(), controls.collider_velocities.copy()
    now.wind, now.pressure = controls.wind.copy(), controls.pressure.copy()
    now.time = old.time + scene.frame_dt
    return now
