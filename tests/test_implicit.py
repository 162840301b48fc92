"""The implicit solver: its potential against the twin, its residual, its order, and what it must survive."""

from __future__ import annotations

from typing import Any

import _minicloth_kernels as kernels
import gymnasium as gym
import numpy as np
import pytest
from test_kernel_twin import GRIDS, crumpled

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.implicit.solver import ImplicitSolver
from cloth_envs.physics.laws.sheet import kinetic_energy, masses, spring_energy
from cloth_envs.physics.laws.step import total_forces
from cloth_envs.physics.solver import kernel_material, kernel_sheet
from cloth_envs.registry import SCENES
from cloth_envs.scene import Air, Collider, Scene
from cloth_envs.state import Controls, State

G = 9.81
SOFT = Material(0.2, 20.0, 6.0, 1e-3, damping=5e-3, drag=0.5)
CLOTH = Material(0.2, 500.0, 150.0, 1e-4, 5e-5, drag=0.0)
SCHEMES = ("euler", "sdirk2")


def sheet(grid: Grid, origin: Any = (0, 0, 0), down: Any = (1, 0, 0)) -> np.ndarray:
    """Unstretched positions ``(1, 3, H, W)``, rows along ``down``, columns along y."""
    r, c = np.indices(grid.shape)
    steps = np.multiply.outer(down, r * grid.row_spacing) + np.multiply.outer((0, 1, 0), c * grid.col_spacing)
    return (np.reshape(np.asarray(origin, float), (3, 1, 1)) + steps)[None]


def roll(solver: Any, state: State, controls: Controls, frames: int = 1) -> State:
    solver.reset(state)
    for _ in range(frames):
        solver.advance(controls)
    return solver.state


class Frozen:
    """The potential of a stage around random places, and what the twin needs."""

    def __init__(self, grid: Grid, tau: float = 0.01) -> None:
        self.air = Air(normal=1.5, tangential=0.4)
        self.scene = Scene("all", grid, SOFT, 0.04, air=self.air, pressure=True)
        self.state, self.tau, self.inertia = crumpled(grid, 1), tau, 1 / tau**2
        self.blow, self.pressure = np.array([3.0, -2.0, 1.0]), 5.0
        self.target = np.random.default_rng(5).normal(size=self.state.positions.shape)

    def potential(self, base: np.ndarray, along: np.ndarray) -> kernels.Potential:
        potential = kernels.Potential(kernel_sheet(self.scene))
        potential.begin(
            material=kernel_material(SOFT),
            tau=self.tau,
            inertia=self.inertia,
            base=base.ravel(),
            along=along.ravel(),
            target=self.target.ravel().copy(),
            velocity=self.state.velocities.ravel(),
            wind=self.blow,
            pressure=self.pressure,
        )
        return potential


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
def test_the_gradient_is_the_twins_forces(grid: Grid) -> None:
    f = Frozen(grid)
    x, v = f.state.positions, f.state.velocities
    # With base = x - tau v and directions taken at x every term is the twin's at (x, v).
    gradient = np.empty(x.size)
    f.potential(x - f.tau * v, x).evaluate(x.ravel(), gradient)
    still = Scene("still", grid, SOFT, 0.04, air=f.air, pressure=True, gravity=0.0)
    force = total_forces(still, [SOFT], f.state, f.blow[None], np.array([f.pressure]))
    expected = masses(grid, [SOFT]) * f.inertia * (x - f.target) - force
    np.testing.assert_allclose(gradient.reshape(x.shape), expected, atol=1e-12 * abs(expected).max())


