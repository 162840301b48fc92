"""The miniature backend: what the scaling claims, and that nothing else of the environment changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.seeding import np_random

import cloth_envs
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.laws.diagnostics import strains
from cloth_envs.policies import open_loop
from cloth_envs.registry import SCENES, load_task
from cloth_envs.resample import KINDS
from cloth_envs.scene import Air, Collider, Scene
from cloth_envs.state import Controls, LazyState, State
from cloth_envs.world import World
from surrogates.miniature.backend import MiniatureBackend
from surrogates.miniature.choice import Choice, choose
from surrogates.miniature.closure import miniature_material
from surrogates.miniature.coarse import coarse_grid
from surrogates.miniature.fine import GUARD
from surrogates.miniature.handles import Handles
from surrogates.upscale.protocol import LEARNED, RememberingUpscaler
from training.bench.benchmark import MEASURED

SMALL = {"Curtain": (49, 33), "Flag": (17, 25), "Collision": (25, 17)}


def make(scene: str, **kwargs: Any) -> Any:
    shape = SMALL.get(scene, (17, 17))
    return gym.make(cloth_envs.env_id(scene), resolution=shape, backend="miniature", backend_kwargs=kwargs).unwrapped


def waving(scene: Scene, seed: int = 0) -> State:
    """A waved sheet with smooth velocities."""
    rng = np.random.default_rng(seed)
    v, u = np.meshgrid(*(np.linspace(0, 1, n) for n in scene.grid.shape), indexing="ij")
    x = np.stack([u * scene.grid.width, 0.05 * np.sin(5 * u + 3 * v), -v * scene.grid.height])[None]
    state = State.still(x, np.tile([0.5, -0.14, -0.4], (1, len(scene.colliders), 2, 1)))
    state.velocities[:] = 0.3 * np.sin(rng.uniform(0, 6, (1, 3, 1, 1)) + 4 * u + 2 * v)
    return state


@pytest.mark.parametrize("scaling", ["seed", "similar"])
def test_the_enlarged_coarse_sheet_is_the_miniature(scaling: str) -> None:
    """Run the copy with axes over s, the fine particle mass, rest length and step, and forces over s as it is built."""
    s, fine = 2, Grid(21, 17, 1.0, 0.8)
    material, air = Material(0.2, 300.0, 80.0, 3e-5, 1e-4, 0.5), Air(max_wind=12.0)
    coarse = coarse_grid(fine, s)
    enlarged = miniature_material(material, s, scaling, {})
    bodies = (Collider("sphere", 0.1, 0.4),)
    big = Scene("big", coarse, enlarged, 0.01, (0, 8), air=air, colliders=bodies)
    # With the spacing over s the same areal density gives the fine particles' mass. The spring constant of a cell
    # does not depend on its size; bending's, B / length^2, keeps its fine value with the fine spacing. The air's
    # force ~ density * area * speed^2 is to be f / s = s^-3 of the enlarged one: area and speed give s^-4.
    k = {"seed": 1.0, "similar": s**-2.0}[scaling]
    b = {"seed": 1.0, "similar": s**-4.0}[scaling]
    small = Scene(
        "small",
        replace(coarse, height=coarse.height / s, width=coarse.width / s),
        material.with_changes(
            stretch_stiffness=material.stretch_stiffness * k,
            shear_stiffness=material.shear_stiffness * k,
            bend_stiffness=material.bend_stiffness * b,
        ),
        0.01,
        (0, 8),
        air=replace(air, density=air.density * s, max_wind=air.max_wind / s),
        colliders=(replace(bodies[0], radius=bodies[0].radius / s),),
        thickness=big.thickness / s,
        gravity=big.gravity / s,
    )
    states = []
    for scene, size in ((big, 1.0), (small, 1.0 / s)):
        state = waving(big)
        for array in (state.positions, state.velocities, state.colliders):
            array *= size
        solver = ExplicitSolver(scene, dtype="float64", substeps=100)
        solver.reset(state)
        controls = Controls.hold(state, scene.handles)
        controls.wind[:] = np.array([3.0, 4.0, 0.0]) * size
        for _ in range(5):
            solver.advance(controls)
        states.append(solver.state.positions / size)
    # The same numbers in other units: 500 substeps of rounding, which the motion does not amplify much.
    np.testing.assert_allclose(states[0], states[1], atol=500 * 16 * np.finfo(float).eps)
    assert np.abs(states[0] - waving(big).positions).max() > 1e-3


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("old", "new"), [(13, 25), (13, 37), (13, 49), (12, 33)])
def test_interpolation_is_exact_for_its_degree_and_at_shared_vertices(kind: str, old: int, new: int) -> None:
    weights = KINDS[kind](old, new)
    degree = {"linear": 1, "quadratic": 2, "cubic": 2}[kind]
    at_old, at_new = np.linspace(0, 1, old), np.linspace(0, 1, new)
    for power in range(degree + 1):
        np.testing.assert_allclose(weights @ at_old**power, at_new**power, atol=1e-14)
    assert not np.allclose(weights @ at_old ** (degree + 1), at_new ** (degree + 1), atol=1e-6)
    shared = np.isclose(at_new[:, None], at_old).any(1)
    assert (weights[shared] == (np.abs(at_new[shared, None] - at_old) < 1e-9)).all()


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("factor", [2, 3, 4])
def test_handles_stay_where_they_are_driven_and_the_cloth_stays_whole(scene: str, factor: int) -> None:
    env = make(scene, factor=factor)
    env.reset(seed=1)
    env.action_space.seed(1)
    for _ in range(10):
        _, _, failed, _, info = env.step(env.action_space.sample())
        assert not failed, info
    world = env.world
    controls = env.task.controls(world.episode)
    firm = env.scene.holding.firm
    held = world.backend.advance(controls).positions.reshape(3, -1)[:, list(env.scene.pins)]
    np.testing.assert_array_equal(held.T, controls.handle_positions[0, firm].astype(np.float32))


def test_every_handle_is_followed_and_no_coarse_vertex_is_driven_far_from_one() -> None:
    fine = Grid(25, 25, 1.0, 1.0)
    for factor in (2, 3, 4):
        coarse = coarse_grid(fine, factor)
        handles = (0, 1, 2, 25, 26, 27, 13 * 25 + 12, 20 * 25 + 7)
        found = Handles.of(fine, coarse, handles)
        followed = np.array(handles)[found.follows]
        fine_at = np.stack(np.divmod(followed, 25)) / 24
        coarse_at = np.stack(np.divmod(np.array(found.vertices), coarse.cols)) / np.reshape(coarse.cells, (2, 1))
        assert np.abs(fine_at - coarse_at).max() <= 0.5 / min(coarse.cells) + 1e-12
        assert {handles[6], handles[7], 0} <= set(followed.tolist())


def test_the_fine_cloth_is_computed_when_it_is_read() -> None:
    env = make("Hanging")
    env.reset(seed=0)
    backend, calls = env.world.backend, []
    for name in ("positions", "velocities"):
        method = getattr(backend.upscaling, name)
        setattr(backend.upscaling, name, lambda history, n=name, m=method: calls.append(n) or m(history))
    state = backend.advance(Controls.hold(env.state, env.scene.handles))
    assert isinstance(state, LazyState)
    assert state.batch == 1
    assert calls == []
    assert state.positions is state.positions
    assert calls == ["positions", "velocities"]
    assert state.copy().positions.shape == (1, 3, 17, 17)
    assert calls == ["positions", "velocities"]


def test_a_state_that_is_read_late_is_the_one_of_its_frame() -> None:
    """After more frames, and after another member began anew; the network reads three frames of history."""
    world = World("Flag", num_envs=2, preset="lee2019", backend="miniature", backend_kwargs={"upscaler": "fc"})
    world.reset({i: np_random(i)[0] for i in range(2)})
    backend, controls = world.backend, Controls.hold(world.state, world.scene.handles)
    start = world.state.copy()
    at_once = [backend.advance(controls).copy() for _ in range(4)]
    backend.reset(start)
    late = [backend.advance(controls) for _ in range(3)]
    backend.reset(start.select([1]), which=[1])
    backend.advance(controls)
    for one, other in zip(at_once, late, strict=False):
        for name, field in one.arrays().items():
            if name != "time":
                np.testing.assert_array_equal(getattr(other, name), field)


class Fading(RememberingUpscaler):
    """Half of what is interpolated now and half of what it said last: the smallest method with a memory of its own."""

    frames = 2

    def reset(self, which: Sequence[int], history: Sequence[State]) -> None:
        said = self.bicubic(history[-1].positions)
        if not hasattr(self, "said"):
            self.said = said
        self.said[list(which)] = said[list(which)]

    @property
    def memory(self) -> dict[str, np.ndarray]:
        return {"said": self.said}

    def recall(self, memory: Mapping[str, np.ndarray]) -> None:
        self.said = memory["said"].copy()

    def positions(self, history: Sequence[State]) -> np.ndarray:
        moving = (history[-1].positions - history[-2].positions) / np.float32(self.fine.frame_dt)
        now = self.bicubic(history[-1].positions + 0.1 * np.float32(self.fine.frame_dt) * moving)
        self.said = (now + self.said) / 2
        return self.said.copy()


@pytest.mark.parametrize("registered", [True, False])
def test_a_method_with_a_memory_is_one_more_upscaler(registered: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read or not, saved and continued, reset member by member: it says the same."""
    name = f"{__name__}:Fading"
    if registered:
        monkeypatch.setitem(LEARNED, "fading", name)
    options = {"upscaler": "fading" if registered else name, "mend": False}
    worlds = [World("Hanging", num_envs=2, backend="miniature", backend_kwargs=options) for _ in range(3)]
    idle = np.zeros((2, len(worlds[0].task.actions)))
    for world in worlds:
        world.reset({i: np_random(i)[0] for i in range(2)})
        for _ in range(3):
            world.step(idle)
    read, unread, continued = worlds
    said = read.backend.upscaling.said  # type: ignore[attr-defined]
    np.testing.assert_array_equal(said[..., -1, :], read.state.positions[..., -1, :])  # far from handles
    controls = read.task.controls(read.episode)
    for _ in range(2):
        last = read.backend.advance(controls).positions
    unread.backend.advance(controls)
    np.testing.assert_array_equal(unread.backend.advance(controls).positions, last)

    saved = continued.get_state()
    fresh = World("Hanging", num_envs=2, backend="miniature", backend_kwargs=options)
    fresh.reset({i: np_random(7)[0] for i in range(2)})
    fresh.set_state(saved)
    for world in (continued, fresh):
        world.step(idle)
    np.testing.assert_array_equal(fresh.state.positions, continued.state.positions)
    start = continued.state.copy()
    continued.reset({0: np_random(5)[0]})
    np.testing.assert_array_equal(continued.state.positions[1], start.positions[1])


