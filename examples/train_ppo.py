"""Proximal policy optimisation (Schulman et al. 2017) that trains on cheap physics first and on the reference last.

python examples/train_ppo.py Hanging-v1 --out hanging.pt && minicloth evaluate hanging.pt --scene Hanging-v1
"""

import argparse
from time import process_time
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.wrappers.utils import RunningMeanStd
from torch import nn

import cloth_envs

MEMBERS, EPOCHS, BATCHES, STEPS = 32, 6, 4, (64, 256)  # an update has more steps at last, when gains are small
HORIZON, TRACE, CLIP, RATE, FASTER = 4 / 3, 0.8, 0.2, 2e-3, 5.0  # the first two in seconds; noise learns FASTER
LASTING = 0.8  # share of an action's noise in the next one's (Hollenstein et al. 2024), which its probability knows
LEAST, CALM = 0.1, (1.0, 0.2)  # the noise's spread at least, for gains to tell of actions, and what is left of it
PATIENCE = {"BallDrop-v1": 10}  # frames of no reward that end an episode here: what misses the ball stays below
SMOOTH = 1.0, 0.3  # weight of how the policy's actions change from frame to frame, squared (Mysore et al. 2021)


def stages(scene: str) -> list[tuple[str, dict[str, Any], float]]:  # physics and shares of frames
    first = 3 if scene.startswith("Skirt") else 4  # of a skirt with a factor of 4 the hem stays wide by itself
    return [("miniature", {"factor": first}, 0.8), ("miniature", {"factor": 2}, 0.16), ("reference", {}, 0.04)]


def network(inputs: int, outputs: int, gain: float) -> nn.Sequential:
    layers = [nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs)]
    for layer, size in zip(layers[::2], (2**0.5, 2**0.5, gain), strict=True):
        nn.init.orthogonal_(layer.weight, size)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(*layers)


class Agent(nn.Module):
    def __init__(self, task: Any, seen: int) -> None:
        super().__init__()
        actions, told = len(task.actions), len(task.extras)
        self.hidden = np.where(np.arange(seen) < seen - told, np.inf, 0)  # keypoints, which shake in their plane
        self.actor, self.critic = network(seen, actions, 0.01), network(seen, 1, 1.0)
        self.slow = nn.Parameter(torch.full((actions,), -0.5 / FASTER))  # logarithm of what is over the least
        self.calm, self.seen, self.earned = CALM[0], RunningMeanStd(shape=(seen,)), RunningMeanStd()

    def scale(self) -> dict[str, np.ndarray]:
        return {"mean": self.seen.mean, "spread": (self.seen.var + 1e-8) ** 0.5 + self.hidden}

    def scaled(self, seen: np.ndarray) -> torch.Tensor:
        mean, spread = self.scale().values()
        return torch.as_tensor(((seen - mean) / spread).clip(-10, 10), dtype=torch.float32)

    def spread(self) -> torch.Tensor:
        return self.calm * (LEAST + (FASTER * self.slow).exp())

    def log_probability(self, x: torch.Tensor, actions: torch.Tensor, lasting: torch.Tensor) -> torch.Tensor:
        new = (actions - self.actor(x)) / self.spread() - lasting
        return -(new**2 / (2 - 2 * LASTING**2) + self.spread().log()).sum(-1)

    def weights(self) -> dict[str, torch.Tensor]:  # as ``minicloth evaluate`` reads them
        return {name: torch.as_tensor(part) for name, part in self.scale().items()} | self.actor.state_dict()


