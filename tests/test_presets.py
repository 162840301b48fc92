"""The presets: with zero actions they are the papers' scenes; they keep Gymnasium's rules and say what does not go."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import cloth_envs
from cloth_envs.commands import cli
from cloth_envs.figure.entry import heading
from cloth_envs.material import Material
from cloth_envs.physics.admm.solver import AdmmSolver
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.laws.stencil import edges
from cloth_envs.presets import chen2020, lee2019, load_preset, presets_of, zhao2024
from cloth_envs.recording import RolloutWriter
from cloth_envs.recording.reader import Rollout
from cloth_envs.registry import PRESETS
from cloth_envs.rendering import framing
from cloth_envs.scene import Air
from cloth_envs.scenes import skirt
from cloth_envs.scenes.starts import rotation
from cloth_envs.world import World
from surrogates.miniature.coarse import coarse_grid

CASES = [(scene, preset) for preset, scenes in PRESETS.items() for scene in scenes]
cases = pytest.mark.parametrize(("scene", "preset"), CASES)
# The papers' grids and frames.
GRIDS = {"Curtain": (73, 49), "Flag": (33, 49), "Collision": (61, 41)}
FRAMES = {"Curtain": 0.04, "Flag": 0.04, "Collision": 0.02}
COARSE: dict[str, Any] = {"chen2020": {"resolution": (28, 27)}}  # the paper's coarse cloth: a hundredth of the work


def make(scene: str, preset: object, **options: object) -> gym.Env:
    return gym.make(cloth_envs.env_id(scene), preset=preset, **options)


def rest(scene: str, preset: object, frames: int, **options: object) -> World:
    """A world after some frames of zero actions."""
    world = World(scene, preset=preset, **options)  # type: ignore[arg-type]
    world.reset({0: np.random.default_rng(0)})
    for _ in range(frames):
        _, reasons = world.step(np.zeros((1, len(world.task.actions))))
        assert reasons == [None]
    return world


@cases
def test_gymnasium_checker_is_clean(scene: str, preset: str) -> None:
    with make(scene, preset, **COARSE.get(preset, {})) as env:
        check_env(env.unwrapped, skip_render_check=True)


@cases
def test_spaces_are_those_of_the_scene(scene: str, preset: str) -> None:
    with make(scene, preset) as env, gym.make(cloth_envs.env_id(scene)) as plain:
        assert env.action_space == plain.action_space
        assert env.observation_space == plain.observation_space
        assert env.unwrapped.scene.frame_dt == plain.unwrapped.scene.frame_dt
        assert env.spec.max_episode_steps == plain.spec.max_episode_steps
        assert "## Description" in env.unwrapped.task.__doc__


@cases
def test_spec_round_trips_through_json(scene: str, preset: str) -> None:
    given = {"name": preset, "mass": 3.0, "spring": 70} if preset == "lee2019" else preset
    with make(scene, given, obs="mesh", **COARSE.get(preset, {})) as env:
        text = env.spec.to_json()
        want = env.reset(seed=0)[0], env.step(env.action_space.high)[0]
    with gym.make(gym.envs.registration.EnvSpec.from_json(text)) as again:
        got = again.reset(seed=0)[0], again.step(again.action_space.high)[0]
    for a, b in zip(want, got, strict=True):
        assert all(np.array_equal(a[part], b[part]) for part in a)


@cases
def test_state_continues_and_vector_members_are_bit_equal(scene: str, preset: str) -> None:
    options = {"preset": preset, **COARSE.get(preset, {})}
    many = gym.make_vec(cloth_envs.env_id(scene), num_envs=2, **options)
    first, second = make(scene, **options).unwrapped, make(scene, **options).unwrapped
    batch, _ = many.reset(seed=3)
    assert np.array_equal(batch[0], first.reset(seed=3)[0])
    second.reset(seed=9)
    actions = np.random.default_rng(0).uniform(-1, 1, (4, *many.action_space.shape)).astype(np.float32)
    for frame, action in enumerate(actions):
        if frame == 2:
            second.set_state(first.get_state())
        batch, rewards, *_ = many.step(action)
        observed, reward, *_ = first.step(action[0])
        assert np.array_equal(batch[0], observed)
        assert rewards[0] == reward
        if frame >= 2:
            assert np.array_equal(second.step(action[0])[0], observed)
    assert 0 <= reward <= 1


@pytest.mark.parametrize(("scene", "preset"), [case for case in CASES if case != ("Skirt", "chen2020")])
def test_zero_actions_hold_what_the_paper_holds(scene: str, preset: str) -> None:
    """Handles and bodies, but for balls on paths, stay bit-equal; every seed moves alike."""
    world = World(scene, preset=preset, num_envs=2, **COARSE.get(preset, {}))
    world.reset({i: np.random.default_rng(i) for i in range(2)})
    start = world.state.copy()
    for _ in range(3):
        world.step(np.zeros((2, len(world.task.actions))))
    end, handles = world.state, list(world.scene.pins)
    assert np.array_equal(end.positions[0], end.positions[1])
    held = [state.positions.reshape(2, 3, -1)[..., handles] for state in (start, end)]
    assert np.array_equal(*held)
    assert not end.velocities.reshape(2, 3, -1)[..., handles].any()
    assert not np.array_equal(start.positions, end.positions)
    assert (start.velocities == 0).all()
    if scene not in ("Collision", "Hitting"):
        assert np.array_equal(start.colliders, end.colliders)
    pressure = {"Pressure": 187_500.0 * (preset == "zhao2024"), "Hanging": 6_250.0}.get(scene, 0.0)
    assert (end.pressure == pressure).all()
    assert (end.wind == [12.0 * (scene == "Flag"), 0, 0]).all()


@pytest.mark.parametrize("scene", PRESETS["lee2019"])
def test_lee2019_has_the_papers_grid_mass_and_springs(scene: str) -> None:
    world = World(scene, preset={"name": "lee2019", "mass": 4.5, "spring": 70})
    grid = world.scene.grid
    assert grid.shape == GRIDS[scene]
    assert grid.row_spacing == pytest.approx(grid.col_spacing)
    assert world.scene.frame_dt == FRAMES[scene]
    assert world.scene.mass.sum() == pytest.approx(4.5)
    material = world.scene.material
    constants = {c for e in edges(grid) for c in np.round(getattr(material, e.modulus) * e.weight, 9).tolist()}
    assert constants == {70.0, 35.0}  # half on the border
    for factor in (2, 4):
        assert grid.cells[0] % factor == grid.cells[1] % factor == 0


def test_lee2019_flag_bends_as_springs_between_a_vertex_and_the_middle_of_two_others() -> None:
    """On a cylinder of curvature c: k/2 |x_i - (x_i-1 + x_i+1) / 2|^2 a vertex and direction is B c^2 / 2 an area.

    The spring's stretch is a^2 c / 2 less (a c)^2 / 12 of it, its energy less twice that: at a c = 0.01, 1.7e-5.
    """
    k, curvature = 70.0, 0.32
    scene = World("Flag", preset={"name": "lee2019", "spring": k}).scene
    a = scene.grid.col_spacing
    angle = curvature * a * np.arange(3)
    x = np.stack([np.sin(angle), np.cos(angle)]) / curvature
    spring = k / 2 * ((x[:, 1] - (x[:, 0] + x[:, 2]) / 2) ** 2).sum() / a**2
    sheet = (scene.material.bend_stiffness - Material().bend_stiffness) * curvature**2 / 2
    assert sheet == pytest.approx(spring, rel=3e-5)
    assert scene.air == Air(lift=0.0, tangential=0.2, max_wind=12.0)
    soft = World("Flag", preset={"name": "lee2019", "bending": 0, "tangential": 0.1}).scene
    assert soft.material.bend_stiffness == Material().bend_stiffness
    assert soft.air == Air(lift=0.0, tangential=0.1, max_wind=12.0)


def test_lee2019_ball_keeps_to_its_path_and_flag_wind_turns_round() -> None:
    world = rest("Collision", "lee2019", 50)  # half a period
    ball = world.state.colliders[0, 0, 0]
    # float32 positions of up to a metre, each step from the last one's rounding.
    assert np.allclose(ball, [0.0, lee2019.BALL_ENDS[1], lee2019.BALL_Z], atol=50 * np.finfo(np.float32).eps)
    world = rest("Flag", {"name": "lee2019", "wind": -8.0}, 25)
    assert world.state.wind[0].tolist() == [-8.0, 0.0, 0.0]
    assert world.task.middle(world.episode)[0, 0] < 0  # the fly is downwind of the pole


@cases
def test_bang_bang_actions_break_nothing(scene: str, preset: str) -> None:
    world, rng = World(scene, preset=preset, **COARSE.get(preset, {})), np.random.default_rng(3)
    world.reset({0: rng})
    for frame in range(40):
        if frame % 4 == 0:
            action = rng.choice([-1.0, 1.0], (1, len(world.task.actions)))
        reward, reasons = world.step(action)
        assert reasons == [None], f"frame {frame}"
        assert 0 <= reward[0] <= 1
        assert np.isfinite(world.observe()).all()


@pytest.mark.parametrize("option", [{}, {"mass": 4.5}, {"spring": 40.0}])
@pytest.mark.parametrize("scene", PRESETS["lee2019"])
def test_lee2019_variants_live_through_an_episode(scene: str, option: dict[str, float]) -> None:
    rest(scene, {"name": "lee2019", **option}, cloth_envs.registry.EPISODE_FRAMES[scene])


@pytest.mark.parametrize(
    ("scene", "preset", "want"),
    [
        ("Pressure", "zhao2024", zhao2024.BLOWN),
        ("Pressure", "zhao2024-fall", zhao2024.FALLEN),
        ("Hanging", "zhao2024", zhao2024.HANG_HEIGHT - zhao2024.HANG),
    ],
)
def test_goals_lie_where_the_paper_scene_comes_to_rest(scene: str, preset: str, want: float) -> None:
    world = rest(scene, preset, 150)
    apex = world.state.positions[0, 2, 64, 64]
    got = apex if scene == "Pressure" else world.task.middle(world.episode)[0, 2]
    assert got == pytest.approx(want, abs=0.01)  # it still swings; the rewards' margins are 0.05 and 0.5 m


@pytest.mark.parametrize(("scene", "count", "trained"), [("Draping", 13, 10), ("Hitting", 35, 31)])
def test_chen2020_has_the_papers_sequences(scene: str, count: int, trained: int) -> None:
    """All differ, in what is held, how large the sphere is and where; the sphere's last radius is of testing alone."""
    task, found = load_preset(scene, "chen2020"), []
    assert (task.sequences, task.trained) == (count, trained)  # type: ignore[attr-defined]
    for sequence in range(count):
        given = {"name": "chen2020", "sequence": sequence}
        world, again = (World(scene, preset=given, resolution=(28, 27)) for _ in range(2))
        world.reset({0: np.random.default_rng(0)}), again.reset({0: np.random.default_rng(1)})
        assert (world.state.positions == again.state.positions).all()
        assert (world.state.colliders == again.state.colliders).all()
        radius = world.scene.colliders[0].radius if world.scene.colliders else 0.0
        found.append((world.scene.pins, radius, world.state.positions.tobytes(), world.state.colliders.tobytes()))
    held, radii, starts, bodies = (set(column) for column in zip(*found, strict=True))
    if scene == "Draping":
        assert (len(held), len(starts)) == (count, count)
        assert all(vertex < 27 for (vertex,) in held)
    else:
        assert len(bodies) == count
        assert {row[1] for row in found[trained:]} - {row[1] for row in found[:trained]} == {0.25}
        assert radii == {0.1, 0.15, 0.2, 0.25, 0.3}