@pytest.mark.parametrize("name", ["wide", "tube"])
def test_the_gradient_is_that_of_the_energy(name: str) -> None:
    f, rng = Frozen(GRIDS[name]), np.random.default_rng(3)
    x = f.state.positions.ravel()
    potential = f.potential(x - f.tau * f.state.velocities.ravel(), x + 0.02 * rng.normal(size=x.shape))
    gradient, other = np.empty(x.size), np.empty(x.size)
    energy = potential.evaluate(x, gradient)
    for step in (1e-4, 5e-5):
        d = rng.normal(size=x.size)
        slope = (potential.evaluate(x + step * d, other) - potential.evaluate(x - step * d, other)) / (2 * step)
        # Central differences: step^2 / 6 times the third derivative, k |d|^3 / L^2 or less an edge; and rounding.
        third = 8 * SOFT.stretch_stiffness * abs(d).max() ** 3 * x.size / GRIDS[name].col_spacing ** 2
        assert slope == pytest.approx(gradient @ d, abs=step**2 * third + 1e-15 * energy / step)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-8])
def test_the_residual_of_the_step_is_what_it_says(tolerance: float) -> None:
    grid, cloth = Grid(9, 8, 0.4, 0.35), CLOTH.with_changes(damping=0.0, drag=0.7)
    scene = Scene("hung", grid, cloth, 0.02, handles=(0, 7))
    state = State.still(sheet(grid))
    controls = Controls.hold(state, scene.handles)
    controls.handle_positions[..., 0] += 0.01
    solver = ImplicitSolver(scene, dtype="float64", tolerance=tolerance, max_iterations=5000)
    now = roll(solver, state, controls)
    h, drag = scene.frame_dt, cloth.drag
    decay = np.exp(-drag * h)
    push = (1 - decay) / (drag * h)
    momentum = scene.mass * (now.velocities - decay * state.velocities) / (push * h)
    unbalanced = momentum - total_forces(scene, [cloth], now, np.zeros((1, 3)), np.zeros(1))
    ratio = (np.sqrt((unbalanced**2).sum(1))[0] / scene.mass / G).ravel()
    ratio[list(scene.handles)] = 0
    rounding = 16 * cloth.stretch_stiffness * np.finfo(float).eps / (scene.mass.min() * G)
    assert ratio.max() <= tolerance + rounding
    assert solver.residual[0] == pytest.approx(ratio.max(), abs=rounding)
    assert 0 < solver.iterations[0] < 5000


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_falling_sheet_reaches_its_terminal_velocity(scheme: str) -> None:
    """At the default tolerance, of a tenth of the weight: no step begins where it may end."""
    air = Air()
    scene = Scene("fall", Grid(5, 5, 0.5, 0.5), CLOTH, 0.02, air=air)
    state = State.still(sheet(scene.grid))
    end = roll(ImplicitSolver(scene, scheme=scheme), state, Controls.hold(state, ()), 75)
    terminal = np.sqrt(2 * CLOTH.areal_density * G / (air.density * air.normal))
    np.testing.assert_allclose(end.velocities[0, 2], -terminal, rtol=2e-3)


def test_too_few_iterations_are_told() -> None:
    grid = Grid(9, 8, 0.4, 0.35)
    state = State.still(sheet(grid))
    solver = ImplicitSolver(Scene("hung", grid, CLOTH, 0.04, handles=(0, 7)), max_iterations=2)
    roll(solver, state, Controls.hold(state, (0, 7)))
    assert solver.iterations[0] == 2
    assert solver.residual[0] > 0.1


@pytest.mark.parametrize(
    "terms", [{}, {"air": Air(max_wind=12.0)}, {"pressure": True}], ids=["springs", "wind", "pressure"]
)
def test_orders_of_convergence_to_the_explicit_solver(terms: dict[str, Any]) -> None:
    grid = Grid(5, 4, 0.4, 0.3)
    scene = Scene("order", grid, SOFT, 0.04, (0, 3), **terms)
    state = State.still(crumpled(grid, 1, 0.1).positions)
    state.velocities[:] = 0.3 * crumpled(grid, 1).velocities
    controls = Controls.hold(state, scene.handles)
    controls.handle_positions[..., 2] += 0.01
    controls.handle_velocities[..., 0] = 0.4
    controls.wind[:], controls.pressure[:] = (3, 2, 1), 2.0
    coarse, fine = (
        roll(ExplicitSolver(scene, dtype="float64", substeps=n), state, controls, 2).positions for n in (2000, 4000)
    )
    truth = 2 * fine - coarse  # what is of order h drops out
    orders = {}
    for scheme in SCHEMES:
        errors = []
        for substeps in (16, 32, 64):
            solver = ImplicitSolver(scene, dtype="float64", scheme=scheme, substeps=substeps, tolerance=1e-8)
            errors.append(abs(roll(solver, state, controls, 2).positions - truth).max())
            assert solver.residual[0] <= 1e-8
        orders[scheme] = np.polyfit(np.log([4, 2, 1]), np.log(errors), 1)[0]
    # The next term of the error is h times a rate of the motion (about 20 / s) below: 0.04 / 16 * 20 = 0.05 for the
    # second order; damped modes of 1000 / s approach the first order more slowly.
    assert orders["sdirk2"] == pytest.approx(2, abs=0.1)
    assert 0.7 < orders["euler"] < 1.1