def test_each_scaling_is_nearer_to_the_reference_than_the_one_before() -> None:
    """A sheet that fell on the ball for 0.5 s, then 5 frames of each from there."""
    world = World("BallDrop")
    world.reset({0: np_random(11)[0]})
    still = np.zeros((1, len(world.task.actions)))
    for _ in range(25):
        world.step(still)
    assert world.episode is not None
    start, controls, ends = world.state.copy(), [], []
    for _ in range(5):
        controls.append(world.task.controls(world.episode))
        world.episode.state = world.backend.advance(controls[-1])
        ends.append(world.state.positions.copy())
    errors = []
    for scaling in ("seed", "similar", "calibrated", "closure"):
        backend = MiniatureBackend(world.scene, factor=4, scaling=scaling)
        backend.reset(start)
        gaps = [backend.advance(c).positions - end for c, end in zip(controls, ends, strict=True)]
        errors.append(np.linalg.norm(gaps, axis=2).mean())
    assert errors == sorted(errors, reverse=True)


def test_by_default_it_takes_what_is_shipped_for_the_scene() -> None:
    scene = World("Curtain").scene
    chosen = MiniatureBackend(scene)
    assert (chosen.scaling, chosen.upscaler) == ("closure", "local")
    elsewhere: dict[str, Any]
    for case, elsewhere in (
        (replace(scene, name="Rug"), {}),
        (scene, {"solver": "admm"}),
        (scene, {"factor": 4, "upscaler": "bilinear"}),
    ):
        plain = MiniatureBackend(case, **elsewhere)
        assert (plain.scaling, plain.upscaler) == ("similar", elsewhere.get("upscaler", "bicubic"))


