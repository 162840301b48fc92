"""Coarse physics and an upscaler, composed to a backend."""

from collections.abc import Mapping, Sequence

import numpy as np
from _minicloth_kernels import Bodies, inspect

from cloth_envs.material import Material
from cloth_envs.physics.solver import kernel_sheet
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, LazyState, State
from surrogates.miniature.coarse import CoarsePhysics
from surrogates.upscale.protocol import RememberingUpscaler, Upscaler

GUARD = 0.5  # strain
REACH = 1e-5  # m, within which a vertex is at the surface of a body
OWN = "upscaler."  # before the names of what an upscaler remembers


class Projection:
    """Puts vertices that are nearer to a body than the scene's thickness on its surface, along the body's normal.

    Vertices at the surface lose the velocity into the body. Bodies act one after the other; where there are several,
    twice. Handles stay where they are driven, inside or not.

    Attributes:
        pushed, depth: of the last cloth of every member, how many vertices were put outside and by how much the
            deepest [m]; ``(B,)``.
    """

    def __init__(self, scene: Scene) -> None:
        self._bodies = Bodies(kernel_sheet(scene)) if scene.colliders else None
        self.pushed, self.depth = np.zeros(0, np.int32), np.zeros(0, np.float32)

    def positions(self, fine: np.ndarray, state: State) -> None:
        """Change ``fine`` ``(B, 3, H, W)`` float32 in place by the bodies of ``state``."""
        if len(self.pushed) != len(fine):
            self.pushed, self.depth = np.zeros(len(fine), np.int32), np.zeros(len(fine), np.float32)
        if self._bodies:
            self._bodies.push_out(fine, state.colliders, state.collider_velocities, self.pushed, self.depth)

    def velocities(self, fine: np.ndarray, positions: np.ndarray, state: State) -> None:
        """Change velocities of the cloth at ``positions``, which are projected already."""
        if self._bodies:
            self._bodies.stop_at(fine, positions, state.colliders, state.collider_velocities, REACH)


class Upscaled:
    """A coarse cloth, upscaled when the fine one is read.

    Driven vertices of the fine cloth are put exactly where they are driven, others never end in a body (``contact``).

    Args:
        coarse: what moves.
        upscaling: what makes a fine cloth of it.
        guard: interpolate a cloth bicubically in frames in which the upscaler would strain an edge by over ``GUARD``.

    Attributes:
        guarded: the members of which that was so in the last frame that was read, ``(B,)``.
    """

    def __init__(self, coarse: CoarsePhysics, upscaling: Upscaler, *, guard: bool = False) -> None:
        self.scene, self.coarse, self.upscaling = coarse.fine, coarse, upscaling
        self.contact, self.guarded = Projection(self.scene), np.zeros(0, bool)
        self._guard, self._held = guard, np.array(self.scene.handles, np.int32)
        self._state: State | None = None
        self._remembering = upscaling if isinstance(upscaling, RememberingUpscaler) else None
        coarse.frames = upscaling.frames

    @property
    def state(self) -> State:
        """The present fine state."""
        if self._state is None:
            raise RuntimeError("there is no cloth yet: call reset(state) first")
        return self._state

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
            self._state, self.guarded = state.astype(np.float32), np.zeros(state.batch, bool)
        else:
            self._state = self.state.copy()
            self._state.assign(list(which), state)

    def advance(self, controls: Controls) -> State:
        """One frame; the fine cloth is computed when it is first read, at once for an upscaler that remembers."""
        coarse = self.coarse.advance(controls)
        history, handles = self.coarse.history, self.coarse.handles

        def positions(_: State) -> np.ndarray:
            fine = self.upscaling.positions(history)
            handles.place(fine, controls.handle_positions, self._held)
            if self._guard:
                self._fall_back(fine, coarse, controls)
            self.contact.positions(fine, coarse)
            return fine

        def velocities(state: State) -> np.ndarray:
            fine = self.upscaling.velocities(history)
            handles.place(fine, controls.handle_velocities, self._held)
            if self.scene.colliders:  # or positions would be computed for nothing
                self.contact.velocities(fine, state.positions, coarse)
            return fine

        self._state = LazyState(coarse, positions, velocities)
        if self._remembering:
            self._state.arrays()
        return self._state

    def _fall_back(self, fine: np.ndarray, coarse: State, controls: Controls) -> None:
        """Change strained members of ``fine`` into what interpolation makes of them."""
        grid = self.scene.grid
        found = inspect(fine, fine, grid.row_spacing, grid.col_spacing, grid.periodic)
        self.guarded = np.array([not strain <= GUARD for _, strain, _ in found])
        if self.guarded.any():
            plain = self.upscaling.bicubic(coarse.positions)
            self.coarse.handles.place(plain, controls.handle_positions, self._held)
            fine[self.guarded] = plain[self.guarded]
