"""States on a device whose fine cloth is computed when it is read, all of it or at some vertices."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from cloth_envs.state import Cloth, LazyState, State
from surrogates.miniature.places import Moment, Places

SMALL = ("colliders", "collider_velocities", "wind", "pressure", "time")


class Given(NamedTuple):
    """Fine cloths that are as a reset gave them, of ``members``; ``(n, 3, H, W)`` each."""

    members: list[int]
    positions: Tensor
    velocities: Tensor

    def and_before(self, old: "Given | None") -> "Given":
        """These, and those of ``old`` that are not among them."""
        anew = set(self.members)
        keep = [k for k, member in enumerate(old.members) if member not in anew] if old else []
        if old is None or not keep:
            return self
        x, v = torch.cat([self.positions, old.positions[keep]]), torch.cat([self.velocities, old.velocities[keep]])
        return Given(self.members + [old.members[k] for k in keep], x, v)

    def of(self, which: list[int]) -> "Given | None":
        """Those of some members, by their numbers among these; None if there are none."""
        number = {member: k for k, member in enumerate(self.members)}
        found = [k for k, member in enumerate(which) if member in number]
        keep = [number[which[k]] for k in found]
        return Given(found, self.positions[keep], self.velocities[keep]) if found else None


class FineState(LazyState):
    """A state in tensors.

    Args:
        known: the coarse state; all but its cloth is that of the fine one. health: of the coarse cloth, ``(B, 3)``.
        places: computes the vertices whose numbers (int64) these bytes are, or all for None.
        now: of what; None before the first frame. given: cloths that are not computed.
    """

    def __init__(
        self,
        known: State,
        health: Any,
        places: Callable[[bytes | None], Places],
        now: Moment | None,
        given: Given | None,
    ) -> None:
        super().__init__(known, self._whole, health)
        self._places, self.now, self.given = places, now, given

    def at(self, vertices: np.ndarray) -> Cloth:
        """Positions [m] and velocities [m/s] of some ``vertices`` ``(K,)``, numbers in NumPy: ``(B, 3, K)`` each."""
        return self._some(self._at(vertices))

    def put(self, vertices: np.ndarray, cloth: Cloth | State) -> None:
        """Write what ``at`` gives where it is in a whole ``cloth``, of contiguous float32 tensors."""
        places = self._at(vertices)
        there: Any = cloth.positions, cloth.velocities
        if self.now is not None:
            places.put(self.now, *there)
        if self.given is not None:
            index = torch.tensor(self.given.members, device=places.vertices.device)[:, None]
            for field, given in zip(there, self.given[1:], strict=True):
                field.flatten(2).transpose(1, 2)[index, places.vertices] = given.flatten(2)[..., places.vertices].mT

    def _at(self, vertices: np.ndarray) -> Places:
        return self._places(np.ascontiguousarray(vertices, np.int64).tobytes())

    def select(self, which: Any) -> "FineState":
        """A copy of some members, a tensor of their numbers: only their cloth will be computed."""
        there: dict[str, Any] = {name: getattr(self, name)[which] for name in SMALL}
        nothing: Any = None
        known, health = State(nothing, nothing, **there), None if self.health is None else self.health[which]
        given = None if self.given is None else self.given.of(which.tolist())
        moved = self.now is not None and (given is None or len(given.members) < len(which))
        now = self.now.select(which) if self.now is not None and moved else None
        return FineState(known, health, self._places, now, given)

    def _whole(self) -> Cloth:
        every = self._places(None)
        there: Any = self._some(every)
        return Cloth(*(field.unflatten(2, every.scene.grid.shape) for field in there))

    def _some(self, places: Places) -> Cloth:
        if self.now is not None:
            x, v = places(self.now)
        else:
            x, v = torch.empty(2, self.batch, 3, len(places.vertices), device=places.vertices.device)
        if self.given is not None:
            index = torch.tensor(self.given.members, device=x.device)
            x, v = (
                field.index_copy(0, index, given.flatten(2)[:, :, places.vertices])
                for field, given in zip((x, v), self.given[1:], strict=True)
            )
        there: Any = x, v
        return Cloth(*there)
