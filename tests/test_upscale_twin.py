"""The compiled upscaling kernels against NumPy: the local network's residual, and vertices kept out of bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.laws.bodies import axis_parameter, on_axis
from cloth_envs.resample import Resampler
from cloth_envs.scene import Collider, Scene
from cloth_envs.state import Controls, State
from surrogates.miniature.coarse import coarse_grid
from surrogates.miniature.fine import REACH, Fine
from surrogates.miniature.handles import Handles
from surrogates.upscale.local import Local
from surrogates.upscale.local_features import NODES, answer, features, spacing
from surrogates.upscale.patches import squares
from surrogates.upscale.protocol import Upscaler

EPS = float(np.finfo(np.float32).eps)
BATCH = 2


def network(hidden: tuple[int, ...], seed: int = 0) -> dict[str, np.ndarray]:
    """Random weights of a net with these hidden layers."""
    rng, sizes = np.random.default_rng(seed), (36, *hidden, 27)
    weights = {f"weight{k}": rng.normal(0, n**-0.5, (m, n)) for k, (n, m) in enumerate(pairwise(sizes))}
    biases = {f"bias{k}": rng.normal(0, 0.3, n) for k, n in enumerate(hidden)}
    return {name: a.astype(np.float32) for name, a in (weights | biases).items()}


def crumpled(grid: Grid, seed: int = 0) -> np.ndarray:
    """A batch of waved sheets with noise of a tenth of a cell, ``(2, 3, h, w)`` float32."""
    rng = np.random.default_rng(seed)
    v, u = np.meshgrid(*(np.linspace(0, 1, n) for n in grid.shape), indexing="ij")
    x = np.stack([u * grid.width, 0.1 * np.sin(5 * u + 3 * v), -v * grid.height])
    return (x + rng.normal(0, 0.1 * spacing(grid), (BATCH, *x.shape))).astype(np.float32)


# Columns fewer and more than a vector's lanes, cells that fill no whole number of vectors.
@pytest.mark.parametrize("shape", [(3, 3), (5, 4), (13, 25)])
@pytest.mark.parametrize("hidden", [(), (20,), (16, 24)])
def test_the_residual_is_that_of_the_twin(shape: tuple[int, int], hidden: tuple[int, ...]) -> None:
    rows, cols = (2 * n - 1 for n in shape)
    fine = Scene("sheet", Grid(rows, cols, 0.02 * (rows - 1), 0.03 * (cols - 1)), Material(), 0.01)
    coarse, arrays = replace(fine, grid=coarse_grid(fine.grid, 2)), network(hidden)
    upscaler = Local(coarse, fine, 2, arrays=arrays)
    upscaler.set_materials(range(BATCH), [fine.material] * BATCH)
    x, unit = crumpled(coarse.grid), spacing(coarse.grid)
    numbers, turn = features(x.astype(np.float64), unit)
    biases = np.split(
        upscaler.biases([fine.material])[0], np.cumsum([len(arrays[f"weight{k}"]) for k in range(len(hidden))])
    )
    for k, bias in enumerate(biases):
        numbers = numbers @ arrays[f"weight{k}"].T + bias
        numbers = np.maximum(numbers, 0) if k < len(hidden) else numbers
    found = upscaler.positions([State.still(x)]) - Resampler(coarse.grid, fine.grid)(x)
    # Positions, up to 2 m, are rounded in the differences that the net reads; it and the turning of axes amplify that
    # by at most the product of the layers' largest sums of weights. A few such roundings add up.
    gain = np.prod([np.abs(arrays[f"weight{k}"]).sum(1).max() for k in range(len(biases))])
    twin = squares(*shape, 2).merge(answer(numbers, turn, unit).reshape(-1, 3 * NODES)).reshape(found.shape)
    np.testing.assert_allclose(found, twin, atol=4 * EPS * gain)
    assert np.abs(found).max() > 0.05 * unit


def test_what_cells_say_of_a_shared_vertex_is_averaged() -> None:
    grid = Grid(9, 9, 1.0, 1.0)
    fine = Scene("sheet", grid, Material(), 0.01)
    upscaler = Local(replace(fine, grid=coarse_grid(grid, 2)), fine, 2, arrays=network((8,)))
    upscaler.set_materials(range(BATCH), [fine.material] * BATCH)
    x = crumpled(coarse_grid(grid, 2))
    assert upscaler.seam([State.still(x)]) > 1e-3
    v, u = np.meshgrid(*(np.linspace(0, 1, 5),) * 2, indexing="ij")
    flat = np.stack([u, 0 * u, -v])[None].repeat(BATCH, 0).astype(np.float32)
    assert upscaler.seam([State.still(flat)]) < 1e-5


class Given(Upscaler):
    """Says of every cloth what it was told."""

    cloth: tuple[np.ndarray, np.ndarray]

    def positions(self, history: Sequence[State]) -> np.ndarray:
        return self.cloth[0]

    def velocities(self, history: Sequence[State]) -> np.ndarray:
        return self.cloth[1]


BODIES = (Collider("sphere", 0.2), Collider("capsule", 0.1), Collider("plane"))
ENDS = {
    "sphere": [[0.5, 0.0, -0.5], [0.5, 0.0, -0.5]],
    "capsule": [[0.2, 0.05, -0.6], [0.8, -0.05, -0.3]],
    "plane": [[0.0, -0.02, 0.0], [0.0, 1.0, 0.0]],
}


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.kind)
@pytest.mark.parametrize("rows", [5, 21])  # 35 vertices: most of the last vector is missing
def test_vertices_are_put_on_the_surface_and_stop_there(body: Collider, rows: int) -> None:
    grid, rng = Grid(rows, 7, 1.0, 1.0), np.random.default_rng(1)
    scene = Scene("sheet", grid, Material(), 0.01, colliders=(body,), handles=(3 * 7 + 3,))
    state = State.still(crumpled(grid), np.tile(np.array(ENDS[body.kind], np.float32), (BATCH, 1, 1, 1)))
    state.collider_velocities[:] = rng.normal(size=state.collider_velocities.shape)
    if body.kind == "plane":
        state.collider_velocities[:, :, 1] = 0
    before, velocities = state.positions.copy(), rng.normal(size=state.positions.shape).astype(np.float32)

    x, v = (a.reshape(BATCH, 3, -1).astype(np.float64) for a in (before, velocities))
    ends, speeds = (a[:, 0].astype(np.float64) for a in (state.colliders, state.collider_velocities))
    if body.kind == "plane":
        normal = np.broadcast_to(ends[:, 1, :, None], x.shape)
        gap, carried = ((x - ends[:, 0, :, None]) * normal).sum(1), np.broadcast_to(speeds[:, 0, :, None], x.shape)
    else:
        place = axis_parameter(ends, x)
        away, carried = x - on_axis(ends, place), on_axis(speeds, place)
        gap = np.linalg.norm(away, axis=1)
        normal = away / gap[:, None]
    depth = np.maximum(body.radius + scene.thickness - gap, 0)
    depth[:, scene.handles[0]] = 0
    assert (depth > 0).any()
    into = np.minimum(((v - carried) * normal).sum(1), 0) * (depth > 0)

    upscaler = Given(replace(scene, grid=coarse_grid(grid, 2)), scene, 2)
    upscaler.cloth = state.positions, velocities
    coarse = replace(state, positions=state.positions[..., ::2, ::2], velocities=state.velocities[..., ::2, ::2])
    controls = Controls.hold(state, scene.handles)
    controls.handle_velocities[:, 0] = velocities.reshape(BATCH, 3, -1)[:, :, scene.handles[0]]
    fine = Fine(scene, Handles.of(grid, upscaler.coarse.grid, scene.handles), upscaler)
    fine.begin(BATCH)
    assert fine([coarse], controls).positions is state.positions
    # Coordinates, radii and gaps below 2 m, each rounded a few times, and the estimate of 1 / sqrt to 2 eps.
    np.testing.assert_allclose(state.positions.reshape(x.shape), x + depth[:, None] * normal, atol=16 * EPS)
    assert fine.pushed.tolist() == (depth > 0).sum(1).tolist()
    np.testing.assert_allclose(fine.depth, depth.max(1), atol=16 * EPS)
    # The normal is taken at the new place, as far as REACH and rounding from the surface.
    tolerance = (REACH + 32 * EPS) / 0.1 * np.abs(v - carried).max()
    np.testing.assert_allclose(velocities.reshape(x.shape), v - into[:, None] * normal, atol=tolerance)