@pytest.mark.parametrize("scheme", SCHEMES)
def test_free_fall(scheme: str) -> None:
    grid = Grid(6, 5, 0.5, 0.4)
    scene = Scene("fall", grid, CLOTH, 0.04)
    state = State.still(sheet(grid))
    solver = ImplicitSolver(scene, dtype="float64", scheme=scheme, substeps=2, tolerance=1e-8)
    z = roll(solver, state, Controls.hold(state, ()), 5).positions[0, 2]
    h, n = 0.02, 10
    law = -G * h * h * (n * (n + 1) if scheme == "euler" else n * n) / 2
    # The residual acts like gravity: at most tolerance g t^2 / 2.
    np.testing.assert_allclose(z, law, atol=1e-8 * G * (n * h) ** 2)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize(
    ("changes", "frame_dt", "wind", "tolerance"),
    [
        ({"stretch_stiffness": 125.0, "shear_stiffness": 40.0}, 0.04, 4.0, 0.02),
        ({"stretch_stiffness": 8000.0, "shear_stiffness": 2400.0}, 0.04, 4.0, 0.02),
        ({"areal_density": 0.067}, 0.04, 4.0, 0.02),
        ({"areal_density": 0.6}, 0.04, 4.0, 0.02),
        ({"damping": 1e-2}, 0.04, 4.0, 0.02),
        ({}, 0.02, 4.0, 0.02),
        ({}, 0.16, 4.0, 0.002),  # solved to 0.02, 1 of 31 winds from 3.5 to 4.5 m/s strains an edge by over 0.2
        ({}, 0.04, 0.0, 0.02),
        ({}, 0.04, 12.0, 0.02),
    ],
)
def test_no_material_frame_or_wind_blows_it_up(
    changes: dict[str, float], frame_dt: float, wind: float, tolerance: float, scheme: str
) -> None:
    grid, cloth = Grid(11, 9, 0.6, 0.5), CLOTH.with_changes(**changes)
    scene = Scene("flag", grid, cloth, frame_dt, tuple(range(9)), air=Air(max_wind=12.0))
    state = State.still(sheet(grid, down=(0, 0, -1)))
    controls = Controls.hold(state, scene.handles)
    controls.wind[:] = np.array([0.8, 0.6, 0.0]) * wind
    solver = ImplicitSolver(scene, scheme=scheme, tolerance=tolerance, max_iterations=4000)
    solver.reset(state)
    for _ in range(12):
        now = solver.advance(controls)
        # Air can't drive it faster than it blows, nor gravity faster than a fall from its top.
        assert np.sqrt((now.velocities**2).sum(1).mean()) <= wind + np.sqrt(2 * G * grid.height)
        span = np.linalg.norm(np.diff(now.positions, axis=2), axis=1).max() / grid.row_spacing
        # At most the pull of the wind and the weight, over the threads' stiffness; doubled for swinging.
        pull = grid.height * (0.5 * 1.2 * 1.5 * wind**2 + cloth.areal_density * G)
        assert span - 1 <= 2 * pull / cloth.stretch_stiffness + 0.05