class Players:
    """Members of one physics, whose first episodes end at different times."""

    def __init__(self, scene: str, backend: str, options: dict[str, Any], seed: int) -> None:
        ours = {"autoreset_mode": "Disabled", "desync": True, "backend": backend, "backend_kwargs": options}
        self.env = gym.make_vec(cloth_envs.env_id(scene), num_envs=MEMBERS, **ours)
        self.seen, self.task = self.env.reset(seed=seed)[0], self.env.unwrapped.task
        self.discount, self.trace = (1 - self.task.frame_dt / seconds for seconds in (HORIZON, TRACE))
        self.failed, self.idle, self.sums = 0, *np.zeros((2, MEMBERS))
        self.patience, self.noise = PATIENCE.get(scene, np.inf), torch.randn(self.env.action_space.shape)

    @torch.no_grad()
    def play(self, agent: Agent, done: float) -> tuple[list[torch.Tensor], float]:
        """Frames of scaled, next scaled, action, lasting noise, log probability, gain, goal; the mean reward."""
        frames: list[tuple[Any, ...]] = []
        for _ in range(round(np.interp(done, (0, 1), STEPS))):
            agent.seen.update(self.seen)
            x, lasting = agent.scaled(self.seen), LASTING * self.noise
            self.noise = lasting + (1 - LASTING**2) ** 0.5 * torch.randn_like(lasting)
            actions = agent.actor(x) + agent.spread() * self.noise
            self.seen, rewards, terminated, truncated, _ = self.env.step(actions.clamp(-1, 1).numpy())
            self.idle, self.failed = np.where(rewards < 0.02, self.idle + 1, 0), self.failed + int(terminated.sum())
            ended = terminated | truncated | (self.idle >= self.patience)
            self.sums = self.discount * self.sums + rewards
            agent.earned.update(self.sums)
            after = agent.critic(agent.scaled(self.seen))[:, 0] * ~torch.as_tensor(terminated)  # goes on, if cut
            frames.append((x, actions, lasting, after, rewards, ended, rewards / (agent.earned.var + 1e-8) ** 0.5))
            if ended.any():
                self.seen, _ = self.env.reset(options={"reset_mask": ended})
                self.sums[ended] = self.idle[ended] = 0.0
        parts = (torch.stack([*map(torch.as_tensor, column)]) for column in zip(*frames, strict=True))
        x, actions, lasting, after, rewards, ended, scaled = parts
        told, values = agent.log_probability(x, actions, lasting), agent.critic(x)[..., 0]
        gains, ahead = torch.zeros_like(values), torch.zeros(MEMBERS)
        for t in reversed(range(len(x))):
            surprise = scaled[t].float() + self.discount * after[t] - values[t]
            ahead = gains[t] = surprise + self.discount * self.trace * ~ended[t] * ahead
        then = torch.where(ended[:, :, None], x, torch.cat([x[1:], x[-1:]]))
        data = [part.flatten(0, 1) for part in (x, then, actions, lasting, told, gains, gains + values)]
        return data, float(rewards.mean())


def learn(agent: Agent, optimizer: torch.optim.Optimizer, data: list[torch.Tensor], done: float) -> None:
    optimizer.param_groups[0]["lr"] = RATE * (1 - 0.9 * done)
    for _ in range(EPOCHS):
        for rows in torch.randperm(len(data[0])).chunk(BATCHES):
            x, then, actions, lasting, told, gain, goal = (part[rows] for part in data)
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            ratio = (agent.log_probability(x, actions, lasting) - told).exp()
            better = torch.minimum(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
            rough = (agent.actor(then) - agent.actor(x)).square().mean() * np.interp(done, (0, 1), SMOOTH)
            loss = 0.5 * (agent.critic(x)[:, 0] - goal).square().mean() + rough - better
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimizer.step()
    agent.calm = np.interp(done, (0, 1), CALM)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", choices=list(cloth_envs.EPISODE_FRAMES))
    parser.add_argument("--frames", type=int, default=600_000, help="of all stages and members (default 600000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", default="policy.pt")
    options = parser.parse_args()
    torch.manual_seed(options.seed)
    torch.set_num_threads(1)
    agent, optimizer, done, began = None, None, 0, process_time()
    for number, (backend, own, share) in enumerate(stages(options.scene)):
        players = Players(options.scene, backend, own, 10_000 * (options.seed + 1) + 1_000 * number)
        until = done + share * options.frames
        agent = agent or Agent(players.task, players.seen.shape[1])
        optimizer = optimizer or torch.optim.Adam(agent.parameters(), eps=1e-5)
        while done < until:
            data, reward = players.play(agent, done / options.frames)
            learn(agent, optimizer, data, done / options.frames)
            done += len(data[0])
            print(f"{process_time() - began:5.0f} s, {done} frames, {backend} {own}: {reward:.3f} a frame", flush=True)
        players.env.close()
    torch.save(agent.weights(), options.out)


if __name__ == "__main__":
    main()
