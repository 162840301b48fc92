"""The upscalers "local" and "ridge": symmetry, training, weights, the environment; contact for every upscaler."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cloth_envs
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.resample import Resampler
from cloth_envs.scene import Collider, Scene
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from surrogates.checkpoint import WEIGHTS, load
from surrogates.miniature.backend import MiniatureBackend
from surrogates.miniature.coarse import coarse_grid
from surrogates.upscale.local import Local, Ridge, weights_name
from training.bench.benchmark import MEASURED
from training.fit import Kept
from training.local.data import cached, pairs, simulate, small, varied
from training.local.train import SHOWN, Recipe, centred, errors, fit_net, fit_ridge
from training.metrics.contact import inside

METHODS = (Local, Ridge)
NAMES = tuple(kind.method for kind in METHODS)
EPS = float(np.finfo(np.float32).eps)


def described(scene: str) -> Scene:
    return World(scene).scene


def folded(grid: Grid) -> np.ndarray:
    """A waved sheet ``(1, 3, h, w)`` within 2 m of the origin."""
    v, u = np.meshgrid(*(np.linspace(0, 1, n) for n in grid.shape), indexing="ij")
    return np.stack([0.7 * u * grid.width, 0.1 * np.sin(9 * u + 3 * v), -v * grid.height])[None]


def upscaler(kind: type[Local], scene: Scene, factor: int) -> Local:
    found = kind(small(scene, factor), scene, factor)
    found.set_materials(range(1), [scene.material])
    return found


@pytest.mark.parametrize("kind", METHODS)
@pytest.mark.parametrize("factor", [2, 3, 4])
def test_a_turned_and_moved_cloth_is_upscaled_alike(kind: type[Local], factor: int) -> None:
    scene = described("Flag")
    up, x = upscaler(kind, scene, factor), folded(coarse_grid(scene.grid, factor))
    turn, way = Rotation.random(random_state=3).as_matrix(), np.array([0.3, -0.2, 0.4])

    def moved(field: np.ndarray) -> np.ndarray:
        return np.einsum("ij,bjhw->bihw", turn, field) + way[:, None, None]

    here, there = (up.positions([State.still(a.astype(np.float32))]) for a in (x, moved(x)))
    # Rounding of coordinates below 4 m, amplified by the network at most by its layers' norms.
    gain = 1 + np.prod([np.linalg.norm(w, 2) for w in up.weights])
    np.testing.assert_allclose(there, moved(here.astype(np.float64)), atol=4 * EPS * 4 * gain)
    detail = here - Resampler(coarse_grid(scene.grid, factor), scene.grid)(x.astype(np.float32))
    assert np.abs(detail).max() > 100 * 4 * EPS * 4 * gain


@pytest.mark.parametrize("scene", MEASURED)
@pytest.mark.parametrize("factor", [2, 3, 4])
def test_a_flat_sheet_stays_flat(scene: str, factor: int) -> None:
    fine = described(scene)
    grid = coarse_grid(fine.grid, factor)
    x = np.stack([*np.meshgrid(np.linspace(0, grid.width, grid.cols), np.linspace(0, grid.height, grid.rows))])
    flat = np.concatenate([x, 0 * x[:1]])[None].astype(np.float32)
    for kind in METHODS:
        up = upscaler(kind, fine, factor)
        gain = 1 + np.prod([np.linalg.norm(w, 2) for w in up.weights])
        gap = up.positions([State.still(flat)]) - Resampler(grid, fine.grid)(flat)
        assert np.abs(gap).max() < 8 * EPS * 2 * gain  # coordinates below 2 m


@pytest.mark.parametrize("method", NAMES)
@pytest.mark.parametrize("scene", MEASURED)
def test_shipped_weights_are_small_and_tell_what_they_are(method: str, scene: str) -> None:
    name = weights_name(method, scene)
    assert (WEIGHTS / f"{name}.safetensors").stat().st_size < 1e6
    card = load(name).card
    assert card["licence"] == "MIT"
    assert set(card["factors"]) == {"2", "3", "4"}
    for part in card["factors"].values():
        shown = part["error [% of length] after frames"]
        for frame in map(str, SHOWN) if method == "local" else "5":  # ridge misses it on Pressure after one frame
            assert shown[f"held out, {method}"][frame] < shown["held out, bicubic"][frame]


def test_without_weights_the_remedy_is_named() -> None:
    scene = replace(described("Flag"), name="Nameless")
    with pytest.raises(ValueError, match="minicloth train local --scenes Nameless"):
        upscaler(Local, scene, 2)
    tube = replace(scene, grid=replace(scene.grid, periodic=True))
    with pytest.raises(ValueError, match="bicubic"):
        Local(tube, tube, 2)


def test_materials_count_within_the_range_of_training() -> None:
    scene = described("Flag")
    up = Local(small(scene, 2), scene, 2)
    heavy, heavier, heaviest = (scene.material.with_changes(areal_density=f * 0.2) for f in (2, 8, 32))
    biases = up.biases([scene.material, heavy, heavier, heaviest])
    assert np.abs(biases[0] - biases[1]).max() > 1e-4
    np.testing.assert_array_equal(biases[2], biases[3])


@pytest.fixture(scope="module")
def data() -> dict[str, Any]:
    """Flags of 17 x 25 vertices: 12 episodes to train on, and 2 of varied material."""
    small_flag = {"starts": (10, 30), "resolution": (17, 25)}
    ranges = varied(described("Flag"))
    return {
        "train": simulate("Flag", range(50, 62), (2,), **small_flag),
        "varied": simulate("Flag", range(62, 64), (2,), randomize=ranges, **small_flag),
    }


def test_a_tiny_net_descends_from_bicubic_on_what_it_learns_from(data: dict[str, Any], tmp_path: Path) -> None:
    """It starts from no correction; a twentieth to a tenth of bicubic's error less when this was written."""
    recipe = Recipe(hidden=(12, 12, 12), patches=50_000, steps=400, batch=512)
    own = data["train"]
    chosen, coarse = pairs(own, 2, recipe.patches), small(own.scene, 2)
    net = centred(fit_net(chosen, 2, recipe, Kept(tmp_path / "net.pt", "")), coarse)
    before, after = errors(own, 2, None), errors(own, 2, Local(coarse, own.scene, 2, arrays=net))
    assert all(after[frame] < before[frame] for frame in map(str, SHOWN))


