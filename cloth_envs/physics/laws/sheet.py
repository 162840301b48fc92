"""What the sheet itself does: springs, dashpots, bending, mass and weight.

Arrays are ``(B, 3, H, W)`` as in ``State``; forces are in newtons, energies ``(B,)`` in joules. ``materials`` holds one
``Material`` per member of the batch.
"""

from collections.abc import Sequence

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.laws.stencil import Edges, Quads, edges, quads, triples

Materials = Sequence[Material]
Forces = np.ndarray


def flat(x: np.ndarray) -> np.ndarray:
    """``(B, 3, H, W)`` as float64 ``(B, 3, H * W)``."""
    return x.astype(np.float64).reshape(len(x), 3, -1)


def values(materials: Materials, name: str) -> np.ndarray:
    """A material property as ``(B, 1)``."""
    return np.array([[getattr(material, name)] for material in materials])


def _stiffness(materials: Materials, edge: Edges) -> np.ndarray:
    """``k`` of every spring, ``(B, E)``."""
    return values(materials, edge.modulus) * edge.weight


def _yielding(materials: Materials, edge: Edges, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How much longer than at rest a spring is (negative: shorter) up to where it buckles, and beyond [m]."""
    short = np.minimum(length - edge.rest, 0.0)
    before = np.maximum(short, -values(materials, "buckling_strain") * edge.rest)
    return before, short - before


def spring_forces(grid: Grid, materials: Materials, x: np.ndarray) -> Forces:
    """``f_i = k (|d| - L) d / |d|``, ``d = x_j - x_i``, on both ends of every edge.

    What it is shortened counts ``compression`` times, beyond ``buckling_strain`` that times ``post_buckling``.
    """
    at, out = flat(x), np.zeros_like(flat(x))
    for edge in edges(grid):
        d = at[..., edge.second] - at[..., edge.first]
        length = np.linalg.norm(d, axis=1)
        before, beyond = _yielding(materials, edge, length)
        shortened = values(materials, "compression") * (before + values(materials, "post_buckling") * beyond)
        tension = _stiffness(materials, edge) * (np.maximum(length - edge.rest, 0.0) + shortened)
        force = (tension / length)[:, None] * d
        out[..., edge.first] += force
        out[..., edge.second] -= force
    return out.reshape(x.shape)


def spring_energy(grid: Grid, materials: Materials, x: np.ndarray) -> np.ndarray:
    """``sum k (|d| - L)^2 / 2``; of a shortened spring the area under its broken line."""
    at, total = flat(x), np.zeros(len(x))
    for edge in edges(grid):
        length = np.linalg.norm(at[..., edge.second] - at[..., edge.first], axis=1)
        before, beyond = _yielding(materials, edge, length)
        area = before**2 / 2 + before * beyond + values(materials, "post_buckling") * beyond**2 / 2
        area = np.maximum(length - edge.rest, 0.0) ** 2 / 2 + values(materials, "compression") * area
        total += (_stiffness(materials, edge) * area).sum(1)
    return total


def damper_forces(grid: Grid, materials: Materials, x: np.ndarray, v: np.ndarray) -> Forces:
    """``f_i = c (d^ . (v_j - v_i)) d^`` along the same edges, ``c = damping * k``.

    Of a shortened spring that is multiplied by ``compression_damping``.
    """
    at, speed, out = flat(x), flat(v), np.zeros_like(flat(x))
    for edge in edges(grid):
        d = at[..., edge.second] - at[..., edge.first]
        length = np.linalg.norm(d, axis=1)
        rate = (d * (speed[..., edge.second] - speed[..., edge.first])).sum(1) / length**2
        c = values(materials, "damping") * _stiffness(materials, edge)
        c = np.where(length < edge.rest, values(materials, "compression_damping") * c, c)
        force = (c * rate)[:, None] * d
        out[..., edge.first] += force
        out[..., edge.second] -= force
    return out.reshape(x.shape)


def damped_spring_forces(grid: Grid, materials: Materials, x: np.ndarray, v: np.ndarray) -> Forces:
    """Springs with their dashpots as the explicit solver steps them.

    Of a simple material ``f_i = k (1 - L / |d + damping w|) d``, ``w = v_j - v_i``: springs whose length is that of a
    moment later. That is a dashpot ``damping k L / |d|`` to first order in ``damping``. Of others the sum of
    ``spring_forces`` and ``damper_forces``.
    """
    at, speed, out = flat(x), flat(v), np.zeros_like(flat(x))
    for edge in edges(grid):
        d = at[..., edge.second] - at[..., edge.first]
        later = d + values(materials, "damping")[:, None] * (speed[..., edge.second] - speed[..., edge.first])
        force = (_stiffness(materials, edge) * (1 - edge.rest / np.linalg.norm(later, axis=1)))[:, None] * d
        out[..., edge.first] += force
        out[..., edge.second] -= force
    simple = np.array([material.simple for material in materials])[:, None, None, None]
    both = spring_forces(grid, materials, x) + damper_forces(grid, materials, x, v)
    return np.where(simple, out.reshape(x.shape), both)


def bend_forces(grid: Grid, materials: Materials, x: np.ndarray) -> Forces:
    """Quadratic bending (Bergou et al. 2006): the negative gradient of ``bend_energy``, linear in x."""
    at, out = flat(x), np.zeros_like(flat(x))
    for t in triples(grid):
        second = at[..., t.before] - 2 * at[..., t.middle] + at[..., t.after]
        force = (values(materials, "bend_stiffness") * t.weight)[:, None] * second
        out[..., t.before] -= force
        out[..., t.middle] += 2 * force
        out[..., t.after] -= force
    q, stiffness = _twist(grid, materials)
    force = stiffness[:, None] * _mixed(at, q)
    for corner, sign in zip(q[:4], (1, -1, -1, 1), strict=True):
        out[..., corner] -= sign * force
    return out.reshape(x.shape)


def bend_energy(grid: Grid, materials: Materials, x: np.ndarray) -> np.ndarray:
    """``sum g |x_before - 2 x_middle + x_after|^2 / 2``, ``g = B * width of the strip / spacing^3``, and the twist.

    That is ``sum t |x_ul - x_ur - x_ll + x_lr|^2 / 2`` over cells, ``t = 2 B twist / (a b)``: of small deflections
    ``B/2 (k_xx^2 + k_yy^2 + 2 twist k_xy^2)`` per area, at ``twist = 1`` the same for a cylinder in any direction.
    """
    at, total = flat(x), np.zeros(len(x))
    for t in triples(grid):
        second = at[..., t.before] - 2 * at[..., t.middle] + at[..., t.after]
        total += (values(materials, "bend_stiffness") * t.weight * (second**2).sum(1)).sum(1) / 2
    q, stiffness = _twist(grid, materials)
    return total + (stiffness * (_mixed(at, q) ** 2).sum(1)).sum(1) / 2


def _twist(grid: Grid, materials: Materials) -> tuple[Quads, np.ndarray]:
    """The cells' corners, and how stiff their mixed difference is, ``(B, 1)`` [N/m]."""
    q = quads(grid)
    return q, values(materials, "bend_stiffness") * values(materials, "twist") * q.weight


def _mixed(at: np.ndarray, q: Quads) -> np.ndarray:
    """``x_ul - x_ur - x_ll + x_lr`` of every cell, ``(B, 3, C)``."""
    return at[..., q.upper_left] - at[..., q.upper_right] - at[..., q.lower_left] + at[..., q.lower_right]


def masses(grid: Grid, materials: Materials) -> np.ndarray:
    """Lumped masses, ``(B, 1, H, W)`` [kg]."""
    return values(materials, "areal_density")[:, :, None, None] * grid.areas


def gravity_forces(grid: Grid, materials: Materials, x: np.ndarray, gravity: float) -> Forces:
    """``(0, 0, -m g)``."""
    return masses(grid, materials) * np.array([0.0, 0.0, -gravity])[:, None, None] + np.zeros(x.shape)


def gravity_energy(grid: Grid, materials: Materials, x: np.ndarray, gravity: float) -> np.ndarray:
    """``sum m g z``."""
    return gravity * (masses(grid, materials)[:, 0] * x[:, 2]).sum((1, 2))


def kinetic_energy(grid: Grid, materials: Materials, v: np.ndarray) -> np.ndarray:
    """``sum m |v|^2 / 2``."""
    return (masses(grid, materials) * v.astype(np.float64) ** 2).sum((1, 2, 3)) / 2
