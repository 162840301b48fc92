"""The benchmark of drawn cloth: the reference against itself is perfect, and what is not mended is told."""

import pytest

from cloth_envs.world import World
from training.bench import wrinkles
from training.bench.participants import WRINKLES, Participant
from training.rollouts import seeded_actions


def test_rows_tell_a_cloth_from_a_smooth_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wrinkles, "STARTS", (5,))
    world, seeds = World("Hanging", num_envs=2), wrinkles.SEEDS[:2]
    moves = seeded_actions(world, seeds, ["bang-bang"], 20)
    truth = wrinkles.watch(world, moves, seeds, (5, 10, 15))
    same, mended, smooth = (
        wrinkles.compare(one, "Hanging", "bang-bang", moves, truth, world)
        for one in (Participant("explicit"), *WRINKLES[2:])
    )
    assert (same.bending, same.acceleration, same.lost, same.error_5) == (1, 1, 0, 0)
    assert same.strain == same.strain_truth < mended.strain < smooth.strain / 2
    assert smooth.bending < mended.bending
    assert mended.error_5 < mended.error_10
    assert "mini \u00d74 not mended" in wrinkles.table([same, mended, smooth])
