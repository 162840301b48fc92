"""The torch cell of sheets against the reference's definition, and what training needs of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.laws import air
from cloth_envs.physics.laws.bodies import resolve_body
from cloth_envs.physics.laws.sheet import damped_spring_forces, gravity_forces
from cloth_envs.physics.laws.step import slow_forces
from cloth_envs.registry import SCENES, make_backend
from cloth_envs.scene import Air, Collider, Scene
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from surrogates.cell.compiled import CLASSES
from surrogates.cell.frame import air_forces, contact, frame
from surrogates.cell.sheet import SheetCell, properties

EPS = np.finfo(float).eps
SCENE = Scene("sheet", Grid(6, 8, 0.5, 0.8), Material(), 0.004, (0, 7), air=Air(max_wind=12.0), pressure=True)
YIELDING = {"compression": 0.1, "buckling_strain": 0.02, "post_buckling": 0.4, "compression_damping": 5.0}
LINEAR = [Material(), Material(0.3, 700.0, 90.0, 1e-4, 1e-4, 1.0)]
MATERIALS = [LINEAR[0], LINEAR[1].with_changes(**YIELDING)]


def waved(scene: Scene, seed: int = 0) -> State:
    """Two crumpled sheets with velocities of about 1 m/s."""
    rng = np.random.default_rng(seed)
    v, u = np.meshgrid(*(np.linspace(0, 1, n) for n in scene.grid.shape), indexing="ij")
    flat = np.stack([u * scene.grid.width, -v * scene.grid.height, 0 * u])
    state = State.still(flat + 0.02 * rng.normal(size=(2, *flat.shape)))
    state.velocities[:] = rng.normal(size=state.velocities.shape)
    return state


def tensors(state: State) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.from_numpy(state.positions), torch.from_numpy(state.velocities)


def test_forces_are_the_references() -> None:
    state = waved(SCENE)
    x, v = tensors(state)
    cell = SheetCell(SCENE, dtype=torch.float64)
    got = cell(x, v, properties(MATERIALS, x)).detach().numpy()
    bare = replace(SCENE, air=None, pressure=False)
    want = damped_spring_forces(bare.grid, MATERIALS, state.positions, state.velocities)
    want = want + slow_forces(bare, MATERIALS, state, Controls.hold(state, bare.handles))
    want = want + gravity_forces(bare.grid, MATERIALS, state.positions, bare.gravity)
    assert abs(got - want).max() < 64 * EPS * abs(want).max()
    wind, pressure = np.array([[3.0, -2.0, 1.0], [0.0, 6.0, -1.0]]), np.array([30.0, -8.0])
    got = air_forces(SCENE, x, v, torch.from_numpy(wind), torch.from_numpy(pressure)).numpy()
    want = air.air_forces(SCENE, state.positions, state.velocities, wind)
    want = want + air.pressure_forces(SCENE.grid, state.positions, pressure)
    assert abs(got - want).max() < 64 * EPS * abs(want).max()


@pytest.mark.parametrize("kind", ["sphere", "capsule", "plane"])
def test_contact_is_the_references(kind: str) -> None:
    rng = np.random.default_rng(1)
    body = Collider(kind, 0.0 if kind == "plane" else 0.3, 0.4)
    x0 = rng.normal(size=(3, 3, 500)) * 0.4
    x1, v = x0 + 0.1 * rng.normal(size=x0.shape), rng.normal(size=x0.shape)
    start = rng.normal(size=(3, 2, 3)) * 0.2
    if kind == "sphere":
        start[:, 1] = start[:, 0]
    end = start + 0.02 * rng.normal(size=(3, 1, 3))
    if kind == "plane":
        start[:, 1] = end[:, 1] = [0.0, 0.6, 0.8]
    given = (x0, x1, v, start, end)
    want = resolve_body(body, *given, 0.01, 1e-2)
    got = contact(body, *(torch.from_numpy(a) for a in given), 0.01, 1e-2)
    assert (abs(want[0] - x1).max(1) > 0).mean() > 0.05  # dozens touch
    for one, other in zip(got, want, strict=True):
        # A quotient by the way of a vertex through the body, 1e-2 of the sizes at least.
        assert abs(one.numpy() - other).max() < 1e4 * EPS * max(1.0, abs(other).max())


@pytest.mark.parametrize("scene", sorted({*SCENES} - {"Skirt"}))  # a tube, which the torch engine refuses
def test_frames_are_the_compiled_engines(scene: str) -> None:
    options = {"resolution": (11, 9), "num_envs": 2, "randomize": {"areal_density": (0.1, 0.3)}}
    ends = []
    for engine in ("compiled", "torch"):
        world = World(scene, backend="cnn", backend_kwargs={"engine": engine, "dtype": "float64"}, **options)
        world.reset({i: np.random.default_rng(3 + i) for i in range(2)})
        action = np.random.default_rng(0).uniform(-1, 1, (2, len(world.task.actions)))
        for _ in range(3):
            world.step(action)
        ends.append(world.state)
    # Hundreds of stable substeps of rounding on positions of a few metres.
    assert abs(ends[0].positions - ends[1].positions).max() < 1e4 * EPS


def test_shortened_springs_yield_as_in_the_compiled_engine() -> None:
    scene = World("Hanging", resolution=(11, 9), self_contact=False).scene
    state, ends = State.still(waved(scene).positions), []
    for engine in ("compiled", "torch"):
        backend = make_backend("cnn", scene, num_envs=2, backend_kwargs={"engine": engine, "dtype": "float64"})
        for material in (scene.material, scene.material.with_changes(**YIELDING)):
            backend.reset(state, [material] * 2)
            for _ in range(2):
                ends.append(backend.advance(Controls.hold(state, scene.handles)).positions)
    stiff, yielding = slice(0, 2), slice(2, 4)
    # Hundreds of stable substeps of rounding on positions of a few metres.
    assert np.abs(np.array(ends[:4]) - ends[4:]).max() < 1e4 * EPS
    assert np.abs(np.array(ends[stiff]) - ends[yielding]).max() > 0.01


def test_momentum_is_kept_whatever_was_learned() -> None:
    rng = np.random.default_rng(2)
    numbers = rng.uniform(0.5, 1.5, len(CLASSES))
    numbers[-3:] = 0.0
    x, v = tensors(waved(SCENE))
    force = SheetCell(SCENE, numbers, dtype=torch.float64)(x, v, properties(MATERIALS, x)).detach()
    largest = float(force.abs().max())
    assert float(force.sum((2, 3)).abs().max()) < 48 * 12 * EPS * largest
    moment = torch.linalg.cross(x, force, dim=1).sum((2, 3)).abs().max()
    assert float(moment) < 48 * 12 * EPS * largest


def test_a_frame_has_the_slope_that_differences_have() -> None:
    scene = replace(SCENE, colliders=(Collider("sphere", 0.2),))
    state = waved(scene)
    state = State.still(state.positions, np.broadcast_to([0.4, -0.25, -0.21], (2, 1, 2, 3)))
    state.velocities[:, 2] = -0.5
    controls = Controls.hold(state, scene.handles)
    controls.wind[:, 0], controls.pressure[:] = 3.0, 5.0
    x, v = tensors(state)
    sheets = properties(LINEAR, x)  # without jumps of the slope
    cell = SheetCell(scene, dtype=torch.float64)

    def loss() -> torch.Tensor:
        after, _ = frame(cell, scene, sheets, x, v, state, controls, 20)
        return ((after - x) ** 2).sum()

    loss().backward()
    slope, e = cell.numbers.grad.clone(), 1e-5
    assert torch.isfinite(slope).all()
    direction = torch.randn(len(CLASSES), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    values = []
    with torch.no_grad():
        for sign in (1, -1):
            cell.numbers += sign * e * direction
            values.append(loss().item())
            cell.numbers -= sign * e * direction
    # A central difference: e^2 times the third derivative, and eps over e.
    assert float(slope @ direction) == pytest.approx((values[0] - values[1]) / (2 * e), rel=1e-4)


def test_forces_plug_in_and_tubes_are_refused() -> None:
    scene = World("Hanging", resolution=(7, 7)).scene
    state = State.still(waved(replace(SCENE, grid=scene.grid)).positions)
    lift = torch.tensor([0.0, 0.0, scene.gravity])[:, None, None] * torch.as_tensor(scene.mass)
    ends = []
    for forces in ((), (lambda x, v: lift.to(x),)):
        options = {"engine": "torch", "dtype": "float64", "forces": forces}
        backend = make_backend("cnn", scene, num_envs=2, backend_kwargs=options)
        backend.reset(state)
        ends.append(backend.advance(Controls.hold(state, scene.handles)).velocities[:, 2].mean())
    assert ends[1] - ends[0] > 0.5 * scene.gravity * scene.frame_dt  # all but what the handle holds
    with pytest.raises(ValueError, match="compiled"):
        SheetCell(replace(scene, grid=replace(scene.grid, periodic=True)))
