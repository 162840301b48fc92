"""Proximal policy optimisation (Schulman et al. 2017, arXiv:1707.06347) of a small network, as one visible loop.

Every update plays one episode of each member, from seeds that no other update has, and goes over it in shuffled
minibatches. Observations are scaled by their running mean and spread, rewards by the spread of their discounted sums.
On a world whose backend is on a device all of it is there.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from gymnasium.utils.seeding import np_random
from torch import Tensor, nn

from cloth_envs.world import World
from training.bench.transfer.policies import FIRST_SEED


@dataclass(frozen=True)
class Recipe:
    """How it is run: time [s] in which a reward's worth falls to 1/e (``horizon``), ``trace`` (lambda) of advantages,
    ``clip`` of the ratio of probabilities, weight of the ``value`` loss, ``largest`` norm of a gradient, ``spread`` of
    actions at first.
    """

    updates: int = 60
    epochs: int = 8
    minibatch: int = 400
    rate: float = 1e-3
    horizon: float = 0.65
    trace: float = 0.95
    clip: float = 0.2
    value: float = 0.5
    largest: float = 0.5
    spread: float = 0.6


class Running:
    """Mean and variance of all rows that it was shown, column by column (Chan, Golub & LeVeque 1979)."""

    def __init__(self, size: int, device: torch.device | None = None) -> None:
        self.count = 0
        self.mean, self.square = torch.zeros((2, size), dtype=torch.float64, device=device)

    def add(self, rows: Tensor) -> None:
        """``(N, size)`` more."""
        rows = rows.double()
        middle, both = rows.mean(0), self.count + len(rows)
        off = middle - self.mean
        self.square = self.square + ((rows - middle) ** 2).sum(0) + off**2 * (self.count * len(rows) / both)
        self.mean, self.count = self.mean + off * (len(rows) / both), both

    @property
    def spread(self) -> Tensor:
        """The standard deviation, kept off zero."""
        return (self.square / max(self.count, 1) + 1e-8).sqrt()


def network(*sizes: int, last: float) -> nn.Sequential:
    """Layers with tanh between them, orthogonal at first; the last one's gain is ``last``."""
    layers: list[nn.Module] = []
    for into, out in pairwise(sizes):
        layer = nn.Linear(into, out)
        nn.init.orthogonal_(layer.weight, last if out == sizes[-1] else 2**0.5)
        nn.init.zeros_(layer.bias)
        layers += [layer, nn.Tanh()]
    return nn.Sequential(*layers[:-1])


class Agent(nn.Module):
    """A Gaussian around what a network of 64 x 64 says of scaled observations, and such a network for their values."""

    def __init__(self, observed: int, actions: int, spread: float, device: torch.device | None = None) -> None:
        super().__init__()
        self.seen = Running(observed, device)
        self.actor, self.critic = network(observed, 64, 64, actions, last=0.01), network(observed, 64, 64, 1, last=1.0)
        self.log_spread = nn.Parameter(torch.full((actions,), float(np.log(spread))))
        self.to(device)

    def scaled(self, obs: Tensor) -> Tensor:
        """What the networks are given."""
        return ((obs - self.seen.mean) / self.seen.spread).clamp(-10, 10).float()

    def log_probability(self, scaled: Tensor, actions: Tensor) -> Tensor:
        """Of actions ``(..., A)``, but for a constant."""
        off = (actions - self.actor(scaled)) / self.log_spread.exp()
        return -(off**2 / 2 + self.log_spread).sum(-1)

    @torch.no_grad()
    def act(self, obs: np.ndarray) -> np.ndarray:
        """The middle of the Gaussian within bounds, ``(B, A)``."""
        middle: Tensor = self.actor(self.scaled(torch.as_tensor(obs, device=self.seen.mean.device)))
        return middle.clamp(-1, 1).double().cpu().numpy()


