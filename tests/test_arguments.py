"""What users write: NumPy's numbers count as Python's, and a mistake is answered by what to write instead."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import cloth_envs
from cloth_envs.material import warn_once
from cloth_envs.registry import EPISODE_FRAMES, make_backend

ID = "MiniCloth-Flag-v0"
SMALL = {"resolution": (9, 13)}
MEMBERS = 3


def one(**options: Any) -> gym.Env[Any, Any]:
    return gym.make(ID, **SMALL | options)


def skirt(**options: Any) -> gym.Env[Any, Any]:
    return gym.make("MiniCloth-Skirt-v0", **{"resolution": (25, 52), **options})


def many(**options: Any) -> gym.vector.VectorEnv[Any, Any, Any]:
    return gym.make_vec(ID, **{"num_envs": MEMBERS, **SMALL, **options})


def physics(backend: str = "reference", **options: Any) -> gym.Env[Any, Any]:
    return one(backend=backend, backend_kwargs=options)


def miniature(**options: Any) -> gym.Env[Any, Any]:
    return physics("miniature", **options)


def cnn(**options: Any) -> gym.Env[Any, Any]:
    return physics("cnn", **options)


# What is done -> words of the sentence that answers it.
MISTAKES: dict[str, tuple[Callable[[], object], list[str]]] = {
    "fabric": (lambda: one(fabric="silk"), ["'fabric'", "mean 'material'", "'resolution'"]),
    "solver": (lambda: one(solver="admm"), ["write backend_kwargs={'solver': 'admm'}"]),
    "iterations": (lambda: one(iterations=4), ["backend_kwargs={'solver': 'admm', 'iterations': 4}"]),
    "refine": (lambda: one(refine=2), ["backend_kwargs={'refine': 2}"]),
    "refine beside threads": (
        lambda: one(refine=2, backend_kwargs={"threads": 2}),
        ["backend_kwargs={'threads': 2, 'refine': 2}"],
    ),
    "factor": (lambda: one(factor=4), ["backend='miniature', backend_kwargs={'factor': 4}"]),
    "engine": (lambda: one(engine="torch"), ["backend='cnn', backend_kwargs={'engine': 'torch'}"]),
    "backends": (lambda: one(backends="cnn"), ["mean 'backend'"]),
    "seed": (lambda: one(seed=1), ["env.reset(seed=1)"]),
    "render": (lambda: one(render=True), ["mean 'render_mode'"]),
    "rendermode": (lambda: one(rendermode="rgb_array"), ["mean 'render_mode'"]),
    "tempo of a preset": (lambda: skirt(tempo=0.5), ["write preset={'name': 'chen2020', 'tempo': 0.5}"]),
    "motion of a preset": (
        lambda: skirt(motion="m.h5:dance", preset={"name": "chen2020", "tempo": 0.5}),
        ["write preset={'name': 'chen2020', 'tempo': 0.5, 'motion': 'm.h5:dance'}"],
    ),
    "sequence of a preset": (
        lambda: skirt(sequence=3, preset="chen2020"),
        ["write preset={'name': 'chen2020', 'sequence': 3}"],
    ),
    "mass of a preset": (
        lambda: one(mass=3.0, preset="lee2019"),
        ["write preset={'name': 'lee2019', 'mass': 3.0}"],
    ),
    "mass": (lambda: one(mass=0.3), ["write material={'areal_density': 0.3}"]),
    "friction": (lambda: one(friction=0.3), ["friction is of a scene's bodies"]),
    "tempo of no preset": (lambda: skirt(tempo=0.5, preset="lee2019"), ["unknown keyword 'tempo'"]),
    "nothing like it": (lambda: one(xyz=1), ["'xyz'", "'backend'", "'material'", "'render_mode'"]),
    "frame_dt": (lambda: one(frame_dt=0.01), ["belongs to the scene: leave it out"]),
    "substeps of a miniature": (
        lambda: one(substeps=5, backend="miniature"),
        ["write backend_kwargs={'solver_kwargs': {'substeps': 5}}"],
    ),
    "density": (lambda: one(density=0.3), ["write material={'areal_density': 0.3}"]),
    "num_envs of one": (lambda: one(num_envs=2), ["make_vec(id, num_envs=2)"]),
    "fabric of many": (lambda: many(fabric="silk"), ["mean 'material'", "'autoreset_mode'"]),
    "threads of many": (lambda: many(threads=2), ["backend_kwargs={'threads': 2}"]),
    "autoreset": (lambda: many(autoreset="SameStep"), ["mean 'autoreset_mode'"]),
    "autoreset_mode list": (lambda: many(autoreset_mode=["SameStep"]), ["autoreset_mode", "'SameStep'"]),
    "obs None": (lambda: one(obs=None), ["observation None", "'keypoints', 'mesh'"]),
    "backend class": (lambda: one(backend=dict), ["register_backend"]),
    "backend_kwargs": (lambda: one(backend_kwargs=4), ["must be a dict, got 4"]),
    "backend_kwargs list": (lambda: one(backend_kwargs=["solver"]), ["must be a dict, got 'solver'"]),
    "backends of one": (
        lambda: one(backend=["miniature", "reference"]),
        ["backend lists 2 for 1 environment", "make_vec(id, num_envs=2"],
    ),
    "backends of too many": (lambda: many(backend=["cnn"] * 2), ["lists 2 for 3 environments", "one entry for each"]),
    "kwargs of too many": (lambda: many(backend_kwargs=[{}] * 4), ["backend_kwargs lists 4 for 3", "num_envs=4"]),
    "backends misspelt": (lambda: many(backend=["refernce", "cnn", "cnn"]), ["mean 'reference'"]),
    "backends by name": (lambda: many(backend={"cnn": 3}), ["backend must be a name", "a list"]),
    "backend of a member": (lambda: many(backend=["cnn", "cnn", 3]), ["backend must be a name", "got 3"]),
    "factor of some": (
        lambda: many(backend=["reference", "miniature", "miniature"], factor=4),
        ["write a list as backend_kwargs, with {'factor': 4} for each member of backend 'miniature'"],
    ),
    "kwargs of another": (
        lambda: many(backend=["miniature", "reference", "reference"], backend_kwargs={"factor": 4}),
        ["members 1-2: unknown keyword", "'factor'", "a list, with a dict for each member"],
    ),
    "kwargs of a member": (
        lambda: many(backend=["miniature", "reference", "reference"], backend_kwargs=[{}, {}, 3]),
        ["member 2: ", "must be a dict, got 3"],
    ),
    "both words": (
        lambda: many(backend=["cnn"] * 3, physics=["reference"] * 3),
        ["physics= is another word for backend="],
    ),
    "solver misspelt": (lambda: physics(sovler="admm"), ["mean 'solver'", "'solver', 'substeps', 'threads'."]),
    "threads misspelt": (lambda: physics(thread=2), ["mean 'threads'"]),
    "another solver's": (
        lambda: physics(iterations=10),
        ["write backend_kwargs={'solver': 'admm', 'iterations': 10}"],
    ),
    "explicit's": (
        lambda: physics(solver="admm", iterations=4, refine=2),
        ["write backend_kwargs={'solver': 'explicit', 'refine': 2}"],
    ),
    "device of cnn": (lambda: physics(device="cpu"), ["write backend='cnn', backend_kwargs={'device': 'cpu'}"]),
    "engine of cnn": (lambda: physics(engine="torch"), ["write backend='cnn', backend_kwargs={'engine': 'torch'}"]),
    "factor of miniature": (
        lambda: physics(factor=2, threads=2),
        ["write backend='miniature', backend_kwargs={'threads': 2, 'factor': 2}"],
    ),
    "upscaler of miniature": (lambda: cnn(upscaler="bicubic"), ["backend='miniature', backend_kwargs={'upscaler'"]),
    "scaling of miniature": (lambda: cnn(scaling="similar"), ["backend='miniature', backend_kwargs={'scaling'"]),
    "solver of cnn": (lambda: cnn(solver="admm"), ["write backend='reference', backend_kwargs={'solver': 'admm'}"]),
    "substeps in a miniature": (
        lambda: miniature(substeps=5),
        ["write backend_kwargs={'solver_kwargs': {'substeps': 5}}"],
    ),
    "iterations in a miniature": (
        lambda: miniature(iterations=5, factor=4),
        ["write backend_kwargs={'factor': 4, 'solver': 'admm', 'solver_kwargs': {'iterations': 5}}"],
    ),
    "factor of its solver": (lambda: miniature(solver_kwargs={"factor": 4}), ["write backend_kwargs={'factor': 4}"]),
    "solver_kwargs of reference": (
        lambda: physics(solver_kwargs={"refine": 2}, threads=2),
        ["write backend_kwargs={'threads': 2, 'refine': 2}"],
    ),
    "resolution of physics": (
        lambda: physics(resolution=(9, 13)),
        ["it belongs to the environment: write resolution=(9, 13) beside backend_kwargs"],
    ),
    "frame_dt of physics": (lambda: physics(frame_dt=0.01), ["belongs to the scene: leave it out"]),
    "seed of physics": (lambda: physics(seed=1), ["env.reset(seed=1)"]),
    "physics of many": (
        lambda: many(backend_kwargs={"iterations": 4, "threads": 1}),
        ["write backend_kwargs={'threads': 1, 'solver': 'admm', 'iterations': 4}"],
    ),
    "material mass": (lambda: one(material={"mass": 0.3}), ["mean 'areal_density'"]),
    "material stiffness": (lambda: one(material={"stiffness": 9}), ["mean 'stretch_stiffness'"]),
    "randomize mass": (lambda: one(randomize={"mass": (0.1, 0.3)}), ["mean 'areal_density'"]),
    "randomize density": (lambda: one(randomize={"density": (0.1, 0.3)}), ["mean 'areal_density'"]),
    "randomize weight": (lambda: one(randomize={"weight": (0.1, 0.3)}), ["mean 'areal_density'"]),
    "randomize stiffness": (lambda: one(randomize={"stiffness": (100, 300)}), ["mean 'stretch_stiffness'"]),
    "material number": (lambda: one(material=3), ["fabric's name or a dict", '{"areal_density": 0.3}']),
    "material text": (lambda: one(material={"drag": "0.2"}), ["drag must be a number, got '0.2'"]),
    "preset option": (lambda: one(preset={"name": "lee2019", "mass": "3"}), ["finite number as mass, got '3'"]),
    "resolution one number": (lambda: one(resolution=33), ["(rows, cols) such as (33, 49)", "got 33"]),
    "resolution text": (lambda: one(resolution="33x49"), ["(33, 49)", "got '33x49'"]),
    "resolution floats": (lambda: one(resolution=(33.0, 49)), ["whole numbers"]),
    "resolution bool": (lambda: one(resolution=(True, 49)), ["whole numbers", "got (True, 49)"]),
    "resolution table": (lambda: one(resolution=np.ones((2, 2), int)), ["two whole numbers"]),
    "resolution small": (lambda: one(resolution=(1, 1)), ["at least 3 x 3"]),
    "resolution huge": (lambda: one(resolution=(5000, 5000)), ["smaller resolution"]),
    "randomize pairs": (lambda: one(randomize=[("drag", (0, 1))]), ["randomize must be a dict such as"]),
    "randomize text": (lambda: one(randomize="drag"), ["randomize must be a dict such as"]),
    "randomize None": (lambda: one(randomize={"drag": (None, 1)}), ["randomize['drag']", "(low, high)"]),
    "randomize texts": (lambda: one(randomize={"drag": ("0", "1")}), ["randomize['drag']", "two numbers"]),
    "randomize bools": (lambda: one(randomize={"drag": (False, True)}), ["randomize['drag']", "two numbers"]),
    "randomize reversed": (lambda: one(randomize={"drag": (2, 1)}), ["randomize['drag']", "low <= high"]),
    "randomize NaN": (lambda: one(randomize={"drag": (np.nan, 1)}), ["randomize['drag']", "low <= high"]),
    "randomize negative": (lambda: one(randomize={"drag": (-1, 1)}), ["randomize['drag']", "zero or positive"]),
    "num_envs float": (lambda: many(num_envs=2.0), ["num_envs must be a whole number of at least 1, got 2.0"]),
    "no frames": (lambda: many(max_episode_steps=0), ["max_episode_steps", "at least 1, got 0", "-1 for no limit"]),
    "minus three": (lambda: many(max_episode_steps=-3), ["max_episode_steps", "got -3", "-1 for no limit"]),
    "half a frame": (lambda: many(max_episode_steps=2.5), ["max_episode_steps", "got 2.5"]),
    "factor float": (lambda: miniature(factor=2.0), ["factor must be 2, 3 or 4, got 2.0"]),
    "guard number": (lambda: miniature(guard=1), ["guard must be True or False, got 1"]),
    "upscaler list": (lambda: miniature(upscaler=["bicubic"]), ["upscaler ['bicubic']", "'bilinear'"]),
    "factors list": (lambda: miniature(scaling="calibrated", factors=[1]), ["factors must be a dict"]),
    "factors name": (lambda: miniature(scaling="calibrated", factors={"dragg": 1}), ["mean 'drag'"]),
    "factors text": (lambda: miniature(scaling="calibrated", factors={"drag": "1"}), ["factors['drag']", "number"]),
    "solver_kwargs": (lambda: miniature(solver_kwargs=3), ["solver_kwargs must be a dict, got 3"]),
    "substeps text": (lambda: physics(substeps="99"), ["substeps must be a whole number", "got '99'"]),
    "substeps float": (lambda: physics(substeps=99.5), ["substeps must be a whole number", "got 99.5"]),
    "dtype": (lambda: physics(dtype=int), ["dtype", "'float32', 'float64'"]),
    "dtype None": (lambda: physics(dtype=None), ["dtype None"]),
    "device": (lambda: cnn(engine="torch", device="gpu"), ["device='gpu'", "write device='cpu'"]),
    "forces": (lambda: cnn(engine="torch", forces=3), ["forces must be a list of functions"]),
    "option of one": (lambda: one().reset(options={"reset_mask": [True]}), ["'reset_mask'", "leave options out"]),
    "seed as option": (lambda: one().reset(options={"seed": 3}), ["no reset options, got 'seed'"]),
    "options list": (lambda: one().reset(options=[1]), ["options of reset must be a dict"]),
    "option of many": (lambda: many().reset(options={"mask": [True]}), ["'mask'", "mean 'reset_mask'"]),
    "ragged mask": (lambda: many().reset(options={"reset_mask": [[1], 0, 1]}), ["bool array of shape (3,)"]),
    "seed negative": (lambda: one().reset(seed=-1), ["seed must be a whole number of at least 0, got -1"]),
    "seed text": (lambda: one().reset(seed="1"), ["seed must be a whole number of at least 0, got '1'"]),
    "seed bool": (lambda: one().reset(seed=True), ["got True"]),
    "seeds float": (lambda: many().reset(seed=1.5), ["a list of 3", "got 1.5"]),
    "seeds text": (lambda: many().reset(seed="123"), ["a list of 3", "got '123'"]),
    "seeds set": (lambda: many().reset(seed={1, 2, 3}), ["a list of 3"]),
    "seeds table": (lambda: many().reset(seed=np.ones((3, 1), int)), ["a list of 3"]),
    "seeds bool": (lambda: many().reset(seed=True), ["got True"]),
    "seeds negative": (lambda: many().reset(seed=[1, -2, 3]), ["got -2"]),
    "seeds too many": (lambda: many().reset(seed=(1, 2, 3, 4)), ["4 seeds for 3"]),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_answered_by_what_to_write(name: str) -> None:
    make, words = MISTAKES[name]
    with pytest.raises(ValueError, match=r"\w") as error:
        make()
    for word in words:
        assert word in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "make",
    [
        lambda: one(xyz=1),
        lambda: physics(colour=1),
        lambda: miniature(solver_kwargs={"xyz": 1}),
        lambda: one(material={"pressure": 1}),
        lambda: one(randomize={"pressure": (1, 2)}),
    ],
)
def test_nothing_is_offered_that_is_not_like_it(make: Callable[[], object]) -> None:
    with pytest.raises(ValueError, match="Choose one of") as error:
        make()
    assert "Did you mean" not in str(error.value)


@pytest.mark.parametrize("backend", ["reference", "cnn", "miniature"])
@pytest.mark.parametrize(
    "wrong",
    [
        {"iterations": 3}, {"substeps": 90}, {"factor": 4}, {"engine": "compiled"}, {"scheme": "euler"},
        {"solver": "admm"}, {"solver": "admm", "iterations": 3, "refine": 2}, {"solver_kwargs": {"substeps": 90}},
        {"dtype": "float64"}, {"solver": "admm", "guard": True}, {"solver": "implicit", "factor": 2},
    ],
    ids=str,
)  # fmt: skip
def test_what_is_offered_can_be_written(backend: str, wrong: dict[str, Any]) -> None:
    """After as many corrections as there are words, at most."""
    options = {"backend": backend, "backend_kwargs": wrong}
    for _ in wrong:
        try:
            one(**options)
        except ValueError as error:
            _, write, text = str(error).partition("; write ")
            assert write
            options |= eval(f"dict({text})")
    one(**options)


@pytest.mark.parametrize("word", ["iterations", "substeps", "solver_kwargs"])
def test_a_net_of_particles_is_offered_no_solver_of_sheets(word: str) -> None:
    with pytest.raises(ValueError, match=word) as error:
        gym.make("MiniCloth-Hanging-v0", preset="zhao2024", backend_kwargs={word: 4})
    assert "admm" not in str(error.value)


ACTIONS: dict[str, tuple[Any, str]] = {
    "too long": (np.zeros(3), "has shape (3,), expected (2,)"),
    "too deep": (np.zeros((1, 2)), "has shape (1, 2), expected (2,)"),
    "a number": (0.5, "has shape (), expected (2,)"),
    "None": (None, "must be numbers in [-1, 1] of shape (2,)"),
    "text": (["0", "1"], "must be numbers"),
    "ragged": ([[0, 1], [2]], "must be numbers"),
    "complex": (np.zeros(2, complex), "must be numbers"),
    "objects": (np.array([0, None]), "must be numbers"),
    "booleans": ([True, False], "must be numbers"),
    "a dict": ({"x": 1}, "must be numbers"),
    "not finite": ([0.0, np.nan], "NaN or infinity"),
}


@pytest.mark.parametrize("name", ACTIONS)
def test_what_is_no_action_moves_nothing(name: str) -> None:
    action, words = ACTIONS[name]
    env = one()
    env.reset(seed=0)
    before = env.unwrapped.get_state()
    with pytest.raises(ValueError, match="action") as error:
        env.step(action)
    assert words in str(error.value)
    after = env.unwrapped.get_state()
    assert all(np.array_equal(before[name], after[name]) for name in before)
    assert env.step([0, 1])[0].shape == env.observation_space.shape  # a list is an action


@pytest.mark.parametrize(
    ("shape", "members"), [((2,), 3), ((2, 2), 3), ((3, 3), 3), ((3,), 3), ((2,), 1)], ids=lambda shape: str(shape)
)
def test_vector_actions_tell_both_shapes(shape: tuple[int, ...], members: int) -> None:
    env = many(num_envs=members)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="action") as error:
        env.step(np.zeros(shape))
    assert f"has shape {shape}, expected ({members}, 2)" in str(error.value)
    env.step([[0, 0]] * members)


def played(env: Any, seed: Any) -> np.ndarray:
    env.reset(seed=seed)
    return env.step(np.full(env.action_space.shape, 0.5))[0]


@pytest.mark.parametrize(
    ("theirs", "ours"),
    [
        ({"resolution": np.array([9, 13])}, {"resolution": (9, 13)}),
        ({"resolution": [np.int32(9), np.int64(13)]}, {"resolution": (9, 13)}),
        ({"randomize": {"drag": np.array([0.25, 1.5])}}, {"randomize": {"drag": (0.25, 1.5)}}),
        ({"randomize": {"drag": [np.float32(0.25), np.array(1.5)]}}, {"randomize": {"drag": (0.25, 1.5)}}),
        ({"material": {"drag": np.array(0.25)}}, {"material": {"drag": 0.25}}),
        ({"preset": {"name": "lee2019", "mass": np.array(3)}}, {"preset": {"name": "lee2019", "mass": 3.0}}),
        ({"num_envs": np.int64(2)}, {"num_envs": 2}),
        ({"max_episode_steps": np.int64(9)}, {"max_episode_steps": 9}),
        ({"backend_kwargs": {"threads": np.int64(2)}}, {"backend_kwargs": {"threads": 2}}),
        ({"backend_kwargs": {"refine": np.uint8(2)}}, {"backend_kwargs": {"refine": 2}}),
        ({"backend_kwargs": {"substeps": np.int64(99)}}, {"backend_kwargs": {"substeps": 99}}),
        ({"backend_kwargs": {"dtype": np.float64}}, {"backend_kwargs": {"dtype": "float64"}}),
        ({"backend_kwargs": {"dtype": np.dtype("f8")}}, {"backend_kwargs": {"dtype": "float64"}}),
        (
            {"backend_kwargs": {"solver": "admm", "iterations": np.int16(3)}},
            {"backend_kwargs": {"solver": "admm", "iterations": 3}},
        ),
        (
            {"backend_kwargs": {"solver": "implicit", "tolerance": np.float32(0.5), "window": np.int64(4)}},
            {"backend_kwargs": {"solver": "implicit", "tolerance": 0.5, "window": 4}},
        ),
        (
            {"backend": "miniature", "backend_kwargs": {"factor": np.int64(2), "guard": np.True_}},
            {"backend": "miniature", "backend_kwargs": {"factor": 2, "guard": True}},
        ),
        (
            {"backend": "cnn", "backend_kwargs": {"dtype": np.float64, "threads": np.int8(1)}},
            {"backend": "cnn", "backend_kwargs": {"dtype": "float64", "threads": 1}},
        ),
    ],
    ids=lambda options: str(options),
)
def test_numpys_numbers_count_as_pythons(theirs: dict[str, Any], ours: dict[str, Any]) -> None:
    assert np.array_equal(played(many(**theirs), 3), played(many(**ours), 3))


def test_a_backend_is_given_pythons_numbers_and_arrays_as_they_are() -> None:
    given: dict[str, Any] = {}

    def factory(scene: Any, *, num_envs: int, **options: Any) -> Any:
        given.update(options)
        return make_backend("reference", scene, num_envs=num_envs)

    cloth_envs.register_backend("listening", factory)
    try:
        weights = np.ones(3)
        one(
            backend="listening", backend_kwargs={"count": np.int64(2), "more": {"share": np.float32(0.5)}, "w": weights}
        )
    finally:
        del cloth_envs.BACKENDS["listening"]
    assert json.dumps({name: given[name] for name in ("count", "more")}) == '{"count": 2, "more": {"share": 0.5}}'
    assert isinstance(given["w"], np.ndarray)


def test_a_backend_that_cannot_be_loaded_is_in_nobodys_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(cloth_envs.BACKENDS, "broken", "no_such_module:Physics")
    with pytest.raises(ValueError, match="Did you mean 'material'"):
        one(fabric="silk")


def test_particles_take_numpys_types() -> None:
    options: dict[str, Any] = {"preset": "zhao2024", "disable_env_checker": True}
    for backend in ("reference", "cnn"):
        env: Any = gym.make("MiniCloth-Hanging-v0", backend=backend, backend_kwargs={"dtype": np.float64}, **options)
        assert env.unwrapped.world.backend.dtype == np.float64
        env.reset(seed=0)
        env.step([0, 0, 0])


@pytest.mark.parametrize("seeds", [(4, 5, 6), np.array([4, 5, 6]), [np.int64(4), np.uint8(5), 6], np.int64(4)], ids=str)
def test_seeds_in_any_form(seeds: Any) -> None:
    assert np.array_equal(played(many(), seeds), played(many(), 4))
    assert np.array_equal(played(one(), np.int64(5)), played(many(), 4)[1])


def test_seeds_of_any_size_and_none() -> None:
    huge = 2**70
    assert np.array_equal(played(many(), huge)[2], played(one(), huge + 2))
    assert np.array_equal(played(many(), [None, huge, None])[1], played(one(), huge))


def test_minus_one_is_no_limit_as_in_make() -> None:
    env = many(max_episode_steps=-1, resolution=(5, 7))
    env.reset(seed=0)
    actions = np.zeros(env.action_space.shape)
    assert not any(env.step(actions)[3].any() for _ in range(EPISODE_FRAMES["Flag"] + 1))


@pytest.fixture
def nothing_told() -> None:
    """As in a process that has warned of nothing so far."""
    warn_once.cache_clear()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"material": {"areal_density": 200}}, "areal_density=200 .*kg/m\\^2: 200 g/m\\^2 is written 0.2"),
        ({"material": cloth_envs.Material(areal_density=200)}, "areal_density=200"),
        ({"randomize": {"areal_density": (100, 300)}}, "randomize\\['areal_density'\\]=100"),
        ({"material": {"bend_stiffness": 0.4}, "backend_kwargs": {"solver": "admm"}}, "bend_stiffness=0.4 .*9.8e-6"),
        ({"material": {"damping": 0.2}, "backend_kwargs": {"solver": "admm"}}, "damping=0.2 .*relaxation time"),
        ({"material": {"drag": 100}}, "drag=100 .*1/s"),
        ({"material": {"drag": 50}}, "drag=50 .*1/s"),
        ({"material": {"stretch_stiffness": 1e6}, "backend_kwargs": {"solver": "admm"}}, "=1e\\+06 .* N/m"),
        ({"material": {"shear_stiffness": 1e-3}}, "shear_stiffness=0.001 .*56"),
        ({"material": {"compression_damping": 9}}, "compression_damping=9 .*ratio"),
        ({"material": {"buckling_strain": 3}}, "3 % is written 0.03"),
    ],
    ids=str,
)
@pytest.mark.usefixtures("nothing_told")
def test_values_of_another_unit_warn_once_with_the_unit(options: dict[str, Any], words: str) -> None:
    with pytest.warns(UserWarning, match=words) as told:
        one(disable_env_checker=True, **options)
    assert [each.category for each in told].count(UserWarning) == 1  # beside Gymnasium's, of every v0


@pytest.mark.usefixtures("nothing_told")
def test_a_value_is_warned_of_once_in_a_process() -> None:
    odd: dict[str, Any] = {"material": {"drag": 60}, "disable_env_checker": True}
    with pytest.warns(UserWarning, match="drag=60") as told:
        gym.make_vec(ID, num_envs=3, vectorization_mode="sync", **SMALL, **odd)
    assert [each.category for each in told].count(UserWarning) == 1  # beside Gymnasium's, of every v0
    one(**odd)  # warnings are errors here
    with pytest.warns(UserWarning, match="drag=61"):
        one(**odd | {"material": {"drag": 61}})


@pytest.mark.usefixtures("nothing_told")
def test_a_term_that_is_switched_off_warns_of_nothing() -> None:
    one(material={"shear_stiffness": 0, "bend_stiffness": 0, "damping": 0, "drag": 0})
    one(randomize={"bend_stiffness": (0, 1e-5)})


@pytest.mark.usefixtures("nothing_told")
def test_what_is_shipped_warns_of_nothing() -> None:
    """Warnings are errors here: fabrics, presets, and the coarse materials of the miniature."""
    for fabric, material in cloth_envs.FABRICS.items():
        one(material=fabric)
        one(material=material)
    for scene in ("Curtain", "Flag", "Collision"):
        gym.make(cloth_envs.env_id(scene), preset="lee2019")
        for factor in (2, 4):
            gym.make(cloth_envs.env_id(scene), backend="miniature", backend_kwargs={"factor": factor})
    gym.make("MiniCloth-Pressure-v0", preset="zhao2024")
