"""The batched engine with everything on the device of its backend: ``World`` in torch."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cloth_envs.arguments import read_actions
from cloth_envs.failure import MAX_ENERGY_JUMP
from cloth_envs.scenes.drives import tick
from cloth_envs.snapshot import Snapshot
from cloth_envs.state import State
from cloth_envs.tensors import OnHost, health_of, moved, on_host, selected, to_device, to_host
from cloth_envs.world import World


class DeviceWorld(World):
    """``World`` whose states, controls, rewards and observations are tensors, on the device of its one backend.

    A frame reads one number back, whether a member has failed, after all of its work is launched; starts are drawn on
    the host, of members that reset only. ``rewards`` and what ``observe`` returns are tensors; ``get_state`` gives
    NumPy arrays, which every backend takes back.

    Attributes:
        device: where they are.
    """

    def __init__(self, scene: Any, **options: Any) -> None:
        super().__init__(scene, **options)
        self._move()

    @classmethod
    def of(cls, world: World) -> "DeviceWorld":
        """``world`` before its first reset, which is not to be used any more, on the device of its backend."""
        own = cls.__new__(cls)
        vars(own).update(vars(world))
        own._move()
        return own

    def _move(self) -> None:
        outside: Any = self.backend
        self.backend: Any = outside.backend if isinstance(outside, OnHost) else outside
        self.device: torch.device = self.backend.device
        self._task = moved(self.task, self.device)
        if hasattr(self.task, "drive"):
            self._task.drive = moved(self.task.drive, self.device)
        self._observer = moved(self.observer, self.device)
        self._observer.task = self._task
        self._frames = to_device(self.frames, self.device)
        self._seen: Any = None  # observations of the present state, where they are known

    def read_only(self) -> State:
        return on_host(self.state).read_only()

    def _place(self, which: Sequence[int], state: State, memory: dict[str, np.ndarray]) -> None:
        there: dict[str, Any] = {name: to_device(value, self.device) for name, value in memory.items()}
        if self._episode is None:
            super()._place(which, state, there)
            self.episode.action = to_device(self.episode.action, self.device)
        else:
            self.backend.reset(state, [self.materials[i] for i in which], which)
            self.episode.state = self.backend.state
            members = torch.tensor(which, device=self.device)
            for name, values in there.items():
                self.episode.memory[name][members] = values
            self._frames[members] = to_device(self.frames[which], self.device)
        self._seen = None

    def step(self, actions: Any) -> tuple[Any, list[str | None]]:
        """One frame by actions ``(B, A)``, a tensor or anything else. Returns and raises what ``World.step`` does."""
        shape = (self.num_envs, len(self.task.actions))
        if not isinstance(actions, Tensor):
            return self.advance(to_device(read_actions(actions, shape, self.task.actions), self.device))
        if actions.shape != shape:
            raise ValueError(
                f"action has shape {tuple(actions.shape)}, expected {shape}: {', '.join(self.task.actions)}"
            )
        return self.advance(actions.to(self.device, torch.float64))

    def advance(self, actions: Any) -> tuple[Any, list[str | None]]:
        episode, before = self.episode, self.episode.state
        last, self.controls = (episode.action, self.controls), None
        episode.action = actions.clip(-1.0, 1.0)
        self.controls = self._task.controls(episode)
        after = episode.state = self.backend.advance(self.controls)
        self.frames += 1
        tick(self._frames, self.scene.frame_dt, after.time)
        failed = self._failed(before, after)
        self._earn()
        flags = torch.stack([actions.isfinite().all(), failed.any()])
        usable, lost = flags.tolist()
        if not usable:
            self._take_back(before, *last)
            raise ValueError("action holds NaN or infinity; the state is unchanged, pass numbers in [-1, 1]")
        reasons = self._put_back(before, after, failed) if lost else [None] * self.num_envs
        return self.rewards, reasons

    def _earn(self) -> None:
        """Rewards and observations of the present state."""
        self.rewards = self._task.reward(self.episode)
        self._seen = self._observer(self.episode)

    def _failed(self, before: State, after: State) -> Tensor:
        """Which members have failed, bool ``(B,)``; the rules are those of ``Failures``."""
        now, then = (health_of(state, self.scene.grid) for state in (after, before))
        good = (now[:, 0] > 0) & (now[:, 1] <= self.failures.max_strain)
        return ~(good & (now[:, 2] - then[:, 2] <= MAX_ENERGY_JUMP))

    def _put_back(self, before: State, after: State, failed: Tensor) -> list[str | None]:
        """Bring members that have failed back to their last good state. Returns why, as ``Failures.check`` does."""
        which = failed.nonzero()[:, 0]
        now, then = (health_of(state, self.scene.grid)[which].tolist() for state in (after, before))
        reasons: list[str | None] = [None] * self.num_envs
        members = which.tolist()
        for i, a, b in zip(members, now, then, strict=True):
            reasons[i] = self.failures.reason(bool(a[0]), a[1], a[2] - b[2])
        good = selected(before, which)
        good.time = after.time[which]
        self.backend.reset(good, [self.materials[i] for i in members], members)
        self.episode.state = self.backend.state
        self._earn()
        self.rewards[which] = 0.0
        return reasons

    def _take_back(self, before: State, action: Any, controls: Any) -> None:
        """Undo a frame of unusable actions."""
        self.episode.action, self.controls = action, controls
        self.frames -= 1
        self._frames -= 1
        self.backend.reset(before, self.materials)
        self.episode.state = self.backend.state
        self._seen = None

    def observe(self) -> Any:
        return self._observer(self.episode) if self._seen is None else self._seen

    def on_host(self, values: Any) -> Any:
        """Tensors as NumPy arrays."""
        return to_host(values)

    def flags(self, which: np.ndarray) -> Tensor:
        """Bools ``(B,)`` as a tensor; only which are true is sent."""
        there = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
        members = np.flatnonzero(which)
        if members.size:
            there[to_device(members, self.device)] = True
        return there

    def _now(self) -> Snapshot:
        found = super()._now()
        state = on_host(found.state)
        return replace(found, state=state, memory=to_host(found.memory), own=to_host(found.own))

    def _make(self, arguments: dict[str, Any]) -> None:
        super()._make(arguments)
        self._move()
