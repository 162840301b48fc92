"""The engine ``"torch"`` of the fitted cell: on GPUs, and with forces plugged in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from cloth_envs.material import Material
from cloth_envs.physics.laws.step import hermite
from cloth_envs.physics.particles.solver import Cell, ParticleSolver, net_of
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.cell.bodies import Ball
from surrogates.cell.compiled import CellSheet
from surrogates.cell.numbers import SHARED, SHEET
from surrogates.cell.planes import Force
from surrogates.cell.sheet import SheetCell, Sheets
from surrogates.cell.stencil import StencilCell
from surrogates.cell.step import Held, Moves, frame, step


class TorchNet(ParticleSolver):
    """``CellNet`` in torch: on GPUs, and with forces plugged in."""

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
        flat, held, frame = (self.num_envs, 3, -1), list(scene.handles), scene.frame_dt
        dt = frame / steps
        from_x, from_v = (a.reshape(flat)[..., held].transpose(0, 2, 1) for a in (old.positions, old.velocities))
        bodies = old.colliders, old.collider_velocities, controls.colliders, controls.collider_velocities

        def tensor(a: np.ndarray) -> torch.Tensor:
            return torch.as_tensor(a, **self._options)

        x, v = tensor(old.positions), tensor(old.velocities)
        pressure = tensor(controls.pressure) if scene.pressure else None
        with torch.no_grad():
            for k in range(steps):
                at, speed = hermite(k / steps, frame, *bodies)
                place, rate = hermite(
                    (k + 1) / steps, frame, from_x, from_v, controls.handle_positions, controls.handle_velocities
                )
                x, v = step(
                    self.cell, x, v, dt=dt, mass=net.node_mass, decay=float(np.exp(-net.drag * scene.drag * dt)),
                    pressure=pressure, forces=self._forces,
                    balls=[
                        Ball(tensor(at[:, i, 0]), tensor(speed[:, i, 0]), body.radius, net.keep)
                        for i, body in enumerate(scene.colliders)
                    ],
                    held=Held(self._held, tensor(place.transpose(0, 2, 1)), tensor(rate.transpose(0, 2, 1)))
                    if held else None,
                )  # fmt: skip
        new.positions[:], new.velocities[:] = x.cpu().numpy(), v.cpu().numpy()


class TorchSheet(CellSheet):
    """``CellSheet`` in torch: on GPUs, and with forces plugged in."""

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
        like = self.cell.areas
        with torch.no_grad():
            for count in np.unique(self.substeps):
                which = np.flatnonzero(self.substeps == count)
                part = Controls(**{name: value[which] for name, value in vars(controls).items()})
                start = old.select(which)
                x, v = (torch.as_tensor(a).to(like) for a in (start.positions, start.velocities))
                sheets = Sheets.of(self.scene, [self._materials[i] for i in which], like)
                moves = Moves.of(start, part, like)
                x, v = frame(self.cell, self.scene, sheets, x, v, moves, int(count), self._forces)
                new.positions[which], new.velocities[which] = x.cpu().numpy(), v.cpu().numpy()
