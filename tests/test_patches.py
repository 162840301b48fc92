"""Patches: cutting and merging are exact where the answer is known, and the NumPy network is torch's."""

from __future__ import annotations

import re
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

from cloth_envs.grid import Grid
from cloth_envs.presets import load_preset
from cloth_envs.resample import Resampler
from cloth_envs.state import State
from surrogates.checkpoint import Checkpoint
from surrogates.miniature.coarse import coarse_scene
from surrogates.upscale.patches import FEATURES, combine, squares, triangles, windows
from surrogates.upscale.published import FullyConnected, HierarchicalDnn, Mlp

EPS = float(np.finfo(np.float32).eps)


def slanted(rows: int, cols: int, step: int = 1) -> np.ndarray:
    """A field that is linear in row and column, in whole numbers: sums and halves of them are exact."""
    i, j = np.meshgrid(step * np.arange(rows), step * np.arange(cols), indexing="ij")
    return np.stack([8 * i + 16 * j, 32 * j - 8 * i, 8 + 0 * i])[None].astype(np.float32)


@pytest.mark.parametrize("factor", [2, 4])
def test_a_linear_field_merges_to_itself_without_seams(factor: int) -> None:
    coarse, fine = slanted(3, 4, factor), slanted(2 * factor + 1, 3 * factor + 1)
    layout = squares(3, 4, factor)
    corners = layout.cut(coarse)
    assert corners.shape == (6, 12)
    np.testing.assert_array_equal(
        corners[1], [*coarse[0, :, 0, 1], *coarse[0, :, 0, 2], *coarse[0, :, 1, 1], *coarse[0, :, 1, 2]]
    )
    patches = corners @ np.kron(layout.weights.T, np.eye(3, dtype=np.float32))
    assert patches.shape == (6, 3 * (factor + 1) ** 2)
    np.testing.assert_array_equal(layout.merge(patches).reshape(fine.shape), fine)
    assert layout.seam(patches) == 0


def test_borders_are_averaged_and_the_seam_says_by_how_much_they_differ() -> None:
    layout = squares(2, 3, 2)  # two patches side by side
    patches = np.zeros((2, 27), np.float32)
    patches[1, ::3] = 3.0  # the second is 3 m off along x
    merged = layout.merge(patches).reshape(3, 3, 5)
    np.testing.assert_array_equal(merged[0], np.tile([0, 0, 1.5, 3, 3], (3, 1)))
    assert not merged[1:].any()
    assert layout.seam(patches) == 1.5  # both are 1.5 m from their average
    four = squares(3, 3, 2)
    corner = four.merge(np.repeat(np.array([[0], [1], [2], [5]], np.float32), 27, 1)).reshape(3, 5, 5)
    assert corner[0, 2, 2] == 2.0  # of 0, 1, 2 and 5
    assert corner[0, 2, 0] == 1.0  # of 0 and 2


def test_every_window_of_the_fine_grid_has_its_own_corners() -> None:
    layout = windows(5, 6, 2)
    assert len(layout.corners) == 3 * 4  # stride 1
    field = np.random.default_rng(0).normal(size=(1, 3, 5, 6))
    corners = layout.cut(field).reshape(12, 4, 3)
    np.testing.assert_array_equal(corners[5], [field[0, :, r, c] for r, c in ((1, 1), (1, 3), (3, 1), (3, 3))])
    np.testing.assert_array_equal(layout.points[5], [6 * r + c for r in (1, 2, 3) for c in (1, 2, 3)])


def test_triangles_give_every_midpoint() -> None:
    layout, fine = triangles(3, 4), slanted(5, 7)
    assert len(layout.corners) == 12
    mid = layout.cut(slanted(3, 4, 2)) @ np.kron(layout.weights.T, np.eye(3, dtype=np.float32))
    merged = layout.merge(mid).reshape(fine.shape)
    merged[:, :, ::2, ::2] = slanted(3, 4, 2)
    np.testing.assert_array_equal(merged, fine)


def test_feature_sets() -> None:
    frames = [np.full((2, 12), k, np.float32) for k in (1.0, 2.0, 4.0)]
    assert combine(frames, "positions", 0.5).tolist() == [[4.0] * 12] * 2
    assert combine(frames, "velocities", 0.5).tolist() == [[4.0] * 24] * 2  # (4 - 2) / 0.5 is 4 too
    assert combine(frames, "velocities", 0.25)[0].tolist() == [8.0] * 12 + [4.0] * 12
    assert combine(frames, "frames", 0.5)[0].tolist() == [1.0] * 12 + [2.0] * 12 + [4.0] * 12
    for kind, (count, each) in FEATURES.items():
        assert combine(frames[-count:], kind, 1.0).shape[1] == 4 * each


def test_the_network_is_that_of_torch() -> None:
    torch.manual_seed(0)
    net = torch.nn.Sequential(
        torch.nn.Linear(36, 64), torch.nn.ReLU(), torch.nn.Linear(64, 64), torch.nn.ReLU(), torch.nn.Linear(64, 27)
    ).double()
    linear = [part for part in net if isinstance(part, torch.nn.Linear)]
    arrays = {f"weight{k}": part.weight.detach().numpy() for k, part in enumerate(linear)}
    arrays |= {f"bias{k}": part.bias.detach().numpy() for k, part in enumerate(linear)}
    x = np.random.default_rng(0).normal(size=(50, 36))
    exact = net(torch.from_numpy(x)).detach().numpy()
    # A dot product of n terms is rounded by at most n eps of the sum of their sizes; ReLU makes no error larger, and
    # sums of sizes are carried through the layers.
    size = np.abs(x)
    for k in range(3):
        size = size @ np.abs(arrays[f"weight{k}"]).T + np.abs(arrays[f"bias{k}"])
    terms = 37 + 65 + 65 + 3  # and one rounding of the weights in each layer
    found = Mlp(arrays)(x.astype(np.float32))
    assert found.dtype == np.float32
    assert (np.abs(found - exact) <= terms * EPS * size).all()


