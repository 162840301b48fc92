"""A ball that moves along a path by itself; the action moves it away from there."""

from abc import abstractmethod

import numpy as np
from array_api_compat import array_namespace

from cloth_envs.scene import Scene
from cloth_envs.scenes.drives import Drive
from cloth_envs.scenes.task import Episode, Task
from cloth_envs.state import Controls

REACH, SPEED, ACCELERATION = 0.3, 1.2, 12.0  # m, m/s, m/s^2: of the action, away from the path along each axis


class BallPath(Task):
    """A scene whose first body is a ball on a path, with which zero actions leave it."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self.roam()

    def roam(self, rise: float = REACH) -> None:
        """Let actions move the ball ``REACH`` from its path at most, but up by no more than ``rise`` [m]."""
        low, high = [-REACH] * 3, [REACH, REACH, min(REACH, rise)]
        self.drive = Drive(low, high, speed=SPEED, acceleration=ACCELERATION, dt=self.frame_dt)

    @abstractmethod
    def path(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the ball would be at ``time`` ``(B,)`` and how fast, ``(B, 3)`` [m] and [m/s]."""

    def controls(self, episode: Episode) -> Controls:
        state = episode.state
        (place, speed), (next_place, next_speed) = self.path(state.time), self.path(state.time + self.frame_dt)
        off, drift = state.colliders[:, 0, 0] - place, state.collider_velocities[:, 0, 0] - speed
        moved, reached = self.drive(off, drift, episode.action)
        controls = self.hold(episode)
        controls.colliders[:] = (next_place + off + moved)[:, None, None]
        controls.collider_velocities[:] = (next_speed + reached)[:, None, None]
        return controls


def to_and_fro(time: np.ndarray, ends: tuple[float, float], period: float) -> tuple[np.ndarray, np.ndarray]:
    """Place [m] and velocity [m/s] at ``time`` [s] of what swings between ``ends`` [m], from the first of them."""
    xp, rate = array_namespace(time), 2 * np.pi / period
    middle, reach = (ends[0] + ends[1]) / 2, (ends[1] - ends[0]) / 2
    return middle - reach * xp.cos(rate * time), reach * rate * xp.sin(rate * time)
