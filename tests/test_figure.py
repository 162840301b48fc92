"""The dancing figure: joints by their angles, motions between frames and from files, capsules, the skirt's task."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cloth_envs.figure import body
from cloth_envs.figure.dance import DURATION, dance, stand
from cloth_envs.figure.motion import Motion, read_motion
from cloth_envs.figure.skeleton import JOINTS, OFFSETS, PARENTS, place
from cloth_envs.grid import Grid
from cloth_envs.physics.laws.bodies import axis_parameter, on_axis
from cloth_envs.scenes import skirt
from cloth_envs.scenes.starts import ruffle
from cloth_envs.world import World

RECORDED = Path(__file__).parents[2] / "shared" / "data" / "mocap" / "cmu_motions.h5"
SMALL = (25, 52)


def lengths(joints: np.ndarray) -> np.ndarray:
    """Of the bones, ``(F, J - 1)``."""
    return np.linalg.norm(joints[:, 1:] - joints[:, PARENTS[1:]], axis=2)


def write(path: Path, **changes: Any) -> Path:
    """A file with one motion, ``"hop"``; what is None in ``changes`` is left out."""
    parts: dict[str, Any] = {"positions": np.repeat(stand(), 5, 0), "fps": 60.0, "joint_names": list(JOINTS)} | changes
    with h5py.File(path, "w") as file:
        group = file.create_group("hop")
        if parts["positions"] is not None:
            group["positions"] = parts["positions"]
        for name in ("fps", "joint_names"):
            if parts[name] is not None:
                group.attrs[name] = parts[name]
    return path


def world(seed: int = 0, **options: Any) -> World:
    made = World("Skirt", resolution=SMALL, **options)
    made.reset({0: np.random.default_rng(seed)})
    return made


def test_an_arm_that_is_bent_carries_what_hangs_from_it() -> None:
    joints = place(
        {"left_upper_arm": Rotation.from_euler("X", [[0.0], [90.0]], degrees=True)}, OFFSETS, PARENTS, JOINTS
    )
    shoulder, elbow, hand = (JOINTS.index(f"left_{part}") for part in ("upper_arm", "lower_arm", "hand"))
    np.testing.assert_allclose(joints[0, hand] - joints[0, shoulder], [0, 0, -0.54], atol=1e-12)
    np.testing.assert_allclose(joints[1, elbow] - joints[1, shoulder], [0, 0.28, 0], atol=1e-12)
    np.testing.assert_allclose(joints[1, hand] - joints[1, shoulder], [0, 0.54, 0], atol=1e-12)


@pytest.mark.skipif(not RECORDED.exists(), reason="recorded motions lie beside the checkout")
@pytest.mark.parametrize("name", ["dance", "walk", "cartwheel"])
def test_recorded_joints_are_where_forward_kinematics_puts_them(name: str) -> None:
    with h5py.File(RECORDED) as file:
        group = file[name]
        positions, turns = group["positions"][:].astype(float), group["rotations"][:].astype(float)
        offsets, parents = group["rest_offsets"][:].astype(float), tuple(group["parents"][:].tolist())
    world_turns = [Rotation.from_quat(turns[:, i]) for i in range(len(JOINTS))]
    bends = {
        joint: world_turns[i] if parents[i] < 0 else world_turns[parents[i]].inv() * world_turns[i]
        for i, joint in enumerate(JOINTS)
    }
    joints = place(bends, offsets, parents, JOINTS)
    found = joints - joints[:, :1] + positions[:, :1]
    assert np.abs(found - positions).max() < 1e-5  # float32 of positions of a few metres
    motion = read_motion(RECORDED, name)
    assert motion.fps == 30  # each frame is there twice
    np.testing.assert_allclose(motion.at(np.arange(0, len(positions), 2) / 60)[0], positions[::2], atol=1e-9)


@pytest.mark.parametrize("times", [1, 2, 3])
def test_frames_that_are_stored_several_times_count_once(times: int, tmp_path: Path) -> None:
    """Else a steady motion stops at each, and goes faster between: up to 1.5 times at a cubic spline's knots."""
    going = np.repeat(stand(), 40, 0) + np.arange(40)[:, None, None] * [0.05, 0, 0]
    stored = np.repeat(going, times, 0)[: 40 * times - (times > 1)]  # the last one less often
    motion = read_motion(write(tmp_path / "motions.h5", positions=stored, fps=30.0 * times), "hop")
    assert motion.duration == pytest.approx(39 / 30)
    _, speed = motion.at(np.linspace(0.3, 1.0, 200))  # away from the ends, where it is at rest
    np.testing.assert_allclose(speed, np.broadcast_to([1.5, 0, 0], speed.shape), atol=1e-3)


