"""The vector environment: one batched state, threads over its members."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from array_api_compat import array_namespace
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from cloth_envs import folds
from cloth_envs.arguments import (
    as_items,
    as_whole,
    check_mask,
    check_reset_options,
    check_seeds,
    one_of,
    true_or_false,
    whole_number,
)
from cloth_envs.backend import device_of, keywords, plain_words
from cloth_envs.choice import Choice, as_lists, choices
from cloth_envs.members import Members
from cloth_envs.naming import counted
from cloth_envs.observation import member
from cloth_envs.options import check_options
from cloth_envs.registry import load_backend
from cloth_envs.scene import Scene
from cloth_envs.scenes.task import Task
from cloth_envs.snapshot import check_array
from cloth_envs.state import State
from cloth_envs.world import World

if TYPE_CHECKING:
    from cloth_envs.rendering import Renderer

OUTPUTS = ("numpy", "torch")
OWN = ("ended", "ahead")  # of a state, beside the world's
DRAWN = 16  # members that are drawn
_MODES = {mode.value: mode for mode in AutoresetMode}


class ClothVectorEnv(Members, VectorEnv[Any, Any, np.ndarray]):
    """``num_envs`` cloths stepped together; made by ``gym.make_vec(id, num_envs=N, ...)``.

    Member i is bit-equal to the single environment with the same seed and actions.

    Arguments:
        num_envs: members.
        max_episode_steps: frames until truncation; None or -1 for no limit.
        autoreset_mode: ``"NextStep"``, ``"SameStep"`` or ``"Disabled"`` (or Gymnasium's ``AutoresetMode``).
        output: ``"numpy"``, or ``"torch"``: observations, rewards and both flags are tensors, of a backend on a device,
            such as ``backend="cnn"`` with ``{"device": "cuda"}``. Such a backend's controls, rewards and observations
            are computed there either way; actions may be a tensor.
        desync: whether first episodes after a reset of all end at different times: that of member i by ``i / num_envs``
            of the limit earlier. What starts then is whole.
        render_mode: ``"rgb_array"``: ``render()`` gives a picture of each of the first 16 members.
        backend, backend_kwargs: as of ``ClothEnv``, or a list with one for each member, such as
            ``["miniature"] * 31 + ["reference"]`` and ``[{"factor": 4}] * 31 + [{}]``. A backend that takes ``threads``
            gets as many as processors are at hand.
        The others are those of ``ClothEnv``.

    Raises:
        ValueError: a bad argument; says what to write instead.
    """

    _renderer: "Renderer | None" = None  # Gymnasium closes what was refused, too

    def __init__(
        self,
        scene: str,
        *,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        output: str = "numpy",
        desync: bool = False,
        render_mode: str | None = None,
        show_goal: bool = True,
        **options: Any,
    ) -> None:
        if render_mode is not None:
            one_of("render_mode", render_mode, ["rgb_array"])
        self.show_goal = true_or_false("show_goal", show_goal)
        options = plain_words(options)
        check_options(options, scene, World, type(self))
        num_envs = whole_number("num_envs", num_envs)
        name = autoreset_mode.value if isinstance(autoreset_mode, AutoresetMode) else autoreset_mode
        self.autoreset_mode = _MODES[one_of("autoreset_mode", name, _MODES)]
        self._tensors = one_of("output", output, OUTPUTS) == "torch"
        self._limit = _limit(max_episode_steps)
        self._desync = true_or_false("desync", desync)
        if self._desync and self._limit is None:
            raise ValueError("desync=True needs episodes that end: pass max_episode_steps")
        self.world = _on_its_device(World(scene, num_envs=num_envs, **threaded(options, num_envs)))
        if self._tensors and self.world.device is None:
            raise ValueError(
                f'output="torch" needs one backend on a device, such as backend="cnn", '
                f'backend_kwargs={{"device": "cuda"}}, got {self.world.title}, which has NumPy arrays: leave output out'
            )
        if options.get("resolution") is not None:
            folds.warn_coarse(self.world.scene)
        self.num_envs = num_envs
        self.render_mode = render_mode
        self._starts: State | None = None  # of the episodes of members that are drawn
        self.metadata = {
            "autoreset_mode": self.autoreset_mode,
            "render_modes": ["rgb_array"],
            "render_fps": round(1 / self.world.scene.frame_dt),
        }
        self.single_observation_space = self.world.observer.space
        self.single_action_space = self.world.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._ended = np.zeros(num_envs, bool)
        self._ahead = np.zeros(num_envs, np.int64)  # frames by which an episode is shorter than the limit
        self._seeds: list[int | None] = [None] * num_envs

    def __repr__(self) -> str:
        return f"<ClothVectorEnv {self.world.title}, {counted(self.num_envs, 'environment')}, {self.world.progress}>"

    @property
    def scene(self) -> Scene:
        """The frozen ``Scene``; it lists self-contact where all members' backends model it."""
        return self.world.scene

    @property
    def task(self) -> Task:
        """The task of all members, which maps actions to controls and states to rewards."""
        return self.world.task

    @property
    def backends(self) -> tuple[str, ...]:
        """The backend's name of every member."""
        return self.world.backends

    @property
    def state(self) -> State:
        """The present batched state; read only. In tensors, with ``output="torch"``."""
        return self.world.state if self._tensors else self.world.read_only()

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start episodes. A number seeds member i with ``seed + i``.

        ``options={"reset_mask": mask}``, bool ``(B,)``, starts only some members.

        Raises:
            ValueError: no seeds, or not as many as members; another option; no mask, or one that picks none.
        """
        n = self.num_envs
        seeds = check_seeds(seed, n)
        mask = check_mask(check_reset_options(options, ["reset_mask"]).get("reset_mask", [True] * n), n)
        for i in np.flatnonzero(mask).tolist():
            if seeds[i] is not None or self.world.rngs[i] is None:
                self._seed(i, seeds[i])
        self._start(np.flatnonzero(mask))
        if self._desync and self._limit is not None and mask.all():
            self._ahead = self._limit * np.arange(n) // n
        return self._out(self.world.observe()), self._by_other_means(mask) | self._material(mask)

    def describe(self) -> str:
        """What the physics models and what it does not, and by what means, as text."""
        return self.world.describe()

    def _by_other_means(self, started: np.ndarray) -> dict[str, np.ndarray]:
        """``info["surrogate"]`` of the members that have ``started``, bool ``(B,)``."""
        if not started.any():
            return {}
        why = self.world.surrogate
        told = started & (why != "")
        why[~told] = None
        return _told("surrogate", why, told)

    def _start(self, which: np.ndarray) -> None:
        rngs = {int(i): rng for i in which if (rng := self.world.rngs[i]) is not None}
        self.world.reset(rngs)
        self._ended[which], self._ahead[which] = False, 0
        if self.render_mode is not None:
            now = self.world.read_only().select(slice(DRAWN))
            if self._starts is None:
                self._starts = now
            drawn = which[which < DRAWN]
            self._starts.assign(drawn, now.select(drawn))

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Pictures uint8 ``(240, 320, 3)`` of the first 16 members, which Gymnasium's ``RecordVideo`` tiles."""
        if self.render_mode is None:
            gym.logger.warn("render() was called without a render_mode; pass render_mode='rgb_array' to gym.make_vec")
            return None
        if self._renderer is None:
            from cloth_envs.rendering import Renderer

            self._renderer = Renderer(self.scene, width=320, height=240)
        pictures, state = [], self.world.read_only()
        for i in range(min(DRAWN, self.num_envs)):
            marks, met = self.world.goal(i) if self.show_goal else ((), False)
            pictures.append(self._renderer.draw(state, start=self._starts, member=i, marks=marks, met=met))
        return tuple(pictures)

    def close_extras(self, **kwargs: Any) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderer": None}  # a copy draws with its own

    def step(self, actions: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        world, n = self.world, self.num_envs
        again = np.flatnonzero(self._ended)
        if again.size and self.autoreset_mode is AutoresetMode.DISABLED:
            raise RuntimeError(
                f"environments {again.tolist()} have ended: reset them with "
                'reset(options={"reset_mask": terminated | truncated})'
            )
        earned, reasons = world.advance(world.read(actions))
        rewards = 1.0 * earned  # the caller's
        terminated = np.zeros(n, bool)
        terminated[list(reasons)] = True
        truncated = np.zeros(n, bool) if self._limit is None else world.frames + self._ahead >= self._limit
        if again.size:  # next-step mode: this step only starts the new episode of those
            self._start(again)
            rewards[again], terminated[again], truncated[again] = 0.0, False, False
        ended = self._ended = terminated | truncated
        infos: dict[str, Any] = {}
        if ended.any():
            infos = self._tell("final_second", world.final_second(), ended)
        if terminated.any():
            told = np.full(n, None, dtype=object)
            for i in np.flatnonzero(terminated).tolist():
                told[i] = reasons[i]
            infos["failure"], infos["_failure"] = told, terminated.copy()
        observations = self._out(world.observe())
        if self.autoreset_mode is AutoresetMode.SAME_STEP and ended.any():
            finals = np.full(n, None, dtype=object)
            for i in np.flatnonzero(ended):
                finals[i] = member(observations, int(i))
            last = infos | self._of_frame(ended) | self._material(ended)
            infos = {"final_obs": finals, "_final_obs": ended.copy(), "final_info": last, "_final_info": ended.copy()}
            frame, started = self._of_frame(~ended), ended.copy()
            self._start(np.flatnonzero(ended))
            observations = self._out(world.observe())
        else:
            started = np.zeros(n, bool)
            started[again] = True
            frame = self._of_frame(~started)
        infos = infos | frame | self._by_other_means(started) | self._material(np.ones(n, bool))
        return observations, self._out(rewards), self._flags(terminated), self._flags(truncated), infos

    def _out(self, values: Any) -> Any:
        """Observations or rewards in what ``output`` asks for."""
        return values if self._tensors else self.world.on_host(values)

    def _flags(self, flags: np.ndarray) -> Any:
        """The same of flags ``(B,)``, of which only those that are set are sent."""
        return self.world.flags(flags) if self._tensors else flags

    def _of_frame(self, which: np.ndarray) -> dict[str, np.ndarray]:
        """What the task and the backend tell of the last frame of members ``which``, bool ``(B,)``."""
        told: dict[str, np.ndarray] = {}
        if (guarded := self.world.guarded).any():
            told |= _told("guard", guarded & which, guarded & which)
        if (crossings := self.world.crossings).any():
            told |= _told("crossings_at_start", crossings * which, (crossings > 0) & which)
        for name, values in self.world.told.items():
            told |= self._tell(name, values, which)
        if not (unknown := np.isnan(error := self.world.measured_error)).all():
            told |= _told("measured_error", np.where(which & ~unknown, error, 0.0), which & ~unknown)
        return told

    def _tell(self, name: str, values: Any, which: np.ndarray) -> dict[str, Any]:
        """``_told`` of numbers or flags as the world has them, for those of all members."""
        if not which.all():
            xp, rest = array_namespace(values), ~which
            nothing = xp.zeros_like(values)
            if rest.sum() < which.sum():  # the fewer are sent to a device
                values = xp.where(self.world.flags(rest), nothing, values)
            else:
                values = xp.where(self.world.flags(which), values, nothing)
        return _told(name, self._out(values), which)

    def _material(self, which: np.ndarray) -> dict[str, Any]:
        """``info["material"]`` of members ``which``, bool ``(B,)``, where it is randomised."""
        told: dict[str, Any] = {}
        for name, values in zip(self.world.ranges, self.world.varied.T, strict=True):
            told |= _told(name, values * which, which)
        return _told("material", told, which) if told else {}

    def _seed(self, i: int, seed: int | None) -> None:
        self.world.rngs[i], self._seeds[i] = seeding.np_random(seed)

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """What draws the next starts, one a member, as Gymnasium's own vector environments have it."""
        for i, rng in enumerate(self.world.rngs):
            if rng is None:
                self._seed(i, None)
        return tuple(rng for rng in self.world.rngs if rng is not None)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """What those were made from, -1 where that is not known."""
        return tuple(-1 if seed is None else seed for _, seed in zip(self.np_random, self._seeds, strict=True))

    def draw_by(self, rng: np.random.Generator, member: int) -> None:
        """Let ``rng`` draw the next starts of a member. Raises ValueError: it is no generator."""
        if not isinstance(rng, np.random.Generator):
            raise ValueError(f"np_random must be a generator, such as numpy.random.default_rng(0), got {rng!r}")
        self.world.rngs[member], self._seeds[member] = rng, None

    def get_state(self, member: int | None = None) -> dict[str, np.ndarray]:
        """Everything that decides the future, as arrays; see ``ClothEnv.get_state``.

        That of one ``member`` is a single environment's, which goes on from it too.

        Raises:
            ValueError: there is no such member.
        """
        if member is not None:
            return self.world.get_state(self._index(member))
        return {**self.world.get_state(), "ended": self._ended.copy(), "ahead": self._ahead.copy()}

    def set_state(self, state: dict[str, np.ndarray], member: int | Sequence[int] | None = None) -> None:
        """Continue from what ``get_state`` gave, bit for bit.

        With a ``member``, or several, only they go on, from a single environment's state.

        Raises:
            ValueError: see ``World.set_state``, or there is no such member; nothing has changed.
        """
        if member is not None:
            items = as_items(member)
            which = [self._index(i) for i in ([member] if items is None else items)]
            self.world.set_state(state, which)
            self._ended[which], self._ahead[which] = False, 0
            for i in which:
                self._seeds[i] = None
            return
        lacks = [name for name in OWN if not isinstance(state, Mapping) or name not in state]
        if lacks:
            raise ValueError(f"this state lacks {', '.join(lacks)}: pass what get_state() of a vector environment gave")
        ended = check_array("ended", state["ended"], self._ended.shape, "b")
        ahead = check_array("ahead", state["ahead"], self._ahead.shape, "iu")
        self.world.set_state({name: value for name, value in state.items() if name not in OWN})
        self._ended, self._ahead, self._seeds = ended, ahead, [None] * self.num_envs
        if self._starts is None and self.render_mode is not None:
            self._starts = self.world.read_only().select(slice(DRAWN))

    def _index(self, member: object) -> int:
        index = as_whole(member)
        if index is None or not 0 <= index < self.num_envs:
            raise ValueError(f"member must be a whole number of 0 to {self.num_envs - 1}, got {member!r}")
        return index


def _on_its_device(world: World) -> World:
    """``world``, or where its backend is on a device one with everything there."""
    if device_of(world.backend) is None:
        return world
    from cloth_envs.device import DeviceWorld

    return DeviceWorld.of(world)


def threaded(options: dict[str, Any], num_envs: int) -> dict[str, Any]:
    """A world's ``options`` with as many threads as processors are at hand, where backends take them."""
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    chosen = choices(options.get("backend", "reference"), options.get("backend_kwargs"), num_envs)
    return options | as_lists([_threaded(choice, min(num_envs, processors)) for choice in chosen])


def _threaded(choice: Choice, threads: int) -> Choice:
    """``choice`` with ``threads``, where the backend takes them and none are given."""
    if isinstance(choice.options, Mapping) and "threads" in keywords(load_backend(choice.name)):
        return replace(choice, options={"threads": threads, **choice.options})
    return choice


def _told(name: str, values: Any, which: np.ndarray) -> dict[str, Any]:
    """An info that some members have, bool ``(B,)``; nothing of none. Others are 0, False or None, as Gymnasium's."""
    return {name: values, f"_{name}": which.copy()} if which.any() else {}


def _limit(frames: int | None) -> int | None:
    """``max_episode_steps`` as Gymnasium's ``make`` reads it."""
    if frames is None or as_whole(frames) == -1:
        return None
    try:
        return whole_number("max_episode_steps", frames)
    except ValueError as error:
        raise ValueError(f"{error}: write -1 for no limit") from None
