"""How joints move: positions that pass smoothly through those of frames, from a recording or made."""

from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np
from array_api_compat import array_namespace
from scipy.interpolate import CubicSpline

from cloth_envs.figure.skeleton import JOINTS
from cloth_envs.naming import unknown_name


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
    ``joint_names``, which must hold those of ``JOINTS``.

    Raises:
        ValueError: no such motion (the nearest match is named), or one that lacks something or has another form.
        OSError: no file, or no HDF5.
    """
    with h5py.File(path, "r") as file:
        if name not in file:
            raise unknown_name(f"motion in {path}:", name, list(file))
        group = file[name]
        lacks = [part for part in ("fps", "joint_names") if part not in group.attrs]
        if lacks or "positions" not in group:
            raise ValueError(f"motion {name!r} in {path} lacks {', '.join(lacks) or 'positions'}: see read_motion")
        positions, names = group["positions"][:].astype(float), _texts(group.attrs["joint_names"])
        fps = float(group.attrs["fps"])
    absent = [joint for joint in JOINTS if joint not in names]
    if absent:
        raise ValueError(f"motion {name!r} in {path} has no {', '.join(absent)}: joints are named {', '.join(JOINTS)}")
    if positions.ndim != 3 or positions.shape[1:] != (len(names), 3) or len(positions) < 4 or not fps > 0:
        raise ValueError(
            f"motion {name!r} in {path} must have positions (F, {len(names)}, 3), F at least 4, and a rate"
        )
    if not np.isfinite(positions).all():
        raise ValueError(f"motion {name!r} in {path} has positions that are not finite")
    return Motion(positions[:, [names.index(joint) for joint in JOINTS]], fps)


def _texts(values: Sequence[str | bytes]) -> list[str]:
    return [value.decode() if isinstance(value, bytes) else str(value) for value in values]
