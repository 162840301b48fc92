"""How far the cell's animations are from the simulator's: max |dx| over steps, particles and axes on the 1 m cloth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cloth_envs.physics.particles.solver import mass_spring_cell, net_of
from surrogates.cell.compiled import CellNet, dimensional
from training.physics_cnn_data import STEPS, case

NUDGE = 1e-9  # m, the size of the disturbance that tells how chaotic an animation is


class Run(NamedTuple):
    """A checkpoint's ``arrays`` (None for the simulator's own law), and random nudges at the start of this size [m]."""

    arrays: Mapping[str, np.ndarray] | None
    dtype: str = "float64"
    nudge: float = 0.0


class Error(NamedTuple):
    """In % of a metre: the largest |dx| until 0.25 s, 0.5 s and the end; and the mean distance at the end."""

    quarter: float
    half: float
    end: float
    mean: float


def errors(name: str, runs: Mapping[str, Run], steps: int = STEPS) -> dict[str, Error]:
    """Every run against the simulator in float64, in step.

    The cell's numbers are dimensionless: they serve the ball's stiffer particles as well.
    """
    given = case(name)
    dt, law = net_of(given.scene).sim_dt, mass_spring_cell(given.scene)
    scene = replace(given.scene, frame_dt=dt)
    truth = CellNet(scene, law, dtype="float64")
    truth.reset(given.start)
    solvers: dict[str, CellNet] = {}
    for run, (arrays, dtype, nudge) in runs.items():
        solvers[run] = CellNet(scene, law if arrays is None else dimensional(scene, arrays), dtype=dtype)
        start = given.start.copy()
        free = np.setdiff1d(np.arange(scene.grid.vertices), np.array(scene.handles, int))
        push = nudge * np.random.default_rng(1).normal(size=(1, 3, len(free)))
        start.positions.reshape(1, 3, -1)[..., free] += push
        solvers[run].reset(start)
    largest = {run: np.zeros(steps) for run in runs}
    mean: dict[str, float] = {}
    for step in range(steps):
        want = truth.advance(given.controls).positions
        for run, solver in solvers.items():
            gap = solver.advance(given.controls).positions - want
            largest[run][step] = abs(gap).max()
            if step == steps - 1:
                mean[run] = float(np.sqrt((gap**2).sum(1)).mean())
    quarter, half = (min(steps, round(t / dt)) for t in (0.25, 0.5))

    def percent(run: str) -> Error:
        first, second, third = (100 * float(largest[run][:end].max()) for end in (quarter, half, steps))
        return Error(first, second, third, 100 * mean[run])

    return {run: percent(run) for run in runs}
