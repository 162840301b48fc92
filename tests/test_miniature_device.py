"""The miniature on a device: frames of the compiled one, at some vertices as in the whole cloth, and what is told."""

from __future__ import annotations

from itertools import chain
from typing import Any

import numpy as np
import pytest
import torch
from on_tensors import DEVICES, actions_of, assert_same, frail, made
from test_upscale_twin import crumpled, network

from cloth_envs.failure import find
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.scene import Collider, Scene
from cloth_envs.state import Cloth, Controls, State
from cloth_envs.tensors import to_device, to_host
from cloth_envs.world import World
from surrogates.miniature.coarse import coarse_scene
from surrogates.miniature.fine import Fine
from surrogates.miniature.handles import Handles
from surrogates.miniature.places import Moment, Places
from surrogates.upscale.local import Local
from surrogates.upscale.local_features import spacing
from surrogates.upscale.protocol import INTERPOLATIONS, Upscaler, make_upscaler

EPS = float(np.finfo(np.float32).eps)
N, FRAMES = 2, 10
PLAIN = {"mend": False, "guard": False}
ORDERS: list[dict[str, bool]] = [{}, {"backwards": True}, {"spare": True}]
SHAPE = {"Curtain": (49, 33), "Flag": (17, 25), "Collision": (25, 17), "Pressure": (17, 17), "BallDrop": (17, 17)}
ENDS = {
    "sphere": [[0.5, 0.0, -0.5], [0.5, 0.0, -0.5]],
    "capsule": [[0.2, 0.05, -0.6], [0.8, -0.05, -0.3]],
    "plane": [[0.0, -0.02, 0.0], [0.0, 1.0, 0.0]],
}


def world(scene: str, *, num_envs: int = N, **options: Any) -> World:
    """Members of different materials, without what a device does not have; begun."""
    made = World(
        scene, backend="miniature", num_envs=num_envs, self_contact=False, randomize={"areal_density": [0.18, 0.25]},
        resolution=SHAPE[scene], backend_kwargs=options if "device" in options else PLAIN | options,
    )  # fmt: skip
    made.reset({i: np.random.default_rng(i) for i in range(num_envs)})
    return made


def step(made: World, frames: int = 1, seed: int = 0) -> World:
    rng = np.random.default_rng(seed)
    for _ in range(frames):
        made.step(rng.uniform(-1, 1, (made.num_envs, len(made.task.actions))))
    return made


def inner(made: World) -> Any:
    """The backend on the device, under what brings its arrays to the host."""
    return made.backend.backend  # type: ignore[attr-defined]


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("factor", [2, 4])
@pytest.mark.parametrize("scene", ["Pressure", "Collision"])
def test_frames_are_those_of_the_compiled_miniature(scene: str, factor: int, device: str) -> None:
    there, here = step(world(scene, factor=factor, device=device), 3), step(world(scene, factor=factor), 3)
    solver, grid = inner(there).solver, here.scene.grid
    # What rounding leaves after three frames of calm cloth; velocities are those of waves, of frequencies below 2 / h.
    close, rate = 1e-5 * max(grid.height, grid.width), 2 * solver.last_cuts.max().item() / here.scene.frame_dt
    np.testing.assert_allclose(there.state.positions, here.state.positions, rtol=0, atol=close)
    np.testing.assert_allclose(there.state.velocities, here.state.velocities, rtol=0, atol=rate * close)
    coarse = State(**{name: to_host(value) for name, value in solver.state.arrays().items()})
    found = find(solver.scene.grid, coarse)
    np.testing.assert_allclose(to_host(inner(there).state.health), found, rtol=1e-4, atol=1e-5)
    assert there.state.health is not None


def assert_same_cloth(
    scene: Scene, handles: Handles, upscaling: Upscaler, coarse: State, controls: Controls, device: str = "cpu", *,
    bias: np.ndarray | None = None, gain: float = 1.0,
) -> np.ndarray:  # fmt: skip
    """Hold ``Places``, whoever's turn it is first, to the processor's kernel, for one coarse cloth, so that no chaos
    parts them. Returns what bodies pushed.
    """
    fine = Fine(scene, handles, upscaling)
    fine.begin(coarse.batch)
    wanted = fine([coarse], controls)
    vertices, where = np.arange(scene.grid.vertices), torch.device(device, 0)
    places = [Places(scene, handles, upscaling, vertices, where, **order) for order in ORDERS]
    there = State(**{name: to_device(value, where) for name, value in coarse.arrays().items()})
    driven = [to_device(field, where) for field in (controls.handle_positions, controls.handle_velocities)]
    biases = to_device(np.zeros((coarse.batch, 0), np.float32) if bias is None else bias, where)
    now = Moment.of(there, driven, biases)
    ends = [each(now) for each in places]
    assert device != "cpu" or all(torch.equal(a, b) for end in ends[1:] for a, b in zip(end, ends[0], strict=True))
    for found, field in zip(chain(*ends), len(ends) * wanted, strict=True):
        # Numbers of up to 4, a few dozen of them summed, and a network's of a tenth of that. The kernel leaves what
        # handles are off by where it is below ROUNDING, a third of this.
        np.testing.assert_allclose(to_host(found).reshape(field.shape), field, rtol=0, atol=64 * 4 * EPS * gain)
    return fine.pushed


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("factor", [2, 3, 4])
@pytest.mark.parametrize("scene", SHAPE)
def test_the_network_says_what_the_kernel_says(scene: str, factor: int, device: str) -> None:
    made = step(world(scene, num_envs=5, factor=factor, scaling="closure", upscaler="local"), 3)  # a block has four
    assert made.controls is not None
    miniature: Any = made.backend
    coarse, upscaling = miniature.coarse, miniature.upscaling
    bias = upscaling.biases(made.materials)
    assert_same_cloth(miniature.scene, coarse.handles, upscaling, coarse.state, made.controls, device, bias=bias)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("hidden", [(), (16, 24)])
