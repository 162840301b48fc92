"""What every scene file fills in: a Task maps actions to controls and states to rewards, batched."""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, reduce
from inspect import cleandoc
from operator import mul
from textwrap import fill
from typing import Any, ClassVar

import numpy as np
from array_api_compat import array_namespace, device

from cloth_envs.failure import MAX_STRAIN
from cloth_envs.grid import Grid
from cloth_envs.marks import Mark
from cloth_envs.material import Material
from cloth_envs.naming import REVISED
from cloth_envs.registry import EPISODE_FRAMES
from cloth_envs.scene import Scene
from cloth_envs.scenes import drives, measures
from cloth_envs.scenes.derived import TaskType, derived
from cloth_envs.state import Controls, State

# What a task tells agents of its cloth, which moves the same whatever that is.
TOLD = frozenset(
    (
        "observe",
        "way",
        "ways",
        "revision",
        "extras",
        "extras_bound",
        "lattice",
        "reward",
        "score",
        "parts",
        "away",
        "enough",
        "marks",
        "max_strain",
    )
)


@dataclass
class Start:
    """How an episode begins: ``positions`` and ``velocities`` ``(3, H, W)``, ``colliders`` ``(C, 2, 3)``.

    Bodies are outside the cloth, or a centimetre inside at most: cloth that is deeper in them is flung out.

    ``memory`` holds what the task must remember (goals, gust phases); one array a name. Of a batch all have one more
    axis, the first.
    """

    positions: np.ndarray
    velocities: np.ndarray
    colliders: np.ndarray
    memory: dict[str, np.ndarray] = field(default_factory=dict)

    @classmethod
    def still(
        cls, positions: np.ndarray, memory: dict[str, np.ndarray], colliders: np.ndarray | None = None
    ) -> "Start":
        """A batch at rest; without bodies, where none are given."""
        xp = array_namespace(positions)
        if colliders is None:
            colliders = xp.zeros((len(positions), 0, 2, 3), dtype=positions.dtype, device=device(positions))
        return cls(positions, xp.zeros_like(positions), colliders, memory)


@dataclass
class Episode:
    """What a task sees at a step: the batch's state, its memory ``(B, ...)`` and the clipped action ``(B, A)``.

    ``action`` is 0 at an episode's start; ``before`` is that of the frame before, or a number for all.
    """

    state: State
    memory: dict[str, np.ndarray]
    action: np.ndarray
    before: np.ndarray | float = 0.0

    @property
    def cloth(self) -> np.ndarray:
        """Positions with flat vertices, ``(B, 3, H * W)``; a view."""
        return self.state.positions.reshape(len(self.action), 3, -1)

    @property
    def cloth_velocity(self) -> np.ndarray:
        """Velocities with flat vertices, ``(B, 3, H * W)``; a view."""
        return self.state.velocities.reshape(len(self.action), 3, -1)


