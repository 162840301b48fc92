"""The one training loop: its schedules, and that it goes on bit for bit where it was stopped."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import pytest
import torch

from training.fit import Best, Kept, cosine, fit, halved


def network() -> torch.nn.Module:
    torch.manual_seed(0)
    return torch.nn.Linear(3, 2)


def run(kept: Kept | None, steps: int = 12, best_every: int = 0) -> tuple[torch.nn.Module, Best | None]:
    """A small regression whose batches come from a generator that goes on drawing."""
    net, rng = network(), np.random.default_rng(1)

    def loss(step: int) -> torch.Tensor:
        x = torch.from_numpy(rng.normal(size=(4, 3)).astype(np.float32))
        return ((net(x) - x[:, :2].sin()) ** 2).mean()

    best = Best(lambda: float(net.weight.detach().abs().sum()), best_every) if best_every else None
    fit(net, loss, steps, cosine(0.1, 12), clip=1.0, kept=kept, rng=rng, best=best)
    return net, best


def equal(a: torch.nn.Module, b: torch.nn.Module) -> bool:
    return all(torch.equal(x, y) for x, y in zip(a.parameters(), b.parameters(), strict=True))


@pytest.mark.parametrize("best_every", [0, 2])
def test_it_goes_on_where_it_stopped(
    tmp_path: Path, best_every: int, stopped: Callable[[int], AbstractContextManager[object]]
) -> None:
    kept = Kept(tmp_path / "made" / "net.pt", "recipe", every=5)
    whole, best = run(None, best_every=best_every)
    for steps in (7, 6):  # stops after 7 and 11, goes on from 5 and 10
        with stopped(steps):
            run(kept, best_every=best_every)
        assert [path.name for path in kept.path.parent.iterdir()] == ["net.pt"]
    found, again = run(kept, best_every=best_every)
    assert equal(found, whole)
    assert (best and best.least) == (again and again.least)
    assert equal(run(kept, best_every=best_every)[0], whole)  # what is done is not done again
    with pytest.raises(ValueError, match="remove it to start again"):
        run(Kept(kept.path, "another recipe"))


def test_the_best_weights_are_left() -> None:
    """Of those looked at: the start, every second step and the last one."""
    states = {steps: float(run(None, steps)[0].weight.detach().abs().sum()) for steps in (0, 2, 4, 6, 7)}
    net, best = run(None, 7, best_every=2)
    assert best is not None
    assert best.least == min(states.values()) == float(net.weight.detach().abs().sum())
    assert states[7] != best.least


def test_frozen_parameters_stay() -> None:
    net = network()
    net.bias.requires_grad_(False)
    before = [p.detach().clone() for p in net.parameters()]
    fit(net, lambda _: net(torch.ones(3)).sum(), 1, lambda _: 0.01)
    assert not torch.equal(before[0], net.weight)
    assert torch.equal(before[1], net.bias)


def test_schedules() -> None:
    falls = cosine(2.0, 10)
    assert falls(0) == 2.0
    assert falls(5) == pytest.approx(1.0)
    assert [cosine(2.0, 10, least=0.25)(k) - falls(k) for k in range(10)] == pytest.approx([0.5] * 10)
    rises = cosine(2.0, 1000, warm=4)
    assert [rises(k) / cosine(2.0, 1000)(k + 1) for k in range(6)] == pytest.approx([0.25, 0.5, 0.75, 1, 1, 1])
    steps = halved(1.0, 40)
    assert [steps(k) for k in (0, 3, 4, 8, 39)] == [1.0, 1.0, 0.5, 0.25, 0.5**9]
    assert halved(1.0, 3)(2) == 0.25