def test_networks_of_any_depth(hidden: tuple[int, ...], device: str) -> None:
    scene = Scene("sheet", Grid(13, 9, 1.0, 1.0), Material(), 0.01, handles=(0, 8))
    coarse, handles = coarse_scene(scene, 2, scene.material)
    arrays = network(hidden)
    upscaling = Local(coarse, scene, 2, arrays=arrays)
    materials = [scene.material] * N
    upscaling.set_materials(range(N), materials)
    state, controls = State.still(crumpled(coarse.grid)), Controls.hold(State.still(crumpled(scene.grid)), (0, 8))
    # Of a patch's numbers, below 4 spacings, layers amplify rounding by at most the largest sums of their weights.
    gain = np.prod([np.abs(arrays[f"weight{k}"]).sum(1).max() for k in range(len(hidden) + 1)])
    assert_same_cloth(
        scene, handles, upscaling, state, controls, device, bias=upscaling.biases(materials),
        gain=max(1.0, gain * spacing(coarse.grid)),
    )  # fmt: skip


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("upscaler", INTERPOLATIONS)
@pytest.mark.parametrize("body", ENDS)
def test_handles_pull_and_bodies_push_as_the_kernel_has_it(body: str, upscaler: str, device: str) -> None:
    grid, rng = Grid(13, 9, 1.0, 1.0), np.random.default_rng(0)
    radius = 0.0 if body == "plane" else 0.2
    bodies = (Collider(body, radius), Collider("sphere", 0.2))
    scene = Scene("sheet", grid, Material(), 0.01, colliders=bodies, handles=(0, 8, 58, 60))
    coarse, handles = coarse_scene(scene, 3, scene.material)
    ends = np.tile(np.array([ENDS[body], ENDS["sphere"]], np.float32), (2, 1, 1, 1))
    state = State.still(crumpled(coarse.grid), ends)
    state.positions[:, :, -1, 0] = ENDS["sphere"][0]  # in the middle of a body
    state.velocities[:] = rng.normal(size=state.velocities.shape)
    state.collider_velocities[:, :, :, 0] = 0.3
    controls = Controls.hold(State.still(crumpled(grid), state.colliders), scene.handles)
    controls.handle_positions += rng.normal(0, 0.05, controls.handle_positions.shape)
    controls.handle_velocities[:] = rng.normal(size=controls.handle_velocities.shape)
    pushed = assert_same_cloth(scene, handles, make_upscaler(upscaler, coarse, scene, 3), state, controls, device)
    assert (pushed > 0).all()


def test_some_vertices_are_those_of_the_whole_cloth_also_of_members_that_begin_anew() -> None:
    made = step(world("Collision", num_envs=4, factor=3, device="cpu"))
    vertices = np.random.default_rng(0).permutation(made.scene.grid.vertices)[:30]

    def assert_same() -> None:
        state = inner(made).state
        for some, whole in zip(state.at(vertices), (state.positions, state.velocities), strict=True):
            assert some.shape == (4, 3, 30)
            # Rows of the same matrices, by columns in another order: a few dozen numbers below 1 are summed.
            np.testing.assert_allclose(some, whole.flatten(2)[:, :, vertices], rtol=0, atol=32 * EPS)
        cloth = Cloth(*(torch.full_like(field, np.nan) for field in (state.positions, state.velocities)))
        state.put(vertices, cloth)
        for field, some in zip(cloth, state.at(vertices), strict=True):
            assert torch.equal(field.flatten(2)[:, :, vertices], some)
            assert field.isnan().sum() == field.numel() - some.numel()  # and nothing else is written

    assert_same()
    handle = made.scene.pins[0]  # of which a network says nothing
    assert torch.equal(inner(made).state.at([handle]).positions, inner(made).state.positions.flatten(2)[:, :, [handle]])
    before = inner(made).state.positions.clone()
    for members in ([1, 3], [0, 3]):
        made.reset({i: np.random.default_rng(10 + i) for i in members})
        assert_same()
    now, start = inner(made).state.positions, world("Collision", num_envs=4, factor=3, device="cpu").task
    assert torch.equal(now[2], before[2])
    for i in (0, 1, 3):
        rng = np.random.default_rng(10 + i)
        rng.uniform(0.18, 0.25)  # the density
        drawn = {name: np.asarray(value)[None] for name, value in start.draw(rng).items()}
        np.testing.assert_array_equal(now[i], start.lay(drawn).positions[0].astype(np.float32))
    for which in ([1], [2], [2, 0]):
        some, every = inner(made).state.select(torch.tensor(which)), inner(made).state
        assert (some.now is None) == (which == [1])  # of given cloths nothing is computed
        assert some.now is None or len(some.now.positions) == len(which)
        for name, value in some.arrays().items():
            np.testing.assert_allclose(value, getattr(every, name)[which], rtol=0, atol=32 * EPS)
    step(made)
    assert_same()


