"""Flag: a flag in gusty wind whose pole moves."""

from __future__ import annotations

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.scene import Scene, Wind
from cloth_envs.scenes.task import Episode, Start, Task, draw_gust, drive, gust
from cloth_envs.state import Controls

POLE_SPEED = 2.0  # m/s at full action
REACH = 1.0  # m, the pole stays within this of its foot
WIND_SPEED = (1.5, 3.5)  # m/s, range of the mean wind
GUST = 0.5  # of the mean
BACKING = 0.4  # rad, how far gusts turn the wind


class Flag(Task):
    """
    ## Description
    A flag of 1.5 x 1.0 m flies from an upright pole in a light, gusty wind. The pole can be walked
    about on the ground. Keep the flag spread out towards an onlooker.

    ## Action Space
    `Box(-1, 1, (2,))`: velocity of the pole along x and y, +-1 is 2 m/s. The pole stays in a square of
    +-1 m.

    ## Observation Space
    `obs="keypoints"`: positions, then velocities of a 4 x 5 lattice of vertices (60 + 60 numbers), then
    the pole's x, y and its velocity, the wind's x, y and the onlooker's direction x, y.
    `obs="mesh"`: the geometry image and the same extras.

    ## Rewards
    Area of the flag projected along the direction to the onlooker, over its rest area, in [0, 1].

    ## Starting State
    The flag is spread downwind with small random waves. Mean wind (1.5-3.5 m/s), gusts, their turning
    and the onlooker's direction are random.

    ## Episode End
    Truncated after 200 frames (8 s). Terminated when the simulation fails (`info["failure"]`).

    ## Arguments
    `backend`, `backend_kwargs`, `obs`, `material`, `randomize`, `resolution`, `render_mode`: see `ClothEnv`.

    ## What Is Modelled
    Springs, damping, bending, gravity, wind on triangles, the pole. No drag by still air, no
    self-contact: folds of the flag can pass through each other.

    ## Version History
    v0: first version.
    """

    size = (1.0, 1.5)
    resolution = (33, 49)
    frame_dt = 0.04
    actions = ("pole velocity x", "pole velocity y")
    lattice = (4, 5)
    extras = ("pole x", "pole y", "pole vx", "pole vy", "wind x", "wind y", "onlooker x", "onlooker y")
    extras_bound = 20.0

    @classmethod
    def build_scene(cls, grid: Grid, material: Material) -> Scene:
        hoist = tuple(grid.index(row, 0) for row in range(grid.rows))
        return Scene("Flag", grid, material, cls.frame_dt, handles=hoist, drag=False, wind=Wind())

    def start(self, rng: np.random.Generator) -> Start:
        grid = self.scene.grid
        heading, speed = rng.uniform(-np.pi, np.pi), rng.uniform(*WIND_SPEED)
        aside = heading + rng.choice([-1.0, 1.0]) * rng.uniform(np.pi / 6, np.pi / 2)
        u = np.linspace(0.0, grid.width, grid.cols)
        # Slope angle along the flag: integrating unit steps keeps the edges at their rest length.
        turn = 0.25 * np.sin(2 * np.pi * (u / grid.width + rng.uniform())) * u / grid.width
        along = heading + turn
        step = grid.col_spacing * np.stack([np.cos(along), np.sin(along)])
        path = np.concatenate([np.zeros((2, 1)), np.cumsum(step[:, :-1], 1)], 1)
        z = -np.linspace(0.0, grid.height, grid.rows)
        positions = np.empty((3, *grid.shape))
        positions[:2] = path[:, None, :]
        positions[2] = z[:, None]
        memory = {
            "heading": np.array(heading),
            "speed": np.array(speed),
            "onlooker": np.array([np.cos(aside), np.sin(aside)]),
            "gust": draw_gust(rng),
            "backing": draw_gust(rng),
        }
        return Start(positions, np.zeros_like(positions), np.zeros((0, 2, 3)), memory)

    def wind(self, episode: Episode) -> np.ndarray:
        """The wind now, ``(B, 3)`` [m/s]."""
        memory, time = episode.memory, episode.state.time
        speed = memory["speed"] * (1 + GUST * gust(memory["gust"], time))
        heading = memory["heading"] + BACKING * gust(memory["backing"], time)
        return np.stack([speed * np.cos(heading), speed * np.sin(heading), np.zeros_like(speed)], 1)

    def controls(self, episode: Episode) -> Controls:
        controls = Controls.hold(episode.state, self.scene.handles)
        foot = controls.handle_positions[:, 0, :2]
        velocity = episode.state.velocities[:, :2, 0, 0]
        reached, speed = drive(
            foot, velocity, POLE_SPEED * episode.action, low=-REACH, high=REACH, dt=self.frame_dt
        )
        controls.handle_positions[:, :, :2] = reached[:, None]
        controls.handle_velocities[:, :, :2] = speed[:, None]
        controls.wind = self.wind(episode)
        return controls

    def observe(self, episode: Episode) -> np.ndarray:
        state = episode.state
        pole = [state.positions[:, :2, 0, 0], state.velocities[:, :2, 0, 0]]
        return np.concatenate([*pole, state.wind[:, :2], episode.memory["onlooker"]], 1)

    def reward(self, episode: Episode) -> np.ndarray:
        x = episode.state.positions
        diagonal, other = x[:, :, 1:, 1:] - x[:, :, :-1, :-1], x[:, :, :-1, 1:] - x[:, :, 1:, :-1]
        # Horizontal area vector of every cell, half the cross product of its diagonals.
        nx = diagonal[:, 1] * other[:, 2] - diagonal[:, 2] * other[:, 1]
        ny = diagonal[:, 2] * other[:, 0] - diagonal[:, 0] * other[:, 2]
        towards = episode.memory["onlooker"][:, :, None, None]
        shown = 0.5 * np.abs(nx * towards[:, 0] + ny * towards[:, 1]).sum((1, 2))
        return np.minimum(shown / (self.scene.grid.height * self.scene.grid.width), 1.0)
