"""What is held has a size in metres: weights, springs of soft handles in every solver, what episodes remember."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cloth_envs.grid import Grid
from cloth_envs.grip import STIFFNESS, Grip, Holding, held
from cloth_envs.material import Material
from cloth_envs.physics.explicit.bounds import stable_step
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.laws.step import step
from cloth_envs.physics.solver import reference
from cloth_envs.registry import load_task
from cloth_envs.scene import Collider, Scene
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from surrogates.miniature.coarse import coarse_scene

CLOTH = Material(0.2, 300.0, 90.0, 1e-4, 5e-5, 0.0)
GRIPS = Grip((0.0, 0.0), 0.2), Grip((0.1, 0.5), 0.15, (False, False, True))


def hung(grid: Grid, grips: tuple[Grip, ...] = GRIPS, **options: object) -> Scene:
    return Scene("hung", grid, CLOTH, 0.02, handles=held(grid, grips), grips=grips, **options)  # type: ignore[arg-type]


def flat(grid: Grid) -> State:
    """A cloth that lies level."""
    r, c = np.indices(grid.shape)
    return State.still(np.stack([c * grid.col_spacing, -r * grid.row_spacing, 0.0 * r])[None])


def carried(scene: Scene, state: State) -> Controls:
    """Every grip is carried 2 cm aside and up, and moves on."""
    controls = Controls.hold(state, scene.handles)
    controls.handle_positions += [0.0, 0.02, 0.01]
    controls.handle_velocities += [0.0, 1.0, 0.5]
    return controls


def held_size(grid: Grid, grip: Grip) -> float:
    """Side [m] of the square that has the held area."""
    areas = grid.areas.ravel()
    return float(np.sqrt(sum(t * areas[v] for v, t in grip.weights(grid).items())))


def max_strain(grid: Grid, x: np.ndarray) -> float:
    """Of rows' and columns' edges."""
    down, along = (np.linalg.norm(np.diff(x[0], axis=axis), axis=0) for axis in (1, 2))
    return float(max(down.max() / grid.row_spacing, along.max() / grid.col_spacing)) - 1


@pytest.mark.parametrize("scene", ["Hanging", "Collision", "Curtain"])
def test_what_is_held_has_the_same_size_on_every_grid(scene: str) -> None:
    """The lead is firm with its whole share of the sheet, so a grid of twice the radius holds a little more."""
    world = World(scene)
    grip, grid = world.scene.grips[0], world.scene.grid
    exact = np.sqrt(np.pi * grip.radius**2 / 12)  # a quarter of a cone, in a corner
    for times in (1, 2, 4):
        finer = replace(grid, rows=times * (grid.rows - 1) + 1, cols=times * (grid.cols - 1) + 1)
        assert abs(held_size(finer, grip) - exact) < 1e-3
    for factor in (2, 4):
        coarse, _ = coarse_scene(world.scene, factor, CLOTH)
        assert abs(held_size(coarse.grid, grip) - exact) < 0.5 * max(coarse.grid.row_spacing, coarse.grid.col_spacing)


def test_a_grip_weighs_its_vertices_by_their_share_of_the_sheet() -> None:
    for middle, grid in (((0.0, 0.0), Grid(41, 41, 1.0, 1.0)), ((0.3, 0.52), Grid(23, 57, 0.9, 1.0))):
        grip = Grip(middle, 0.2)
        weights = grip.weights(grid)
        lead, *others = weights
        places = {v: (v // grid.cols * grid.row_spacing, v % grid.cols * grid.col_spacing) for v in weights}
        away = {v: np.hypot(*np.subtract(place, middle)) for v, place in places.items()}
        assert weights[lead] == 1.0
        assert away[lead] == min(away.values())
        assert all(0 < weights[v] < 1 for v in others)
        for v in others:  # the cone's mean over a cell away from tip and edge differs by d^2 / (12 r R), d the spacing
            if 0.3 * grip.radius < away[v] < 0.7 * grip.radius and places[v][0] > 0 and places[v][1] > 0:
                assert abs(weights[v] - (1 - away[v] / grip.radius)) < grid.diagonal**2 / (12 * away[v] * grip.radius)


def test_handles_beside_grips_are_firm_and_a_vertex_in_two_follows_the_one_that_holds_it_more() -> None:
    grid = Grid(5, 9, 0.4, 0.8)
    grips = Grip((0.0, 0.0), 0.25), Grip((0.0, 0.4), 0.35)
    handles = (*held(grid, grips), 40)
    holding = Holding.of(grid, handles, grips)
    number = {v: i for i, v in enumerate(handles)}
    np.testing.assert_array_equal(np.flatnonzero(holding.firm), sorted(number[v] for v in (0, 4, 40)))
    assert holding.lead[number[40]] == number[40]
    both = [v for v in grips[0].weights(grid) if v in grips[1].weights(grid) and v not in (0, 4)]
    assert both
    for v in both:
        mine = max(range(2), key=lambda k: grips[k].weights(grid)[v])
        t = grips[mine].weights(grid)[v]
        assert holding.lead[number[v]] == number[(0, 4)[mine]]
        assert_allclose(holding.hold[number[v]], STIFFNESS * t / (1 - t) ** 2 / grips[mine].radius ** 2)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_the_kernel_holds_softly_as_its_twin_does(dtype: str) -> None:
    grid = Grid(9, 11, 0.6, 0.8)
    scene = hung(grid, colliders=(Collider("sphere", 0.1),))
    state = flat(grid)
    state.positions += 1e-3 * np.random.default_rng(0).normal(size=state.positions.shape)
    state.colliders = np.tile([0.1, -0.1, 0.1], (1, 1, 2, 1))
    state.collider_velocities = np.zeros((1, 1, 2, 3))
    controls = carried(scene, state)
    solver = ExplicitSolver(scene, dtype=dtype)
    solver.reset(state)
    got, want = solver.advance(controls), step(scene, state, controls, solver.last_cuts)
    bound = 1e4 * float(np.finfo(dtype).eps)  # as in test_kernel_twin
    assert_allclose(got.positions, want.positions, rtol=0, atol=bound)
    assert_allclose(got.velocities, want.velocities, rtol=0, atol=100 * bound)
    soft = np.array(scene.handles)[~scene.holding.firm]
    free = step(replace(scene, handles=scene.pins, grips=()), state, Controls.hold(state, scene.pins), solver.last_cuts)
    moved = abs(want.positions - free.positions).reshape(3, -1)[:, soft]
    assert moved.max() > 1e-3


@pytest.mark.parametrize("stiffness", [0.1, 1e3, 1e12])
def test_soft_handles_are_stable_however_stiff(stiffness: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """At the largest stable step of the free cloth: the spring is implicit, so it asks for no smaller one."""
    monkeypatch.setattr("cloth_envs.grip.STIFFNESS", stiffness)
    grid = Grid(9, 11, 0.6, 0.8)
    cloth = CLOTH.with_changes(damping=0.0)
    scene = replace(hung(grid, gravity=0.0), material=cloth)
    state = flat(grid)
    state.velocities += np.random.default_rng(0).normal(size=state.positions.shape)
    state.velocities.reshape(3, -1)[:, list(scene.pins)] = 0.0
    solver = ExplicitSolver(scene, dtype="float64", substeps=int(np.ceil(0.02 / stable_step(scene, cloth))))
    solver.reset(state)
    controls = Controls.hold(state, scene.handles)
    kinetic = [float((scene.mass * np.square(solver.advance(controls).velocities)).sum()) / 2 for _ in range(200)]
    start = float((scene.mass * np.square(state.velocities)).sum()) / 2
    assert max(kinetic) < 1.05 * start  # symplectic Euler's energy oscillates by a few percent


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_velocities_of_soft_handles_are_how_they_move(dtype: str) -> None:
    """Their springs carry the cloth; without their half kick what they carry would be told as ``F h / (2 m)``."""
    grid = Grid(9, 11, 0.6, 0.8)
    scene = replace(hung(grid), material=CLOTH.with_changes(drag=20.0))
    solver = ExplicitSolver(scene, dtype=dtype)
    solver.reset(flat(grid))
    controls = Controls.hold(solver.state, scene.handles)
    for _ in range(100):
        before = solver.state.positions
        state = solver.advance(controls)
    moved = (state.positions - before) / scene.frame_dt
    found, want = (field.reshape(3, -1)[:, scene.handles] for field in (state.velocities, moved))
    assert abs(found - want).max() < 0.005


@pytest.mark.parametrize(
    ("solver", "steps", "options"),
    [
        ("explicit", "refine", {"refine": 4}),
        ("implicit", "substeps", {"substeps": 32, "tolerance": 1e-4}),
        ("admm", "substeps", {"substeps": 32, "iterations": 40}),
    ],
)
def test_all_solvers_hold_alike(solver: str, steps: str, options: dict[str, float]) -> None:
    """Each is of order 1: half the step halves how far it is from a scheme of order 2 at small steps."""
    grid = Grid(9, 11, 0.6, 0.8)
    scene = hung(grid)
    state = flat(grid)
    controls = carried(scene, state)

    def end(**kwargs: object) -> np.ndarray:
        backend = reference(scene, dtype="float64", **kwargs)  # type: ignore[arg-type]
        backend.reset(state)
        for _ in range(2):
            backend.advance(controls)
        return backend.state.positions.reshape(3, -1)[:, list(scene.handles)] - controls.handle_positions[0].T

    want = end(solver="implicit", scheme="sdirk2", substeps=64, tolerance=1e-5)
    size = abs(want).max()
    assert size > 0.01  # m, by which they give way
    coarse, fine = (
        abs(end(solver=solver, **options | {steps: times * options[steps]}) - want).max() / size for times in (1, 2)
    )
    assert 0.02 < coarse < 0.15
    assert fine < 0.65 * coarse  # h^2 / h adds to 1/2


def test_a_step_of_any_solver_draws_a_soft_vertex_as_its_spring_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """One implicit Euler step of a sheet without stiffness: ``e = h^2 k / (m + h^2 k) (path - x)``."""
    monkeypatch.setattr("cloth_envs.grip.STIFFNESS", 1e12)  # times the sheet's next to none
    grid = Grid(9, 11, 0.6, 0.8)
    slack = Material(0.2, 1e-9, 0.0, 0.0, 0.0, 0.0)
    scene = replace(hung(grid, gravity=0.0), material=slack, frame_dt=0.01)
    state = flat(grid)
    controls = Controls.hold(state, scene.handles)
    controls.handle_positions += [0.0, 0.0, 0.01]
    for solver in ("explicit", "admm", "implicit"):
        backend = reference(scene, dtype="float64", solver=solver, substeps=1)
        backend.reset(state)
        moved = backend.advance(controls).positions[0, 2].ravel()[list(scene.handles)]
        mass = scene.mass.ravel()[list(scene.handles)]
        pull = 1e-4 * scene.grip_stiffness(slack)[:, 2]
        share = 1 / (1 + mass / pull)
        assert 0.1 < np.median(share) < 0.99
        assert_allclose(moved, 0.01 * share, rtol=5e-3, atol=1e-12)


@pytest.mark.parametrize("scene", ["Hanging", "Collision", "Curtain"])
def test_grips_keep_their_shape_over_an_episode_and_its_copies(scene: str) -> None:
    """Where soft handles are drawn to is their way from the lead at the episode's start, whatever the cloth does."""
    world = World(scene, num_envs=2)
    world.reset({i: np.random.default_rng(i) for i in range(2)})
    lead = world.scene.holding.lead
    start = world.state.positions.reshape(2, 3, -1)[:, :, world.task.handles].transpose(0, 2, 1).astype(float)
    ways = start - start[:, lead]
    assert abs(ways).max() > 0.01
    actions = np.random.default_rng(0).uniform(-1, 1, (6, 2, len(world.task.actions)))
    for action in actions[:5]:
        world.step(action)
    twin, other = copy.deepcopy(world), World(scene, num_envs=2)
    other.set_state(world.get_state())
    worlds = world, twin, other
    for one in worlds:
        at = one.task.controls(one.episode).handle_positions
        assert_allclose(at - at[:, lead], ways, rtol=0, atol=1e-12)
        one.step(actions[5])
    np.testing.assert_array_equal(twin.state.positions, world.state.positions)
    np.testing.assert_array_equal(other.state.positions, world.state.positions)


