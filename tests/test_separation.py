"""Folds of upscaled cloths are drawn out of each other, towards the facets of the coarse cloth."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from gymnasium.utils.seeding import np_random

from cloth_envs import policies
from cloth_envs.world import World
from surrogates.miniature.fine import Fine
from surrogates.miniature.mending import Mending
from surrogates.miniature.upscaled import Upscaled
from training.metrics.contact import crossing_triangles


def upscaled(world: World) -> Upscaled:
    assert isinstance(world.backend, Upscaled)
    return world.backend


@pytest.mark.parametrize(
    ("name", "factor", "frames", "resolution"),
    [("BallDrop", 4, 110, None), ("Hanging", 2, 240, None), ("Curtain", 4, 100, None), ("Collision", 4, 90, (58, 39))],
)
def test_folds_do_not_cross_where_the_coarse_ones_do_not(
    name: str, factor: int, frames: int, resolution: tuple[int, int] | None
) -> None:
    options = {"factor": factor}
    world = World(name, resolution=resolution, self_contact=True, backend="miniature", backend_kwargs=options)
    backend, (plain, _) = upscaled(world), fine_cloths(world)
    world.reset({0: np_random(12)[0]})
    actions = policies.open_loop("bang-bang", frames, world.action_space.shape[0], world.scene.frame_dt, 12)
    grid, crossed = world.scene.grid, {"coarse": 0, "fine": 0, "plain": 0}
    for action in actions.astype(np.float32):
        world.step(action[None])
        state, controls = world.state, world.controls
        assert controls is not None
        drawn = plain(backend.coarse.history, controls)
        near = np.linalg.norm(drawn.positions - state.positions, axis=1).max()
        assert near < 0.5 * factor * world.scene.grid.row_spacing
        clear = np.array_equal(drawn.positions, state.positions)
        tangled = int(crossing_triangles(grid, drawn.positions)[0])
        assert clear == (tangled == 0)  # nothing else moves
        crossed["plain"] += tangled
        crossed["fine"] += int(crossing_triangles(grid, state.positions)[0])
        crossed["coarse"] += int(crossing_triangles(backend.coarse.scene.grid, backend.coarse.history[-1].positions)[0])
    assert crossed["plain"] > 20
    assert crossed["coarse"] == crossed["fine"] == 0


def fine_cloths(world: World) -> tuple[Fine, Fine]:
    """What draws the cloth of ``world`` with folds that cross, and what draws them out of each other."""
    backend = upscaled(world)
    parts = backend.coarse.handles, backend.upscaling
    mending = Mending.of(backend.upscaling, backend.coarse.handles.vertices)
    alone = replace(world.scene, self_contact=None)
    made = [Fine(scene, *parts, mending=mending) for scene in (alone, world.scene)]
    for fine in made:
        fine.begin(1)
    return made[0], made[1]


@pytest.mark.parametrize("noise", [0.2, 0.25])
def test_no_crossing_is_missed_however_crumpled_the_cloth_is(noise: float) -> None:
    """Triangles are turned over inside of cells that as a whole are not."""
    world = World("Curtain", self_contact=True, backend="miniature", backend_kwargs={"factor": 2})
    plain, apart = fine_cloths(world)
    world.reset({0: np_random(0)[0]})
    world.step(np.zeros((1, world.action_space.shape[0]), np.float32))
    coarse, controls, rng = upscaled(world).coarse.history[-1], world.controls, np.random.default_rng(0)
    assert controls is not None
    tangled, cell = 0, world.scene.grid.row_spacing * 2
    for _ in range(200):
        crumpled = coarse.copy()
        crumpled.positions[:] += noise * cell * rng.normal(size=coarse.positions.shape)
        drawn = plain([crumpled], controls).positions
        crossings = int(crossing_triangles(world.scene.grid, drawn)[0])
        assert (crossings == 0) == np.array_equal(drawn, apart([crumpled], controls).positions)
        tangled += crossings > 0
    assert tangled > 20


# A flag's coarse cloth beside its pole, in cells from the pole's upper end: found under bang-bang actions.
CREASED = np.array(
    [
        [[-0.37, -0.28, -0.11], [-0.27, -1.16, -0.26], [0.46, -0.62, -0.72], [0.17, 0.19, -1.27]],
        [[0.2, -0.02, -0.97], [-0.51, -0.67, -1.09], [0.22, -1.18, -1.51], [0.29, -0.35, -2.08]],
        [[-0.27, 0.36, -1.9], [-0.61, -0.56, -2], [-0.4, -1.47, -2.27], [0.22, -0.93, -2.84]],
        [[-0.7, 0.55, -2.88], [-0.65, -0.41, -2.98], [-0.83, -1.32, -3.17], [0.06, -1.5, -3.61]],
    ]
).transpose(2, 0, 1)


def test_facets_that_cross_at_a_common_vertex_are_drawn_apart() -> None:
    """Their pair is not counted, but pairs of the smaller triangles that lie in them are."""
    options = {"factor": 2, "scaling": "closure", "upscaler": "local"}
    world = World("Flag", resolution=(7, 9), self_contact=True, backend="miniature", backend_kwargs=options)
    _, apart = fine_cloths(world)
    world.reset({0: np_random(0)[0]})
    world.step(np.zeros((1, 2), np.float32))
    coarse, controls = upscaled(world).coarse.history[-1].copy(), world.controls
    assert controls is not None
    grid, x = upscaled(world).coarse.scene.grid, coarse.positions
    x[0, ..., 1:] = x[0, :, :1, :1] + grid.row_spacing * CREASED
    assert crossing_triangles(grid, x)[0] == 0
    assert crossing_triangles(world.scene.grid, facets(x))[0] > 0
    assert crossing_triangles(world.scene.grid, apart([coarse], controls).positions)[0] == 0


def facets(x: np.ndarray) -> np.ndarray:
    """The triangles of a coarse cloth ``(1, 3, h, w)``, each divided into four."""
    fine = np.empty((1, 3, *(2 * n - 1 for n in x.shape[2:])), np.float32)
    fine[..., ::2, ::2], fine[..., 1::2, ::2] = x, (x[..., 1:, :] + x[..., :-1, :]) / 2
    fine[..., ::2, 1::2] = (x[..., 1:] + x[..., :-1]) / 2
    fine[..., 1::2, 1::2] = (x[..., 1:, 1:] + x[..., :-1, :-1]) / 2
    return fine


@pytest.mark.parametrize("noise", [0.3, 0.5, 0.8])
def test_where_the_coarse_cloth_crosses_no_more_is_drawn_than_its_facets_have(noise: float) -> None:
    world = World("Curtain", resolution=(33, 25), self_contact=True, backend="miniature", backend_kwargs={"factor": 2})
    plain, apart = fine_cloths(world)
    world.reset({0: np_random(0)[0]})
    world.step(np.zeros((1, world.action_space.shape[0]), np.float32))
    coarse, controls, rng = upscaled(world).coarse.history[-1], world.controls, np.random.default_rng(1)
    assert controls is not None
    tangled, fewer, grid, cell = 0, 0, upscaled(world).coarse.scene.grid, world.scene.grid.row_spacing * 2
    for _ in range(40):
        crumpled = coarse.copy()
        crumpled.positions[:, :, 4:] += noise * cell * rng.normal(size=coarse.positions[:, :, 4:].shape)  # none is held
        tangled += crossing_triangles(grid, crumpled.positions)[0] > 0
        most, drawn, smooth = (
            int(crossing_triangles(world.scene.grid, cloth)[0])
            for cloth in (
                facets(crumpled.positions),
                apart([crumpled], controls).positions,
                plain([crumpled], controls).positions,
            )
        )
        assert drawn <= most
        fewer += drawn < smooth
    assert tangled > 20
    assert fewer > 20


def test_threads_and_batches_change_no_bit() -> None:
    found = []
    for members, threads in ((3, 1), (3, 2), (1, 1)):
        options = {"factor": 4, "threads": threads}
        world = World("Hanging", num_envs=members, backend="miniature", backend_kwargs=options)
        world.reset({i: np_random(5 + i)[0] for i in range(members)})
        for _ in range(50):
            world.step(np.zeros((members, 3), np.float32))
        found.append(copy.copy(world.state.positions))
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0][:1], found[2])


def test_crossings_of_the_coarse_cloth_are_told() -> None:
    world = World("Hanging", backend="miniature", backend_kwargs={"factor": 4})
    world.reset({0: np_random(0)[0]})
    tangled = world.state.copy()
    grid = world.scene.grid
    tangled.positions[0, 0] = 0.05 * np.sin(np.linspace(0, 40, grid.rows * grid.cols)).reshape(grid.shape)
    world.set_positions(tangled.positions[0], np.zeros_like(tangled.positions[0]))
    world.step(np.zeros((1, 3), np.float32))
    assert world.crossings[0] > 0
