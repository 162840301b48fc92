"""A list of backends: what members share, what of each stays its own, and what comes back from saved states."""

import copy
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import cloth_envs
from cloth_envs.choice import choices
from cloth_envs.mixed import MixedBackend
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.state import LazyState
from surrogates.upscale.protocol import Upscaler

SMALL: dict[str, Any] = {"resolution": (9, 13), "randomize": {"areal_density": (0.1, 0.3)}}
MIXED = ["miniature", "reference", "miniature", "cnn"]


def many(backend: Any = MIXED, scene: str = "Flag", **options: Any) -> Any:
    count = len(backend) if isinstance(backend, list) else 4
    return gym.make_vec(cloth_envs.env_id(scene), **{"num_envs": count, "backend": backend, **SMALL, **options})


def parts(env: Any) -> list[tuple[list[int], Any]]:
    return [(members.tolist(), backend) for members, backend in env.unwrapped.world.backend.parts]


def run(env: Any, frames: int = 4) -> list[np.ndarray]:
    """Observations and rewards under actions that are the same for all members."""
    rng, seen = np.random.default_rng(0), []
    for _ in range(frames):
        actions = np.broadcast_to(rng.uniform(-1, 1, env.single_action_space.shape), env.action_space.shape)
        seen += env.step(actions)[:2]
    return seen