def test_a_network_that_does_not_fit_together_is_refused() -> None:
    with pytest.raises(ValueError, match="needs weight0"):
        Mlp({"bias0": np.zeros(3)})
    layers = {"weight0": np.zeros((4, 3)), "bias0": np.zeros(4), "weight1": np.zeros((2, 5)), "bias1": np.zeros(2)}
    with pytest.raises(ValueError, match="cannot follow 4 numbers"):
        Mlp(layers)


def linear_net(factor: int) -> Checkpoint:
    """One layer that is bilinear interpolation of the newest of three frames."""
    weight = np.zeros((3 * (factor + 1) ** 2, 36), np.float32)
    weight[:, 24:] = np.kron(squares(2, 2, factor).weights, np.eye(3))
    recipe = {"features": "frames"}
    return Checkpoint({"weight0": weight, "bias0": np.zeros(len(weight), np.float32)}, {"recipe": recipe})


@pytest.mark.parametrize("factor", [2, 3])
def test_an_upscaler_puts_the_patches_of_a_batch_together(factor: int) -> None:
    """With a network that interpolates, it does; also onto a grid that the factor does not divide."""
    task = load_preset("Flag", "lee2019")
    fine = task.make_scene(resolution=(33, 49), material=task.material)
    coarse, _ = coarse_scene(fine, factor, fine.material)
    rng = np.random.default_rng(0)
    history = [State.still(rng.normal(size=(2, 3, *coarse.grid.shape)).astype(np.float32)) for _ in range(3)]
    up = FullyConnected(coarse, fine, factor, weights=linear_net(factor))
    assert up.frames == 3
    rows, cols = coarse.grid.cells
    dense = Grid(factor * rows + 1, factor * cols + 1, fine.grid.height, fine.grid.width)
    expected = Resampler(coarse.grid, dense, "linear")(history[-1].positions)
    if dense.shape != fine.grid.shape:
        expected = Resampler(dense, fine.grid)(expected)
    found = up.positions(history)
    assert found.shape == (2, 3, 33, 49)
    # Weighted means of normal numbers up to 5, about ten roundings on the way.
    np.testing.assert_allclose(found, expected, rtol=0, atol=10 * 5 * EPS)
    assert up.seam(history) <= 10 * 5 * EPS


@pytest.mark.parametrize("name", ["fc", "hdnn"])
@pytest.mark.parametrize("scene", ["Curtain", "Flag", "Collision"])
def test_the_shipped_networks_follow_the_coarse_cloth(name: str, scene: str) -> None:
    """After ten frames the upscaled cloth is nearer to bicubic interpolation of the same coarse cloth than a cell."""

    def run(upscaler: str) -> Any:
        env = gym.make(
            f"MiniCloth-{scene}-v0", preset="lee2019", backend="miniature",
            backend_kwargs={"upscaler": upscaler, "solver": "admm", "guard": False},
        ).unwrapped  # fmt: skip
        env.reset(seed=0)
        for _ in range(10):
            env.step(np.zeros(env.action_space.shape))
        return env

    found, plain = run(name), run("bicubic")
    gap = np.linalg.norm(found.positions - plain.positions, axis=0)
    assert 0 < gap.mean() < gap.max() < found.scene.grid.row_spacing
    handles = list(found.scene.pins)
    np.testing.assert_array_equal(
        found.positions.reshape(3, -1)[:, handles], plain.positions.reshape(3, -1)[:, handles]
    )


def test_a_saved_state_keeps_the_frames_that_the_network_reads() -> None:
    def make() -> Any:
        options = {"upscaler": "fc", "solver": "admm"}
        env = gym.make("MiniCloth-Flag-v0", preset="lee2019", backend="miniature", backend_kwargs=options).unwrapped
        env.reset(seed=3)
        return env

    def step(env: Any, count: int) -> np.ndarray:
        for _ in range(count):
            env.step(np.array([0.5, -0.3], np.float32))
        return env.positions

    env, other = make(), make()
    step(env, 4)
    saved = env.get_state()
    later = step(env, 3)
    other.set_state(saved)
    np.testing.assert_array_equal(step(other, 3), later)


def test_scenes_without_weights_are_refused_with_advice() -> None:
    def make(scene: str, **options: Any) -> None:
        gym.make(f"MiniCloth-{scene}-v0", backend="miniature", backend_kwargs={"upscaler": "fc"}, **options)

    with pytest.raises(
        ValueError, match=r"no weights for Pressure at factor 2; there are .*fc_flag_2.*minicloth train"
    ):
        make("Pressure")
    for options in ({}, {"preset": "lee2019", "resolution": (17, 25)}):
        with pytest.raises(ValueError, match=re.escape("Flag with preset='lee2019' only")):
            make("Flag", **options)
    task = load_preset("Flag", "lee2019")
    fine = task.make_scene(resolution=(33, 49), material=task.material)
    coarse, _ = coarse_scene(fine, 3, fine.material)
    with pytest.raises(ValueError, match="use factor 2 or 4"):
        HierarchicalDnn(coarse, fine, 3)
