"""The batched engine with everything on the device of its backend: ``World`` in torch."""

from collections.abc import Sequence
from dataclasses import fields, replace
from math import inf
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor

from cloth_envs.failure import MAX_ENERGY_JUMP
from cloth_envs.launch import OneLaunch
from cloth_envs.scenes.drives import tick
from cloth_envs.scenes.task import Episode
from cloth_envs.snapshot import Snapshot
from cloth_envs.state import Controls, State
from cloth_envs.tensors import OnHost, health_of, moved, on_host, selected, starting, to_device, to_host
from cloth_envs.world import World


class DeviceWorld(World):
    """``World`` whose states, controls, rewards and observations are tensors, on the device of its one backend.

    A frame is few launches: what the task computes before and after the backend's own is one each, on copies of the
    state that stay where they are. Two flags are read back once all is launched: whether actions are numbers, and
    whether a member has failed. Starts are drawn on the host, of members that reset only. ``rewards`` and what
    ``observe`` returns are tensors; ``get_state`` gives NumPy arrays, which every backend takes back.

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
        self.rewards: Any = to_device(self.rewards, self.device)
        self._task, self._observer = moved(self.task, self.device), moved(self.observer, self.device)
        self._observer.task = self._task
        if hasattr(self.task, "drive"):
            self._task.drive = moved(self.task.drive, self.device)

    def _vary(self, which: Sequence[int]) -> None:
        super()._vary(which)
        if self._observer.material is not None:
            self._observer.material[list(which)] = to_device(self.varied[which], self.device)

    def read_only(self) -> State:
        return on_host(self.state).read_only()

    def _laid(self, drawn: dict[str, np.ndarray]) -> tuple[State, dict[str, np.ndarray]]:
        start = self._task.lay({name: to_device(values, self.device) for name, values in drawn.items()})
        state = starting(start.positions, start.velocities, start.colliders)
        return state, start.memory | self._task.gripped(state.positions)

    def _place(self, which: Sequence[int], state: State, memory: dict[str, np.ndarray]) -> None:
        there: dict[str, Any] = {name: to_device(value, self.device) for name, value in memory.items()}
        if self._episode is None:
            super()._place(which, state, there)
            self._begin()
            self._look()
        else:
            members = torch.tensor(which, device=self.device)
            for name, values in there.items():
                self.episode.memory[name][members] = values
            self._frames[members] = to_device(self.frames[which], self.device)
            self._replace(members, which, state)

    def _replace(self, members: Tensor, which: Sequence[int], state: State) -> None:
        """Go on from ``state`` with some members."""
        self.backend.reset(state, [self.materials[i] for i in which], which)
        self.episode.state = self.backend.state
        self._look(members)

    def _begin(self) -> None:
        """Lay out what stays where it is: all that ``_driven`` and ``_judged`` read."""
        state: Any = self.episode.state
        partial = (
            hasattr(state, "at") and self.task.watched is not None and not isinstance(self.observer.space, spaces.Dict)
        )
        self._watched = (self.task.watched, to_device(self.task.watched, self.device)) if partial else None
        self._given: Any = torch.zeros(self.episode.action.shape, dtype=torch.float64, device=self.device)
        self._before: Any = self._given.clone()
        action: Any = self._given.clone()
        self.episode.action = action
        self._frames = to_device(self.frames, self.device)
        there: dict[str, Any] = state.arrays()
        self._seen = State(**{name: value.clone().contiguous() for name, value in there.items()})
        self._health = health_of(state, self.scene.grid).clone()
        self._energy = self._health[:, 2].clone()  # before the frame
        self._drive, self._judge = OneLaunch(self._driven, self.device), OneLaunch(self._judged, self.device)

    @torch.no_grad()
    def _look(self, members: Tensor | slice = slice(None)) -> None:
        """Copy the present state, or that of some members, to where the task sees it.

        Of a cloth that is computed when it is read only what the task watches, if that is told.
        """
        whole = isinstance(members, slice)
        state: Any = self.episode.state if whole else selected(self.episode.state, members)
        for name in [field.name for field in fields(State)]:
            if self._watched is None or name not in ("positions", "velocities"):
                getattr(self._seen, name)[members] = getattr(state, name)
        if self._watched is not None and whole:
            state.put(self._watched[0], self._seen)
        elif self._watched is not None:
            vertices, index = self._watched
            for name, value in zip(("positions", "velocities"), state.at(vertices), strict=True):
                seen = getattr(self._seen, name).flatten(2)
                seen[members] = seen[members].index_copy_(2, index, value)
        self._health[members] = health_of(state, self.scene.grid)
        self._observed: Any = None

    def _as_seen(self) -> Episode:
        return Episode(self._seen, self.episode.memory, self._given.clip(-1.0, 1.0), self._before)

    def _rest(self, which: Sequence[int]) -> None:
        members = torch.tensor(which, device=self.device)
        for action in (self._given, self._before):
            action[members] = 0.0
        self.episode.action = self._given.clip(-1.0, 1.0)

    def _act(self, action: np.ndarray) -> None:
        for there in (self._given, self._before):
            there.copy_(to_device(action, self.device))
        self.episode.action = self._given.clone()

    def _driven(self) -> list[Any]:
        """The clipped action, then the fields of ``Controls``."""
        episode = self._as_seen()
        return [episode.action, *vars(self._task.controls(episode)).values()]

    def _failed(self) -> Tensor:
        """Which members have failed, bool ``(B,)``; the rules are those of ``Failures``."""
        finite, strain, kinetic = self._health.unbind(1)
        good = (finite > 0) & (strain <= self.failures.max_strain) & (kinetic - self._energy <= MAX_ENERGY_JUMP)
        return ~good

    def _judged(self) -> list[Any]:
        """Whether actions are numbers and a member has failed, ``(2,)``; rewards, scores, observations."""
        episode = self._as_seen()
        observed = self._observer(episode)
        flags = torch.stack([self._given.isfinite().all(), self._failed().any()])
        rewards, scores = self._task.judge(episode)
        self._scored = len(scores)
        return [flags, rewards, *scores, *(observed.values() if isinstance(observed, dict) else [observed])]

    def _find(self) -> Tensor:
        """Rewards, scores and observations of the present state. Returns the flags of ``_judged``."""
        flags, self.rewards, *parts = self._judge()
        self._scores, parts = tuple(parts[: self._scored]), parts[self._scored :]
        names = self.observer.space
        self._observed = dict(zip(names, parts, strict=True)) if isinstance(names, spaces.Dict) else parts[0]
        return flags

    def observe(self) -> Any:
        if self._observed is None:
            judged = self.rewards, self._scores
            self._find()
            self.rewards, self._scores = judged
        return self._observed

    def read(self, actions: Any) -> Any:
        if not isinstance(actions, Tensor):
            return to_device(super().read(actions), self.device)
        shape, meaning = (self.num_envs, len(self.task.actions)), self.task.actions
        if actions.shape != shape:
            raise ValueError(f"action has shape {tuple(actions.shape)}, expected {shape}: {', '.join(meaning)}")
        return actions.detach()

    def advance(self, actions: Any) -> tuple[Any, dict[int, str]]:
        episode, before = self.episode, self.episode.state
        controls = self.controls
        self._before.copy_(episode.action)
        self._given.copy_(actions)
        episode.action, *driven = self._drive()
        self.controls = Controls(*driven)
        self._energy.copy_(self._health[:, 2])
        episode.state = self.backend.advance(self.controls)
        self.frames += 1
        tick(self._frames, self.scene.frame_dt, episode.state.time)
        self._look()
        finite, strain, _ = self._health.double().unbind(1)
        self._strain: Any = strain.where(finite > 0, inf)
        usable, lost = self._find().tolist()
        if not usable:
            self._take_back(before, controls)
            raise ValueError("action holds NaN or infinity; the state is unchanged, pass numbers in [-1, 1]")
        reasons = self._put_back(before) if lost else {}
        self._last_second.append(self.rewards)
        return self.rewards, reasons

    @property
    def strain(self) -> Any:
        return self._strain

    def final_second(self) -> Any:
        frames = torch.arange(len(self._last_second), device=self.device).flip(0)[:, None] < self._frames
        return (torch.stack(list(self._last_second)) * frames).sum(0) / frames.sum(0).clip(1)

    def _put_back(self, before: State) -> dict[int, str]:
        """Bring members that have failed back to their last good state. Returns why."""
        which = self._failed().nonzero()[:, 0]
        members, now, then = which.tolist(), self._health[which].tolist(), self._energy[which].tolist()
        reasons = {
            i: str(self.failures.reason(bool(finite), strain, kinetic - energy))
            for i, (finite, strain, kinetic), energy in zip(members, now, then, strict=True)
        }
        good = selected(before, which)
        good.time = self._seen.time[which]
        self._replace(which, members, good)
        self._find()
        for values in (self.rewards, *self._scores[2:]):
            values[which] = 0.0
        return reasons

    def _take_back(self, before: State, controls: Controls | None) -> None:
        """Undo a frame of actions that are no numbers."""
        self.episode.action, self.controls = self._before.clone(), controls
        self._given.copy_(self._before)
        self.frames -= 1
        self._frames -= 1
        self.backend.reset(before, self.materials)
        self.episode.state = self.backend.state
        self._look()

    def seen_on_host(self) -> Episode:
        episode = self.episode
        return Episode(on_host(episode.state), to_host(episode.memory), to_host(episode.action))

    def on_host(self, values: Any) -> Any:
        return to_host(values)

    def _there(self, values: np.ndarray) -> Any:
        return to_device(values, self.device)

    def flags(self, which: np.ndarray) -> Any:
        """Bools ``(B,)`` as a tensor; only which are true is sent."""
        there = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
        members = np.flatnonzero(which)
        if members.size:
            there[to_device(members, self.device)] = True
        return there

    def _now(self) -> Snapshot:
        found = super()._now()
        return replace(found, state=on_host(found.state), memory=to_host(found.memory), own=to_host(found.own))
