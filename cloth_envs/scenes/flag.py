"""Flag: a flag in gusty wind whose pole moves."""

from typing import Any

import numpy as np
from array_api_compat import array_namespace

from cloth_envs.grid import Grid
from cloth_envs.marks import Mark
from cloth_envs.material import Material
from cloth_envs.scene import Air, Scene, SelfContact
from cloth_envs.scenes.drives import GUST_TONES, Drive, gusty_wind, tones_of
from cloth_envs.scenes.measures import along, columns, loop_area, ramp
from cloth_envs.scenes.starts import between
from cloth_envs.scenes.task import Episode, Start, Task, documented
from cloth_envs.state import Controls

POLE_SPEED, ACCELERATION = 2.5, 25.0  # m/s at full action, m/s^2
REACH = 1.5  # m, the pole stays within this of where it started
WIND_SPEED = (2.0, 4.5)  # m/s, range of the mean wind
FASTEST = 12.0  # m/s, of gusts and of the pole through the air
ASIDE = 0.6  # rad, largest angle between the mean wind and the line to the onlooker
GUST = 0.5  # of the mean
SEEN_FROM = 1.0  # m from the pole, where pictures show the onlooker, who is far away
BACKING = 0.4  # rad, how far gusts turn the wind


@documented
class Flag(Task):
    """
    ## Description
    A flag of 1.5 x 1.0 m flies from an upright pole in a gusty wind that blows mostly towards or away from an
    onlooker, who sees little of it. Run about with the pole so that the onlooker sees the flag spread out.

    ## Action Space
    `Box(-1, 1, (2,))`: velocity of the pole along x and y, +-1 is 2.5 m/s. The pole stays in a square of
    +-1.5 m.

    ## Observation Space
    `obs="keypoints"`: positions, then velocities of a 4 x 5 lattice of vertices (60 + 60 numbers), then
    the pole's x, y and its velocity, the wind's x, y and the onlooker's direction x, y.

    ## Rewards
    Component of the flag's area vector towards the onlooker, without its sign, over the rest area, in [0, 1]. The
    area vector follows from the border alone; where the flag is folded over, the two layers cancel.

    ## Starting State
    The flag is spread downwind with small random waves. Mean wind (2-4.5 m/s), gusts, their turning
    and the onlooker's direction, up to 34 degrees beside the wind, are random.

    ## What Is Modelled
    Springs, damping, bending, gravity, wind with lift on cells, the pole, contact and friction of the flag
    with itself.

    ## Version 1
    Before the extras also the part of the area that is shown, signed by the side, and the pole's place, its velocity
    and the wind as parts towards the onlooker and to his left.
    """

    size = (1.0, 1.5)
    resolution = (33, 49)
    frame_dt = 0.04
    actions = ("pole velocity x", "pole velocity y")
    lattice = (4, 5)
    extras = ("pole x", "pole y", "pole vx", "pole vy", "wind x", "wind y", "onlooker x", "onlooker y")
    extras_bound = 20.0
    parts = ("shown",)
    away = "fraction of the area that is not shown"
    enough = 0.5
    ways = (
        *("shown", "pole towards", "pole aside", "pole velocity towards", "pole velocity aside"),
        *("wind towards", "wind aside"),
    )

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self.drive = Drive([-REACH] * 2, [REACH] * 2, speed=POLE_SPEED, acceleration=ACCELERATION, dt=self.frame_dt)
        self.follow = np.ones((len(self.handles), 2))
        self.border = scene.grid.border.astype(np.int32)
        self.area = scene.grid.height * scene.grid.width
        self.along = np.linspace(0.0, scene.grid.width, scene.grid.cols)
        self.down = -np.linspace(0.0, scene.grid.height, scene.grid.rows)
        self.watch(self.border)

    @classmethod
    def build_scene(cls, grid: Grid, material: Material) -> Scene:
        hoist = tuple(grid.index(row, 0) for row in range(grid.rows))
        air = Air(max_wind=FASTEST)
        return Scene("Flag", grid, material, cls.frame_dt, handles=hoist, air=air, self_contact=SelfContact())

    def draw(self, rng: np.random.Generator) -> dict[str, Any]:
        return {"even": rng.random(4 + 4 * GUST_TONES)}

    def lay(self, drawn: dict[str, np.ndarray]) -> Start:
        grid, even, xp = self.scene.grid, drawn["even"], array_namespace(drawn["even"])
        heading, speed = between(even[:, 0], -np.pi, np.pi), between(even[:, 1], *WIND_SPEED)
        aside, wave = heading + between(even[:, 2], -ASIDE, ASIDE), even[:, 3]
        # Slope angle along the flag: integrating unit steps keeps the edges at their rest length.
        part = self.along / grid.width
        turn = 0.25 * xp.sin(2 * np.pi * (part + wave[:, None])) * self.along / grid.width
        along = heading[:, None] + turn
        step = grid.col_spacing * xp.stack([xp.cos(along), xp.sin(along)], axis=1)
        path = xp.cumulative_sum(step[:, :, :-1], axis=2, include_initial=True)
        level = xp.broadcast_to(path[:, :, None], (len(path), 2, *grid.shape))
        upright = xp.broadcast_to(self.down[:, None], (len(path), 1, *grid.shape))
        positions = xp.concat([level, upright], axis=1)
        onlooker, gusts = xp.stack([xp.cos(aside), xp.sin(aside)], axis=1), tones_of(even[:, 4:])
        return Start.still(positions, {"heading": heading, "speed": speed, "onlooker": onlooker, "gusts": gusts})

    def wind(self, episode: Episode) -> np.ndarray:
        """The wind now, ``(B, 3)`` [m/s]."""
        memory = episode.memory
        return gusty_wind(memory["gusts"], episode.state.time, memory["speed"], memory["heading"], GUST, BACKING)

    def controls(self, episode: Episode) -> Controls:
        state = episode.state
        controls = self.carry(episode, state.positions[:, :2, 0, 0], state.velocities[:, :2, 0, 0], self.follow)
        controls.wind = self.wind(episode)
        return controls

    def marks(self, episode: Episode, member: int) -> list[Mark]:
        pole = episode.state.positions[member, :, :, 0].mean(1)
        place = pole[:2] + SEEN_FROM * episode.memory["onlooker"][member]
        return [Mark("onlooker", np.array([[*place, 0.0], pole]))]

    def observe(self, episode: Episode) -> np.ndarray:
        state = episode.state
        pole, velocity = state.positions[:, :2, 0, 0], state.velocities[:, :2, 0, 0]
        return columns(pole, velocity, state.wind[:, :2], episode.memory["onlooker"])

    def shows(self, episode: Episode) -> np.ndarray:
        """The part of the area vector towards the onlooker, ``(B,)`` [m^2]; negative of the flag's other side."""
        return along(loop_area(episode.state.positions, self.border), episode.memory["onlooker"])

    def way(self, episode: Episode) -> np.ndarray:
        """What is shown of the area, and what moves, as the onlooker sees it: towards him, and to his left."""
        state, towards, xp = episode.state, episode.memory["onlooker"], array_namespace(episode.action)
        aside = xp.stack([-towards[:, 1], towards[:, 0]], axis=1)
        moving = state.positions[:, :, 0, 0], state.velocities[:, :, 0, 0], state.wind
        seen = [along(vector, way) for vector in moving for way in (towards, aside)]
        return columns(self.shows(episode) / self.area, *seen)

    def score(self, episode: Episode) -> tuple[np.ndarray, ...]:
        shown = ramp(abs(self.shows(episode)), self.area)
        return 1.0 - shown, shown