class Task(metaclass=TaskType):
    """One scene's task. Every method takes and returns batches, so single and vector environments agree bit for bit.

    Batches are NumPy arrays, or tensors where an environment lives on a device: of a copy of the task, then, whose own
    arrays are tensors there.
    """

    size: ClassVar[tuple[float, float]]  # rest height and width [m]
    resolution: ClassVar[tuple[int, int]]  # default rows and columns
    frame_dt: ClassVar[float]  # s
    actions: ClassVar[tuple[str, ...]]  # names of the action's components, each in [-1, 1]
    lattice: ClassVar[tuple[int, int]]  # rows and columns of the keypoints in the default observation
    extras: ClassVar[tuple[str, ...]]  # names of the numbers that follow the keypoints in the observation
    extras_bound: ClassVar[float] = 100.0  # on their absolute value
    parts: ClassVar[tuple[str, ...]] = ()  # names of what the reward is the product of, for those with a ``score``
    away: ClassVar[str] = ""  # what the distance to the goal is
    enough: ClassVar[float] = 0.9  # of every part but effort, for success
    ways: ClassVar[tuple[str, ...]] = ()  # names of what ``way`` gives
    version: ClassVar[int] = 0  # of the task; from 1 on effort is priced, last actions and ``ways`` are told
    revision: ClassVar[Mapping[str, Any]] = {}  # what version 1 has in the place of this class's attributes
    written: ClassVar[str]  # of the docstring, what is the scene's own
    material: ClassVar[Material] = Material()
    max_strain: ClassVar[float] = MAX_STRAIN  # of an edge, at which an episode ends as overstretched
    drive: drives.Drive  # what the action moves, in scenes where it moves something
    options: ClassVar[Mapping[str, float | str]] = {}  # what a preset lets its user change (``with_options``)
    fixed: ClassVar[tuple[str, ...]] = ()  # what a preset leaves no choice of
    watched: np.ndarray | None = None  # the vertices that the task reads, but for whole meshes; None: maybe all

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.keypoints = scene.grid.keypoints(*self.lattice).astype(np.int32)
        self.handles = np.array(scene.handles, dtype=np.int32)
        self.leads = self.handles[scene.holding.lead]  # the vertex that each handle moves with
        self.led = bool((self.leads != self.handles).any())  # whether one moves with another

    def watch(self, *more: np.ndarray | int) -> None:
        """Say that the task reads keypoints, handles and ``more`` vertices only; what others read nobody knows."""
        if type(self).__module__.split(".")[0] == __name__.split(".")[0]:
            parts = self.keypoints, self.handles, *map(np.atleast_1d, more)
            self.watched = np.unique(np.concatenate(parts)).astype(np.int64)

    def __repr__(self) -> str:
        return f"<Task {type(self).__name__} {self.scene.grid}, actions {', '.join(self.actions)}>"

    @classmethod
    def make_scene(cls, *, resolution: tuple[int, int], material: Material) -> Scene:
        """The scene at this resolution and material, and what drives it."""
        return replace(cls.build_scene(Grid(*resolution, *cls.size), material), driven_by=cls._driver())

    @classmethod
    def _driver(cls) -> str:
        """See ``Scene.driven_by``: the first class, seen from this one, that changes more than ``TOLD``."""
        for each in cls.__mro__:
            if each.__module__.partition(".")[0] == __name__.partition(".")[0]:
                return ""
            own = {name for name in vars(each) if name == "__init__" or not name.startswith(("__", "_abc_"))}
            if own - TOLD:
                return f"{each.__module__}:{each.__qualname__}"
        return ""

    @classmethod
    @abstractmethod
    def build_scene(cls, grid: Grid, material: Material) -> Scene:
        """The scene on ``grid``."""

    @classmethod
    def with_options(cls, **options: Any) -> "type[Task]":
        """The task with some of its ``options`` changed; for those that have any."""
        raise NotImplementedError(f"{cls.__name__} says how its options {', '.join(options)} change it")

    def __init_subclass__(cls) -> None:
        """What a class has of its own comes in the place of an inherited ``start``, or ``draw`` and ``lay``."""
        own = vars(cls)
        if "start" in own and "draw" not in own:
            cls.draw, cls.lay = Task.draw, Task.lay  # type: ignore[method-assign]
        elif "start" not in own and ("draw" in own or "lay" in own):
            cls.start = _one_of(cls)  # type: ignore[method-assign, assignment]
        if "reward" in own and "score" not in own:
            cls.parts = ()  # they make another reward

    @classmethod
    @cache
    def revised(cls) -> "type[Task]":
        """Version 1 of the task: this class with its ``revision``."""
        own = {"version": 1, **cls.revision}
        told = own.get("extras", cls.extras)
        own["extras"] = (*(f"last {name}" for name in cls.actions), *cls.ways, *told)
        own["parts"] = (*own.get("parts", cls.parts), "effort")
        revised: type[Task] = derived(cls, f"{cls.__name__}{REVISED}", own, "revised")
        if "written" in vars(cls):
            revised.__doc__ = _page(revised)
        return revised

    def start(self, rng: np.random.Generator) -> Start:
        """A random start; draws only from ``rng``. A scene has this, or ``draw`` and ``lay``."""
        raise NotImplementedError(f"{type(self).__name__} needs a start, or draw and lay")

    def draw(self, rng: np.random.Generator) -> dict[str, Any]:
        """What is random of one start, numbers or arrays by name; draws only from ``rng``."""
        start = self.start(rng)
        whole = {"positions": start.positions, "velocities": start.velocities, "colliders": start.colliders}
        return whole | start.memory

    def lay(self, drawn: dict[str, np.ndarray]) -> Start:
        """Starts of what was drawn for B members, ``(B, ...)`` each; on a device the arrays are tensors there."""
        memory = dict(drawn)
        return Start(memory.pop("positions"), memory.pop("velocities"), memory.pop("colliders"), memory)

    @abstractmethod
    def controls(self, episode: Episode) -> Controls:
        """Where driven things are at the end of the coming frame."""

    def gripped(self, positions: np.ndarray) -> dict[str, np.ndarray]:
        """What is remembered of cloths ``(B, 3, H, W)`` as they are gripped: each handle's way from its lead [m].

        Nothing where every handle leads itself.
        """
        if not self.led:
            return {}
        xp = array_namespace(positions)
        vertices = xp.permute_dims(positions.reshape(len(positions), 3, -1), (0, 2, 1))
        at, lead = (xp.astype(vertices[:, which], xp.float64) for which in (self.handles, self.leads))
        return {"grips": at - lead}

    def hold(self, episode: Episode) -> Controls:
        """Controls that bring every handle and body to rest where it is now; a scene changes what it drives.

        What a grip holds is where it would be if it had moved with the vertex that leads it alone.
        """
        controls = Controls(*drives.hold(episode.state.positions, self.leads, episode.state.colliders))
        if "grips" in episode.memory:
            controls.handle_positions += episode.memory["grips"]
        return controls

    def carry(self, episode: Episode, position: np.ndarray, velocity: np.ndarray, share: np.ndarray) -> Controls:
        """Controls whose handles take ``share`` ``(N, n)`` of what the action moves, at rest otherwise.

        ``position`` and ``velocity`` ``(B, n)`` are those of what ``self.drive`` moves.
        """
        controls = self.hold(episode)
        moved, reached = self.drive(position, velocity, episode.action)
        drives.carry(controls.handle_positions, controls.handle_velocities, moved, reached, share)
        return controls

    def middle(self, episode: Episode) -> np.ndarray:
        """Mean position of the keypoints, ``(B, 3)`` [m]."""
        return measures.mean_point(episode.state.positions, self.keypoints)

    def middle_velocity(self, episode: Episode) -> np.ndarray:
        """Mean velocity of the keypoints, ``(B, 3)`` [m/s]."""
        return measures.mean_point(episode.state.velocities, self.keypoints)

    def speed(self, episode: Episode, first: int = 0, last: int = 3) -> np.ndarray:
        """Root mean square over the keypoints of velocity components ``first`` to ``last - 1``, ``(B,)`` [m/s]."""
        return measures.root_mean_square(episode.state.velocities, self.keypoints, first, last)

    def marks(self, episode: Episode, member: int) -> list[Mark]:
        """What pictures of a member show of its goal; NumPy arrays only."""
        return []

    @abstractmethod
    def observe(self, episode: Episode) -> np.ndarray:
        """The extras, ``(B, len(extras))``; of version 1 the last of them."""

    def way(self, episode: Episode) -> np.ndarray:
        """What is left to do, ``(B, len(ways))``: the goal less what has to get there, in the task's own measures."""
        raise NotImplementedError(f"{type(self).__name__} has no way, which version 1 tells")

    def numbers(self, episode: Episode) -> np.ndarray:
        """The extras, ``(B, len(extras))``: of version 1 the last action, the ways, then what ``observe`` gives."""
        told = self.observe(episode)
        return measures.columns(episode.action, self.way(episode), told) if self.version else told

    def score(self, episode: Episode) -> tuple[np.ndarray, ...]:
        """The distance to the goal, then ``parts`` in [0, 1], ``(B,)`` each, new arrays.

        A scene has this, or ``reward``.

        Raises:
            NotImplementedError: it has neither.
        """
        if type(self).reward is Task.reward:
            raise NotImplementedError(f"{type(self).__name__} needs a score, or a reward")
        return ()

    def reward(self, episode: Episode) -> np.ndarray:
        """``(B,)`` in [0, 1]: the product of the parts, where a scene has no other."""
        return _product(self._scores(episode, measures.change(episode.action, episode.before))[1:])

    def judge(self, episode: Episode) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """The reward of a frame, and the change of the action with the score, each measured once."""
        change = measures.change(episode.action, episode.before)
        scores = self._scores(episode, change)
        own = type(self).reward is not Task.reward
        return self.reward(episode) if own else _product(scores[1:]), (change, *scores)

    def _scores(self, episode: Episode, change: np.ndarray) -> tuple[np.ndarray, ...]:
        """The distance and all ``parts``: of version 1 effort too, 0 where an action turns from bound to bound."""
        scores = self.score(episode)
        return (*scores, 1.0 - 0.5 * change) if self.version else scores

    def met(self, parts: Sequence[np.ndarray]) -> np.ndarray:
        """Whether a frame of these ``parts`` is a success, bool ``(B,)``: each but effort is at least ``enough``."""
        met = parts[0] >= self.enough
        for part in parts[1 : len(parts) - (self.version > 0)]:
            met = met & (part >= self.enough)
        return met


