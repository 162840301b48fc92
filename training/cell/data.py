"""What the cell of Zhao 2024 is fitted to: the author's four scenes by our simulator, and their sums of squares.

The cell's force is linear in its 39 parameters, so the loss of a whole state is a quadratic form of them, and a state
is kept as the matrix of that: gradient descent sees exactly the loss that it would see on the states.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain, repeat
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cloth_envs.physics.particles.solver import NEIGHBOURS, ParticleSolver, mass_spring_cell, net_of
from cloth_envs.physics.solver import Solver
from cloth_envs.progress import progress
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from surrogates.cell.compiled import CellNet
from training.cache import cached_arrays, digest
from training.rollouts import replay

# name -> scene and preset. The paper trains on the first two and tests on the others.
CASES = {
    "fall": ("Pressure", "zhao2024-fall"),
    "blow": ("Pressure", "zhao2024"),
    "hang": ("Hanging", "zhao2024"),
    "ball": ("BallDrop", "zhao2024"),
}
STEPS = 4811  # of an animation (the author's code)
KNOWABLE = {"hang": 640}  # steps, 0.2 s: after 0.5 s a start 1e-15 m away is off by 1.5 %
EPS = 1e-12  # m^2, of the ISRU: next to spacings of 1/128 m nothing, and it keeps 0 / 0 away


class Case(NamedTuple):
    """One animation: its scene, start and (constant) controls."""

    scene: Scene
    start: State
    controls: Controls


def case(name: str) -> Case:
    """The animation ``name`` with zero actions, in float64."""
    scene, preset = CASES[name]
    world = World(scene, preset=preset)
    world.reset({0: np.random.default_rng(0)})
    assert world.episode is not None
    return Case(world.scene, world.state.astype(np.float64), world.task.controls(world.episode))


Links = tuple[np.ndarray, np.ndarray, np.ndarray]


def links(rows: int, cols: int, vertices: np.ndarray) -> Links:
    """``vertices``, their 12 neighbours ``(12, n)`` on a grid with borders, and whether these exist, 0 or 1.

    A vertex stands for its own missing neighbours.
    """
    r, c = np.divmod(vertices, cols)
    down, right = r + NEIGHBOURS[:, :1], c + NEIGHBOURS[:, 1:]
    exists = (down >= 0) & (down < rows) & (right >= 0) & (right < cols)
    return vertices, np.where(exists, down * cols + right, vertices), exists.astype(float)


def design(x: np.ndarray, v: np.ndarray, at: Links, *, vector: bool = True) -> np.ndarray:
    """``(39, 3 n)`` of ``x``, ``v`` ``(3, N)``: the columns of alpha, beta, gamma (12 each) and the bias (3).

    These are what the branches sum (eqs 6-7), ``d``, ``n`` and ``(w . n) n``. With ``vector`` false the ISRU and the
    product are taken per component: the ablation, which knows no length of ``d``.
    """
    (own, neighbours, exists), n = at, len(at[0])
    d, w = ((a[:, neighbours] - a[:, None, own]) * exists for a in (x, v))
    if vector:
        unit = d / np.sqrt((d * d).sum(0) + EPS)
        rate = (w * unit).sum(0) * unit
    else:
        unit = d / np.sqrt(d * d + EPS)
        rate = w * unit * unit
    inner = np.stack([d, unit, rate]).swapaxes(1, 2).reshape(-1, 3 * n)
    return np.concatenate([inner, np.repeat(np.eye(3), n, axis=1)])


def accelerations(scene: Scene, state: State) -> np.ndarray:
    """What the law gives all particles, pinned ones as well, less drag and pressure, over a step: ``(3, N)`` [m/s^2].

    All of the velocities before the step, as a convolution reads them. What the simulator's loop adds, whose particles
    feel the new velocities of those before them, is no function of these: fitted to that, cells blow up.
    """
    net = net_of(scene)
    free = replace(scene, frame_dt=net.sim_dt, handles=(), grips=(), colliders=(), pressure=False)
    after = bare_step(CellNet(free, mass_spring_cell(free), dtype="float64"), state)
    return ((after.velocities * np.exp(net.drag * net.sim_dt) - state.velocities) / net.sim_dt)[0].reshape(3, -1)


def bare_step(solver: Solver, state: State, **air: np.ndarray) -> State:
    """The state after a frame of ``solver`` from the cloth of ``state``, without bodies and handles."""
    bare = replace(State.still(state.positions), velocities=state.velocities)
    solver.reset(bare)
    return solver.advance(replace(Controls.hold(bare, ()), **air))


def free_vertices(scene: Scene) -> np.ndarray:
    """Numbers of the vertices that no handle drives."""
    return np.setdiff1d(np.arange(scene.grid.vertices), np.array(scene.handles, int))


def samples(
    given: Case, steps: int, chosen: Iterable[int], vertices: int, rng: np.random.Generator
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """``x``, ``v`` before the ``chosen`` of the simulator's ``steps``, what the law adds to ``v``, all ``(3, N)``.

    And the numbers of ``vertices`` free particles, drawn anew for every one. Steps are the particles' own, in float64.
    """
    solver = ParticleSolver(replace(given.scene, frame_dt=net_of(given.scene).sim_dt), dtype="float64")
    frames = (state for state, _ in replay(solver, given.start, repeat(given.controls, steps - 1)))
    wanted, moving = set(chosen), free_vertices(given.scene)
    for step, state in enumerate(progress(chain([given.start], frames), given.scene.name, steps, unit="step")):
        if step in wanted:
            x, v = (a[0].reshape(3, -1) for a in (state.positions, state.velocities))
            yield x, v, accelerations(given.scene, state), rng.choice(moving, vertices, replace=False)


class Sums(NamedTuple):
    """Per state, ``[A; a] [A; a]^T`` ``(T, 40, 40)`` of the design ``A`` and the accelerations ``a`` [m^2/s^4].

    ``free`` over particles that move, ``pinned`` over those that do not: what moves is all that data of states show,
    forces from equations (the physics loss) are known on pinned particles too.
    """

    free: np.ndarray
    pinned: np.ndarray


def sums(name: str, states: int, vertices: int, folder: Path) -> Sums:
    """Sums of ``states`` states (at most ``STEPS``) spread over the animation ``name``, kept in ``folder``.

    ``vertices`` of the free ones are drawn anew for every state and weighted up to all.
    """
    given = case(name)
    key = digest("in place", given.scene, states, vertices, STEPS, EPS, given.start.positions)

    def make() -> dict[str, np.ndarray]:
        shape, pins = given.scene.grid.shape, np.array(given.scene.handles, int)
        share, found = (given.scene.grid.vertices - len(pins)) / vertices, list[list[np.ndarray]]()
        chosen = np.linspace(0, STEPS - 1, states).round().astype(int).tolist()
        for x, v, a, drawn in samples(given, STEPS, chosen, vertices, np.random.default_rng(0)):
            found.append([])
            for at, weight in ((links(*shape, drawn), share), (links(*shape, pins), 1.0)):
                block = np.concatenate([design(x, v, at), a[:, at[0]].reshape(1, -1)])
                found[-1].append(weight * (block @ block.T))
        free, pinned = zip(*found, strict=True)
        return {"free": np.stack(free), "pinned": np.stack(pinned)}

    return Sums(**cached_arrays(folder / f"{name}_{key}.npz", make))
