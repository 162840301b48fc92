"""Table 2 of Zhao 2024, the physics-embedded CNN, and what its cell is and is not good for (docs/networks.md).

Errors are max |dx| over steps, particles and axes in % of the 1 m cloth, against our simulator in float64 with the
author's settings and order: velocities change in place, row by row, which no convolution does. Speeds are of one
thread, in one run, in turns.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from cloth_envs.physics.laws.particles import cell_forces
from cloth_envs.physics.particles.solver import NEIGHBOURS, ParticleSolver, net_of
from surrogates.cell.compiled import CellNet, dimensional
from surrogates.cell.engine import TorchNet
from surrogates.checkpoint import load
from training.cell.data import CASES, case
from training.cell.score import EXACT, NUDGE, Run, errors, scored
from training.cell.solve import least_squares
from training.cell.solve import rows as columns
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
LAW = "the law on old velocities"  # what is left of its error is the order of the author's loop
SIDEWAYS = 0.01  # of gravity, the bias whose effect is shown


@dataclass(frozen=True)
class CellRow:
    """One run of an animation of Zhao 2024; errors in % of a metre."""

    scene: str
    run: str
    dtype: str
    steps: int
    until_fifth_second: float
    until_half_second: float
    whole: float
    mean_at_end: float
    paper: float


CELL_KEY = ("scene", "run", "steps")


@dataclass(frozen=True)
class CellSpeedRow:
    """Steps per second of 128 x 128 particles, and over the simulator's."""

    engine: str
    dtype: str
    median: float
    best: float
    over_simulator: float
    paper: float


@dataclass(frozen=True)
class CellCheckRow:
    """A number that a claim rests on."""

    name: str
    scene: str
    value: float


def wanted() -> dict[str, Run]:
    """All runs of an animation by name: cells, the law, the simulator's floors, and a cell with a sideways bias."""
    arrays = {name: load(name).arrays for name in CELLS}
    pushed = {**arrays[CELLS[0]], "bias": arrays[CELLS[0]]["bias"] + [SIDEWAYS, 0.0, 0.0]}
    return {
        **{name: Run(values) for name, values in arrays.items()},
        LAW: Run(EXACT),
        f"{CELLS[1]}, float32": Run(arrays[CELLS[1]], "float32"),
        "simulator, float32": Run(None, "float32"),
        "simulator, nudged by 1e-9 m": Run(None, nudge=NUDGE),
        f"sideways bias of {SIDEWAYS:g} g": Run(pushed),
    }


def score(store: Store[CellRow], steps: int) -> None:
    """The rows that ``store`` lacks, an animation at a time."""
    for scene in CASES:
        count = scored(scene, steps)
        runs = {name: run for name, run in wanted().items() if (scene, name, count) not in store}
        found = errors(scene, runs, steps) if runs else {}
        papers = {name: PAPER.get((name, scene), np.nan) for name in found}
        store.add(*(CellRow(scene, n, runs[n].dtype, count, *error, papers[n]) for n, error in found.items()))


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
    rows = []
    for engine, dtype in solvers:
        own, best = middle[engine, dtype], max(times[engine, dtype][1:])
        paper = PAPER_SPEED.get(engine, np.nan) if dtype == "float32" else np.nan
        rows.append(CellSpeedRow(engine, dtype, own, best, own / middle["simulator", dtype], paper))
    return rows


def checks(states: int) -> list[CellCheckRow]:
    """The component-wise ISRU, how well a sideways bias can be told from uneven weights, momentum and turns."""
    found, count = [], len(NEIGHBOURS)
    pairs = np.zeros((3 * count + 3, 3 * count // 2 + 3))
    pairs[np.arange(3 * count), np.arange(3 * count) // 2] = 1.0
    pairs[3 * count :, 3 * count // 2 :] = np.eye(3)
    for scene, vector in product(("fall", "blow", "hang", "ball"), (True, False)):
        block, target = columns((scene,), states, 1000, vector=vector)
        fit = least_squares((block, target))
        off = np.linalg.norm(fit.numbers @ block - target) / np.linalg.norm(target)
        kind = "vector" if vector else "component-wise"
        found.append(CellCheckRow(f"relative force error, best fit with {kind} ISRU", scene, float(off)))
        if vector:
            found.append(CellCheckRow("seconds of the closed form", scene, fit.seconds))
        for text, ties in (("12", np.eye(len(block))), ("6 shared", pairs)) if vector else ():
            tied = ties.T @ block
            tied /= np.sqrt((tied**2).mean(1))[:, None]
            inflation = float(np.linalg.inv(tied @ tied.T / tied.shape[1])[-3, -3])  # by the columns beside it
            name = f"variance inflation of the sideways bias, {text} weights a branch"
            found.append(CellCheckRow(name, scene, inflation))
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
        turning = abs(gap).max() / abs(force).max()
        found.append(CellCheckRow("error of turned forces over the largest", name, float(turning)))
    return found


def table(rows: Sequence[CellRow], speeds: Sequence[CellSpeedRow], checks: Sequence[CellCheckRow]) -> str:
    """Errors, speeds and checks of the physics-embedded CNN."""
    lines = [f"{'max |dx|, % of 1 m':42s}{'0.2 s':>10s}{'0.5 s':>10s}{'whole':>10s}{'mean':>10s}{'paper':>8s}"]
    for r in rows:
        numbers = (r.until_fifth_second, r.until_half_second, r.whole, r.mean_at_end)
        lines.append(f"{r.scene:5s} {r.run:36s}" + "".join(f"{n:10.2e}" for n in numbers) + f"{r.paper:8.3f}")
    lines.append(f"\n{'steps/s':24s}{'median':>9s}{'best':>9s}{'x simulator':>13s}{'paper':>8s}")
    lines += [
        f"{s.engine:16s}{s.dtype:8s}{s.median:9.0f}{s.best:9.0f}{s.over_simulator:13.2f}{s.paper:8.0f}" for s in speeds
    ]
    return "\n".join([*lines, "", *(f"{c.name}, {c.scene}: {c.value:.3g}" for c in checks)])
