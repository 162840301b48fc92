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
    [("BallDrop", 4, 110, None), ("Hanging", 2, 150, None), ("Curtain", 4, 100, None), ("Collision", 4, 90, (58, 39))],
)
def test_folds_do_not_cross_where_the_coarse_ones_do_not(
    name: str, factor: int, frames: int, resolution: tuple[int, int] | None
) -> None:
    options = {"factor": factor}
    world = World(name, resolution=resolution, self_contact=True, backend="miniature", backend_kwargs=options)
    backend = upscaled(world)
    mending = Mending.of(backend.upscaling, backend.coarse.handles.vertices)
    alone = replace(world.scene, self_contact=None)
    plain = Fine(alone, backend.coarse.handles, backend.upscaling, mending=mending)
    plain.begin(1)
    world.reset({0: np_random(12)[0]})
    actions = policies.open_loop("bang-bang", frames, world.action_space.shape[0], world.scene.frame_dt, 12)
    crossed = {"coarse": 0, "fine": 0, "plain": 0}
    for action in actions.astype(np.float32):
        world.step(action[None])
        state, controls = world.state, world.controls
        assert controls is not None
        drawn = plain(backend.coarse.history, controls)
        near = np.linalg.norm(drawn.positions - state.positions, axis=1).max()
        assert near < 0.5 * factor * world.scene.grid.row_spacing
        clear = np.array_equal(drawn.positions, state.positions)
        tangled = int(crossing_triangles(alone.grid, drawn.positions)[0])
        assert clear == (tangled == 0)  # nothing else moves
        crossed["plain"] += tangled
        crossed["fine"] += int(crossing_triangles(alone.grid, state.positions)[0])
        crossed["coarse"] += int(crossing_triangles(backend.coarse.scene.grid, backend.coarse.history[-1].positions)[0])
    assert crossed["plain"] > 20
    assert crossed["coarse"] == crossed["fine"] == 0


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
