"""The capsules around a figure's joints, and the frame of its hips, in which a waistband lies."""

from typing import NamedTuple

import numpy as np
from array_api_compat import array_namespace

from cloth_envs.figure.skeleton import JOINTS
from cloth_envs.scene import Collider


class Limb(NamedTuple):
    """A capsule from one joint towards another: ``inset`` [m] from each; its radius [m]."""

    name: str
    first: str
    second: str
    radius: float
    inset: float = 0.0


LIMBS = (
    Limb("hips", "right_thigh", "left_thigh", 0.095, 0.03),
    Limb("right thigh", "right_thigh", "right_shin", 0.07),
    Limb("right shin", "right_shin", "right_foot", 0.05),
    Limb("left thigh", "left_thigh", "left_shin", 0.07),
    Limb("left shin", "left_shin", "left_foot", 0.05),
    Limb("waist", "pelvis", "torso", 0.1),
    Limb("chest", "torso", "head", 0.115, 0.06),
    Limb("shoulders", "right_upper_arm", "left_upper_arm", 0.06, 0.04),
    Limb("head", "head", "head", 0.1),
    Limb("right upper arm", "right_upper_arm", "right_lower_arm", 0.045),
    Limb("right lower arm", "right_lower_arm", "right_hand", 0.04),
    Limb("left upper arm", "left_upper_arm", "left_lower_arm", 0.045),
    Limb("left lower arm", "left_lower_arm", "left_hand", 0.04),
)
TWISTING = {"waist": "hips", "chest": "shoulders", "right thigh": "hips", "left thigh": "hips"}  # with whose axis
FRICTION = 0.3
ENDS = np.array([[JOINTS.index(limb.first), JOINTS.index(limb.second)] for limb in LIMBS], np.int32)  # joints
INSETS = np.array([limb.inset for limb in LIMBS])
PELVIS, TORSO = JOINTS.index("pelvis"), JOINTS.index("torso")
HIPS = JOINTS.index("right_thigh"), JOINTS.index("left_thigh")


def colliders() -> tuple[Collider, ...]:
    """The capsules; those of waist, chest and thighs spin."""
    names = [limb.name for limb in LIMBS]
    return tuple(
        Collider(
            "sphere" if limb.first == limb.second else "capsule",
            limb.radius,
            FRICTION,
            limb.name,
            turns_with=names.index(TWISTING[limb.name]) if limb.name in TWISTING else None,
        )
        for limb in LIMBS
    )


def ends(joints: np.ndarray, limbs: np.ndarray, insets: np.ndarray) -> np.ndarray:
    """The capsules' ends ``(B, C, 2, 3)`` of joints ``(B, J, 3)``; ``limbs``, ``insets``: ``ENDS``, ``INSETS``."""
    at, xp = joints[:, limbs], array_namespace(joints)
    axis = at[:, :, 1] - at[:, :, 0]
    length = xp.sqrt((axis * axis).sum(2))
    inset = (insets / (length + (length == 0.0)))[:, :, None] * axis
    return xp.stack([at[:, :, 0] + inset, at[:, :, 1] - inset], axis=2)


def hips_frame(joints: np.ndarray) -> np.ndarray:
    """Axes of the hips of joints ``(B, J, 3)`` as rows ``(B, 3, 3)``: forwards, to the left hip, and up the spine."""
    xp = array_namespace(joints)
    left = _unit(joints[:, HIPS[1]] - joints[:, HIPS[0]])
    spine = joints[:, TORSO] - joints[:, PELVIS]
    up = _unit(spine - (spine * left).sum(1)[:, None] * left)
    return xp.stack([xp.linalg.cross(left, up), left, up], axis=1)


def _unit(lines: np.ndarray) -> np.ndarray:
    """Lines ``(B, 3)`` of length 1."""
    return lines / array_namespace(lines).sqrt((lines * lines).sum(1))[:, None]
