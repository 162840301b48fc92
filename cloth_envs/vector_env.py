"""The vector environment: one batched state, threads over its members."""

import os
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from cloth_envs.backend import keywords
from cloth_envs.naming import unknown_name
from cloth_envs.registry import load_backend
from cloth_envs.scene import Scene
from cloth_envs.state import State
from cloth_envs.world import World, member

_MODES = {mode.value: mode for mode in AutoresetMode}


class ClothVectorEnv(VectorEnv[Any, Any, np.ndarray]):
    """``num_envs`` cloths stepped together; made by ``gym.make_vec(id, num_envs=N, ...)``.

    Member i is bit-equal to the single environment with the same seed and actions.

    Arguments:
        num_envs: members.
        max_episode_steps: frames until truncation, None for none.
        autoreset_mode: ``"NextStep"``, ``"SameStep"`` or ``"Disabled"`` (or Gymnasium's ``AutoresetMode``).
        The others are those of ``ClothEnv``; a backend that takes ``threads`` gets as many as processors are at hand.

    Raises:
        ValueError: a bad argument; says what to write instead.
    """

    def __init__(
        self,
        scene: str,
        *,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        backend_kwargs: dict[str, Any] | None = None,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        if render_mode is not None:
            raise ValueError("a vector environment does not render: draw single members with gym.make, or a recording")
        if isinstance(num_envs, bool) or not isinstance(num_envs, int) or num_envs < 1:
            raise ValueError(f"num_envs must be a whole number of at least 1, got {num_envs!r}")
        name = autoreset_mode.value if isinstance(autoreset_mode, AutoresetMode) else autoreset_mode
        if name not in _MODES:
            raise unknown_name("autoreset_mode", name, _MODES)
        self.autoreset_mode, self._limit = _MODES[name], max_episode_steps
        threads = min(
            num_envs, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        )
        given: Any = backend_kwargs or {}
        if isinstance(given, dict) and "threads" in keywords(load_backend(options.get("backend", "reference"))):
            given = {"threads": threads, **given}
        self.world = World(scene, num_envs=num_envs, backend_kwargs=given, **options)
        self.num_envs = num_envs
        self.render_mode = None
        self.metadata = {
            "autoreset_mode": self.autoreset_mode,
            "render_modes": [],
            "render_fps": round(1 / self.world.scene.frame_dt),
        }
        self.single_observation_space = self.world.observation_space
        self.single_action_space = self.world.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._ended = np.zeros(num_envs, bool)

    def __repr__(self) -> str:
        return f"<ClothVectorEnv {self.world.title}, {self.num_envs} environments, {self.world.progress}>"

    @property
    def scene(self) -> Scene:
        """The frozen ``Scene``."""
        return self.world.scene

    @property
    def state(self) -> State:
        """The present batched state; read only."""
        return self.world.state

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start episodes. A number seeds member i with ``seed + i``.

        ``options={"reset_mask": mask}``, bool ``(B,)``, starts only some members.

        Raises:
            ValueError: a list of seeds or a mask of the wrong length, or a mask that picks none.
        """
        n = self.num_envs
        seeds = [None if seed is None else seed + i for i in range(n)] if not isinstance(seed, list) else seed
        if len(seeds) != n:
            raise ValueError(f"got {len(seeds)} seeds for {n} environments; pass one number or {n} of them")
        mask = np.ones(n, bool)
        if options and "reset_mask" in options:
            mask = np.asarray(options["reset_mask"])
            if mask.shape != (n,) or mask.dtype != bool or not mask.any():
                raise ValueError(f"reset_mask must be a bool array of shape ({n},) that picks at least one environment")
        for i in np.flatnonzero(mask):
            if seeds[i] is not None or self.world.rngs[i] is None:
                self.world.rngs[i], _ = seeding.np_random(seeds[i])
        self._start(np.flatnonzero(mask))
        return self.world.observe(), {}

    def _start(self, which: np.ndarray) -> None:
        rngs = {int(i): rng for i in which if (rng := self.world.rngs[i]) is not None}
        self.world.reset(rngs)
        self._ended[which] = False

    def step(self, actions: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        world, n = self.world, self.num_envs
        again = self._ended.copy()
        if again.any() and self.autoreset_mode is AutoresetMode.DISABLED:
            raise RuntimeError(
                f"environments {np.flatnonzero(again).tolist()} have ended: reset them with "
                'reset(options={"reset_mask": terminated | truncated})'
            )
        rewards, reasons = world.step(actions)
        terminated = np.array([reason is not None for reason in reasons])
        truncated = np.zeros(n, bool) if self._limit is None else world.frames >= self._limit
        if again.any():  # next-step mode: this step only starts the new episode of those
            self._start(np.flatnonzero(again))
            rewards[again], terminated[again], truncated[again] = 0.0, False, False
        infos: dict[str, Any] = {}
        failed = terminated & ~again
        if failed.any():
            infos["failure"] = np.array([r if f else None for r, f in zip(reasons, failed, strict=True)], dtype=object)
            infos["_failure"] = failed
        ended = terminated | truncated
        self._ended = ended.copy()
        observations = world.observe()
        if self.autoreset_mode is AutoresetMode.SAME_STEP and ended.any():
            finals = np.full(n, None, dtype=object)
            for i in np.flatnonzero(ended):
                finals[i] = member(observations, int(i))
            infos = {"final_obs": finals, "_final_obs": ended, "final_info": infos, "_final_info": ended.copy()}
            self._start(np.flatnonzero(ended))
            observations = world.observe()
        return observations, rewards, terminated, truncated, infos

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything that decides the future, as arrays; see ``ClothEnv.get_state``."""
        return {**self.world.get_state(), "ended": self._ended.copy()}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Continue from what ``get_state`` gave, bit for bit.

        Raises:
            ValueError: the state belongs to another scene, resolution or number of environments.
        """
        self.world.set_state(state)
        self._ended = np.asarray(state["ended"]).copy()
