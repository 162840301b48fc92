"""P-ADMM: its steps against a NumPy twin, what it converges to, and the laws of contact."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import gymnasium as gym
import numpy as np
import pytest
from scipy.optimize import minimize

import cloth_envs  # noqa: F401
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.admm.solver import WEIGHT, AdmmSolver, eigenvalues, modes
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.implicit.prefactored import bending_matrix, spring_laplacian
from cloth_envs.physics.laws.air import pressure_forces
from cloth_envs.physics.laws.sheet import kinetic_energy
from cloth_envs.physics.laws.stencil import edges, triples
from cloth_envs.physics.solver import Solver
from cloth_envs.registry import SCENES
from cloth_envs.scene import Air, Collider, Scene
from cloth_envs.state import Controls, State

G = 9.81
CLOTH = Material(0.2, 500.0, 150.0, 1e-3, 5e-4, 0.5)
GRIDS = {
    "odd": Grid(7, 5, 0.5, 0.4),
    "even": Grid(6, 8, 0.3, 0.6),
    "smallest": Grid(3, 3, 0.2, 0.3),
    "tube": Grid(5, 7, 0.4, 0.6, periodic=True),
    "even tube": Grid(4, 8, 0.4, 0.6, periodic=True),
}


def flat(grid: Grid) -> np.ndarray:
    """Positions of a flat sheet, or of a tube, ``(1, 3, H, W)``."""
    r, c = np.indices(grid.shape)
    if not grid.periodic:
        return np.stack([c * grid.col_spacing, -r * grid.row_spacing, 0.0 * r])[None]
    angle = 2 * np.pi / grid.cols
    radius = grid.col_spacing / (2 * np.sin(angle / 2))
    return np.stack([radius * np.cos(angle * c), radius * np.sin(angle * c), -grid.row_spacing * r])[None]


def shaken(grid: Grid, amount: float = 0.2, speed: float = 1.0) -> State:
    """A sheet with random displacements of ``amount`` spacings and random velocities [m/s]."""
    rng = np.random.default_rng(1)
    x = flat(grid)
    state = State.still(x + amount * min(grid.row_spacing, grid.col_spacing) * rng.normal(size=x.shape))
    state.velocities[:] = speed * rng.normal(size=x.shape)
    return state


def run(solver: Solver, state: State, controls: Controls | None = None, frames: int = 1) -> State:
    solver.reset(state)
    for _ in range(frames):
        solver.advance(Controls.hold(state, solver.scene.handles) if controls is None else controls)
    return solver.state


def matrix(grid: Grid, values: np.ndarray) -> np.ndarray:
    """The dense matrix that has the modes of a grid and the eigenvalues ``values``."""
    q = np.kron(modes(grid.rows, False)[0], modes(grid.cols, grid.periodic)[0])
    weighted = (grid.areas.ravel() / (grid.row_spacing * grid.col_spacing))[:, None] * q
    return weighted @ (values.ravel()[:, None] * weighted.T)


def prediction(scene: Scene, state: State, controls: Controls, h: float) -> np.ndarray:
    """``x~`` ``(3, n)``: no wind."""
    m = scene.material
    decay = np.exp(-m.drag * h)
    lag = (1 - decay) / m.drag if m.drag else h
    acceleration = pressure_forces(scene.grid, state.positions, controls.pressure * scene.pressure)
    acceleration = acceleration / scene.mass - scene.gravity * np.array([0, 0, 1.0])[:, None, None]
    return (state.positions + h * decay * state.velocities + h * lag * acceleration)[0].reshape(3, -1)


def springs(scene: Scene, x: np.ndarray, h: float) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """First, second, k', L' of every class of springs with their dashpots; ``x`` ``(3, n)`` at the step's start."""
    out, a = [], scene.material.damping / h
    for e in edges(scene.grid):
        length = np.linalg.norm(x[:, e.second] - x[:, e.first], axis=0)
        k = getattr(scene.material, e.modulus) * e.weight * (1 + a)
        out.append((e.first, e.second, k, (e.rest + a * length) / (1 + a)))
    return out


