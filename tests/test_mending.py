"""Edges of upscaled cloths are brought to their lengths: the kernel against NumPy, where it acts, and what it does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.seeding import np_random

import cloth_envs
from cloth_envs.grid import Grid
from cloth_envs.physics.laws.diagnostics import strain
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from surrogates.miniature.coarse import coarse_grid
from surrogates.miniature.mending import BUCKLING, SLACK, Level, mend, mends
from surrogates.upscale.protocol import Upscaler

EPS = float(np.finfo(np.float32).eps)
SHAPES = [(3, 3), (4, 5), (21, 18), (9, 33), (33, 49)]  # fewer and more columns than lanes, odd and even


def crumpled(shape: tuple[int, int]) -> tuple[Grid, np.ndarray]:
    """Two sheets of a metre's width in waves, shortened by up to a fifth here and lengthened there."""
    grid, rng = Grid(*shape, 0.8, 1.0), np.random.default_rng(0)
    v, u = np.meshgrid(*(np.linspace(0, 1, n) for n in shape), indexing="ij")
    x = np.stack([0.9 * u + 0.03 * np.sin(5 * u + v), 0.05 * np.cos(4 * u - 3 * v), -0.75 * v + 0.02 * np.sin(6 * v)])
    return grid, (x + rng.normal(0, 1e-3, (2, *x.shape))).astype(np.float32)


def pull(x: np.ndarray, first: int, axis: int, length: float, shorter: float) -> None:
    """Edges from every second line across ``axis`` to the next one, in place."""
    count = (x.shape[axis] - first) // 2
    a, b = (np.moveaxis(x, axis, -1)[..., first + side :: 2][..., :count] for side in (0, 1))
    square = ((b - a) ** 2).sum(1, keepdims=True)
    over = (square - length**2) / (square + length**2)
    change = (np.maximum(over - SLACK, 0) - shorter * np.maximum(-over, 0)) / 2 * (b - a)
    a += change
    b -= change


def wave(grid: Grid, x: np.ndarray, steep: float) -> np.ndarray:
    """``x`` with the zigzag that it begins with."""
    along, down = x[..., 1:-1, 2:] - x[..., 1:-1, :-2], x[..., 2:, 1:-1] - x[..., :-2, 1:-1]
    normal = np.cross(down, along, axis=1)
    zigzag = [np.array([0, 1, 0, -1])[np.arange(1, n - 1) % 4] for n in grid.shape]
    lines = (zigzag[0][:, None], down, grid.row_spacing), (zigzag[1], along, grid.col_spacing)
    depths = [
        z * d * np.sqrt(2 * np.maximum(1 - np.linalg.norm(e, axis=1) / (2 * d) - BUCKLING, 0)) for z, e, d in lines
    ]
    out = x.copy()
    out[..., 1:-1, 1:-1] += steep * (depths[0] + depths[1])[:, None] * normal / np.linalg.norm(normal, axis=1)[:, None]
    return out


@pytest.mark.parametrize("shape", SHAPES)
def test_the_kernel_is_its_twin(shape: tuple[int, int]) -> None:
    grid, start = crumpled(shape)
    held = [0, grid.vertices - 2]
    level = Level(3, 0.6, 0.0)
    x, flat = start.astype(np.float64), start.reshape(2, 3, -1)
    for _ in range(level.sweeps):
        for axis, length in ((3, grid.col_spacing), (2, grid.row_spacing)):
            for first in (0, 1):
                pull(x, first, axis, length, level.shorter)
        x.reshape(flat.shape)[..., held] = flat[..., held]
    found = start.copy()
    mend(grid, held, level).apply(found)
    # Positions of up to 1 m are rounded in each of 4 pulls a sweep, which moves both ends by less than what is off.
    np.testing.assert_allclose(found, x, atol=4 * level.sweeps * 2 * EPS)
    assert np.abs(found - start).max() > 0.01 * grid.col_spacing

    found = start.copy()
    mend(grid, held, Level(0, 1.0, 0.5)).apply(found)
    expected = wave(grid, start.astype(np.float64), 0.5)
    expected.reshape(flat.shape)[..., held] = flat[..., held]
    # Two estimates of 1 / sqrt (4e-4 each) of an amplitude below half a spacing; and where cloth is shortened by hardly
    # more than BUCKLING, the root of what rounding (EPS over two spacings) makes of the strain.
    spacing = max(grid.row_spacing, grid.col_spacing)
    rounding = np.sqrt(2 * 4 * EPS / (2 * min(grid.row_spacing, grid.col_spacing)))
    np.testing.assert_allclose(found, expected, atol=spacing * (0.5 * 8e-4 + 0.5 * rounding))
    assert np.abs(found - start).max() > 0.02 * spacing


