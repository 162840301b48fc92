"""Small worlds for the laws: sheets in closed form, and one way to run them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State

G = 9.81
# Only threads: no shear, bending, damping or drag. Laws add what they are about.
THREADS = Material(0.2, 500.0, shear_stiffness=0, bend_stiffness=0, damping=0, drag=0)
Drive = Controls | Callable[[int, State], Controls] | None


def flat(
    grid: Grid,
    *,
    down: Sequence[float] = (0, -1, 0),
    right: Sequence[float] = (1, 0, 0),
    origin: Sequence[float] = (0, 0, 0),
) -> np.ndarray:
    """Unstretched positions ``(1, 3, H, W)`` [m]; ``down`` and ``right`` are the unit steps of row and column."""
    r, c = np.indices(grid.shape)
    steps = np.multiply.outer(down, r * grid.row_spacing) + np.multiply.outer(right, c * grid.col_spacing)
    return (np.reshape(np.asarray(origin, float), (3, 1, 1)) + steps)[None]


def tube(grid: Grid, radius: float) -> np.ndarray:
    """Vertices ``(1, 3, H, W)`` on a cylinder around z, rows upwards: the triangles' normals point inwards."""
    angle = 2 * np.pi * np.arange(grid.cols) / grid.cols
    z = np.arange(grid.rows) * grid.row_spacing
    ring = np.stack([np.cos(angle), np.sin(angle)])[:, None] * radius
    return np.concatenate([ring + 0 * z[:, None], 0 * ring[:1] + z[:, None]])[None]


def bumpy(grid: Grid, seed: int, amplitude: float = 0.1) -> np.ndarray:
    """A flat sheet ``(1, 3, H, W)`` plus a smooth random displacement of about ``amplitude`` spacings."""
    rng = np.random.default_rng(seed)
    r, c = np.indices(grid.shape) / np.reshape(grid.shape, (2, 1, 1))
    out = flat(grid)
    for axis in range(3):
        for _ in range(4):
            kr, kc = rng.integers(0, 4, 2)
            wave = np.cos(np.pi * (kr * r + 2 * kc * c) + rng.uniform(0, 6))
            out[0, axis] += amplitude * grid.row_spacing * rng.normal() * wave
    return out


def run(
    scene: Scene,
    state: State,
    drive: Drive = None,
    frames: int = 1,
    *,
    substeps: int | None = None,
    held: int | None = None,
    dtype: str = "float64",
) -> tuple[list[State], float]:
    """States at the frames' ends, the start included, and the substep's length [s].

    ``drive`` gives the controls: fixed, a function of frame number and state, or None to hold everything. ``held`` is
    for how many substeps slow forces are held, at most.
    """
    backend = ExplicitSolver(scene, num_envs=state.batch, dtype=dtype, substeps=substeps, held=held)
    backend.reset(state)
    states = [backend.state.copy()]
    drive = Controls.hold(state, scene.handles) if drive is None else drive
    for frame in range(frames):
        controls = drive(frame, backend.state) if callable(drive) else drive
        states.append(backend.advance(controls).copy())
    return states, scene.frame_dt / float(np.max(backend.substeps))


def simulate(scene: Scene, state: State, drive: Drive = None, frames: int = 1, **options: object) -> State:
    """The state after ``frames`` frames; options as for ``run``."""
    return run(scene, state, drive, frames, **options)[0][-1]  # type: ignore[arg-type]


def settle(scene: Scene, state: State, time: float, drive: Drive = None) -> State:
    """``simulate`` for ``time`` [s] in whole frames."""
    return simulate(scene, state, drive, int(np.ceil(time / scene.frame_dt)))


def centre(scene: Scene, states: Sequence[State], name: str = "positions") -> np.ndarray:
    """Mass-weighted mean of ``positions`` or ``velocities`` over time, ``(T, 3)``, of the first member."""
    weight = scene.mass / scene.mass.sum()
    return np.array([(getattr(state, name)[0] * weight).sum((1, 2)) for state in states])


def frequency(signal: np.ndarray, dt: float) -> float:
    """Angular frequency [rad/s] of a harmonic ``signal`` about zero, sampled every ``dt`` [s].

    From ``a(t + dt) + a(t - dt) = 2 cos(w dt) a(t)`` in the least-squares sense.
    """
    inner = signal[1:-1]
    return float(np.arccos((inner @ (signal[2:] + signal[:-2])) / (2 * inner @ inner)) / dt)


def rates(errors: Sequence[float]) -> np.ndarray:
    """Observed orders ``log2(e_i / e_{i+1})`` of errors at steps that halve."""
    e = np.asarray(errors)
    return np.log2(e[:-1] / e[1:])
