"""The learner of ``examples/train_ppo.py``: gains, probabilities, ends of episodes, noise."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra 'train'")

import torch
from torch.distributions import Normal

from training.bench.agents.ppo import example

FRAMES = 16


def test_gains_and_probabilities_are_those_of_their_definitions(monkeypatch: pytest.MonkeyPatch) -> None:
    """On random rewards and ends: what is cut goes on, what terminates does not, and no gain reaches over an end."""
    ppo, rng = example(), np.random.default_rng(0)
    monkeypatch.setattr(ppo, "USUAL", ((FRAMES, FRAMES), 1, 1e-3, 1.0, np.inf))
    torch.manual_seed(0)
    players = ppo.Players("Pressure-v1", "miniature", {"factor": 4}, 0)
    players.env.close()
    agent, shape = ppo.Agent(players.task, players.seen.shape[1]), players.seen.shape
    nothing = SimpleNamespace(mean=np.zeros(shape[1]), var=np.ones(shape[1]), update=lambda _: None)
    agent.seen, agent.earned = nothing, SimpleNamespace(var=4.0, update=lambda _: None)
    torch.nn.init.orthogonal_(agent.actor[4].weight, 1.0)
    before, after, rewards = rng.normal(size=(2, FRAMES, *shape)), [], rng.normal(size=(FRAMES, ppo.MEMBERS))
    terminated, truncated = rng.random((2, FRAMES, ppo.MEMBERS)) < 0.1
    ended = terminated | truncated
    t, noises, taken, started = iter(range(FRAMES)), [players.noise], [], [players.seen]

    def step(actions: np.ndarray) -> tuple[Any, ...]:
        i = next(t)
        taken.append(actions)
        after.append(before[0, i])
        started.append(np.where(ended[i][:, None], before[1, i], before[0, i]))
        noises.append(players.noise)
        return before[0, i], rewards[i], terminated[i], truncated[i], {}

    def reset(options: dict[str, Any]) -> tuple[np.ndarray, dict[str, Any]]:
        assert (options["reset_mask"] == ended[len(after) - 1]).all()
        return started[-1], {}

    monkeypatch.setattr(players, "env", SimpleNamespace(step=step, reset=reset))
    parts = players.play(agent, 0.0)
    x, then, actions, lasting, told, gains, goals = (part.unflatten(0, (FRAMES, -1)).detach() for part in parts)
    with torch.no_grad():
        values, spread = agent.critic(x)[..., 0].numpy(), agent.spread()
        later = agent.critic(agent.scaled(np.array(after)))[..., 0].numpy() * ~terminated
        normal = Normal(agent.actor(x) + spread * lasting, spread * (1 - ppo.LASTING**2) ** 0.5)
    assert torch.equal(x, agent.scaled(np.array(started[:-1])))
    assert np.array_equal(actions.clamp(-1, 1).numpy(), taken)
    torch.testing.assert_close(lasting, ppo.LASTING * torch.stack(noises[:-1]))
    constant = normal.log_prob(actions).sum(-1) - told
    torch.testing.assert_close(constant, constant.mean().expand_as(constant), atol=1e-4, rtol=0)
    surprise = rewards / 2 + players.discount * later - values
    for member in range(ppo.MEMBERS):
        for i in range(FRAMES):
            last = next((k for k in range(i, FRAMES) if ended[k, member]), FRAMES - 1)
            weights = (players.discount * players.trace) ** np.arange(last - i + 1)
            assert gains[i, member] == pytest.approx(weights @ surprise[i : last + 1, member], abs=1e-4)
            goes_on = i + 1 < FRAMES and not ended[i, member]
            assert torch.equal(then[i, member], x[i + goes_on, member])
    np.testing.assert_allclose(goals, gains.numpy() + values, atol=1e-5)


@pytest.mark.parametrize(
    ("patience", "reward", "least", "most"), [(3, 0.0, 7, 8), (np.inf, 0.0, 0, 1), (3, 0.05, 0, 1)]
)
def test_episodes_of_no_reward_end_early(
    patience: float, reward: float, least: int, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    ppo, masks = example(), []
    monkeypatch.setattr(ppo, "OWN", {"BallDrop-v1": ((12, 36), 1, 1e-3, 1.0, patience)})
    players = ppo.Players("BallDrop-v1", "miniature", {"factor": 4}, 0)
    agent, step, reset = ppo.Agent(players.task, players.seen.shape[1]), players.env.step, players.env.reset

    def little(actions: np.ndarray) -> tuple[Any, ...]:
        seen, rewards, *others = step(actions)
        return seen, 0 * rewards + reward, *others

    def watched(options: dict[str, Any]) -> Any:
        masks.append(options["reset_mask"].copy())
        return reset(options=options)

    monkeypatch.setattr(players.env, "step", little)
    monkeypatch.setattr(players.env, "reset", watched)
    rows = players.play(agent, 0.5)
    players.env.close()
    assert {len(part) for part in rows} == {24 * ppo.MEMBERS}
    ended = np.sum([np.zeros(ppo.MEMBERS), *masks], axis=0)
    assert (ended >= least).all()
    assert (ended <= most).all()


def test_noise_is_calmed_as_far_as_a_recipe_says() -> None:
    ppo = example()
    torch.manual_seed(0)
    agent = ppo.Agent(SimpleNamespace(actions=("a",), extras=("b",) * 4), 4)
    optimizer, x = torch.optim.Adam(agent.parameters(), eps=1e-5), torch.randn(64, 4)
    data = [x, x, torch.zeros(64, 1), torch.zeros(64, 1), *torch.zeros(3, 64)]
    ppo.Players.learn(SimpleNamespace(batches=1, rate=0.0, calm=0.2), agent, optimizer, data, 1.0)
    assert agent.spread().item() == pytest.approx(0.02 + 0.2 * np.exp(-0.5))


@pytest.mark.parametrize("smooth", [True, False])
def test_answers_that_change_from_frame_to_frame_are_made_calm(smooth: bool) -> None:
    ppo = example()
    ppo.SMOOTH = tuple(smooth * weight for weight in ppo.SMOOTH)
    torch.manual_seed(0)
    agent = ppo.Agent(SimpleNamespace(actions=("a",), extras=("b",) * 4), 4)
    torch.nn.init.orthogonal_(agent.actor[4].weight, 2.0)
    x, then = torch.randn(2, 512, 4)
    mean, nothing = agent.actor(x).detach(), torch.zeros(512)
    told = agent.log_probability(x, mean, torch.zeros(512, 1)).detach()
    data = [x, then, mean, torch.zeros(512, 1), told, nothing, nothing]  # no action is better than another
    change = [(agent.actor(then) - agent.actor(x)).square().mean().item()]
    optimizer = torch.optim.Adam(agent.parameters(), eps=1e-5)
    for _ in range(10):
        ppo.Players.learn(SimpleNamespace(batches=1, rate=1e-3, calm=1.0), agent, optimizer, data, 0.0)
    change.append((agent.actor(then) - agent.actor(x)).square().mean().item())
    assert (change[1] < 0.1 * change[0]) == smooth
