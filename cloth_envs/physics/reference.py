"""The plain NumPy twin of the explicit kernel: the definition of every force, and the tests' oracle.

Arrays are ``(B, 3, H, W)`` as in ``State``; forces are in newtons, energies ``(B,)`` in joules. All is
computed in float64, one vertex class at a time, with nothing saved or reused: read it, do not run it
on anything large. ``materials`` holds one ``Material`` per member of the batch.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.reference_contact import resolve_contact
from cloth_envs.physics.stencil import Edges, edges, triples
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State

Materials = Sequence[Material]
Forces = np.ndarray


def _flat(x: np.ndarray) -> np.ndarray:
    return x.astype(np.float64).reshape(len(x), 3, -1)


def _values(materials: Materials, name: str) -> np.ndarray:
    """A material property as ``(B, 1)``."""
    return np.array([[getattr(material, name)] for material in materials])


def _stiffness(materials: Materials, edge: Edges) -> np.ndarray:
    """``k`` of every spring, ``(B, E)``."""
    return _values(materials, edge.modulus) * edge.weight


def _yielding(materials: Materials, edge: Edges, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How much longer than at rest a spring is (negative: shorter) up to where it buckles, and beyond [m]."""
    short = np.minimum(length - edge.rest, 0.0)
    before = np.maximum(short, -_values(materials, "buckling_strain") * edge.rest)
    return before, short - before


def spring_forces(grid: Grid, materials: Materials, x: np.ndarray) -> Forces:
    """``f_i = k (|d| - L) d / |d|``, ``d = x_j - x_i``, on both ends of every edge.

    What it is shortened counts ``compression`` times, beyond ``buckling_strain`` that times ``post_buckling``.
    """
    at, out = _flat(x), np.zeros_like(_flat(x))
    for edge in edges(grid):
        d = at[..., edge.second] - at[..., edge.first]
        length = np.linalg.norm(d, axis=1)
        before, beyond = _yielding(materials, edge, length)
        shortened = _values(materials, "compression") * (before + _values(materials, "post_buckling") * beyond)
        tension = _stiffness(materials, edge) * (np.maximum(length - edge.rest, 0.0) + shortened)
        force = (tension / length)[:, None] * d
        out[..., edge.first] += force
        out[..., edge.second] -= force
    return out.reshape(x.shape)


def spring_energy(grid: Grid, materials: Materials, x: np.ndarray) -> np.ndarray:
    """``sum k (|d| - L)^2 / 2``; of a shortened spring the area under its broken line."""
    at, total = _flat(x), np.zeros(len(x))
    for edge in edges(grid):
        length = np.linalg.norm(at[..., edge.second] - at[..., edge.first], axis=1)
        before, beyond = _yielding(materials, edge, length)
        area = before**2 / 2 + before * beyond + _values(materials, "post_buckling") * beyond**2 / 2
        area = np.maximum(length - edge.rest, 0.0) ** 2 / 2 + _values(materials, "compression") * area
        total += (_stiffness(materials, edge) * area).sum(1)
    return total


def damper_forces(grid: Grid, materials: Materials, x: np.ndarray, v: np.ndarray) -> Forces:
    """``f_i = c (d^ . (v_j - v_i)) d^`` along the same edges, ``c = damping * k``.

    Of a shortened spring that is multiplied by ``compression_damping``.
    """
    at, speed, out = _flat(x), _flat(v), np.zeros_like(_flat(x))
    for edge in edges(grid):
        d = at[..., edge.second] - at[..., edge.first]
        rate = (d * (speed[..., edge.second] - speed[..., edge.first])).sum(1) / (d * d).sum(1)
        c = _values(materials, "damping") * _stiffness(materials, edge)
        shortened = np.linalg.norm(d, axis=1) < edge.rest
        c = np.where(shortened, _values(materials, "compression_damping") * c, c)
        force = (c * rate)[:, None] * d
        out[..., edge.first] += force
        out[..., edge.second] -= force
    return out.reshape(x.shape)


