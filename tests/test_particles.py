"""The net of particles: the kernel against its twin, the laws that it keeps, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import _minicloth_kernels as kernels
import numpy as np
import pytest

from cloth_envs.grid import Grid
from cloth_envs.particles import Particles
from cloth_envs.physics.laws import particles as twin
from cloth_envs.physics.particles.solver import NEIGHBOURS, Cell, ParticleSolver, make_kernel, mass_spring_cell
from cloth_envs.physics.solver import kernel_sheet, reference
from cloth_envs.scene import Air, Collider, Scene
from cloth_envs.state import Controls, State

NET = Particles()
FREE = Particles(drag=0.0, dashpot=0.0)
BALL = Collider("sphere", 0.03)
TERMS: dict[str, tuple[Particles, dict[str, object]]] = {
    "springs": (FREE, {}),
    "dashpots": (replace(FREE, stiffness=1e-9, dashpot=200.0), {}),
    "gravity": (FREE, {"gravity": 9.8}),
    "drag": (replace(FREE, drag=3.0), {}),
    "pressure": (FREE, {"pressure": True}),
    "ball": (replace(FREE, stiffness=1e-9), {"colliders": (BALL,)}),
    "handles": (FREE, {"handles": (0, 7)}),
}


def make_scene(net: Particles, rows: int = 8, cols: int = 11, steps: int = 1, **options: object) -> Scene:
    grid = Grid(rows, cols, (rows - 1) * net.spacing, (cols - 1) * net.spacing)
    given = {"gravity": 0.0, **options}
    return Scene("net", grid, net.sheet(), steps * net.sim_dt, particles=net, **given)  # type: ignore[arg-type]


def crumpled(scene: Scene, batch: int = 2, amount: float = 0.15) -> State:
    """Random positions ``amount`` spacings around flat sheets, velocities of about 1 m/s, a ball at the middle."""
    rng = np.random.default_rng(0)
    r, c = np.indices(scene.grid.shape) * scene.grid.row_spacing
    x = np.stack([c, -r, 0 * r]) + amount * scene.grid.row_spacing * rng.normal(size=(batch, 3, *scene.grid.shape))
    centre = x.mean((2, 3))[:, None, None] + [0, 0, -0.02]
    state = State.still(x, np.broadcast_to(centre, (batch, len(scene.colliders), 2, 3)))
    state.velocities[:] = rng.normal(size=x.shape)
    return state


def moving(scene: Scene, state: State) -> Controls:
    """Handles, balls and pressure that differ over the batch."""
    controls = Controls.hold(state, scene.handles)
    controls.handle_positions += 1e-4
    controls.handle_velocities += 0.3
    controls.colliders += 2e-4
    controls.collider_velocities += [0.2, 0.1, 0.4]
    controls.pressure[:] = [150_000.0, -40_000.0][: state.batch]
    return controls


def compare(scene: Scene, dtype: str, roundings: float, refine: int = 1, in_place: bool = True) -> State:
    """Assert that kernel and twin differ by at most ``roundings`` times eps of the largest value."""
    state, law = crumpled(scene).astype(dtype), mass_spring_cell(scene)
    controls, got = moving(scene, state), state.copy()
    want = twin.step(scene, state, controls, law, refine, in_place=in_place)
    kernel = make_kernel(scene, law, in_place=in_place, dtype=dtype, refine=refine)
    kernel.advance(state, got, controls, 1)
    for name in ("positions", "velocities"):
        a, b = getattr(got, name), getattr(want, name)
        assert a.dtype == dtype
        assert abs(a - b).max() <= roundings * np.finfo(dtype).eps * abs(b).max(), name
    return want


@pytest.mark.parametrize("in_place", [True, False])
@pytest.mark.parametrize("term", TERMS)
@pytest.mark.parametrize("shape", [(8, 11), (3, 3), (5, 37)])
def test_one_step_of_each_term(term: str, shape: tuple[int, int], in_place: bool) -> None:
    net, options = TERMS[term]
    scene = make_scene(net, *shape, **options)
    # A rounding of a position, of 37 spacings at most, becomes h Y / (L m) = 400 1/s times it from each of 12 springs:
    # 12 * 400 * 37 / 128 = 1400 m/s times eps, 400 of it per largest velocity of about 3.5 m/s.
    compare(scene, "float64", 400.0, in_place=in_place)


@pytest.mark.parametrize("shape", [(37, 5), (40, 45)])
def test_grids_higher_than_a_vector(shape: tuple[int, int]) -> None:
    scene = make_scene(NET, *shape, gravity=9.8, pressure=True, colliders=(BALL,), handles=(0, 4))
    compare(scene, "float64", 400.0)


@pytest.mark.parametrize("in_place", [True, False])
@pytest.mark.parametrize(("dtype", "refine"), [("float64", 1), ("float64", 3), ("float32", 1)])
def test_a_frame_of_everything(dtype: str, refine: int, in_place: bool) -> None:
    scene = make_scene(NET, steps=8, gravity=9.8, pressure=True, colliders=(BALL,), handles=(0, 10, 87))
    # Eight steps of the test above on 11 instead of 37 columns; a stable step does not amplify errors.
    want = compare(scene, dtype, 8 * 400 * 11 / 37, refine, in_place)
    bare = replace(scene, colliders=())
    state = crumpled(bare)
    other = twin.step(bare, state, moving(bare, state), mass_spring_cell(bare), refine, in_place=in_place)
    assert abs(other.velocities - want.velocities).max() > 0.1  # the ball is met


def test_any_coefficients_are_the_kernels_too() -> None:
    """A learned cell: every neighbour its own coefficients, a sideways bias, a smooth root."""
    scene, rng = make_scene(NET, gravity=9.8), np.random.default_rng(3)
    cell = Cell(rng.normal(size=(12, 3)) * [1e6, 1e4, 200], rng.normal(size=3), eps=1e-5)
    state = crumpled(scene)
    controls = Controls.hold(state, ())
    for in_place in (True, False):
        want = twin.step(scene, state, controls, cell, in_place=in_place)
        got = state.copy()
        make_kernel(scene, cell, in_place=in_place, dtype="float64").advance(state, got, controls, 1)
        assert abs(got.velocities - want.velocities).max() <= 400 * np.finfo(float).eps * abs(want.velocities).max()


def test_threads_and_batches_change_nothing() -> None:
    scene = make_scene(NET, steps=8, gravity=9.8, pressure=True, colliders=(BALL,), handles=(0, 10))
    state = crumpled(scene)
    both = ParticleSolver(scene, num_envs=2, threads=2)
    both.reset(state)
    got = both.advance(moving(scene, state))
    for i in range(2):
        one = ParticleSolver(scene)
        one.reset(state.select([i]))
        controls = Controls(**{name: value[[i]] for name, value in vars(moving(scene, state)).items()})
        assert np.array_equal(one.advance(controls).positions[0], got.positions[i])


def test_springs_are_the_slope_of_their_energy() -> None:
    scene = make_scene(FREE, 4, 5)
    x = crumpled(scene, 1, 0.3).positions
    force = twin.cell_forces(mass_spring_cell(scene), x, 0 * x)
    direction, e = np.random.default_rng(1).normal(size=x.shape), 1e-7
    slope = (twin.spring_energy(scene, x + e * direction) - twin.spring_energy(scene, x - e * direction)) / (2 * e)
    # A central difference errs by e^2 times the third derivative, about Y / L^2: (1e-7 / L)^2, and by eps E / e.
    assert -(force * direction).sum() == pytest.approx(slope[0], rel=1e-6)


@pytest.mark.parametrize(
    ("dashpot", "in_place", "kept"), [(200.0, False, True), (0.0, True, True), (200.0, True, False)]
)
def test_momentum_is_kept_unless_dashpots_see_new_velocities(dashpot: float, in_place: bool, kept: bool) -> None:
    """From one end of a dashpot the other's velocity is old, from the other end new: the author's loop."""
    scene = make_scene(replace(FREE, dashpot=dashpot), steps=64)
    start = crumpled(scene, 1)
    end, kernel = start.copy(), make_kernel(scene, mass_spring_cell(scene), in_place=in_place, dtype="float64")
    kernel.advance(start, end, Controls.hold(start, ()), 1)

    def moments(state: State) -> np.ndarray:
        x, v = (a[0].reshape(3, -1) for a in (state.positions, state.velocities))
        return np.concatenate([v.sum(1), np.cross(x, v, axis=0).sum(1)])

    assert abs(end.velocities - start.velocities).max() > 0.5
    # Angular momentum: x moves by h v after v has changed, so x cross v is kept by the step too. 64 steps of rounding.
    scale, change = abs(start.velocities).sum(), abs(moments(end) - moments(start)).max()
    assert change < 64 * np.finfo(float).eps * scale if kept else change > 0.01 * scale


def test_the_kernel_refuses_neighbours_that_its_waves_do_not_order() -> None:
    scene, law = make_scene(NET), mass_spring_cell(make_scene(NET))
    for offset in ((1, -2), (-1, 3), (0, 0), (5, 0)):
        options = {"bias": law.bias, "eps": 0.0, "node_mass": 1.0, "decay": 1.0, "keep": 1.0, "substeps": 1}
        with pytest.raises(ValueError, match="in reach"):
            kernels.Particles64(
                kernel_sheet(scene),
                neighbours=np.array([offset], np.int32),
                coefficients=law.coefficients[:1].copy(),
                in_place=True,
                **options,
            )


def test_a_rotated_net_moves_rotated() -> None:
    scene = make_scene(NET, steps=8, pressure=True)
    state = crumpled(scene, 1)
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))  # no mirror: pressure has a side
    ends = []
    for matrix in (np.eye(3), turn):
        solver = ParticleSolver(scene, dtype="float64")
        solver.reset(State.still(np.einsum("ij,bjhw->bihw", matrix, state.positions)))
        solver.state.velocities[:] = np.einsum("ij,bjhw->bihw", matrix, state.velocities)
        end = solver.advance(moving(scene, solver.state))
        ends.append(np.einsum("ji,bjhw->bihw", matrix, end.velocities))
    # As in a frame of everything, and a rotation's rounding before it.
    assert abs(ends[0] - ends[1]).max() < 2 * 8 * 400 * np.finfo(float).eps * abs(ends[0]).max()


def test_pressure_pushes_a_flat_net_by_its_corners() -> None:
    """``p L^2`` for each of the 4 corners around a particle, 2 on the border, 1 at its ends; upwards."""
    scene = make_scene(NET, 5, 6, pressure=True)
    state = crumpled(scene, 1, 0.0)
    corners = np.ones(5)[:, None] * np.ones(6) * 4
    corners[[0, -1]] /= 2
    corners[:, [0, -1]] /= 2
    force = twin.pressure_forces(state.positions, np.array([1000.0]))
    assert np.allclose(force[0, 2], 1000.0 * NET.spacing**2 * corners, rtol=1e-12)
    assert np.allclose(force[0, :2], 0)


def test_falling_with_drag_is_a_geometric_sum() -> None:
    """``v' = (v - g h) q`` with ``q = exp(-3 h)``: after n steps ``v = -g h q (1 - q^n) / (1 - q)``."""
    scene = make_scene(NET, steps=64, gravity=9.8)
    solver = ParticleSolver(scene, dtype="float64")
    solver.reset(State.still(crumpled(scene, 1, 0.0).positions))
    end = solver.advance(Controls.hold(solver.state, ()))
    h, q = NET.sim_dt, np.exp(-NET.drag * NET.sim_dt)
    # Edges at rest are off by a rounding of the positions, which springs of Y / L turn to h Y eps * 11 * 64.
    assert abs(end.velocities[0, 2] + 9.8 * h * q * (1 - q**64) / (1 - q)).max() < 1e-11
    assert abs(end.velocities[0, :2]).max() < 1e-11


