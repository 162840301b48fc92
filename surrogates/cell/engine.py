"""The engine ``"torch"`` of the fitted cell: on GPUs, and with forces plugged in."""

import os
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from cloth_envs.extras import install
from cloth_envs.material import Material
from cloth_envs.physics.laws.drives import hermite
from cloth_envs.physics.particles.solver import Cell, ParticleSolver, net_of
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.cell.compiled import SHARED, SHEET, CellSheet
from surrogates.cell.frame import frame
from surrogates.cell.sheet import Force, SheetCell, properties
from surrogates.cell.stencil import StencilCell

if hasattr(os, "register_at_fork"):  # a forked process lacks the threads of torch's OpenMP and would wait for them
    os.register_at_fork(after_in_child=partial(torch.set_num_threads, 1))


def usable(device: str) -> str:
    """``device`` as it is. Raises ValueError: torch has no such device, or this machine has not."""
    try:
        torch.empty(0, device=device)
    except (AssertionError, RuntimeError, TypeError) as error:
        reason = str(error).splitlines()[0]
        raise ValueError(f"device={device!r} can't be used ({reason}): write device='cpu', or leave it out") from error
    return device


def usable_card(device: str) -> str:
    """``device`` as it is. Raises ValueError: it is no card that can be used; names the extra that a card needs."""
    try:
        return usable(device)
    except ValueError as error:
        raise ValueError(
            f"{str(error).split(': write')[0]}: a card needs {install('gpu')}; or leave device out"
        ) from error


def pressure_force(positions: Tensor, pressure: Tensor) -> Tensor:
    """Eq. 3, ``p sum r_a x r_b`` over four pairs of nearest neighbours, for ``pressure`` ``(B,)`` [Pa].

    It is ``p (right - left) x (up - down)``, where a missing neighbour counts as lying on the particle.
    """
    spread = functional.pad(positions, (1, 1, 1, 1), mode="replicate")
    across = spread[..., 1:-1, 2:] - spread[..., 1:-1, :-2]
    up = spread[..., :-2, 1:-1] - spread[..., 2:, 1:-1]
    return pressure[:, None, None, None] * torch.linalg.cross(across, up, dim=1)


def hit_ball(x: Tensor, v: Tensor, centre: Tensor, moving: Tensor, radius: float, keep: float) -> Tensor:
    """Velocities after a step inside a ball: no inward part, then ``keep`` of the rest, relative to the ball's.

    ``centre`` and ``moving``, its velocity, are ``(B, 3, 1, 1)``.
    """
    d, u = x - centre, v - moving
    away = d.norm(dim=1, keepdim=True)
    n = d / away.clamp_min(torch.finfo(d.dtype).tiny)
    left = keep * (u - (u * n).sum(1, keepdim=True).clamp_max(0) * n)
    return torch.where(away < radius, left + moving, v)


class TorchNet(ParticleSolver):
    """``CellNet`` in torch: the step of fig. 2 of Zhao 2024, on GPUs, and with forces plugged in."""

    def __init__(
        self, scene: Scene, cell: Cell, *, device: str = "cpu", forces: Sequence[Force] = (), **options: Any
    ) -> None:
        super().__init__(scene, **options)
        self._options = {"device": torch.device(device), "dtype": getattr(torch, self.dtype.name)}
        self.cell = StencilCell.of(cell, dtype=self._options["dtype"]).to(device)
        self._forces = tuple(forces)
        self._held = torch.tensor(scene.handles, dtype=torch.long, device=device)

    def step(self, old: State, new: State, controls: Controls) -> None:
        scene, net, steps = self.scene, net_of(self.scene), int(self.substeps[0])
        held, frame = list(scene.handles), scene.frame_dt
        dt = frame / steps
        decay = float(np.exp(-net.drag * dt))
        starts = [
            a.reshape(self.num_envs, 3, -1)[..., held].transpose(0, 2, 1) for a in (old.positions, old.velocities)
        ]
        handles = *starts, controls.handle_positions, controls.handle_velocities
        bodies = old.colliders, old.collider_velocities, controls.colliders, controls.collider_velocities

        def tensor(a: np.ndarray) -> Tensor:
            return torch.as_tensor(a, **self._options)

        x, v, pressure = tensor(old.positions), tensor(old.velocities), tensor(controls.pressure)
        with torch.no_grad():
            for k in range(steps):
                force = self.cell(x, v)
                if scene.pressure:
                    force = force + pressure_force(x, pressure)
                for extra in self._forces:
                    force = force + extra(x, v)
                v = (v + dt / net.node_mass * force) * decay
                balls = [tensor(a[:, :, 0, :, None, None]) for a in hermite(k / steps, frame, *bodies)]
                for i, body in enumerate(scene.colliders):
                    v = hit_ball(x, v, balls[0][:, i], balls[1][:, i], body.radius, net.keep)
                x = x + dt * v
                if held:
                    driven = [tensor(a.transpose(0, 2, 1)) for a in hermite((k + 1) / steps, frame, *handles)]
                    x, v = (
                        a.flatten(2).index_copy(2, self._held, b).reshape(a.shape)
                        for a, b in zip((x, v), driven, strict=True)
                    )
        new.positions[:], new.velocities[:] = x.cpu().numpy(), v.cpu().numpy()


class TorchSheet(CellSheet):
    """``CellSheet`` in torch: on GPUs, and with forces plugged in; without self-contact."""

    self_contact = False

    def __init__(
        self,
        scene: Scene,
        factors: Mapping[str, float],
        *,
        num_envs: int = 1,
        device: str = "cpu",
        forces: Sequence[Force] = (),
        **options: Any,
    ) -> None:
        self._materials = [scene.material] * num_envs
        super().__init__(scene, factors, num_envs=num_envs, **options)
        numbers = SHARED[:, : len(SHEET)] @ [factors[name] for name in SHEET]
        self.cell = SheetCell(scene, numbers, dtype=getattr(torch, self.dtype.name)).to(device)
        self._forces = tuple(forces)

    def set_materials(self, which: Sequence[int], materials: Sequence[Material]) -> None:
        super().set_materials(which, materials)  # for the number of substeps
        for i, material in zip(which, materials, strict=True):
            self._materials[i] = material

    def step(self, old: State, new: State, controls: Controls) -> None:
        cuts = self._cuts_of(old, controls, self._kernel.speeds(old, new, controls))
        members, levels = np.arange(self.num_envs), self._levels_of(old)
        todo = members
        with torch.no_grad():
            while len(todo):
                taken = cuts[members, levels]
                for cut in np.unique(taken[todo], axis=0):
                    self._frame(todo[(taken[todo] == cut).all(1)], cut, old, new, controls)
                levels = np.maximum(levels, self._levels_of(new))
                todo = np.flatnonzero((cuts[members, levels] != taken).any(1))

    def _frame(self, which: np.ndarray, cut: np.ndarray, old: State, new: State, controls: Controls) -> None:
        """Step some members with one cut."""
        like = self.cell.areas
        part = Controls(**{name: value[which] for name, value in vars(controls).items()})
        start = old.select(which)
        x, v = (torch.as_tensor(a).to(like) for a in (start.positions, start.velocities))
        sheets = properties([self._materials[i] for i in which], like)
        x, v = frame(self.cell, self.scene, sheets, x, v, start, part, int(cut[0]), int(cut[1]), self._forces)
        new.positions[which], new.velocities[which] = x.cpu().numpy(), v.cpu().numpy()
