"""What a graphics card runs, thread by thread here: against the solver's twin, and as an environment's backend."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import _minicloth_kernels as kernels
import gymnasium as gym
import numpy as np
import pytest
import torch

from cloth_envs.failure import find
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.gpu.card import MOST_THREADS, plan
from cloth_envs.physics.gpu.solver import CardSolver
from cloth_envs.physics.gpu.terms import cloths_of
from cloth_envs.physics.laws.step import step
from cloth_envs.registry import make_backend
from cloth_envs.scene import Air, Collider, Scene
from cloth_envs.scenes.task import Task
from cloth_envs.state import Controls, State
from cloth_envs.tensors import to_host
from cloth_envs.world import World
from tests.on_tensors import DEVICES
from tests.test_kernel_twin import GRIDS, NOTHING, SHEETS, TERMS, controls_for, crumpled, with_bodies

EPS = float(np.finfo(np.float32).eps)
ORDERS = [{"strip": 4}, {"strip": 1, "backwards": True}, {"strip": 4, "backwards": True}]


def on_card(scene: Scene, state: State, materials: list[Material], controls: Controls, **order: object) -> CardSolver:
    """After one frame."""
    solver = CardSolver(scene, num_envs=state.batch, device="cpu", **order)
    solver.reset(state, materials)
    solver.advance(controls)
    return solver


def compare(scene: Scene, state: State, materials: list[Material], tolerance: float) -> CardSolver:
    """Assert that a frame is the twin's, in no longer steps than the compiled solver's, whoever's turn it is first."""
    state = state.astype("float32")
    controls, cutter = controls_for(scene, state), ExplicitSolver(scene, num_envs=state.batch)
    cutter.reset(state, materials)
    cutter.advance(controls)
    ends = [on_card(scene, state, materials, controls, **order) for order in ORDERS]
    cuts = ends[0].last_cuts.numpy()
    assert (cuts[:, 0] >= cutter.last_cuts[:, 0]).all()
    want = step(scene, state, controls, cuts, materials)
    for solver in ends:
        np.testing.assert_array_equal(solver.last_cuts, cuts)
        for name in ("positions", "velocities"):
            got, expected = getattr(solver.state, name).numpy(), getattr(want, name)
            change = abs(expected - getattr(state, name)).max()
            assert abs(got - expected).max() <= tolerance * change + 8 * EPS * abs(expected).max(), name
    for name in ("positions", "velocities"):  # a phase that read what another thread of it wrote would tell
        np.testing.assert_array_equal(getattr(ends[0].state, name), getattr(ends[2].state, name))
    return ends[0]


@pytest.mark.parametrize("term", TERMS)
@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
def test_one_substep_of_each_term(grid: Grid, term: str) -> None:
    changes, options = TERMS[term]
    material = NOTHING.with_changes(**changes)
    scene = Scene("term", grid, material, 1e-4, **{"gravity": 0.0, **options})  # type: ignore[arg-type]
    state = crumpled(grid, 2)
    state.velocities[:] = np.round(state.velocities, 2)
    # A change of dv is a difference of velocities of about 1 m/s: 8 eps of those are allowed beside 1e-5 of it.
    compare(scene, state, [material] * 2, 1e-5)


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
def test_a_frame_of_everything(grid: Grid) -> None:
    bodies = (Collider("sphere", 0.1, 0.4), Collider("plane", friction=0.2), Collider("capsule", 0.06, 0.3))
    scene = Scene(
        "all", grid, SHEETS[0], 2e-3, handles=(0, grid.cols - 1, grid.vertices - 2), air=Air(), pressure=True,
        colliders=bodies,
    )  # fmt: skip
    state = with_bodies(crumpled(grid, len(SHEETS), 0.1), bodies)
    compare(scene, state, SHEETS, 1e4 * EPS)  # as the compiled kernel's


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("name", ["Flag", "Curtain", "Collision", "Pressure", "Hanging", "BallDrop"])
def test_frames_of_the_scenes_are_as_exact_as_the_compiled_solvers(name: str, device: str) -> None:
    """Over two frames, before chaos: as near to float64 as its float32 is, but for a few roundings."""
    world = World(name, num_envs=2, resolution=(17, 13), self_contact=False)
    world.reset({i: np.random.default_rng(40 + i) for i in range(2)})
    card = CardSolver(world.scene, num_envs=2, device=device)
    exact = ExplicitSolver(world.scene, num_envs=2, dtype="float64")
    for solver in (card, exact):
        solver.reset(world.state)
    rng = np.random.default_rng(4)
    for _ in range(2):
        world.step(rng.uniform(-1, 1, (2, len(world.task.actions))).astype(np.float32))
        got, true = card.advance(world.controls), exact.advance(world.controls)
    errors = [
        np.sqrt(((x - true.positions) ** 2).sum(1).mean()) for x in (to_host(got.positions), world.state.positions)
    ]
    assert errors[0] <= 3 * errors[1] + 4 * EPS * world.scene.grid.height
    for told, found in zip(got.health.tolist(), find(world.scene.grid, world.state), strict=True):
        np.testing.assert_allclose(told, found, rtol=1e-3, atol=1e-5)


def test_many_handles_soft_ones_and_large_sheets() -> None:
    """Numbers of handles over a byte; forces that wait in global memory."""
    grid = Grid(20, 20, 1.0, 1.0)
    scene = Scene("many", grid, Material(), 4e-3, handles=tuple(range(300)), air=Air())
    compare(scene, crumpled(grid, 1, 0.05), [Material()], 1e4 * EPS)


