"""The look-up of bodies near vertices misses none: what moves is the same where all are tested."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cloth_envs.grid import Grid
from cloth_envs.material import FABRICS
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.scene import Collider, Scene
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from training.rollouts import record

FAR, FAST = 500.0, 10.0  # m, m/s: over 1 cm in eight substeps, in which nothing is looked up


def with_another(state: State, place: np.ndarray, speed: np.ndarray) -> State:
    """The same beside another body."""
    state = state.copy()
    state.colliders = np.concatenate([state.colliders, place], 1)
    state.collider_velocities = np.concatenate([state.collider_velocities, speed], 1)
    return state


@pytest.mark.parametrize(
    ("scene", "options", "batch"),
    [
        ("Skirt", {"preset": {"name": "chen2020", "tempo": 1.0}, "resolution": (25, 52)}, 1),
        ("Skirt", {"preset": {"name": "chen2020", "tempo": 4.0}, "resolution": (25, 52)}, 1),
        ("Collision", {"resolution": (21, 15)}, 3),
    ],
)
def test_the_look_up_of_bodies_misses_none(scene: str, options: dict[str, Any], batch: int) -> None:
    """Another body, far away, moves so fast that every body is tested at every vertex, or it stands still.

    Dances are 8 and 32 times as fast as the preset's; of a batch the cloths lie in the lanes of vectors. Half-way all
    starts anew.
    """
    world, frames = World(scene, num_envs=batch, **options), 30
    actions = np.sign(np.random.default_rng(1).normal(size=(frames, batch, len(world.task.actions))))
    run = record(world, actions, [0], seeds=range(batch))
    far = replace(run.scene, colliders=(*run.scene.colliders, Collider("sphere", 0.05)))
    ends = []
    for rate in (0.0, FAST):
        solver = ExplicitSolver(far, num_envs=batch)
        path = []
        for _ in range(2):
            speed = np.zeros((batch, 1, 2, 3))
            speed[..., 0] = rate
            place = np.full((batch, 1, 2, 3), FAR)
            solver.reset(with_another(run.states[0], place, speed))
            for number, controls in enumerate(run.controls):
                more = Controls(**vars(controls))
                more.colliders = np.concatenate([controls.colliders, place + (number + 1) * far.frame_dt * speed], 1)
                more.collider_velocities = np.concatenate([controls.collider_velocities, speed], 1)
                path.append(solver.advance(more).positions.copy())
        ends.append(np.stack(path))
    np.testing.assert_array_equal(ends[0], ends[1])
    touched = np.linalg.norm(ends[0][frames - 1] - ends[0][0], axis=1).max()
    assert touched > 0.05  # m


@pytest.mark.parametrize(("pulled", "gap"), [(0.04, 0.017), (0.05, 0.025), (0.06, 0.035)])
def test_cloth_that_speeds_up_from_rest_meets_what_is_in_its_way(pulled: float, gap: float) -> None:
    """One vertex, ``pulled`` [m] out of a sheet at rest, snaps back onto a thin rod, ``gap`` [m] below it at first."""
    grid, rod = Grid(21, 21, 0.5, 0.5), Collider("capsule", 0.002)
    scene = Scene("rod", grid, FABRICS["cotton"], 0.02, colliders=(rod,), gravity=0.0)
    side = np.linspace(-0.25, 0.25, 21)
    positions = np.stack([*np.meshgrid(side, side, indexing="ij"), np.zeros((21, 21))])[None]
    positions[0, 2, 10, 10] = pulled
    height = pulled - gap - rod.radius - scene.thickness
    place = np.array([[[[0.0, -0.5, height], [0.0, 0.5, height]]]])
    solver = ExplicitSolver(scene)
    solver.reset(State.still(positions, place))
    none = np.zeros((1, 0, 3))
    still = Controls(none, none, place, 0 * place, np.zeros((1, 3)), np.zeros(1))
    assert solver.advance(still).positions[0, 2, 10, 10] > height
