"""What happened between states: work and losses, the residual of an implicit step, and slow motion.

Forces are those of ``physics.laws``; arrays have one row a cloth.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cloth_envs.material import Material
from cloth_envs.physics.laws import air, sheet, step
from cloth_envs.physics.laws.diagnostics import as_materials, depths, energy
from cloth_envs.scene import GRAVITY, Scene
from cloth_envs.state import State

LEAST_FALL = 0.05  # of the cloth's length: a cloth that hardly falls says nothing of slow motion


@dataclass(frozen=True)
class Budget:
    """Where the mechanical energy came from and went, ``(B,)`` [J]:
    ``gained = handles + air + pressure - damping - drag + rest``.
    """

    gained: np.ndarray  # change of kinetic, gravity, spring and bending energy
    handles: np.ndarray  # work of whatever drives the handles
    air: np.ndarray  # work of the air, still or blowing
    pressure: np.ndarray
    damping: np.ndarray  # lost in dashpots, positive
    drag: np.ndarray  # lost to the materials' ``drag``, positive

    @property
    def rest(self) -> np.ndarray:
        """What the others leave: work and friction of contact, the solver's own gain or loss, and the error of the
        quadrature; without bodies and with short intervals it is the solver's.
        """
        return self.gained - self.handles - self.air - self.pressure + self.damping + self.drag


def _powers(
    scene: Scene, sheets: Sequence[Material], state: State, wind: np.ndarray, pressure: np.ndarray
) -> np.ndarray:
    """Power [W] of pull at the handles, air, pressure, damping and drag, ``(5, B)``, in a given wind and pressure."""
    grid, x, v = scene.grid, state.positions, state.velocities.astype(np.float64)
    blown = air.air_forces(scene, x, v, wind)
    pressed = air.pressure_forces(grid, x, pressure) if scene.pressure else np.zeros(x.shape)
    damped = sheet.damper_forces(grid, sheets, x, v)
    rate = np.array([m.drag for m in sheets])[:, None, None, None]
    slowed = -rate * sheet.masses(grid, sheets) * v
    held = np.isin(np.arange(grid.vertices), scene.handles)
    pull = sheet.spring_forces(grid, sheets, x) + sheet.bend_forces(grid, sheets, x)
    pull = pull + sheet.gravity_forces(grid, sheets, x, scene.gravity) + blown + pressed + damped + slowed
    parts = (pull * held.reshape(grid.shape), blown, pressed, damped, slowed)
    return np.array([(force * v).sum((1, 2, 3)) for force in parts])


def budget(scene: Scene, states: Sequence[State], materials: Sequence[Material] | None = None) -> Budget:
    """The energy budget over ``states``: two ends of a frame, or a trajectory.

    Powers ``f . v`` are computed at every state and summed by the trapezoidal rule, second order in the time between
    states: step the cloth in short frames (``dataclasses.replace(scene, frame_dt=...)``) where it matters. Wind and
    pressure of an interval are those that its later state tells. A handle is accelerated by the cloth's forces ``F``
    and its drive's ``f``, ``m a = F + f``, so the drive's work is the handle's gain of kinetic energy less the
    integral of ``F . v``; no acceleration is needed.

    Raises:
        ValueError: fewer than two states.
    """
    if len(states) < 2:
        raise ValueError("a budget needs the states before and after: give at least two")
    sheets = as_materials(scene, states[0], materials)
    work = np.zeros((5, states[0].batch))
    for before, after in pairwise(states):
        ends = [_powers(scene, sheets, state, after.wind, after.pressure) for state in (before, after)]
        work += (ends[0] + ends[1]) / 2 * (after.time - before.time)
    first, last = states[0], states[-1]
    start, end = energy(scene, first, sheets), energy(scene, last, sheets)
    held = np.isin(np.arange(scene.grid.vertices), scene.handles)
    mass = sheet.masses(scene.grid, sheets) * held.reshape(scene.grid.shape)
    driven = [(mass * s.velocities.astype(np.float64) ** 2).sum((1, 2, 3)) / 2 for s in (first, last)]
    return Budget(
        gained=end.mechanical - start.mechanical,
        handles=driven[1] - driven[0] - work[0],
        air=work[1],
        pressure=work[2],
        damping=-work[3],
        drag=-work[4],
    )


def implicit_residual(
    scene: Scene, before: State, after: State, materials: Sequence[Material] | None = None, *, contact: float = 1e-4
) -> np.ndarray:
    """How badly ``after`` solves implicit Euler, ``sum |M (v1 - v0) / h - F(x1, v1)| / (M g)`` over vertices, ``(B,)``.

    1 is a residual as large as the weight (at 9.81 m/s^2, whatever the scene's). ``h`` is the time between the two
    states, so they must be one substep apart; wind and pressure are those of ``after``. Left out, in the residual
    and in the weight: handles, and vertices within ``contact`` [m] of touching a body, whose forces nobody knows.
    """
    sheets, grid = as_materials(scene, before, materials), scene.grid
    v0, v1 = (state.velocities.astype(np.float64) for state in (before, after))
    mass = sheet.masses(grid, sheets)
    h = (after.time - before.time)[:, None, None, None]
    rate = np.array([m.drag for m in sheets])[:, None, None, None]
    force = step.total_forces(scene, sheets, after, after.wind, after.pressure) - rate * mass * v1
    size = np.linalg.norm(mass * (v1 - v0) / h - force, axis=1).reshape(before.batch, -1)
    free = depths(scene, after) < -contact
    free[:, list(scene.handles)] = False
    weight = GRAVITY * (mass.reshape(before.batch, -1) * free).sum(1)
    return np.divide((size * free).sum(1), weight, out=np.zeros(before.batch), where=weight > 0)


@dataclass(frozen=True)
class SlowMotion:
    """The gate's finding, ``(B,)``."""

    # Mean height of the run less that of the converged one where they are farthest apart [m]; positive if it hangs.
    difference: np.ndarray
    fall: np.ndarray  # how far the converged mean height got from its start [m]
    fraction: np.ndarray  # ``|difference|`` over the fall, or over ``LEAST_FALL`` of the cloth's length if it fell less
    passed: np.ndarray  # ``fraction <= tolerance``


def slow_motion(
    scene: Scene, run: Sequence[State], converged: Sequence[State], *, tolerance: float = 0.05
) -> SlowMotion:
    """Compare mean heights of ``run`` with a ``converged`` run of the same start, handles and times.

    Solvers that stop short of convergence hold the edges at their length and yet fall too slowly: strain does not
    show it, the mean height does, and it is far less chaotic than any vertex. Give trajectories, or just the start
    and the end. NaN in the run does not pass.

    Raises:
        ValueError: different lengths, or fewer than two states.
    """
    if len(run) != len(converged) or len(run) < 2:
        raise ValueError(f"give as many states of both, the start first: got {len(run)} and {len(converged)}")
    heights, true = (
        np.array([(s.positions[:, 2].astype(np.float64) * scene.grid.areas).sum((1, 2)) for s in states])
        / scene.grid.areas.sum()
        for states in (run, converged)
    )
    gap = heights - true
    worst = abs(gap).argmax(0)  # the first NaN, if there is one
    difference = np.take_along_axis(gap, worst[None], 0)[0]
    fall = abs(true - true[0]).max(0)
    fraction = abs(difference) / np.maximum(fall, LEAST_FALL * scene.grid.length)
    return SlowMotion(difference, fall, fraction, fraction <= tolerance)
