"""The endurance benchmark counts what vector environments answer."""

import numpy as np
import pytest

from cloth_envs.world import World
from training.bench import endurance
from training.bench.participants import Participant

EXPLICIT = Participant("explicit", coarse=6)


@pytest.mark.parametrize("policy", endurance.MODES)
def test_every_policy_counts_its_episodes(policy: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(endurance, "MEMBERS", 2)
    row = endurance.endure("Hanging", EXPLICIT, policy, 2 * 260)
    assert (row.steps, row.episodes, row.truncated) == (520, 2, 2)
    assert (row.wrong, row.warnings, row.error) == (0, 0, "")
    assert f"{520:,}" in endurance.table([row])


def test_faults_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(endurance, "MEMBERS", 2)
    observe = World.observe
    monkeypatch.setattr(World, "observe", lambda self: observe(self) * np.float32(np.nan))
    assert endurance.endure("Flag", EXPLICIT, "random", 6).wrong == 6

    def fail(self: World) -> None:
        np.float64(1e308) * 10  # warns
        raise ArithmeticError("no luck")

    monkeypatch.setattr(World, "observe", lambda self: fail(self) if self.frames[0] else observe(self))
    row = endurance.endure("Flag", EXPLICIT, "random", 6)
    assert row.error == "ArithmeticError: no luck"
    assert row.warnings == 1
