"""Proximal policy optimisation (Schulman et al. 2017, arXiv:1707.06347) of a small network, as one visible loop.

Every update plays one episode of each member from seeds that no other update has, and goes over it in shuffled
minibatches. Observations are scaled by their running mean and spread, rewards by that of their discounted sum.
"""

from dataclasses import dataclass

import numpy as np
import torch
from gymnasium.utils.seeding import np_random
from torch import Tensor, nn

from cloth_envs.world import World
from training.bench.transfer.policies import FIRST_SEED


@dataclass(frozen=True)
class Recipe:
    """How PPO is run: ``discount`` and ``trace`` (lambda) of the advantages, ``clip`` of the ratio of probabilities."""

    updates: int = 60
    epochs: int = 8
    minibatch: int = 400
    rate: float = 1e-3
    discount: float = 0.97
    trace: float = 0.95
    clip: float = 0.2
    entropy: float = 0.0
    value: float = 0.5
    largest: float = 0.5  # norm of the gradient
    spread: float = 0.6  # of actions, at first


class Running:
    """Mean and variance of all that it was shown, column by column (Chan, Golub & LeVeque 1979)."""

    def __init__(self, size: int) -> None:
        self.count, self.mean, self.square = 1e-4, np.zeros(size), np.ones(size) * 1e-4

    def add(self, values: np.ndarray) -> None:
        """Rows ``(N, size)`` more."""
        count, mean = len(values), values.mean(0)
        both, off = self.count + count, mean - self.mean
        self.square += ((values - mean) ** 2).sum(0) + off**2 * self.count * count / both
        self.mean, self.count = self.mean + off * count / both, both

    @property
    def deviation(self) -> np.ndarray:
        """The square root of the variance, kept off zero."""
        return np.sqrt(self.square / self.count + 1e-8)


def _network(*sizes: int, last: float) -> nn.Sequential:
    """Layers with tanh between them, orthogonal; the last one's gain is ``last``."""
    layers: list[nn.Module] = []
    for i, (into, out) in enumerate(zip(sizes, sizes[1:], strict=False)):
        layer = nn.Linear(into, out)
        nn.init.orthogonal_(layer.weight, last if i == len(sizes) - 2 else 2**0.5)
        nn.init.zeros_(layer.bias)
        layers += [layer, nn.Tanh()]
    return nn.Sequential(*layers[:-1])


class Agent(nn.Module):
    """A Gaussian around a network of 64 x 64 for actions, another network for values; observations are scaled."""

    def __init__(self, observed: int, actions: int, spread: float) -> None:
        super().__init__()
        self.seen = Running(observed)
        self.actor, self.critic = _network(observed, 64, 64, actions, last=0.01), _network(observed, 64, 64, 1, last=1)
        self.log_spread = nn.Parameter(torch.full((actions,), float(np.log(spread))))

    def scaled(self, obs: np.ndarray) -> Tensor:
        """What the networks are given."""
        return torch.as_tensor(np.clip((obs - self.seen.mean) / self.seen.deviation, -10, 10), dtype=torch.float32)

    def gaussian(self, scaled: Tensor) -> torch.distributions.Normal:
        """Of which actions are drawn, each component alone."""
        return torch.distributions.Normal(self.actor(scaled), self.log_spread.exp())

    @torch.no_grad()
    def act(self, obs: np.ndarray) -> np.ndarray:
        """The middle of the Gaussian within bounds, ``(B, A)``."""
        return self.actor(self.scaled(obs)).clamp(-1, 1).numpy().astype(np.float64)


def advantages(rewards: Tensor, values: Tensor, alive: Tensor, recipe: Recipe) -> Tensor:
    """Generalised advantages (Schulman et al. 2016, arXiv:1506.02438), ``(T, B)``.

    ``values`` ``(T + 1, B)`` go on behind the last frame, where an episode is cut and not over; nothing follows a frame
    after which a member is not ``alive`` ``(T, B)``.
    """
    out, following = torch.zeros_like(rewards), torch.zeros_like(rewards[0])
    for t in range(len(rewards) - 1, -1, -1):
        surprise = rewards[t] + recipe.discount * values[t + 1] * alive[t] - values[t]
        following = surprise + recipe.discount * recipe.trace * alive[t] * following
        out[t] = following
    return out


def train(world: World, recipe: Recipe, *, frames: int, seed: int) -> Agent:
    """An agent after all updates of episodes of ``frames``; its seeds and noise follow from ``seed`` alone."""
    members, size = world.num_envs, len(world.task.actions)
    noise = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        agent = Agent(world.observer.space.shape[0], size, recipe.spread)
    optimizer = torch.optim.Adam(agent.parameters(), lr=recipe.rate, eps=1e-5)
    earned, sums = Running(1), np.zeros(members)
    for update in range(recipe.updates):
        for group in optimizer.param_groups:
            group["lr"] = recipe.rate * (1 - update / recipe.updates)
        first = FIRST_SEED * (seed + 1) + update * members
        world.reset({i: np_random(first + i)[0] for i in range(members)})
        sums[:] = 0
        kept: list[list[Tensor]] = []
        going, total = np.ones(members, bool), 0.0
        obs = world.observe()
        for _ in range(frames):
            agent.seen.add(obs)
            with torch.no_grad():
                scaled = agent.scaled(obs)
                chosen = agent.gaussian(scaled)
                actions = torch.normal(chosen.mean, chosen.stddev, generator=noise)
                told = chosen.log_prob(actions).sum(1)
            rewards, reasons = world.step(actions.clamp(-1, 1).numpy().astype(np.float64))
            before, going = going, going & [reason is None for reason in reasons]
            total += float((rewards * going).sum())
            sums = sums * recipe.discount + rewards
            earned.add(sums[:, None])
            kept.append(
                [
                    scaled,
                    actions,
                    told,
                    torch.as_tensor(rewards / earned.deviation),
                    *map(torch.as_tensor, (going, before)),
                ]
            )
            obs = world.observe()
        print(update, total / frames / members, agent.log_spread.exp().tolist(), flush=True)
        scaled, actions, told, rewards, alive, counted = (torch.stack(column) for column in zip(*kept, strict=True))
        with torch.no_grad():
            values = agent.critic(torch.cat([scaled, agent.scaled(obs)[None]]))[..., 0]
        ahead = advantages(rewards.float(), values, alive.float(), recipe)
        data = [part[counted] for part in (scaled, actions, told, ahead, ahead + values[:-1])]
        for _ in range(recipe.epochs):
            for chosen_rows in torch.randperm(len(data[0]), generator=noise).split(recipe.minibatch):
                x, a, old, gain, goal = (part[chosen_rows] for part in data)
                around = agent.gaussian(x)
                ratio = (around.log_prob(a).sum(1) - old).exp()
                gain = (gain - gain.mean()) / (gain.std() + 1e-8)
                better = torch.minimum(ratio * gain, ratio.clamp(1 - recipe.clip, 1 + recipe.clip) * gain).mean()
                loss = (
                    recipe.value * ((agent.critic(x)[:, 0] - goal) ** 2).mean()
                    - better
                    - recipe.entropy * around.entropy().sum(1).mean()
                )
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), recipe.largest)
                optimizer.step()
    return agent
