"""Curtain: a curtain on rings is drawn to a target opening and calmed."""

from itertools import pairwise
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from cloth_envs.grid import Grid
from cloth_envs.grip import Grip, held
from cloth_envs.marks import Mark, line
from cloth_envs.material import Material
from cloth_envs.scene import Air, Scene, SelfContact
from cloth_envs.scenes.drives import Drive
from cloth_envs.scenes.measures import broad_tolerance, columns, mean_span, tolerance
from cloth_envs.scenes.starts import between, bow, either
from cloth_envs.scenes.task import Episode, Start, Task, documented
from cloth_envs.state import Controls

RINGS, RING = 7, 0.03  # how many, and the radius [m] of what each holds
SPEED = (0.5, 0.6)  # m/s at full action: lead ring along the rail, rail across
LOW, HIGH = (0.35, -0.3), (0.95, 0.3)  # m, box of the lead ring
ACCELERATION = 15.0  # m/s^2
TARGET = (0.4, 0.9)  # covered fraction of a window as wide as the flat curtain
APART = 0.2  # least difference of the target from the starting opening
SWING = 1.2  # m/s, largest starting speed of the hem
COVER_MARGIN, CALM_MARGIN = 0.3, 0.5  # fraction, m/s
FAR_MARGIN, NEAR_MARGIN = 0.8, 0.22  # of the fraction, in version 1; 0.9 is where it is in version 0


