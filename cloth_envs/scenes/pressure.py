"""Pressure: a pinned sheet is inflated so that its apex follows a moving height."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from array_api_compat import array_namespace

from cloth_envs.grid import Grid
from cloth_envs.marks import Mark, dot, line, ring
from cloth_envs.material import Material
from cloth_envs.scene import Air, Scene
from cloth_envs.scenes.drives import GUST_TONES, gust, pump, tones_of
from cloth_envs.scenes.measures import columns, tolerance
from cloth_envs.scenes.starts import between
from cloth_envs.scenes.task import Episode, Start, Task, documented
from cloth_envs.state import Controls

FULL_PRESSURE = 40.0  # Pa
PUMP = 0.06  # s, time in which the pressure approaches the wanted one
TARGET_HEIGHT = 0.15  # m, times a gust signal in [-1, 1]
PREVIEW = [0.0, 0.1]  # s, the target is shown now and ahead
AHEAD = [0.0, 0.1, 0.2, 0.3, 0.4]  # s, in version 1
MARGIN = 0.05  # m
RING = 0.15  # m, radius of the mark at the target height
BULGE = 0.04  # m, largest starting apex height


@documented
class Pressure(Task):
    """
    ## Description
    A sheet of 1 x 1 m is pinned along its border, like a drum. A pump sets the pressure below it.
    Make the middle of the sheet follow a height that moves smoothly up and down.

    ## Action Space
    `Box(-1, 1, (1,))`: the pressure that the pump aims at, +-1 is 40 Pa (+ lifts the sheet; its weight
    is about 2 Pa). The pump needs 0.06 s to get there.

    ## Observation Space
    `obs="keypoints"`: positions, then velocities of a 5 x 5 lattice of vertices (75 + 75 numbers), then apex
    height and velocity, pressure over 40 Pa, the target height now and in 0.1 s.

    ## Rewards
    `tolerance(apex - target, 0.05 m)`, in [0, 1].

    ## Starting State
    A smooth bulge at rest, up to 4 cm up or down, no pressure. The target is a sum of four random tones of
    0.15-1.2 Hz.

    ## What Is Modelled
    Springs, damping, bending, gravity, still air, pressure along the normals, pinned border. The air's own mass and
    flow are not. No self-contact, and no need of it: none of the sheet's triangles cross.

    ## Version 1
    The target moves by up to 22 cm, full pressure is 80 Pa (the number among the extras is over that). Before the
    extras also the way from the apex to the target now and in 0.1, 0.2, 0.3 and 0.4 s.
    """

    size = (1.0, 1.0)
    resolution = (65, 65)
    frame_dt = 0.02
    actions = ("pressure",)
    lattice = (5, 5)
    extras = ("apex z", "apex vz", "pressure", "target z", "target z soon")
    extras_bound = 50.0
    parts = ("height",)
    away = "of the apex from the target height [m]"
    ways = ("to target", *(f"to target in {ahead:g} s" for ahead in AHEAD[1:]))
    rise: ClassVar[float] = TARGET_HEIGHT
    full: ClassVar[float] = FULL_PRESSURE
    revision: ClassVar[Mapping[str, Any]] = {"rise": 0.22, "full": 80.0}

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self.preview, self.ahead = np.array([PREVIEW]), np.array([AHEAD])
        v, u = (np.linspace(0.0, 1.0, n) for n in scene.grid.shape)
        self.level = np.stack(np.meshgrid((u - 0.5) * scene.grid.width, (0.5 - v) * scene.grid.height))
        self.dome = np.outer(np.sin(np.pi * v), np.sin(np.pi * u))
        self.apex = scene.grid.index(scene.grid.rows // 2, scene.grid.cols // 2)
        self.watch(self.apex)

    @classmethod
    def build_scene(cls, grid: Grid, material: Material) -> Scene:
        pins = tuple(np.sort(grid.border).tolist())
        return Scene("Pressure", grid, material, cls.frame_dt, handles=pins, pressure=True, air=Air())

    def draw(self, rng: np.random.Generator) -> dict[str, Any]:
        return {"even": rng.random(1 + 2 * GUST_TONES)}

    def lay(self, drawn: dict[str, np.ndarray]) -> Start:
        even, xp = drawn["even"], array_namespace(drawn["even"])
        bulge = between(even[:, 0], -BULGE, BULGE)
        x, y = (xp.broadcast_to(part, (len(bulge), *part.shape)) for part in self.level)
        return Start.still(xp.stack([x, y, bulge[:, None, None] * self.dome], axis=1), {"tones": tones_of(even[:, 1:])})

    def controls(self, episode: Episode) -> Controls:
        controls = self.hold(episode)
        share = self.frame_dt / PUMP
        controls.pressure = pump(episode.state.pressure, episode.action[:, 0], self.full, share)
        return controls

    def target(self, episode: Episode) -> np.ndarray:
        """The wanted apex height now and in 0.1 s, ``(B, 2)`` [m]."""
        return self.rise * gust(episode.memory["tones"], episode.state.time[:, None] + self.preview)

    def way(self, episode: Episode) -> np.ndarray:
        """From the apex to where it should be, now and ahead."""
        wanted = self.rise * gust(episode.memory["tones"], episode.state.time[:, None] + self.ahead)
        return columns(wanted - episode.cloth[:, 2, self.apex][:, None])

    def marks(self, episode: Episode, member: int) -> list[Mark]:
        apex, target = episode.cloth[member, :, self.apex], self.target(episode)[member, 0]
        ruler = line((0.0, 0.0, -self.rise), (0.0, 0.0, self.rise), own=True)
        return [ruler, dot(apex), ring(np.array([0.0, 0.0, target]), RING)]

    def observe(self, episode: Episode) -> np.ndarray:
        height, velocity = episode.cloth[:, 2, self.apex], episode.cloth_velocity[:, 2, self.apex]
        return columns(height, velocity, episode.state.pressure / self.full, self.target(episode))

    def score(self, episode: Episode) -> tuple[np.ndarray, ...]:
        off = episode.cloth[:, 2, self.apex] - self.target(episode)[:, 0]
        return abs(off), tolerance(off, MARGIN)
