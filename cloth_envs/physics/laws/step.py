"""The plain NumPy twin of the explicit kernel: drives, all forces, and a frame of symplectic Euler; tests' oracle."""

import numpy as np

from cloth_envs.physics.laws.air import air_forces, pressure_forces
from cloth_envs.physics.laws.bodies import resolve_contact
from cloth_envs.physics.laws.sheet import (
    Forces,
    Materials,
    bend_forces,
    damper_forces,
    flat,
    gravity_forces,
    masses,
    spring_forces,
    values,
)
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State


def hermite(
    s: float, frame: float, x0: np.ndarray, v0: np.ndarray, x1: np.ndarray, v1: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity at ``s`` in [0, 1] of the cubic from ``x0, v0`` to ``x1, v1`` in ``frame`` [s]."""
    x = (1 + 2 * s) * (1 - s) ** 2 * x0 + s * s * (3 - 2 * s) * x1
    x = x + frame * s * (1 - s) * ((1 - s) * v0 - s * v1)
    v = 6 * s * (1 - s) * (x1 - x0) / frame + (1 - s) * (1 - 3 * s) * v0 + s * (3 * s - 2) * v1
    return x, v


def bodies_at(scene: Scene, old: State, controls: Controls, s: float) -> tuple[np.ndarray, np.ndarray]:
    """Bodies and their velocities ``(B, C, 2, 3)`` at ``s`` in [0, 1] of the frame from ``old``."""
    x1, v1 = controls.colliders, controls.collider_velocities
    return hermite(s, scene.frame_dt, old.colliders, old.collider_velocities, x1, v1)


def put_handles(scene: Scene, old: State, now: State, controls: Controls, s: float) -> None:
    """Give the handles of ``now`` their place and velocity at ``s`` in [0, 1] of the frame from ``old``."""
    held = list(scene.handles)
    x0, v0 = (flat(field)[..., held].transpose(0, 2, 1) for field in (old.positions, old.velocities))
    moved = hermite(s, scene.frame_dt, x0, v0, controls.handle_positions, controls.handle_velocities)
    for array, value in zip((now.positions, now.velocities), moved, strict=True):
        array.reshape(len(array), 3, -1)[..., held] = value.transpose(0, 2, 1)


def total_forces(scene: Scene, materials: Materials, state: State, wind: np.ndarray, pressure: np.ndarray) -> Forces:
    """All forces of the scene but drag and contact, which the step applies to the velocities."""
    grid, x, v = scene.grid, state.positions, state.velocities
    force = spring_forces(grid, materials, x) + damper_forces(grid, materials, x, v) + bend_forces(grid, materials, x)
    force += gravity_forces(grid, materials, x, scene.gravity) + air_forces(scene, x, v, wind)
    return force + pressure_forces(grid, x, pressure) if scene.pressure else force


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
    decay = values(materials, "drag")[:, :, None, None] * h
    push = np.divide(-np.expm1(-decay), decay, out=np.ones_like(decay), where=decay > 0)
    for substep in range(1, substeps + 1):
        s = substep / substeps
        force = total_forces(scene, materials, now, controls.wind, controls.pressure)
        before = now.positions
        now.velocities = now.velocities * np.exp(-decay) + force / mass * h * push
        now.positions = before + h * now.velocities
        bodies, _ = bodies_at(scene, old, controls, s)
        resolve_contact(scene, now, before, now.colliders, bodies, h)
        now.colliders = bodies
        put_handles(scene, old, now, controls, s)
    now.collider_velocities = np.array(controls.collider_velocities, np.float64)
    now.wind, now.pressure = controls.wind.copy(), controls.pressure.copy()
    now.time = old.time + scene.frame_dt
    return now
