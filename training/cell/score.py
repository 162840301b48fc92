"""How far the cell's animations are from the simulator's: max |dx| over steps, particles and axes on the 1 m cloth."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import repeat
from typing import NamedTuple

import numpy as np

from cloth_envs.physics.particles.solver import Cell, mass_spring_cell, net_of
from cloth_envs.state import State
from surrogates.cell.compiled import CellNet, dimensional
from training.cell.data import STEPS, case, free_vertices
from training.rollouts import replay

NUDGE = 1e-9  # m, the size of the disturbance that tells how chaotic an animation is


class Run(NamedTuple):
    """A checkpoint's ``arrays`` (None for the simulator's own law), and random nudges at the start of this size [m]."""

    arrays: Mapping[str, np.ndarray] | None
    dtype: str = "float64"
    nudge: float = 0.0


def errors(name: str, runs: Mapping[str, Run], steps: int = STEPS) -> dict[str, tuple[float, float, float, float]]:
    """Every run against the simulator in float64: |dx| until 0.25 s, 0.5 s and the end, mean distance [% of 1 m].

    The cell's numbers are dimensionless: they serve the ball's stiffer particles as well.
    """
    given = case(name)
    dt, law = net_of(given.scene).sim_dt, mass_spring_cell(given.scene)
    scene, free = replace(given.scene, frame_dt=dt), free_vertices(given.scene)

    def positions(law: Cell, dtype: str, start: State) -> Iterator[np.ndarray]:
        solver = CellNet(scene, law, dtype=dtype)
        return (state.positions for state, _ in replay(solver, start, repeat(given.controls, steps)))

    animations = {}
    for run, (arrays, dtype, nudge) in runs.items():
        start = given.start.copy()
        push = nudge * np.random.default_rng(1).normal(size=(1, 3, len(free)))
        start.positions.reshape(1, 3, -1)[..., free] += push
        animations[run] = positions(law if arrays is None else dimensional(scene, arrays), dtype, start)
    largest, gaps = [], list[np.ndarray]()
    for truth, *found in zip(positions(law, "float64", given.start), *animations.values(), strict=True):
        gaps = [x - truth for x in found]
        largest.append([float(abs(gap).max()) for gap in gaps])
    quarter, half = (min(steps, round(t / dt)) for t in (0.25, 0.5))
    means = [float(np.sqrt((gap**2).sum(1)).mean()) for gap in gaps]
    told = zip(runs, zip(*largest, strict=True), means, strict=True)
    return {run: (100 * max(a[:quarter]), 100 * max(a[:half]), 100 * max(a), 100 * mean) for run, a, mean in told}
