"""Torch's tensors and NumPy's arrays: states and controls of one as those of the other, and backends on a device.

Only what has a backend on a device imports this, so torch stays unloaded everywhere else.
"""

from collections.abc import Sequence
from copy import copy
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.state import Cloth, Controls, Health, LazyState, State

Thing = TypeVar("Thing")


def to_device(array: Any, device: torch.device) -> Any:
    """A copy of an array there; int32 becomes int64, which indexes without a conversion. Tensors stay as they are."""
    if isinstance(array, Tensor):
        return array
    tensor = torch.tensor(array, device=device)
    return tensor.long() if array.dtype == np.int32 else tensor


def to_host(value: Any) -> Any:
    """A tensor as a NumPy array, a dict of tensors as one of arrays; all else as it is."""
    if isinstance(value, dict):
        return {name: to_host(part) for name, part in value.items()}
    return value.cpu().numpy() if isinstance(value, Tensor) else value


def moved(thing: Thing, device: torch.device) -> Thing:
    """A copy of an object whose arrays are tensors there."""
    own = copy(thing)
    for name, value in vars(thing).items():
        if isinstance(value, np.ndarray):
            setattr(own, name, to_device(value, device))
    return own


def starting(positions: Any, velocities: Any, colliders: Any) -> State:
    """A state of float32 tensors whose bodies are at rest, without wind and pressure."""
    x, v, bodies = (part.to(torch.float32).contiguous() for part in (positions, velocities, colliders))
    wind, pressure, time = (x.new_zeros(len(x), *shape, dtype=torch.float64) for shape in ((3,), (), ()))
    there: Any = x, v, bodies, torch.zeros_like(bodies), wind, pressure, time
    return State(*there)


def selected(state: State, which: Tensor | slice) -> State:
    """Some members of a batch of tensors, with their health; a view where they are a slice.

    Of a cloth that is computed when it is read, only theirs.
    """
    lazy: Any = state
    if hasattr(state, "at") and isinstance(which, Tensor):
        few: State = lazy.select(which)
        return few
    there: dict[str, Any] = state.arrays()
    found = State(**{name: value[which] for name, value in there.items()})
    if state.health is not None:
        health: Any = state.health
        found.health = health[which]  # type: ignore[misc]
    return found


def health_of(state: State, grid: Grid) -> Any:
    """``state.health`` of tensors, ``(B, 3)`` float32; computed where there is none, as ``failure.find`` does."""
    if state.health is not None:
        return state.health
    x: Any = state.positions
    v: Any = state.velocities
    down, along = x[:, :, 1:] - x[:, :, :-1], x.roll(-1, 3) - x
    if not grid.periodic:
        along = along[..., :-1]
    squares = [
        (edges.square().sum(1) / length**2).flatten(1).amax(1)
        for edges, length in ((down, grid.row_spacing), (along, grid.col_spacing))
    ]
    finite = x.isfinite().flatten(1).all(1) & v.isfinite().flatten(1).all(1)
    energy = 0.5 * v.square().flatten(1).sum(1) / (grid.rows * grid.cols)
    return torch.stack([finite, torch.maximum(*squares).sqrt() - 1, energy], 1)


class OnHost:
    """A backend on a device, which takes and gives NumPy arrays; cloths are copied when they are read.

    Attributes:
        backend: the one on the device.
    """

    def __init__(self, backend: Any) -> None:
        self.backend, self.scene = backend, backend.scene
        self._state: State | None = None

    def __getattr__(self, name: str) -> Any:
        """What else the backend tells."""
        if name.startswith("_") or name == "backend":
            raise AttributeError(name)
        return getattr(self.backend, name)

    @property
    def state(self) -> State:
        """The present state, in NumPy arrays."""
        if self._state is None:
            self._state = on_host(self.backend.state)
        return self._state

    @property
    def memory(self) -> dict[str, np.ndarray]:
        """See ``Backend``."""
        return to_host(self.backend.memory)

    def recall(self, memory: dict[str, np.ndarray]) -> None:
        """See ``Backend``."""
        self.backend.recall(memory)
        self._state = None

    def reset(
        self, state: State, materials: Sequence[Material] | None = None, which: Sequence[int] | None = None
    ) -> None:
        """See ``Backend``."""
        self._tell_time()
        self.backend.reset(state, materials, which)
        self._state = None

    def advance(self, controls: Controls) -> State:
        """See ``Backend``."""
        self._tell_time()
        there = {name: to_device(value, self.backend.device) for name, value in vars(controls).items()}
        self.backend.advance(Controls(**there))
        self._state = None
        return self.state

    def _tell_time(self) -> None:
        """Tell the backend the time, which callers may have set."""
        if self._state is not None:
            time: Any = self.backend.state.time
            time.copy_(torch.from_numpy(self._state.time))


def on_host(state: State) -> LazyState:
    """A state of tensors in NumPy arrays; the cloth is copied when it is read."""
    health: Health | None = None
    if state.health is not None:
        there: Any = state.health
        health = [(bool(finite), strain, energy) for finite, strain, energy in there.tolist()]
    small = ("colliders", "collider_velocities", "wind", "pressure", "time")
    nothing = np.empty(0)
    known = State(nothing, nothing, **{name: to_host(getattr(state, name)) for name in small})
    return LazyState(known, lambda: Cloth(to_host(state.positions), to_host(state.velocities)), health)
