"""Contact of the cloth with itself: its NumPy twin, conservation, friction, piles at rest, folds that open."""

from dataclasses import replace

import numpy as np
import pytest
from worlds import G, run, simulate

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.laws import self_contact as twin
from cloth_envs.physics.laws.diagnostics import angular_momentum, energy, linear_momentum
from cloth_envs.scene import Collider, Scene, SelfContact
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from training.metrics.contact import crossing_triangles

LOOSE = Material(0.2, 1e-12, 0.0, 0.0, damping=0.0)  # vertices that hold each other in no way
LAYER, MU, FLOOR = 0.0025, 0.3, np.array([[[[0, 0, 0], [0, 0, 1.0]]]])
SEEDS = {1: (35, 36, 148, 192), 2: (2, 114)}  # pairs are due that have no vertex in common


def strip(grid: Grid, layers: int, z: float = 0.0) -> np.ndarray:
    """Vertices ``(1, 3, H, W)`` of a strip along x in level layers two spacings apart; turns are half a hexagon."""
    straight = (grid.cols - 1 - 3 * (layers - 1)) // layers
    angles = [0.0] * straight
    for layer in range(1, layers):
        turn = np.array([np.pi / 6, np.pi / 2, 5 * np.pi / 6, *[np.pi] * straight])
        angles += [*turn] if layer % 2 else [*(np.pi - turn)]
    angles += angles[-1:] * (grid.cols - 1 - len(angles))
    x, up = (grid.col_spacing * np.append(0, np.cumsum(part)) for part in (np.cos(angles), np.sin(angles)))
    y = -grid.row_spacing * np.arange(grid.rows)[:, None]
    return np.stack([x + 0 * y, y + 0 * x, z + up + 0 * y])[None]


def colliding(friction: float, damping: float, dtype: str = "float64") -> tuple[Scene, list[State]]:
    """A free strip whose halves fly at each other at 2 m/s and slide on each other."""
    grid = Grid(6, 31, 0.1, 0.6)
    scene = Scene("free", grid, Material(damping=damping), 0.01, gravity=0.0, self_contact=SelfContact(0.004, friction))
    state = State.still(strip(grid, 2))
    side = np.sign(state.positions[0, 2] - state.positions[0, 2].mean())
    state.velocities[0] = np.stack([0.3 * side + 0.1, 0 * side, -side])
    return scene, run(scene, state, frames=60, dtype=dtype)[0]


@pytest.mark.parametrize("substeps", [1, 2])
def test_a_step_is_that_of_the_twin(substeps: int) -> None:
    grid, h = Grid(5, 9, 0.08, 0.16), 2e-3
    own = SelfContact(0.004, 0.4)
    scene = Scene("twin", grid, LOOSE, substeps * h, handles=(0,), gravity=0.0, self_contact=own)
    row, col = np.indices(grid.shape)
    up, seen = col > 4, np.zeros(2, int)
    laid = np.stack([0.02 * np.where(up, 8.35 - col, col), -0.02 * (row + 0.2 * up), 0.012 * up])
    for seed in SEEDS[substeps]:
        rng = np.random.default_rng(seed)
        noise = rng.normal(size=(2, 3, *grid.shape)) * [[[[1.0]], [[1.0]], [[2.2]]], [[[200.0]], [[200.0]], [[1000.0]]]]
        state = State.still(laid[None] + 1e-3 * noise[:1])
        state.velocities[:] = 1e-3 * noise[1]
        told = simulate(scene, state, substeps=substeps)
        x, v = (field.reshape(3, -1).T.copy() for field in (state.positions, state.velocities))
        v[0], contact = 0, twin.SelfContact(scene, h)
        for _ in range(substeps):
            x += h * v
            due = contact.step(x, v)
            seen += [len(pairs) for pairs in due]
            used = np.concatenate(due).ravel()
            assert len(used) == len(set(used.tolist()))  # in whatever order
        assert abs(told.positions.reshape(3, -1).T - x).max() <= 1e-14
        assert abs(told.velocities.reshape(3, -1).T - v).max() <= 1e-10
    assert (seen > 0).all()


