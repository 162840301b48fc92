"""The plain NumPy twin of the explicit kernel: all forces, and a frame of substeps; tests' oracle."""

import numpy as np

from cloth_envs.physics.laws.air import air_forces, pressure_forces
from cloth_envs.physics.laws.bodies import resolve_contact
from cloth_envs.physics.laws.drives import bodies_at, pull_handles, put_handles
from cloth_envs.physics.laws.sheet import (
    Forces,
    Materials,
    bend_forces,
    damped_spring_forces,
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
    force += gravity_forces(grid, materials, x, scene.gravity) + air_forces(scene, x, v, wind)
    return force + pressure_forces(grid, x, pressure) if scene.pressure else force


def slow_forces(scene: Scene, materials: Materials, state: State, controls: Controls) -> Forces:
    """Bending, air and pressure: what is held for some substeps."""
    grid, x = scene.grid, state.positions
    force = bend_forces(grid, materials, x) + air_forces(scene, x, state.velocities, controls.wind)
    return force + pressure_forces(grid, x, controls.pressure) if scene.pressure else force


def kicks(count: int) -> np.ndarray:
    """Shares of the ``count + 1`` changes of velocities in a frame of ``count`` substeps: half of those at its ends."""
    part = np.ones(count + 1)
    part[[0, -1]] = 0.5
    return part


def foresight(substep: int, held: int, count: int) -> tuple[float, float]:
    """How far ahead slow forces are looked for at ``substep``, if they are held for ``held`` of ``count`` substeps.

    Substeps to the middle of their kicks, and how much of the velocities' change since they were last looked for is
    added to these by then. Velocities are half a substep old, but at a frame's start.
    """
    part = kicks(count)[substep : substep + held]
    later = float(np.average(np.arange(len(part)), weights=part))
    return later, 0.0 if substep == 0 else (later + 0.5) / (held if substep > held else held - 0.5)


def step(
    scene: Scene,
    state: State,
    controls: Controls,
    substeps: int | np.ndarray,
    materials: Materials | None = None,
) -> State:
    """One frame by velocity Verlet, with slow forces held for a few substeps; the result is in float64.

    ``substeps`` is a number for all, or of each cloth ``(B, 2)``: their number, and for how many of them slow forces
    are held. ``materials`` default to the scene's. At the start of a substep of length h:
    ``v <- v D + (F + G) / m h phi`` with ``F`` springs with their dashpots and weight, ``G`` bending, air, pressure,
    ``D = exp(-drag h)``, ``phi = (1 - D) / (drag h)`` (exact for a constant force); half of it (h / 2) in a frame's
    first, and again at its end. Then ``x <- x + h v``, contact with every body in turn; handles go, or are drawn, to
    their cubics (``put_handles``); the springs of soft ones pull for half a substep more at the frame's end, and for
    half less at its start, whose first substep draws them for a whole one (``pull_handles``). ``G`` is that of the
    middle of the time for which it is held: of positions that go on as they move, and for the air of velocities that go
    on changing as since it was last computed. Velocities at the end are those that contact leaves of them if they go on
    for half a substep.
    """
    materials = [scene.material] * state.batch if materials is None else materials
    if isinstance(substeps, np.ndarray):
        out = state.astype(np.float64)
        for i, cut in enumerate(substeps):
            one = Controls(**{name: value[[i]] for name, value in vars(controls).items()})
            out.assign([i], _frame(scene, state.select([i]), one, int(cut[0]), int(cut[1]), [materials[i]]))
        return out
    return _frame(scene, state, controls, substeps, 1, materials)


def _frame(scene: Scene, state: State, controls: Controls, count: int, held: int, materials: Materials) -> State:
    """A frame of ``count`` substeps."""
    old, now = state.astype(np.float64), state.astype(np.float64)
    h, mass = scene.frame_dt / count, masses(scene.grid, materials)
    decay = h * values(materials, "drag")[:, :, None, None]
    weight = gravity_forces(scene.grid, materials, now.positions, scene.gravity)
    stiffness = np.array([m.stretch_stiffness / m.areal_density for m in materials])
    part, before, slow = kicks(count), now.velocities, weight
    for substep in range(count + 1):
        if substep % held == 0:
            later, trend = foresight(substep, held, count)
            then = now.copy()
            then.positions = now.positions + later * h * now.velocities
            then.velocities = now.velocities + trend * (now.velocities - before)
            before, slow = now.velocities, slow_forces(scene, materials, then, controls)
        force = damped_spring_forces(scene.grid, materials, now.positions, now.velocities) + weight + slow
        if substep == 0:
            pull_handles(scene, old, now, controls, 0.0, stiffness, -h / 2)
        lost = part[substep] * decay
        push = h * part[substep] * np.divide(-np.expm1(-lost), lost, out=np.ones_like(lost), where=lost > 0) / mass
        now.velocities = now.velocities * np.exp(-lost) + force * push
        if substep < count:
            start, s = now.positions, (substep + 1) / count
            now.positions = start + h * now.velocities
            bodies, _ = bodies_at(scene, old, controls, s)
            resolve_contact(scene, now, start, now.colliders, bodies, h)
            now.colliders = bodies
        elif scene.colliders:
            trial, ahead = now.copy(), bodies_at(scene, old, controls, 1 + 0.5 / count)[0]
            trial.positions = now.positions + h / 2 * now.velocities
            resolve_contact(scene, trial, now.positions, now.colliders, ahead, h / 2)
            now.velocities = trial.velocities
        put_handles(scene, old, now, controls, s, stiffness, h if substep < count else 0.0)
    pull_handles(scene, old, now, controls, 1.0, stiffness, h / 2)
    now.collider_velocities = np.array(controls.collider_velocities, np.float64)
    now.wind, now.pressure = controls.wind.copy(), controls.pressure.copy()
    now.time = old.time + scene.frame_dt
    return now
