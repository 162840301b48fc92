"""Gymnasium's ``TimeLimit`` wrappers, whose counts of frames belong to the state of the environment inside."""

import sys
import weakref
from typing import Any

import gymnasium as gym
from gymnasium.wrappers import TimeLimit


class TimeLimits:
    """Those around one environment; it can't name them, so they are found as callers of its ``reset``."""

    def __init__(self) -> None:
        self._known: list[weakref.ref[TimeLimit[Any, Any]]] = []

    def find(self, env: gym.Env[Any, Any]) -> None:
        """Remember the wrappers through which the running ``reset`` of ``env`` was called."""
        self._known, frame = [], sys._getframe(1)
        while frame is not None:
            if frame.f_code is TimeLimit.reset.__code__:  # the locals of others would live on in their frames
                caller = frame.f_locals["self"]
                if caller.unwrapped is env:
                    self._known.append(weakref.ref(caller))
            frame = frame.f_back  # type: ignore[assignment]

    def move(self, before: int, after: int) -> None:
        """Let those that had counted ``before`` frames have counted ``after``; others count something else."""
        for limit in self._now():
            if limit._elapsed_steps == before:
                limit._elapsed_steps = after

    def reached(self) -> bool:
        """Whether the running ``step`` is the last that one of them allows."""
        for known in self._known:
            limit = known()
            if limit is not None and (limit._elapsed_steps or 0) + 1 >= limit._max_episode_steps:
                return True
        return False

    def _now(self) -> list[TimeLimit[Any, Any]]:
        return [limit for known in self._known if (limit := known()) is not None]

    def __getstate__(self) -> list[TimeLimit[Any, Any]]:
        return self._now()  # a copy of them lies around a copy of the environment

    def __setstate__(self, known: list[TimeLimit[Any, Any]]) -> None:
        self._known = [weakref.ref(limit) for limit in known]
