"""Super-resolution: geometry images, the published networks and losses, the compiled network and its twin."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from json import loads
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.utils.seeding import np_random

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.laws import bodies as laws
from cloth_envs.registry import load_task
from cloth_envs.scene import Collider, Scene
from cloth_envs.scenes.starts import rotation
from cloth_envs.state import State
from cloth_envs.world import World
from surrogates.checkpoint import load
from surrogates.superres.features import (
    CHANNELS,
    FRAMES,
    LIMIT,
    SCALE,
    Bodies,
    features,
    spacing,
    touched,
)
from surrogates.superres.image import Alignment, Range, at_rest, image, normals
from surrogates.superres.network import SuperResolution, convolved, untiled
from surrogates.superres.published import MeshSr, Mfsr, tiled
from surrogates.superres.refine import smoothed
from training.fit import Kept
from training.metrics import detail as metrics
from training.rows import read_rows
from training.superres import published, restarts
from training.superres import train as train_mfsr
from training.superres.convergence import CONVERGENCE, FEATURES, ConvergenceRow
from training.superres.detail import Detail, Mirrored, Net, Recipe, coarse_modes, overlong, ridge, tiles, train
from training.superres.frames import Aligned, Frames, frames_of
from training.superres.generate import BACKEND
from training.superres.losses import kinematic, positions
from training.superres.pairs import Pair, Run
from training.superres.train import arrays, errors

SMALL, LARGE = Grid(5, 6, 1.0, 1.2), Grid(17, 21, 1.0, 1.2)
TUBE, LARGE_TUBE = Grid(5, 8, 1.0, 1.6, periodic=True), Grid(17, 32, 1.0, 1.6, periodic=True)
BODIES = tuple(Collider(kind, radius) for kind, radius in (("sphere", 0.3), ("capsule", 0.2), ("plane", 0.0)))
BOTH = pytest.mark.parametrize("periodic", [False, True], ids=["sheet", "tube"])


def crumpled(grid: Grid, count: int = 1, seed: int = 0) -> np.ndarray:
    """Sheets at rest with noise of a fifth of a cell, ``(count, 3, H, W)`` float32."""
    noise = np.random.default_rng(seed).standard_normal((count, 3, *grid.shape))
    return (at_rest(grid).numpy() + 0.2 * spacing(grid) * noise).astype(np.float32)


TURN, WAY = rotation(np.array([0.7]), 0, 1)[0], np.array([1.0, -2.0, 3.0])  # about z, which leaves gravity alone


def turned(x: np.ndarray, turn: np.ndarray = TURN) -> np.ndarray:
    """Turned and moved."""
    return (np.einsum("ij,bjhw->bihw", turn, x) + WAY[:, None, None]).astype(np.float32)


def seen_there(state: State, turn: np.ndarray) -> State:
    """Cloth and ``BODIES`` turned and moved."""
    ends = np.einsum("ij,bckj->bcki", turn, state.colliders)
    ends += np.where(np.array([[1, 1], [1, 1], [1, 0]])[..., None], WAY, 0)
    return State.still(turned(state.positions, turn), ends.astype(np.float32))


def scenes(periodic: bool) -> tuple[Scene, Scene]:
    """A coarse and a fine scene."""
    task = load_task("Draping")
    fine = task.make_scene(resolution=LARGE.shape, material=Material())
    few, many = (TUBE, LARGE_TUBE) if periodic else (SMALL, LARGE)
    still: dict[str, Any] = {"handles": (), "grips": (), "colliders": BODIES}
    return replace(fine, grid=few, **still | {"handles": (0, 7)}), replace(fine, grid=many, **still)


def weights(layers: int = 3, width: int = 12, seed: int = 0) -> dict[str, np.ndarray]:
    """Of a network that nobody trained, whose answers are about half their limit."""
    rng, sizes = np.random.default_rng(seed), [CHANNELS, *[width] * layers, 48]
    arrays = {"mean": rng.standard_normal(CHANNELS) * 0.1, "width": 0.5 + rng.random(CHANNELS)}
    for k, (few, many) in enumerate(pairwise(sizes)):
        arrays[f"weight{k}"] = rng.standard_normal((many, few, 3, 3)) * (0.1 if k == layers else 1) / np.sqrt(5 * few)
        arrays[f"bias{k}"] = rng.standard_normal(many) * 0.1
    return {name: array.astype(np.float32) for name, array in arrays.items()}


def around(batch: int, seed: int = 0) -> np.ndarray:
    """Places of ``BODIES`` that touch a sheet at rest, ``(batch, 3, 2, 3)``."""
    ball, axis = [[0.3, 0.2, -0.3]] * 2, [[0.8, -0.1, -0.6], [1.0, 0.2, -0.9]]
    plane = [[0.0, 0.0, -0.9], [0.0, 0.6, 0.8]]
    moved = (
        0.05
        * np.random.default_rng(seed).standard_normal((batch, 3, 1, 3))
        * np.array([[1, 1], [1, 1], [1, 0]])[..., None]
    )
    return (np.array([ball, axis, plane]) + moved).astype(np.float32)


def history(grid: Grid, batch: int = 2) -> list[State]:
    return [State.still(crumpled(grid, batch, seed), around(batch, seed)) for seed in range(FRAMES)]


def test_alignment_finds_a_rigid_motion() -> None:
    rest = at_rest(SMALL)
    moved = torch.from_numpy(turned(rest[None].numpy()))
    align = Alignment.of(moved, rest)
    torch.testing.assert_close(align.points(moved)[0], rest, atol=1e-6, rtol=0)
    torch.testing.assert_close(align.back(align.points(moved)), moved, atol=1e-6, rtol=0)
    assert torch.det(align.turn[0]).item() == pytest.approx(1)


def test_images_do_not_turn_with_the_cloth() -> None:
    rest, x = at_rest(SMALL), crumpled(SMALL)
    there, v = turned(x), 0.1 * crumpled(SMALL, seed=1)
    images = []
    for cloth, speed in ((x, v), (there, turned(v) - turned(0 * v))):
        at, moving = torch.from_numpy(cloth), torch.from_numpy(speed)
        images.append(image(at, moving, rest, Alignment.of(at, rest)))
    torch.testing.assert_close(images[0], images[1], atol=1e-5, rtol=0)


@BOTH
def test_normals_are_those_of_the_metrics(periodic: bool) -> None:
    grid = TUBE if periodic else SMALL
    x = crumpled(grid)
    found = normals(torch.from_numpy(x), periodic).numpy()
    np.testing.assert_allclose(found, metrics.normals(grid, x), atol=1e-5)


def test_ranges_are_undone() -> None:
    images = torch.randn(3, 9, 5, 6)
    scale = Range.of(images)
    assert (scale(images).amin((0, 2, 3)) == 0).all()
    assert (scale(images).amax((0, 2, 3)) == 1).all()
    torch.testing.assert_close(scale.back(scale(images)), images)


def test_the_published_network_has_its_size() -> None:
    def conv(inputs: int, outputs: int, size: int) -> int:
        return outputs * (inputs * size**2 + 1)

    block = sum(conv(64 + 32 * k, 32, 3) for k in range(6)) + conv(64 + 6 * 32, 64, 1)
    ends = conv(9, 64, 3) + conv(64, 64, 3) + conv(16 * 64, 64, 1) + conv(64, 64, 3) + 3 * conv(64, 3, 3)
    assert sum(part.numel() for part in Mfsr().parameters()) == 16 * block + ends  # 4.40 million


@pytest.mark.parametrize("kind", [Mfsr, MeshSr])
def test_published_networks_double_twice_and_know_no_seam(kind: type[Mfsr] | type[MeshSr]) -> None:
    torch.manual_seed(0)
    sheet = kind(base=8, blocks=2, channels=9).eval()
    assert sheet(torch.rand(1, 9, *SMALL.shape)).shape[2:] == LARGE.shape
    tube = kind(base=8, blocks=2, channels=9, periodic=True).eval()
    x = torch.rand(1, 9, *TUBE.shape)
    with torch.no_grad():
        one, other = tube(x), tube(x.roll(1, 3))
    assert one.shape[2:] == LARGE_TUBE.shape
    torch.testing.assert_close(one.roll(SCALE, 3), other, atol=1e-5, rtol=0)


def test_the_kinematic_loss_holds_in_the_world_only() -> None:
    rng, dt, count = np.random.default_rng(0), 0.04, 4
    path = np.cumsum(0.1 * rng.standard_normal((count, 3, 1, 1)), 0) + crumpled(LARGE, count)
    x = torch.from_numpy(np.concatenate([path[:2], turned(path[2:])])).double()
    v = torch.diff(x, dim=0, prepend=x[:1]) / dt
    assert kinematic(x[None, 1:], v[None, 1:], dt).item() < 1e-20
    aligned = torch.stack([Alignment.of(part[None], at_rest(LARGE).double()).points(part[None])[0] for part in x])
    assert kinematic(aligned[None, 1:], v[None, 1:], dt).item() > 1e-3


def test_positions_are_those_of_the_images() -> None:
    few, many = (torch.from_numpy(crumpled(grid, 3)) for grid in (SMALL, LARGE))
    aligned = Aligned.of(Frames(few, many, torch.zeros(3), SMALL, LARGE, 0.04))
    scale, frames = aligned.range(), torch.tensor([1, 2])
    found = positions(scale(aligned.images(frames)[1]), scale, aligned, frames)
    torch.testing.assert_close(found, many[frames], atol=1e-5, rtol=0)


@BOTH
def test_the_kernel_is_its_twin(periodic: bool) -> None:
    coarse, fine = scenes(periodic)
    up, past = SuperResolution(coarse, fine, SCALE, arrays=weights()), history(coarse.grid)
    found, plain = up.positions(past), up.bicubic(past[-1].positions)
    assert np.abs(found - plain).max() > 0.1 * LIMIT * spacing(coarse.grid)
    # Sums of some hundred products in float32 of numbers of about one spacing.
    np.testing.assert_allclose(found, up.twin(past), atol=2e-5 * spacing(coarse.grid))


@BOTH
def test_the_trained_network_is_the_twin(periodic: bool) -> None:
    arrays, x = weights(), np.random.default_rng(1).standard_normal((2, CHANNELS, 5, 8)).astype(np.float32)
    net = Net(12, 3, periodic)
    for k, layer in enumerate(net.layers):
        assert isinstance(layer, Mirrored)
        layer.load_state_dict({name: torch.from_numpy(arrays[f"{name}{k}"]) for name in ("weight", "bias")})
        arrays |= {
            f"{name}{k}": part.detach().numpy() for name, part in zip(("weight", "bias"), layer.used(), strict=True)
        }
    with torch.no_grad():
        found = net(torch.from_numpy(x)).numpy()
    for k in range(4):
        weight, bias = arrays[f"weight{k}"], arrays[f"bias{k}"]
        x = convolved(np.maximum(x, 0) if k else x, weight, periodic) + bias[:, None, None]
    np.testing.assert_allclose(found, untiled(x, periodic), atol=1e-5)


@BOTH
def test_tiles_are_undone(periodic: bool) -> None:
    shape = (LARGE_TUBE if periodic else LARGE).shape
    fine = torch.randn(2, 3, *shape)
    found = tiled(torch.nn.functional.pixel_shuffle(tiles(fine, periodic), SCALE), periodic)
    torch.testing.assert_close(found, fine)


@pytest.mark.parametrize("turn", [TURN, TURN * [1, -1, 1]], ids=["turned", "mirrored"])
def test_detail_turns_with_the_cloth_and_mirrors_it(turn: np.ndarray) -> None:
    """Every network turns it, one that was trained mirrors it."""
    coarse, fine = scenes(False)
    torch.manual_seed(0)
    detail = Detail(*frames_of([swung(0, 9)]))
    net = Net(12, 3, False)
    last: Any = net.layers[-1]
    torch.nn.init.normal_(last.weight, std=0.1), torch.nn.init.normal_(last.bias, std=0.1)
    up, past = SuperResolution(coarse, fine, SCALE, arrays=arrays(net, detail)), history(SMALL)
    found, there = up.positions(past), [seen_there(state, turn) for state in past]
    assert np.abs(found - up.bicubic(past[-1].positions)).max() > 0.1 * LIMIT * spacing(SMALL)
    np.testing.assert_allclose(up.positions(there), turned(found, turn), atol=2e-5)


def test_features_of_numpy_and_torch_agree() -> None:
    x = [crumpled(SMALL, 2, seed) for seed in range(3)]
    held, planes = np.zeros(SMALL.shape, np.float32), [body.kind == "plane" for body in BODIES]
    told = Bodies(around(2), around(2, 1), np.array([[body.radius for body in BODIES]], np.float32), planes)
    tensors = Bodies(torch.from_numpy(told.now), torch.from_numpy(told.before), torch.from_numpy(told.radii), planes)
    for mine, other in zip(
        features(x, told, held, SMALL),
        features([torch.from_numpy(a) for a in x], tensors, torch.from_numpy(held), SMALL),
        strict=True,
    ):
        np.testing.assert_allclose(mine, other.numpy(), atol=1e-5)


@pytest.mark.parametrize("number", range(3))
def test_bodies_are_seen_as_contact_has_them(number: int) -> None:
    """How near they are, and the normal, on which a vertex that goes with them does not slide."""
    body, x, moved = BODIES[number], crumpled(SMALL, 2).astype(np.float64), np.array([0.01, 0.02, -0.03])
    now = around(2)[:, number].astype(np.float64)
    shift = np.where(np.array([[1], [body.kind != "plane"]]), moved, 0)
    told = Bodies(now[:, None], (now - shift)[:, None], np.array([[body.radius]]), [body.kind == "plane"])
    near, normal, slide = touched(x, np.broadcast_to(moved[:, None, None], x.shape), told, 0.3)
    flat = x.reshape(2, 3, -1)
    if body.kind == "plane":
        gap = laws.dot(now[:, 1][:, :, None], flat - now[:, 0][:, :, None])
    else:
        away = flat - laws.on_axis(now, laws.axis_parameter(now, flat))
        gap = np.linalg.norm(away, axis=1, keepdims=True) - body.radius
    wanted = np.maximum(1 - gap / 0.3, 0)
    assert 0 < (wanted > 0).mean() < 1
    np.testing.assert_allclose(near.reshape(wanted.shape), wanted, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), near[:, 0], atol=1e-9)
    closer, _, _ = touched(x - 1e-4 * normal, 0 * x, told, 0.3)
    np.testing.assert_allclose(closer - near, 1e-4 / 0.3 * near, atol=1e-6)
    np.testing.assert_allclose(slide, 0, atol=1e-12)


def test_other_grids_are_refused() -> None:
    coarse, fine = scenes(False)
    with pytest.raises(ValueError, match="needs 4 fine cells"):
        SuperResolution(coarse, replace(fine, grid=Grid(16, 21, 1.0, 1.2)), SCALE, arrays=weights())
    with pytest.raises(ValueError, match="minicloth train mfsr --scenes BallDrop"):
        SuperResolution(coarse, replace(fine, name="BallDrop"), SCALE)


def swung(seed: int, frames: int = 50) -> Pair:
    """Draping on a small grid and the fine cloth that follows it."""
    world = World("Draping", resolution=(33, 33), backend=BACKEND)
    world.reset({0: np_random(seed)[0]})
    cloths: Any = world.backend
    path = []
    for _ in range(frames):
        assert world.step(np.zeros((1, 3)))[1] == [None]
        path.append([np.moveaxis(state.positions[0].copy(), 0, -1) for state in (cloths.coarse, world.state)])
    few, many = (np.stack(x).astype(np.float32) for x in zip(*path, strict=True))
    runs = Run(cloths.coarse_scene, few, 0 * few), Run(world.scene, many, 0 * many)
    return Pair(seed, *runs, np.zeros((frames, 0, 2, 3)))


def test_a_small_training_beats_interpolation_where_it_was_not_trained() -> None:
    """And ridge, on a cloth that starts otherwise; what is compiled is what was trained."""
    detail = Detail(*frames_of([swung(seed) for seed in range(4)]))
    recipe = Recipe(width=16, layers=2, steps=200, windows=2)
    net, _ = train(recipe, detail)
    pair = swung(9)
    unseen = Detail(*frames_of([pair]), detail.scale)
    told = errors({"bicubic": None, "ridge": ridge(detail), "net": net}, unseen, Aligned.of(detail.frames).range())
    assert told["net"]["rms"] < 0.95 * told["bicubic"]["rms"], told
    assert told["net"]["normal"] < told["bicubic"]["normal"], told
    assert told["net"]["rms"] < told["ridge"]["rms"], told
    up = SuperResolution(pair.coarse.scene, pair.fine.scene, SCALE, arrays=arrays(net, detail))
    past = [State.still(unseen.frames.coarse[k : k + 1].numpy()) for k in (10, 11, 12)]
    with torch.no_grad():
        found = unseen(net, torch.tensor([12])).numpy()
    np.testing.assert_allclose(up.positions(past), found, atol=1e-5)


def test_a_closures_cloths_that_start_again_teach_what_they_lack(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A coarse run is a past frame, the truth at its start, and what becomes of that; what is trained is kept."""
    monkeypatch.setattr(restarts, "SEEDS", (range(1000, 1004), range(200, 201)))
    given = ["--scenes", "Collision", "--steps", "60", "--width", "8", "--layers", "2"]
    given += ["--out", str(tmp_path), "--cache", str(tmp_path / "cache")]
    assert train_mfsr.main(given) == 0
    whole = load("mfsr_collision", tmp_path).card
    assert "seeds 1000 to 1003, unseen 200 to 200; actions smooth, random, smooth, bang-bang in turn" in whole["data"]
    card = whole["factors"]["4"]
    told = card["errors of unseen sequences"]
    assert told["mfsr"]["rms"] < 0.98 * told["bicubic"]["rms"], told
    assert (card["fitted on"]["scaling"], card["fitted on"]["self_contact"]) == ("closure", False)
    scene = World("Collision").scene
    found = restarts.simulate("Collision", [1000])
    frames, around_them = restarts.frames_of(scene, found)
    assert frames.run.tolist() == [run for run in range(7) for _ in range(8)]
    assert around_them.held[0].sum() == len(restarts.coarse_cloth(scene).scene.handles)
    start = slice(1, None, 8)
    np.testing.assert_allclose(found["coarse"][start], found["fine"][start][..., ::4, ::4], atol=1e-6)
    assert np.abs(found["coarse"][2::8] - found["fine"][2::8][..., ::4, ::4]).max() > 1e-4
    first = (tmp_path / "mfsr_collision.safetensors").stat().st_mtime_ns
    assert train_mfsr.main(given) == 0
    assert (tmp_path / "mfsr_collision.safetensors").stat().st_mtime_ns == first


