"""Collision: a ball presses a hanging cloth into a target shape."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from array_api_compat import array_namespace

from cloth_envs.grid import Grid
from cloth_envs.grip import Grip, held
from cloth_envs.marks import Mark, dot, ghost, line
from cloth_envs.material import Material
from cloth_envs.scene import Air, Collider, Scene
from cloth_envs.scenes.drives import Drive, push
from cloth_envs.scenes.measures import columns, largest_stretch, length, tolerance
from cloth_envs.scenes.starts import between, either, pleats
from cloth_envs.scenes.task import Episode, Start, Task, documented
from cloth_envs.state import Controls

RADIUS = 0.2  # m
GRIP = 0.098  # m, radius of what holds a corner: as much cloth as 5 cm along both sides
SPEED, ACCELERATION = 1.2, 12.0  # m/s at full action, m/s^2
LOW, HIGH = (-0.3, -0.7, -1.1), (0.3, 0.4, -0.3)  # m, box of the ball's centre
START_LOW, START_HIGH = (-0.25, -0.6, -1.0), (0.25, -0.4, -0.5)  # m
GOAL_LOW, GOAL_HIGH = (-0.15, 0.0, -0.9), (0.15, 0.3, -0.5)  # m
WAVES = 4  # half waves across the width
HUNG = 0.95  # distance of the hung corners over the cloth's width
SHAPE_MARGIN = 0.2  # m
BALL = ("ball x", "ball y", "ball z", "ball vx", "ball vy", "ball vz")
FREE_STRAIN, STRAIN_MARGIN = 0.03, 0.05  # the overstretch that costs nothing, and that leaves a tenth


@documented
class Collision(Task):
    """
    ## Description
    A cloth 1.0 m wide and 1.5 m tall hangs by 5 x 5 cm of its upper corners. Press a ball against it until the cloth
    takes the target shape, about the one it has when the ball rests at the goal, without stretching it.

    ## Action Space
    `Box(-1, 1, (3,))`: velocity of the ball (radius 0.2 m) along x, y, z, +-1 is 1.2 m/s. Its centre stays in
    a box: x within +-0.3 m, y from -0.7 to 0.4 m, z from 1.1 to 0.3 m below the corners.

    ## Observation Space
    `obs="keypoints"`: positions, then velocities of a 5 x 4 lattice of vertices (60 + 60 numbers), then the
    ball's position and velocity and the goal.

    ## Rewards
    `tolerance(shape error, 0.2 m) * tolerance(overstretch, 0.05)`, in [0, 1]. The shape error is the root-mean-square
    difference in y over the lower four keypoint rows, overstretch what the largest strain between keypoints
    one above the other exceeds 0.03 by.

    ## Starting State
    Hanging in four shallow pleats, at rest length and at rest; ball and goal are random. The top falls into a swag.

    ## What Is Modelled
    Springs, damping, bending, gravity, still air, contact and friction with the ball. No self-contact, and no need of
    it: none of the cloth's triangles cross. The ball slides, it doesn't roll, and doesn't feel the cloth.

    ## Version 1
    The goal of the ball is not told. Before the extras there is by how much each keypoint below the first row is short
    of its target y: the cloth tells what is to be done.
    """

    size = (1.5, 1.0)
    resolution = (61, 41)
    frame_dt = 0.02
    actions = ("ball velocity x", "ball velocity y", "ball velocity z")
    lattice = (5, 4)
    extras = (*BALL, "goal x", "goal y", "goal z")
    extras_bound = 20.0
    parts = ("shape", "unstretched")
    away = "the shape error [m]"
    ways = tuple(f"{row}, {col} short of y" for row in range(1, 5) for col in range(4))
    revision: ClassVar[Mapping[str, Any]] = {"extras": BALL}

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        rows, cols = np.divmod(self.keypoints.reshape(self.lattice), scene.grid.cols)
        self.depth = (rows * scene.grid.row_spacing)[1:].ravel()
        self.across = (cols * scene.grid.col_spacing - 0.5 * scene.grid.width)[1:].ravel()
        columns = self.lattice[1]
        self.above, self.shaped = self.keypoints[:-columns].copy(), self.keypoints[columns:].copy()
        self.shape_margin = SHAPE_MARGIN * len(self.shaped) ** 0.5  # of the length of all errors, not of their rms
        rows_apart = np.maximum(np.diff(rows, axis=0), 1)  # a coarse grid has less rows than the lattice
        self.apart = rows_apart.ravel() * scene.grid.row_spacing
        self.free_strain = FREE_STRAIN
        self.hung = pleats(scene.grid, WAVES, HUNG, 1.0)
        self.drive = Drive(LOW, HIGH, speed=SPEED, acceleration=ACCELERATION, dt=self.frame_dt)
        self.watch()

    @classmethod
    def build_scene(cls, grid: Grid, material: Material) -> Scene:
        grips = (Grip((0.0, 0.0), GRIP), Grip((0.0, grid.width), GRIP))
        ball = Collider("sphere", RADIUS, 0.3, "ball")
        return Scene(
            "Collision", grid, material, cls.frame_dt, handles=held(grid, grips), grips=grips, air=Air(),
            colliders=(ball,),
        )  # fmt: skip

    def draw(self, rng: np.random.Generator) -> dict[str, Any]:
        return {"side": either(rng), "even": rng.random(6)}

    def lay(self, drawn: dict[str, np.ndarray]) -> Start:
        even, xp = drawn["even"], array_namespace(drawn["even"])
        ball, goal = between(even[:, :3], START_LOW, START_HIGH), between(even[:, 3:], GOAL_LOW, GOAL_HIGH)
        x, y, z = (xp.broadcast_to(part, (len(ball), *part.shape)) for part in self.hung)
        positions = xp.stack([x, drawn["side"][:, None, None] * y, z], axis=1)
        bodies = xp.broadcast_to(ball[:, None, None], (len(ball), 1, 2, 3))
        return Start.still(positions, {"goal": goal, "shape": self.shape(goal)}, bodies)

    def controls(self, episode: Episode) -> Controls:
        state = episode.state
        moved, speed = self.drive(state.colliders[:, 0, 0], state.collider_velocities[:, 0, 0], episode.action)
        controls = self.hold(episode)
        push(controls.colliders, controls.collider_velocities, moved, speed)
        return controls

    def marks(self, episode: Episode, member: int) -> list[Mark]:
        now, wanted = episode.cloth[member][:, self.shaped], episode.memory["shape"][member]
        x, z = (now[0], now[2]) if self.version else (self.across, -self.depth)
        net = np.stack([x, wanted, z], 1).reshape(self.lattice[0] - 1, self.lattice[1], 3)
        of = [dot(point) for point in now.T] if self.version else [ghost(episode.memory["goal"][member], RADIUS)]
        return [*of, *(line(*points) for points in (*net, *net.swapaxes(0, 1)))]

    def observe(self, episode: Episode) -> np.ndarray:
        state = episode.state
        ball = state.colliders[:, 0, 0], state.collider_velocities[:, 0, 0]
        return columns(*ball) if self.version else columns(*ball, episode.memory["goal"])

    def way(self, episode: Episode) -> np.ndarray:
        """By how much the keypoints below the first row are short of their target y [m]."""
        return columns(episode.memory["shape"] - episode.cloth[:, 1, self.shaped])

    def shape(self, goal: np.ndarray) -> np.ndarray:
        """Target y of the keypoints below the first row, ``(B, n)`` [m], for ball centres ``goal`` ``(B, 3)``.

        A fit, 3 cm rms, to 48 presses: a bell across, a straight line from the top down to the ball.
        """
        press = goal[:, 1:2] + RADIUS
        down = -self.depth / goal[:, 2:]
        width = 0.07 + 0.68 * press
        xp = array_namespace(goal)
        profile = xp.minimum(down, 0.84 + 0.16 * down)
        return press * profile * xp.exp(-0.5 * xp.square((self.across - goal[:, :1]) / width))

    def score(self, episode: Episode) -> tuple[np.ndarray, ...]:
        error = episode.cloth[:, 1, self.shaped] - episode.memory["shape"]
        stretch = largest_stretch(episode.state.positions, self.above, self.shaped, self.apart)
        over = stretch - (1.0 + self.free_strain)
        shape, unstretched = tolerance(error, self.shape_margin), tolerance(over * (over > 0.0), STRAIN_MARGIN)
        return length(error) / len(self.shaped) ** 0.5, shape, unstretched
