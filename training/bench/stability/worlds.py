"""Worlds of ``minicloth bench stability``: a scene's episode, changed by one level along one axis."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from gymnasium.utils.seeding import np_random

from cloth_envs.policies import open_loop
from cloth_envs.registry import load_task
from cloth_envs.scene import Scene
from cloth_envs.scenes.task import Episode
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from training.bench.benchmark import MEASURED
from training.rollouts import retime
from training.truth import DETAILED, Case, unseen

DURATION = 0.64  # s of a run, a whole number of frames of four times any scene's
LENGTHS = (25, 50, 100, 150, 250)  # frames; the longest is ten times the longest horizon of `bench speed-accuracy`
BALL_END, BALL_WAY = 0.3, 0.6  # m: where a shot ball stops (y), and least way of its front before it is half through
BALL_SPEED, BALL_RADIUS = 4.0, 0.2  # m/s, m: of the axis that does not vary it
FREE_SPEED = 1.0  # m/s, root mean square of what a free cloth starts with
SHEETS, EVERY = ("Curtain", "Flag", *DETAILED), (*MEASURED, *DETAILED)
POLICIES = ("zero", "smooth", "bang-bang", "random", "alternating")  # bang-bang and random ones have axes of their own


@dataclass(frozen=True, eq=False)
class Stage:
    """``start`` and the ``controls`` of all frames in ``scene``."""

    scene: Scene
    start: State
    controls: Sequence[Controls]


class Base(NamedTuple):
    """Whose episode: a scene, a seed, a grid ``coarse`` times coarser."""

    scene: str
    seed: int
    coarse: float = 1.0


def episode(base: Base, frames: int, policy: str = "smooth") -> Stage:
    """An episode's start and controls.

    Controls follow from handles, bodies, time and actions alone, so no cloth is computed for them.
    """
    world = World(base.scene, **Case(base.scene, coarse=base.coarse, sequence=unseen(base.scene)).place)
    world.reset({0: np_random(base.seed)[0]})
    scene, start, now = world.scene, world.state.copy(), world.state.astype(np.float64)
    scripted, size = [], len(world.task.actions)
    actions = open_loop(policy, max(frames, 200), size, scene.frame_dt, base.seed)[:frames]
    assert world.episode is not None
    for action in actions:
        given = world.task.controls(Episode(now, world.episode.memory, action[None]))
        scripted.append(Controls(**{name: np.array(value) for name, value in vars(given).items()}))
        now = driven(scene, now, given)
    return Stage(scene, start, scripted)


def driven(scene: Scene, state: State, controls: Controls) -> State:
    """``state`` a frame later if nothing but what is driven moved."""
    after = state.copy()
    for name, handles in (("positions", controls.handle_positions), ("velocities", controls.handle_velocities)):
        getattr(after, name).reshape(state.batch, 3, -1)[..., list(scene.handles)] = handles.transpose(0, 2, 1)
    after.colliders[:], after.collider_velocities[:] = controls.colliders, controls.collider_velocities
    after.wind, after.pressure = controls.wind.copy(), controls.pressure.copy()
    after.time = state.time + scene.frame_dt
    return after


def _plain(base: Base, policy: str = "smooth") -> Stage:
    return episode(base, round(DURATION / load_task(base.scene).frame_dt), policy)


def _changed(change: Callable[[Stage, float], dict[str, Any]]) -> Callable[[Base, float], Stage]:
    """What makes a plain world with the fields of its ``Stage`` that ``change`` gives."""

    def make(base: Base, level: float) -> Stage:
        stage = _plain(base)
        return replace(stage, **change(stage, level))

    return make


def _frame(stage: Stage, level: float) -> dict[str, Any]:
    controls = retime(stage.scene, stage.start, stage.controls, level)
    return {"scene": replace(stage.scene, frame_dt=stage.scene.frame_dt * level), "controls": controls}


def _stiffness(stage: Stage, level: float) -> dict[str, Any]:
    """All stiffnesses; the dashpots' constants stay (``damping`` is a time)."""
    m = stage.scene.material
    stiff = {n: getattr(m, n) * level for n in ("stretch_stiffness", "shear_stiffness", "bend_stiffness")}
    return {"scene": stage.scene.with_material(m.with_changes(**stiff, damping=m.damping / level))}


