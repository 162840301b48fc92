"""A dance without a file: hips that sway and twist over small steps, arms that swing; 48 seconds, then again.

Steps, twists, arms and the way that the dancer faces go round 24, 17, 8 and 5 times in it, so they drift against each
other (24 / 17 is nearly the square root of two): no two seconds of the dance are like two others of it.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from cloth_envs.figure.motion import Motion
from cloth_envs.figure.skeleton import JOINTS, OFFSETS, PARENTS, place

FPS, DURATION = 60, 48.0
STEPS, TWISTS, ARMS, FACING = 24, 17, 8, 5  # a step with each leg every two seconds
SIDES = (("right", -1.0), ("left", 1.0))
SWAY, LEAN = 0.05, 0.03  # m, of the hips to the side with the steps, and forwards and back with the twists
SOFT = 0.01  # m, over which weight goes from one foot to the other


def stand() -> np.ndarray:
    """Joint positions ``(1, J, 3)`` [m] of a person who stands upright, arms spread, the feet apart as the hips are."""
    arms = {f"{side}_upper_arm": Rotation.from_euler("X", [[sign * 75]], degrees=True) for side, sign in SIDES}
    return place(arms, OFFSETS, PARENTS, JOINTS)


def dance() -> Motion:
    """The dance: feet stay above the ground, z = 0, the lower one near it."""
    t = np.linspace(0.0, DURATION, round(DURATION * FPS) + 1)
    beat, winding, waving, slow = (2 * np.pi * rounds / DURATION * t for rounds in (STEPS, TWISTS, ARMS, FACING))

    def bend(axes: str, *degrees: np.ndarray) -> Rotation:
        return Rotation.from_euler(axes, np.stack(degrees, 1), degrees=True)

    swing = np.sin(beat) * (0.8 + 0.2 * np.sin(waving))  # steps are larger and smaller
    lift = {"right": 0.5 + 0.5 * swing, "left": 0.5 - 0.5 * swing}
    twist = 28 * np.sin(winding) + 8 * np.sin(beat)
    bends = {
        "pelvis": bend("ZXY", 40 * np.sin(slow) + twist, 7 * swing, 4 * np.sin(winding + slow)),
        "torso": bend("ZX", -0.7 * twist, -8 * swing),
    }
    for side, sign in SIDES:
        up = lift[side] ** 2
        bends |= {
            f"{side}_thigh": bend("ZYX", -0.5 * twist, 4 - 36 * up, sign * (6 - 7 * swing * sign)),
            f"{side}_shin": bend("Y", 6 + 52 * up),
            f"{side}_upper_arm": bend("XY", sign * (62 + 15 * np.sin(waving + slow)), -30 * sign * np.sin(waving)),
            f"{side}_lower_arm": bend("Y", -50 - 20 * np.sin(winding + sign)),
        }
    positions = place(bends, OFFSETS, PARENTS, JOINTS)
    feet = positions[:, [JOINTS.index("right_foot"), JOINTS.index("left_foot")], 2]
    positions[:, :, 2] += SOFT * np.log(np.exp(-feet / SOFT).sum(1))[:, None] + 0.07
    positions[:, :, 0] += LEAN * np.cos(winding)[:, None]
    positions[:, :, 1] += SWAY * swing[:, None]
    positions[-1] = positions[0]
    return Motion(positions, FPS, loops=True)
