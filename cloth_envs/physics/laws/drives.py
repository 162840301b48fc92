"""How handles and bodies move through a frame, in plain NumPy: the twin of ``kernels/sheet/drives.hpp``."""

import numpy as np

from cloth_envs.physics.laws.sheet import flat
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State


def hermite(
    s: float, frame: float, x0: np.ndarray, v0: np.ndarray, x1: np.ndarray, v1: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity at ``s`` in [0, 1] of the cubic from ``x0, v0`` to ``x1, v1`` in ``frame`` [s]."""
    x = (1 + 2 * s) * (1 - s) ** 2 * x0 + s * s * (3 - 2 * s) * x1
    x = x + frame * s * (1 - s) * ((1 - s) * v0 - s * v1)
    v = 6 * s * (1 - s) * (x1 - x0) / frame + (1 - s) * (1 - 3 * s) * v0 + s * (3 * s - 2) * v1
    return x, v


def bodies_at(scene: Scene, old: State, controls: Controls, s: float) -> tuple[np.ndarray, np.ndarray]:
    """Bodies and their velocities ``(B, C, 2, 3)`` at ``s`` in [0, 1] of the frame from ``old``."""
    x1, v1 = controls.colliders, controls.collider_velocities
    return hermite(s, scene.frame_dt, old.colliders, old.collider_velocities, x1, v1)


def handle_starts(scene: Scene, x: np.ndarray, v: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the paths of handles that end at ``ends`` ``(..., N, 3)`` begin, and their velocities, of the same shape.

    ``x`` and ``v`` are the handles' own. A firm one's path begins where it is; a soft one's where it would
    be, had it moved with its lead alone.
    """
    holding = scene.holding
    lead = np.where(holding.firm, np.arange(len(holding.lead)), holding.lead)
    return x[..., lead, :] + (ends - ends[..., lead, :]), v[..., lead, :]


def _handles(
    scene: Scene, old: State, now: State, controls: Controls, s: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions and velocities of the handles of ``now``, and of their paths at ``s``, ``(B, N, 3)``."""
    handles = list(scene.handles)
    x0, v0, x, v = (
        flat(field)[..., handles].transpose(0, 2, 1)
        for field in (old.positions, old.velocities, now.positions, now.velocities)
    )
    ends = controls.handle_positions
    path, speed = hermite(s, scene.frame_dt, *handle_starts(scene, x0, v0, ends), ends, controls.handle_velocities)
    return x, v, path, speed


def _rate(scene: Scene, stiffness: np.ndarray) -> np.ndarray:
    """Of the springs of soft handles, ``(B, N, 3)`` [1/s^2]; 0 of firm ones."""
    return np.where(scene.holding.firm[:, None], 0.0, scene.holding.hold) * stiffness[:, None, None]


def put_handles(
    scene: Scene, old: State, now: State, controls: Controls, s: float, stiffness: np.ndarray, h: float
) -> None:
    """Move the handles of ``now`` to ``s`` in [0, 1] of the frame from ``old``, at the end of a step of ``h`` [s].

    A firm one gets the place and velocity of its path. A soft one is drawn there by a spring of ``rate = hold *
    stiffness`` [1/s^2], ``stiffness`` ``(B,)`` [m^2/s^2] the cloth's stretch stiffness over its areal density:
    ``x += e``, ``v += e / h`` with ``e = h^2 rate / (1 + h^2 rate) (path - x)``, implicit in the spring; nothing where
    ``h`` is 0.
    """
    firm, rate = scene.holding.firm[:, None], _rate(scene, stiffness)
    x, v, path, speed = _handles(scene, old, now, controls, s)
    drawn = h * rate / (1 + h * h * rate) * (path - x)
    for array, value in (
        (now.positions, np.where(firm, path, x + h * drawn)),
        (now.velocities, np.where(firm, speed, v + drawn)),
    ):
        array.reshape(len(array), 3, -1)[..., list(scene.handles)] = value.transpose(0, 2, 1)


def pull_handles(
    scene: Scene, old: State, now: State, controls: Controls, s: float, stiffness: np.ndarray, dt: float
) -> None:
    """Add to the soft handles' velocities what their springs do in ``dt`` [s] where they are at ``s`` of the frame.

    ``v += dt rate (path - x)``; the rest is as in ``put_handles``.
    """
    x, v, path, _ = _handles(scene, old, now, controls, s)
    pulled = v + dt * _rate(scene, stiffness) * (path - x)
    now.velocities.reshape(len(v), 3, -1)[..., list(scene.handles)] = pulled.transpose(0, 2, 1)
