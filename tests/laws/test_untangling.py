"""What crosses at a frame's start comes apart, with momentum kept, and is told."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from test_layers import strip
from worlds import run

import cloth_envs
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.laws.diagnostics import linear_momentum, strains
from cloth_envs.scene import Scene, SelfContact
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from training.metrics.contact import crossing_triangles

SCENE = Scene("free", Grid(9, 31, 0.16, 0.6), Material(), 0.02, gravity=0.0, self_contact=SelfContact())


def through(*, corner: bool = False) -> State:
    """A folded strip whose upper half goes through the lower one with its end, or with a corner of it."""
    positions = strip(SCENE.grid, 2)
    row, col = np.indices(SCENE.grid.shape) / np.reshape(SCENE.grid.shape, (2, 1, 1))
    along = np.clip(2 * col - 1, 0, 1) * (row if corner else 1)
    positions[0, 2] -= 0.08 * along
    return State.still(positions)


def crossing(states: list[State]) -> list[int]:
    return [int(crossing_triangles(SCENE.grid, state.positions)[0]) for state in states]


@pytest.mark.parametrize("corner", [False, True])
def test_strips_pushed_through_each_other_come_apart(corner: bool) -> None:
    states, _ = run(SCENE, through(corner=corner), frames=50)
    pairs = crossing(states)
    assert pairs[0] > 5
    assert pairs[-10:] == [0] * 10
    assert max(strains(SCENE.grid, state.positions).max() for state in states[1:]) < 0.2
    moving = max(float((SCENE.mass * np.linalg.norm(state.velocities[0], axis=0)).sum()) for state in states)
    momenta = np.array([linear_momentum(SCENE, state)[0] for state in states])
    assert moving > 1e-3
    assert abs(momenta).max() <= 1e-12 * moving
    middles = np.array([(SCENE.mass * state.positions).sum((0, 2, 3)) for state in states]) / SCENE.mass.sum()
    assert abs(middles - middles[0]).max() <= 1e-12  # what is displaced is, too


def test_what_is_held_stays() -> None:
    scene = replace(SCENE, handles=(0, 30, 8 * 31))
    states, _ = run(scene, through(), frames=50)
    assert crossing(states)[-1] == 0
    held = np.array([state.positions.reshape(3, -1)[:, list(scene.handles)] for state in states])
    assert abs(held - held[0]).max() <= 1e-15


def test_a_cloth_beside_a_tangled_one_does_not_feel_it() -> None:
    start = State.still(np.concatenate([through().positions, strip(SCENE.grid, 2), through(corner=True).positions]))

    def ends(which: list[int], threads: int) -> tuple[np.ndarray, np.ndarray]:
        backend = ExplicitSolver(SCENE, num_envs=len(which), threads=threads)
        backend.reset(start.select(which))
        for _ in range(3):
            backend.advance(Controls.hold(backend.state, SCENE.handles))
        return backend.state.positions, backend.crossings

    together, crossings = ends([0, 1, 2], 1)
    assert [bool(pairs) for pairs in crossings] == [True, False, True]
    assert (ends([0, 1, 2], 2)[0] == together).all()
    for member in (0, 1, 2, 1):
        assert (ends([member], 1)[0][0] == together[member]).all()


def test_a_tangled_cloth_is_free_within_a_second() -> None:
    tangled = World("Hanging", self_contact=False)
    tangled.reset({0: np.random.default_rng(200)})
    for _ in range(100):
        tangled.step(np.zeros((1, *tangled.action_space.shape)))
    env = gym.make(cloth_envs.env_id("Hanging"), self_contact=True).unwrapped
    env.reset(seed=200)
    env.set_positions(tangled.state.positions[0], tangled.state.velocities[0])  # type: ignore[attr-defined]
    grid, still, seen = env.scene.grid, np.zeros(env.action_space.shape, np.float32), []  # type: ignore[attr-defined]
    for _ in range(50):
        before = int(crossing_triangles(grid, env.state.positions)[0])  # type: ignore[attr-defined]
        *_, terminated, _, info = env.step(still)
        seen.append((before, info.get("crossings_at_start", 0), terminated))
    counted, told, ended = zip(*seen, strict=True)
    assert counted[0] > 100
    assert counted == told
    assert counted[-1] == 0
    assert not any(ended)


def test_vector_environments_tell_of_each_member() -> None:
    envs = gym.make_vec(cloth_envs.env_id("Hanging"), num_envs=2, resolution=SCENE.grid.shape, self_contact=True)
    envs.reset(seed=0)
    still = np.zeros(envs.action_space.shape, np.float32)
    assert "crossings_at_start" not in envs.step(still)[4]
    grid = envs.unwrapped.scene.grid
    envs.unwrapped.world.set_positions(_folded_through(grid), which=1)
    infos = envs.step(still)[4]
    assert infos["crossings_at_start"][0] == 0 < infos["crossings_at_start"][1]
    assert infos["_crossings_at_start"].tolist() == [False, True]
    envs.close()


def _folded_through(grid: Grid) -> np.ndarray:
    """Two upright halves of a cloth ``(3, H, W)`` that lean through each other."""
    row, col = np.indices(grid.shape)
    side = np.where(2 * col < grid.cols, 1, -1)
    x = side * (col - (grid.cols - 1) / 2) * grid.col_spacing / 2
    return np.stack([x, side * (0.11 * grid.width + x), 1 + (row + 0.2 * side) * grid.row_spacing])