def test_a_stretched_cloth_gains_no_energy_however_long_the_step() -> None:
    grid = Grid(6, 6, 0.5, 0.5)
    for frame_dt in (0.01, 0.04, 0.16):
        scene = Scene("free", grid, CLOTH.with_changes(damping=0.0), frame_dt, gravity=0.0)
        state = crumpled(grid, 1)
        solver = ImplicitSolver(scene, dtype="float64", tolerance=1e-6)
        stored = spring_energy(grid, [scene.material], state.positions)
        before = stored + kinetic_energy(grid, [scene.material], state.velocities)
        now = roll(solver, state, Controls.hold(state, ()), 3)
        after = spring_energy(grid, [scene.material], now.positions)
        assert after + kinetic_energy(grid, [scene.material], now.velocities) <= before
        # Springs push both ends alike: momentum changes by no more than the residual, tolerance m g t.
        drift = (scene.mass * (now.velocities - state.velocities)).sum((2, 3))
        assert abs(drift).max() <= 1e-6 * scene.mass.sum() * G * 3 * frame_dt


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("angle", [0.2, np.arctan(0.5) - 0.02, np.arctan(0.5) + 0.02, 0.9])
def test_friction_on_a_slope(scheme: str, angle: float) -> None:
    grid, mu = Grid(5, 5, 0.1, 0.1), 0.5
    downhill, normal = np.array([np.cos(angle), 0, -np.sin(angle)]), np.array([np.sin(angle), 0, np.cos(angle)])
    scene = Scene("slope", grid, CLOTH, 0.02, colliders=(Collider("plane", friction=mu),))
    x = sheet(grid, origin=normal * scene.thickness, down=downhill)
    state = State.still(x, np.array([[[0 * normal, normal]]]))
    tolerance, frames, h = 1e-6, 10, scene.frame_dt
    solver = ImplicitSolver(scene, dtype="float64", scheme=scheme, tolerance=tolerance)
    moved = roll(solver, state, Controls.hold(state, ()), frames).positions - x
    way = np.tensordot(downhill, moved[0].mean((1, 2)), 1)
    law = G * max(np.sin(angle) - mu * np.cos(angle), 0.0)
    steps = frames * (frames + 1) if scheme == "euler" else frames**2
    assert way == pytest.approx(law * h * h * steps / 2, abs=tolerance * G * (frames * h) ** 2)
    if law == 0:  # it sticks: nothing but rounding moves it
        assert abs(moved).max() <= 1e-15 * frames


def test_a_sheet_comes_to_rest_on_a_ball() -> None:
    grid, radius = Grid(7, 7, 0.12, 0.12), 0.2
    scene = Scene("ball", grid, SOFT.with_changes(drag=2.0), 0.02, colliders=(Collider("sphere", radius, 0.5),))
    state = State.still(sheet(grid, origin=(-0.06, -0.06, radius + 0.01)), np.zeros((1, 1, 2, 3)))
    solver = ImplicitSolver(scene, dtype="float64")
    controls = Controls.hold(state, ())
    before = roll(solver, state, controls, 60).copy()
    frames, h, tolerance = 10, scene.frame_dt, 0.1
    for _ in range(frames):
        after = solver.advance(controls)
        assert solver.residual[0] <= tolerance
    distance = np.sqrt((after.positions**2).sum(1))
    assert distance.min() >= radius + scene.thickness - 4 * np.finfo(float).eps
    # At rest but for what is left unbalanced, whose speed tolerance g h a frame's friction takes away again.
    assert abs(after.velocities).max() <= tolerance * G * h
    assert abs(after.positions - before.positions).max() <= tolerance * G * h * h


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("kind", ["sphere", "capsule"])
def test_a_fast_body_does_not_pass_the_hung_cloth(kind: str, scheme: str) -> None:
    grid, radius, speed = Grid(21, 15, 1.5, 1.0), 0.1, 20.0
    scene = Scene("hit", grid, CLOTH, 0.02, (0, 14), colliders=(Collider(kind, radius),))
    x = sheet(grid, down=(0, 0, -1))
    start = np.array([[-radius - 0.01, 0.5 - 0.02, -0.75], [-radius - 0.01, 0.5 + 0.02, -0.75]])
    if kind == "sphere":
        start[:] = start.mean(0)
    state = State.still(x, start[None, None])
    state.collider_velocities[..., 0] = speed
    solver = ImplicitSolver(scene, scheme=scheme, max_iterations=500)
    solver.reset(state)
    hit = np.hypot(x[0, 1] - 0.5, x[0, 2] + 0.75) < radius / 2
    assert hit.any()
    for frame in range(2):
        controls = Controls.hold(state, scene.handles)
        controls.colliders[..., 0] += speed * (frame + 1) * scene.frame_dt
        controls.collider_velocities[..., 0] = speed
        now = solver.advance(controls)
        ends = now.colliders[0, 0].astype(float)
        axis = ends[1] - ends[0]
        apart = now.positions[0].astype(float) - ends[0][:, None, None]
        if kind == "capsule":
            apart -= axis[:, None, None] * np.clip(np.tensordot(axis, apart, 1) / (axis @ axis), 0, 1)
        distance = np.linalg.norm(apart, axis=0).ravel()[15:]
        assert radius + scene.thickness - distance.min() <= 4 * np.finfo(np.float32).eps
        assert (apart[0][hit] > 0).all()


