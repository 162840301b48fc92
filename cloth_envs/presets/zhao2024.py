"""The four scenes of Zhao 2024 (physics-embedded CNN) as presets of Pressure, Hanging and BallDrop.

The paper states the model (eqs 1-5) and the scenes in words; the numbers are those of the author's public code, whose
loop changes velocities in place, row by row: dashpots see the new velocities of the particles before. Gravity
(9.8 m/s^2) and where the sheet lies along x and y are those of the Taichi example that it extends: our reading. The
units are the paper's: particles of 1 kg make a sheet of 16 t that is as stiff in proportion, so pressures are large.
"""

from typing import ClassVar

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.particles import Particles
from cloth_envs.scene import Collider, Scene
from cloth_envs.scenes import hanging
from cloth_envs.scenes.ball_drop import MARGIN, RADIUS, BallDrop
from cloth_envs.scenes.drives import Drive, draw_gust
from cloth_envs.scenes.hanging import Hanging
from cloth_envs.scenes.measures import length, tolerance
from cloth_envs.scenes.pressure import Pressure
from cloth_envs.scenes.task import Episode, Start, Task
from cloth_envs.state import Controls

VERTICES = 128  # along each side
GRID = Grid(VERTICES, VERTICES, (VERTICES - 1) / VERTICES, (VERTICES - 1) / VERTICES)  # spacing 1/128 m
GRAVITY = 9.8  # m/s^2
NET, BALL_NET = Particles(), Particles(stiffness=3e4, dashpot=1e4 / 128, drag=1.0)
BLOW, BREEZE = 187_500.0, 6_250.0  # the p of eq. 3 [Pa]
HEIGHT, HANG_HEIGHT = 0.6, 1.1  # m, of the flat sheet at the start
# Where the scenes come to rest with zero actions, measured (tests/test_presets.py): goals lie around it.
BLOWN, FALLEN = 0.756, 0.503  # m, the apex with and without pressure
HANG = 0.90  # m, from the corner down to the middle
HELD = 0.3  # m, height of the middle above the ball's lowest point from which on the cloth counts as held up


class Zhao2024(Task):
    """What the four share: the net of particles, which leaves no choice of material and resolution."""

    net: ClassVar[Particles] = NET
    max_strain = 20.0  # of the springs that all the weight hangs from
    fixed = ("material", "randomize", "resolution")
    size = (GRID.height, GRID.width)
    resolution = GRID.shape
    material = NET.sheet()

    def flat(self, height: float, memory: dict[str, np.ndarray], colliders: np.ndarray | None = None) -> Start:
        """Level and at rest at ``height`` [m], x from -0.5, y down from 0.5 m."""
        positions = np.empty((3, *GRID.shape))
        positions[0] = np.arange(VERTICES) / VERTICES - 0.5
        positions[1] = -positions[0].T
        positions[2] = height
        return Start(
            positions, np.zeros_like(positions), np.zeros((0, 2, 3)) if colliders is None else colliders, memory
        )


class Blow2024(Zhao2024, Pressure):
    """
    ## Description
    "Blow" of Zhao 2024: 128 x 128 particles, pinned along the border, blown up by the pressure p = 187,500.

    ## Action Space
    `Box(-1, 1, (1,))`: p is 187,500 (1 + action) at once, without a pump. Zero is the paper's constant pressure.

    ## Observation Space
    As in `Pressure`, with p over 187,500.

    ## Starting State
    Flat and at rest at the height 0.6 m. The target moves around the height where the apex comes to rest.

    ## Arguments
    `preset="zhao2024"`; it fixes `material`, `randomize` and `resolution`.

    ## What Is Modelled
    Springs to 12 neighbours and dashpots along them, gravity, drag, the pressure of eq. 3, pinned border.

    All else is as in `Pressure`.
    """

    still: ClassVar[float] = BLOW  # p with zero actions
    rest: ClassVar[float] = BLOWN

    @classmethod
    def build_scene(cls, grid: Grid, material: Material) -> Scene:
        pins = super().build_scene(grid, material).handles
        return Scene(
            "Pressure", grid, material, cls.frame_dt, handles=pins, pressure=True, gravity=GRAVITY, particles=cls.net
        )

    def start(self, rng: np.random.Generator) -> Start:
        return self.flat(HEIGHT, {"tones": draw_gust(rng)})

    def controls(self, episode: Episode) -> Controls:
        controls = self.hold(episode)
        controls.pressure = self.still + BLOW * episode.action[:, 0]
        return controls

    def target(self, episode: Episode) -> np.ndarray:
        return self.rest + super().target(episode)

    def observe(self, episode: Episode) -> np.ndarray:
        extras = super().observe(episode)
        extras[:, 2] = episode.state.pressure / BLOW
        return extras