@BOTH
def test_smoothing_by_normals_takes_noise_away_and_leaves_the_cloth(periodic: bool) -> None:
    grid = LARGE_TUBE if periodic else LARGE
    smooth = at_rest(grid)[None]
    if not periodic:
        smooth[:, 2] = 0.05 * torch.sin(4 * smooth[:, 0])
    noisy = smooth + 0.1 * spacing(grid) * torch.randn(smooth.shape, generator=torch.Generator().manual_seed(0))
    true = normals(smooth, periodic)
    error = [(normals(x, periodic) - true).square().mean().item() for x in (noisy, smoothed(noisy, true, periodic))]
    assert error[1] < 0.2 * error[0]
    moved = (smoothed(smooth, true, periodic) - smooth).norm(dim=1).max().item()
    assert moved < 0.1 * spacing(
        grid
    )  # three passes by the sagitta of a cell, h^2 / 8 times a curvature below 1 / 0.25


def test_a_published_training_learns_and_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few, many = (torch.from_numpy(crumpled(grid, 1)).repeat(12, 1, 1, 1) for grid in (SMALL, LARGE))
    sway = 0.1 * torch.sin(torch.arange(12) / 3)[:, None, None, None]
    frames = Frames(few + sway, many + sway, torch.zeros(12), SMALL, LARGE, 0.04)
    recipe = published.Recipe(size=published.SMALL, schedule="cosine", rate=2e-3)
    monkeypatch.setattr(published, "RECIPES", {"all": recipe})
    net, told = published.train(recipe, Aligned.of(frames), Aligned.of(frames), Aligned.of(frames).range(), steps=60)
    assert told["curve"][-1][1] > told["curve"][0][1] + 10  # dB
    assert (
        published.test(recipe, net, Aligned.of(frames), Aligned.of(frames).range())["psnr"] > told["curve"][0][1] + 10
    )
    monkeypatch.setattr(published, "_affordable", lambda *_: 30)  # however busy the machine is
    for _ in range(2):
        published.run(["all"], Aligned.of(frames), Aligned.of(frames), 0.1, tmp_path, "Draping")
        monkeypatch.setattr(published, "train", None)  # not called again
    assert set(loads((tmp_path / "published.json").read_text())) == {"all"}
    curve = read_rows(tmp_path / f"{CONVERGENCE}.csv", ConvergenceRow)
    assert {row.feature for row in curve} == set(FEATURES)
    assert not list(tmp_path.glob("*.part"))


