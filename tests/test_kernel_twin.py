"""The compiled kernel against its NumPy twin: every term alone, all together, and whole frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.laws.step import step
from cloth_envs.scene import Air, Collider, Scene
from cloth_envs.state import Controls, State

GRIDS = {
    "square": Grid(6, 6, 0.5, 0.5),
    "wide": Grid(5, 8, 0.3, 0.9),
    "tall": Grid(19, 18, 0.9, 0.4),
    "smallest": Grid(3, 3, 0.2, 0.3),
    "tube": Grid(6, 7, 0.5, 0.8, periodic=True),
    "smallest tube": Grid(3, 3, 0.2, 0.3, periodic=True),
    "even tube": Grid(4, 20, 0.3, 0.9, periodic=True),
}
NOTHING = Material(0.2, 1e-12, 0.0, 0.0, damping=0.0, drag=0.0)  # stretch can't be zero
SHEETS = [
    Material(0.2, 500.0, 150.0, 1e-3, 5e-5, 0.5),
    Material(0.4, 90.0, 10.0, 2e-4, 2e-4, 0.0, compression=0.1),
    Material(0.3, 200.0, 40.0, 0.0, 1e-5, 0.2, 0.2, buckling_strain=0.1, post_buckling=0.3, compression_damping=8.0),
    Material(),
]
TERMS: dict[str, tuple[dict[str, float], dict[str, object]]] = {
    "stretch": ({"stretch_stiffness": 500.0}, {}),
    "shear": ({"shear_stiffness": 150.0}, {}),
    "wrinkled": ({"stretch_stiffness": 500.0, "shear_stiffness": 90.0, "compression": 0.05}, {}),
    "buckled": (
        {"stretch_stiffness": 500.0, "shear_stiffness": 90.0, "buckling_strain": 0.1, "post_buckling": 0.2},
        {},
    ),
    "wrinkles damped": ({"stretch_stiffness": 300.0, "damping": 1e-4, "compression_damping": 10.0}, {}),
    "damped": ({"stretch_stiffness": 300.0, "shear_stiffness": 90.0, "damping": 1e-3}, {}),
    "bend": ({"bend_stiffness": 1e-3, "twist": 0.0}, {}),
    "bend and twist": ({"bend_stiffness": 1e-3, "twist": 0.9}, {}),
    "drag": ({"drag": 3.0}, {}),
    "gravity": ({}, {"gravity": 9.81}),
    "air": ({}, {"air": Air(normal=1.5, lift=0.0, tangential=0.2)}),
    "lift": ({}, {"air": Air(normal=0.0, lift=1.3, tangential=0.0)}),
    "pressure": ({}, {"pressure": True}),
    "air and pressure": ({}, {"air": Air(normal=0.7, lift=0.6, tangential=0.9), "pressure": True}),
}


def crumpled(grid: Grid, batch: int, amount: float = 0.3) -> State:
    """Random positions ``amount`` spacings around flat sheets or tubes, random velocities of about 1 m/s."""
    rng = np.random.default_rng(1)
    r, c = np.indices(grid.shape)
    x = amount * min(grid.row_spacing, grid.col_spacing) * rng.normal(size=(batch, 3, *grid.shape))
    x[:, 0] += c * grid.col_spacing
    x[:, 1] -= r * grid.row_spacing
    if grid.periodic:
        angle = 2 * np.pi * c / grid.cols
        x[:, 0] += grid.width / 6 * np.cos(angle) - c * grid.col_spacing
        x[:, 2] += grid.width / 6 * np.sin(angle)
    state = State.still(x)
    state.velocities[:] = rng.normal(size=x.shape)
    return state


def controls_for(scene: Scene, state: State, seed: int = 2) -> Controls:
    """Handles, bodies, wind and pressure that all move and differ over the batch."""
    rng = np.random.default_rng(seed)
    controls = Controls.hold(state, scene.handles)
    for name in ("handle_positions", "colliders"):
        getattr(controls, name)[:] += 0.02 * rng.normal(size=getattr(controls, name).shape)
    for name in ("handle_velocities", "collider_velocities"):
        getattr(controls, name)[:] = rng.normal(size=getattr(controls, name).shape)
    controls.wind[:] = 3 * rng.normal(size=(state.batch, 3))
    controls.pressure[:] = 5 * rng.normal(size=state.batch)
    for number, body in enumerate(scene.colliders):  # a plane keeps its normal, the others their axis
        for end, start in ((controls.colliders, state.colliders), (controls.collider_velocities, None)):
            axis = 0 if start is None else start[:, number, 1] - (body.kind != "plane") * start[:, number, 0]
            end[:, number, 1] = axis + (body.kind != "plane") * end[:, number, 0]
    return controls


def with_bodies(state: State, bodies: tuple[Collider, ...]) -> State:
    """``state`` with bodies at rest that touch the middle of the cloth."""
    middle = state.positions.mean((2, 3))[:, None]
    places = {
        "sphere": middle + [[0, 0, -0.05]] * 2,
        "plane": 0 * middle + [[0, 0, -0.02], [0, 0.6, 0.8]],
        "capsule": middle + np.array([[-0.1, 0, 0.08], [0.1, 0.02, 0.08]]),
    }
    state.colliders = np.stack([places[body.kind] for body in bodies], 1)
    state.collider_velocities = np.zeros_like(state.colliders)
    return state


def without_bodies(what: State | Controls) -> State | Controls:
    """A copy with no bodies."""
    return replace(what, colliders=what.colliders[:, :0], collider_velocities=what.collider_velocities[:, :0])


def compare(
    scene: Scene, state: State, materials: list[Material], dtype: str, tolerance: float, refine: int = 1
) -> State:
    """Assert that kernel and twin agree over one frame; the largest difference is scaled by the largest change."""
    backend = ExplicitSolver(scene, num_envs=state.batch, dtype=dtype, refine=refine)
    backend.reset(state, materials)
    state = state.astype(dtype)
    controls = controls_for(scene, state)
    got = backend.advance(controls)
    want = step(scene, state, controls, backend.last_cuts, materials)
    for name in ("positions", "velocities"):
        change = getattr(want, name) - getattr(state, name)
        error = abs(getattr(got, name) - getattr(want, name)).max()
        assert error <= tolerance * abs(change).max() + 4 * np.finfo(dtype).eps * abs(getattr(want, name)).max(), name
        assert getattr(got, name).dtype == dtype
    return want


@pytest.mark.parametrize("term", TERMS)
@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
def test_one_substep_of_each_term(grid: Grid, term: str) -> None:
    changes, options = TERMS[term]
    base = [replace(NOTHING, areal_density=density) for density in (0.2, 0.5)]
    materials = [
        m.with_changes(**{k: v * f for k, v in changes.items()}) for m, f in zip(base, (1.0, 0.6), strict=True)
    ]
    scene = Scene("term", grid, materials[0], 1e-5, **{"gravity": 0.0, **options})  # type: ignore[arg-type]
    # The change of a velocity is a difference: eps |v| / |dv| is lost, |dv| of 1e-5 s * 1 m/s^2 at least.
    compare(scene, crumpled(grid, 2), materials, "float64", 1e-10)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
def test_shear_is_the_mean_over_the_corners_at_an_inner_vertex(grid: Grid, dtype: str) -> None:
    """Where those above may count against those below, those to the left against those to the right."""
    state = crumpled(grid, 3)
    x, v = state.positions.astype(dtype), state.velocities.astype(dtype)
    down = np.diff(x.astype(float), axis=2)[..., 1:-1]  # above, then below each inner vertex
    along = np.diff(x.astype(float), axis=3)[:, :, 1:-1]
    corners = [[(d * a).sum(1) for a in (along[..., :-1], along[..., 1:])] for d in (down[:, :, :-1], down[:, :, 1:])]
    sums = [abs(np.einsum("i,j,ij...", p, q, corners)) for p in ([1, 1], [1, -1]) for q in ([1, 1], [1, -1])]
    sines = np.max(sums, axis=(0, 2, 3)) / (4 * grid.row_spacing * grid.col_spacing)
    solver = ExplicitSolver(Scene("shear", grid, NOTHING, 1e-5), num_envs=3, dtype=dtype)
    exact = 1e-12 if dtype == "float64" else 1e-5
    np.testing.assert_allclose(solver._kernel.shear(x), sines, rtol=exact)
    parts = [np.linalg.norm(np.diff(v.astype(float), axis=axis), axis=1).max((1, 2)) for axis in (2, 3)]
    np.testing.assert_allclose(solver._kernel.apart(v), np.maximum(*parts), rtol=exact)


@pytest.mark.parametrize("kind", ["sphere", "plane", "capsule"])
@pytest.mark.parametrize("friction", [0.0, 0.5, 5.0])
def test_one_substep_of_contact(kind: str, friction: float) -> None:
    bodies = (Collider(kind, 0.0 if kind == "plane" else 0.07, friction),)
    scene = Scene("contact", GRIDS["tall"], NOTHING, 2e-3, colliders=bodies)
    state = with_bodies(crumpled(scene.grid, 2), bodies)
    want = compare(scene, state, [NOTHING] * 2, "float64", 1e-12)
    flying = step(replace(scene, colliders=()), without_bodies(state), controls_for(scene, state), 1)
    assert 0.01 < (abs(want.velocities - flying.velocities).max(1) > 1e-9).mean() < 1  # some touch, some do not


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
def test_a_frame_of_everything(grid: Grid, dtype: str) -> None:
    bodies = (Collider("sphere", 0.1, 0.4), Collider("plane", friction=0.2), Collider("capsule", 0.06, 0.3))
    scene = Scene(
        "all", grid, SHEETS[0], 2e-3, handles=(0, grid.cols - 1, grid.vertices - 2), air=Air(), pressure=True,
        colliders=bodies,
    )  # fmt: skip
    state = with_bodies(crumpled(grid, len(SHEETS), 0.1), bodies)
    controls = controls_for(scene, state)
    # Tens of substeps; each can amplify a rounding a few times where crumpled edges are short, or where bodies overlap.
    want = compare(scene, state, SHEETS, dtype, 4e4 * float(np.finfo(dtype).eps), refine=2)
    assert np.isfinite(want.positions).all()
    bare = step(replace(scene, colliders=()), without_bodies(state), without_bodies(controls), 10, SHEETS)
    assert abs(bare.positions - want.positions).max() > 1e-3  # the bodies do touch


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("grid", [*GRIDS.values(), Grid(33, 9, 1.0, 0.4)], ids=[*GRIDS, "long"])
def test_a_batch_is_bit_equal_to_its_members(grid: Grid, dtype: str) -> None:
    """Whether a cloth has the lanes of the vectors to itself or shares them with others, of other materials too."""
    bodies = (Collider("sphere", 0.1, 0.4), Collider("plane", friction=0.2))
    scene = Scene("many", grid, SHEETS[0], 4e-3, (0, grid.cols - 1), air=Air(max_wind=12.0), colliders=bodies)
    materials, batch = [SHEETS[i % 3] for i in range(21)], 21
    state = with_bodies(crumpled(grid, batch, 0.1), bodies).astype(dtype)
    controls = controls_for(scene, state)
    ends = []
    for members in ([[*range(batch)]], [[i] for i in range(batch)], [[*range(18)], [18, 19, 20]]):
        for which in members:
            solver = ExplicitSolver(scene, num_envs=len(which), dtype=dtype, threads=2)
            solver.reset(state.select(which), [materials[i] for i in which])
            part = Controls(**{name: value[which] for name, value in vars(controls).items()})
            ends.append(solver.advance(part).copy())
    whole, parts = ends[0], ends[1:]
    for name in ("positions", "velocities"):
        assert np.isfinite(getattr(whole, name)).all()
        for group in (parts[:batch], parts[batch:]):
            np.testing.assert_array_equal(getattr(whole, name), np.concatenate([getattr(s, name) for s in group]))


def test_states_in_fortran_order_are_stepped_alike() -> None:
    scene = Scene("order", Grid(9, 7, 1.0, 0.8), Material(), 0.01)
    state = crumpled(scene.grid, 1)
    ends = []
    for start in (state, replace(state, **{n: np.asfortranarray(a) for n, a in state.arrays().items()})):
        backend = ExplicitSolver(scene)
        backend.reset(start)
        ends.append(backend.advance(controls_for(scene, state)).positions)
    np.testing.assert_array_equal(*ends)
