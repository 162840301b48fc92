"""Soft actor-critic (Haarnoja et al. 2018) of Stable-Baselines3 on batched cloths, as a learner of ``bench agents``."""

from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from stable_baselines3 import SAC
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecNormalize
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from cloth_envs.agents import mlp
from cloth_envs.evaluation import Policy
from cloth_envs.registry import env_id
from cloth_envs.stable_baselines import ClothVecEnv

MEMBERS, STEPS = 32, 64  # frames of all members between looks at the clock
HORIZON = 4 / 3  # seconds that rewards count for, as in the example
LASTING = 0.8  # share of an action's noise in the next one's, in play (Eberhard et al. 2023)
RATE = 1e-3  # of the first step; a tenth of it in the last
SETTINGS: dict[str, Any] = {
    "buffer_size": 400_000,
    "learning_starts": MEMBERS * STEPS,
    "batch_size": 256,
    "gradient_steps": 2,  # a frame of all members: on Pressure two thirds of the time
    "ent_coef": "auto_0.1",
    "policy_kwargs": {"net_arch": [64, 64], "activation_fn": torch.nn.Tanh, "optimizer_kwargs": {"fused": True}},
    "device": "cpu",
}


class Told(VecEnvWrapper):
    """The task's numbers of observations, without keypoints, as the example's agent has them; counts failures."""

    def __init__(self, env: VecEnv) -> None:
        bound = env.observation_space.high[-len(env.get_attr("task", 0)[0].extras) :]  # type: ignore[attr-defined]
        self.hidden, self.failed = env.observation_space.shape[0] - len(bound), 0  # type: ignore[index]
        super().__init__(env, Box(-bound, bound))

    def reset(self) -> VecEnvObs:
        seen: Any = self.venv.reset()
        return seen[:, self.hidden :]

    def step_wait(self) -> VecEnvStepReturn:
        seen: Any
        seen, rewards, ended, infos = self.venv.step_wait()
        for i in np.flatnonzero(ended):
            self.failed += "failure" in infos[i]
            infos[i]["terminal_observation"] = infos[i]["terminal_observation"][self.hidden :]
        return seen[:, self.hidden :], rewards, ended, infos


class LastingSAC(SAC):
    """SAC that plays with noise that lasts and learns with noise that does not."""

    noise = torch.zeros(())

    @torch.no_grad()
    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[np.ndarray, Any]:
        if deterministic:
            return super().predict(observation, state, episode_start, True)
        mean, spread, _ = self.actor.get_action_dist_params(torch.as_tensor(observation))
        new = torch.randn_like(mean)
        self.noise = LASTING * self.noise + (1 - LASTING**2) ** 0.5 * new if self.noise.ndim else new
        return torch.tanh(mean + spread.exp() * self.noise).numpy(), state


class Sac:
    """A training, from physics to physics: ``begin`` one, ``go_on`` for a while, ``end`` it."""

    what = "policy of SAC of Stable-Baselines3, 64 x 64"

    def __init__(self) -> None:
        self.model: Any = None
        self.done = 0.0

    def begin(self, scene: str, backend: str, options: dict[str, Any], seed: int) -> None:
        cloths = ClothVecEnv(env_id(scene), MEMBERS, desync=True, backend=backend, backend_kwargs=options)
        self.told = Told(cloths)
        self.env = VecNormalize(self.told, norm_reward=False)
        self.env.seed(seed)
        if self.model is None:
            gamma = 1 - cloths.get_attr("scene", 0)[0].frame_dt / HORIZON
            self.model = LastingSAC("MlpPolicy", self.env, self._rate, gamma=gamma, seed=seed, **SETTINGS)
        else:
            self.env.obs_rms = self.model.get_vec_normalize_env().obs_rms
            self.model.set_env(self.env)

    def _rate(self, _: float) -> float:
        return RATE * (1 - 0.9 * self.done)

    def go_on(self, done: float) -> int:
        self.done = done
        self.model.learn(MEMBERS * STEPS, reset_num_timesteps=False, log_interval=None)
        return MEMBERS * STEPS

    def end(self) -> int:
        self.env.close()
        return self.told.failed

    def weights(self) -> dict[str, torch.Tensor]:
        """Keypoints have an infinite spread, a last layer of ones squashes actions."""
        seen: Any
        actor, seen, hidden = self.model.actor, self.env.obs_rms, self.told.hidden
        layers = [*actor.latent_pi[::2], actor.mu]
        found = {f"{2 * i}.{n}": p.detach() for i, layer in enumerate(layers) for n, p in layer.named_parameters()}
        found["0.weight"] = torch.nn.functional.pad(found["0.weight"], (hidden, 0))
        size, last = len(layers[-1].bias), 2 * len(layers)
        found |= {f"{last}.weight": torch.eye(size), f"{last}.bias": torch.zeros(size)}
        mean = np.pad(seen.mean, (hidden, 0))
        spread = np.pad((seen.var + self.env.epsilon) ** 0.5, (hidden, 0), constant_values=np.inf)
        return {"mean": torch.as_tensor(mean), "spread": torch.as_tensor(spread), **found}

    def policy(self) -> Policy:
        return mlp({name: value.numpy().copy() for name, value in self.weights().items()})
