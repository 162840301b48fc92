"""Draping: a tablecloth that is held at one point of its upper edge falls, swings and is brought to rest."""

from typing import ClassVar

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.grip import Grip, held
from cloth_envs.marks import Mark, dot, ghost, line
from cloth_envs.material import Material
from cloth_envs.scene import Air, Scene, SelfContact
from cloth_envs.scenes.drives import Drive
from cloth_envs.scenes.measures import columns, length, tolerance, within
from cloth_envs.scenes.starts import rotation
from cloth_envs.scenes.task import Episode, Start, Task, documented
from cloth_envs.state import Controls

GRIP = 0.069  # m, radius of what holds the edge: as much cloth as 5 x 5 cm
SPEED, ACCELERATION = 1.2, 12.0  # m/s of the held point at full action, m/s^2
LOW, HIGH = (-1.0, -1.0, -0.4), (1.0, 1.0, 0.4)  # m, box of the held point
GOAL_LOW, GOAL_HIGH = (-0.8, -0.8, -0.3), (0.8, 0.8, 0.3)  # m, held point above the goal
HANG = 0.63  # m, depth of the cloth's middle below the held point when it hangs at rest
TILT = 0.35 * np.pi  # rad, most that the starting cloth is let down from level
WAVE = 0.02  # m, largest starting waves
PLACE_MARGIN, CALM_MARGIN = 0.5, 1.0  # m, m/s
NEAR = within(PLACE_MARGIN)  # m, distance of the goal that is near enough


@documented
class Draping(Task):
    """
    ## Description
    A tablecloth of 1 x 1 m is held by as much cloth as 5 x 5 cm of its upper edge, a quarter of the way along it, and
    let go of otherwise: it falls and swings. Carry the held point so that the middle of the cloth comes to rest at a
    goal.

    ## Action Space
    `Box(-1, 1, (3,))`: velocity of the held point, +-1 is 1.2 m/s along x, y, z. It stays within 1 m (x, y) and 0.4 m
    (z) of where it started.

    ## Observation Space
    `obs="keypoints"`: positions, then velocities of a 5 x 5 lattice of vertices (75 + 75 numbers), then the held
    point's position and velocity, the middle's position and velocity (mean of the keypoints), the goal.

    ## Rewards
    `tolerance(distance of middle to goal, 0.5 m) * (1 + 3 * tolerance(speed, 1 m/s)) / 4`, in [0, 1]; speed is the
    root-mean-square speed of the keypoints.

    ## Starting State
    Spread out with small waves, from level to 63 degrees down from its upper edge, turned at random, at rest. The goal
    is random.

    ## What Is Modelled
    Springs, damping, bending, gravity, still air, contact and friction of the cloth with itself.

    ## Version 1
    Before the extras also the way from the middle to the goal, and the speed.
    """

    size = (1.0, 1.0)
    resolution = (65, 65)
    frame_dt = 0.04
    actions = ("held point's velocity x", "held point's velocity y", "held point's velocity z")
    lattice = (5, 5)
    extras = (
        *("held x", "held y", "held z", "held vx", "held vy", "held vz"),
        *("middle x", "middle y", "middle z", "middle vx", "middle vy", "middle vz"),
        *("goal x", "goal y", "goal z"),
    )
    extras_bound = 50.0
    parts = ("place", "calm")
    away = "of the middle from the goal [m]"
    ways = ("to goal x", "to goal y", "to goal z", "speed")
    held: ClassVar[float] = 0.25  # place of the held point along the upper edge, of its length

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self.drive = Drive(LOW, HIGH, speed=SPEED, acceleration=ACCELERATION, dt=self.frame_dt)
        self.follow = np.ones((len(self.handles), 3))
        self.point = scene.pins[0]
        self.watch(self.point)

    @classmethod
    def build_scene(cls, grid: Grid, material: Material) -> Scene:
        grips = (Grip((0.0, cls.held * grid.width), GRIP),)
        return Scene(
            *("Draping", grid, material, cls.frame_dt),
            handles=held(grid, grips),
            grips=grips,
            air=Air(),
            self_contact=SelfContact(),
        )

    def start(self, rng: np.random.Generator) -> Start:
        positions = self.spread(rng)
        memory = {"goal": rng.uniform(GOAL_LOW, GOAL_HIGH) - [0.0, 0.0, HANG]}
        return Start(positions, np.zeros_like(positions), np.zeros((0, 2, 3)), memory)

    def spread(self, rng: np.random.Generator) -> np.ndarray:
        """A gently waved sheet, let down from level, turned at random, the held point at the origin; ``(3, H, W)``."""
        grid = self.scene.grid
        v, u = np.meshgrid(*(np.linspace(0.0, s, n) for s, n in zip(self.size, grid.shape, strict=True)), indexing="ij")
        phase = rng.uniform(-np.pi, np.pi, 2)
        wave = rng.uniform(0, WAVE) * np.cos(2 * np.pi * u + phase[0]) * np.cos(2 * np.pi * v + phase[1])
        sheet = np.stack([u, -v, wave]).reshape(3, -1)
        sheet -= sheet[:, self.point : self.point + 1]
        yaw, tilt = rotation(rng.uniform(-np.pi, np.pi, 1), 0, 1)[0], rotation(rng.uniform(0.0, TILT, 1), 1, 2)[0]
        return (yaw @ tilt @ sheet).reshape(3, *grid.shape)

    def controls(self, episode: Episode) -> Controls:
        return self.carry(episode, *self.held_point(episode), self.follow)

    def held_point(self, episode: Episode) -> tuple[np.ndarray, np.ndarray]:
        """Its position [m] and velocity [m/s], ``(B, 3)`` each."""
        return episode.cloth[:, :, self.point], episode.cloth_velocity[:, :, self.point]

    def marks(self, episode: Episode, member: int) -> list[Mark]:
        middle, goal = self.middle(episode)[member], episode.memory["goal"][member]
        return [line(middle, goal), ghost(goal, NEAR), dot(middle)]

    def observe(self, episode: Episode) -> np.ndarray:
        middle = self.middle(episode), self.middle_velocity(episode)
        return columns(*self.held_point(episode), *middle, episode.memory["goal"])

    def way(self, episode: Episode) -> np.ndarray:
        return columns(episode.memory["goal"] - self.middle(episode), self.speed(episode))

    def score(self, episode: Episode) -> tuple[np.ndarray, ...]:
        off = self.middle(episode) - episode.memory["goal"]
        return length(off), tolerance(off, PLACE_MARGIN), tolerance(self.speed(episode), CALM_MARGIN, 0.25)
