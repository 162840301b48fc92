"""The one state that every backend steps, every renderer draws and every recorder writes."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import ClassVar, NamedTuple

import numpy as np

Health = list[tuple[bool, float, float]]  # of each cloth: all finite, largest structural strain, kinetic energy [J/kg]


@dataclass
class State:
    """A batch of B cloths on a grid of H rows x W columns, z up.

    Attributes:
        positions: ``(B, 3, H, W)`` [m].
        velocities: ``(B, 3, H, W)`` [m/s].
        colliders: ``(B, C, 2, 3)`` [m]; see ``scene.Collider`` for the meaning of the two points.
        collider_velocities: ``(B, C, 2, 3)`` [m/s].
        wind: ``(B, 3)`` [m/s], the wind of the last frame.
        pressure: ``(B,)`` [Pa], the pressure of the last frame.
        time: ``(B,)`` [s].
        health: what failures are judged by, where the backend integrates another cloth than this one.
    """

    health: ClassVar[Health | None] = None
    positions: np.ndarray
    velocities: np.ndarray
    colliders: np.ndarray
    collider_velocities: np.ndarray
    wind: np.ndarray
    pressure: np.ndarray
    time: np.ndarray

    @classmethod
    def still(cls, positions: np.ndarray, colliders: np.ndarray | None = None) -> "State":
        """A batch at rest at ``positions`` ``(B, 3, H, W)``, in their dtype."""
        batch = len(positions)
        dtype = positions.dtype
        bodies = np.zeros((batch, 0, 2, 3), dtype) if colliders is None else np.asarray(colliders, dtype)
        return cls(
            positions=np.ascontiguousarray(positions),
            velocities=np.zeros_like(positions, order="C"),
            colliders=np.ascontiguousarray(bodies),
            collider_velocities=np.zeros_like(bodies, order="C"),
            wind=np.zeros((batch, 3)),
            pressure=np.zeros(batch),
            time=np.zeros(batch),
        )

    @property
    def batch(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        rows, cols = self.positions.shape[2:]
        return f"<State of {self.batch} x {rows}x{cols} {self.positions.dtype}, time {_span(self.time)} s>"

    def copy(self) -> "State":
        return State(**{name: value.copy() for name, value in self.arrays().items()})

    def arrays(self) -> dict[str, np.ndarray]:
        """The fields by name; no copies."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def astype(self, dtype: np.dtype | type) -> "State":
        """A copy in C order, the cloth and the bodies in another float type; wind, pressure, time stay float64."""
        keep = ("wind", "pressure", "time")
        return State(**{n: np.array(a, a.dtype if n in keep else dtype, order="C") for n, a in self.arrays().items()})

    def select(self, which: np.ndarray | slice | list[int]) -> "State":
        """A copy of some members of the batch."""
        return State(**{name: value[which].copy() for name, value in self.arrays().items()})

    def read_only(self) -> "State":
        """Views of the same arrays that can't be written."""
        return State(**{name: _locked(value) for name, value in self.arrays().items()})

    def assign(self, which: np.ndarray | slice | list[int], other: "State") -> None:
        """Overwrite some members of the batch by those of ``other``."""
        for name, value in self.arrays().items():
            value[which] = getattr(other, name)


def _locked(array: np.ndarray) -> np.ndarray:
    view = array.view()
    view.flags.writeable = False
    return view


def _span(values: np.ndarray) -> str:
    """What they all are, or the range they lie in."""
    if not len(values):
        return "none"
    low, high = values.min(), values.max()
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


class Cloth(NamedTuple):
    """``positions`` and ``velocities`` ``(B, 3, H, W)``."""

    positions: np.ndarray
    velocities: np.ndarray


class LazyState(State):
    """A state whose cloth is computed when it is first read, and then kept; everything else is that of ``known``.

    Args:
        known: its bodies, wind, pressure and time.
        compute: gives the cloth. It is called whenever somebody reads, so it must not depend on anything that changes
            meanwhile.
        health: of what it is computed from.
    """

    def __init__(self, known: State, compute: Callable[[], Cloth], health: Health | None = None) -> None:
        self._compute, self.health = compute, health  # type: ignore[misc]
        self._cloth: Cloth | None = None
        self.colliders, self.collider_velocities = known.colliders, known.collider_velocities
        self.wind, self.pressure, self.time = known.wind, known.pressure, known.time

    def __repr__(self) -> str:  # computes nothing
        read = "not read so far" if self._cloth is None else "read"
        return f"<LazyState of {self.batch}, {read}, time {_span(self.time)} s>"

    def _read(self) -> Cloth:
        self._cloth = self._compute()
        return self._cloth

    @property
    def positions(self) -> np.ndarray:  # type: ignore[override]
        """``(B, 3, H, W)`` [m]."""
        return (self._cloth or self._read()).positions

    @property
    def velocities(self) -> np.ndarray:  # type: ignore[override]
        """``(B, 3, H, W)`` [m/s]."""
        return (self._cloth or self._read()).velocities

    def read_only(self) -> State:
        known = {n: _locked(getattr(self, n)) for n in ("colliders", "collider_velocities", "wind", "pressure", "time")}
        nothing = np.empty(0)
        return LazyState(
            State(nothing, nothing, **known),
            lambda: Cloth(_locked(self.positions), _locked(self.velocities)),
            self.health,
        )


@dataclass
class Controls:
    """What an action becomes: where driven things are at the end of the frame.

    Handles and bodies move on a cubic from their present position and velocity to these, soft handles are drawn to
    such cubics (``Scene.holding``); wind and pressure are constant over the frame.

    Attributes:
        handle_positions, handle_velocities: ``(B, N, 3)`` [m], [m/s], in the order of ``Scene.handles``.
        colliders, collider_velocities: ``(B, C, 2, 3)``.
        wind: ``(B, 3)`` [m/s]. pressure: ``(B,)`` [Pa].
    """

    handle_positions: np.ndarray
    handle_velocities: np.ndarray
    colliders: np.ndarray
    collider_velocities: np.ndarray
    wind: np.ndarray
    pressure: np.ndarray

    def __repr__(self) -> str:
        batch, handles = self.handle_positions.shape[:2]
        return f"<Controls of {batch}, {handles} handles, {self.colliders.shape[1]} bodies>"

    def select(self, which: np.ndarray | slice | list[int]) -> "Controls":
        """A copy of some members of the batch."""
        return Controls(**{field.name: getattr(self, field.name)[which].copy() for field in fields(self)})

    @classmethod
    def hold(cls, state: State, handles: tuple[int, ...]) -> "Controls":
        """Controls that bring every handle and body to rest where it is now, with no wind or pressure."""
        flat = state.positions.reshape(state.batch, 3, -1)
        at = flat[:, :, list(handles)].transpose(0, 2, 1).astype(np.float64)
        return cls(
            handle_positions=at,
            handle_velocities=np.zeros_like(at),
            colliders=state.colliders.astype(np.float64),
            collider_velocities=np.zeros(state.colliders.shape),
            wind=np.zeros((state.batch, 3)),
            pressure=np.zeros(state.batch),
        )
