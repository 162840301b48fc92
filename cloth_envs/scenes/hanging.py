"""Hanging: a cloth held by one corner is carried to a place and brought to rest."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from array_api_compat import array_namespace

from cloth_envs.grid import Grid
from cloth_envs.grip import Grip, held
from cloth_envs.marks import Mark, dot, ghost, line
from cloth_envs.material import Material
from cloth_envs.scene import Air, Scene, SelfContact
from cloth_envs.scenes.drives import GUST_TONES, Drive, gust, tones_of
from cloth_envs.scenes.measures import broad_tolerance, columns, length, tolerance, within
from cloth_envs.scenes.starts import between, rotation
from cloth_envs.scenes.task import Episode, Start, Task, documented
from cloth_envs.state import Controls

GRIP = 0.098  # m, radius of what holds the corner: as much cloth as 5 cm along both sides
SPEED, ACCELERATION = 1.0, 10.0  # m/s of the corner at full action, m/s^2
LOW, HIGH = (-0.8, -0.8, -0.4), (0.8, 0.8, 0.4)  # m, box of the corner
GOAL_LOW, GOAL_HIGH = (-0.6, -0.6, -0.2), (0.6, 0.6, 0.2)  # m, corner above the goal
HANG = 0.79  # m, depth of the cloth's middle below the corner when it hangs at rest
BREEZE = 0.15  # Pa, a twelfth of the cloth's weight
WRAP = (0.6, 0.85)  # of a full turn, how far the starting cone closes
EDGE_TURN = 1.4  # of the cone's sine times the cells along a side: edges of few cells would be chords of a narrow one
SWING = 1.0  # rad/s, largest starting rate of swinging
PLACE_MARGIN, CALM_MARGIN = 0.5, 1.0  # m, m/s
FAR_MARGIN, NEAR_MARGIN, REST_MARGIN = 1.0, 0.25, 0.5  # m, m, m/s, of version 1
NEAR, NEARER = within(PLACE_MARGIN), 0.075  # m, distances of the goal that are near enough in versions 0 and 1


@documented
class Hanging(Task):
    """
    ## Description
    A cloth of 1 x 1 m, held by as much of one corner as 5 x 5 cm, hangs in a light random breeze. Carry the corner so
    that the middle of the cloth comes to rest at a goal.

    ## Action Space
    `Box(-1, 1, (3,))`: velocity of the corner, +-1 is 1 m/s along x, y, z. The corner stays within 0.8 m
    (x, y) and 0.4 m (z) of where it started.

    ## Observation Space
    `obs="keypoints"`: positions, then velocities of a 4 x 4 lattice of vertices (48 + 48 numbers), then the
    corner's position and velocity, the middle's position and velocity (mean of the keypoints), the goal, the breeze.

    ## Rewards
    `tolerance(distance of middle to goal, 0.5 m) * (1 + 3 * tolerance(speed, 1 m/s)) / 4`, in [0, 1]; speed is the
    root-mean-square speed of the keypoints.

    ## Starting State
    The cloth is wrapped on a cone below its corner, at rest length, turned at random and swinging as a
    whole. The goal is random.

    ## What Is Modelled
    Springs, damping, bending, gravity, still air, the breeze as a small pressure along the normals, contact
    and friction of the cloth with itself.

    ## Version 1
    Before the extras also the way from the middle to the goal, and the speed. The reward is `approach * (1 +
    tolerance(speed, 0.5 m/s)) / 2`; approach is the mean of `tolerance(distance, 1 m)`, which is felt from everywhere,
    and `tolerance(distance, 0.25 m)`.
    """

    size = (1.0, 1.0)
    resolution = (65, 65)
    frame_dt = 0.02
    actions = ("corner velocity x", "corner velocity y", "corner velocity z")
    lattice = (4, 4)
    extras = (
        *("corner x", "corner y", "corner z", "corner vx", "corner vy", "corner vz"),
        *("middle x", "middle y", "middle z", "middle vx", "middle vy", "middle vz"),
        *("goal x", "goal y", "goal z", "breeze"),
    )
    extras_bound = 50.0
    parts = ("place", "calm")
    away = "of the middle from the goal [m]"
    ways = ("to goal x", "to goal y", "to goal z", "speed")
    near: ClassVar[float] = NEAR
    revision: ClassVar[Mapping[str, Any]] = {"parts": ("approach", "calm"), "near": NEARER}

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self.drive = Drive(LOW, HIGH, speed=SPEED, acceleration=ACCELERATION, dt=self.frame_dt)
        self.follow = np.ones((len(self.handles), 3))
        v, u = (np.linspace(0.0, s, n) for n, s in zip(scene.grid.shape, self.size, strict=True))
        u, v = np.meshgrid(u, v)
        self.polar = np.stack([np.hypot(u, v), np.arctan2(v, u) - np.pi / 4])  # of each vertex about the corner
        self.watch()

    @classmethod
    def build_scene(cls, grid: Grid, material: Material) -> Scene:
        grips = (Grip((0.0, 0.0), GRIP),)
        return Scene(
            *("Hanging", grid, material, cls.frame_dt),
            handles=held(grid, grips),
            grips=grips,
            pressure=True,
            air=Air(),
            self_contact=SelfContact(),
        )

    def draw(self, rng: np.random.Generator) -> dict[str, Any]:
        return {"even": rng.random(7 + 2 * GUST_TONES)}

    def lay(self, drawn: dict[str, np.ndarray]) -> Start:
        grid, even, xp = self.scene.grid, drawn["even"], array_namespace(drawn["even"])
        # A quarter sheet around its corner covers `wrap` of a cone: isometric, folded nowhere.
        sine = (0.25 / between(even[:, 0], *WRAP)).clip(EDGE_TURN / min(grid.cells))[:, None, None]
        yaw, rate = between(even[:, 1], -np.pi, np.pi), between(even[:, 2:4], -SWING, SWING)
        distance, angle = self.polar
        across, turn = distance * sine, angle / sine
        down = -distance * xp.sqrt(1 - sine**2)
        cone = xp.stack([across * xp.cos(turn), across * xp.sin(turn), down], axis=1).reshape(len(sine), 3, -1)
        middle = cone.mean(2)
        tilt = xp.atan2(middle[:, 0], -middle[:, 2])  # the middle hangs below the corner
        x, y, z = xp.unstack(rotation(yaw, 0, 1) @ rotation(tilt, 2, 0) @ cone, axis=1)
        a, b = rate[:, :1], rate[:, 1:]
        shape = (len(sine), 3, *grid.shape)
        positions, velocities = (
            xp.stack(part, axis=1).reshape(shape) for part in ((x, y, z), (b * z, -a * z, a * y - b * x))
        )
        goal = between(even[:, 4:7], GOAL_LOW, GOAL_HIGH)
        goal[:, 2] -= HANG
        memory = {"goal": goal, "tones": tones_of(even[:, 7:])}
        return replace(Start.still(positions, memory), velocities=velocities)

    def controls(self, episode: Episode) -> Controls:
        state = episode.state
        controls = self.carry(episode, state.positions[:, :, 0, 0], state.velocities[:, :, 0, 0], self.follow)
        controls.pressure = BREEZE * gust(episode.memory["tones"], state.time[:, None])[:, 0]
        return controls

    def marks(self, episode: Episode, member: int) -> list[Mark]:
        middle, goal = self.middle(episode)[member], episode.memory["goal"][member]
        return [line(middle, goal), ghost(goal, self.near), dot(middle)]

    def observe(self, episode: Episode) -> np.ndarray:
        state = episode.state
        corner, velocity = state.positions[:, :, 0, 0], state.velocities[:, :, 0, 0]
        middle = self.middle(episode), self.middle_velocity(episode)
        return columns(corner, velocity, *middle, episode.memory["goal"], state.pressure)

    def way(self, episode: Episode) -> np.ndarray:
        return columns(episode.memory["goal"] - self.middle(episode), self.speed(episode))

    def score(self, episode: Episode) -> tuple[np.ndarray, ...]:
        off, speed = self.middle(episode) - episode.memory["goal"], self.speed(episode)
        if not self.version:
            return length(off), tolerance(off, PLACE_MARGIN), tolerance(speed, CALM_MARGIN, 0.25)
        approach = broad_tolerance(off, FAR_MARGIN, NEAR_MARGIN)
        return length(off), approach, tolerance(speed, REST_MARGIN, 0.5)