def test_a_published_training_has_the_steps_that_its_time_allows() -> None:
    def batch(_: int) -> torch.Tensor:
        sleep(0.01)
        return torch.zeros(1, requires_grad=True).sum()

    assert 1 <= published._affordable(batch, 0.5) <= 50
    assert published._affordable(batch, 1e-4) == 1


def test_a_published_training_that_was_stopped_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few, many = (torch.from_numpy(crumpled(grid, 1)).repeat(8, 1, 1, 1) for grid in (SMALL, LARGE))
    pairs = Aligned.of(Frames(few, many, torch.zeros(8), SMALL, LARGE, 0.04))
    recipe, loss = published.Recipe(size=published.SMALL, windows=1), published.loss
    whole, told = published.train(recipe, pairs, pairs, pairs.range(), steps=24)
    left = [17]

    def stopping(*given: Any) -> torch.Tensor:
        left[0] -= 1
        if not left[0]:
            raise KeyboardInterrupt
        return loss(*given)

    monkeypatch.setattr(published, "loss", stopping)
    kept = Kept(tmp_path / "all.part", "mark", every=10)
    with pytest.raises(KeyboardInterrupt):
        published.train(recipe, pairs, pairs, pairs.range(), steps=24, kept=kept)
    again, found = published.train(recipe, pairs, pairs, pairs.range(), seconds=1.0, kept=kept)
    assert (found["steps"], found["curve"]) == (24, told["curve"])
    for a, b in zip(whole.parameters(), again.parameters(), strict=True):
        assert torch.equal(a, b)


