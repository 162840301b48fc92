"""A person's joints: names, parents, and where they are by the angles between them."""

import numpy as np
from scipy.spatial.transform import Rotation

JOINTS = (
    "pelvis", "torso", "head", "right_upper_arm", "right_lower_arm", "right_hand", "left_upper_arm", "left_lower_arm",
    "left_hand", "right_thigh", "right_shin", "right_foot", "left_thigh", "left_shin", "left_foot",
)  # fmt: skip
PARENTS = (-1, 0, 1, 1, 3, 4, 1, 6, 7, 0, 9, 10, 0, 12, 13)
# From each joint's parent, upright and facing along x, left along y [m]: a person of about 1.7 m.
OFFSETS = np.array(
    [
        [0.0, 0.0, 0.92], [0.0, 0.0, 0.24], [0.0, 0.0, 0.38],
        [0.0, -0.18, 0.24], [0.0, 0.0, -0.28], [0.0, 0.0, -0.26],
        [0.0, 0.18, 0.24], [0.0, 0.0, -0.28], [0.0, 0.0, -0.26],
        [0.0, -0.085, 0.0], [0.0, 0.0, -0.43], [0.0, 0.0, -0.42],
        [0.0, 0.085, 0.0], [0.0, 0.0, -0.43], [0.0, 0.0, -0.42],
    ]
)  # fmt: skip


def place(
    bends: dict[str, Rotation], offsets: np.ndarray, parents: tuple[int, ...], names: tuple[str, ...]
) -> np.ndarray:
    """Joint positions ``(F, J, 3)`` [m] by forward kinematics, the root at its offset.

    ``bends`` are rotations of joints over their parents', ``F`` each; joints that are not named don't bend.
    """
    frames = max((len(bend) for bend in bends.values()), default=1)
    still = Rotation.identity(frames)
    turns: list[Rotation] = []
    positions = np.zeros((frames, len(names), 3))
    for i, (name, parent) in enumerate(zip(names, parents, strict=True)):
        carried = turns[parent] if parent >= 0 else still
        positions[:, i] = (positions[:, parent] if parent >= 0 else 0.0) + carried.apply(offsets[i])
        turns.append(carried * bends.get(name, still))
    return positions