@pytest.mark.parametrize("scene", ["Draping", "Hitting"])
def test_chen2020_is_the_papers_grid_and_has_its_coarse_one(scene: str) -> None:
    world = World(scene, preset="chen2020")
    assert world.scene.grid.shape == (109, 105)
    assert coarse_grid(world.scene.grid, 4).shape == (28, 27)
    coarse = World(scene, preset="chen2020", resolution=(28, 27))
    fine_rows, fine_cols = np.divmod(world.scene.pins, 105)
    rows, cols = np.divmod(coarse.scene.pins, 27)
    assert fine_rows.tolist() == (4 * rows).tolist()
    if scene == "Draping":  # a clip of Hitting may lie between coarse vertices
        assert fine_cols.tolist() == (4 * cols).tolist()


def test_chen2020_has_the_papers_skirts() -> None:
    """Their grids, a dance that is 8 times as slow, and hips that go with it alone where nothing is done."""
    world = World("Skirt", preset="chen2020")
    assert world.scene.grid.shape == (97, 208)
    assert coarse_grid(world.scene.grid, 4).shape == (25, 52)
    slow = World("Skirt", preset="chen2020", resolution=(25, 52))
    slow.reset({0: np.random.default_rng(0)})
    task: Any = slow.task
    plain: Any = World("Skirt", resolution=(25, 52)).task
    (place, speed), (same, fast) = (
        each.joints(np.array([skirt.SETTLE + skirt.BLEND / 2 + after]), np.array([2.0]))  # half of it is lost at first
        for each, after in ((task, 16.0), (plain, 2.0))
    )
    np.testing.assert_allclose(place, same, atol=1e-9)
    np.testing.assert_allclose(8 * speed, fast, atol=1e-9)
    for _ in range(3):
        slow.step(np.zeros((1, 2)))
    assert slow.episode is not None
    np.testing.assert_allclose(np.concatenate(task.apart(slow.episode)[1:]), 0, atol=1e-5)