def test_stretch_and_diagonals_are_those_of_the_nearest_sheet() -> None:
    """The tension of a sheet stretched by e along a row: stretch plus shear stiffness times width and e."""
    scene, strain = make_scene(FREE, 30, 12), 1e-6
    x = crumpled(scene, 1, 0.0).positions
    x[:, 0] *= 1 + strain
    force = twin.cell_forces(mass_spring_cell(scene), x, 0 * x)
    tension = -force[0, 0, :, 6:].sum()
    sheet = NET.sheet()
    width = np.array([30, 29]) * NET.spacing  # one spring a row, two diagonals a cell
    want = strain * (sheet.stretch_stiffness * width[0] + sheet.shear_stiffness * width[1])
    # The diagonals' stretch is not linear: a relative error of about e.
    assert tension == pytest.approx(want, rel=2 * strain + 1e-7)
    mass = sheet.areal_density * NET.spacing**2
    assert mass == pytest.approx(NET.node_mass)


def test_halving_the_step_halves_the_error() -> None:
    scene = make_scene(NET, steps=16, gravity=9.8)
    ends = []
    for refine in (1, 2, 4, 32):
        solver = ParticleSolver(scene, dtype="float64", refine=refine)
        solver.reset(crumpled(scene, 1, 0.05))
        ends.append(solver.advance(Controls.hold(solver.state, ())).positions)
    errors = [abs(end - ends[-1]).max() for end in ends[:-1]]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # First order; the reference's own error, 1/32 of the first, adds log2((1 - 1/32) / (1/2 - 1/32)) - 1 = 0.05, the
    # next terms of the error some.
    assert (abs(orders - 1) < 0.35).all(), orders


