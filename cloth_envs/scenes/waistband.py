"""The rigid band from which a skirt hangs, and which motions leave room for it."""

import numpy as np

from cloth_envs.figure import body
from cloth_envs.figure.motion import FEWEST, Motion
from cloth_envs.grid import Grid
from cloth_envs.physics.laws.bodies import axis_parameter, on_axis
from cloth_envs.scenes.starts import ruffle

PLEATS = 13
WAIST, RISE = 0.15, 0.1  # m, its mean radius, and its height above the pelvis
POINTS = Grid(3, 4 * PLEATS, 1.0, 1.6)  # of whose columns it is looked whether a limb is there


def waistband(grid: Grid) -> np.ndarray:
    """Its vertices in the hips' frame, one a column, ``(W, 3)`` [m]."""
    return np.append(ruffle(grid, PLEATS, WAIST), np.full((1, grid.cols), RISE), 0).T.copy()


def limbs_inside(motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Of each frame of a motion ``(F,)``: the limb that is deepest in the waistband, and how deep it is [m]."""
    joints, _ = motion.at(np.arange(round(motion.duration * motion.fps) + 1) / motion.fps)
    points = (joints[:, :1] + waistband(POINTS) @ body.hips_frame(joints)).transpose(0, 2, 1)
    ends = body.ends(joints, body.ENDS, body.INSETS)
    nearest = (on_axis(end, axis_parameter(end, points)) for end in ends.swapaxes(0, 1))
    away = [np.linalg.norm(points - near, axis=1).min(1) for near in nearest]
    deep = np.array([limb.radius for limb in body.LIMBS])[:, None] - away
    return deep.argmax(0), deep.max(0)


def check_waistband(motion: Motion, which: str) -> None:
    """Refuse a motion that takes a limb into the waistband, which tears the cloth there.

    Raises:
        ValueError: says which limb, and when, and what part of the motion goes without.
    """
    limbs, deep = limbs_inside(motion)
    worst = int(deep.argmax())
    if deep[worst] <= 0.0:
        return
    hits = np.flatnonzero(np.concatenate([[1], deep > 0, [1]])) - 1  # one before and one behind it all count as such
    longest = np.diff(hits).argmax()
    first, last = hits[longest] + 1, hits[longest + 1] - 1
    begin, end = first / motion.fps, last / motion.fps
    free = f"the {end - begin:.1f} s from {begin:.3f} to {end:.3f} s"  # to the frame
    part = f"store a part of it that does not, such as {free}, or " if last - first + 1 >= FEWEST else ""
    raise ValueError(
        f"{which} takes the {body.LIMBS[limbs[worst]].name} {1e3 * deep[worst]:.0f} mm into the waistband at "
        f"{worst / motion.fps:.2f} s, which would tear the skirt: {part}choose another motion"
    )