def test_a_cloth_at_rest_stays() -> None:
    """Neither edges at rest nor those that are pulled by less than the slack are changed by more than rounding."""
    grid = Grid(17, 25, 1.0, 1.5)
    v, u = np.meshgrid(*(np.linspace(0, s, n) for s, n in zip((1.0, 1.5), grid.shape, strict=True)), indexing="ij")
    for stretch in (1.0, 1 + SLACK / 2):
        start = (stretch * np.stack([u, 0 * u, -v]))[None].astype(np.float32)
        found = start.copy()
        mend(grid, [], Level(6, 1.0, 1.0)).apply(found)
        np.testing.assert_allclose(found, start, atol=16 * EPS)


def test_it_acts_where_cloth_folds() -> None:
    for name, preset in (("Curtain", None), ("Pressure", None), ("Curtain", "lee2019"), ("BallDrop", None)):
        scene = World(name, preset=preset).scene
        assert mends(scene, coarse_grid(scene.grid, 4)) == (name != "Pressure" and preset is None)
    assert not mends(scene, scene.grid)
    tube = replace(scene, grid=replace(scene.grid, periodic=True))
    assert not mends(tube, coarse_grid(tube.grid, 4))


@pytest.mark.parametrize("factor", [2, 3, 4])
def test_edges_are_nearer_to_their_lengths_and_frames_need_no_others(factor: int) -> None:
    """Strain is less than 0.6 of what it is without; and whether earlier frames were read or not changes nothing."""
    made = [
        World("Hanging", num_envs=2, backend="miniature", backend_kwargs={"factor": factor, **options})
        for options in ({}, {}, {"mend": False, "guard": False})
    ]
    action = np.ones((2, 3))
    for world in made:
        world.reset({i: np_random(i)[0] for i in range(2)})
    controls: list[Controls] = []
    for k in range(25):
        made[0].step(action if k % 10 < 5 else -action)
        assert made[0].controls is not None
        controls.append(made[0].controls)
    unread, plain = (world.backend for world in made[1:])
    for control in controls:
        now, other = unread.advance(control), plain.advance(control)
    np.testing.assert_array_equal(now.positions, made[0].state.positions)
    found, without = (strain(world.scene.grid, s.positions).p99 for world, s in ((made[0], now), (made[2], other)))
    assert (found < 0.6 * without).all()
    handles = list(made[0].scene.handles[:1])
    np.testing.assert_array_equal(*(s.positions.reshape(2, 3, -1)[..., handles] for s in (now, other)))


class Torn(Upscaler):
    """Bicubic, but for a vertex two metres away."""

    def positions(self, history: Sequence[State]) -> np.ndarray:
        x = self.bicubic(history[-1].positions)
        x[..., 8, 8] += 2.0
        return x


@pytest.mark.parametrize("guard", [True, False])
def test_no_episode_ends_for_how_its_cloth_is_drawn(guard: bool) -> None:
    """The coarse cloth, which moves, is sound; where the guard draws another one, ``info`` says so."""
    options = {"upscaler": f"{__name__}:Torn", "guard": guard, "mend": False}
    made = {"backend": "miniature", "backend_kwargs": options, "resolution": (17, 17)}
    env = gym.make(cloth_envs.env_id("Hanging"), self_contact=False, **made)  # which would draw it together
    env.reset(seed=0)
    *_, terminated, _, info = env.step(np.zeros(3, np.float32))
    assert not terminated
    always = {"reward_place", "reward_calm", "success", "distance", "strain", "change"}
    assert info.keys() == always | ({"guard"} if guard else set())
    assert info.get("guard", False) is guard
    base = env.unwrapped
    assert (strain(base.scene.grid, base.state.positions).max > 1).all() == (not guard)  # type: ignore[attr-defined]

    for mode in ("NextStep", "SameStep"):
        many = gym.make_vec(cloth_envs.env_id("Hanging"), num_envs=2, max_episode_steps=2, autoreset_mode=mode, **made)
        many.reset(seed=0)
        told = [many.step(np.zeros((2, 3), np.float32))[4] for _ in range(3)]
        inner = told[1]["final_info"] if mode == "SameStep" else told[1]
        for infos in (told[0], inner):
            assert infos.get("guard", np.zeros(2, bool)).tolist() == [guard] * 2
            assert ("_guard" in infos) == guard
        if mode == "NextStep":
            assert "guard" not in told[2]  # that step only started
