"""The explicit solver for thousands of sheets on a graphics card; arrays are tensors there."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from cloth_envs.arguments import whole_number
from cloth_envs.backend import Stateful
from cloth_envs.material import Material
from cloth_envs.physics.explicit.cuts import FrameCuts
from cloth_envs.physics.gpu.card import Card, Emulated, Runner
from cloth_envs.physics.gpu.terms import bodies_of, cloths_of, sheet_of
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State

SINGLE = ("positions", "velocities", "colliders", "collider_velocities")  # float32; the others float64


class CardSolver(Stateful):
    """A batch of sheets of one scene on a card, by the steps of ``ExplicitSolver`` in float32, without self-contact.

    ``State`` and ``Controls`` hold tensors on ``device``. Frames of cloth that is faster or under more pressure than
    usual are cut into as many substeps as that can ask for, of which none holds slow forces.

    Args:
        scene: a sheet. num_envs: members of the batch.
        held: for how many substeps slow forces are held, at most; see ``ExplicitSolver``.
        device: a card, ``"cuda"`` or ``"cuda:1"``; ``"cpu"`` emulates it thread by thread, slowly, to test it.
        emulated: options of ``Emulated``.

    Attributes:
        last_cuts: how the last frame of each cloth was cut, ``(B, 2)`` of int32: substeps, and for how many of them
            slow forces were held.

    Raises:
        ValueError: a net of particles, bodies that spin, or a sheet that is too large for a card.
        ImportError: CuPy is missing; names the extra.
    """

    self_contact: ClassVar[bool] = False

    def __init__(
        self,
        scene: Scene,
        *,
        num_envs: int = 1,
        held: int | None = None,
        device: str | torch.device = "cuda",
        **emulated: Any,
    ) -> None:
        if scene.particles is not None:
            raise ValueError("a net of particles is not stepped on a card: leave device out")
        if any(body.turns_with is not None for body in scene.colliders):
            raise ValueError("bodies that spin are not stepped on a card: leave device out")
        self.scene = self._stepped = scene
        self.num_envs = whole_number("num_envs", num_envs)
        self.device = torch.device(device)
        if self.device.type == "cuda" and self.device.index is None:
            self.device = torch.device("cuda", torch.cuda.current_device())
        self._emulated, self._cutter = emulated, FrameCuts(scene, held=held)
        number = np.full(scene.grid.vertices, -1, np.int32)
        number[list(scene.handles)] = np.arange(len(scene.handles))
        self._constants = [
            self._put(number),
            self._put(np.array(scene.handles, np.int32)),
            self._put(scene.holding.lead.astype(np.int32)),
            self._put(scene.holding.hold.astype(np.float64)),
        ]
        self._bodies = self._put(bodies_of(scene).view(np.uint8))
        self.runner: Runner | None = None
        self._cloths = cloths_of(scene, self._cutter, [self.felt_as(scene.material)] * self.num_envs)
        self._told = self._put(self._cloths.view(np.uint8))
        self.last_cuts = torch.zeros((self.num_envs, 2), dtype=torch.int32, device=self.device)

    def _put(self, array: np.ndarray) -> Tensor:
        return torch.as_tensor(array).to(self.device)

    def check_material(self, material: Material) -> None:
        """Refuse what would need too many substeps. Raises ValueError: says what to change."""
        self._cutter.count(self.felt_as(material))

    def felt_as(self, material: Material) -> Material:
        """What a cloth of ``material`` is stepped as."""
        return material

    def reset(
        self,
        state: State,
        materials: Sequence[Material] | None = None,
        which: Sequence[int] | None = None,
    ) -> None:
        members = list(range(self.num_envs)) if which is None else list(which)
        if len(state.time) != len(members):
            raise ValueError(f"the state holds {len(state.time)} cloths, expected {len(members)}")
        chosen = [self.scene.material] * len(members) if materials is None else list(materials)
        cloths = cloths_of(self._stepped, self._cutter, list(map(self.felt_as, chosen)))
        if not np.array_equal(self._cloths[members], cloths) or self.runner is None:
            self._cloths[members] = cloths
            self._told, self.runner = self._put(self._cloths.view(np.uint8)), self._choose()
        given: dict[str, Any] = self._tensors(state)
        if which is None:
            self._state = State(**given)
            return
        index = torch.as_tensor(members, device=self.device)
        old = {f.name: getattr(self.state, f.name) for f in fields(State)}
        self._state = State(**{name: value.index_copy(0, index, given[name]) for name, value in old.items()})

    def _choose(self) -> Runner:
        """What steps today's materials."""
        sheet = sheet_of(self._stepped, bends=bool(self._cloths["bend"].any()))
        if self.device.type != "cuda":
            return Emulated(sheet, **self._emulated)
        simple = set(self._cloths["simple"].tolist())
        return Card(sheet, self.device, simple=bool(simple.pop()) if len(simple) == 1 else None)

    def _tensors(self, what: State | Controls) -> dict[str, Tensor]:
        """Its arrays on the device, of the types that a card reads; copies, but of tensors that are there."""
        single = SINGLE if isinstance(what, State) else ()
        return {
            f.name: torch.as_tensor(getattr(what, f.name))
            .to(self.device, torch.float32 if f.name in single else torch.float64)
            .contiguous()
            for f in fields(what)
        }

    def advance(self, controls: Controls) -> State:
        old: Any = self.state
        given: dict[str, Any] = self._tensors(controls)
        x, v = torch.empty_like(old.positions), torch.empty_like(old.velocities)
        health = torch.empty((self.num_envs, 3), dtype=torch.float32, device=self.device)
        self.last_cuts = torch.empty_like(self.last_cuts)
        batch: tuple[Tensor, ...] = (
            *(self._told, self._bodies, old.positions, old.velocities, x, v, old.colliders, old.collider_velocities),
            *(given[n] for n in ("colliders", "collider_velocities", "handle_positions", "handle_velocities")),
            *(given["wind"], given["pressure"], *self._constants, health, self.last_cuts),
        )
        assert self.runner is not None
        self.runner.run([tensor.data_ptr() for tensor in batch], self.num_envs)
        bodies = (given["colliders"].float(), given["collider_velocities"].float())
        there: Any = x, v, *bodies, given["wind"], given["pressure"], old.time + self.scene.frame_dt
        new: Any = State(*there)
        new.health = health
        self._state = new
        return self.state