def test_a_motion_that_stands_still_or_rests_keeps_its_frames(tmp_path: Path) -> None:
    rests = np.repeat(stand(), 9, 0) + np.array([0, 0, 0, 1, 1, 1, 2, 3, 3])[:, None, None] * [0.01, 0, 0]
    for positions in (np.repeat(stand(), 5, 0), rests, rests[:6]):
        motion = read_motion(write(tmp_path / "motions.h5", positions=positions), "hop")
        assert motion.fps == 60
        np.testing.assert_allclose(motion.at(np.arange(len(positions)) / 60)[0], positions, atol=1e-12)


def test_a_motion_is_smooth_between_frames() -> None:
    """A circle of 24 frames: a spline of them is off by less than its fifth-order remainder, its velocity as well."""
    turns = 2 * np.pi * np.arange(25) / 24
    circle = np.stack([np.cos(turns), np.sin(turns), 0 * turns], 1)[:, None]
    motion = Motion(circle, 24.0, loops=True)
    t = np.linspace(0, 2.5, 401)
    place, speed = motion.at(t)
    want = np.stack([np.cos(2 * np.pi * t), np.sin(2 * np.pi * t), 0 * t], 1)[:, None]
    assert np.abs(place - want).max() < (2 * np.pi / 24) ** 4 / 100
    assert (
        np.abs(speed[:, :, :2] - 2 * np.pi * want[:, :, [1, 0]] * [-1, 1]).max()
        < 2 * np.pi * (2 * np.pi / 24) ** 3 / 10
    )
    once = Motion(circle, 24.0)
    (first, last), ends = once.at(np.array([-1.0, 5.0]))
    np.testing.assert_allclose([first[0], last[0]], [circle[0, 0], circle[-1, 0]], atol=1e-12)
    assert np.abs(ends).max() < 1e-12


def test_the_dance_keeps_its_bones_and_its_feet_up() -> None:
    motion = dance()
    t = np.linspace(0, 2 * DURATION, 1001)
    joints, speed = motion.at(t)
    np.testing.assert_allclose(lengths(joints), np.repeat(lengths(stand()), len(t), 0), atol=1e-4)  # splines
    feet = joints[:, [JOINTS.index("right_foot"), JOINTS.index("left_foot")], 2]
    shin = next(limb for limb in body.LIMBS if limb.name == "right shin")
    assert feet.min() > shin.radius
    assert 0.5 < np.linalg.norm(speed, axis=2).max() < 3.0  # it dances, and no faster than a person does
    np.testing.assert_allclose(joints[:500], joints[500:1000], atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fps": None}, "lacks fps"),
        ({"positions": None}, "lacks positions"),
        ({"joint_names": [*JOINTS[:-1], "toe"]}, "no left_foot"),
        ({"positions": np.zeros((5, 3, 3))}, r"\(F, 15, 3\)"),
        ({"positions": np.full((5, 15, 3), np.nan)}, "not finite"),
        ({"fps": 0.0}, "a rate"),
        ({"fps": np.inf}, "a rate"),
        ({"fps": "60"}, "all numbers"),
        ({"fps": np.array([60.0, 60.0])}, "all numbers"),
        ({"joint_names": 3}, "no pelvis"),
        ({"positions": np.zeros((5, 15, 3)) + 0j}, "all numbers"),
        ({"positions": np.zeros((5, 15, 3))}, "0 to 0 m between its thighs"),
        ({"positions": 100 * np.repeat(stand(), 5, 0)}, "positions are in metres"),
        ({"positions": np.repeat(stand(), 5, 0)[:, [0, 9, *range(2, 15)]]}, "spine along the line"),
    ],
)
def test_files_without_a_motion_are_refused(changes: dict[str, Any], words: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=words):
        read_motion(write(tmp_path / "motions.h5", **changes), "hop")
    with pytest.raises(ValueError, match="Did you mean 'hop'"):
        read_motion(write(tmp_path / "motions.h5"), "hopp")


