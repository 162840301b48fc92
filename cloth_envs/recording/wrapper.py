"""A Gymnasium wrapper that records every episode."""

from __future__ import annotations

from typing import Any

import gymnasium as gym

from cloth_envs.material import PROPERTIES, Material
from cloth_envs.recording.writer import RolloutWriter


class RecordRollout(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Records every episode of a single environment to ``path``; see ``RolloutWriter``.

    Example: ``env = RecordRollout(gym.make("MiniCloth-Flag-v0"), "flag.h5")``.
    """

    def __init__(self, env: gym.Env[Any, Any], path: str, *, overwrite: bool = False) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, path=str(path), overwrite=overwrite)
        super().__init__(env)
        self.writer = RolloutWriter(path, env, overwrite=overwrite)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        result = self.env.reset(seed=seed, options=options)
        cloth: Any = self.env.unwrapped
        values = cloth.get_state()["materials"][0].tolist()
        self.writer.begin(seed, Material(**dict(zip(PROPERTIES, values, strict=True))))
        self.writer.append(cloth.state)
        return result

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        result = self.env.step(action)
        cloth: Any = self.env.unwrapped
        self.writer.append(cloth.state, action, float(result[1]))
        return result

    def close(self) -> None:
        self.writer.close()
        self.env.close()