def _mass(stage: Stage, level: float) -> dict[str, Any]:
    m = stage.scene.material
    return {"scene": stage.scene.with_material(m.with_changes(areal_density=m.areal_density * level))}


def _wind(stage: Stage, level: float) -> dict[str, Any]:
    air = stage.scene.air
    assert air is not None
    strong = replace(stage.scene, air=replace(air, max_wind=air.max_wind * max(level, 1)))
    return {"scene": strong, "controls": [replace(c, wind=c.wind * level) for c in stage.controls]}


def _turned(stage: Stage, level: float) -> dict[str, Any]:
    """The wind turned by ``level`` degrees; the flag still starts downwind of where it was."""
    cos, sin = np.cos(np.radians(level)), np.sin(np.radians(level))
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    return {"controls": [replace(c, wind=c.wind @ turn.T) for c in stage.controls]}


def _pressure(stage: Stage, level: float) -> dict[str, Any]:
    return {"controls": [replace(c, pressure=c.pressure * level) for c in stage.controls]}


def _free(base: Base, level: float) -> Stage:
    """No force from outside: no handles, gravity, air or bodies, and smooth random velocities."""
    stage = episode(base, round(level))
    material = stage.scene.material.with_changes(drag=0.0)
    scene = replace(
        stage.scene, material=material, handles=(), grips=(), gravity=0.0, air=None, pressure=False, colliders=(),
    )  # fmt: skip
    v, u = np.meshgrid(*(np.linspace(0, np.pi, n) for n in scene.grid.shape), indexing="ij")
    rng, start = np.random.default_rng(base.seed), stage.start.copy()
    waves = np.array([np.cos(i * v) * np.cos(j * u) for i in range(3) for j in range(3)])
    speed = np.tensordot(rng.normal(size=(3, 9)), waves, 1)
    start.velocities[0] = FREE_SPEED * speed / np.sqrt((speed**2).sum(0).mean())
    start.colliders, start.collider_velocities = np.zeros((2, 1, 0, 2, 3), np.float32)
    return replace(stage, scene=scene, start=start, controls=[Controls.hold(start, ())] * round(level))


def shot(base: Base, *, speed: float, radius: float) -> Stage:
    """A ball flies along y into the hanging cloth at constant ``speed`` and stops within one frame 0.3 m behind it."""
    stage = _plain(base, "zero")
    body, *others = stage.scene.colliders
    scene = replace(stage.scene, colliders=(replace(body, radius=radius), *others))
    dt, rng, start = scene.frame_dt, np.random.default_rng(base.seed), stage.start.copy()
    moving = int(np.ceil((BALL_WAY + radius) / (speed * dt)))
    x, z = rng.uniform(-0.15, 0.15), rng.uniform(-0.9, -0.6)
    start.colliders[:, 0] = x, BALL_END - moving * speed * dt, z
    start.collider_velocities[:, 0] = 0, speed, 0
    given = []
    for frame, control in enumerate(stage.controls, 1):
        at, fast = control.colliders.copy(), control.collider_velocities.copy()
        at[:, 0] = x, BALL_END - max(moving - frame, 0) * speed * dt, z
        fast[:, 0] = 0, speed * (frame < moving), 0
        given.append(replace(control, colliders=at, collider_velocities=fast))
    return replace(stage, scene=scene, start=start, controls=given)