def test_the_linear_weights_are_the_optimum(data: dict[str, Any]) -> None:
    """Moved along any direction they lose: the gradient of the weighted squares and the ridge's term is zero."""
    recipe = Recipe()
    chosen = pairs(data["train"], 2, 5_000)
    found = fit_ridge(chosen, recipe)["weight0"].astype(np.float64).T
    x, y = (a.astype(np.float64) * chosen.weight[:, None] for a in (chosen.x, chosen.y))
    ridge = recipe.ridge * np.square(x).sum() / x.shape[1]
    gradient = x.T @ (x @ found - y) + ridge * found
    # The weights are rounded to float32: eps of each, times what the squares make of it.
    assert (np.abs(gradient) <= EPS * (np.abs(x).T @ np.abs(x) @ np.abs(found) + ridge * np.abs(found))).all()


def test_a_stopped_training_goes_on(
    data: dict[str, Any], tmp_path: Path, stopped: Callable[[int], AbstractContextManager[object]]
) -> None:
    chosen = pairs(data["varied"], 2, 5_000)
    recipe = Recipe(hidden=(4, 4, 4), steps=30, batch=64)
    whole = fit_net(chosen, 2, recipe, Kept(tmp_path / "whole.pt", ""))
    kept = Kept(tmp_path / "part.pt", "", every=10)
    with stopped(25):
        fit_net(chosen, 2, recipe, kept)
    assert kept.path.is_file()
    part = fit_net(chosen, 2, recipe, kept)
    assert not kept.path.exists()
    for name, value in whole.items():
        np.testing.assert_array_equal(part[name], value)


def test_data_are_kept(data: dict[str, Any], tmp_path: Path) -> None:
    windows = data["varied"]
    assert {m.areal_density for m in windows.materials} != {windows.scene.material.areal_density}
    for make in (lambda: windows, lambda: None):
        found = cached(windows.scene, tmp_path / "flag.npz", make)
        assert found.key == windows.key
        assert found.materials == windows.materials


OPTIONS = {"factor": 4, "scaling": "calibrated"}


