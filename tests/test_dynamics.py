"""The learned correction of the coarse dynamics: symmetry, bounds, handles, and a small training."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cloth_envs.registry import SCENES as REGISTERED
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from surrogates.checkpoint import WEIGHTS, load
from surrogates.miniature.backend import MiniatureBackend
from surrogates.miniature.correction import ARRAYS, Correction, shipped, weights_name
from training.dynamics.data import Course, Episodes, episodes
from training.dynamics.train import LIMIT, Recipe, Trainer, main

HIDDEN = 8
SCENES = ("Flag", "BallDrop", "Curtain")  # wind, bodies, neither
EPS = float(np.finfo(np.float32).eps)


def coarse(scene: str) -> Scene:
    return MiniatureBackend(World(scene).scene, factor=4).coarse.scene


def network(scene: Scene, bound: float = 1e6) -> Correction:
    """Random weights; features are clipped to ``bound``."""
    rng, count = np.random.default_rng(0), Correction(scene, {}).features(*frames(scene))[0].shape[-1]
    shapes = [(HIDDEN, count), (HIDDEN,), (HIDDEN, HIDDEN), (HIDDEN,), (6, HIDDEN), (6,), (count,), (count,), (6,)]
    arrays = {name: rng.normal(size=shape) / shape[-1] for name, shape in zip(ARRAYS, shapes, strict=True)}
    arrays |= {"low": np.full(count, -bound), "high": np.full(count, bound), "limit": np.full(6, 0.2)}
    return Correction(scene, {name: a.astype(np.float32) for name, a in arrays.items()})


def frames(scene: Scene) -> tuple[State, State]:
    """A waved sheet within 2 m of the origin before and after a frame, at speeds of about 1 m/s."""
    rng, (h, w) = np.random.default_rng(1), scene.grid.shape
    v, u = np.meshgrid(np.linspace(0, 1, h), np.linspace(0, 1, w), indexing="ij")
    x = np.stack([0.7 * u * scene.grid.width, 0.1 * np.sin(9 * u + 3 * v), -v * scene.grid.height])[None]
    bodies = np.broadcast_to([[0.1, 0.3, -0.2], [0.0, 0.0, 1.0]], (1, len(scene.colliders), 2, 3)).copy()
    after = replace(State.still(x, bodies), wind=rng.normal(size=(1, 3)), velocities=rng.normal(size=x.shape))
    return replace(after, velocities=rng.normal(size=x.shape)), after


def corrected(correction: Correction, before: State, after: State) -> State:
    out = after.copy()
    correction.apply(out, *correction.features(before, out))
    return out


@pytest.mark.parametrize("name", SCENES)
def test_turning_the_scene_about_the_vertical_turns_the_answer(name: str) -> None:
    scene = coarse(name)
    correction, turn = network(scene), Rotation.from_euler("z", 1.1).as_matrix()

    def turned(state: State) -> State:
        cloth = {n: np.einsum("ij,bjhw->bihw", turn, getattr(state, n)) for n in ("positions", "velocities")}
        return replace(state, **cloth, colliders=state.colliders @ turn.T, wind=state.wind @ turn.T)

    before, after = frames(scene)
    one, other = turned(corrected(correction, before, after)), corrected(correction, turned(before), turned(after))
    # Differences of coordinates within 2 m carry 4 eps m; over the spacing they enter some hundred features, and the
    # normalised weights hand on at most the largest of them. The answer comes back in spacings, and those per frame.
    rounding = 100 * 4 * EPS
    assert abs(one.positions - other.positions).max() < rounding
    assert abs(one.velocities - other.velocities).max() < rounding / scene.frame_dt
    assert abs(one.positions - turned(after).positions).max() > 100 * rounding


@pytest.mark.parametrize("name", SCENES)
def test_handles_stay_and_answers_are_bounded(name: str) -> None:
    scene = coarse(name)
    correction = network(scene)
    correction.arrays["weight2"] *= 1e6
    before, after = frames(scene)
    found = corrected(correction, before, after)
    moved = np.linalg.norm(found.positions - after.positions, axis=1).reshape(-1)
    # Each of three components within its limit.
    assert 0 < moved.max() <= np.sqrt(3) * 0.2 * scene.grid.row_spacing * (1 + 100 * EPS)
    assert not moved[list(scene.handles)].any()


def test_a_tube_float64_and_missing_weights_are_refused() -> None:
    scene = coarse("Curtain")
    with pytest.raises(ValueError, match="no tubes"):
        Correction(replace(scene, grid=replace(scene.grid, periodic=True)), {})
    exact = MiniatureBackend(World("Curtain").scene, factor=4, solver_kwargs={"dtype": "float64"}).coarse
    with pytest.raises(ValueError, match="leave dtype out"):
        exact.correct(network(exact.scene))
    with pytest.raises(ValueError, match="minicloth train dynamics --scenes Nowhere"):
        shipped("Nowhere", 4)


@pytest.fixture(autouse=True, scope="module")
def short_episodes() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for module in ("data", "train"):
            patch.setattr(f"training.dynamics.{module}.FRAMES", 30)
        yield


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("dynamics")


@pytest.fixture(scope="module")
def data(cache: Path) -> Episodes:
    return episodes("Curtain", range(1000, 1003), 4, ("smooth",), cache)


def test_a_small_training_descends_on_its_own_episodes(data: Episodes, tmp_path: Path) -> None:
    """Along all five frames of restarts: by a fifth to a quarter of the error when this was written."""
    trainer = Trainer(data, Recipe(hidden=16, warm=200, steps=2, horizon=5))
    arrays = trainer.fit(tmp_path / "net", "")
    found = Course(data, "closure", trainer.correction).errors(5)
    assert (found < Course(data, "closure").errors(5)).all()
    assert arrays["limit"] == pytest.approx(LIMIT * trainer.scale.numpy())


def test_a_stopped_training_goes_on(
    data: Episodes,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    stopped: Callable[[int], AbstractContextManager[object]],
) -> None:
    """On frames and on windows, where it is told from the best network so far too."""
    monkeypatch.setattr("training.dynamics.train.LOOK", 2)
    recipe = Recipe(hidden=4, warm=5, steps=5, horizon=2, batch=2)
    whole = Trainer(data, recipe).fit(tmp_path / "whole", "")
    for steps in (3, 6):  # of 10, and of the 8 that are then left
        with stopped(steps):
            Trainer(data, recipe).fit(tmp_path / "parts", "")
    assert {path.name for path in tmp_path.iterdir()} >= {"parts.0.pt", "parts.1.pt"}
    found = Trainer(data, recipe).fit(tmp_path / "parts", "")
    for name, value in whole.items():
        np.testing.assert_array_equal(found[name], value)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("bound", [1e6, 0.1])
def test_the_compiled_correction_of_a_frame_is_its_numpy_twin(name: str, bound: float) -> None:
    world = World(name, num_envs=2)
    world.reset({i: np.random.default_rng(i) for i in range(2)})
    solvers = [MiniatureBackend(world.scene, num_envs=2, factor=4, scaling="closure") for _ in range(2)]
    for solver in solvers:
        solver.reset(world.state)
    tested, plain = (solver.coarse for solver in solvers)
    correction = network(tested.scene, bound)
    tested.correct(correction)
    controls = Controls.hold(world.state, world.scene.handles)
    before = plain.state.copy()
    expected = corrected(correction, before, plain.advance(controls))
    tested.advance(controls)
    # As in the turned scene: rounding of coordinates within 2 m, over a few hundred sums of about 1.
    rounding = 100 * 4 * EPS
    assert abs(tested.state.positions - expected.positions).max() < rounding
    assert abs(tested.state.velocities - expected.velocities).max() < rounding / world.scene.frame_dt
    assert abs(expected.positions - plain.state.positions).max() > 10 * rounding


def test_the_command_writes_weights_and_a_card(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("training.dynamics.train.HELD_OUT", (200, 201))
    given = ["--scenes", "Curtain", "--factors", "4", "--seeds", "2", "--warm", "5", "--steps", "1", "--hidden", "4"]
    assert main([*given, "--out", str(tmp_path), "--cache", str(cache)]) == 0
    found = load(weights_name("Curtain"), tmp_path)
    assert {name.removeprefix("4.") for name in found.arrays} == set(ARRAYS)
    assert set(found.card["factors"]["4"]["held-out error [% of length] after frames"]) == {
        "calibrated",
        "closure",
        "learned",
    }
    with pytest.raises(ValueError, match="Curtain"):
        main(["--scenes", "Curtan"])


def test_a_corrected_world_goes_on_from_what_was_saved() -> None:
    options = {"factor": 4, "scaling": "closure", "correction": "learned"}
    world = World("Curtain", backend="miniature", backend_kwargs=options)
    world.reset({0: np.random.default_rng(0)})
    action = np.full((1, len(world.task.actions)), 0.5)
    ends, plain = [], World("Curtain", backend="miniature", backend_kwargs={"factor": 4, "scaling": "closure"})
    plain.reset({0: np.random.default_rng(0)})
    for _ in range(3):
        world.step(action), plain.step(action)
    saved = world.get_state()
    for _ in range(2):
        world.set_state(saved)
        world.step(action)
        ends.append(world.state.positions.copy())
    plain.step(action)
    assert np.array_equal(*ends)
    assert 1e-4 < abs(ends[0] - plain.state.positions).max() < 0.3


def test_corrections_that_fit_nothing_are_refused() -> None:
    scene = World("Curtain").scene
    for options, words in (
        ({"correction": "lerned", "scaling": "closure"}, "learned"),
        ({"correction": "learned", "scaling": "similar"}, 'scaling="closure"'),
        ({"correction": "learned", "scaling": "closure", "factor": 3}, "minicloth train dynamics"),
    ):
        with pytest.raises(ValueError, match=words):
            MiniatureBackend(scene, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("path", sorted(WEIGHTS.glob("dynamics_*.json")), ids=lambda path: path.stem)
def test_shipped_weights_fit_their_scene_and_gained_on_held_out_seeds(path: Path) -> None:
    card = json.loads(path.read_text())
    name = next(scene for scene in REGISTERED if weights_name(scene) == path.stem)
    for factor, entry in card["factors"].items():
        Correction(
            MiniatureBackend(World(name).scene, factor=int(factor)).coarse.scene, shipped(name, int(factor))
        ).compiled()
        errors = entry["held-out error [% of length] after frames"]
        for frames, learned in errors["learned"].items():
            assert learned < min(errors["calibrated"][frames], errors["closure"][frames])
