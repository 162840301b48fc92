"""How a dancer goes over into a motion: bones keep their lengths, velocities are those of the positions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from cloth_envs.figure import body
from cloth_envs.figure.entry import BONES, chain, gathered, heading, upright
from cloth_envs.figure.motion import Motion
from cloth_envs.scenes import skirt
from cloth_envs.scenes.starts import rotation
from cloth_envs.tensors import moved
from cloth_envs.world import World

RECORDED = Path(__file__).parents[2] / "shared" / "data" / "mocap" / "cmu_motions.h5"
beside = pytest.mark.skipif(not RECORDED.exists(), reason="recorded motions lie beside the checkout")
MOTIONS = ["", *(pytest.param(name, marks=beside) for name in ("dance", "walk", "run", "hop"))]
SETTLE, BLEND = skirt.SETTLE, skirt.BLEND


def dancer(name: str, tempo: float = 1.0) -> Any:
    motion = f"{RECORDED}:{name}" if name else ""
    return World("Skirt", preset={"name": "chen2020", "motion": motion, "tempo": tempo}, resolution=(25, 52)).task


def moments(task: Any) -> tuple[np.ndarray, np.ndarray]:
    """Times until after the dancer is in the dance, of places where dances begin."""
    begins = np.linspace(0.0, task.motion.duration, 49) if task.motion.loops else np.zeros(1)
    times = np.linspace(0.0, SETTLE + BLEND + 0.5, 301)
    return tuple(part.ravel() for part in np.meshgrid(times, begins))  # type: ignore[return-value]


def bones(joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Their lengths ``(F, J - 1)`` and directions."""
    lines = joints[:, BONES[0]] - joints[:, BONES[1]]
    lengths = np.linalg.norm(lines, axis=2)
    return lengths, lines / lengths[:, :, None]


def poses(motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    return motion.at(np.linspace(0.0, motion.duration, 2001))


@pytest.mark.parametrize("tempo", [1.0, 0.125])
@pytest.mark.parametrize("name", MOTIONS)
def test_bones_keep_their_lengths(name: str, tempo: float) -> None:
    """To what splines between a recording's frames leave of them."""
    task = dancer(name, tempo)
    lengths, _ = bones(task.joints(*moments(task))[0])
    own, _ = bones(poses(task.motion)[0])
    np.testing.assert_allclose(lengths, np.broadcast_to(own.mean(0), lengths.shape), rtol=0.01)


@pytest.mark.parametrize("name", MOTIONS)
def test_velocities_are_those_of_the_positions(name: str) -> None:
    """And so is the rate of the heading. Splines' third derivatives jump at frames: the error goes as h over theirs."""
    task, h = dancer(name), 1e-6
    time, begin = moments(task)
    (before, _), (joints, speeds), (after, _) = (task.joints(time + ahead, begin) for ahead in (-h, 0.0, h))
    np.testing.assert_allclose(speeds, (after - before) / (2 * h), atol=1e-6)
    (was, _), (_, rate), (will, _) = (heading(at, speeds) for at in (before, joints, after))
    np.testing.assert_allclose(rate, ((will - was + np.pi) % (2 * np.pi) - np.pi) / (2 * h), atol=1e-5)


@pytest.mark.parametrize("name", MOTIONS)
def test_the_dancer_goes_over_smoothly(name: str) -> None:
    """Accelerations, differences of velocities over a millisecond, change little in one where it begins and ends."""
    task, h = dancer(name), 1e-3
    for when in (SETTLE, SETTLE + BLEND):
        speeds = task.joints(when + h * np.arange(-2, 3), np.zeros(5))[1]
        before, _, _, after = np.diff(speeds, axis=0) / h
        jerk = 60 / BLEND**3  # of the share [1/s^3] at its ends; bones are shorter than a metre and go on from others
        own = np.abs(np.diff(poses(task.motion)[1], 2, axis=0)).max() / (task.motion.duration / 2000) ** 2
        assert np.abs(after - before).max() < 3 * h * (4 * jerk + own)


@pytest.mark.parametrize("tempo", [1.0, 0.5, 0.125])
@pytest.mark.parametrize("name", MOTIONS)
def test_joints_go_no_faster_than_bones_have_to_turn(name: str, tempo: float) -> None:
    """A normalised blend of directions ``angle`` apart turns by up to 2 tan(angle / 2) of the share's rate, and what it
    blends by up to 1 / cos(angle / 2) as fast as that; bones add up along the limbs.
    """
    task = dancer(name, tempo)
    joints, speeds = poses(task.motion)
    lengths, directions = bones(joints)
    angles, spin = heading(joints, speeds)
    stood = upright() @ rotation(-angles, 0, 1)
    half = np.arccos((stood * directions).sum(2).clip(-1, 1)).max(0) / 2
    swung = np.abs(spin).max() * np.hypot(*upright()[:, :2].T)
    turned = np.linalg.norm(speeds[:, BONES[0]] - speeds[:, BONES[1]], axis=2).max(0) / lengths.mean(0)
    rates = 15 / 8 / BLEND * 2 * np.tan(half) + tempo * np.maximum(swung, turned) / np.cos(half)
    most = chain() @ (lengths.max(0) * rates) + tempo * np.linalg.norm(speeds[:, 0], axis=1).max()
    found = np.linalg.norm(task.joints(*moments(task))[1], axis=2).max(0)
    assert (found <= 1.01 * most).all()


def test_the_dancer_stands_turned_as_the_hips_are() -> None:
    task = dancer("")
    begin = np.linspace(0.0, task.motion.duration, 20)
    joints, speeds = task.joints(np.full(20, SETTLE), begin)
    danced, there = task.motion.at(begin)
    np.testing.assert_allclose(heading(joints, speeds)[0], heading(danced, there)[0], atol=1e-12)
    np.testing.assert_allclose(joints[:, body.PELVIS], danced[:, body.PELVIS], atol=1e-12)
    np.testing.assert_allclose(body.hips_frame(joints)[:, 2], np.tile([0, 0, 1.0], (20, 1)), atol=1e-12)
    assert np.abs(speeds).max() == 0.0


def test_the_share_has_its_derivative_and_integral() -> None:
    at, h = np.linspace(-0.5, 1.5, 2001), 1e-5
    share, rate, whole = gathered(at)
    for which, slope in ((0, rate), (2, share)):
        np.testing.assert_allclose((gathered(at + h)[which] - gathered(at - h)[which]) / (2 * h), slope, atol=1e-7)
    assert (share.min(), share.max(), whole[0]) == (0.0, 1.0, 0.0)
    assert whole[-1] == pytest.approx(1.0)  # half of it while it grows


def test_tensors_move_alike() -> None:
    task = dancer("", 0.5)
    time, begin = moments(task)
    there = moved(task, torch.device("cpu"))
    for tensor, array in zip(
        there.joints(torch.tensor(time), torch.tensor(begin)), task.joints(time, begin), strict=True
    ):
        np.testing.assert_allclose(tensor.numpy(), array, atol=1e-12)