def test_the_preset_takes_a_recorded_motion(tmp_path: Path) -> None:
    path = write(
        tmp_path / "motions.h5", positions=np.repeat(stand(), 5, 0) + np.arange(5)[:, None, None] * [0.01, 0, 0]
    )
    given = {"name": "chen2020", "motion": f"{path}:hop", "tempo": 0.5}
    task: Any = World("Skirt", preset=given, resolution=SMALL).task
    long = np.array([100.0])
    np.testing.assert_allclose(task.joints(long, 0 * long)[0][0], stand()[0] + [0.04, 0, 0], atol=1e-12)
    for wrong, words in (
        ({"motion": str(path)}, "file and a name"), ({"motion": 3}, "text as motion"), ({"tempo": 0}, "positive tempo"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=words):
            World("Skirt", preset=given | wrong, resolution=SMALL)


@pytest.mark.parametrize("cols", [52, 104, 208])
@pytest.mark.parametrize("radius", [0.15, 0.19, 0.24])
def test_a_ruffle_has_its_radius_and_edges_of_rest_length(cols: int, radius: float) -> None:
    grid = Grid(9, cols, 0.75, 1.6, periodic=True)
    line = ruffle(grid, 13, radius)
    np.testing.assert_allclose(np.linalg.norm(np.roll(line, -1, 1) - line, axis=0), grid.col_spacing, rtol=1e-12)
    assert np.linalg.norm(line, axis=0).mean() == pytest.approx(radius, abs=1e-3)
    np.testing.assert_allclose(line.mean(1), 0, atol=1e-12)


def test_actions_turn_and_raise_the_dancer_besides_the_dance() -> None:
    """Rates go up within the acceleration's limit and stay; what the task reads back from the bodies is what it did."""
    made = world()
    assert made.episode is not None
    task: Any = made.task
    turns = []
    for _ in range(40):
        made.step(np.array([[0.5, 1.0]]))
        turns.append([part[0] for part in task.apart(made.episode)])
    angle, rate, height, rising = np.array(turns).T
    assert rate[-1] == pytest.approx(0.5 * skirt.SPIN, abs=1e-3)
    np.testing.assert_allclose(np.diff(np.unwrap(angle))[20:], 0.5 * skirt.SPIN * task.frame_dt, atol=1e-4)
    assert height[-1] == pytest.approx(skirt.LIFT, abs=0.01)
    assert np.abs(np.diff(height)).max() <= skirt.RISING * task.frame_dt + 1e-5
    assert np.abs(rising).max() <= skirt.RISING + 1e-3


def test_the_waistband_goes_with_the_hips() -> None:
    """Rigidly: its points keep their places in the hips' frame, to float32."""
    made = world(3)
    task: Any = made.task
    for _ in range(60):
        made.step(np.array([[0.7, -0.4]]))
    assert made.episode is not None
    band = made.state.positions[0, :, 0].astype(float)
    apart = np.linalg.norm(band[:, :, None] - band[:, None], axis=0)
    want = np.linalg.norm(task.band[:, None] - task.band, axis=2)
    np.testing.assert_allclose(apart, want, atol=2e-6)
    hips = made.state.colliders[0, 0].astype(float).mean(0)
    assert np.linalg.norm(band.mean(1) - hips) == pytest.approx(skirt.RISE, abs=1e-5)


def test_a_dance_leaves_the_skirt_outside_the_body_and_itself() -> None:
    made = world(1)
    deepest, crossings = -np.inf, 0
    for _ in range(150):
        _, reasons = made.step(np.array([[0.8, 0.0]]))
        assert reasons == [None]
        crossings += int(made.crossings[0])
    x = made.state.positions.reshape(1, 3, -1).astype(float)
    for number, limb in enumerate(made.scene.colliders):
        ends = made.state.colliders[:, number].astype(float)
        away = np.linalg.norm(x - on_axis(ends, axis_parameter(ends, x)), axis=1)
        deepest = max(deepest, limb.radius - away.min())
    assert deepest < 0  # the thickness of 5 mm lies between
    assert crossings == 0