def test_training_never_sees_the_end_of_the_dance_that_tests_are_of() -> None:
    spans = []
    for sequence in range(7):
        task: Any = load_preset("Skirt", {"name": "chen2020", "sequence": sequence})
        world = World(task, resolution=(25, 52))
        world.reset({0: np.random.default_rng(0)})
        begin = float(world.episode.memory["begin"][0])
        spans.append((begin, begin + task.frames * task.frame_dt * task.tempo))
    assert len(set(spans)) == 7
    assert max(end for _, end in spans[:5]) <= min(begin for begin, _ in spans[5:]) + 1e-9
    assert max(end for _, end in spans) <= task.motion.duration + 1e-9


def test_test_dances_are_as_unlike_those_of_training_as_these_are_to_each_other() -> None:
    """Poses and velocities up to a turn about the vertical, the dance at its own pace."""
    moves = []
    for sequence in range(7):
        task: Any = World("Skirt", preset={"name": "chen2020", "sequence": sequence}, resolution=(25, 52)).task
        times = np.arange(81, 801, 8) * task.frame_dt
        joints, speeds = task.joints(times, np.full(len(times), task.begin(np.random.default_rng(0))))
        turn = rotation(heading(joints, speeds)[0], 0, 1)
        posed = np.stack([joints - joints[:, :1] * [1, 1, 0], speeds / task.tempo / np.pi]) @ turn  # a step is pi rad/s
        moves.append(np.moveaxis(posed, 0, 1).reshape(len(times), -1))
    apart = [
        np.mean([np.linalg.norm(x - np.concatenate(moves[:n] + moves[n + 1 : 5]), axis=1).min() for x in moves[n]])
        for n in range(7)
    ]
    assert min(apart[5:]) > 0.8 * np.mean(apart[:5])