@pytest.mark.parametrize("name", NAMES)
def test_in_the_environment(name: str) -> None:
    """Same first frame after every reset, same future after save and restore, handles where they are driven."""
    kwargs = {"backend": "miniature", "backend_kwargs": {**OPTIONS, "upscaler": name}}
    env: Any = gym.make(cloth_envs.env_id("Curtain"), **kwargs).unwrapped
    actions = np.random.default_rng(0).uniform(-1, 1, (6, 2)).astype(np.float32)
    env.reset(seed=4)
    first = env.step(actions[0])[0]
    for action in actions[1:4]:
        env.step(action)
    saved = env.get_state()
    later = [env.step(action)[0] for action in actions[4:]]
    env.reset(seed=4)
    np.testing.assert_array_equal(env.step(actions[0])[0], first)
    env.set_state(saved)
    for action, expected in zip(actions[4:], later, strict=True):
        np.testing.assert_array_equal(env.step(action)[0], expected)
    plain: Any = gym.make(cloth_envs.env_id("Curtain"), backend="miniature", backend_kwargs=OPTIONS).unwrapped
    plain.reset(seed=4)
    held = list(env.scene.pins)
    assert np.abs(plain.step(actions[0])[0] - first).max() > 1e-5
    env.reset(seed=4)
    env.step(actions[0])
    fine = [e.state.positions.reshape(3, -1) for e in (env, plain)]
    np.testing.assert_array_equal(fine[0][:, held], fine[1][:, held])


@pytest.mark.parametrize("name", NAMES)
def test_members_of_a_batch_are_what_they_are_alone(name: str) -> None:
    options = {"backend": "miniature", "backend_kwargs": {**OPTIONS, "upscaler": name}}
    randomize = {"areal_density": (0.1, 0.4)}
    both = World("Flag", num_envs=3, randomize=randomize, **options)  # type: ignore[arg-type]
    both.reset({i: np.random.default_rng(i) for i in range(3)})
    actions = np.random.default_rng(9).uniform(-1, 1, (5, 3, 2))
    for frame, action in enumerate(actions):
        if frame == 3:  # one starts anew, with another material
            both.reset({0: np.random.default_rng(7)})
        both.step(action)
    for i, seed, begin in ((0, 7, 3), (1, 1, 0), (2, 2, 0)):
        alone = World("Flag", randomize=randomize, **options)  # type: ignore[arg-type]
        alone.reset({0: np.random.default_rng(seed)})
        for action in actions[begin:]:
            alone.step(action[i : i + 1])
        np.testing.assert_array_equal(alone.state.positions[0], both.state.positions[i])


@pytest.mark.parametrize("name", ["bilinear", "biquadratic", "bicubic", *NAMES])
@pytest.mark.parametrize("body", ["sphere", "capsule"])
def test_no_vertex_ends_in_a_ball_pressed_into_a_coarse_cloth(name: str, body: str) -> None:
    """A ball of three coarse cells' radius; interpolation alone ends inside it, which the counter tells."""
    grid, radius = Grid(33, 33, 1.0, 1.0), 0.13
    corners = tuple(grid.index(r, c) for r in (0, -1) for c in (0, -1))
    scene = Scene("Collision", grid, Material(), 0.02, handles=corners, colliders=(Collider(body, radius),))
    v, u = np.meshgrid(*(np.linspace(0, 1, 33),) * 2, indexing="ij")
    start = State.still(np.stack([u, v, 0 * u])[None].astype(np.float32))
    ends = np.array([[0.5, 0.5, radius + 0.01]] * 2)
    ends[1, 0] += 0.1 * (body == "capsule")
    start.colliders, start.collider_velocities = (np.zeros((1, 1, 2, 3), np.float32) for _ in range(2))
    start.colliders[:] = ends
    backend = MiniatureBackend(scene, factor=4, scaling="calibrated", upscaler=name)
    backend.reset(start)
    controls, deepest = Controls.hold(start, corners), 0.0
    for _ in range(20):
        controls.colliders = controls.colliders - np.array([0.0, 0.0, 0.01])
        controls.collider_velocities[:] = [0.0, 0.0, -0.5]
        state = backend.advance(controls)
        assert inside(scene, state).count[0] == 0
        deepest = max(deepest, float(backend.fine.depth[0]))
        # Nothing at the surface moves on into the body: REACH away from it, at the body's own speed at most.
        away = state.positions[0].reshape(3, -1).T - state.colliders[0, 0, 0]
        if body == "sphere":
            gap = np.linalg.norm(away, axis=1)
            near = gap < radius + scene.thickness + 5e-6
            speed = (state.velocities[0].reshape(3, -1).T + np.array([0, 0, 0.5]))[near]
            assert ((speed * (away / gap[:, None])[near]).sum(1) > -1e-4).all()
    assert deepest > 1e-3