def advantages(rewards: Tensor, values: Tensor, alive: Tensor, discount: float, trace: float) -> Tensor:
    """Generalised advantages (Schulman et al. 2016, arXiv:1506.02438), ``(T, B)``.

    ``values`` ``(T + 1, B)`` go on behind the last frame, where an episode is cut and not over; nothing follows a frame
    after which a member is not ``alive`` ``(T, B)``.
    """
    out, ahead = torch.zeros_like(rewards), torch.zeros_like(rewards[0])
    for t in reversed(range(len(rewards))):
        surprise = rewards[t] + discount * values[t + 1] * alive[t] - values[t]
        ahead = surprise + discount * trace * alive[t] * ahead
        out[t] = ahead
    return out


def train(
    world: World, recipe: Recipe, *, frames: int, seed: int, tell: Callable[[int, float], None] = lambda *_: None
) -> Agent:
    """An agent after all updates of episodes of ``frames``; its seeds and noise follow from ``seed``.

    ``tell`` is given the number of every update and the mean reward a frame in it.
    """
    members, device = world.num_envs, world.device
    noise = torch.Generator(device or "cpu").manual_seed(seed)
    discount = float(np.exp(-world.scene.frame_dt / recipe.horizon))

    def observe() -> Tensor:
        return torch.as_tensor(world.observe(), device=device)

    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        world.reset({i: np_random(i)[0] for i in range(members)})
        agent = Agent(observe().shape[1], len(world.task.actions), recipe.spread, device)
    optimizer, earned = torch.optim.Adam(agent.parameters(), lr=recipe.rate, eps=1e-5), Running(1, device)
    for update in range(recipe.updates):
        optimizer.param_groups[0]["lr"] = recipe.rate * (1 - update / recipe.updates)
        first = FIRST_SEED * (seed + 1) + update * members
        world.reset({i: np_random(first + i)[0] for i in range(members)})
        obs, played, total = observe(), [], torch.zeros((), dtype=torch.float64, device=device)
        sums = torch.zeros(members, dtype=torch.float64, device=device)
        alive = torch.ones(members, dtype=torch.bool, device=device)
        for _ in range(frames):
            agent.seen.add(obs)
            scaled, before = agent.scaled(obs), alive
            with torch.no_grad():
                drawn = torch.randn((members, agent.log_spread.numel()), generator=noise, device=device)
                actions = agent.actor(scaled) + agent.log_spread.exp() * drawn
                told = agent.log_probability(scaled, actions)
            clipped: Any = actions.clamp(-1, 1).double()
            found, reasons = world.advance(world.read(clipped if device else clipped.numpy()))
            rewards = torch.as_tensor(found, device=device)
            if reasons:
                alive = alive.clone()
                alive[list(reasons)] = False
            sums = discount * sums + rewards
            earned.add(sums[:, None])
            total += (rewards * alive).mean() / frames
            gained = (rewards / earned.spread).float()
            played.append((scaled, actions, told, gained, alive.float(), before))
            obs = observe()
        tell(update, float(total))
        scaled, actions, told, gained, going, counts = (torch.stack(column) for column in zip(*played, strict=True))
        with torch.no_grad():
            values = agent.critic(torch.cat([scaled, agent.scaled(obs)[None]]))[..., 0]
        gains = advantages(gained, values, going, discount, recipe.trace)
        data = [part[counts] for part in (scaled, actions, told, gains, gains + values[:-1])]
        for _ in range(recipe.epochs):
            for rows in torch.split(torch.randperm(len(data[0]), generator=noise, device=device), recipe.minibatch):
                x, a, old, gain, goal = (part[rows] for part in data)
                gain = (gain - gain.mean()) / (gain.std() + 1e-8)
                ratio = (agent.log_probability(x, a) - old).exp()
                better = torch.minimum(ratio * gain, ratio.clamp(1 - recipe.clip, 1 + recipe.clip) * gain).mean()
                loss = recipe.value * ((agent.critic(x)[:, 0] - goal) ** 2).mean() - better
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), recipe.largest)
                optimizer.step()
    return agent
