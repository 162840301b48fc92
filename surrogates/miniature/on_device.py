"""The miniature of thousands of members on a device: the coarse cloth by ``CardSolver``, the fine one by ``Places``."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from cloth_envs.material import Material
from cloth_envs.physics.explicit.bounds import HELD
from cloth_envs.physics.gpu.solver import CardSolver
from cloth_envs.resample import weights
from cloth_envs.state import Controls, State
from cloth_envs.tensors import health_of, to_device
from surrogates.miniature.backend import MiniatureBackend
from surrogates.miniature.fine_state import FineState, Given
from surrogates.miniature.places import Moment, Places
from surrogates.upscale.local import Local

PLANS = 16  # sets of vertices whose matrices are kept


class MiniatureOnDevice:
    """``plain``, for ``num_envs`` members, with states and controls of tensors on a device.

    Edges are not mended there, the network is not guarded, and neither cloth keeps out of itself.

    Args:
        plain: what it is made of. num_envs: members of the batch.
        device: a card; ``"cpu"`` emulates it, slowly, to test it.
        without: what was asked for and is not there, as text.

    Raises:
        ValueError: a sheet that is too large for a card.
        ImportError: CuPy is missing; names the extra.
    """

    self_contact: ClassVar[bool] = False

    def __init__(
        self, plain: MiniatureBackend, *, num_envs: int, device: str | torch.device, without: str = ""
    ) -> None:
        self._plain, self.upscaling, self._handles = plain, plain.upscaling, plain.coarse.handles
        self.scene, coarse = (replace(scene, self_contact=None) for scene in (plain.scene, plain.coarse.scene))
        held = HELD if coarse.grid != self.scene.grid else None
        self.solver = CardSolver(coarse, num_envs=num_envs, device=device, held=held)
        self.num_envs, self.device, self._without = self.solver.num_envs, self.solver.device, without
        self._restricted = [self._put(matrix.astype(np.float32)) for matrix in weights(self.scene.grid, coarse.grid)]
        self._driven = self._put(np.array(self.scene.handles, np.int64))
        self._driving = self._put(np.array(coarse.handles, np.int64))
        self._follows = self._put(self._handles.follows.astype(np.int64))
        self._materials: list[Material | None] = [None] * self.num_envs
        self._coarse = [coarse.material] * self.num_envs
        outputs = sum(map(len, self.upscaling.weights)) if isinstance(self.upscaling, Local) else 0
        self._bias = torch.zeros(self.num_envs, outputs, device=self.device)
        self._told = np.full(self.num_envs, self._tell(self.scene.material), object)
        self._state: FineState | None = None
        self._places = lru_cache(PLANS)(self._make_places)

    def _put(self, array: Any) -> Tensor:
        there: Tensor = to_device(array, self.device)
        return there

    def _make_places(self, vertices: bytes | None) -> Places:
        numbers = np.arange(self.scene.grid.vertices) if vertices is None else np.frombuffer(vertices, np.int64)
        return Places(self.scene, self._handles, self.upscaling, numbers, self.device)

    @property
    def state(self) -> FineState:
        """The present fine state."""
        if self._state is None:
            raise RuntimeError("there is no cloth yet: call reset(state) first")
        return self._state

    @property
    def surrogate(self) -> np.ndarray:
        """Why each member is plainer than usual or beyond its card, ``(B,)`` text; empty where neither is so."""
        return self._told.copy()

    def _tell(self, material: Material) -> str:
        told = self._plain.plain(material)
        if not self._without:
            return told
        return f"{told}; {self._without}" if told else f"{self._plain.made_of}: {self._without}"

    @property
    def memory(self) -> dict[str, Any]:
        """The coarse cloth and how handles are followed, as ``CoarsePhysics`` has them."""
        coarse = self.solver.state
        there: dict[str, Any] = {"positions": coarse.positions, "velocities": coarse.velocities}
        return {name: value[:, None] for name, value in there.items()} | {"offsets": self._offsets}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Take back, after a ``reset`` of the whole batch, what ``memory`` held."""
        cloth: dict[str, Any] = {name: self._put(memory[name])[:, 0] for name in ("positions", "velocities")}
        self.solver.reset(replace(self.solver.state, **cloth), self._coarse)
        self._offsets = self._put(memory["offsets"]).clone()
        self._show(health_of(self.solver.state, self.solver.scene.grid), self.state.now, self.state.given)

    def check_material(self, material: Material) -> None:
        """Refuse a fine material whose coarse one can't be stepped. Raises ValueError: says what to change."""
        self._plain.check_material(material)

    def reset(
        self, state: State, materials: Sequence[Material] | None = None, which: Sequence[int] | None = None
    ) -> None:
        """Start from ``state``, of tensors or NumPy arrays; see ``Backend.reset``."""
        members = list(range(self.num_envs)) if which is None else list(which)
        chosen = [self.scene.material] * len(members) if materials is None else list(materials)
        there: dict[str, Any] = {name: self._put(value) for name, value in state.arrays().items()}
        x, v = (there[name].to(torch.float32, copy=True) for name in ("positions", "velocities"))
        rows, cols = self._restricted
        there |= {"positions": rows @ x @ cols.T, "velocities": rows @ v @ cols.T}
        self._set_materials(members, chosen)
        self.solver.reset(State(**there), [self._coarse[i] for i in members], which)
        here = there["positions"].flatten(2)[:, :, self._driving]
        offsets = (here - x.flatten(2)[:, :, self._driven][:, :, self._follows]).transpose(1, 2).double()
        given, health = Given(members, x, v), health_of(State(**there), self.solver.scene.grid)
        if which is None:
            self._offsets, now = offsets.contiguous(), None
        else:
            old, index = self.state, self._put(np.array(members))
            judged: Any = old.health
            self._offsets = self._offsets.index_copy(0, index, offsets)
            now, given, health = old.now, given.and_before(old.given), judged.index_copy(0, index, health)
        self._show(health, now, given)

    def _set_materials(self, members: list[int], chosen: list[Material]) -> None:
        if [self._materials[i] for i in members] == chosen:
            return
        found = {m: (k, self._tell(m), self._plain.coarse.material(m)) for k, m in enumerate(dict.fromkeys(chosen))}
        for i, material in zip(members, chosen, strict=True):
            self._materials[i], (_, self._told[i], self._coarse[i]) = material, found[material]
        if isinstance(self.upscaling, Local):
            each = self.upscaling.biases(list(found))[[found[m][0] for m in chosen]]
            self._bias = self._bias.index_copy(0, self._put(np.array(members)), self._put(each))

    def advance(self, controls: Controls) -> FineState:
        """One frame; the fine cloth is computed when it is read."""
        positions, velocities = self._put(controls.handle_positions), self._put(controls.handle_velocities)
        followed: Any = positions[:, self._follows] + self._offsets, velocities[:, self._follows]
        now = self.solver.advance(replace(controls, handle_positions=followed[0], handle_velocities=followed[1]))
        self._show(now.health, Moment.of(now, (positions, velocities), self._bias), None)
        return self.state

    def _show(self, health: Any, now: Moment | None, given: Given | None) -> None:
        self._state = FineState(self.solver.state, health, self._places, now, given)
