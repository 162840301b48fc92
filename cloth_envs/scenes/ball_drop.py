"""BallDrop: a ball on the ground catches a falling cloth."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from array_api_compat import array_namespace

from cloth_envs.grid import Grid
from cloth_envs.marks import Mark, dot, line, ring
from cloth_envs.material import Material
from cloth_envs.scene import Air, Collider, Scene, SelfContact
from cloth_envs.scenes.drives import Drive, push
from cloth_envs.scenes.measures import broad_tolerance, columns, length, ramp, tolerance, within
from cloth_envs.scenes.starts import between
from cloth_envs.scenes.task import Episode, Start, Task, documented
from cloth_envs.state import Controls

RADIUS = 0.3  # m
CENTRE = 0.45  # m, height of the ball's centre above the ground
SPEED, ACCELERATION = 1.5, 20.0  # m/s at full action, m/s^2
REACH = 1.0  # m, the ball stays within this of its start
DROP = (1.0, 1.2)  # m, starting height of the cloth above the ground
OFFSET = 0.35  # m, largest starting distance of the cloth's middle from the ball's axis
DRIFT = 0.3  # m/s, largest starting velocity along x and y
WAVE = 0.02  # m, largest starting waves
HELD = 0.5  # m, mean height from which on the cloth counts as held up
MARGIN, FAR_MARGIN = 0.35, 1.0  # m, the second of version 1, which is felt from everywhere
NEAR = within(MARGIN)  # m, distance from the axis that is near enough
GOAL = (0.3, 0.8)  # m, distance of the goal from the ball's start, in version 1
BRING_MARGIN, BRING_LEAST = 0.5, 0.25  # m, and what a cloth that is caught earns far from the goal
BROUGHT = within(BRING_MARGIN, (0.9 - BRING_LEAST) / (1 - BRING_LEAST))  # m, distance of the goal that is near enough


@documented
class BallDrop(Task):
    """
    ## Description
    A flat cloth of 1 x 1 m falls from about a metre. Move the ball below it so that the cloth drapes
    over the ball, centred; a missed cloth ends on the ground.

    ## Action Space
    `Box(-1, 1, (2,))`: velocity of the ball along x and y, +-1 is 1.5 m/s. The ball (radius 0.3 m, centre
    0.45 m above the ground) stays in a square of +-1 m.

    ## Observation Space
    `obs="keypoints"`: positions, then velocities of a 5 x 5 lattice of vertices (75 + 75 numbers), then the
    ball's x, y and its velocity, the cloth's middle (mean of the keypoints) and its velocity.

    ## Rewards
    `tolerance(distance of the middle from the ball's axis, 0.35 m) * held`, in [0, 1]; held is the middle's height over
    0.5 m, at most 1.

    ## Starting State
    Level with small waves, 1.0-1.2 m above the ground, turned at random, drifting, its middle up to 0.35 m
    beside the ball's axis.

    ## What Is Modelled
    Springs, damping, bending, gravity, still air, contact and friction with the ball, the ground and
    itself. The ball slides, it doesn't roll, and doesn't feel the cloth.

    ## Version 1
    The cloth starts 0.35-0.6 m beside the ball's axis, so that nothing catches it by luck, and is to be carried to a
    goal on the ground, 0.3-0.8 m from where the ball starts. The reward is multiplied by `(1 + 3 * tolerance(distance
    of the middle from the goal, 0.5 m)) / 4`, and `distance` is this one; of the distance from the ball's axis counts
    the mean of `tolerance(distance, 1 m)`, which is felt from everywhere, and `tolerance(distance, 0.35 m)`. Before the
    extras also the ways from the ball's axis to the middle, and from the middle to the goal.
    """

    size = (1.0, 1.0)
    resolution = (65, 65)
    frame_dt = 0.02
    actions = ("ball velocity x", "ball velocity y")
    lattice = (5, 5)
    extras = (
        *("ball x", "ball y", "ball vx", "ball vy"),
        *("middle x", "middle y", "middle z", "middle vx", "middle vy", "middle vz"),
    )
    extras_bound = 50.0
    parts = ("centred", "held")
    away = "of the middle from the ball's axis [m]"
    ways = ("to middle x", "to middle y", "to goal x", "to goal y")
    revision: ClassVar[Mapping[str, Any]] = {"beside": (0.35, 0.6), "parts": ("brought", "centred", "held")}
    beside: ClassVar[tuple[float, float]] = (0.0, OFFSET)  # m, starting distance of the middle from the ball's axis

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        v, u = (np.linspace(-0.5, 0.5, n) * s for n, s in zip(scene.grid.shape, self.size, strict=True))
        self.level = np.stack(np.meshgrid(u, v))
        self.bodies = np.array([[[0.0, 0.0, CENTRE]] * 2, [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]])
        self.drive = Drive([-REACH] * 2, [REACH] * 2, speed=SPEED, acceleration=ACCELERATION, dt=self.frame_dt)
        self.watch()

    @classmethod
    def build_scene(cls, grid: Grid, material: Material) -> Scene:
        bodies = (Collider("sphere", RADIUS, 0.5, "ball"), Collider("plane", 0.0, 0.5, "ground"))
        own = SelfContact()
        return Scene("BallDrop", grid, material, cls.frame_dt, colliders=bodies, air=Air(), self_contact=own)

    def draw(self, rng: np.random.Generator) -> dict[str, Any]:
        return {"even": rng.random(9 + 2 * self.version)}

    def lay(self, drawn: dict[str, np.ndarray]) -> Start:
        even, xp = drawn["even"][..., None, None], array_namespace(drawn["even"])
        yaw, side = (between(even[:, i], -np.pi, np.pi)[:, None] for i in range(2))
        (nearest, farthest), phase = self.beside, between(even[:, 3:5], -np.pi, np.pi)
        away = nearest + (farthest - nearest) * xp.sqrt(even[:, 2:3])
        height, wave = between(even[:, 5:6], *DROP), between(even[:, 6:7], 0.0, WAVE)
        u, v = self.level
        waves = wave * xp.cos(2 * np.pi * u + phase[:, :1]) * xp.cos(2 * np.pi * v + phase[:, 1:])
        x = xp.cos(yaw) * u + xp.sin(yaw) * v + away * xp.cos(side)
        y = xp.sin(yaw) * u - xp.cos(yaw) * v + away * xp.sin(side)
        positions = xp.concat([x, y, height + waves], axis=1)
        start = Start.still(positions, {}, xp.broadcast_to(self.bodies, (len(yaw), *self.bodies.shape)))
        start.velocities[:, :2] = between(even[:, 7:9], -DRIFT, DRIFT)
        if self.version:
            (near, far), (turn, share) = GOAL, xp.unstack(drawn["even"][:, 9:], axis=1)
            angle = between(turn, -np.pi, np.pi)
            start.memory["goal"] = between(share, near, far)[:, None] * xp.stack([xp.cos(angle), xp.sin(angle)], axis=1)
        return start

    def controls(self, episode: Episode) -> Controls:
        state = episode.state
        moved, speed = self.drive(state.colliders[:, 0, 0, :2], state.collider_velocities[:, 0, 0, :2], episode.action)
        controls = self.hold(episode)
        push(controls.colliders, controls.collider_velocities, moved, speed)
        return controls

    def marks(self, episode: Episode, member: int) -> list[Mark]:
        middle, ball = self.middle(episode)[member], episode.state.colliders[member, 0, 0]
        below = np.array([*ball[:2], middle[2]])
        marks = [line(ball, (*ball[:2], DROP[1])), ring(below, NEAR), dot(middle)]
        if self.version:
            goal, foot = np.array([*episode.memory["goal"][member], 0.0]), np.array([*middle[:2], 0.0])
            marks += [line(foot, goal), ring(goal, BROUGHT), dot(foot)]
        return marks

    def observe(self, episode: Episode) -> np.ndarray:
        state = episode.state
        ball, velocity = state.colliders[:, 0, 0, :2], state.collider_velocities[:, 0, 0, :2]
        return columns(ball, velocity, self.middle(episode), self.middle_velocity(episode))

    def way(self, episode: Episode) -> np.ndarray:
        """From the ball's axis to the middle, and from the middle to the goal."""
        middle = self.middle(episode)[:, :2]
        return columns(middle - episode.state.colliders[:, 0, 0, :2], episode.memory["goal"] - middle)

    def score(self, episode: Episode) -> tuple[np.ndarray, ...]:
        middle = self.middle(episode)
        away = middle[:, :2] - episode.state.colliders[:, 0, 0, :2]
        held = ramp(middle[:, 2], HELD)
        if not self.version:
            return length(away), tolerance(away, MARGIN), held
        left = middle[:, :2] - episode.memory["goal"]
        brought, centred = tolerance(left, BRING_MARGIN, BRING_LEAST), broad_tolerance(away, FAR_MARGIN, MARGIN)
        return length(left), brought, centred, held
