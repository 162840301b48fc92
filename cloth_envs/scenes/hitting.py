"""Hitting: a ball is driven into a hung tablecloth so that a marked vertex moves to a target point."""

from typing import ClassVar

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.grip import Grip, held
from cloth_envs.marks import Mark, dot, ghost, globe, line
from cloth_envs.material import Material
from cloth_envs.scene import Air, Collider, Scene, SelfContact
from cloth_envs.scenes.drives import Drive, push
from cloth_envs.scenes.measures import columns, length, points, tolerance, within
from cloth_envs.scenes.starts import either, pleats
from cloth_envs.scenes.task import Episode, Start, Task, documented
from cloth_envs.state import Controls

CLIPS, GRIP = 4, 0.069  # grips along the upper edge; m, radius of each: as much cloth as 5 x 5 cm, half at the corners
HUNG = 0.95  # distance of the outer clips over the cloth's width
SPEED, ACCELERATION = 1.5, 15.0  # m/s of the ball at full action, m/s^2
LOW, HIGH = (-0.5, -0.8, -1.0), (0.5, 0.8, -0.2)  # m, box of the ball's centre
AWAY, ASIDE = 0.45, 0.3  # m, of the starting ball: in front of the cloth, most to the side
DEPTH = (-0.9, -0.5)  # m, height of the starting ball below the upper edge
PUSH = (0.15, 0.35)  # m, how far behind the hung cloth the target lies
SIDE = 0.05  # m, most that the target lies beside the vertex
MARGIN = 0.25  # m
NEAR = within(MARGIN)  # m, distance of the target that is near enough


@documented
class Hitting(Task):
    """
    ## Description
    A tablecloth of 1 x 1 m hangs from four clips along its upper edge. Drive a ball into it so that a marked vertex
    of the cloth comes to a target point on its other side.

    ## Action Space
    `Box(-1, 1, (3,))`: velocity of the ball (radius 0.15 m) along x, y, z, +-1 is 1.5 m/s. Its centre stays in a box:
    x within +-0.5 m, y within +-0.8 m, z from 1.0 to 0.2 m below the clips.

    ## Observation Space
    `obs="keypoints"`: positions, then velocities of a 5 x 5 lattice of vertices (75 + 75 numbers), then the ball's
    position and velocity, the marked vertex's position and velocity, the target.

    ## Rewards
    `tolerance(distance of the vertex to the target, 0.25 m)`, in [0, 1].

    ## Starting State
    Hanging in three shallow pleats, at rest length and at rest; the ball 0.45 m in front of or behind it, at a random
    place. The marked vertex is one of nine in the middle of the lower half, the target 0.15-0.35 m from the hung cloth
    on the side away from the ball.

    ## What Is Modelled
    Springs, damping, bending, gravity, still air, contact and friction with the ball and of the cloth with itself. The
    ball slides, it doesn't roll, and doesn't feel the cloth.

    ## Version 1
    Before the extras also the ways from the vertex to the target, and from the ball to the vertex.
    """

    size = (1.0, 1.0)
    resolution = (65, 65)
    frame_dt = 0.04
    actions = ("ball velocity x", "ball velocity y", "ball velocity z")
    lattice = (5, 5)
    extras = (
        *("ball x", "ball y", "ball z", "ball vx", "ball vy", "ball vz"),
        *("vertex x", "vertex y", "vertex z", "vertex vx", "vertex vy", "vertex vz"),
        *("target x", "target y", "target z"),
    )
    extras_bound = 50.0
    parts = ("place",)
    away = "of the marked vertex from the target [m]"
    ways = ("to target x", "to target y", "to target z", "to vertex x", "to vertex y", "to vertex z")
    radius: ClassVar[float] = 0.15  # m, of the ball

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self.drive = Drive(LOW, HIGH, speed=SPEED, acceleration=ACCELERATION, dt=self.frame_dt)
        self.watch()

    @classmethod
    def build_scene(cls, grid: Grid, material: Material) -> Scene:
        grips = tuple(Grip((0.0, at * grid.width), GRIP) for at in np.linspace(0.0, 1.0, CLIPS).tolist())
        return Scene(
            *("Hitting", grid, material, cls.frame_dt),
            handles=held(grid, grips),
            grips=grips,
            air=Air(),
            colliders=(Collider("sphere", cls.radius, 0.3, "ball"),),
            self_contact=SelfContact(),
        )

    def start(self, rng: np.random.Generator) -> Start:
        side = either(rng)
        positions = pleats(self.scene.grid, CLIPS - 1, HUNG, either(rng))
        ball = np.array([rng.uniform(-ASIDE, ASIDE), -side * AWAY, rng.uniform(*DEPTH)])
        return Start(positions, np.zeros_like(positions), np.tile(ball, (1, 2, 1)), self.aim(positions, side, rng))

    def aim(self, positions: np.ndarray, side: float, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """A marked keypoint, as 1 among zeros, and a target on ``side`` (-1 or 1 along y) of the hung ``positions``."""
        rows, cols = self.lattice
        marked = rng.integers(rows // 2, rows) * cols + rng.integers(1, cols - 1)
        x, _, z = positions.reshape(3, -1)[:, self.keypoints[marked]]
        y = side * rng.uniform(*PUSH)
        target = np.array([x + rng.uniform(-SIDE, SIDE), y, -np.sqrt(z**2 - y**2)])  # about the clips, on a taut line
        return {"target": target, "marked": np.eye(rows * cols)[marked]}

    def controls(self, episode: Episode) -> Controls:
        state = episode.state
        controls = self.hold(episode)
        moved, speed = self.drive(state.colliders[:, 0, 0], state.collider_velocities[:, 0, 0], episode.action)
        push(controls.colliders, controls.collider_velocities, moved, speed)
        return controls

    def vertex(self, episode: Episode, field: np.ndarray) -> np.ndarray:
        """A field ``(B, 3, H, W)`` at each cloth's marked vertex, ``(B, 3)``."""
        return (points(field, self.keypoints) * episode.memory["marked"][:, None]).sum(2)

    def marks(self, episode: Episode, member: int) -> list[Mark]:
        vertex, target = self.vertex(episode, episode.state.positions)[member], episode.memory["target"][member]
        ball = globe(episode.state.colliders[member, 0, 0], self.radius)
        return [line(vertex, target), ghost(target, NEAR), dot(vertex), *ball]

    def observe(self, episode: Episode) -> np.ndarray:
        state = episode.state
        vertex = self.vertex(episode, state.positions), self.vertex(episode, state.velocities)
        ball = state.colliders[:, 0, 0], state.collider_velocities[:, 0, 0]
        return columns(*ball, *vertex, episode.memory["target"])

    def way(self, episode: Episode) -> np.ndarray:
        """From the vertex to the target, and from the ball to the vertex."""
        vertex = self.vertex(episode, episode.state.positions)
        return columns(episode.memory["target"] - vertex, vertex - episode.state.colliders[:, 0, 0])

    def score(self, episode: Episode) -> tuple[np.ndarray, ...]:
        off = self.vertex(episode, episode.state.positions) - episode.memory["target"]
        return length(off), tolerance(off, MARGIN)
