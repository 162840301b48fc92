"""How far the cell's animations are from the simulator's: max |dx| over steps, particles and axes on the 1 m cloth."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import repeat
from typing import NamedTuple

import numpy as np

from cloth_envs.physics.particles.solver import NEIGHBOURS, ParticleSolver, net_of
from cloth_envs.state import State
from surrogates.cell.compiled import CellNet, dimensional
from training.cell.data import KNOWABLE, STEPS, case, free_vertices
from training.rollouts import replay

# The simulator's law as a cell: what a convolution, which reads the velocities before the step, can reach with it.
EXACT = {"coefficients": np.ones((len(NEIGHBOURS), 3)), "bias": np.array([0.0, 0.0, -1.0]), "eps": np.zeros(1)}
NUDGE = 1e-9  # m, the size of the disturbance that tells how chaotic an animation is


class Run(NamedTuple):
    """A checkpoint's ``arrays`` (None for the simulator), and random nudges at the start of this size [m]."""

    arrays: Mapping[str, np.ndarray] | None
    dtype: str = "float64"
    nudge: float = 0.0


class Score(NamedTuple):
    """max |dx| until 0.2 s, 0.5 s (nan where the animation ends before) and the end, mean distance at it [% of 1 m]."""

    until_fifth_second: float
    until_half_second: float
    whole: float
    mean_at_end: float


def scored(scene: str, steps: int) -> int:
    """How many of ``steps`` of an animation are scored."""
    return min(steps, KNOWABLE.get(scene, steps))


def errors(scene: str, runs: Mapping[str, Run], steps: int = STEPS) -> dict[str, Score]:
    """Every run against the simulator in float64, over the steps that are ``scored``.

    The cell's numbers are dimensionless: they serve the ball's stiffer particles as well.
    """
    given, steps = case(scene), scored(scene, steps)
    dt = net_of(given.scene).sim_dt
    stepped, free = replace(given.scene, frame_dt=dt), free_vertices(given.scene)

    def positions(run: Run, start: State) -> Iterator[np.ndarray]:
        solver: ParticleSolver = (
            ParticleSolver(stepped, dtype=run.dtype)
            if run.arrays is None
            else CellNet(stepped, dimensional(stepped, run.arrays), dtype=run.dtype)
        )
        return (state.positions for state, _ in replay(solver, start, repeat(given.controls, steps)))

    animations = {}
    for name, run in runs.items():
        start = given.start.copy()
        push = run.nudge * np.random.default_rng(1).normal(size=(1, 3, len(free)))
        start.positions.reshape(1, 3, -1)[..., free] += push
        animations[name] = positions(run, start)
    largest, gaps = [], list[np.ndarray]()
    for truth, *found in zip(positions(Run(None), given.start), *animations.values(), strict=True):
        gaps = [x - truth for x in found]
        largest.append([100 * float(abs(gap).max()) for gap in gaps])
    fifth, half = (round(t / dt) for t in (0.2, 0.5))
    means = [100 * float(np.sqrt((gap**2).sum(1)).mean()) for gap in gaps]
    return {
        run: Score(max(a[:fifth]), max(a[:half]) if steps >= half else np.nan, max(a), mean)
        for run, a, mean in zip(runs, zip(*largest, strict=True), means, strict=True)
    }