@pytest.mark.parametrize("sequence", [11, 34])
def test_the_sphere_of_chen2020_is_not_driven_into_the_clips(sequence: int) -> None:
    """Where it was, it pressed the cloth through itself."""
    world = World("Hitting", preset={"name": "chen2020", "sequence": sequence}, resolution=(28, 27))
    world.reset({0: np.random.default_rng(0)})
    radius, tops = world.scene.colliders[0].radius, []
    for _ in range(60):
        world.step(np.array([[0.0, 0.0, 1.0]]))
        tops.append(world.state.colliders[0, 0, 0, 2] + radius)
    assert max(tops) == pytest.approx(-chen2020.BELOW, abs=2e-3)  # its speed is that for the distance a frame before


def test_the_sphere_of_chen2020_crosses_back_and_forth() -> None:
    world = World("Hitting", preset={"name": "chen2020", "sequence": 3}, resolution=(28, 27))
    world.reset({0: np.random.default_rng(0)})
    ys = []
    for _ in range(round(2 * chen2020.PERIODS[1] / world.scene.frame_dt)):
        _, reasons = world.step(np.zeros((1, 3)))
        assert reasons == [None]
        ys.append(float(world.state.colliders[0, 0, 0, 1]))
    turns = np.count_nonzero(np.diff(np.sign(np.diff(ys))))
    assert turns >= 3
    # The turns lie between frames; a float32 of 0.7 for every frame.
    assert max(ys) == pytest.approx(chen2020.END, abs=0.01)
    assert min(ys) == pytest.approx(-chen2020.END, abs=0.01)