def same(one: list[np.ndarray], other: list[np.ndarray]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def test_equal_choices_share_a_batch() -> None:
    fourth = {"factor": np.int64(4)}  # as Python's 4
    kwargs = [{"factor": 4}, None, {"factor": 2}, {}, fourth, {"factor": 2}, {}]
    env = many(
        ["miniature", "reference", "miniature", "reference", "miniature", "miniature", "cnn"], backend_kwargs=kwargs
    )
    assert [members for members, _ in parts(env)] == [[0, 4], [1, 3], [2, 5], [6]]
    assert [backend.factor for _, backend in parts(env)[::2][:2]] == [4, 2]
    assert env.unwrapped.backends == ("miniature", "reference") * 2 + ("miniature", "miniature", "cnn")
    assert "2 x miniature, 2 x reference, 2 x miniature, 1 x cnn" in repr(env.unwrapped)
    assert not isinstance(many(["reference"] * 2, backend_kwargs=[{}, None]).unwrapped.world.backend, MixedBackend)
    by_options = many("miniature", backend_kwargs=[{"factor": 2}] * 3 + [{"factor": 4}])  # a name is for all
    assert [members for members, _ in parts(by_options)] == [[0, 1, 2], [3]]
    assert many(physics=MIXED, backend=None).unwrapped.backends == tuple(MIXED)


@pytest.mark.parametrize("library", ["numpy", "torch"])
def test_arrays_are_equal_to_themselves_only(library: str) -> None:
    ones = pytest.importorskip(library).ones
    own = {"table": ones(3)}
    assert [choice.members for choice in choices("mine", [own, {"table": ones(3)}, own], 3)] == [[0, 2], [1]]


@pytest.mark.parametrize("scene", list(cloth_envs.SCENES))
def test_equal_seeds_are_equal_starts_in_equal_spaces(scene: str) -> None:
    env, plain = many(scene=scene), many("reference", scene=scene)
    assert env.observation_space == plain.observation_space
    assert env.action_space == plain.action_space
    first, _ = env.reset(seed=[5] * 4)
    assert np.array_equal(first, plain.reset(seed=[5] * 4)[0])
    assert (first == first[0]).all()
    found, wanted = run(env)[-2], run(plain)[-2]
    assert np.array_equal(found[[1, 3]], wanted[[1, 3]])  # the cnn is the reference to the bit
    assert np.array_equal(found[0], found[2])
    assert not np.array_equal(found[0], found[1])
    assert env.observation_space.contains(found)


def test_a_pair_stays_a_pair_over_resets() -> None:
    env = many(["miniature", "reference"], "BallDrop", max_episode_steps=3)
    first, _ = env.reset(seed=[7, 7])
    for _ in range(4):
        again = env.step(np.zeros(env.action_space.shape, np.float32))[0]
    assert np.array_equal(again[0], again[1])
    assert not np.array_equal(again[0], first[0])


def test_geometry_images_too() -> None:
    env = many(obs="mesh")
    env.reset(seed=1)
    ones = [gym.make("MiniCloth-Flag-v0", backend=name, obs="mesh", **SMALL) for name in MIXED]
    for i, one in enumerate(ones):
        one.reset(seed=1 + i)
    actions = np.full(env.action_space.shape, 0.5, np.float32)
    found = env.step(actions)[0]
    for i, one in enumerate(ones):
        wanted = one.step(actions[i])[0]
        assert all(np.array_equal(found[name][i], wanted[name]) for name in ("mesh", "task"))


def test_cloths_stay_unread_and_time_is_exact() -> None:
    env = many(["miniature", "reference"])
    env.reset(seed=0)
    world = env.unwrapped.world
    (_, miniature), (_, reference) = parts(env)
    for _ in range(70):
        world.advance(np.zeros((2, 2)))
    assert isinstance(world.backend.state, LazyState)
    now = world.backend.advance(world.controls)
    assert "not read" in repr(now)
    assert "not read" in repr(miniature.state)
    assert np.array_equal(now.positions[0], miniature.state.positions[0])
    assert np.array_equal(now.positions[1], reference.state.positions[0])
    dt = world.scene.frame_dt
    assert now.time.tolist() == [70 * dt + dt] * 2  # the parts began at the batch's time, not at their sum of frames
    assert 70 * dt + dt != sum([dt] * 71)


class Torn(Upscaler):
    """Bicubic, but for a vertex two metres away."""

    def positions(self, history: Any) -> np.ndarray:
        x = self.bicubic(history[-1].positions)
        x[..., 8, 8] += 2.0
        return x


def test_infos_are_those_of_each_member() -> None:
    """The guard of one's miniature, and the crossings of another's cloth, also of single environments."""
    kwargs: list[dict[str, Any]] = [{}, {"upscaler": f"{__name__}:Torn", "mend": False}, {}, {"solver": "admm"}]
    names = ["miniature", "miniature", "reference", "reference"]
    env = many(names, "Hanging", backend_kwargs=kwargs, resolution=(17, 17), randomize=None)
    env.reset(seed=[0] * 4)
    row, col = np.indices((17, 17))
    side = np.where(col < 8, 1, -1)  # two upright halves that lean through each other
    width = env.unwrapped.scene.grid.width
    x = side * (col - 8) * width / 32
    folded = np.stack([x, side * (0.11 * width + x), 1 + (row + 0.2 * side) * width / 16])
    still = np.zeros((4, 3), np.float32)
    for which in (0, 2):
        env.unwrapped.world.set_positions(folded, which=which)
    infos = env.step(still)[4]
    assert infos["guard"].tolist() == infos["_guard"].tolist() == [False, True, False, False]
    assert infos["_crossings_at_start"].tolist() == [True, False, True, False]
    for i, (name, own) in enumerate(zip(names, kwargs, strict=True)):
        options = {"backend": name, "backend_kwargs": own, "resolution": (17, 17)}
        one: Any = gym.make(cloth_envs.env_id("Hanging"), **options)
        one.reset(seed=0)
        if i in (0, 2):
            one.unwrapped.set_positions(folded)
        info = one.step(still[i])[4]
        assert {n: infos[n][i] for n in infos if not n.startswith("_") and infos[f"_{n}"][i]} == info
        assert ("guard" in info, "crossings_at_start" in info) == (i == 1, i in (0, 2))


def test_the_scene_lists_self_contact_that_all_model() -> None:
    env = many(["reference"] * 2, "Curtain", backend_kwargs=[{}, {"solver": "admm"}])
    assert env.unwrapped.scene.self_contact is None
    assert parts(env)[0][1].scene.self_contact is not None  # whose member has it nevertheless
    assert many(["reference", "miniature"], "Curtain").unwrapped.scene.self_contact is not None
    plain = many("reference", "Curtain", num_envs=2)
    env.reset(seed=0)
    run(env)
    plain.set_state(env.get_state())  # of one task
    assert np.array_equal(plain.unwrapped.state.positions, env.unwrapped.state.positions)
    with pytest.raises(ValueError, match=r"member 1: self_contact=True: reference .*admm"):
        many(["reference"] * 2, "Curtain", backend_kwargs=[{}, {"solver": "admm"}], self_contact=True)
    without = many(["reference"] * 2, "Curtain", backend_kwargs=[{}, {"solver": "admm"}], self_contact=False)
    assert parts(without)[0][1].scene.self_contact is None


def test_materials_are_those_that_all_can_step() -> None:
    with pytest.raises(ValueError, match=r"randomize allows .*compression.*AdmmSolver"):
        many(["reference"] * 2, backend_kwargs=[{}, {"solver": "admm"}], randomize={"compression": (0.1, 1)})


def test_saved_states_go_on_and_are_never_another_members() -> None:
    env, again = many(), many()
    env.reset(seed=1)
    run(env)
    saved = env.get_state()
    assert {"backend.0,2.positions", "backend.0,2.offsets"} <= set(saved)
    future = run(env)
    again.set_state(saved)
    assert same(run(again), future)
    env.set_state(saved)
    assert same(run(env), future)
    # Another split has as many miniatures, and continues from the cloths, as a uniform batch does.
    for other in (many(["miniature", "miniature", "reference", "cnn"]), many("reference"), many("miniature")):
        other.set_state(saved)
        assert np.array_equal(other.unwrapped.state.positions, saved["state.positions"])
        fresh = many(list(other.unwrapped.backends))
        for twin in (other, fresh):
            twin.set_state({name: value for name, value in saved.items() if not name.startswith("backend.")})
        other.set_state(saved)
        assert same(run(other), run(fresh))
    for name in ("backend.0,2.positions", "state.positions"):
        bad = {**saved, name: saved[name][:1]}
        with pytest.raises(ValueError, match=name.replace(".", r"\.")):
            again.set_state(bad)


class Lifted(ExplicitSolver):
    """Recalls where its cloth was, from a state that does not tell."""

    @property
    def memory(self) -> dict[str, np.ndarray]:
        return {"height": self.state.positions[:, 2]}

    def recall(self, memory: dict[str, np.ndarray]) -> None:
        self._state = self.state.copy()
        self._state.positions[:, 2] = memory["height"]


def test_what_is_recalled_is_shown() -> None:
    env = many([f"{__name__}:Lifted", "reference"])
    env.reset(seed=0)
    saved = env.get_state()
    saved["backend.0.height"] = saved["backend.0.height"] + np.float32(0.5)
    env.set_state(saved)
    moved = env.unwrapped.state.positions[:, 2] - saved["state.positions"][:, 2]
    np.testing.assert_allclose(moved, np.broadcast_to([[[0.5]], [[0.0]]], moved.shape), atol=1e-6)


@pytest.mark.parametrize(
    "way", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["deepcopy", "pickle"]
)
def test_copies_go_on(way: Any) -> None:
    env = many(max_episode_steps=5)
    env.reset(seed=2)
    run(env, 3)
    twin = way(env)
    assert same(run(twin), run(env))  # over the end of an episode


def test_registered_backends_travel(monkeypatch: pytest.MonkeyPatch) -> None:
    table = dict(cloth_envs.BACKENDS)
    monkeypatch.setattr("cloth_envs.registry.BACKENDS", table)
    monkeypatch.setattr("cloth_envs.world.BACKENDS", table)
    cloth_envs.register_backend("mine", ExplicitSolver)
    env = many(["mine", "miniature"])
    env.reset(seed=0)
    saved = pickle.dumps(env)
    del table["mine"]  # as in a process that knows none
    assert same(run(pickle.loads(saved)), run(env))
