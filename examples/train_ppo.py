"""Proximal policy optimisation (Schulman et al. 2017) that trains on cheap physics first and on the reference last.

python examples/train_ppo.py Pressure-v1 --out pressure.pt && minicloth evaluate pressure.pt --scene Pressure-v1
"""

import argparse
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.wrappers.utils import RunningMeanStd
from torch import nn

import cloth_envs

MEMBERS, EPOCHS, CLIP, FASTER = 32, 6, 0.2, 5.0  # the noise's spread learns FASTER
HORIZON, TRACE, LASTING = 4 / 3, 0.8, 0.8  # s, s, share of an action's noise in the next (Hollenstein et al. 2024)
LEAST, SMOOTH = (0.1, 0.02), (1.0, 0.3)  # first, last: least noise, weight of changes squared (Mysore et al. 2021)
USUAL = (128, 128), 8, 1e-3, 1.0, np.inf  # steps to an update (first, last), its batches, rate, noise at last, patience
OWN = {"BallDrop-v1": ((64, 256), 4, 2e-3, 0.2, 10)}  # patience: frames of reward < .02 that end an episode
NEARER = {  # multipliers by factor, where what a controller earns on the usual miniature is not what it earns later
    "Hanging-v1": {4: {"compression": 0.01}, 2: {"compression": 0.03}},
    "Skirt-v1": {3: {"bend_stiffness": 2.0, "compression": 0.05}, 2: {"bend_stiffness": 2.0, "compression": 0.1}},
}


def stages(scene: str) -> list[tuple[str, dict[str, Any], float]]:  # physics and shares of frames
    near = NEARER.get(scene, {4: {}, 2: {}})
    own = [{"factor": n} | ({"scaling": "calibrated", "factors": few} if few else {}) for n, few in near.items()]
    return [("miniature", own[0], 0.8), ("miniature", own[1], 0.16), ("reference", {}, 0.04)]


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
        self.slow = nn.Parameter(torch.full((actions,), -0.5 / FASTER))  # logarithm of what is over the least, / FASTER
        self.seen, self.earned, self.noise = RunningMeanStd(shape=(seen,)), RunningMeanStd(), [LEAST[0], 1.0]

    def scale(self) -> dict[str, np.ndarray]:
        return {"mean": self.seen.mean, "spread": (self.seen.var + 1e-8) ** 0.5 + self.hidden}

    def scaled(self, seen: np.ndarray) -> torch.Tensor:
        mean, spread = self.scale().values()
        return torch.as_tensor(((seen - mean) / spread).clip(-10, 10), dtype=torch.float32)

    def spread(self) -> torch.Tensor:
        return self.noise[0] + self.noise[1] * (FASTER * self.slow).exp()

    def log_probability(self, x: torch.Tensor, actions: torch.Tensor, lasting: torch.Tensor) -> torch.Tensor:
        new = (actions - self.actor(x)) / self.spread() - lasting
        return -(new**2 / (2 - 2 * LASTING**2) + self.spread().log()).sum(-1)

    def weights(self) -> dict[str, torch.Tensor]:  # as ``minicloth evaluate`` reads them
        return {name: torch.as_tensor(part) for name, part in self.scale().items()} | self.actor.state_dict()


class Players:  # members of one physics, whose first episodes end at different times
    def __init__(self, scene: str, backend: str, options: dict[str, Any], seed: int) -> None:
        ours = {"autoreset_mode": "Disabled", "desync": True, "backend": backend, "backend_kwargs": options}
        self.env = gym.make_vec(cloth_envs.env_id(scene), num_envs=MEMBERS, **ours)
        self.seen, self.task = self.env.reset(seed=seed)[0], self.env.unwrapped.task
        self.discount, self.trace = (1 - self.task.frame_dt / seconds for seconds in (HORIZON, TRACE))
        self.steps, self.batches, self.rate, self.calm, self.patience = OWN.get(scene, USUAL)
        self.failed, self.sums, self.idle = 0, *np.zeros((2, MEMBERS))
        self.noise = torch.randn(self.env.action_space.shape)

    @torch.no_grad()
    def play(self, agent: Agent, done: float) -> list[torch.Tensor]:  # what ``learn`` reads, of all frames
        frames: list[tuple[Any, ...]] = []
        for _ in range(round(np.interp(done, (0, 1), self.steps))):
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
        columns = zip(*frames, strict=True)
        x, actions, lasting, after, rewards, ended, scaled = (torch.stack([*map(torch.as_tensor, c)]) for c in columns)
        told, values = agent.log_probability(x, actions, lasting), agent.critic(x)[..., 0]
        gains, ahead = torch.zeros_like(values), torch.zeros(MEMBERS)
        for t in reversed(range(len(frames))):
            later = self.discount * (after[t] + self.trace * ~ended[t] * ahead)
            ahead = gains[t] = scaled[t].float() + later - values[t]
        then = torch.where(ended[:, :, None], x, torch.cat([x[1:], x[-1:]]))
        self.reward = float(rewards.mean())
        return [part.flatten(0, 1) for part in (x, then, actions, lasting, told, gains, gains + values)]

    def learn(self, agent: Agent, optimizer: torch.optim.Optimizer, data: list[torch.Tensor], done: float) -> None:
        optimizer.param_groups[0]["lr"] = self.rate * (1 - 0.9 * done)
        for _ in range(EPOCHS):
            for rows in torch.randperm(len(data[0])).chunk(self.batches):
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
        agent.noise = [np.interp(done, (0, 1), ends) for ends in (LEAST, (1.0, self.calm))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", choices=list(cloth_envs.EPISODE_FRAMES))
    parser.add_argument("--frames", type=int, default=600_000, help="of all stages and members (default 600000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", default="policy.pt")
    options = parser.parse_args()
    torch.manual_seed(options.seed)
    torch.set_num_threads(1)
    agent, optimizer, done = None, None, 0
    for number, (backend, own, share) in enumerate(stages(options.scene)):
        players = Players(options.scene, backend, own, 10_000 * (options.seed + 1) + 1_000 * number)
        until = done + share * options.frames
        agent = agent or Agent(players.task, players.seen.shape[1])
        optimizer = optimizer or torch.optim.Adam(agent.parameters(), eps=1e-5)
        while done < until:
            data = players.play(agent, done / options.frames)
            players.learn(agent, optimizer, data, done / options.frames)
            done += len(data[0])
            print(f"{done} of {options.frames} frames, {backend} {own}: {players.reward:.3f} a frame", flush=True)
        players.env.close()
    torch.save(agent.weights(), options.out)


if __name__ == "__main__":
    main()
