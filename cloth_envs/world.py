"""The batched engine behind the single and the vector environment."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from math import inf
from typing import Any

import numpy as np
from gymnasium import spaces

from cloth_envs.arguments import read_actions, true_or_false
from cloth_envs.backend import Backend, check_material, device_of
from cloth_envs.choice import Choice, as_lists, choices
from cloth_envs.failure import Failures
from cloth_envs.grid import check_resolution
from cloth_envs.marks import Mark
from cloth_envs.material import Material, as_material, check_ranges, warn_unusual
from cloth_envs.mixed import MixedBackend
from cloth_envs.naming import REVISED, counted
from cloth_envs.observation import Observer
from cloth_envs.physics.solver import solvers_of
from cloth_envs.places import check_backend_kwargs
from cloth_envs.presets import load_preset, solver_of
from cloth_envs.registry import BACKENDS, load_task, make_backend, register_backend
from cloth_envs.scenes.drives import clip_actions, tick
from cloth_envs.scenes.task import Episode, Task, stacked
from cloth_envs.snapshot import Snapshot, check_array
from cloth_envs.state import Controls, State


class World:
    """``num_envs`` episodes of one scene, on one backend or, where ``backend`` is a list, on one for each.

    ``scene`` is a name, as ``Flag`` or ``Flag-v1``, or a task's class, which is taken as it is: of ``preset`` only the
    solver counts then.

    Attributes:
        scene: what is modelled: as the task lists it, without self-contact where a backend has none.
        backends: the backend's name of every member.
        observer: what an agent observes.
        controls: what the last ``step`` gave to the backend; None before the first.
        rewards: what it returned, ``(B,)``.
        varied: of every member's material what ``randomize`` names, ``(B, M)``.
        title: scene, resolution and backend in a few words.
        device: the ``torch.device`` of states, rewards and observations; None, as they are NumPy arrays.

    Raises:
        ValueError: unknown scene, preset, backend, fabric, property or observation (the nearest match is
            named), a resolution, material or range that makes no sense or that the preset fixes, or self-contact
            that is asked for of a physics without it.
    """

    device: Any = None

    def __init__(
        self,
        scene: str | type[Task],
        *,
        num_envs: int = 1,
        backend: str | Sequence[str] = "reference",
        backend_kwargs: Mapping[str, Any] | Sequence[Mapping[str, Any] | None] | None = None,
        obs: str = "keypoints",
        material: str | Mapping[str, float] | Material | None = None,
        randomize: Mapping[str, Sequence[float]] | None = None,
        resolution: Sequence[int] | None = None,
        preset: str | Mapping[str, Any] | None = None,
        self_contact: bool | None = None,
        observe_material: bool = False,
    ) -> None:
        self._arguments: dict[str, Any] = {
            "scene": scene, "num_envs": num_envs, "backend": backend, "backend_kwargs": backend_kwargs, "obs": obs,
            "material": material, "randomize": randomize, "resolution": resolution, "preset": preset,
            "self_contact": self_contact, "observe_material": observe_material,
        }  # fmt: skip
        self.num_envs, self.ranges = num_envs, check_ranges(randomize)
        observed = true_or_false("observe_material", observe_material)
        if observed and not self.ranges:
            raise ValueError('observe_material=True needs randomize={"drag": (0.2, 0.8)}, or another range')
        if not isinstance(scene, str):
            task_class = scene
        else:
            task_class = load_task(scene) if preset is None else load_preset(scene, preset)
        given = {"material": material, "randomize": self.ranges or None, "resolution": resolution}
        for name in task_class.fixed:
            if given[name] is not None:
                raise ValueError(f"preset={preset!r} fixes the {name}: leave {name}= out")
        base = as_material(material, task_class.material)
        shape = check_resolution(resolution, task_class.resolution)
        wanted = None if self_contact is None else true_or_false("self_contact", self_contact)
        self._listed = task_class.make_scene(resolution=shape, material=base).with_self_contact(wanted)
        parts = [self._built(choice) for choice in choices(backend, backend_kwargs, num_envs)]
        chosen = [choice for choice, _ in parts]
        self.backends = tuple(as_lists(chosen)["backend"])
        self.backend: Backend = parts[0][1]
        self._physics, who = chosen[0].line, chosen[0].name
        if len(parts) > 1:
            self.backend = MixedBackend(self._listed, [(choice.members, made) for choice, made in parts])
            self._physics = "; ".join(f"{choice.line} of {choice.whose}" for choice in chosen)
            who = ", ".join(f"{len(choice.members)} x {choice.name}" for choice in chosen)
        modelled = getattr(self.backend, "self_contact", False)
        self.scene = self._listed if modelled else replace(self._listed, self_contact=None)
        self.task: Task = task_class(self.scene)
        self._check_ranges()
        warn_unusual(material, self.ranges)
        self.title = f"{self.scene.name}{REVISED if self.task.version else ''} {self.scene.grid} {who}"
        self.failures = Failures(self.scene, self.task.max_strain)
        self.rngs: list[np.random.Generator | None] = [None] * num_envs
        self.materials = [base] * num_envs
        self.frames = np.zeros(num_envs, np.int64)
        self._episode: Episode | None = None
        self.controls: Controls | None = None
        self.rewards = np.zeros(num_envs)
        self.varied = np.zeros((num_envs, len(self.ranges)))
        self._scores: tuple[np.ndarray, ...] = ()
        self._parts = [f"reward_{name}" for name in self.task.parts]
        self._last_second: deque[Any] = deque(maxlen=max(1, round(1 / self.scene.frame_dt)))

        known = (self.varied, np.array(list(self.ranges.values())).T) if observed else ()
        self.observer = Observer(self.task, obs, *known)
        self.action_space = spaces.Box(-1.0, 1.0, (len(self.task.actions),), np.float32)

    def __repr__(self) -> str:
        return f"<World {self.title}, {counted(self.num_envs, 'environment')}, {self.progress}>"

    def _built(self, choice: Choice) -> tuple[Choice, Backend]:
        """The backend that is chosen for some members, and the choice with what a preset adds to it.

        Raises:
            ValueError, ImportError: see ``check_backend_kwargs`` and ``make_backend``; self-contact is asked for which
                it does not have. The members are named where others have another backend.
        """
        name, options, members = choice.name, choice.options, choice.members
        if name == "reference" and isinstance(options, Mapping) and "solver" not in options:
            options = {**solver_of(self._arguments["preset"]), **options}
        try:
            check_backend_kwargs(name, options, solvers=solvers_of(self._listed), beside=self._arguments)
            made = make_backend(name, self._listed, num_envs=len(members), backend_kwargs=options)
            if device_of(made) is not None:
                from cloth_envs.tensors import OnHost

                made = OnHost(made)
            built = replace(choice, options=options)
            if self._arguments["self_contact"] and not getattr(made, "self_contact", False):
                raise ValueError(
                    f"self_contact=True: {built.line} has no contact of the cloth with itself: leave self_contact out, "
                    "or use solver='explicit' (of backend='cnn': engine='compiled')"
                )
        except ValueError as error:
            if len(members) == self.num_envs:
                raise
            raise ValueError(
                f"{choice.whose}: {error} (backend_kwargs may be a list, with a dict for each member)"
            ) from error
        return built, made

    @property
    def started(self) -> bool:
        """Whether there is a cloth."""
        return self._episode is not None

    @property
    def progress(self) -> str:
        """The frames since the reset, as text."""
        if not self.started:
            return "before reset()"
        low, high = self.frames.min(), self.frames.max()
        return f"frame {low}" if low == high else f"frames {low} to {high}"

    def _check_ranges(self) -> None:
        """Refuse ``randomize`` where a corner of its ranges can't be stepped, so that no reset ever fails."""
        check_material(self.backend, self.scene.material)
        for corner in product(*self.ranges.values()):
            changes = dict(zip(self.ranges, corner, strict=True))
            try:
                check_material(self.backend, self.scene.material.with_changes(**changes))
            except ValueError as error:
                raise ValueError(f"randomize allows {changes}, which can't be stepped: {error}") from error

    @property
    def episode(self) -> Episode:
        if self._episode is None:
            raise RuntimeError("there is no cloth yet: call reset() first")
        return self._episode

    @property
    def state(self) -> State:
        return self.episode.state

    def read_only(self) -> State:
        """The present state, to read."""
        return self.state.read_only()

    def on_host(self, values: Any) -> Any:
        """Observations or rewards as NumPy arrays, which they are."""
        return values

    def _there(self, values: np.ndarray) -> Any:
        """A copy in what rewards are in."""
        return values.copy()

    def flags(self, which: np.ndarray) -> Any:
        """Bools ``(B,)`` in what rewards are in."""
        return which

    def reset(self, rngs: Mapping[int, np.random.Generator]) -> None:
        """Start new episodes for the environments named by the keys, each drawing from its own generator."""
        which = sorted(rngs)
        drawn = []
        for i in which:
            rng = self.rngs[i] = rngs[i]
            changes = {name: float(rng.uniform(lo, hi)) for name, (lo, hi) in self.ranges.items()}
            self.materials[i] = self.scene.material.with_changes(**changes) if changes else self.scene.material
            drawn.append(self.task.draw(rng))
        self.frames[which] = 0
        self._vary(which)
        self._place(which, *self._laid(stacked(drawn)))
        self._rest(which)

    def _vary(self, which: Sequence[int]) -> None:
        """Note what ``randomize`` made of the materials of some members."""
        self.varied[which] = [[getattr(self.materials[i], name) for name in self.ranges] for i in which]

    def _rest(self, which: Sequence[int]) -> None:
        """Let some members have had no action."""
        self.episode.action[which] = 0.0

    def _laid(self, drawn: dict[str, np.ndarray]) -> tuple[State, dict[str, np.ndarray]]:
        """States of starts that were drawn, and what the task remembers of them."""
        start = self.task.lay(drawn)
        state = State.still(start.positions.astype(np.float32), start.colliders.astype(np.float32))
        state.velocities[:] = start.velocities
        return state, start.memory | self.task.gripped(state.positions)

    def _place(self, which: Sequence[int], state: State, memory: dict[str, np.ndarray]) -> None:
        materials = [self.materials[i] for i in which]
        if self._episode is None:
            if len(which) < self.num_envs:
                raise RuntimeError("the first reset must start every environment")
            self.backend.reset(state, materials)
            self._episode = Episode(self.backend.state, memory, np.zeros((self.num_envs, len(self.task.actions))))
            return
        self.backend.reset(state, materials, which)
        self.episode.state = self.backend.state
        for name, values in memory.items():
            self.episode.memory[name][which] = values

    def set_positions(self, positions: np.ndarray, velocities: np.ndarray | None = None, which: int = 0) -> None:
        """See ``ClothEnv.set_positions``; ``which`` is the member."""
        state = self.state.select([which])
        parts = {
            "positions": positions,
            "velocities": np.zeros(np.shape(positions)) if velocities is None else velocities,
        }
        for name, value in parts.items():
            target = getattr(state, name)[0]
            target[:] = check_array(f"state.{name}", value, target.shape, "fiu")
        self._place([which], state, self.task.gripped(state.positions))

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, list[str | None]]:
        """One frame. Returns rewards ``(B,)`` in [0, 1] and, per environment, why it failed or None.

        A failed environment is put back to its last good state.

        Raises:
            ValueError: actions of the wrong shape or not finite; nothing has moved then.
        """
        rewards, reasons = self.advance(self.read(actions))
        return rewards, [reasons.get(i) for i in range(self.num_envs)]

    def read(self, actions: Any) -> np.ndarray:
        """Actions ``(B, A)`` as ``advance`` takes them. Raises ValueError: not numbers, or of another shape."""
        return read_actions(actions, (self.num_envs, len(self.task.actions)), self.task.actions)

    def advance(self, actions: np.ndarray) -> tuple[np.ndarray, dict[int, str]]:
        """``step`` by actions that were read already. Tells why of those members that failed.

        The rewards stay this world's, to read.
        """
        episode = self.episode
        before, clipped = episode.state, clip_actions(actions)
        if clipped is None:
            raise ValueError("action holds NaN or infinity; the state is unchanged, pass numbers in [-1, 1]")
        episode.before, episode.action = episode.action, clipped
        self.controls = self.task.controls(episode)
        episode.state = self.backend.advance(self.controls)
        tick(self.frames, self.scene.frame_dt, episode.state.time)
        reasons = self.failures.check(before, episode.state)
        failed = list(reasons)
        if failed:
            good = before.select(failed)
            good.time[:] = episode.state.time[failed]
            self.backend.reset(good, [self.materials[i] for i in failed], failed)
            episode.state = self.backend.state
        rewards, self._scores = self.task.judge(episode)
        if failed:
            for values in (rewards, *self._scores[2:]):
                values[failed] = 0.0
        self.rewards = rewards
        self._last_second.append(rewards)
        return rewards, reasons

    @property
    def told(self) -> dict[str, Any]:
        """What ``info`` tells of the last frame, ``(B,)`` each: strain, change, parts of the reward and so on."""
        return self._named(self._scores, self.strain)

    @property
    def told_of_one(self) -> dict[str, Any]:
        """``told`` of a batch of one, as Python's own numbers."""
        ((finite, strain, _),) = self.failures.health
        return self._named([values.item() for values in self._scores], strain if finite else inf)

    def _named(self, scores: Sequence[Any], strain: Any) -> dict[str, Any]:
        told: dict[str, Any] = {"strain": strain}
        if scores:
            told["change"], *scores = scores
        if scores:
            told["distance"], *parts = scores
            if self._parts:
                told["success"] = self.task.met(parts)
                told.update(zip(self._parts, parts, strict=True))
        return told

    @property
    def strain(self) -> Any:
        """The largest strain of an edge of each cloth at the end of the last frame, ``(B,)``; infinity of none."""
        return np.array([strain if finite else inf for finite, strain, _ in self.failures.health])

    def final_second(self) -> Any:
        """Mean reward of the last second, or of the episode where that is shorter, ``(B,)``."""
        newest_first = enumerate(reversed(self._last_second))
        earned = sum(rewards * (ago < self.frames) for ago, rewards in newest_first)  # in one order for every batch
        return earned / self.frames.clip(1, len(self._last_second))

    @property
    def guarded(self) -> np.ndarray:
        """The members whose last cloth, once it is read, the backend's guard drew in a plainer way, ``(B,)``."""
        return np.asarray(getattr(self.backend, "guarded", np.zeros(self.num_envs, bool)))

    @property
    def crossings(self) -> np.ndarray:
        """Pairs of each cloth's triangles that crossed as the last frame began, ``(B,)``; 0 where none are counted."""
        return np.asarray(getattr(self.backend, "crossings", np.zeros(self.num_envs, np.int32)))

    @property
    def surrogate(self) -> np.ndarray:
        """By what other means than usual each member is stepped and why, ``(B,)`` text, empty of most."""
        return np.array(getattr(self.backend, "surrogate", np.full(self.num_envs, "", object)), object)

    @property
    def measured_error(self) -> np.ndarray:
        """How far each cloth was found to be from the reference in the last frame [%], NaN if it was not, ``(B,)``."""
        return np.asarray(getattr(self.backend, "measured_error", np.full(self.num_envs, np.nan)))

    def describe(self) -> str:
        """What is modelled and what is not, and by what means, as text."""
        means = dict.fromkeys(filter(None, self.surrogate.tolist()))
        return "\n".join([self.scene.describe(), f"physics: {', '.join(dict.fromkeys(self.backends))}", *means])

    def goal(self, member: int) -> tuple[list[Mark], bool]:
        """What a picture of a member shows of its goal, and whether it is met now."""
        task, episode = self.task, self.seen_on_host()
        _, scores = task.judge(episode)
        return task.marks(episode, member), bool(task.parts and task.met(scores[2:])[member])

    def seen_on_host(self) -> Episode:
        """The present episode in NumPy arrays, which it is."""
        return self.episode

    def observe(self) -> Any:
        """See ``Observer``."""
        return self.observer(self.episode)

    def _now(self) -> Snapshot:
        memory, own = self.episode.memory, self.backend.memory
        where = self._listed, type(self.task), self._physics
        earned = np.zeros((self.num_envs, self._last_second.maxlen or 0))
        for ago, rewards in enumerate(reversed(self._last_second), 1):
            earned[:, -ago] = self.on_host(rewards)
        action = self.on_host(self.episode.action)
        return Snapshot(*where, self.state, memory, own, action, self.frames, self.materials, self.rngs, earned)

    def get_state(self, member: int | None = None) -> dict[str, np.ndarray]:
        """See ``ClothEnv.get_state``; of one ``member``, as a single environment has it."""
        now = self._now()
        return (now if member is None else now.alone(member, self._place_of)).arrays()

    def _place_of(self, member: int) -> tuple[str, int]:
        """See ``snapshot.Place``."""
        return self.backend.place(member) if isinstance(self.backend, MixedBackend) else ("", member)

    def set_state(self, saved: Mapping[str, np.ndarray], members: Sequence[int] | None = None) -> None:
        """Continue from what ``get_state`` gave, bit for bit on the same backend; ``members`` from that of one.

        Another backend continues from the same positions, velocities, bodies, goals and generators; what
        the saved one remembered beyond them is left out then.

        Raises:
            ValueError: something is missing, not finite or of another shape, the state belongs to another scene,
                preset, resolution, self_contact or number of environments, or its material can't be stepped; nothing
                has changed.
        """
        trial = not self.started and members is None
        if trial:  # what a state must hold is told by one
            self.reset({i: np.random.default_rng(0) for i in range(self.num_envs)})
        try:
            now = self._now()
            alone = {i: now.alone(i, self._place_of).other(saved) for i in members or ()}
            snapshot = now.other(saved) if members is None else now.put(alone, self._place_of)
            for material in set(snapshot.materials):
                check_material(self.backend, material)
        except BaseException:
            if trial:
                self._episode, self.rngs = None, [None] * self.num_envs
            raise
        self.frames, self.materials, self.rngs = snapshot.frames, snapshot.materials, snapshot.rngs
        self._last_second.clear()
        self._last_second.extend(self._there(rewards) for rewards in snapshot.last_second.T)
        self._vary(range(self.num_envs))
        self._place(range(self.num_envs), snapshot.state, snapshot.memory)
        forgotten = [i for i, other in alone.items() if not other.own]  # what was remembered is of another cloth
        fresh = self._now() if forgotten else now
        for i in forgotten:
            snapshot.recall(i, fresh.alone(i, self._place_of).own, self._place_of)
        if snapshot.own:
            self.backend.recall(snapshot.own)
            self.episode.state = self.backend.state
        self._act(snapshot.action)

    def _act(self, action: np.ndarray) -> None:
        """Take ``action`` ``(B, A)`` as the last one."""
        self.episode.action = action

    def __getstate__(self) -> dict[str, Any]:
        """What makes it again, since a backend need not know how to copy itself: arguments and state."""
        named = {name: BACKENDS[name] for name in set(self.backends) if name in BACKENDS}
        return {
            "arguments": self._arguments,
            "factories": named,  # of ``register_backend``, for other processes
            "rngs": self.rngs,
            "state": self.get_state() if self.started else None,
            "controls": self.controls,
        }

    def __setstate__(self, saved: dict[str, Any]) -> None:
        for name, factory in saved["factories"].items():
            if name not in BACKENDS:
                register_backend(name, factory)
        type(self).__init__(self, **saved["arguments"])
        if saved["state"] is not None:
            self.set_state(saved["state"])
        self.controls = saved["controls"]
        self.rngs = saved["rngs"]
