"""Coarse physics and an upscaler, composed to a backend."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from cloth_envs.backend import Stateful
from cloth_envs.failure import find
from cloth_envs.material import Material
from cloth_envs.state import Controls, LazyState, State
from surrogates.miniature.coarse import CoarsePhysics
from surrogates.miniature.fine import Fine
from surrogates.miniature.mending import Mending
from surrogates.upscale.protocol import RememberingUpscaler, Upscaler

OWN = "upscaler."  # before the names of what an upscaler remembers


class Upscaled(Stateful):
    """A coarse cloth, upscaled when the fine one is read.

    Driven vertices of the fine cloth are put exactly where they are driven, others never end in a body. Where the
    coarse cloth keeps out of itself, folds of the fine one are drawn out of each other. Whether it has failed is judged
    by the coarse cloth, which moves; the fine one is drawn on it.

    Args:
        coarse: what moves.
        upscaling: what makes a fine cloth of it.
        mend: bring the fine cloth's edges to their lengths (``mending``).
        guard: interpolate a cloth bicubically in frames in which a network would strain an edge by over its
            ``torn``.
        threads: that upscale, over members of the batch.

    Attributes:
        fine: what puts the fine cloth together, and what it found in the last frame that was read.
    """

    def __init__(
        self, coarse: CoarsePhysics, upscaling: Upscaler, *, mend: bool = False, guard: bool = False, threads: int = 1
    ) -> None:
        own = coarse.fine.self_contact if getattr(coarse.solver, "self_contact", False) else None
        self.scene, self.coarse, self.upscaling = replace(coarse.fine, self_contact=own), coarse, upscaling
        mending = Mending.of(upscaling, coarse.handles.vertices) if mend else None
        self.fine = Fine(self.scene, coarse.handles, upscaling, mending=mending, guard=guard, threads=threads)
        self._remembering = upscaling if isinstance(upscaling, RememberingUpscaler) else None
        coarse.frames, upscaling.threads = upscaling.frames, threads

    @property
    def self_contact(self) -> bool:
        """Whether the cloth keeps out of itself."""
        return self.scene.self_contact is not None

    @property
    def guarded(self) -> np.ndarray:
        """The members that the guard interpolated in the last frame that was read, ``(B,)``."""
        return self.fine.guarded

    @property
    def crossings(self) -> np.ndarray:
        """How many pairs of the coarse cloth's triangles crossed as the last frame began, ``(B,)``."""
        return np.asarray(getattr(self.coarse.solver, "crossings", np.zeros(self.state.batch, np.int32)))

    @property
    def memory(self) -> dict[str, np.ndarray]:
        """The coarse cloth, with its past frames, and what the upscaler remembers."""
        own = self._remembering.memory if self._remembering else {}
        return self.coarse.memory | {OWN + name: value for name, value in own.items()}

    def recall(self, memory: Mapping[str, np.ndarray]) -> None:
        """Take back, after a ``reset`` of the whole batch, what ``memory`` held."""
        self.coarse.recall(memory)
        if self._remembering:
            self._remembering.recall({n[len(OWN) :]: value for n, value in memory.items() if n.startswith(OWN)})

    def check_material(self, material: Material) -> None:
        """Refuse a fine material whose coarse one can't be stepped. Raises ValueError: says what to change."""
        self.coarse.check_material(material)

    def reset(
        self, state: State, materials: Sequence[Material] | None = None, which: Sequence[int] | None = None
    ) -> None:
        """Start from ``state``; see ``Backend.reset``."""
        chosen = [self.scene.material] * state.batch if materials is None else materials
        members = range(state.batch) if which is None else which
        self.coarse.reset(state, chosen, which)
        self.upscaling.set_materials(members, chosen)
        if self._remembering:
            self._remembering.reset(members, self.coarse.history)
        if which is None:
            self.fine.begin(state.batch)
        self._begin(state.astype(np.float32), which)
        self.state.health = find(self.coarse.scene.grid, self.coarse.state)  # type: ignore[misc]

    def advance(self, controls: Controls) -> State:
        """One frame; the fine cloth is computed when it is first read, at once for an upscaler that remembers."""
        now = self.coarse.advance(controls)
        history = self.coarse.history
        self._state = LazyState(now, lambda: self.fine(history, controls), health=find(self.coarse.scene.grid, now))
        if self._remembering:
            self._state.arrays()
        return self._state