def test_what_is_fast_is_stepped_in_shorter_steps_that_hold_nothing() -> None:
    grid = Grid(9, 9, 1.0, 1.0)
    scene = Scene("fast", grid, Material(), 0.01, air=Air())
    state = crumpled(grid, 2, 0.0)
    state.velocities[:] = 0
    state.velocities[1, 2] = 60.0
    controls = Controls.hold(state, ())
    solver = on_card(scene, state, [Material()] * 2, controls)
    slow, fast = solver.last_cuts.tolist()
    assert fast[0] > slow[0]
    assert fast[1] == 1 < slow[1]
    reference = ExplicitSolver(scene, num_envs=2)
    reference.reset(state)
    want = reference.advance(controls).positions
    assert fast[0] >= reference.last_cuts[1, 0]
    assert abs(solver.state.positions.numpy() - want).max() < 2e-3 * 0.6  # of 0.6 m in other steps: to first order in h


@pytest.mark.parametrize("order", ORDERS)
def test_a_frame_that_is_lost_in_too_long_steps_is_stepped_again(
    order: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As if it had been stepped in short ones at once: nothing is left of the first time."""
    scene = Scene("again", Grid(17, 13, 1.0, 1.0), Material(), 0.04, handles=(0, 1), air=Air())
    state = crumpled(scene.grid, 2, 0.02).astype("float32")
    state.velocities[:] = 0
    ends = []
    for first, last in ((20, 200), (200, 200), (20, 20)):

        def cut(*given: Any, cuts: tuple[int, int] = (first, last)) -> np.ndarray:
            cloths = cloths_of(*given)
            cloths["cuts"] = [(count, 1) for count in (cuts[0], *cuts)]
            return cloths

        monkeypatch.setattr("cloth_envs.physics.gpu.solver.cloths_of", cut)
        ends.append(on_card(scene, state, [Material()] * 2, Controls.hold(state, scene.handles), **order))
    again, once, lost = ends
    assert not lost.state.health[:, 0].any()
    assert again.last_cuts[:, 0].tolist() == [200, 200]
    np.testing.assert_array_equal(again.state.positions, once.state.positions)
    np.testing.assert_array_equal(again.state.velocities, once.state.velocities)


def test_a_cloth_that_is_not_finite_is_told() -> None:
    scene = Scene("lost", Grid(5, 5, 1.0, 1.0), Material(), 0.01)
    state = crumpled(scene.grid, 2, 0.05)
    state.velocities[1, 0, 2, 2] = np.nan
    solver = on_card(scene, state, [Material()] * 2, Controls.hold(state, ()))
    assert solver.state.health[:, 0].tolist() == [1, 0]


def test_members_are_replaced_with_their_materials() -> None:
    scene = Scene("some", Grid(7, 5, 1.0, 0.8), SHEETS[0], 2e-3, handles=(0,), air=Air())
    state = crumpled(scene.grid, 3, 0.1).astype("float32")
    both = CardSolver(scene, num_envs=3, device="cpu")
    both.reset(state)
    both.reset(state.select([1]), [SHEETS[2]], [1])
    both.advance(controls_for(scene, state))
    alone = on_card(scene, state, [SHEETS[0], SHEETS[2], SHEETS[0]], controls_for(scene, state))
    np.testing.assert_array_equal(both.state.positions, alone.state.positions)
    with pytest.raises(ValueError, match="holds 3 cloths, expected 1"):
        both.reset(state, which=[0])


def test_the_cell_steps_what_it_was_identified_to_be() -> None:
    task: type[Task] = World("Flag", resolution=(9, 13)).task.__class__
    scene = replace(task.make_scene(resolution=(9, 13), material=task.material), self_contact=None)
    state = World("Flag", resolution=(9, 13), self_contact=False)
    state.reset({0: np.random.default_rng(0)})
    ends = []
    for device in ("emulated", "cpu"):
        backend = make_backend("cnn", scene, backend_kwargs={"device": device})
        backend.reset(state.state)
        ends.append(np.asarray(backend.advance(Controls.hold(state.state, scene.handles)).positions))
    assert abs(ends[0] - ends[1]).max() < 40 * EPS


@pytest.mark.parametrize("shape", [(9, 13), (33, 49), (73, 49), (65, 65), (109, 105), (3, 700)])
def test_every_vertex_has_a_thread(shape: tuple[int, int]) -> None:
    chosen = plan(*shape, 100_000, 232_448)
    strips = -(-shape[0] // chosen.strip)
    assert strips * shape[1] <= chosen.threads <= MOST_THREADS
    assert chosen.threads % 32 == 0


def test_what_a_card_can_not_do_is_told() -> None:
    def make(**kwargs: object) -> object:
        preset = kwargs.pop("preset", None)
        return gym.make_vec("MiniCloth-Hanging-v0", num_envs=2, backend="cnn", preset=preset, backend_kwargs=kwargs)

    with pytest.raises(ValueError, match="float32"):
        make(device="emulated", dtype="float64")
    with pytest.raises(ValueError, match="net of particles"):
        make(device="emulated", preset="zhao2024")
    with pytest.raises(ValueError, match='forces belong to engine="torch"'):
        make(device="emulated", forces=[np.sin])
    if not torch.cuda.is_available():
        with pytest.raises(ValueError, match=r"device='cuda' can't be used .*\[gpu\]"):
            make(device="cuda")
    with pytest.raises(ValueError, match="self_contact=True"):
        gym.make_vec(
            "MiniCloth-Flag-v0", num_envs=1, backend="cnn", self_contact=True, backend_kwargs={"device": "emulated"}
        )


def test_the_text_for_a_card_needs_no_other_file() -> None:
    text = kernels.card_text()
    assert "#include" not in text
    assert "minicloth_frame" in text
    with pytest.raises(ValueError, match="not a CardSheet"):
        kernels.card_memory(b"")
