"""Motions that take a limb into the waistband are refused, however far others tip."""

from __future__ import annotations

import re
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cloth_envs.figure.dance import dance
from cloth_envs.figure.entry import check_entry
from cloth_envs.figure.motion import Motion, read_motion
from cloth_envs.figure.skeleton import JOINTS, OFFSETS, PARENTS, place
from cloth_envs.presets import load_preset
from cloth_envs.scenes.waistband import check_waistband, limbs_inside

RECORDED = Path(__file__).parents[2] / "shared" / "data" / "mocap" / "cmu_motions.h5"
ARMS = ("right", -75.0), ("left", 75.0)
beside = pytest.mark.skipif(not RECORDED.exists(), reason="recorded motions lie beside the checkout")


def bent(joint: str, axis: str, degrees: float) -> Motion:
    """Four seconds, arms spread: it bends by so much and back."""
    angles = degrees * np.sin(np.linspace(0, np.pi, 121))[:, None] ** 2
    bends = {f"{side}_upper_arm": Rotation.from_euler("X", 0 * angles + a, degrees=True) for side, a in ARMS}
    bends[joint] = Rotation.from_euler(axis, angles, degrees=True)
    return Motion(place(bends, OFFSETS, PARENTS, JOINTS), 30.0)


@pytest.mark.parametrize("axis", ["X", "Y"])
def test_hips_may_tip_over(axis: str) -> None:
    check_waistband(bent("pelvis", axis, 170), "it")
    check_waistband(dance(), "it")


def test_a_knee_may_come_up_to_the_waistband_and_not_into_it() -> None:
    check_waistband(bent("left_thigh", "Y", -95), "it")
    motion = bent("left_thigh", "Y", -120)
    _, deep = limbs_inside(motion)
    assert deep.argmax() == 60  # of 120, the middle
    assert 0.03 < deep.max() < 0.07  # m, the thigh's radius
    first = np.flatnonzero(deep > 0)[0]
    into, free = (
        f"left thigh {1e3 * deep.max():.0f} mm into the waistband at 2.00 s",
        f"the {(first - 1) / 30:.1f} s from",
    )
    with pytest.raises(ValueError, match=f"{into}.*{free}"):
        check_waistband(motion, "it")


@pytest.mark.parametrize(
    ("joint", "axis", "degrees", "why"), [("pelvis", "Y", 90, "hips face"), ("pelvis", "X", 180, "upside down")]
)
def test_motions_begin_upright(joint: str, axis: str, degrees: float, why: str) -> None:
    """In the middle, at 2 s, as far as they like."""
    motion = bent(joint, axis, degrees)
    check_entry(motion, 0.65, "it")
    with pytest.raises(ValueError, match=f"{why}.* at .*its first 2.60 s should be upright"):
        check_entry(motion, 2.6, "it")
    check_entry(bent("left_thigh", "Y", -95), 9.0, "it")
    check_entry(dance(), 48.0, "it")


@pytest.mark.parametrize("fps", [24.0, 29.97, 60.0, 120.0])
def test_the_part_that_is_told_is_free_to_the_frame(fps: float) -> None:
    rng, count = np.random.default_rng(9100), 90
    for _ in range(5):
        away = np.arange(count)[:, None] - rng.integers(0, count, 3)
        lift = -125 * np.exp(-np.square(away / rng.uniform(1, 6, 3))).max(1)
        bends = {
            f"{side}_upper_arm": Rotation.from_euler("X", np.full((count, 1), a), degrees=True) for side, a in ARMS
        }
        bends["right_thigh"] = Rotation.from_euler("Y", lift[:, None], degrees=True)
        positions = place(bends, OFFSETS, PARENTS, JOINTS)
        with pytest.raises(ValueError, match="store a part") as refused:
            check_waistband(Motion(positions, fps), "it")
        told = re.search(r"from ([\d.]+) to ([\d.]+) s, or", str(refused.value))
        assert told
        first, last = (round(float(time) * fps) for time in told.groups())
        check_waistband(Motion(positions[first : last + 1], fps), "that part")


def test_a_part_too_short_to_be_read_is_not_told() -> None:
    up, down = (bent("left_thigh", "Y", -120).at(np.array([at]))[0] for at in (2.0, 0.0))
    with pytest.raises(ValueError, match="skirt: choose another motion"):
        check_waistband(Motion(np.concatenate([up, down, down, down, up]), 30.0), "it")


def test_one_that_stays_in_it_has_no_part_to_take() -> None:
    still = Motion(np.repeat(bent("left_thigh", "Y", -120).at(np.array([2.0]))[0], 5, 0), 30.0)
    with pytest.raises(ValueError, match="skirt: choose another motion"):
        check_waistband(still, "it")


def test_the_preset_refuses_such_a_motion(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "motions.h5", "w") as file:
        group = file.create_group("kick")
        motion = bent("right_thigh", "Y", -130)
        group["positions"] = motion.at(np.arange(121) / 30)[0]
        group.attrs.update(fps=30.0, joint_names=list(JOINTS))
    with pytest.raises(ValueError, match=r"'kick' in .*motions.h5 takes the right thigh"):
        load_preset("Skirt", {"name": "chen2020", "motion": f"{tmp_path / 'motions.h5'}:kick"})


@beside
@pytest.mark.parametrize(("name", "fits"), [("dance", True), ("walk", True), ("run", True), ("cartwheel", False)])
def test_recorded_motions(name: str, fits: bool) -> None:
    _, deep = limbs_inside(read_motion(RECORDED, name))
    assert (deep.max() <= 0) == fits