def twin(scene: Scene, state: State, controls: Controls, iterations: int) -> np.ndarray:
    """Positions ``(3, n)`` after one P-ADMM step, one line for one formula."""
    grid, h, held = scene.grid, scene.frame_dt, list(scene.handles)
    goal, start = prediction(scene, state, controls, h), state.positions[0].reshape(3, -1)
    a = matrix(grid, eigenvalues(grid, scene.material, h))
    free = np.setdiff1d(np.arange(grid.vertices), held)
    all_springs = springs(scene, start, h)
    duals = [np.zeros((3, len(first))) for first, *_ in all_springs]
    x = goal.copy()
    x[:, held] = controls.handle_positions[0].T
    bending = bending_matrix(grid, scene.material)
    for _ in range(iterations):
        residual = scene.mass.ravel() / h**2 * (goal - x) - (bending @ x.T).T
        for i, (first, second, k, rest) in enumerate(all_springs):
            d = x[:, second] - x[:, first]
            y = d + duals[i]
            length = np.linalg.norm(y, axis=0)
            z = (k * rest * y / length + WEIGHT * k * y) / (k + WEIGHT * k)
            duals[i] = y - z
            pull = WEIGHT * k * (z - duals[i] - d)
            np.add.at(residual, (slice(None), first), -pull)
            np.add.at(residual, (slice(None), second), pull)
        x[:, free] += np.linalg.solve(a[np.ix_(free, free)], residual[:, free].T).T
    return x


def potential(scene: Scene, state: State, controls: Controls, x: np.ndarray) -> tuple[float, np.ndarray]:
    """What a step minimises and its gradient at positions ``x`` ``(3, n)``."""
    h, d = scene.frame_dt, x - prediction(scene, state, controls, scene.frame_dt)
    inertia = scene.mass.ravel() / h**2 * d
    value, gradient = (inertia * d).sum() / 2, inertia
    for first, second, k, rest in springs(scene, state.positions[0].reshape(3, -1), h):
        edge = x[:, second] - x[:, first]
        length = np.linalg.norm(edge, axis=0)
        value += (k * (length - rest) ** 2).sum() / 2
        pull = k * (1 - rest / length) * edge
        np.add.at(gradient, (slice(None), first), -pull)
        np.add.at(gradient, (slice(None), second), pull)
    for t in triples(scene.grid):
        second_difference = x[:, t.before] - 2 * x[:, t.middle] + x[:, t.after]
        value += scene.material.bend_stiffness * (t.weight * second_difference**2).sum() / 2
    gradient += (bending_matrix(scene.grid, scene.material) @ x.T).T
    gradient[:, list(scene.handles)] = 0
    return value, gradient


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
def test_the_modes_give_the_matrix_of_springs_and_bound_bending(grid: Grid) -> None:
    limp, h = CLOTH.with_changes(bend_stiffness=0, damping=0), 0.03
    springs_alone = (WEIGHT * spring_laplacian(grid, limp)).toarray()
    springs_alone += np.diag(grid.areas.ravel() * limp.areal_density / h**2)
    got = matrix(grid, eigenvalues(grid, limp, h))
    np.testing.assert_allclose(got, springs_alone, atol=1e-12 * abs(springs_alone).max())
    more = matrix(grid, eigenvalues(grid, CLOTH.with_changes(damping=0), h)) - got
    gap = np.linalg.eigvalsh(more - bending_matrix(grid, CLOTH).toarray())
    assert gap[0] > -1e-10 * np.linalg.norm(more)  # never below the true matrix


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
def test_steps_equal_the_twin(grid: Grid, dtype: str) -> None:
    for handles in ((), (0, 4, grid.vertices - 1)):
        scene = Scene("twin", grid, CLOTH, 0.04, handles=handles, pressure=True)
        state = shaken(grid).astype(dtype).astype(np.float64)
        controls = Controls.hold(state, handles)
        controls.handle_positions += 0.01
        controls.pressure[:] = 3.0
        for iterations in (1, 4):
            end = run(AdmmSolver(scene, dtype=dtype, iterations=iterations), state, controls)
            want = twin(scene, state, controls, iterations)
            # Rounding of x, magnified by the matrix's condition: springs over inertia, at most 8 * 2 k h^2 / m.
            k = WEIGHT * (CLOTH.stretch_stiffness + CLOTH.shear_stiffness)
            condition = 1 + 16 * k * scene.frame_dt**2 / (CLOTH.areal_density * grid.row_spacing * grid.col_spacing)
            tolerance = 4 * np.finfo(dtype).eps * condition
            np.testing.assert_allclose(end.positions[0].reshape(3, -1), want, atol=tolerance)
            speed = (want - state.positions[0].reshape(3, -1)) / scene.frame_dt
            free = np.setdiff1d(np.arange(grid.vertices), handles)
            got = end.velocities[0].reshape(3, -1)
            np.testing.assert_allclose(got[:, free], speed[:, free], atol=tolerance / scene.frame_dt)