@dataclass(frozen=True)
class Axis:
    """``levels`` and how a world is made of one; the ``scenes`` that it belongs to (none: all), the ``usual`` ones.

    Where ``cut``, the levels are frames of one run.
    """

    title: str
    levels: Sequence[float]
    make: Callable[[Base, float], Stage]
    scenes: Sequence[str] = ()
    label: Callable[[float], str] = lambda level: f"\u00d7{Fraction(level).limit_denominator(16)}"
    cut: bool = False
    usual: Sequence[str] = ("Curtain", "Flag")

    def of(self, scenes: Sequence[str] | None) -> Sequence[str]:
        """Those of ``scenes`` that it belongs to; of none, its own or the usual ones."""
        if scenes is None:
            return self.scenes or self.usual
        return [scene for scene in scenes if not self.scenes or scene in self.scenes]

    def runs(self, *, ends: bool = False) -> list[float]:
        """The levels that need a run of their own; of several only the ``ends``."""
        chosen = self.levels[-1:] if self.cut else [self.levels[0], self.levels[-1]] if ends else self.levels
        return [float(level) for level in chosen]

    def marks(self, level: float, frames: int) -> list[tuple[float, int]]:
        """The levels that a run of ``frames`` at ``level`` tells of, and the frames of each."""
        return [(float(n), round(n)) for n in self.levels] if self.cut else [(level, frames)]


AXES: dict[str, Axis] = {
    "frame": Axis("frame step", (1 / 2, 1, 2, 3, 4), _changed(_frame), usual=SHEETS),
    "stiffness": Axis("stiffness", (1 / 4, 1 / 2, 1, 2, 4, 8, 16), _changed(_stiffness), usual=SHEETS),
    "mass": Axis("mass", (1 / 3, 1 / 2, 1, 2, 3), _changed(_mass), usual=SHEETS),
    "resolution": Axis(
        "resolution", (1 / 2, 3 / 4, 1, 3 / 2, 2), lambda base, level: _plain(base._replace(coarse=base.coarse / level))
    ),
    "length": Axis(
        "length of the rollout [frames]", LENGTHS, lambda base, level: episode(base, round(level)),
        label="{:g}".format, cut=True, usual=SHEETS,
    ),
    "actions": Axis(
        "actions", (0, 1, 4), lambda base, level: _plain(base, POLICIES[round(level)]),
        label=lambda level: POLICIES[round(level)], usual=EVERY,
    ),
    "random": Axis(
        "random actions [frames]", (10, 25, 50, 100),
        lambda base, level: episode(base, round(level), "random"), label="{:g}".format, cut=True, usual=EVERY,
    ),
    "bang-bang": Axis(
        "bang-bang actions [frames]", (25, 50, 100, 200), lambda base, level: episode(base, round(level), "bang-bang"),
        label="{:g}".format, cut=True, usual=EVERY,
    ),
    "wind": Axis("wind speed", (0, 1 / 2, 1, 3 / 2, 2, 3), _changed(_wind), ("Flag",)),
    "direction": Axis("wind turned [degrees]", (0, 45, 90, 135, 180), _changed(_turned), ("Flag",), "{:g}".format),
    "pressure": Axis("pressure", (0, 1 / 2, 1, 2, 3, 4), _changed(_pressure), ("Pressure",)),
    "ball speed": Axis(
        f"speed of a ball, radius {BALL_RADIUS:g} m [m/s]", (1, 2, 4, 8, 16, 24),
        lambda base, level: shot(base, speed=level, radius=BALL_RADIUS), ("Collision",), "{:g}".format,
    ),
    "ball radius": Axis(
        f"radius of a ball at {BALL_SPEED:g} m/s [m]", (0.0125, 0.025, 0.05, 0.1, 0.2, 0.3),
        lambda base, level: shot(base, speed=BALL_SPEED, radius=level), ("Collision",), "{:g}".format,
    ),
    "free": Axis("no force from outside [frames]", LENGTHS, _free, ("Curtain",), "{:g}".format, cut=True),
}  # fmt: skip
