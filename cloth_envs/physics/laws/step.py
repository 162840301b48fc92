"""The plain NumPy twin of the explicit kernel: all forces, and a frame of substeps; tests' oracle."""

import numpy as np

from cloth_envs.physics.laws.air import air_forces, pressure_forces
from cloth_envs.physics.laws.bodies import resolve_contact
from cloth_envs.physics.laws.drives import bodies_at, put_handles
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


def slow_forces(scene: Scene, materials: Materials, state: State, controls: Controls, air: bool, bend: bool) -> Forces:
    """What acts as impulses: bending, if ``bend``, and wind and pressure, if ``air``."""
    grid, x = scene.grid, state.positions
    force = bend_forces(grid, materials, x) if bend else np.zeros_like(x)
    if air:
        force = force + air_forces(scene, x, state.velocities, controls.wind)
    return force + pressure_forces(grid, x, controls.pressure) if air and scene.pressure else force


def impulse_share(substep: int, every: int, count: int) -> float:
    """How many of a frame's ``count`` substeps the impulse at the start of ``substep`` stands for, 0 for no impulse.

    Impulses come every ``every`` substeps and at the end of the frame; each stands for half of the time to the one
    before and to the one after it.
    """
    if substep % every and substep != count:
        return 0.0
    last = (count - 1) // every * every
    before = last if substep == count else max(substep - every, 0)
    return (min(substep + every, count) - before) / 2


def step(
    scene: Scene,
    state: State,
    controls: Controls,
    substeps: int | np.ndarray,
    materials: Materials | None = None,
) -> State:
    """One frame by velocity Verlet with impulses (r-RESPA, Tuckerman et al. 1992); the result is in float64.

    ``substeps`` is a number for all, or of each cloth ``(B, 3)``: their number, and after how many of them bending and
    the air act. ``materials`` default to the scene's. At the start of a substep of length h:
    ``v <- v D + (F + s G) / m h phi`` with ``F`` springs with their dashpots and weight, ``G`` bending and air, ``s`` the
    substeps that their impulse stands for (``impulse_share``), ``D = exp(-drag h)``, ``phi = (1 - D) / (drag h)``
    (exact for a constant force); half of it (h / 2) in a frame's first, and again at its end. Then ``x <- x + h v``,
    contact with every body in turn; handles go, or are drawn, to their cubics (``put_handles``). The air sees velocities with half
    of what its impulse, as large as the last one, will change. Velocities at the end are those that contact leaves of
    them if they go on for half a substep.
    """
    materials = [scene.material] * state.batch if materials is None else materials
    if isinstance(substeps, np.ndarray):
        out = state.astype(np.float64)
        for i, cut in enumerate(substeps):
            one = Controls(**{name: value[[i]] for name, value in vars(controls).items()})
            out.assign([i], _frame(scene, state.select([i]), one, *map(int, cut), [materials[i]]))
        return out
    return _frame(scene, state, controls, substeps, 1, 1, materials)


def _frame(
    scene: Scene, state: State, controls: Controls, count: int, bend_every: int, air_every: int, materials: Materials
) -> State:
    """A frame of ``count`` substeps."""
    old, now = state.astype(np.float64), state.astype(np.float64)
    h, mass = scene.frame_dt / count, masses(scene.grid, materials)
    decay = h * values(materials, "drag")[:, :, None, None]
    weight = gravity_forces(scene.grid, materials, now.positions, scene.gravity)
    kick, before = np.zeros_like(now.positions), 0.0  # the air's last impulse, and its share
    stiffness = np.array([m.stretch_stiffness / m.areal_density for m in materials])
    bends = any(material.bend_stiffness > 0 for material in materials)

    def change(decay: np.ndarray) -> np.ndarray:
        return np.divide(-np.expm1(-decay), decay, out=np.ones_like(decay), where=decay > 0)

    for substep in range(count + 1):
        part = 0.5 if substep in (0, count) else 1.0
        bend, air = bends * impulse_share(substep, bend_every, count), impulse_share(substep, air_every, count)
        impulse = np.zeros_like(now.positions)
        if air:
            seen = now.copy()
            if before:
                seen.velocities = now.velocities + air / 2 / before * kick / mass * h * change(decay)
            kick = impulse = air / part * slow_forces(scene, materials, seen, controls, air=True, bend=False)
            before = air / part
        if bend:
            impulse = impulse + bend / part * slow_forces(scene, materials, now, controls, air=False, bend=True)
        force = damped_spring_forces(scene.grid, materials, now.positions, now.velocities) + weight
        push = h * part * change(part * decay) / mass
        now.velocities = now.velocities * np.exp(-part * decay) + (force + impulse) * push
        if substep < count:
            start, s = now.positions, (substep + 1) / count
            now.positions = start + h * now.velocities
            bodies, _ = bodies_at(scene, old, controls, s)
            resolve_contact(scene, now, start, now.colliders, bodies, h)
            now.colliders = bodies
        elif scene.colliders:
            s, trial = 1 + 0.5 / count, now.copy()
            trial.positions = now.positions + h / 2 * now.velocities
            resolve_contact(scene, trial, now.positions, now.colliders, bodies_at(scene, old, controls, s)[0], h / 2)
            now.velocities, s = trial.velocities, 1.0
        put_handles(scene, old, now, controls, s, stiffness, h if substep < count else 0.0)
    now.collider_velocities = np.array(controls.collider_velocities, np.float64)
    now.wind, now.pressure = controls.wind.copy(), controls.pressure.copy()
    now.time = old.time + scene.frame_dt
    return now