def test_zhao2024_ball_is_inside_nothing_but_a_step() -> None:
    """What comes in at most: the way of one step at the speed of the fall from 0.6 to 0.3 m."""
    world = rest("BallDrop", "zhao2024", 30)
    depth = 0.3 - np.linalg.norm(world.state.positions[0], axis=0).min()
    speed, step = np.sqrt(2 * 9.8 * 0.3), zhao2024.BALL_NET.sim_dt
    # Inside, what is left of an inward velocity after a step is what gravity adds in the next: g h / (1 - keep).
    creep = 9.8 * step / (1 - zhao2024.BALL_NET.keep) * 0.6
    assert 0 < depth < speed * step + creep
    assert world.task.reward(world.episode)[0] > 0.9


@cases
def test_pictures_hold_the_whole_cloth(scene: str, preset: str) -> None:
    """Every vertex lies in the field of view of the camera that the first frame chooses."""
    world = World(scene, preset=preset, **COARSE.get(preset, {}))
    world.reset({0: np.random.default_rng(0)})
    aspect = 4 / 3
    towards = framing.direction(world.scene, world.state)
    corners = np.array(np.meshgrid(*framing.reach(world.scene, world.state).T)).reshape(3, -1).T
    camera = framing.fit(corners, towards, aspect)
    position, up = np.array(camera.position), np.array(camera.up)
    axes = np.stack([np.cross(up, towards), up, towards])
    half = np.tan(np.deg2rad(framing.VIEW_ANGLE / 2))
    for _ in range(60):
        world.step(np.zeros((1, len(world.task.actions))))
        right, above, near = axes @ (world.state.positions[0].reshape(3, -1) - position[:, None])
        assert (abs(right) < half * aspect * -near).all()
        assert (abs(above) < half * -near).all()


@pytest.mark.parametrize(("scene", "preset"), [("Curtain", "lee2019"), ("BallDrop", "zhao2024")])
def test_a_picture_is_drawn(scene: str, preset: str) -> None:
    pytest.importorskip("pyvista", reason="needs the extra 'render'")
    with make(scene, preset, render_mode="rgb_array") as env:
        env.reset(seed=0)
        env.step(np.zeros(env.action_space.shape, np.float32))
        assert env.render().std() > 5  # not a blank frame


@cases
def test_recordings_hold_the_whole_scene(scene: str, preset: str, tmp_path: Path) -> None:
    with make(scene, preset) as env:
        env.reset(seed=0)
        with RolloutWriter(tmp_path / "run.h5", env) as writer:
            writer.begin(seed=0)
            writer.append(env.unwrapped.state)
        with Rollout.open(tmp_path / "run.h5") as record:
            assert record.scene == env.unwrapped.scene
            assert record.scene.describe() == env.unwrapped.scene.describe()
            assert record.material() == env.unwrapped.scene.material