def bend_forces(grid: Grid, materials: Materials, x: np.ndarray) -> Forces:
    """Quadratic bending (Bergou et al. 2006): the negative gradient of ``bend_energy``, linear in x."""
    at, out = _flat(x), np.zeros_like(_flat(x))
    for t in triples(grid):
        second = at[..., t.before] - 2 * at[..., t.middle] + at[..., t.after]
        force = (_values(materials, "bend_stiffness") * t.weight)[:, None] * second
        out[..., t.before] -= force
        out[..., t.middle] += 2 * force
        out[..., t.after] -= force
    return out.reshape(x.shape)


def bend_energy(grid: Grid, materials: Materials, x: np.ndarray) -> np.ndarray:
    """``sum g |x_before - 2 x_middle + x_after|^2 / 2``, ``g = B * width of the strip / spacing^3``."""
    at, total = _flat(x), np.zeros(len(x))
    for t in triples(grid):
        second = at[..., t.before] - 2 * at[..., t.middle] + at[..., t.after]
        total += (_values(materials, "bend_stiffness") * t.weight * (second**2).sum(1)).sum(1) / 2
    return total


def masses(grid: Grid, materials: Materials) -> np.ndarray:
    """Lumped masses, ``(B, 1, H, W)`` [kg]."""
    return _values(materials, "areal_density")[:, :, None, None] * grid.areas


def gravity_forces(grid: Grid, materials: Materials, x: np.ndarray, gravity: float) -> Forces:
    """``(0, 0, -m g)``."""
    return masses(grid, materials) * np.array([0.0, 0.0, -gravity])[:, None, None] + np.zeros(x.shape)


def gravity_energy(grid: Grid, materials: Materials, x: np.ndarray, gravity: float) -> np.ndarray:
    """``sum m g z``."""
    return gravity * (masses(grid, materials)[:, 0] * x[:, 2]).sum((1, 2))


def kinetic_energy(grid: Grid, materials: Materials, v: np.ndarray) -> np.ndarray:
    """``sum m |v|^2 / 2``."""
    return (masses(grid, materials) * v.astype(np.float64) ** 2).sum((1, 2, 3)) / 2


def _corners(grid: Grid, x: np.ndarray) -> np.ndarray:
    """The three corners of every facet, ``(3 corners, B, T, 3 axes)``."""
    return _flat(x)[:, :, grid.facets.T].transpose(2, 0, 3, 1)


def _to_vertices(grid: Grid, force: np.ndarray, shape: tuple[int, ...]) -> Forces:
    """A third of half of every facet's force ``(B, T, 3)`` to each of its corners."""
    out = np.zeros((grid.vertices, len(force), 3))
    for corner in grid.facets.T:
        np.add.at(out, corner, force.transpose(1, 0, 2) / 6)
    return out.transpose(1, 2, 0).reshape(shape)


def wind_forces(scene: Scene, x: np.ndarray, v: np.ndarray, wind: np.ndarray) -> Forces:
    """Wejchert & Haumann 1991: ``f = -rho/2 A (C_n |n.v_r| (n.v_r) n + C_t |v_t| v_t)`` on a facet.

    ``v_r`` is the facet's mean velocity less ``wind`` ``(B, 3)``, ``v_t`` its part in the plane.
    """
    if scene.wind is None:
        return np.zeros(x.shape)
    x0, x1, x2 = _corners(scene.grid, x)
    normal = np.cross(x1 - x0, x2 - x0)
    twice_area = np.linalg.norm(normal, axis=2, keepdims=True)
    n = normal / twice_area
    relative = _corners(scene.grid, v).mean(0) - wind[:, None, :]
    across = (n * relative).sum(2, keepdims=True)
    tangential = relative - across * n
    speed = np.linalg.norm(tangential, axis=2, keepdims=True)
    stress = scene.wind.normal * abs(across) * across * n + scene.wind.tangential * speed * tangential
    return _to_vertices(scene.grid, -0.5 * scene.wind.air_density * (twice_area / 2) * stress, x.shape)


def pressure_forces(grid: Grid, x: np.ndarray, pressure: np.ndarray) -> Forces:
    """``p (x1 - x0) x (x2 - x0) / 2`` on a facet: ``pressure`` ``(B,)`` [Pa] along its normal."""
    x0, x1, x2 = _corners(grid, x)
    return _to_vertices(grid, pressure[:, None, None] * np.cross(x1 - x0, x2 - x0) / 2, x.shape)