class Fall2024(Blow2024):
    """
    ## Description
    "Fall" of Zhao 2024: 128 x 128 particles, pinned along the border, sag under their weight.

    ## Action Space
    `Box(-1, 1, (1,))`: the pressure p, +-1 is 187,500. Zero is the paper's sheet without pressure.

    ## Arguments
    `preset="zhao2024-fall"`; it fixes `material`, `randomize` and `resolution`.

    All else is as in `preset="zhao2024"` of `Pressure`.
    """

    still = 0.0
    rest = FALLEN


class Hang2024(Zhao2024, Hanging):
    """
    ## Description
    "Hang" of Zhao 2024: 128 x 128 particles swing from one pinned corner in a constant breeze, the pressure p = 6,250.

    ## Action Space
    As in `Hanging`: velocity of the corner, which stays within 0.8 m (x, y) and 0.4 m (z) of where it started. With
    zero actions it stays.

    ## Observation Space
    As in `Hanging`, with p over 6,250 as the breeze.

    ## Starting State
    Flat and at rest at the height 1.1 m; only the corner's particle is held. The goal is random.

    ## Arguments
    `preset="zhao2024"`; it fixes `material`, `randomize` and `resolution`.

    ## What Is Modelled
    Springs to 12 neighbours and dashpots along them, gravity, drag, the pressure of eq. 3. All the weight hangs from
    one particle, whose springs stretch to several times their length.

    All else is as in `Hanging`.
    """

    CORNER = np.array([-0.5, 0.5, HANG_HEIGHT])

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self.drive = Drive(
            (self.CORNER + hanging.LOW).tolist(),
            (self.CORNER + hanging.HIGH).tolist(),
            speed=hanging.SPEED,
            acceleration=hanging.ACCELERATION,
            dt=self.frame_dt,
        )

    @classmethod
    def build_scene(cls, grid: Grid, material: Material) -> Scene:
        return Scene(
            "Hanging", grid, material, cls.frame_dt, handles=(0,), pressure=True, gravity=GRAVITY, particles=cls.net
        )

    def start(self, rng: np.random.Generator) -> Start:
        goal = self.CORNER + rng.uniform(hanging.GOAL_LOW, hanging.GOAL_HIGH) - [0.0, 0.0, HANG]
        return self.flat(HANG_HEIGHT, {"goal": goal})

    def controls(self, episode: Episode) -> Controls:
        state = episode.state
        controls = self.carry(episode, state.positions[:, :, 0, 0], state.velocities[:, :, 0, 0], self.follow)
        controls.pressure[:] = BREEZE
        return controls

    def observe(self, episode: Episode) -> np.ndarray:
        extras = super().observe(episode)
        extras[:, 15] = episode.state.pressure / BREEZE
        return extras


class Ball2024(Zhao2024, BallDrop):
    """
    ## Description
    "Ball" of Zhao 2024: 128 x 128 particles fall on a ball of radius 0.3 m at the origin. There is no ground.

    ## Action Space
    As in `BallDrop`: velocity of the ball along x and y. With zero actions it stays at the origin.

    ## Rewards
    `tolerance(distance of the middle from the ball's axis, 0.35 m) * held`, in [0, 1]; held is the middle's height
    above the ball's lowest point over 0.3 m, at most 1.

    ## Starting State
    Flat and at rest at the height 0.6 m above the ball's centre; nothing is random.

    ## Arguments
    `preset="zhao2024"`; it fixes `material`, `randomize` and `resolution`.

    ## What Is Modelled
    Springs to 12 neighbours and dashpots along them, gravity, drag, contact with the ball: inside it an inward velocity
    is removed and the rest is multiplied by 0.95 a step of 0.3125 ms. Particles that have come in are not pushed out.

    All else is as in `BallDrop`.
    """

    net = BALL_NET
    material = BALL_NET.sheet()

    @classmethod
    def build_scene(cls, grid: Grid, material: Material) -> Scene:
        ball = Collider("sphere", RADIUS, 0.0, "ball")
        return Scene("BallDrop", grid, material, cls.frame_dt, colliders=(ball,), gravity=GRAVITY, particles=cls.net)

    def start(self, rng: np.random.Generator) -> Start:
        return self.flat(HEIGHT, {}, np.zeros((1, 2, 3)))

    def score(self, episode: Episode) -> tuple[np.ndarray, ...]:
        away = self.middle(episode) - episode.state.colliders[:, 0, 0]
        held = ((away[:, 2] + RADIUS) / HELD).clip(0.0, 1.0)
        return length(away[:, :2]), tolerance(away[:, :2], MARGIN), held