def test_new_positions_are_gripped_anew() -> None:
    world = World("Hanging")
    world.reset({0: np.random.default_rng(0)})
    r, c = np.indices(world.scene.grid.shape)
    grid = world.scene.grid
    world.set_positions(np.stack([0.0 * r, c * grid.col_spacing, -r * grid.row_spacing]))
    at = world.task.controls(world.episode).handle_positions[0]
    assert_allclose(at[:, 0], 0.0, atol=1e-7)  # in the plane that the cloth was put into


def test_the_description_tells_what_is_held_by_its_size() -> None:
    assert "7 grips of 3 cm around" in World("Curtain").scene.describe()
    assert "33 handles" in World("Flag").scene.describe()


@pytest.mark.parametrize(("name", "size"), [("Hanging", (33, 33)), ("Curtain", (73, 49))])
def test_the_largest_strain_hardly_grows_on_a_finer_grid(name: str, size: tuple[int, int]) -> None:
    """By less than 1.4, a sharp edge's ``r^-1/2``; a curtain on single vertices had 1.9 times as much."""
    largest = []
    for rows, cols in (size, (2 * size[0] - 1, 2 * size[1] - 1)):
        task = load_task(name)
        scene = task.make_scene(resolution=(rows, cols), material=task.material.with_changes(drag=6.0))
        state = State.still(task(scene).start(np.random.default_rng(3)).positions[None].astype(np.float32))
        solver = ExplicitSolver(scene)
        solver.reset(state)
        controls = Controls.hold(state, scene.handles)
        for _ in range(round(1.2 / scene.frame_dt)):
            solver.advance(controls)
        largest.append(max_strain(scene.grid, solver.state.positions))
    assert 0.005 < largest[0] < 0.05  # it hangs
    assert largest[1] < 1.4 * largest[0]
