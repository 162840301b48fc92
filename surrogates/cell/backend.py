"""The backend ``"cnn"``: the cell of Zhao 2024, fitted, stepped by the compiled kernels or in torch.

Learned are dimensionless numbers that multiply what the scene's material says (1 where the cell has found the law),
so weights belong to no one stiffness and mass. On a net of particles they are alpha, beta and gamma of every
neighbour and the weight's direction and size (39 numbers); on a sheet what stretch, shear, bending, damping and
gravity are of the material's (5 numbers, identified class of edges by class of edges).

Plugged in, as in the paper's fig. 2: air drag, wind, pressure, bodies with friction, handles, the step, and geometry
(which neighbours exist; on sheets also how wide a strip an edge stands for, and the masses).

The cell contains the reference's own law, and least squares finds it: on sheets the numbers are 1 to 1e-12 and frames
are those of ``"reference"`` to the bit, at its speed. At the same grid and step there is nothing to gain; see
``training.bench.papers.large_step`` for why several cells cannot take a larger one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cloth_envs.material import Material
from cloth_envs.naming import unknown_name
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.laws.drives import hermite
from cloth_envs.physics.particles.solver import Cell, ParticleSolver, make_kernel, mass_spring_cell, net_of
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.cell.numbers import SHARED, SHEET
from surrogates.checkpoint import load

if TYPE_CHECKING:
    from surrogates.cell.stencil import Force

ENGINES = ("compiled", "torch")
PARTICLES = "cnn_particles"  # the default weights of nets; those of a sheet are cnn_<scene>


def cnn(
    scene: Scene,
    *,
    num_envs: int = 1,
    threads: int = 1,
    dtype: str = "float32",
    weights: str | None = None,
    engine: str = "compiled",
    device: str = "cpu",
    forces: Sequence[Force] = (),
) -> ParticleSolver | ExplicitSolver:
    """The physics-embedded cell of Zhao 2024, fitted, in place of the solver's inner forces.

    Args:
        scene: a sheet, or a net of particles (presets of Zhao 2024).
        num_envs: members of the batch. threads: over them, of the compiled engine.
        dtype: ``"float32"`` or ``"float64"``.
        weights: a checkpoint's name; default ``"cnn_particles"`` or ``"cnn_<scene>"``.
        engine: ``"compiled"``, or ``"torch"`` on ``device``.
        forces: plugged in to the torch engine, ``f(positions, velocities) -> (B, 3, H, W)`` [N] in tensors.

    Raises:
        ValueError: a bad argument, weights that there are not, or plugged-in forces without ``engine="torch"``.
    """
    if engine not in ENGINES:
        raise unknown_name("engine", engine, ENGINES)
    common: dict[str, Any] = {"num_envs": num_envs, "threads": threads, "dtype": dtype}
    name = weights or (PARTICLES if scene.particles is not None else f"cnn_{scene.name.lower()}")
    arrays = load(name).arrays
    if ("factors" in arrays) == (scene.particles is not None):
        of = "a sheet" if "factors" in arrays else "a net of particles"
        raise ValueError(f"weights {name!r} are of {of}, this scene is not: leave weights out")
    factors = dict(zip(SHEET, arrays["factors"].tolist(), strict=True)) if scene.particles is None else {}
    if engine == "torch":
        common |= {"device": device, "forces": forces}
        if scene.particles is None:
            return TorchSheet(scene, factors, **common)
        return TorchNet(scene, dimensional(scene, arrays), **common)
    if forces or device != "cpu":
        raise ValueError('forces and device belong to engine="torch": add it, or leave them out')
    if scene.particles is None:
        return CellSheet(scene, factors, **common)
    return CellNet(scene, dimensional(scene, arrays), **common)


def dimensional(scene: Scene, arrays: Mapping[str, np.ndarray]) -> Cell:
    """The cell of a checkpoint's ``arrays`` for the particles of ``scene``, whatever their stiffness and mass."""
    law, weight = mass_spring_cell(scene), net_of(scene).node_mass * scene.gravity
    return Cell(law.coefficients * arrays["coefficients"], weight * arrays["bias"], float(arrays["eps"][0]))


