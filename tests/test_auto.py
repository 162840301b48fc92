"""``backend="auto"``: chooses by its table, is what it chose to the bit, verifies and goes on closer."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from cloth_envs import env_id
from cloth_envs.world import World
from surrogates.auto.backend import AutoBackend
from surrogates.auto.table import HORIZONS, Table
from training.bench.benchmark import MEASURED

SHAPE = (17, 25)


def entry(**ms_and_error: tuple[float, float]) -> list[dict[str, Any]]:
    """Of miniatures of factors x4, x2, ... and the reference: time, and the error at every horizon."""
    return [
        {
            "backend": "reference" if name == "reference" else "miniature",
            "options": {} if name == "reference" else {"factor": int(name[1:])},
            "ms": ms,
            "error": {str(frames): error for frames in HORIZONS},
        }
        for name, (ms, error) in ms_and_error.items()
    ]


@pytest.fixture(autouse=True)
def table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A table of a small flag."""
    material = World("Flag").scene.material.as_dict()
    scene = {
        "measured on": {"resolution": SHAPE, "material": material},
        "floor": {str(frames): 0.01 for frames in HORIZONS},
        "backends": entry(x4=(0.1, 2.0), x3=(0.2, 3.0), x2=(0.3, 0.5), reference=(2.0, 0.1)),
    }
    (tmp_path / "auto.json").write_text(json.dumps({"scenes": {"Flag": scene}}))
    monkeypatch.setattr("surrogates.auto.table.WEIGHTS", tmp_path)
    Table.of.cache_clear()
    yield
    Table.of.cache_clear()


def world(n: int = 1, **options: Any) -> World:
    made = World("Flag", num_envs=n, backend="auto", backend_kwargs=options, resolution=SHAPE)
    made.reset({i: np.random.default_rng(i) for i in range(n)})
    return made


def inside(made: World) -> AutoBackend:
    assert isinstance(made.backend, AutoBackend)
    return made.backend


@pytest.mark.parametrize(
    ("options", "chosen"),
    [
        ({}, "miniature factor=4"),  # 3 % after 5 frames
        ({"tolerance": 1}, "miniature factor=2"),
        ({"tolerance": 5}, "miniature factor=4"),
        ({"tolerance": 2.4}, "miniature factor=2"),  # 2 % of the table are not enough under other actions
        ({"tolerance": 0.4}, "reference solver=explicit"),
        ({"tolerance": 0.05}, "reference solver=explicit"),
        ({"budget_ms": 0.25}, "miniature factor=4"),
        ({"budget_ms": 1.0}, "miniature factor=2"),
        ({"budget_ms": 3.0}, "reference solver=explicit"),
    ],
)
def test_it_takes_the_cheapest_that_held_and_says_so(options: dict[str, float], chosen: str) -> None:
    made = world(**options)
    assert made.surrogate[0].startswith(f"{chosen}: ")
    assert made.surrogate[0] in made.describe()


def test_it_is_what_it_chose_to_the_bit() -> None:
    auto = world(n=2, tolerance=1)
    own = World("Flag", num_envs=2, backend="miniature", backend_kwargs={"factor": 2}, resolution=SHAPE)
    own.reset({i: np.random.default_rng(i) for i in range(2)})
    for k in range(12):
        for made in (auto, own):
            made.step(np.full((2, 2), np.sin(k)))
    np.testing.assert_array_equal(auto.state.positions, own.state.positions)
    np.testing.assert_array_equal(auto.observe(), own.observe())


@pytest.mark.parametrize(
    "options",
    [{"material": {"areal_density": 0.3}}, {"resolution": (17, 27)}, {"preset": "lee2019"}, {"material": "leather"}],
)
def test_beyond_its_table_it_is_the_reference(options: dict[str, Any]) -> None:
    made = World("Flag", backend="auto", **{"resolution": SHAPE, **options})
    made.reset({0: np.random.default_rng(0)})
    assert made.surrogate[0].startswith("reference solver=explicit: ")
    assert type(inside(made).inner) is type(World("Flag").backend)


def test_a_tolerance_below_the_chaos_floor_is_refused_with_it() -> None:
    with pytest.raises(ValueError, match=r"below the chaos floor.*0\.01 % after 25 frames"):
        world(tolerance=0.005, horizon=25)


BAD: list[tuple[dict[str, Any], str]] = [
    ({"tolerance": 0}, "tolerance must be a positive number"),
    ({"tolerance": "1"}, "tolerance must be a positive number"),
    ({"tolerance": 1, "budget_ms": 1}, "give one of them"),
    ({"horizon": 7}, "one of 1, 5, 10, 25"),
    ({"verify": 1.5}, "verify must be a number from 0 to 1"),
    ({"budget_ms": 0.01}, "below the cheapest, miniature factor=4"),
]


