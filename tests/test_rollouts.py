"""The one rollout loop: what it records can be replayed, and cut into pairs of one frame."""

from __future__ import annotations

import numpy as np
import pytest

from cloth_envs.registry import load_task
from cloth_envs.state import State
from cloth_envs.world import World
from training.rollouts import one_frame_pairs, record, replay, seeded_actions, stack_states

SMALL = {"resolution": (9, 13)}


def test_what_is_recorded_is_replayed() -> None:
    """Bit for bit by a backend without a memory, from the start and from any frame on, and without a new start."""
    world = World("Flag", num_envs=2, randomize={"areal_density": (0.1, 0.3)}, **SMALL)
    run = record(world, seeded_actions(world, [3, 4], ["smooth", "random"], 6), range(7), seeds=[3, 4])
    assert run.good == [0, 1]
    other = World("Flag", num_envs=2, **SMALL).backend
    again = [state for state, _ in replay(other, run.states[0], run.controls[:4], run.materials)]
    again += [state for state, _ in replay(other, None, run.controls[4:])]
    for frame, state in enumerate(again, 1):
        np.testing.assert_array_equal(state.positions, run.states[frame].positions)
    one = run.only([1])
    single = World("Flag", **SMALL).backend
    ends = [state for state, _ in replay(single, one.states[2], one.controls[2:], one.materials)]
    np.testing.assert_array_equal(ends[-1].positions[0], run.states[6].positions[1])


def test_actions_may_be_drawn_after_the_start_and_less_may_be_kept() -> None:
    """A world of a task's class is that of its name; one generator serves the start and then the actions."""
    worlds, rng = [World(scene, **SMALL) for scene in ("Hanging", load_task("Hanging"))], np.random.default_rng(5)

    def drawn():  # type: ignore[no-untyped-def]
        for _ in range(3):
            yield rng.uniform(-1, 1, (1, len(worlds[1].task.actions)))

    def middle(state: State) -> State:
        return State.still(state.positions[..., 4:5, 6:7].copy())

    found = record(worlds[1], drawn(), [0, 3], seeds=[rng], take=middle)
    assert sorted(found.states) == [0, 3]
    same = np.random.default_rng(5)
    worlds[0].reset({0: same})
    actions = [same.uniform(-1, 1, (1, len(worlds[0].task.actions))) for _ in range(3)]
    run = record(worlds[0], actions, [3], seeds=[np.random.default_rng(5)])
    np.testing.assert_array_equal(found.states[3].positions[..., 0, 0], run.states[3].positions[..., 4, 6])


def test_pairs_of_one_frame() -> None:
    """A surrogate that steps ``before`` under ``controls`` and ``materials`` is to give ``after``."""
    pairs = one_frame_pairs(
        "Collision", [0, 1], 3, policies=("smooth", "bang-bang"), randomize={"drag": (0.1, 0.5)}, **SMALL
    )
    assert pairs.before.batch == pairs.after.batch == len(pairs.materials) == len(pairs.controls.wind) == 6
    assert len({material.drag for material in pairs.materials}) == 2
    backend = World("Collision", num_envs=6, **SMALL).backend
    assert backend.scene.grid == pairs.scene.grid
    after = next(replay(backend, pairs.before, [pairs.controls], pairs.materials))[0]
    np.testing.assert_array_equal(after.positions, pairs.after.positions)
    np.testing.assert_array_equal(after.velocities, pairs.after.velocities)
    for first in (0, 3):  # frame after frame of one episode
        middle = pairs.after.select(slice(first, first + 2))
        np.testing.assert_array_equal(pairs.before.select(slice(first + 1, first + 3)).positions, middle.positions)
    joined = stack_states([pairs.before.select([k]) for k in range(6)])
    np.testing.assert_array_equal(joined.positions, pairs.before.positions)


def test_episodes_that_fail_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    step = World.step

    def fails(self: World, actions: np.ndarray) -> tuple[np.ndarray, list[str | None]]:
        rewards, reasons = step(self, actions)
        return rewards, ["overstretch" if i in broken and self.frames[0] == 2 else r for i, r in enumerate(reasons)]

    monkeypatch.setattr(World, "step", fails)
    broken = {0}
    kept = one_frame_pairs("Flag", [7, 8], 3, **SMALL)
    assert kept.before.batch == 3
    world = World("Flag", num_envs=2, **SMALL)
    run = record(world, seeded_actions(world, [7, 8], ["smooth"], 3), [0], seeds=[7, 8])
    assert run.failures == ["overstretch at frame 2", ""]
    np.testing.assert_array_equal(kept.before.positions[0], run.states[0].positions[1])
    broken = {0, 1}
    with pytest.raises(ValueError, match="choose other seeds"):
        one_frame_pairs("Flag", [7, 8], 3, **SMALL)
