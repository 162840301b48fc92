"""How a dancer who stands goes over into a motion: bones turn from upright to danced, and keep their lengths."""

import numpy as np
from array_api_compat import array_namespace

from cloth_envs.figure import body
from cloth_envs.figure.dance import stand
from cloth_envs.figure.motion import Motion
from cloth_envs.figure.skeleton import PARENTS

LEVEL, OPPOSED = 0.25, -0.97  # least level part of where hips face, cosine of the most that a bone turns (166 degrees)
BONES = np.array([range(1, len(PARENTS)), PARENTS[1:]], np.int32)  # ``(2, J - 1)``, the joints at their ends


def upright() -> np.ndarray:
    """Directions ``(J - 1, 3)`` of the bones of a person who stands facing along x, arms spread."""
    joints = stand()[0]
    bones = joints[BONES[0]] - joints[BONES[1]]
    return bones / np.linalg.norm(bones, axis=1)[:, None]


def chain() -> np.ndarray:
    """``(J, J - 1)``, 1 where a bone lies between the pelvis and a joint: times bones, joints about the pelvis."""
    found = np.zeros((len(PARENTS), len(PARENTS) - 1))
    for bone, (joint, parent) in enumerate(BONES.T):
        found[joint] = found[parent]
        found[joint, bone] = 1.0
    return found


def gathered(at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The share that grows from 0 to 1 as ``at`` does, smooth in its second derivative; its first one; its integral."""
    s = at.clip(0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s * s), 30 * (s * (1 - s)) ** 2, s**4 * (2.5 - 3 * s + s * s) + at.clip(1.0) - 1.0


def enter(
    joints: np.ndarray,
    speeds: np.ndarray,
    share: np.ndarray,
    rate: np.ndarray,
    stance: np.ndarray,
    links: np.ndarray,
    bones: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Joints [m] and velocities [m/s] ``(B, J, 3)`` of whose bones a share is as in ``joints``, the rest upright.

    Bones turn from where they are in ``stance``, faced as the hips are, the pelvis and their lengths are those of
    ``joints``. A bone that has to turn by 180 degrees has no way to; near that it goes fast.

    Args:
        joints, speeds: ``(B, J, 3)`` of the motion. share, rate: ``(B,)``, and its derivative [1/s].
        stance, links, bones: ``upright()``, ``chain()`` and ``BONES``, arrays or tensors as the others are.
    """
    xp, share, rate = array_namespace(joints), share[:, None, None], rate[:, None, None]
    lines, changes = (part[:, bones[0]] - part[:, bones[1]] for part in (joints, speeds))
    danced, turning, length, growth = _direction(lines, changes)
    angle, spin = heading(joints, speeds)
    cos, sin = xp.cos(angle)[:, None], xp.sin(angle)[:, None]
    x, y, z = stance[:, 0], stance[:, 1], stance[:, 2]
    ahead, aside = cos * x - sin * y, sin * x + cos * y
    still = xp.zeros_like(ahead)
    stood = xp.stack([ahead, aside, still + z], axis=2)
    swept = spin[:, None, None] * xp.stack([-aside, ahead, still], axis=2)
    apart = danced - stood
    mixed, changing, _, _ = _direction(stood + share * apart, swept + share * (turning - swept) + rate * apart)
    placed = links @ xp.concat([length * mixed, growth * mixed + length * changing], axis=2)
    return joints[:, :1] + placed[:, :, :3], speeds[:, :1] + placed[:, :, 3:]


def check_entry(motion: Motion, seconds: float, which: str) -> None:
    """Refuse a motion into whose first ``seconds`` who stands can't go over: bones would jump.

    Raises:
        ValueError: the hips face up or down, or a bone lies opposite to where it is upright; says when.
    """
    times = np.append(np.arange(0.0, min(seconds, motion.duration), 0.5 / motion.fps), min(seconds, motion.duration))
    joints, speeds = motion.at(times)
    none = np.zeros(len(times))
    stood, _ = enter(joints, speeds, none, none, upright(), chain(), BONES)
    left, spine = (joints[:, a] - joints[:, b] for a, b in (body.HIPS[::-1], (body.TORSO, body.PELVIS)))
    forward = np.cross(left, spine)
    level = np.linalg.norm(forward[:, :2], axis=1) / np.linalg.norm(forward, axis=1)
    lines, before = (part[:, BONES[0]] - part[:, BONES[1]] for part in (joints, stood))
    alike = ((lines * before).sum(2) / np.square(lines).sum(2)).min(1)
    for least, found, what in ((LEVEL, level, "the hips face up or down"), (OPPOSED, alike, "a limb is upside down")):
        if found.min() < least:
            raise ValueError(
                f"{which} begins where who stands can't go over into it: {what} at {times[found.argmin()]:.2f} s; "
                f"its first {seconds:.2f} s should be upright, so store a later part of it"
            )


def heading(joints: np.ndarray, speeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The angle from x to where the hips of ``joints`` ``(B, J, 3)`` face, ``(B,)`` [rad], and its rate [rad/s]."""
    cross = array_namespace(joints).linalg.cross
    (left, spine), (swung, leant) = (
        (part[:, body.HIPS[1]] - part[:, body.HIPS[0]], part[:, body.TORSO] - part[:, body.PELVIS])
        for part in (joints, speeds)
    )
    return level_angle(cross(left, spine), cross(swung, spine) + cross(left, leant))


def level_angle(line: np.ndarray, speed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The angle from x to level lines ``(B, 3)`` [rad], and the rate at which it grows as they change by ``speed``."""
    x, y = line[:, 0], line[:, 1]
    return array_namespace(line).atan2(y, x), (x * speed[:, 1] - y * speed[:, 0]) / (x * x + y * y + 1e-12)


def _direction(lines: np.ndarray, changes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Directions and lengths of lines ``(B, N, 3)``, each with its rate: direction, rate, length, rate."""
    xp = array_namespace(lines)
    length = xp.sqrt(xp.linalg.vecdot(lines, lines))[:, :, None]
    over = 1.0 / (length + (length == 0.0))
    along = over * lines
    growth = xp.linalg.vecdot(along, changes)[:, :, None]
    return along, over * (changes - growth * along), length, growth