@pytest.mark.parametrize("friction", [0.0, MU])
def test_momentum_is_kept(friction: float) -> None:
    scene, states = colliding(friction, 0.0)
    flying = float((scene.mass * np.linalg.norm(states[0].velocities[0], axis=0)).sum())
    momenta = np.array([linear_momentum(scene, state)[0] for state in states])
    assert abs(momenta - momenta[0]).max() <= 1e-13 * flying
    # Layers rub a layer apart, and nothing turns the cloth back; without friction it is the step's error.
    turning = np.array(
        [angular_momentum(scene, state, about=states[0].positions.mean((0, 2, 3)))[0] for state in states]
    )
    assert abs(turning - turning[0]).max() <= (0.3 * 0.004 if friction else 1e-4) * flying
    assert not any(crossing_triangles(scene.grid, state.positions)[0] for state in states)


@pytest.mark.parametrize("friction", [0.0, MU])
def test_energy_never_grows(friction: float) -> None:
    scene, states = colliding(friction, 5e-5)
    sums = np.array([energy(scene, state).mechanical[0] for state in states])
    assert (np.diff(sums) < 0).all()
    assert sums[-1] < 0.15 * sums[0]
    assert not any(crossing_triangles(scene.grid, state.positions)[0] for state in states)


def piled(spacing: float, layers: int) -> tuple[Scene, State, int]:
    """A strip in layers of 12 cm above the floor, which fall on it; cells of a layer and a turn."""
    straight = round(0.12 / spacing)
    cols = layers * straight + 3 * (layers - 1) + 1
    grid = Grid(5, cols, 4 * spacing, (cols - 1) * spacing)
    cloth, floor = Material(0.2, 200.0, 60.0, 2e-6, drag=2.0), Collider("plane", friction=MU)
    own = SelfContact(LAYER, MU)
    scene = Scene("pile", grid, cloth, 0.02, colliders=(floor,), thickness=LAYER, self_contact=own)
    return scene, State.still(strip(grid, layers, LAYER), FLOOR), straight + 3


