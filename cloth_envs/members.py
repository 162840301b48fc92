"""One cloth as callers see it, of a single environment or a batch, and what Gymnasium calls in each of a batch."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cloth_envs.arguments import per_member
from cloth_envs.naming import unknown_name
from cloth_envs.scene import Scene
from cloth_envs.scenes.task import Task
from cloth_envs.state import State
from cloth_envs.world import World

if TYPE_CHECKING:
    from gymnasium import Space
    from gymnasium.envs.registration import EnvSpec

    from cloth_envs.vector_env import ClothVectorEnv


class OneCloth:
    """What is read of one member of ``world``."""

    __slots__ = ()
    world: World

    @property
    def scene(self) -> Scene:
        """The frozen ``Scene``; ``scene.describe()`` says what is modelled."""
        return self.world.scene

    @property
    def task(self) -> Task:
        """The task that maps actions to controls and states to rewards."""
        return self.world.task

    @property
    def state(self) -> State:
        """The present state, a batch of one; read only."""
        return self.world.read_only()

    @property
    def positions(self) -> np.ndarray:
        """A float32 copy, ``(3, H, W)`` [m]."""
        return self.state.positions[0].astype(np.float32)

    @property
    def velocities(self) -> np.ndarray:
        """A float32 copy, ``(3, H, W)`` [m/s]."""
        return self.state.velocities[0].astype(np.float32)

    @property
    def time(self) -> float:
        """Simulated time since the reset [s]."""
        return float(self.state.time[0])

    def describe(self) -> str:
        """What the physics models and what it does not, and by what means, as text."""
        return self.world.describe()


class Member(OneCloth):
    """Member ``index`` of a vector environment, by the words of a single one: what ``call`` and ``get_attr`` reach."""

    __slots__ = ("_env", "_index")  # setting another raises AttributeError

    def __init__(self, env: "ClothVectorEnv", index: int) -> None:
        self._env, self._index = env, index

    @property
    def world(self) -> World:  # type: ignore[override]
        """The engine, which all members share."""
        return self._env.world

    @property
    def state(self) -> State:
        """A copy of the present state, a batch of one."""
        return self.world.read_only().select([self._index])

    @property
    def backend(self) -> str:
        """The backend's name."""
        return self.world.backends[self._index]

    @property
    def np_random(self) -> np.random.Generator:
        """What draws the next start. Setting it raises ValueError: no generator of NumPy."""
        return self._env.np_random[self._index]

    @np_random.setter
    def np_random(self, value: np.random.Generator) -> None:
        self._env.draw_by(value, self._index)

    @property
    def np_random_seed(self) -> int:
        """What ``np_random`` was made from, or -1 where that is not known."""
        return self._env.np_random_seed[self._index]

    @property
    def observation_space(self) -> "Space[Any]":
        return self._env.single_observation_space

    @property
    def action_space(self) -> "Space[Any]":
        return self._env.single_action_space

    @property
    def render_mode(self) -> str | None:
        return self._env.render_mode

    @property
    def spec(self) -> "EnvSpec | None":
        """The batch's."""
        return self._env.spec

    def set_positions(self, positions: np.ndarray, velocities: np.ndarray | None = None) -> None:
        """See ``ClothEnv.set_positions``."""
        self.world.set_positions(positions, velocities, self._index)

    def get_state(self) -> dict[str, np.ndarray]:
        """That of the member alone, as a single environment gives and takes it."""
        return self._env.get_state(self._index)

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """See ``ClothEnv.set_state``; other members stay as they are."""
        self._env.set_state(state, self._index)


class Members:
    """What Gymnasium's own vector environments offer of the single ones in them."""

    num_envs: int

    @abstractmethod
    def set_state(self, state: dict[str, np.ndarray], member: int | Sequence[int] | None = None) -> None:
        """See ``ClothVectorEnv``."""

    @property
    def members(self) -> list[Member]:
        """One each, made as they are asked for: an environment that held them would outlive its last user."""
        return [Member(self, i) for i in range(self.num_envs)]  # type: ignore[arg-type]

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """What a method of a single environment gives for each member, or what it is, if it is no method.

        Raises:
            AttributeError: members have no such thing.
        """
        self._check(name)
        if name == "set_state":  # of all at once, which takes the time of one
            self.set_state(*args, **kwargs | {"member": range(self.num_envs)})
            return (None,) * self.num_envs
        found = [getattr(member, name) for member in self.members]
        return tuple(each(*args, **kwargs) if callable(each) else each for each in found)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """What an attribute of a single environment is for each member, such as ``"positions"``; see ``call``."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set what can be set, ``"np_random"``: to the entries of a list or tuple, or to one value for all.

        Raises:
            AttributeError: members have no such thing, or it can't be set. ValueError: not one entry for each.
        """
        self._check(name)
        if getattr(getattr(Member, name), "fset", None) is None:
            raise AttributeError(f"{name} of members can't be set, np_random can")
        each = values if isinstance(values, (list, tuple)) else [values] * self.num_envs
        for member, value in zip(self.members, per_member(name, each, self.num_envs), strict=True):
            setattr(member, name, value)

    def _check(self, name: str) -> None:
        known = [known for known in dir(Member) if not known.startswith("_")]
        if name not in known:
            raise AttributeError(str(unknown_name("attribute of members:", name, known)))
