"""The cell of a sheet, identified from the reference's own steps: one number for every class of edges and branch."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import lstsq

from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.laws.air import air_forces, pressure_forces
from cloth_envs.physics.laws.stencil import edges, quads, triples
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.cell.compiled import CLASSES, SHARED, SHEET, CellSheet
from training.cell.data import bare_step
from training.metrics.errors import vertex_error
from training.rollouts import replay
from training.truth import Case

SEED, HELD_OUT = 100, 200
FRAMES = (2, 5, 8, 12, 16, 20, 25, 30, 35, 40)


def columns(scene: Scene, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """What every number of ``CLASSES`` multiplies, as accelerations ``(17, 3 N)``, from ``x``, ``v`` ``(3, N)``.

    All numbers are 1 on the reference; shares of edges, masses and borders are geometry, taken from ``stencil``.
    """
    material, mass = scene.material, scene.mass.ravel()
    found = np.zeros((len(CLASSES), *x.shape))
    for k, edge in enumerate(edges(scene.grid)):
        d, w = (a[:, edge.second] - a[:, edge.first] for a in (x, v))
        length, later = (np.sqrt((a * a).sum(0)) for a in (d, d + material.damping * w))
        n = d / length
        stiffness = getattr(material, edge.modulus) * edge.weight
        branches = (stiffness * d, -stiffness * edge.rest * n, stiffness * edge.rest * (1 / length - 1 / later) * d)
        for branch, force in enumerate(branches):
            found[4 * branch + k][:, edge.first] += force
            found[4 * branch + k][:, edge.second] -= force
    for k, t in enumerate(triples(scene.grid), 12):
        second = material.bend_stiffness * t.weight * (x[:, t.before] - 2 * x[:, t.middle] + x[:, t.after])
        for vertices, share in ((t.before, -1), (t.middle, 2), (t.after, -1)):
            found[k][:, vertices] += share * second
    q = quads(scene.grid)
    mixed = x[:, q.upper_left] - x[:, q.upper_right] - x[:, q.lower_left] + x[:, q.lower_right]
    for vertices, sign in zip(q[:4], (-1, 1, 1, -1), strict=True):
        found[12:14, :, vertices] += sign * material.bend_stiffness * material.twist * q.weight / 2 * mixed
    found /= mass
    found[-3:] = scene.gravity * np.array([1.0, 1.0, -1.0])[:, None, None] * np.eye(3)[:, :, None]
    return found.reshape(len(CLASSES), -1)


def accelerations(scene: Scene, state: State, controls: Controls, substeps: int) -> np.ndarray:
    """What the cell has to give: a substep of the reference, less drag, air and pressure, ``(3 N,)`` [m/s^2].

    The step is taken without handles and bodies, so that driven vertices tell their forces as well.
    """
    h, drag = scene.frame_dt / substeps, scene.material.drag
    bare = replace(scene, frame_dt=h, handles=(), grips=(), colliders=())
    solver = ExplicitSolver(bare, dtype="float64", substeps=1, held=1)
    after = bare_step(solver, state, wind=controls.wind, pressure=controls.pressure)
    kick = -np.expm1(-drag * h / 2) / drag if drag else h / 2  # half of it before positions move
    moved = (after.positions.astype(np.float64) - state.positions) / h
    total = (moved - state.velocities * np.exp(-drag * h / 2)) / kick
    air = air_forces(scene, state.positions, state.velocities, controls.wind)
    if scene.pressure:
        air = air + pressure_forces(scene.grid, state.positions, controls.pressure)
    return (total - air / scene.mass)[0].ravel()


class Identified(NamedTuple):
    """``factors`` in the order of ``SHEET``, numbers ``by_class`` in that of ``CLASSES``, the bias along x and y over
    gravity, the relative ``error`` of the forces from ``factors`` on held-out data, and a hash of the data.
    """

    factors: np.ndarray
    by_class: np.ndarray
    sideways: np.ndarray
    error: float
    data_hash: str


def data(name: str, seed: int, frames: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Columns ``(17, R)`` and accelerations ``(R,)`` of states on an episode with smooth actions."""
    run = Case(name, seed, truth="plain", self_contact=False).record(max(frames), frames)
    substeps, blocks, wanted = int(ExplicitSolver(run.scene).substeps[0]), [], []
    for frame in frames:
        state = run.states[frame]
        blocks.append(columns(run.scene, *(a[0].reshape(3, -1) for a in (state.positions, state.velocities))))
        wanted.append(accelerations(run.scene, state, run.controls[frame - 1], substeps))
    return np.concatenate(blocks, 1), np.concatenate(wanted)


def solve(block: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Least squares of ``block.T @ numbers = wanted``, with its columns scaled to one size."""
    size = np.sqrt((block**2).mean(1))
    return lstsq((block / size[:, None]).T, wanted)[0] / size


def identify(name: str, frames: Sequence[int] = FRAMES) -> Identified:
    """The cell of the scene ``name`` from one episode, tested on another."""
    block, wanted = data(name, SEED, frames)
    key = hashlib.sha256(block.tobytes() + wanted.tobytes()).hexdigest()
    by_class = solve(block, wanted)
    shared = solve(SHARED.T @ block, wanted)
    block, wanted = data(name, HELD_OUT, frames)
    error = np.linalg.norm(shared @ SHARED.T @ block - wanted) / np.linalg.norm(wanted)
    return Identified(shared[: len(SHEET)], by_class, shared[len(SHEET) :], float(error), key)


def sheet_errors(name: str, factors: Mapping[str, float]) -> list[float]:
    """Mean distance from the reference 1, 5 and 10 frames after its 20th, in float32, in % of the cloth's length."""
    run = Case(name, HELD_OUT, truth="plain", self_contact=False).record(30, [20])
    solvers = CellSheet(run.scene, factors), ExplicitSolver(run.scene)
    pairs = zip(*(replay(solver, run.states[20], run.controls[20:]) for solver in solvers), strict=True)
    length = run.scene.grid.length
    found = [float(vertex_error(own.positions, other.positions, length).mean[0]) for (own, _), (other, _) in pairs]
    return [float(f"{found[frame - 1]:.2g}") for frame in (1, 5, 10)]