@pytest.mark.parametrize("spacing", [0.01, 0.04 / 3, 0.02])
@pytest.mark.parametrize("layers", [2, 4])
def test_layers_lie_a_layer_apart(layers: int, spacing: float) -> None:
    scene, state, cells = piled(spacing, layers)
    states, _ = run(scene, state, frames=75)
    assert scene.layer == LAYER
    middle = [cells * layer + (cells - 3) // 2 for layer in range(layers)]
    for now in states[-5:]:  # weight is carried
        heights = now.positions[0, 2, 1:-1][:, middle].mean(0) / LAYER
        assert abs(np.diff(np.append(0, heights)) - 1).max() < 0.1
        assert crossing_triangles(scene.grid, now.positions)[0] == 0


def test_a_layer_at_rest_hardly_creeps() -> None:
    """On a layer that is held; the turn pulls at it. 0.4 mm/s: pairs at rest are looked at every few steps only."""
    scene, state, cells = piled(0.02, 2)
    held = tuple(np.arange(scene.grid.vertices).reshape(scene.grid.shape)[:, : cells - 2].ravel().tolist())
    states, _ = run(replace(scene, handles=held), state, frames=150)
    early, late = (now.positions[0][:, :, cells:].mean((1, 2)) for now in (states[100], states[-1]))
    assert np.linalg.norm(late - early) < 0.25 * LAYER  # in a second
    assert late[2] == pytest.approx(2 * LAYER, rel=0.05)


@pytest.mark.parametrize("friction", [0.3, 0.6])
def test_a_layer_that_slides_on_another_is_stopped_by_mu_g(friction: float) -> None:
    """Cloth without any forces of its own, so that the fold does not pull; the lower layer sticks to the floor."""
    grid, thick, speed = Grid(9, 17, 0.16, 0.32), 0.004, 0.3
    floor, own = Collider("plane", friction=50.0), SelfContact(thick, friction)
    scene = Scene("slide", grid, LOOSE, 0.01, colliders=(floor,), thickness=thick, self_contact=own)
    row, col = np.indices(grid.shape)
    upper = col > 9
    x = np.stack([0.02 * np.where(upper, 18.4 - col, col), -0.02 * (row + 0.3 * upper), thick * (1.0 + upper)])[None]
    state = State.still(x, FLOOR)
    state.velocities[0, 0][upper] = -speed
    states, _ = run(scene, state, frames=20, substeps=30)
    way = np.array([(state.positions - now.positions)[0, 0][upper].mean() for now in states])
    assert way[-1] == pytest.approx(speed**2 / (2 * friction * G), rel=0.15)
    assert way[-1] - way[-5] < 1e-4
    assert 1.8 * thick < states[-1].positions[0, 2][upper].mean() < 2.2 * thick


@pytest.mark.parametrize("bending", [0.0, 1e-3])
def test_a_fold_opens_by_bending_and_not_by_contact(bending: float) -> None:
    layer, grid, arm = 0.004, Grid(5, 26, 0.08, 0.5), 12
    own = SelfContact(layer, 0.0)
    scene = Scene("fold", grid, Material(bend_stiffness=bending, drag=1.0), 0.01, gravity=0.0, self_contact=own)
    tilt, col = np.arcsin((grid.col_spacing - 0.75 * layer) / 2 / (arm * grid.col_spacing)), np.arange(26)
    out = grid.col_spacing * np.minimum(col, 25 - col)  # from the ends, which are pressed together
    y = -grid.row_spacing * np.arange(5)[:, None]
    up = np.where(col < 13, -1, 1) * (0.375 * layer + out * np.sin(tilt))
    states, _ = run(
        scene, State.still(np.stack([out * np.cos(tilt) + 0 * y, y + 0 * out, up + 0 * y])[None]), frames=20
    )
    gap = [float((now.positions[0, 2, :, -1] - now.positions[0, 2, :, 0]).mean()) / layer for now in states]
    assert gap[0] == pytest.approx(0.75)
    assert gap[-1] > 50 if bending else 0.95 < gap[5] < gap[-1] < 1.1


def test_bits_are_those_of_any_batch_threads_and_start() -> None:
    scene, state, _ = piled(0.02, 2)
    rng = np.random.default_rng(0)
    many = State.still(np.repeat(state.positions, 16, 0), np.repeat(FLOOR, 16, 0))
    many.velocities[:] = 0.3 * rng.normal(size=(16, 3, 1, 1)) + 0.1 * rng.normal(size=many.velocities.shape)
    for dtype in ("float32", "float64"):
        told = None
        for size, threads in ((16, 1), (16, 2), (2, 1), (1, 1)):
            here = many.select(slice(0, size))
            backend = ExplicitSolver(scene, num_envs=size, threads=threads, dtype=dtype)
            backend.reset(here)
            for _ in range(20):
                now = backend.advance(Controls.hold(here, ()))
            told = now.copy() if told is None else told
            assert np.array_equal(now.positions, told.positions[:size])
            assert np.array_equal(now.velocities, told.velocities[:size])
        loose = simulate(replace(scene, self_contact=None), here, frames=20, dtype=dtype)
        assert abs(loose.positions - told.positions[:1]).max() > 1e-3  # contact did something


def test_float32_is_float64_until_chaos() -> None:
    # Halves meet in the second frame. The third, which squeezes them, is chaos in float64 too: starts 1e-8 m apart part
    # by 5 um (median of 32, at most 9), float32 by 7-14 um.
    double, single = (colliding(MU, 5e-5, dtype)[1][:3] for dtype in ("float64", "float32"))
    far = [float(abs(a.positions - b.positions).max()) for a, b in zip(double, single, strict=True)]
    free = run(replace(colliding(MU, 5e-5)[0], self_contact=None), double[0], frames=2)[0][-1]
    assert max(far) < 3e-7 < 3000 * 3e-7 < abs(free.positions - double[2].positions).max()


def play(world: World, frames: int) -> list[int]:
    """Pairs that cross after each frame."""
    still = np.zeros((1, len(world.task.actions)))
    counts = []
    for _ in range(frames):
        world.step(still)
        counts.append(int(crossing_triangles(world.scene.grid, world.state.positions)[0]))
    return counts


def test_a_restored_world_goes_on_by_the_same_bits() -> None:
    worlds = [World("BallDrop", resolution=(17, 17), self_contact=True) for _ in range(2)]
    for seed, world in enumerate(worlds):
        world.reset({0: np.random.default_rng(seed)})
    play(worlds[0], 50)
    worlds[1].set_state(worlds[0].get_state())
    ends = [(play(world, 15), world.state.positions) for world in worlds]
    assert np.array_equal(ends[0][1], ends[1][1])
    assert ends[0][0] == 15 * [0]


@pytest.mark.parametrize("name", ["Hanging", "BallDrop"])
def test_no_triangles_cross(name: str) -> None:
    worst = {}
    for on in (True, False):
        world = World(name, resolution=(33, 33), self_contact=on)
        world.reset({0: np.random.default_rng(0)})
        worst[on] = max(play(world, 100))
    assert worst[True] == 0
    assert worst[False] > 100
