"""One backend made of several, which step their members of a batch each."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cloth_envs.backend import Backend, Stateful, check_material
from cloth_envs.choice import spans
from cloth_envs.failure import find
from cloth_envs.material import Material
from cloth_envs.scene import Scene
from cloth_envs.state import Cloth, Controls, Health, LazyState, State


class MixedBackend(Stateful):
    """Backends that each step their members of a batch of B, as one.

    The cloths stay lazy: those of a part are computed when the batch's are read.

    Args:
        scene: what all of them step.
        parts: each with its members, which together are 0 to B - 1.
    """

    def __init__(self, scene: Scene, parts: Sequence[tuple[Sequence[int], Backend]]) -> None:
        self.scene = scene
        self.parts = [(np.array(members), backend) for members, backend in parts]
        self.num_envs = sum(len(members) for members, _ in self.parts)
        self.self_contact = all(getattr(backend, "self_contact", False) for _, backend in self.parts)

    @property
    def memory(self) -> dict[str, np.ndarray]:
        """What the parts remember, ``(members, ...)``, by names that begin with their members, as ``0-3,7.``."""
        named = [(spans(members.tolist()), backend.memory) for members, backend in self.parts]
        return {f"{who}.{name}": value for who, own in named for name, value in own.items()}

    def recall(self, memory: Mapping[str, np.ndarray]) -> None:
        """Take back, after a ``reset`` of the whole batch, what ``memory`` held."""
        for members, backend in self.parts:
            start = f"{spans(members.tolist())}."
            own = {name[len(start) :]: value for name, value in memory.items() if name.startswith(start)}
            if own:
                backend.recall(own)
        self._join()

    def place(self, member: int) -> tuple[str, int]:
        """What the names in ``memory`` of the part that has ``member`` begin with, and which of its rows is its own."""
        members = next(members for members, _ in self.parts if member in members)
        return f"{spans(members.tolist())}.", int(np.searchsorted(members, member))

    @property
    def guarded(self) -> np.ndarray:
        """See ``Backend``, ``(B,)``."""
        return self._told("guarded", bool)

    @property
    def crossings(self) -> np.ndarray:
        """See ``Backend``, ``(B,)``."""
        return self._told("crossings", np.int32)

    @property
    def surrogate(self) -> np.ndarray:
        """See ``Backend``, ``(B,)``."""
        return self._told("surrogate", object, "")

    @property
    def measured_error(self) -> np.ndarray:
        """See ``Backend``, ``(B,)``."""
        return self._told("measured_error", float, np.nan)

    def check_material(self, material: Material) -> None:
        """Refuse what one of the parts can't step. Raises ValueError: see ``Backend``."""
        for _, backend in self.parts:
            check_material(backend, material)

    def reset(
        self, state: State, materials: Sequence[Material] | None = None, which: Sequence[int] | None = None
    ) -> None:
        """Start from ``state``; see ``Backend.reset``."""
        chosen = np.arange(self.num_envs) if which is None else np.asarray(which)
        if state.batch != len(chosen):
            raise ValueError(f"the state holds {state.batch} cloths, expected {len(chosen)}")
        if which is not None:
            self._tell_time()
        for members, backend in self.parts:
            at = np.flatnonzero(np.isin(chosen, members))  # in ``state``
            if not at.size:
                continue
            own = None if materials is None else [materials[i] for i in at.tolist()]
            inside = None if which is None else np.searchsorted(members, chosen[at]).tolist()
            backend.reset(state.select(at), own, inside)
        self._join()

    def advance(self, controls: Controls) -> State:
        """One frame of every part."""
        self._tell_time()
        for members, backend in self.parts:
            backend.advance(controls.select(members))
        return self._join()

    def _tell_time(self) -> None:
        """Tell the parts the time of the batch, which callers may have set."""
        for members, backend in self.parts:
            backend.state.time[:] = self.state.time[members]

    def _join(self) -> State:
        """Make the batch's state of those that the parts have now."""
        found = [(members, backend.state) for members, backend in self.parts]
        named = ("colliders", "collider_velocities", "wind", "pressure", "time")
        small = {name: self._whole([(members, getattr(state, name)) for members, state in found]) for name in named}
        health: Health = [(True, 0.0, 0.0)] * self.num_envs
        for members, state in found:
            for i, told in zip(members, state.health or find(self.scene.grid, state), strict=True):
                health[i] = told

        def cloth() -> Cloth:
            return Cloth(
                self._whole([(members, state.positions) for members, state in found]),
                self._whole([(members, state.velocities) for members, state in found]),
            )

        nothing = np.empty(0)
        self._state = LazyState(State(nothing, nothing, **small), cloth, health)
        return self._state

    def _whole(self, found: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """Arrays of some members each as one of all, ``(B, ...)``; of mixed float types in the wider one."""
        arrays = [array for _, array in found]
        whole = np.empty((self.num_envs, *arrays[0].shape[1:]), np.result_type(*arrays))
        for members, array in found:
            whole[members] = array
        return whole

    def _told(self, name: str, kind: type, nothing: Any = 0) -> np.ndarray:
        """What the parts tell of their members, ``(B,)``; ``nothing`` of those that tell nothing."""
        told: np.ndarray = np.full(self.num_envs, nothing, kind)
        for members, backend in self.parts:
            told[members] = getattr(backend, name, nothing)
        return told