def test_a_published_training_does_not_take_what_is_of_other_pairs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither figures, nor weights or a plan that were half done: every scene's folder is the same by default."""
    few, many = (torch.from_numpy(crumpled(grid, 1)).repeat(8, 1, 1, 1) for grid in (SMALL, LARGE))
    pairs = Aligned.of(Frames(few, many, torch.zeros(8), SMALL, LARGE, 0.04))
    other = Aligned.of(Frames(few + 0.01 * torch.rand(few.shape), many, torch.zeros(8), SMALL, LARGE, 0.04))
    monkeypatch.setattr(published, "RECIPES", {"all": published.Recipe(size=published.SMALL, windows=1)})
    monkeypatch.setattr(published, "_affordable", lambda *_: 2)
    whole = published.test

    def stopped(*_: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(published, "test", stopped)  # both steps are done and kept
    with pytest.raises(KeyboardInterrupt):
        published.run(["all"], pairs, pairs, 1.0, tmp_path, "Draping")
    monkeypatch.setattr(published, "test", whole)
    for one, scene in ((other, "Draping"), (pairs, "Hitting")):
        with pytest.raises(ValueError, match="of another recipe or other data"):
            published.run(["all"], one, one, 1.0, tmp_path, scene)
    (tmp_path / "all.part").unlink()  # as if stopped before anything was kept
    monkeypatch.setattr(published, "_affordable", lambda *_: 3)
    published.run(["all"], other, other, 1.0, tmp_path, "Draping")
    assert loads((tmp_path / "published.json").read_text())["all"]["steps"] == 3
    for one, scene in ((pairs, "Draping"), (other, "Hitting")):
        with pytest.raises(ValueError, match="of other pairs: give another folder as --out"):
            published.run(["all"], one, one, 1.0, tmp_path, scene)


@pytest.mark.parametrize(
    "option", [{"width": 5}, {"width": 6}, {"layers": 0}, {"steps": 0}, {"windows": -1}, {"strain": -1.0}]
)
def test_a_recipe_of_nothing_is_refused(option: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(option))} must be"):
        Recipe(**option)