def test_dashpots_and_drag_only_take_energy() -> None:
    scene = make_scene(NET, steps=4)
    solver = ParticleSolver(scene, dtype="float64", refine=4)
    solver.reset(crumpled(scene, 1, 0.05))

    def energy() -> float:
        state = solver.state
        return float(twin.spring_energy(scene, state.positions)[0] + NET.node_mass * (state.velocities**2).sum() / 2)

    energies = [energy()]
    for _ in range(20):
        solver.advance(Controls.hold(solver.state, ()))
        energies.append(energy())
    assert (np.diff(energies) < 0).all()
    assert energies[-1] < 0.5 * energies[0]


def test_the_scene_tells_what_it_is() -> None:
    scene = make_scene(NET, gravity=9.8, pressure=True, colliders=(BALL,))
    text = scene.describe()
    told = ("Y = 10000 N", "in place, row by row", "springs at distance two", "four corners a vertex")
    for words in (*told, "velocity inside times 0.95"):
        assert words in text
    assert (scene.mass == NET.node_mass).all()
    assert len(NEIGHBOURS) == len({tuple(offset) for offset in NEIGHBOURS.tolist()}) == 12


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: reference(make_scene(NET), solver="admm"), ["'admm'", "net of particles", "'explicit'"]),
        (lambda: reference(make_scene(NET), solver="implicit"), ["'implicit'", "net of particles"]),
        (lambda: reference(make_scene(NET), substeps=3), ["'substeps'", "'refine'"]),
        (lambda: ParticleSolver(replace(make_scene(NET), particles=None)), ["sheet", "'zhao2024'"]),
        (lambda: ParticleSolver(replace(make_scene(NET), air=Air())), ["no air"]),
        (lambda: ParticleSolver(replace(make_scene(NET), colliders=(Collider("plane"),))), ["spheres"]),
        (lambda: ParticleSolver(replace(make_scene(NET), grid=Grid(9, 9, 1.0, 1.0))), ["spacing", "resolution"]),
        (lambda: ParticleSolver(replace(make_scene(NET), frame_dt=1e-3)), ["whole number"]),
        (lambda: ParticleSolver(make_scene(NET), refine=0), ["refine"]),
        (lambda: ParticleSolver(make_scene(NET)).check_material(FREE.sheet()), ["no material"]),
        (lambda: Particles(stiffness=0.0), ["stiffness", "positive"]),
        (lambda: Particles(drag=float("nan")), ["drag", "finite"]),
    ],
)
def test_bad_arguments_name_the_remedy(build, words: list[str]) -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        build()
    assert all(word in str(caught.value) for word in words), str(caught.value)