def test_a_batch_is_its_members_one_by_one() -> None:
    grid = Grid(9, 8, 0.4, 0.35)
    scene = Scene("batch", grid, CLOTH, 0.02, handles=(0,), colliders=(Collider("plane", friction=0.3),))
    materials = [CLOTH, SOFT, CLOTH.with_changes(areal_density=0.4)]
    state = State.still(crumpled(grid, 3).positions, np.tile([[[0, 0, -0.05], [0, 0, 1.0]]], (3, 1, 1, 1)))
    controls = Controls.hold(state, scene.handles)
    solver = ImplicitSolver(scene, num_envs=3)
    solver.reset(state, materials)
    together = solver.advance(controls)
    for i in range(3):
        alone = ImplicitSolver(scene)
        alone.reset(state.select([i]), [materials[i]])
        one = Controls(**{name: value[[i]] for name, value in vars(controls).items()})
        assert (alone.advance(one).positions == together.positions[[i]]).all()
        assert alone.iterations[0] == solver.iterations[i]


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", SCENES)
def test_every_scene_runs_and_saved_states_continue_bit_for_bit(name: str, scheme: str) -> None:
    options = {"solver": "implicit", "scheme": scheme, "max_iterations": 200}
    env = gym.make(f"MiniCloth-{name}-v0", backend_kwargs=options, resolution=(13, 11))
    env.reset(seed=1)
    env.action_space.seed(1)
    actions = [env.action_space.sample() for _ in range(10)]
    saved = None
    for action in actions[:7]:
        _, _, terminated, _, info = env.step(action)
        assert not terminated, info
    saved = env.unwrapped.get_state()
    ends = []
    for _ in range(2):
        env.unwrapped.set_state(saved)
        for action in actions[7:]:
            _, _, terminated, _, info = env.step(action)
            assert not terminated, info
        ends.append(env.unwrapped.get_state())
    assert all((ends[0][key] == ends[1][key]).all() for key in ends[0])
    env.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tolerance": 0.0}, "tolerance must be a positive number"),
        ({"tolerance": "1e-3"}, "tolerance must be a positive number"),
        ({"substeps": 0}, "substeps must be a whole number"),
        ({"scheme": "eular"}, "euler"),
        ({"window": 0}, "window must be a whole number"),
        ({"max_iterations": 1.5}, "max_iterations must be a whole number"),
        ({"dtype": "float16"}, "float32"),
    ],
)
def test_bad_arguments_are_refused(options: dict[str, Any], message: str) -> None:
    scene = Scene("bad", Grid(4, 4, 0.3, 0.3), CLOTH, 0.02)
    with pytest.raises(ValueError, match=message):
        ImplicitSolver(scene, **options)