@pytest.mark.parametrize(("options", "why"), BAD, ids=lambda value: str(value))
def test_bad_options_are_refused(options: dict[str, Any], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        world(**options)


def test_verified_errors_are_the_distance_from_the_reference() -> None:
    env = gym.make(env_id("Flag"), backend="auto", backend_kwargs={"verify": 1.0, "tolerance": 50}, resolution=SHAPE)
    _, info = env.reset(seed=0)
    assert info["surrogate"].startswith("miniature factor=4")
    own = World("Flag", resolution=SHAPE)
    own.reset({0: np.random.default_rng(0)})
    backend, told = own.backend, []
    made = env.unwrapped.world  # type: ignore[attr-defined]
    backend.reset(made.state.copy(), [made.scene.material])
    for frame in range(1, 11):
        *_, info = env.step(np.array([1.0, -1.0]))
        true = backend.advance(made.controls)
        told.append("measured_error" in info)
        if frame % 5 == 0:
            gap = np.linalg.norm(made.state.positions[0].astype(float) - true.positions[0], axis=0).mean()
            assert info["measured_error"] == pytest.approx(100 * gap / own.scene.grid.length, rel=1e-5)
            assert info["measured_error"] > 0
            backend.reset(made.state.copy(), [made.scene.material])
    assert told == [frame % 5 == 0 for frame in range(1, 11)]


def test_it_goes_on_closer_where_the_tolerance_is_left() -> None:
    made = world(n=2, tolerance=2.6, verify=1.0)
    chosen = []
    for k in range(40):
        chosen.append(made.surrogate[0].split(":")[0])
        made.step(np.full((2, 2), (-1.0) ** (k // 7)))
    assert chosen[0] == "miniature factor=4"
    assert chosen[-1] in ("miniature factor=2", "reference solver=explicit")
    assert "left the tolerance of 2.6 %" in made.surrogate[0]


@pytest.mark.parametrize("frames", [3, 8, 21])
def test_a_saved_state_goes_on_bit_for_bit(frames: int) -> None:
    def step(made: World, first: int, last: int) -> list[np.ndarray]:
        found = []
        for k in range(first, last):
            made.step(np.full((2, 2), (-1.0) ** (k // 7)))
            found.append(np.concatenate([made.state.positions.ravel(), made.measured_error]))
        return found

    one = world(n=2, tolerance=2.6, verify=0.6)
    step(one, 0, frames)
    saved = one.get_state()
    other = world(n=2, tolerance=2.6, verify=0.6)
    other.set_state(saved)
    np.testing.assert_array_equal(step(one, frames, frames + 25), step(other, frames, frames + 25))


def test_a_stretch_does_not_cross_a_reset() -> None:
    made = world(n=2, verify=1.0, tolerance=50)
    made.step(np.zeros((2, 2)))
    made.reset({1: np.random.default_rng(7)})
    for _ in range(4):
        made.step(np.zeros((2, 2)))
    assert np.isfinite(made.measured_error).tolist() == [True, False]


def test_vector_environments_tell_errors_as_gymnasium_does() -> None:
    options = {"backend": "auto", "backend_kwargs": {"verify": 1.0, "tolerance": 50}, "resolution": SHAPE}
    env = gym.make_vec(env_id("Flag"), num_envs=2, autoreset_mode="Disabled", **options)
    singles = [gym.make(env_id("Flag"), **options) for _ in range(2)]
    env.reset(seed=[0, 1])
    for i, single in enumerate(singles):
        single.reset(seed=i)
    env.step(np.zeros((2, 2), np.float32))
    env.reset(seed=[None, 7], options={"reset_mask": np.array([False, True])})
    singles[0].step(np.zeros(2, np.float32))
    singles[1].reset(seed=7)
    for _ in range(4):
        *_, infos = env.step(np.zeros((2, 2), np.float32))
        told = [single.step(np.zeros(2, np.float32))[4] for single in singles]
    assert ["measured_error" in info for info in told] == [True, False]
    want: dict[str, Any] = {}
    for i, info in enumerate(told):
        want = env.unwrapped._add_info(want, info, i)
    names = {"measured_error", "reward_shown", "success", "distance", "strain", "change"}
    assert infos.keys() == want.keys() == names | {f"_{name}" for name in names}
    for name, values in want.items():
        np.testing.assert_array_equal(infos[name], values)
        assert infos[name].dtype == values.dtype


def test_the_shipped_table_knows_every_measured_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    Table.of.cache_clear()
    for name in MEASURED:
        known, scene = Table.of(name), World(name).scene
        assert known is not None
        assert known.beyond(scene, scene.material) == ""
        assert {option.backend for option in known.options} == {"reference", "miniature"}
        assert all(known.floor[frames] >= 0 for frames in HORIZONS)