def test_iterations_go_to_the_minimum_of_the_potential() -> None:
    scene = Scene("minimum", Grid(4, 3, 0.3, 0.2), CLOTH, 0.01, handles=(0, 2))
    state = shaken(scene.grid, amount=0.05, speed=0.5)
    controls = Controls.hold(state, scene.handles)
    controls.handle_positions[..., 2] += 0.01
    norms = []
    for iterations in (3, 10, 30, 100, 2000):
        end = run(AdmmSolver(scene, dtype="float64", iterations=iterations), state, controls)
        x = end.positions[0].reshape(3, -1)
        norms.append(np.linalg.norm(potential(scene, state, controls, x)[1]))
    assert (np.diff(norms) < 0).all()
    assert norms[-1] < 1e-6 * norms[0]
    held = list(scene.handles)
    begin = x.copy()
    begin += 1e-3 * np.random.default_rng(0).normal(size=x.shape)
    begin[:, held] = x[:, held]

    def objective(flattened: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = potential(scene, state, controls, flattened.reshape(3, -1))
        return value, gradient.ravel()

    best = minimize(objective, begin.ravel(), jac=True, method="BFGS", options={"gtol": 1e-9, "maxiter": 2000})
    # The Hessian is at least M / h^2 here (no spring is slack enough to buckle): |dx| <= |gradient| h^2 / m.
    reach = np.linalg.norm(best.jac) + norms[-1]
    slack = reach * scene.frame_dt**2 / scene.mass.min()
    np.testing.assert_allclose(best.x.reshape(3, -1), x, atol=max(slack, 1e-9))


def test_small_steps_agree_with_the_explicit_solver_at_first_order() -> None:
    scene = Scene("order", Grid(5, 6, 0.3, 0.4), CLOTH, 0.04, handles=(0, 5), air=Air(max_wind=12.0), pressure=True)
    state = shaken(scene.grid, amount=0.02, speed=0.1)
    controls = Controls.hold(state, scene.handles)
    controls.handle_positions[..., 0] += 0.01
    controls.handle_velocities[..., 0] = 0.2
    controls.wind[:], controls.pressure[:] = [1.0, 3.0, 2.0], 2.0
    truth = run(ExplicitSolver(scene, dtype="float64", refine=64), state, controls).positions
    errors = []
    for substeps in (64, 128, 256, 512):
        end = run(AdmmSolver(scene, dtype="float64", substeps=substeps, iterations=40), state, controls)
        errors.append(np.sqrt(((end.positions - truth) ** 2).mean()))
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (abs(rates - 1) < 0.25).all(), rates


def test_free_fall_is_exact() -> None:
    for drag in (0.0, 2.0):
        scene = Scene("fall", Grid(9, 6, 0.5, 0.4), CLOTH.with_changes(drag=drag), 0.04)
        state = State.still(flat(scene.grid))
        state.velocities[:, 0] = 1.0
        end = run(AdmmSolver(scene, dtype="float64"), state, frames=5)
        x, v = np.zeros(3), np.array([1.0, 0, 0])
        decay = np.exp(-drag * scene.frame_dt)
        lag = (1 - decay) / drag if drag else scene.frame_dt
        for _ in range(5):
            v = v * decay + [0, 0, -G * lag]
            x = x + scene.frame_dt * v
        np.testing.assert_allclose(end.positions - state.positions, x[:, None, None] + 0 * end.positions, atol=1e-12)


def test_handles_go_where_they_are_told() -> None:
    scene = Scene("pins", Grid(7, 9, 0.5, 0.6), CLOTH, 0.04, handles=(0, 8, 31))
    state = shaken(scene.grid, speed=0.0)
    controls = Controls.hold(state, scene.handles)
    controls.handle_positions += 0.03
    controls.handle_velocities[:] = [0.1, 0.2, 0.3]
    for substeps in (1, 3):
        end = run(AdmmSolver(scene, dtype="float64", substeps=substeps), state, controls)
        for array, want in (
            (end.positions, controls.handle_positions),
            (end.velocities, controls.handle_velocities),
        ):
            got = array.reshape(1, 3, -1)[..., list(scene.handles)].transpose(0, 2, 1)
            np.testing.assert_allclose(got, want, atol=1e-14)


def test_ten_iterations_do_not_fall_in_slow_motion() -> None:
    grid = Grid(17, 25, 1.0, 1.5)
    scene = Scene("flag", grid, Material(), 0.04, handles=tuple(range(0, grid.vertices, grid.cols)))
    state = State.still(flat(grid))
    truth = run(ExplicitSolver(scene), state, frames=13).positions[:, 2].mean()
    end = run(AdmmSolver(scene), state, frames=13).positions[:, 2].mean()
    # Implicit Euler lags by up to h |v| / 2 in a fall; the swing's lowest point moves at sqrt(2 g s).
    assert abs(end - truth) < 0.02 * (2 * G * abs(truth)) ** 0.5
    assert truth < -0.6


def test_nothing_blows_up_over_the_whole_range() -> None:
    grid = Grid(6, 9, 1.0, 1.5)
    for stiffness, mass, frame, wind in product((0.25, 1, 16), (1 / 3, 1, 3), (0.5, 1, 4), (0, 3)):
        material = Material(0.2 * mass, 500.0 * stiffness, 150.0 * stiffness)
        handles = tuple(range(0, grid.vertices, grid.cols))
        scene = Scene("flag", grid, material, 0.04 * frame, handles=handles, air=Air(max_wind=12.0))
        state = State.still(flat(grid))
        controls = Controls.hold(state, scene.handles)
        controls.wind[:] = wind * np.array([4.0, 2.0, 1.0])
        solver = AdmmSolver(scene)
        solver.reset(state)
        most = 0.0
        for _ in range(40):
            end = solver.advance(controls)
            most = max(most, float(kinetic_energy(grid, [material], end.velocities)[0]))
        # Weight and wind can't give more: a fall over the flag's length, and the wind's own speed.
        heaviest = material.areal_density * 1.5
        assert most < heaviest * (G * 1.5 + 21 * wind**2 / 2), (stiffness, mass, frame, wind)
        assert np.ptp(end.positions[0], axis=(1, 2)).max() < 2 * 1.5


@pytest.mark.parametrize("frame_dt", [0.04, 0.16])
def test_a_falling_sheet_reaches_its_terminal_velocity(frame_dt: float) -> None:
    grid, air = Grid(7, 7, 0.5, 0.5), Air(normal=1.5, tangential=0.4)
    scene = Scene("fall", grid, Material(0.05, drag=0.0), frame_dt, air=air)
    end = run(AdmmSolver(scene, dtype="float64"), State.still(flat(grid)), frames=int(4 / frame_dt))
    terminal = np.sqrt(2 * 0.05 * G / (air.density * air.normal))  # of the law, whatever the step
    np.testing.assert_allclose(end.velocities[0, 2], -terminal, rtol=1e-6)


def on_slope(kind: str, angle: float, mu: float) -> tuple[Scene, State, np.ndarray]:
    """A small sheet on a body so large that it lies on a plane falling off by ``angle``, and the way down."""
    grid, huge = Grid(5, 5, 0.1, 0.1), 1e5
    down, up = np.array([np.cos(angle), 0, -np.sin(angle)]), np.array([np.sin(angle), 0, np.cos(angle)])
    body = Collider(kind, 0.0 if kind == "plane" else huge, mu)
    scene = Scene("slope", grid, CLOTH.with_changes(drag=0.0), 0.02, colliders=(body,))
    r, c = np.indices(grid.shape) * grid.row_spacing - 0.05
    x = np.multiply.outer(down, r) + np.multiply.outer([0, 1.0, 0], c) + (scene.thickness * up)[:, None, None]
    place = {
        "plane": [0 * up, up],
        "sphere": [-huge * up] * 2,
        "capsule": [-huge * up - 9 * down, -huge * up + 9 * down],
    }
    return scene, State.still(x[None], np.array(place[kind])[None, None]), down


@pytest.mark.parametrize("kind", ["plane", "sphere", "capsule"])
def test_friction_on_slopes(kind: str) -> None:
    mu, frames = 0.5, 20
    for angle in (0.2, np.arctan(mu) - 0.02, np.arctan(mu) + 0.02, 0.9):
        scene, state, down = on_slope(kind, angle, mu)
        end = run(AdmmSolver(scene, dtype="float64"), state, frames=frames)
        way = np.tensordot(down, (end.positions - state.positions)[0], 1).mean()
        law = max(G * (np.sin(angle) - mu * np.cos(angle)), 0.0)
        h, t = scene.frame_dt, frames * scene.frame_dt
        # Steps sum to a t (t + h) / 2. A round body is (0.05 m)^2 / R lower at the sheet's corners, its slope turns
        # by the way over R, and positions on it are rounded.
        slack = 1e-12 if kind == "plane" else G * t * t * (0.05 + way) / 1e5 + frames * 1e5 * np.finfo(float).eps
        assert way == pytest.approx(law * t * (t + h) / 2, abs=slack)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("speed", [5.0, 20.0])
def test_a_fast_ball_takes_the_cloth_along(dtype: str, speed: float) -> None:
    grid, radius = Grid(31, 21, 0.75, 0.5), 0.1
    scene = Scene("hit", grid, CLOTH, 0.02, handles=(0, 20), colliders=(Collider("sphere", radius),))
    state = State.still(flat(grid), np.tile([0.25, -0.375, -0.3], (1, 1, 2, 1)))
    state.collider_velocities[..., 2] = speed
    controls = Controls.hold(state, scene.handles)
    controls.collider_velocities[..., 2] = speed
    solver = AdmmSolver(scene, dtype=dtype)
    solver.reset(state)
    hit = 0.2 / speed
    for frame in range(int(np.ceil((0.2 / speed + 0.03) / 0.02))):
        t = (frame + 1) * scene.frame_dt
        controls.colliders[..., 2] = -0.3 + speed * t
        end = solver.advance(controls)
        x, centre = end.positions[0].astype(np.float64), controls.colliders[0, 0, 0]
        gap = np.linalg.norm(x - centre[:, None, None], axis=0) - radius - scene.thickness
        assert gap.min() > -8 * np.finfo(dtype).eps * (1 + abs(centre).max())
        # The vertex that the ball met first may slide off its top, not pass through it.
        assert x[2, 15, 10] > (centre[2] if t > hit else -np.inf)
        assert abs(end.velocities).max() < 5 * speed + G


def test_a_sheet_comes_to_rest_on_a_table() -> None:
    scene = Scene("table", Grid(9, 9, 0.4, 0.4), Material(drag=0.0), 0.02, colliders=(Collider("plane"),))
    x = flat(scene.grid)
    x[:, 2] += scene.thickness + 0.02
    state = State.still(x, np.array([[[[0, 0, 0], [0, 0, 1.0]]]]))
    end = run(AdmmSolver(scene, dtype="float64"), state, frames=20)
    # Flat contact is solved in one iteration: only rounding is left.
    np.testing.assert_allclose(end.positions[0, 2], scene.thickness, atol=1e-12)
    np.testing.assert_allclose(end.velocities, 0, atol=1e-10)


def test_members_and_threads_do_not_matter() -> None:
    grid = Grid(9, 11, 0.5, 0.6)
    scene = Scene(
        "batch", grid, CLOTH, 0.02, handles=(0, 10), colliders=(Collider("sphere", 0.1),), air=Air(max_wind=12.0)
    )
    materials = [CLOTH, Material(), CLOTH.with_changes(areal_density=0.1)]
    one = State.still(flat(grid), np.tile([0.3, -0.25, -0.11], (1, 1, 2, 1)))
    states = one.select([0, 0, 0])
    states.velocities[:] = np.random.default_rng(0).normal(size=states.velocities.shape)
    controls = Controls.hold(states, scene.handles)
    controls.wind[:] = [[1, 2, 3], [3, 0, 0], [0, 0, 1]]
    ends = []
    for threads in (1, 2):
        solver = AdmmSolver(scene, num_envs=3, threads=threads)
        solver.reset(states, materials)
        solver.advance(controls)
        ends.append(solver.advance(controls).positions)
    np.testing.assert_array_equal(*ends)
    for i, material in enumerate(materials):
        single = AdmmSolver(scene)
        single.reset(states.select([i]), [material])
        mine = Controls(**{name: value[[i]] for name, value in vars(controls).items()})
        single.advance(mine)
        np.testing.assert_array_equal(single.advance(mine).positions[0], ends[0][i])


@pytest.mark.parametrize("scene", SCENES)
def test_every_scene_runs_and_continues_from_a_saved_state(scene: str) -> None:
    env = gym.make(f"MiniCloth-{scene}-v0", backend_kwargs={"solver": "admm"})
    env.reset(seed=3)
    rng = np.random.default_rng(0)
    actions = [rng.uniform(-1, 1, env.action_space.shape).astype(np.float32) for _ in range(20)]
    for action in actions[:10]:
        _, _, terminated, _, info = env.step(action)
        assert not terminated, info
    saved = env.unwrapped.get_state()  # type: ignore[attr-defined]
    first = [env.step(action)[0] for action in actions[10:]]
    env.unwrapped.set_state(saved)  # type: ignore[attr-defined]
    for action, want in zip(actions[10:], first, strict=True):
        got, _, terminated, _, info = env.step(action)
        assert not terminated, info
        np.testing.assert_array_equal(got, want)
    env.close()


def test_bad_arguments_are_refused() -> None:
    scene = Scene("plain", Grid(3, 3, 0.2, 0.2), CLOTH, 0.02)
    for name, value in (("iterations", 0), ("iterations", -3), ("iterations", 2.5), ("substeps", 0)):
        with pytest.raises(ValueError, match=name):
            AdmmSolver(scene, **{name: value})  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="iterations"):
        gym.make("MiniCloth-Flag-v0", backend_kwargs={"solver": "admm", "iteration": 3})
    state = State.still(flat(scene.grid))
    other = AdmmSolver(replace(scene, frame_dt=0.04))
    other.reset(state)
    assert other.advance(Controls.hold(state, ())).time[0] == 0.04