def dimensionless(scene: Scene, cell: Cell) -> dict[str, np.ndarray]:
    """The arrays of a checkpoint, of which ``dimensional`` makes ``cell`` again on particles like the scene's."""
    law, weight = mass_spring_cell(scene), net_of(scene).node_mass * scene.gravity
    numbers = cell.coefficients / law.coefficients
    return {"coefficients": numbers, "bias": cell.bias / weight, "eps": np.array([cell.eps])}


class CellNet(ParticleSolver):
    """A net of particles whose forces are those of ``cell``; the simulator's kernel, step and contact."""

    def __init__(
        self, scene: Scene, cell: Cell, *, num_envs: int = 1, threads: int = 1, dtype: str = "float32"
    ) -> None:
        super().__init__(scene, num_envs=num_envs, threads=threads, dtype=dtype)
        self._kernel = make_kernel(scene, cell, dtype=dtype)


class CellSheet(ExplicitSolver):
    """A sheet whose material is what a cell was identified to be; the reference's kernel, step and contact.

    ``factors`` multiply the material's stretch, shear, bending and damping, and the scene's gravity (``SHEET``).
    """

    def __init__(
        self, scene: Scene, factors: Mapping[str, float], *, num_envs: int = 1, threads: int = 1, dtype: str = "float32"
    ) -> None:
        self._factors = dict(factors)
        gravity = scene.gravity * self._factors.pop("gravity")
        super().__init__(replace(scene, gravity=gravity), num_envs=num_envs, threads=threads, dtype=dtype)
        self.scene = scene

    def set_materials(self, which: Sequence[int], materials: Sequence[Material]) -> None:
        felt = [m.with_changes(**{n: getattr(m, n) * f for n, f in self._factors.items()}) for m in materials]
        super().set_materials(which, felt)


class TorchNet(ParticleSolver):
    """``CellNet`` in torch: on GPUs, and with forces plugged in."""

    def __init__(
        self,
        scene: Scene,
        cell: Cell,
        *,
        num_envs: int = 1,
        threads: int = 1,
        dtype: str = "float32",
        device: str = "cpu",
        forces: Sequence[Force] = (),
    ) -> None:
        import torch

        from surrogates.cell.stencil import StencilCell

        super().__init__(scene, num_envs=num_envs, threads=threads, dtype=dtype)
        self._options = {"device": torch.device(device), "dtype": getattr(torch, dtype)}
        self.cell = StencilCell.of(cell, dtype=self._options["dtype"]).to(device)
        self._forces = tuple(forces)
        self._held = torch.tensor(scene.handles, dtype=torch.long, device=device)

    def step(self, old: State, new: State, controls: Controls) -> None:
        import torch

        from surrogates.cell.stencil import Ball, Held, step

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
        threads: int = 1,
        dtype: str = "float32",
        device: str = "cpu",
        forces: Sequence[Force] = (),
    ) -> None:
        import torch

        from surrogates.cell.sheet import SheetCell

        self._materials = [scene.material] * num_envs
        super().__init__(scene, factors, num_envs=num_envs, threads=threads, dtype=dtype)
        numbers = SHARED[:, : len(SHEET)] @ [factors[name] for name in SHEET]
        self.cell = SheetCell(scene, numbers, dtype=getattr(torch, dtype)).to(device)
        self._forces = tuple(forces)

    def set_materials(self, which: Sequence[int], materials: Sequence[Material]) -> None:
        super().set_materials(which, materials)  # for the number of substeps
        for i, material in zip(which, materials, strict=True):
            self._materials[i] = material

    def step(self, old: State, new: State, controls: Controls) -> None:
        import torch

        from surrogates.cell.sheet import Moves, Sheets, frame

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