def test_states_are_saved_and_restored_across_the_two() -> None:
    there, here = world("Pressure", factor=4, device="cpu"), world("Pressure", factor=4)
    close = 1e-5 * there.scene.grid.height
    for one, other in ((there, here), (here, there)):
        other.set_state(step(one, 2, seed=1).get_state())
        for each in (one, other):
            step(each, 2, seed=2)
        np.testing.assert_allclose(other.state.positions, one.state.positions, rtol=0, atol=close)
    saved = there.get_state()
    later = step(there, 2).state.positions
    there.set_state(saved)
    np.testing.assert_array_equal(step(there, 2).state.positions, later)


@pytest.mark.parametrize("device", DEVICES)
def test_vector_environments_are_those_of_the_compiled_miniature(device: str) -> None:
    """Also where members fail and start again."""
    options: dict[str, Any] = {"backend": "miniature", "resolution": (17, 17), "self_contact": False}
    usual = {"factor": 2, "scaling": "closure", "upscaler": "local"}
    there = frail(made("Pressure", backend_kwargs=usual | {"device": device}, output="torch", **options))
    here = frail(made("Pressure", backend_kwargs=usual | PLAIN, **options))
    assert_same(there.reset(seed=1)[0], here.reset(seed=1)[0])
    rng, failed = np.random.default_rng(0), 0
    for _ in range(FRAMES):
        actions = actions_of(here, rng)
        found, wanted = there.step(torch.tensor(actions, device=device)), here.step(actions)
        for flags, expected in zip(found[2:4], wanted[2:4], strict=True):
            np.testing.assert_array_equal(to_host(flags), expected)
        np.testing.assert_allclose(to_host(found[1]), wanted[1], rtol=0, atol=1e-4)  # velocities part before them
        assert found[4].get("failure", np.zeros(0)).tolist() == wanted[4].get("failure", np.zeros(0)).tolist()
        failed += wanted[2].sum()
    assert 0 < failed < FRAMES * here.num_envs


ABSENT = {
    "the usual": ({}, "closure, local: on a device without mended edges and a guard"),
    "interpolation": ({"upscaler": "bicubic"}, ""),
    "a correction": (
        {"scaling": "closure", "upscaler": "ridge", "guard": False, "correction": "learned"},
        "closure, ridge: on a device without correction='learned' and mended edges",
    ),
    "published": ({"scaling": "similar", "upscaler": "fc"}, "similar, bicubic: on a device without upscaler='fc'"),
}


@pytest.mark.parametrize(("options", "told"), ABSENT.values(), ids=ABSENT)
def test_what_a_device_does_not_have_is_told(options: dict[str, Any], told: str) -> None:
    made = world("Curtain", factor=4, device="cpu", **options)
    assert made.surrogate.tolist() == [told] * N
    assert told in made.describe()
    assert made.scene.self_contact is None


def test_beyond_the_card_both_are_told() -> None:
    made = World("Flag", backend="miniature", backend_kwargs={"device": "cpu"}, material={"compression": 0.5})
    made.reset({0: np.random.default_rng(0)})
    assert made.surrogate.tolist() == ["similar, bicubic: compression 0.5, fitted on 1"]


REFUSED = {
    "solver": ({"solver": "admm"}, "leave solver, solver_kwargs and mend out, or device"),
    "mend": ({"mend": True}, "leave solver, solver_kwargs and mend out, or device"),
    "strict": ({"strict": True, "scaling": "closure", "correction": "learned"}, "leave strict or device out"),
    "correction": ({"correction": "learnd"}, "correction.*'learned'"),
    "upscaler": ({"upscaler": "locl"}, "local"),
    "device": ({"device": "cudda"}, "device='cudda' can't be used"),
}


@pytest.mark.parametrize(("options", "advice"), REFUSED.values(), ids=REFUSED)
def test_what_no_device_can_do_is_refused(options: dict[str, Any], advice: str) -> None:
    with pytest.raises(ValueError, match=advice):
        World("Curtain", backend="miniature", backend_kwargs={"device": "cpu", "factor": 4} | options)
