"""``RecordRollout``: records an environment, also what is done to it past its wrappers."""

from typing import Any

import gymnasium as gym
import numpy as np

from cloth_envs.material import PROPERTIES, Material
from cloth_envs.recording.writer import RolloutWriter
from cloth_envs.state import State


class RecordRollout(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Records every episode of a single environment to ``path``; see ``RolloutWriter``.

    Recorded is what the unwrapped environment took and gave: its action, as it stepped with it (float64, clipped), its
    state and its reward. Every trajectory keeps where it began. A state that did not come of the last recorded frame
    (``set_positions``, ``set_state``, a reset or a step past this wrapper) begins a new one.

    Example: ``env = RecordRollout(gym.make("MiniCloth-Flag-v0"), "flag.h5")``.
    """

    def __init__(self, env: gym.Env[Any, Any], path: str, *, overwrite: bool = False) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, path=str(path), overwrite=overwrite)
        super().__init__(env)
        self.writer = RolloutWriter(path, env, overwrite=overwrite)
        self._last: State | None = None  # as it was recorded

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        self.writer.check_open()
        result = self.env.reset(seed=seed, options=options)
        self._begin(seed, reset=True)
        return result

    def _begin(self, seed: int | None = None, *, reset: bool) -> None:
        cloth: Any = self.env.unwrapped
        start = cloth.get_state()
        material = Material(**dict(zip(PROPERTIES, start["materials"][0].tolist(), strict=True)))
        self.writer.begin(seed, material, start, reset=reset)
        self.writer.append(cloth.world.state)
        self._last = cloth.world.state

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        self.writer.check_open()
        world: Any = self.env.unwrapped.world  # type: ignore[attr-defined]
        if self._last is not None and world.state is not self._last:
            self._begin(reset=int(world.frames[0]) == 0)
        frames = int(world.frames[0])
        result = self.env.step(action)
        if int(world.frames[0]) == frames + 1:
            self.writer.append(world.state, np.array(world.episode.action), float(world.rewards[0]))
            self._last = world.state
        else:  # a wrapper has reset it, or stepped more than once
            self._begin(reset=int(world.frames[0]) == 0)
        return result

    def close(self) -> None:
        try:
            self.writer.close()
        finally:
            self.env.close()
