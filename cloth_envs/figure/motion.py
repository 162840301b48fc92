"""How joints move: positions that pass smoothly through those of frames, from a recording or made."""

from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np
from array_api_compat import array_namespace
from scipy.interpolate import CubicSpline

from cloth_envs.figure.skeleton import JOINTS
from cloth_envs.naming import unknown_name

LEAST, MOST = 0.03, 1.0  # m, of a person's hips and lower spine, a child's or a giant's
ACROSS = 0.1  # sine of the angle between them, at least
FEWEST = 4  # frames of a recording


class Motion:
    """Joint positions at any time, in NumPy or in tensors: cubic splines through frames, of continuous acceleration.

    Args:
        positions: ``(F, J, 3)`` [m], z up, the joints in the order of ``JOINTS``.
        fps: frames a second. loops: the last frame is the first again; else it begins and ends at rest, and what comes
            before and after is its first and last pose.
    """

    def __init__(self, positions: np.ndarray, fps: float, *, loops: bool = False) -> None:
        self.fps, self.loops, self.duration = fps, loops, (len(positions) - 1) / fps
        times = np.arange(len(positions)) / fps
        ends = "periodic" if loops else "clamped"
        self.pieces: np.ndarray = CubicSpline(times, np.asarray(positions, float), bc_type=ends).c

    def at(self, time: np.ndarray, pieces: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Positions [m] and velocities [m/s] ``(B, J, 3)`` at ``time`` ``(B,)`` [s].

        For tensors ``pieces`` is the attribute ``(4, F - 1, J, 3)``, coefficients from the cubes' on, on their device.
        """
        pieces, xp = self.pieces if pieces is None else pieces, array_namespace(time)
        count, frame = pieces.shape[1], time * self.fps
        frame = frame - count * xp.floor(frame / count) if self.loops else frame.clip(0.0, count)
        piece = xp.astype(frame, xp.int64).clip(0, count - 1)
        a, b, c, d = (part[piece] for part in pieces)
        s = ((frame - piece) / self.fps)[:, None, None]
        return ((a * s + b) * s + c) * s + d, (3 * a * s + 2 * b) * s + c


def read_motion(path: str | Path, name: str) -> Motion:
    """One motion of a file of recorded ones.

    The file is HDF5: a group for each motion with ``positions`` ``(F, J, 3)`` [m], z up, and the attributes ``fps`` and
    ``joint_names``, which must hold those of ``JOINTS``. Where it holds each frame several times, as one of 30 a second
    stored as 60, each counts once, at a rate that much lower: the motion would stop at every one.

    Raises:
        ValueError: no such motion (the nearest match is named), or one that lacks something, has another form or is
            of no person.
        OSError: no file, or no HDF5.
    """
    with h5py.File(path, "r") as file:
        if name not in file:
            raise unknown_name(f"motion in {path}:", name, list(file))
        group, which = file[name], f"motion {name!r} in {path}"
        lacks = [part for part in ("fps", "joint_names") if part not in group.attrs]
        positions = group.get("positions") if isinstance(group, h5py.Group) else None
        if lacks or not isinstance(positions, h5py.Dataset):
            raise ValueError(f"{which} lacks {', '.join(lacks) or 'positions'}: see read_motion")
        names, rate = _texts(group.attrs["joint_names"]), np.asarray(group.attrs["fps"])
        absent = [joint for joint in JOINTS if joint not in names]
        if absent:
            raise ValueError(f"{which} has no {', '.join(absent)}: joints are named {', '.join(JOINTS)}")
        form = positions.ndim == 3 and positions.shape[1:] == (len(names), 3) and len(positions) >= FEWEST
        if not form or positions.dtype.kind not in "fiu" or rate.dtype.kind not in "fiu" or rate.size != 1:
            raise ValueError(
                f"{which} must have positions (F, {len(names)}, 3), F at least {FEWEST}, and a rate, all numbers"
            )
        frames, fps = positions[:].astype(float)[:, [names.index(joint) for joint in JOINTS]], float(rate.item())
    if not 0 < fps < np.inf:
        raise ValueError(f"{which} must have a rate above 0, got fps {fps:g}")
    _check_person(frames, which)
    held = max(1, int(np.gcd.reduce(1 + np.flatnonzero(np.diff(frames, axis=0).any((1, 2))))))  # how often there
    once = frames[::held]
    return Motion(once, fps / held) if len(once) >= 4 else Motion(frames, fps)


def _check_person(joints: np.ndarray, which: str) -> None:
    """Refuse joints ``(F, J, 3)`` between which no skirt can hang. Raises ValueError: says what is wrong."""
    if not np.isfinite(joints).all():
        raise ValueError(f"{which} has positions that are not finite")
    right, left, pelvis, torso = (joints[:, JOINTS.index(n)] for n in ("right_thigh", "left_thigh", "pelvis", "torso"))
    hips, spine = left - right, torso - pelvis
    wide, long = np.linalg.norm(hips, axis=1), np.linalg.norm(spine, axis=1)
    for what, size in (("between its thighs", wide), ("from pelvis to torso", long)):
        if size.min() < LEAST or size.max() > MOST:
            raise ValueError(
                f"{which} has {size.min():.3g} to {size.max():.3g} m {what}, of a person {LEAST:g} to {MOST:g}: "
                "positions are in metres"
            )
    if (np.linalg.norm(np.cross(hips, spine), axis=1) < ACROSS * wide * long).any():
        raise ValueError(f"{which} has a spine along the line between the thighs: joints may be named wrongly")


def _texts(values: Sequence[str | bytes]) -> list[str]:
    return [value.decode() if isinstance(value, bytes) else str(value) for value in np.atleast_1d(values)]
