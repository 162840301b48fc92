"""The plain NumPy twin of the explicit kernel: all forces, and a frame of symplectic Euler; tests' oracle."""

import numpy as np

from cloth_envs.physics.laws.air import pressure_forces, wind_forces
from cloth_envs.physics.laws.bodies import resolve_contact
from cloth_envs.physics.laws.drives import bodies_at, put_handles
from cloth_envs.physics.laws.sheet import (
    Forces,
    Materials,
    bend_forces,
    damper_forces,
    gravity_forces,
    masses,
    spring_forces,
    values,
)
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State


def total_forces(scene: Scene, materials: Materials, state: State, wind: np.ndarray, pressure: np.ndarray) -> Forces:
    """All forces of the scene but drag and contact, which the step applies to the velocities."""
    grid, x, v = scene.grid, state.positions, state.velocities
    force = spring_forces(grid, materials, x) + damper_forces(grid, materials, x, v) + bend_forces(grid, materials, x)
    force += gravity_forces(grid, materials, x, scene.gravity) + wind_forces(scene, x, v, wind)
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
    in turn; handles then go, or are drawn, to their cubics (``put_handles``).
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
    stiffness = np.array([m.stretch_stiffness / m.areal_density for m in materials])
    decay = values(materials, "drag")[:, :, None, None] * h * scene.drag
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
        put_handles(scene, old, now, controls, s, stiffness, h)
    now.collider_velocities = np.array(controls.collider_velocities, np.float64)
    now.wind, now.pressure = controls.wind.copy(), controls.pressure.copy()
    now.time = old.time + scene.frame_dt
    return now
