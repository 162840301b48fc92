"""The compiled fine cloth is what the upscaler's own methods say, on any number of threads, and its health is found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from _minicloth_kernels import Fine
from gymnasium.utils.seeding import np_random

from cloth_envs.failure import find
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.solver import kernel_sheet
from cloth_envs.scene import Scene
from cloth_envs.state import State
from cloth_envs.world import World
from surrogates.upscale.local import Local
from surrogates.upscale.protocol import Interpolation

BATCH, FRAMES = 3, 12


class Called(Local):
    """The network by its methods."""

    def positions(self, history: Sequence[State]) -> np.ndarray:
        return super().positions(history)

    def velocities(self, history: Sequence[State]) -> np.ndarray:
        return super().velocities(history)


class Squared(Interpolation):
    """Biquadratic interpolation by its methods."""

    def __init__(self, *scenes: object) -> None:
        super().__init__(*scenes, kind="quadratic")  # type: ignore[arg-type]

    def positions(self, history: Sequence[State]) -> np.ndarray:
        return super().positions(history)

    def velocities(self, history: Sequence[State]) -> np.ndarray:
        return super().velocities(history)


def run(scene: str, **options: object) -> World:
    """A batch after some frames of full actions."""
    world = World(scene, num_envs=BATCH, backend="miniature", backend_kwargs={"factor": 4, **options})
    world.reset({i: np_random(i)[0] for i in range(BATCH)})
    for _ in range(FRAMES):
        world.step(np.ones((BATCH, len(world.task.actions))))
    return world


@pytest.mark.parametrize("scene", ["Curtain", "BallDrop"])
@pytest.mark.parametrize(("name", "called"), [("local", "Called"), ("biquadratic", "Squared")])
def test_the_compiled_cloth_is_what_the_methods_say(scene: str, name: str, called: str) -> None:
    options = {"scaling": "closure", "mend": False}  # or a network's half spacing would be mended too
    found, expected = (run(scene, upscaler=up, **options) for up in (name, f"{__name__}:{called}"))
    np.testing.assert_array_equal(found.state.positions, expected.state.positions)
    np.testing.assert_array_equal(found.state.velocities, expected.state.velocities)


def test_threads_do_not_change_it() -> None:
    one, more = run("BallDrop"), run("BallDrop", threads=2)
    np.testing.assert_array_equal(one.state.positions, more.state.positions)
    np.testing.assert_array_equal(one.state.velocities, more.state.velocities)


def test_its_health_is_that_of_the_cloth_that_moves() -> None:
    world = run("Collision")
    state, coarse = world.state, world.backend.coarse  # type: ignore[attr-defined]
    assert state.health == find(coarse.scene.grid, coarse.state)
    assert state.health != find(world.scene.grid, state)
    assert state.read_only().health == state.health
    assert state.copy().health is None  # whoever changes a copy changes what is found
    world.reset({0: np.random.default_rng(5)})
    assert world.state.health == find(coarse.scene.grid, coarse.state)  # of the other members too
    assert world.failures.check(state, state) == {}


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_solver_prepares_the_next_state_in_its_own_type(dtype: str) -> None:
    """From controls of any type."""
    world = World("Collision", backend_kwargs={"dtype": dtype})
    world.reset({0: np_random(0)[0]})
    controls = world.task.controls(world.episode)
    controls.colliders = controls.colliders.astype(np.float32)
    after = world.backend.advance(controls)
    assert {a.dtype.name for a in (after.positions, after.velocities, after.colliders, after.collider_velocities)} == {
        dtype
    }
    np.testing.assert_array_equal(after.colliders, controls.colliders)
    np.testing.assert_array_equal(after.collider_velocities, controls.collider_velocities.astype(dtype))
    assert after.time == world.scene.frame_dt


def test_only_firm_handles_are_put_where_they_are_driven() -> None:
    """The last of three, by the last row of what is driven."""
    scene = Scene("sheet", Grid(5, 5, 1.0, 1.0), Material(), 0.01, handles=(0, 4, 20))
    nobody, driven = np.zeros(0, np.int32), np.arange(18.0).reshape(2, 1, 3, 3)
    kernel = Fine(kernel_sheet(scene), np.array([2], np.int32), nobody, nobody, nobody.astype(np.float32), 1e-5, 1e-5)
    coarse, (x, v) = np.zeros((1, 3, 3, 3), np.float32), np.zeros((2, 1, 3, 5, 5), np.float32)
    bodies, told = np.zeros((1, 0, 2, 3), np.float32), [np.zeros(1, t) for t in (np.int32, np.float32, np.int32)]
    bias = np.zeros((0, 0), np.float32)
    kernel.fill(coarse, coarse, None, bias, *[None] * 7, 0.5, *driven, bodies, bodies, x, v, *told, 1)
    for field, rows in zip((x, v), driven, strict=True):
        expected = np.zeros((3, 25))
        expected[:, 20] = rows[0, 2]
        np.testing.assert_array_equal(field.reshape(3, 25), expected)