def test_the_guard_interpolates_what_a_network_tears() -> None:
    scene = World("Hanging").scene
    backend, plain = (
        MiniatureBackend(scene, num_envs=2, factor=4, scaling="closure", **o)
        for o in ({"upscaler": "local", "guard": True}, {"upscaler": "bicubic", "mend": True})
    )
    world = World("Hanging", num_envs=2)
    world.reset({i: np_random(i)[0] for i in range(2)})
    state = world.state
    controls = Controls.hold(state, scene.handles)
    for one in (backend, plain):
        one.reset(state)
    calm = backend.advance(controls).positions
    assert not backend.guarded.any()
    assert not np.array_equal(calm, plain.advance(controls).positions)
    sound = backend.upscaling.positions

    def torn(history: Any) -> np.ndarray:
        fine = sound(history)
        fine[1, :, 30, 30] += 5 * scene.grid.row_spacing  # more than mending makes up for
        return fine

    backend.upscaling.positions = torn  # type: ignore[method-assign]
    saved, wanted = backend.advance(controls).positions, plain.advance(controls).positions
    assert backend.guarded.tolist() == [False, True]
    assert np.array_equal(saved[1], wanted[1])


def test_a_guarded_cloth_is_mended_more_beside_handles_between_coarse_vertices() -> None:
    """Bicubic interpolation of a sound coarse cloth, mended, would be strained by up to 0.7 there."""
    world = World("Curtain", self_contact=False, backend="miniature", backend_kwargs={"factor": 3})
    world.reset({0: np_random(3)[0]})
    grid, guarded = world.scene.grid, 0
    moves = open_loop("bang-bang", 200, world.action_space.shape[0], world.scene.frame_dt, 3)[:45].astype(np.float32)
    for action in moves:
        world.step(action[None])
        assert strains(grid, world.state.positions).max() < GUARD
        assert world.state.health is not None
        assert world.state.health[0][1] < 0.2  # of the coarse cloth
        guarded += int(world.guarded[0])
    assert guarded > 5


