"""Table 2 of Zhao 2024, the physics-embedded CNN, and what its cell is and is not good for.

Errors are max |dx| over steps, particles and axes in % of the 1 m cloth, against our simulator in float64 with the
author's settings, over the whole animation of 4,811 steps. Two animations are chaotic: there the error is the same for
the simulator itself in float32 or after a nudge of 1e-9 m, so errors until 0.25 s and 0.5 s stand beside. Speeds are of
one thread, in one run, in turns.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cloth_envs.physics.laws.particles import cell_forces
from cloth_envs.physics.particles.solver import NEIGHBOURS, ParticleSolver, net_of
from surrogates.cell.compiled import CellNet, dimensional
from surrogates.cell.engine import TorchNet
from surrogates.checkpoint import load
from training.bench.papers.rows import CellCheckRow, CellRow, CellSpeedRow
from training.cell.data import CASES, case
from training.cell.score import NUDGE, Run, errors
from training.cell.solve import least_squares, rows
from training.rollouts import replay
from training.rows import Store

CELLS = ("cnn_particles_least_squares", "cnn_particles", "cnn_particles_fall", "cnn_particles_blow")
# (cell, scene) -> the paper's error [%]: no pressure, pressure, trained without and tested with.
PAPER = {
    ("cnn_particles_fall", "fall"): 0.213,
    ("cnn_particles_blow", "blow"): 0.477,
    ("cnn_particles_fall", "blow"): 0.518,
}
PAPER_SPEED = {"cell, torch": 232.0, "simulator": 201.0}  # steps/s: network on a GPU, simulator on a CPU
SIDEWAYS = 0.01  # of gravity, the bias whose effect is shown


def wanted() -> dict[str, Run]:
    """All runs of an animation by name: cells, the simulator's floors, and a cell with a sideways bias."""
    arrays = {name: load(name).arrays for name in CELLS}
    pushed = {**arrays[CELLS[0]], "bias": arrays[CELLS[0]]["bias"] + [SIDEWAYS, 0.0, 0.0]}
    return {
        **{name: Run(values) for name, values in arrays.items()},
        f"{CELLS[1]}, float32": Run(arrays[CELLS[1]], "float32"),
        "simulator, float32": Run(None, "float32"),
        "simulator, nudged by 1e-9 m": Run(None, nudge=NUDGE),
        f"sideways bias of {SIDEWAYS:g} g": Run(pushed),
    }


def score(store: Store[CellRow], steps: int) -> None:
    """The rows that ``store`` lacks, an animation at a time."""
    for scene in CASES:
        runs = {name: run for name, run in wanted().items() if (scene, name, steps) not in store}
        if runs:
            found = errors(scene, runs, steps)
            store.add(
                *(
                    CellRow(scene, name, run.dtype, steps, *found[name], paper=PAPER.get((name, scene), np.nan))
                    for name, run in runs.items()
                )
            )


def speeds(frames: int) -> list[CellSpeedRow]:
    """Everything that steps the paper's "blow", one after the other, several times round; time of the processor."""
    import torch

    torch.set_num_threads(1)
    given = case("blow")
    scene = replace(given.scene, frame_dt=16 * net_of(given.scene).sim_dt)
    cell = dimensional(scene, load(CELLS[1]).arrays)
    solvers: dict[tuple[str, str], ParticleSolver] = {}
    for dtype in ("float32", "float64"):
        solvers["simulator", dtype] = ParticleSolver(scene, dtype=dtype)
        solvers["cell, compiled", dtype] = CellNet(scene, cell, dtype=dtype)
        solvers["cell, torch", dtype] = TorchNet(scene, cell, dtype=dtype)
    times: dict[tuple[str, str], list[float]] = {key: [] for key in solvers}
    for _ in range(frames + 1):  # the first warms up
        for key, solver in solvers.items():
            # The first frame of a pair fills the caches, which hold what ran before.
            _, (_, taken) = replay(solver, given.start, [given.controls] * 2)
            times[key].append(16 / taken.cpu)
    middle = {key: float(np.median(values[1:])) for key, values in times.items()}
    return [
        CellSpeedRow(
            engine,
            dtype,
            middle[engine, dtype],
            max(times[engine, dtype][1:]),
            middle[engine, dtype] / middle["simulator", dtype],
            PAPER_SPEED.get(engine, np.nan) if dtype == "float32" else np.nan,
        )
        for engine, dtype in solvers
    ]


def inflation(block: np.ndarray, ties: np.ndarray) -> float:
    """How many times the other columns blow up the variance of the bias along x, from tied columns."""
    tied = ties.T @ block
    tied /= np.sqrt((tied**2).mean(1))[:, None]
    return float(np.linalg.inv(tied @ tied.T / tied.shape[1])[-3, -3])


def checks(states: int) -> list[CellCheckRow]:
    """The component-wise ISRU, how well a sideways bias can be told from uneven weights, momentum and turns."""
    found, count = [], len(NEIGHBOURS)
    pairs = np.zeros((3 * count + 3, 3 * count // 2 + 3))
    pairs[np.arange(3 * count), np.arange(3 * count) // 2] = 1.0
    pairs[3 * count :, 3 * count // 2 :] = np.eye(3)
    for names in (("fall",), ("blow",), ("hang",), ("ball",)):
        for vector in (True, False):
            block, target = rows(names, states, 1000, vector=vector)
            fit = least_squares((block, target))
            off = np.linalg.norm(fit.numbers @ block - target) / np.linalg.norm(target)
            kind = "vector" if vector else "component-wise"
            found.append(CellCheckRow(f"relative force error, best fit with {kind} ISRU", names[0], float(off)))
            if vector:
                found.append(CellCheckRow("seconds of the closed form", names[0], fit.seconds))
                for text, ties in (("12", np.eye(len(block))), ("6 shared", pairs)):
                    name = f"variance inflation of the sideways bias, {text} weights a branch"
                    found.append(CellCheckRow(name, names[0], inflation(block, ties)))
    return found + laws()


def laws() -> list[CellCheckRow]:
    """What a free crumpled net keeps of its momentum, and how its forces turn with it, of every shipped cell."""
    scene, rng = case("fall").scene, np.random.default_rng(0)
    x = case("fall").start.positions + 0.15 * scene.grid.row_spacing * rng.normal(size=(1, 3, *scene.grid.shape))
    v, found = rng.normal(size=x.shape), []
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    for name in CELLS:
        cell = replace(dimensional(scene, load(name).arrays), bias=np.zeros(3))
        force = cell_forces(cell, x, v)
        turned = cell_forces(cell, *(np.einsum("ij,bjhw->bihw", turn, a) for a in (x, v)))
        gap = turned - np.einsum("ij,bjhw->bihw", turn, force)
        lost = abs(force.sum((0, 2, 3))).max() / abs(force).sum()
        found.append(CellCheckRow("sum of forces over sum of their sizes", name, float(lost)))
        found.append(
            CellCheckRow("error of turned forces over the largest", name, float(abs(gap).max() / abs(force).max()))
        )
    return found