def test_every_preset_has_a_scene_and_the_command_takes_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert presets_of("Pressure") == ["zhao2024", "zhao2024-fall"]
    assert cli.main(["rollout", "BallDrop", "--preset", "zhao2024", "--frames", "2", "--policy", "zero"]) == 0
    assert cli.main(["rollout", "Flag", "--preset", '{"name": "lee2019", "mass": 3}', "--frames", "2"]) == 0
    assert cli.main(["list"]) == 0
    assert cli.main(["list", "--scene", "Curtain"]) == 0
    text = capsys.readouterr().out
    assert "zhao2024-fall" in text
    assert 'preset="lee2019"' in text
    assert cli.main(["rollout", "Flag", "--preset", "zhao2024"]) == 2
    assert "'lee2019'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("scene", "preset", "options", "words"),
    [
        ("Pressure", "zaho2024", {}, ["'zhao2024'", "Did you mean"]),
        ("Flag", "zhao2024", {}, ["Flag has 'lee2019'", "Pressure, Hanging, BallDrop"]),
        ("Hanging", "zhao2024-fall", {}, ["Hanging has 'zhao2024'", "exists for Pressure"]),
        ("Flagg", "lee2019", {}, ["'Flag'"]),
        ("Flag", 3, {}, ["'lee2019'"]),
        ("Flag", {"mass": 3.0}, {}, ["name"]),
        ("Flag", {"name": "lee2019", "mas": 3.0}, {}, ["'mass'"]),
        ("Curtain", {"name": "lee2019", "wind": 3.0}, {}, ["'mass'", "'spring'"]),
        ("Flag", {"name": "lee2019", "mass": 0.0}, {}, ["positive mass"]),
        ("Flag", {"name": "lee2019", "mass": "3"}, {}, ["finite number as mass"]),
        ("Flag", {"name": "lee2019", "wind": 40.0}, {}, ["-12 to 12"]),
        ("Flag", {"name": "lee2019", "bending": -1.0}, {}, ["bending of 0 or more"]),
        ("Flag", {"name": "lee2019", "tangential": -1.0}, {}, ["tangential of 0 or more"]),
        ("Draping", {"name": "chen2020", "sequence": 13}, {}, ["0 to 12"]),
        ("Hitting", {"name": "chen2020", "sequence": 0.5}, {}, ["0 to 34"]),
        ("Skirt", {"name": "chen2020", "sequence": 7}, {}, ["0 to 6"]),
        ("Pressure", {"name": "zhao2024", "mass": 3.0}, {}, ["no options"]),
        ("Pressure", "zhao2024", {"material": "silk"}, ["fixes the material", "leave material= out"]),
        ("Pressure", "zhao2024", {"randomize": {"drag": [0.1, 0.2]}}, ["fixes the randomize"]),
        ("Pressure", "zhao2024", {"resolution": (65, 65)}, ["fixes the resolution"]),
        ("Hanging", "zhao2024", {"backend_kwargs": {"solver": "admm"}}, ["net of particles", "'explicit'"]),
        ("Hanging", "zhao2024", {"backend": "miniature"}, ["spacing"]),
    ],
)
def test_bad_arguments_name_the_remedy(
    scene: str, preset: object, options: dict[str, object], words: list[str]
) -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        World(scene, preset=preset, **options)  # type: ignore[arg-type]
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_lee2019_leaves_material_and_resolution_open() -> None:
    world = World("Flag", preset="lee2019", material={"drag": 1.0}, resolution=(17, 25))
    assert world.scene.material.areal_density == 1.0
    assert world.scene.material.drag == 1.0
    assert world.scene.grid.shape == (17, 25)
    assert load_preset("Flag", "lee2019").resolution == (33, 49)


def test_lee2019_runs_the_papers_solver_unless_another_is_chosen() -> None:
    small = {"preset": "lee2019", "resolution": (17, 25)}
    assert isinstance(World("Flag", **small).backend, AdmmSolver)  # type: ignore[arg-type]
    more = World("Flag", backend_kwargs={"iterations": 30}, **small).backend  # type: ignore[arg-type]
    assert isinstance(more, AdmmSolver)
    assert more.iterations == 30
    assert isinstance(World("Flag", backend_kwargs={"solver": "explicit"}, **small).backend, ExplicitSolver)  # type: ignore[arg-type]
    assert isinstance(World("Flag", resolution=(17, 25)).backend, ExplicitSolver)