def test_bad_arguments_name_the_remedy() -> None:
    for kwargs, words in (
        ({"factor": 5}, "2, 3 or 4"),
        ({"scaling": "simlar"}, "'similar'"),
        ({"upscaler": "cubic"}, "'bicubic'"),
        ({"solver": "explict"}, "'explicit'"),
        ({"solver_kwargs": {"thread": 1}}, "'threads'"),
        ({"faktor": 2}, "'factor'"),
        ({"guard": "yes"}, "True or False"),
    ):
        with pytest.raises(ValueError, match=words):
            make("Flag", **kwargs)
    nameless = replace(make("Flag").scene, name="Nameless")
    for scaling in ("calibrated", "closure"):
        with pytest.raises(ValueError, match=rf"training\.calibrate --scaling {scaling}"):
            MiniatureBackend(nameless, scaling=scaling)


def test_handles_are_not_placed_in_a_copy() -> None:
    """A field that is not contiguous would be copied, and the copy changed."""
    handles = Handles.of(Grid(5, 5, 1.0, 1.0), Grid(3, 3, 1.0, 1.0), (0,))
    field = np.zeros((1, 5, 5, 3), np.float32).transpose(0, 3, 1, 2)
    with pytest.raises(TypeError, match="incompatible"):
        handles.place(field, np.ones((1, 1, 3)), np.array([0], np.int32))


