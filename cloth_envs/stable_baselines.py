"""The vector environment as Stable-Baselines3 takes it (extra ``rl``)."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from cloth_envs.arguments import check_reset_options
from cloth_envs.extras import missing
from cloth_envs.members import Member

try:
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn
except ImportError as error:
    raise ImportError(missing("cloth_envs.stable_baselines", error)) from error

CHOSEN: dict[str, Any] = {"autoreset_mode": "SameStep", "output": "numpy"}


class ClothVecEnv(VecEnv):
    """``num_envs`` cloths stepped together, as a ``VecEnv``: ``SAC("MlpPolicy", ClothVecEnv("MiniCloth-Flag-v1"))``.

    What it gives is bit-equal to a ``DummyVecEnv`` of ``gym.make(env_id, **options)`` with the same seeds and actions.
    ``VecMonitor`` around it tells rewards of episodes.

    Arguments:
        env_id: as of ``gym.make_vec``.
        num_envs: members.
        options: the others of ``gym.make_vec`` (see ``ClothVectorEnv``), but ``autoreset_mode`` and ``output``.

    Attributes:
        env: what ``gym.make_vec`` made.

    Raises:
        ValueError: a bad argument; says what to write instead.
    """

    def __init__(self, env_id: str, num_envs: int = 1, **options: Any) -> None:
        for name, value in CHOSEN.items():
            if name in options:
                raise ValueError(f'Stable-Baselines3 needs {name}="{value}", which this chooses: leave {name} out')
        self.env: Any = gym.make_vec(env_id, num_envs=num_envs, **CHOSEN, **options)
        super().__init__(num_envs, self.env.single_observation_space, self.env.single_action_space)

    def reset(self) -> VecEnvObs:
        """Start all episodes, by the seeds of ``seed`` the first time after it."""
        for options in self._options:
            check_reset_options(options)
        observations, infos = self.env.reset(seed=self._seeds)
        self.reset_infos = self._by_member(infos)
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Observations, float32 rewards, whether episodes ended, infos. Those that ended have begun anew.

        The info of an episode's last frame has ``terminal_observation``, those of all ``TimeLimit.truncated``.
        """
        observations, rewards, terminated, truncated, told = self.env.step(self._actions)
        ended = np.flatnonzero(terminated | truncated).tolist()
        finals, last = told.pop("final_obs", None), told.pop("final_info", {})
        infos, lasts = self._by_member(told), self._by_member(last)
        for i in ended:
            self.reset_infos[i], infos[i] = infos[i], {**lasts[i], "terminal_observation": finals[i]}
        for info, cut in zip(infos, (truncated & ~terminated).tolist(), strict=True):
            info["TimeLimit.truncated"] = cut
        return observations, rewards.astype(np.float32), terminated | truncated, infos

    def close(self) -> None:
        self.env.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Pictures of the first 16 members."""
        return self.env.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """See ``ClothVectorEnv.get_attr``."""
        return [getattr(one, attr_name) for one in self._members(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """See ``ClothVectorEnv.set_attr``; all of ``indices`` get one value."""
        for one in self._members(indices):
            setattr(one, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """What a method of a single environment gives for each of ``indices``."""
        return [getattr(one, method_name)(*method_args, **method_kwargs) for one in self._members(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """No member is."""
        return [False for _ in self._get_indices(indices)]

    def _members(self, indices: VecEnvIndices) -> list[Member]:
        members = self.env.unwrapped.members
        return [members[i] for i in self._get_indices(indices)]

    def _by_member(self, told: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Infos of a batch as those of single environments, in Python's own numbers."""
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for name in (name for name in told if f"_{name}" in told):
            values = told[name]
            each = self._by_member(values) if isinstance(values, dict) else values.tolist()
            for info, value, known in zip(infos, each, told[f"_{name}"], strict=True):
                if known:
                    info[name] = value
        return infos