def pressure_energy(grid: Grid, x: np.ndarray, pressure: np.ndarray) -> np.ndarray:
    """``-p V``, ``V = sum x0 . (x1 x x2) / 12`` over facets. Its gradient is the force at vertices off the border."""
    x0, x1, x2 = _corners(grid, x)
    return -pressure * (x0 * np.cross(x1, x2)).sum((1, 2)) / 12


def total_forces(scene: Scene, materials: Materials, state: State, wind: np.ndarray, pressure: np.ndarray) -> Forces:
    """All forces of the scene but drag and contact, which the step applies to the velocities."""
    grid, x, v = scene.grid, state.positions, state.velocities
    force = spring_forces(grid, materials, x) + damper_forces(grid, materials, x, v) + bend_forces(grid, materials, x)
    force += gravity_forces(grid, materials, x, scene.gravity) + wind_forces(scene, x, v, wind)
    return force + pressure_forces(grid, x, pressure) if scene.pressure else force


def hermite(
    s: float, frame: float, x0: np.ndarray, v0: np.ndarray, x1: np.ndarray, v1: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity at ``s`` in [0, 1] of the cubic from ``x0, v0`` to ``x1, v1`` in ``frame`` [s]."""
    x = (1 + 2 * s) * (1 - s) ** 2 * x0 + s * s * (3 - 2 * s) * x1
    x = x + frame * s * (1 - s) * ((1 - s) * v0 - s * v1)
    v = 6 * s * (1 - s) * (x1 - x0) / frame + (1 - s) * (1 - 3 * s) * v0 + s * (3 * s - 2) * v1
    return x, v


def step(
    scene: Scene,
    state: State,
    controls: Controls,
    substeps: int | np.ndarray,
    materials: Materials | None = None,
) -> State:
    """One frame by symplectic Euler; the result is in float64.

    ``substeps`` is a number for all, or ``(B,)``; ``materials`` default to the scene's.
    In a substep of length h: ``v <- v D + (F/m) h phi`` with ``D = exp(-drag h)``,
    ``phi = (1 - D) / (drag h)`` (exact for a constant force), ``x <- x + h v``, contact with every body
    in turn; handles then get the place and velocity of their cubic.
    """
    materials = [scene.material] * state.batch if materials is None else materials
    if not isinstance(substeps, int):
        out = state.astype(np.float64)
        for i, count in enumerate(substeps):
            one = Controls(**{name: value[[i]] for name, value in vars(controls).items()})
            out.assign([i], step(scene, state.select([i]), one, int(count), [materials[i]]))
        return out
    old, now = state.astype(np.float64), state.astype(np.float64)
    h = scene.frame_dt / substeps
    mass = masses(scene.grid, materials)
    decay = _values(materials, "drag")[:, :, None, None] * h * scene.drag
    push = np.divide(-np.expm1(-decay), decay, out=np.ones_like(decay), where=decay > 0)
    held = list(scene.handles)
    from_x, from_v = (_flat(a)[..., held].transpose(0, 2, 1) for a in (old.positions, old.velocities))
    for substep in range(1, substeps + 1):
        s = substep / substeps
        force = total_forces(scene, materials, now, controls.wind, controls.pressure)
        before = now.positions
        now.velocities = now.velocities * np.exp(-decay) + force / mass * h * push
        now.positions = before + h * now.velocities
        bodies, _ = hermite(
            s, scene.frame_dt, old.colliders, old.collider_velocities, controls.colliders, controls.collider_velocities
        )
        resolve_contact(scene, now, before, now.colliders, bodies, h)
        now.colliders = bodies
        to_x, to_v = controls.handle_positions, controls.handle_velocities
        place, speed = hermite(s, scene.frame_dt, from_x, from_v, to_x, to_v)
        for array, value in ((now.positions, place), (now.velocities, speed)):
            array.reshape(state.batch, 3, -1)[..., held] = value.transpose(0, 2, 1)
    now.collider_velocities = np.array(controls.collider_velocities, np.float64)
    now.wind, now.pressure = controls.wind.copy(), controls.pressure.copy()
    now.time = old.time + scene.frame_dt
    return now