def _product(parts: Sequence[np.ndarray]) -> np.ndarray:
    """A new array, also of one part."""
    return reduce(mul, parts) if len(parts) > 1 else 1.0 * parts[0]


def _one_of(task: type[Task]) -> Callable[[Task, np.random.Generator], Start]:
    """The ``start`` that ``draw`` and ``lay`` of this very class make."""

    def start(self: Task, rng: np.random.Generator) -> Start:
        """A random start; draws only from ``rng``."""
        batch = task.lay(self, stacked([task.draw(self, rng)]))
        memory = {name: values[0] for name, values in batch.memory.items()}
        return Start(batch.positions[0], batch.velocities[0], batch.colliders[0], memory)

    return start


def stacked(drawn: Sequence[Mapping[str, Any]]) -> dict[str, np.ndarray]:
    """What ``Task.draw`` gave for each of some members, ``(B, ...)``."""
    return {name: np.array([one[name] for one in drawn]) for name in drawn[0]}


def documented(task: type[Task]) -> type[Task]:
    """Add to a scene's docstring what is told of every one."""
    task.written = cleandoc(task.__doc__ or "")
    task.__doc__ = _page(task)
    return task


def _page(task: type[Task]) -> str:
    """The docstring of a scene, or of its revision."""
    n, name = EPISODE_FRAMES[task.__name__], task.__name__.removesuffix(REVISED)
    parts = ", ".join(f"`reward_{part}`" for part in task.parts)
    every = "every part but `reward_effort`" if task.version else "every part"
    told = fill(f"The extras, in order: {', '.join(task.extras)}.", 115)
    mesh = '`obs="mesh"`: the geometry image and the same extras.'
    own = task.written.replace("\n\n## Rewards", f"\n{mesh}\n{told}\n\n## Rewards")
    return f"""{own}

## Episode End
Truncated after {n} frames ({n * task.frame_dt:g} s). Terminated when the simulation fails (`info["failure"]`).

## Info
On every step: {parts}, whose product is the reward; `distance`, {task.away}; `success`,
whether {every} is at least {task.enough:g}; `strain`, the largest of an edge; `change`, the mean absolute change of
the action's components since the frame before. More is in docs/using.md.

## Arguments
`backend`, `backend_kwargs`, `obs`, `material`, `randomize`, `observe_material`, `resolution`, `preset`, `self_contact`,
`render_mode`: see `ClothEnv`.

## Version History
v0: first version.
v1: `MiniCloth-{name}-v1`, what *Version 1* says above, and as in all scenes: before the extras are the last
action and what is left to do; the reward is multiplied by `reward_effort`, 1 - `change` / 2, which success leaves
out."""