@documented
class Curtain(Task):
    """
    ## Description
    A curtain 1.0 m wide and 1.5 m tall hangs by seven rings, each of 3 cm around, from a rail along x. The first
    ring is fixed to the wall at x = 0, the last (lead) ring is pulled along the rail and the others space out
    between them. The rail sways across. Cover a target fraction of the 1 m window and calm the curtain.

    ## Action Space
    `Box(-1, 1, (2,))`: velocity of the lead ring along the rail, +-1 is 0.5 m/s, and of the rail across
    (y), +-1 is 0.6 m/s. The lead ring stays in 0.35-0.95 m, the rail within +-0.3 m of y = 0.

    ## Observation Space
    `obs="keypoints"`: positions, then velocities of a 5 x 4 lattice of vertices (60 + 60 numbers), then the
    lead ring's x, y and its velocity, the covered and the target fraction.

    ## Rewards
    `tolerance(covered - target, 0.3) * (1 + 3 * tolerance(swing, 0.5 m/s)) / 4` in [0, 1]. Covered is the mean
    x-distance from the first to the last column (five keypoint rows) over 1 m; swing is the
    root-mean-square y-velocity of the keypoints.

    ## Starting State
    Hanging in pleats at rest length with a random opening, target and a random swing that grows
    towards the hem.

    ## What Is Modelled
    Springs, damping, bending, gravity, still air, rings, contact and friction of pleats with each other. No
    friction of rings on the rail.

    ## Version 1
    Before the extras also the fraction that is still to be covered, and the swing. Cover is the mean of
    `tolerance(covered - target, 0.8)`, which is felt from everywhere, and `tolerance(covered - target, 0.22)`.
    """

    size = (1.5, 1.0)
    resolution = (73, 49)
    frame_dt = 0.04
    actions = ("lead ring velocity x", "rail velocity y")
    lattice = (5, 4)
    extras = ("lead x", "rail y", "lead vx", "rail vy", "covered", "target")
    extras_bound = 20.0
    parts = ("cover", "calm")
    away = "of the covered fraction from the target"
    ways = ("uncovered", "swing")

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        ringed = self.leads % scene.grid.cols  # of each handle, the column of its ring
        self.spans = list(pairwise(np.unique(ringed).tolist()))  # first and last column of every pleat
        self.depth = np.linspace(0.0, 1.0, scene.grid.rows)[:, None]
        share = ringed / (scene.grid.cols - 1)
        self.follow = np.stack([share, np.ones(len(share))], 1)  # of the lead ring's x, y
        self.drive = Drive(LOW, HIGH, speed=SPEED, acceleration=ACCELERATION, dt=self.frame_dt)
        edges = self.keypoints.reshape(self.lattice)
        self.first, self.last = edges[:, 0].copy(), edges[:, -1].copy()
        self.watch()

    @classmethod
    def build_scene(cls, grid: Grid, material: Material) -> Scene:
        rings = min(RINGS, (grid.cols + 1) // 2)  # at least two cells a pleat
        columns = np.linspace(0, grid.cols - 1, rings).round().astype(int)
        grips = tuple(Grip((0.0, col * grid.col_spacing), RING, (False, False, True)) for col in columns.tolist())
        return Scene(
            *("Curtain", grid, material, cls.frame_dt),
            handles=held(grid, grips),
            grips=grips,
            air=Air(),
            self_contact=SelfContact(),
        )

    def draw(self, rng: np.random.Generator) -> dict[str, Any]:
        return {"even": rng.random(3), "side": either(rng)}

    def lay(self, drawn: dict[str, np.ndarray]) -> Start:
        grid, even, xp = self.scene.grid, drawn["even"], array_namespace(drawn["even"])
        opening, target = between(even[:, 0], LOW[0], HIGH[0]), between(even[:, 1], TARGET[0], TARGET[1] - 2 * APART)
        target = xp.where(target > opening - APART, target + 2 * APART, target)
        bows = {cells: grid.col_spacing * bow(cells, opening) for cells in {end - begin for begin, end in self.spans}}
        rows = []
        for i, (begin, end) in enumerate(self.spans):
            path = bows[end - begin]
            along = opening[:, None] * begin * grid.col_spacing + path[:, 0]
            pleat = xp.stack([along, (-1) ** i * drawn["side"][:, None] * path[:, 1]], axis=1)
            rows.append(pleat if end == grid.cols - 1 else pleat[:, :, :-1])
        level = xp.concat(rows, axis=2)
        shape = (len(opening), 1, *grid.shape)
        upright = xp.broadcast_to(-grid.height * self.depth, shape)
        positions = xp.concat([xp.broadcast_to(level[:, :, None], (len(opening), 2, *grid.shape)), upright], axis=1)
        start = Start.still(positions, {"target": target})
        start.velocities[:, 1] = between(even[:, 2, None, None], -SWING, SWING) * self.depth
        return start

    def controls(self, episode: Episode) -> Controls:
        state = episode.state
        return self.carry(episode, state.positions[:, :2, 0, -1], state.velocities[:, :2, 0, -1], self.follow)

    def covered(self, episode: Episode) -> np.ndarray:
        """Covered fraction of the window, ``(B,)``."""
        return mean_span(episode.state.positions, self.first, self.last)[:, 0] / self.scene.grid.width

    def marks(self, episode: Episode, member: int) -> list[Mark]:
        begin, y = episode.cloth[member, 0, self.first].mean(), episode.state.positions[member, 1, 0, -1]
        end, bottom = begin + episode.memory["target"][member] * self.scene.grid.width, -1.02 * self.scene.grid.height
        return [line((begin, y, bottom), (end, y, bottom), (end, y, 0.0))]  # what is to be covered, and its edge

    def observe(self, episode: Episode) -> np.ndarray:
        state = episode.state
        corner, velocity = state.positions[:, :2, 0, -1], state.velocities[:, :2, 0, -1]
        return columns(corner, velocity, self.covered(episode), episode.memory["target"])

    def way(self, episode: Episode) -> np.ndarray:
        return columns(episode.memory["target"] - self.covered(episode), self.speed(episode, 1, 2))

    def score(self, episode: Episode) -> tuple[np.ndarray, ...]:
        off = self.covered(episode) - episode.memory["target"]
        cover, calm = tolerance(off, COVER_MARGIN), tolerance(self.speed(episode, 1, 2), CALM_MARGIN, 0.25)
        if self.version:
            cover = broad_tolerance(off, FAR_MARGIN, NEAR_MARGIN)
        return abs(off), cover, calm