@pytest.mark.parametrize("given", [["--seconds", "0"], ["--frames", "3"]])
def test_a_published_training_of_nothing_is_refused(given: list[str]) -> None:
    with pytest.raises(ValueError, match="--seconds must be over 0 and --frames at least 4"):
        published.main(given)


def test_the_published_rate_falls_by_ten_until_the_middle() -> None:
    rate = published.published_rate(1e-4, 240)
    assert [rate(step) for step in (0, 39, 40, 80, 120, 239)] == pytest.approx([1e-4, 1e-4, 1e-5, 1e-6, 1e-7, 1e-7])


@BOTH
def test_edges_that_are_too_long_are_told(periodic: bool) -> None:
    """Of a sheet twice as large as at rest, of strain 1; of a tube but for chords in place of its arcs."""
    grid = LARGE_TUBE if periodic else LARGE
    sheet = at_rest(grid)[None]
    assert overlong(sheet, grid) == 0
    chord = 1 - (np.pi / grid.cols) ** 2 / 6 if periodic else 1
    down, along = (2 - 1 - 0.5) ** 2, (2 * chord - 1 - 0.5) ** 2
    counts = grid.cells[0] * grid.cols, grid.rows * grid.cells[1]
    mean = (counts[0] * down + counts[1] * along) / sum(counts)
    np.testing.assert_allclose(overlong(2 * sheet, grid), mean, rtol=1e-4)


@BOTH
def test_what_is_finer_than_the_coarse_grid_is_what_its_waves_lack(periodic: bool) -> None:
    """Up to the one of which two coarse cells are one."""
    few, many = 8, 32
    project = coarse_modes(few, many, periodic)
    for waves in range(many // 2 if periodic else many):  # half ones between open ends
        at = np.arange(many) * 2 / many if periodic else (np.arange(many + 1) + 0.5) / (many + 1)
        wave = np.cos(np.pi * waves * at)
        known = waves <= (few // 2 if periodic else few)
        np.testing.assert_allclose(project @ wave, wave if known else 0 * wave, atol=1e-12)
