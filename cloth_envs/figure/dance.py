"""A dance without a file: hips that sway and twist over small steps, arms that swing; eight seconds, then again."""

import numpy as np
from scipy.spatial.transform import Rotation

from cloth_envs.figure.motion import Motion
from cloth_envs.figure.skeleton import JOINTS, OFFSETS, PARENTS, place

FPS, DURATION = 60, 8.0
BEAT = 2 * np.pi / 2.0  # rad/s, a step with each leg every two seconds
SIDES = (("right", -1.0), ("left", 1.0))
SWAY = 0.05  # m, of the hips to the side
SOFT = 0.01  # m, over which weight goes from one foot to the other


def stand() -> np.ndarray:
    """Joint positions ``(1, J, 3)`` [m] of a person who stands upright, arms spread, the feet apart as the hips are."""
    arms = {f"{side}_upper_arm": Rotation.from_euler("X", [[sign * 75]], degrees=True) for side, sign in SIDES}
    return place(arms, OFFSETS, PARENTS, JOINTS)


def dance() -> Motion:
    """The dance: feet stay above the ground, z = 0, the lower one near it."""
    t = np.linspace(0.0, DURATION, round(DURATION * FPS) + 1)
    beat, slow = BEAT * t, BEAT * t / 4

    def bend(axes: str, *degrees: np.ndarray) -> Rotation:
        return Rotation.from_euler(axes, np.stack(degrees, 1), degrees=True)

    lift = {"right": 0.5 + 0.5 * np.sin(beat), "left": 0.5 - 0.5 * np.sin(beat)}
    twist = 28 * np.sin(beat) + 10 * np.sin(2 * slow)
    bends = {
        "pelvis": bend("ZXY", 40 * np.sin(slow) + twist, 7 * np.sin(beat), 3 * np.sin(2 * beat)),
        "torso": bend("ZX", -0.7 * twist, -8 * np.sin(beat)),
    }
    for side, sign in SIDES:
        up = lift[side] ** 2
        swing = 25 * np.sin(beat) * -sign
        bends |= {
            f"{side}_thigh": bend("ZYX", -0.5 * twist, 4 - 36 * up, sign * (6 - 7 * np.sin(beat) * sign)),
            f"{side}_shin": bend("Y", 6 + 52 * up),
            f"{side}_upper_arm": bend("XY", sign * (62 + 15 * np.sin(2 * slow)), swing),
            f"{side}_lower_arm": bend("Y", -50 - 20 * np.sin(beat + sign)),
        }
    positions = place(bends, OFFSETS, PARENTS, JOINTS)
    feet = positions[:, [JOINTS.index("right_foot"), JOINTS.index("left_foot")], 2]
    positions[:, :, 2] += SOFT * np.log(np.exp(-feet / SOFT).sum(1))[:, None] + 0.07
    positions[:, :, 1] += SWAY * np.sin(beat)[:, None]
    positions[-1] = positions[0]
    return Motion(positions, FPS, loops=True)
