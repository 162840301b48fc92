"""What actions and gusts become: how handles and bodies move through a frame, and what blows.

Positions depend on the bits of these numbers, so the sources agree with what runs to rounding only. Arrays are NumPy's,
or tensors of one device.
"""

from collections.abc import Sequence

import numpy as np
from array_api_compat import array_namespace, device

from cloth_envs.scenes.compiled import compiled
from cloth_envs.scenes.starts import between

GUST_TONES = 4


@compiled  # 6 us
def clip_actions(actions: np.ndarray, /) -> np.ndarray | None:
    """Actions ``(B, A)`` clipped to [-1, 1], or None if one is not finite."""
    xp = array_namespace(actions)
    return actions.clip(-1.0, 1.0) if xp.all(xp.isfinite(actions)) else None


@compiled  # 4 us
def tick(frames: np.ndarray, dt: float, time: np.ndarray, /) -> None:
    """Count one frame more, and write the ``time`` [s] at which it ends: sums of many ``dt`` would drift; ``(B,)``."""
    xp = array_namespace(time)
    frames += 1
    time[:] = xp.astype(frames, xp.float64) * dt


@compiled  # 6 us
def hold(positions: np.ndarray, handles: np.ndarray, colliders: np.ndarray, /) -> tuple[np.ndarray, ...]:
    """The fields of ``Controls`` that bring every handle and body to rest where it is now, without wind or pressure."""
    xp, batch = array_namespace(positions), len(positions)
    vertices = xp.permute_dims(positions.reshape(batch, 3, -1), (0, 2, 1))
    at, bodies = (xp.astype(part, xp.float64) for part in (vertices[:, handles], colliders))
    wind, pressure = (xp.zeros(shape, dtype=xp.float64, device=device(at)) for shape in ((batch, 3), batch))
    return at, xp.zeros_like(at), bodies, xp.zeros_like(bodies), wind, pressure


@compiled  # 11 us
def drive(
    position: np.ndarray,
    velocity: np.ndarray,
    action: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    speed: np.ndarray,
    change: float,
    brake: float,
    dt: float,
    /,
) -> tuple[np.ndarray, np.ndarray]:
    """How far a driven thing moves in a frame, and its velocity at the end, ``(B, n)`` each; see ``Drive``."""
    xp = array_namespace(position)
    at, now = xp.astype(position, xp.float64), xp.astype(velocity, xp.float64)
    slowest, fastest = ((low - at) / brake).clip(max=0.0), ((high - at) / brake).clip(0.0)
    wanted = (action * speed).clip(slowest, fastest)
    reached = wanted.clip(now - change, now + change)
    return 0.5 * dt * (now + reached), reached


@compiled  # 7 us
def carry(
    handles: np.ndarray, velocities: np.ndarray, moved: np.ndarray, reached: np.ndarray, share: np.ndarray, /
) -> None:
    """Move handles ``(B, N, 3)`` in place by ``share`` ``(N, n)`` of how far and fast something moves, ``(B, n)``."""
    for driven, by in ((handles, moved), (velocities, reached)):
        part = driven[:, :, : share.shape[1]]  # a view
        part += by[:, None] * share


@compiled  # 6 us
def push(bodies: np.ndarray, velocities: np.ndarray, moved: np.ndarray, reached: np.ndarray, /) -> None:
    """Move the first body of ``(B, C, 2, 3)`` in place by how far and fast it is driven along its axes, ``(B, n)``."""
    for driven, by in ((bodies, moved), (velocities, reached)):
        part = driven[:, 0, :, : by.shape[1]]  # a view
        part += by[:, None]


@compiled  # 3 us
def pump(pressure: np.ndarray, action: np.ndarray, full: float, share: float, /) -> np.ndarray:
    """``pressure`` ``(B,)`` a ``share`` of the way nearer to what the action ``(B,)`` asks for, ``full`` [Pa] at 1."""
    return pressure + share * (full * action - pressure)


class Drive:
    """Moves something by an action: a wanted velocity, limited acceleration, a box it can't leave.

    The velocity ramps linearly through a frame and changes by at most ``acceleration * dt``. The speed
    towards a side of the box is at most the distance to it over ``BRAKE``, so it slows down in time.

    Args:
        low, high: the box [m], ``n`` numbers. speed: at full action [m/s], one or ``n`` numbers.
        acceleration: [m/s^2]; at least ``speed / BRAKE``. dt: frame [s].
    """

    BRAKE = 0.1  # s

    def __init__(
        self,
        low: Sequence[float],
        high: Sequence[float],
        *,
        speed: float | Sequence[float],
        acceleration: float,
        dt: float,
    ) -> None:
        self.low, self.high = np.array(low, float), np.array(high, float)
        self.speed = np.zeros(len(low)) + speed
        self.change, self.dt = acceleration * dt, dt

    def __call__(self, position: np.ndarray, velocity: np.ndarray, action: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far it moves in the frame [m] and its velocity at the end [m/s]; all arrays ``(B, n)``."""
        return drive(position, velocity, action, self.low, self.high, self.speed, self.change, self.BRAKE, self.dt)


def draw_gust(rng: np.random.Generator, signals: int = 1) -> np.ndarray:
    """Frequencies [rad/s] and phases of independent signals, ``(2, signals, GUST_TONES)``."""
    return tones_of(rng.random((1, 2 * signals * GUST_TONES)))[0]


def tones_of(even: np.ndarray) -> np.ndarray:
    """The same of numbers that are even in [0, 1), ``(B, 2 * signals * GUST_TONES)``, for B members."""
    xp, parts = array_namespace(even), even.reshape(len(even), 2, -1, GUST_TONES)
    return xp.stack([2 * np.pi * between(parts[:, 0], 0.15, 1.2), between(parts[:, 1], 0.0, 2 * np.pi)], axis=1)


@compiled  # 8 us a call
def gust(tones: np.ndarray, time: np.ndarray, /) -> np.ndarray:
    """Smooth signals in [-1, 1] at ``time`` ``(B, K)``, means of the sines ``tones`` ``(B, 2, S, N)``.

    As many as the larger of ``S`` and ``K``, of which one may be 1.
    """
    xp = array_namespace(tones)
    return xp.sin(tones[:, 0] * time[:, :, None] + tones[:, 1]).mean(2)


@compiled  # 22 us
def gusty_wind(
    tones: np.ndarray, time: np.ndarray, speed: np.ndarray, heading: np.ndarray, swell: float, turn: float, /
) -> np.ndarray:
    """A level wind, ``(B, 3)`` [m/s]: one gust changes its ``speed`` by up to ``swell`` of it, one its ``heading``.

    ``tones`` are two signals of ``draw_gust``; ``time``, ``speed`` [m/s] and ``heading`` [rad] are ``(B,)``, ``turn``
    is in radians.
    """
    xp = array_namespace(tones)
    gusts = xp.sin(tones[:, 0] * time[:, None, None] + tones[:, 1]).mean(2)
    strength, angle = speed * (1.0 + swell * gusts[:, 0]), heading + turn * gusts[:, 1]
    return xp.stack([strength * xp.cos(angle), strength * xp.sin(angle), xp.zeros_like(angle)], axis=1)