THIN = [(3, 60), (60, 3), (4, 40), (5, 30), (30, 7)]
LIVES = [
    *((scene, shape, 2, 0, 1.0) for scene in ("Flag", "Curtain", "Hanging") for shape in THIN),
    ("Curtain", (63, 6), 2, 95, 1.0),
    ("Curtain", (40, 6), 2, 0, 1.0),
    ("Curtain", (3, 51), 2, 0, 1.0),
    ("Curtain", (5, 41), 2, 0, 1.0),
    ("Curtain", (6, 65), 2, 0, 1.0),
    ("Curtain", (3, 60), 3, 0, 1.0),
    ("Curtain", (3, 60), 4, 0, 8.0),
    ("BallDrop", (6, 6), 2, 101, 1.0),
    ("BallDrop", (9, 9), 4, 0, 1.0),
    ("Pressure", (4, 68), 2, 0, 8.0),
    ("Flag", (4, 55), 2, 138, 1.0),
    ("Collision", (6, 44), 2, 0, 8.0),
    ("Collision", (11, 8), 4, 0, 8.0),
]


@pytest.mark.parametrize(("scene", "resolution", "factor", "seed", "strength"), LIVES)
def test_the_default_lives_through_what_the_reference_does_on_small_and_thin_grids(
    scene: str, resolution: tuple[int, int], factor: int, seed: int, strength: float
) -> None:
    """Under random actions, of ``strength`` 8 nearly bang-bang ones."""
    for options in ({}, {"backend": "miniature", "backend_kwargs": {"factor": factor}}):
        world = World(scene, num_envs=4, resolution=resolution, **options)
        world.reset({i: np_random(seed + i)[0] for i in range(4)})
        rng = np.random.default_rng(seed)
        for _ in range(45):
            actions = np.clip(strength * rng.uniform(-1, 1, (4, len(world.task.actions))), -1, 1)
            assert world.step(actions)[1] == [None] * 4


@pytest.mark.parametrize("name", MEASURED)
@pytest.mark.parametrize("factor", [2, 3, 4])
def test_from_half_the_scenes_own_grid_the_default_is_what_was_trained(name: str, factor: int) -> None:
    rows, cols = load_task(name).resolution
    for shape in (
        (rows, cols),
        (rows // 2 + 1, cols // 2 + 1),
        *([(2 * rows - 1, 2 * cols - 1)] if factor == 4 else []),
    ):
        task = load_task(name)
        scene = task.make_scene(resolution=shape, material=task.material)
        assert choose(scene, factor) == Choice("closure", "local")


@pytest.mark.parametrize("name", sorted({*SCENES} - {*MEASURED}))
@pytest.mark.parametrize("factor", [2, 4])
def test_a_scene_without_a_fit_is_stepped_as_outside_a_card(name: str, factor: int) -> None:
    task = load_task(name)
    rows, cols = task.resolution
    why = f"no closure of {name} at factor {factor}"
    for shape, plain in (((rows, cols), ("similar", "bicubic", 2)), ((rows, 5), ("similar", "bilinear", 6))):
        scene = task.make_scene(resolution=shape, material=task.material)
        assert choose(scene, factor) == Choice(*plain, why)
    env = make(name, factor=factor)
    assert why in env.reset(seed=0)[1]["surrogate"]
    with pytest.raises(ValueError, match=why):
        make(name, factor=factor, strict=True)


def test_a_cloth_of_few_cells_is_the_reference() -> None:
    worlds = [World("BallDrop", resolution=(7, 5), backend=backend) for backend in ("reference", "miniature")]
    for world in worlds:
        world.reset({0: np_random(0)[0]})
        for _ in range(20):
            world.step(np.ones((1, 2)))
    reference, miniature = worlds
    assert isinstance(miniature.backend, MiniatureBackend)
    assert miniature.backend.coarse.scene.grid == reference.scene.grid
    np.testing.assert_array_equal(miniature.state.positions, reference.state.positions)


def test_a_handle_midway_between_coarse_vertices_drives_both() -> None:
    """Or the fine one, interpolated from a driven and a free vertex, would part from where it is driven."""
    fine = Grid(9, 33, 1.0, 1.0)
    assert set(Handles.of(fine, coarse_grid(fine, 2), (0, 11, 21, 32)).vertices) == {0, 5, 6, 10, 11, 16}
