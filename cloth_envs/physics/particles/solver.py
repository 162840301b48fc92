"""The solver of a net of particles: the simulator of Zhao 2024, compiled."""

from collections.abc import Sequence
from dataclasses import dataclass

import _minicloth_kernels as kernels
import numpy as np

from cloth_envs.arguments import whole_number
from cloth_envs.material import Material
from cloth_envs.particles import Particles
from cloth_envs.physics.solver import Solver, kernel_sheet
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State

# Offsets (rows, columns) of the 13-point stencil: nearest, diagonal, at distance two.
NEIGHBOURS = np.array(
    [(0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1), (0, 2), (0, -2), (2, 0), (-2, 0)], np.int32
)


@dataclass(frozen=True)
class Cell:
    """The force on a particle in the form of Zhao 2024 (eqs 6-7), of which mass and springs are one case.

    ``F = sum_c [alpha_c d_c + beta_c n_c + gamma_c (w_c . n_c) n_c] + bias`` over the neighbours that exist, with
    ``d`` and ``w`` the neighbour's position and velocity less the particle's own and ``n = d / sqrt(|d|^2 + eps)``.
    """

    coefficients: np.ndarray  # ``(12, 3)`` alpha [N/m], beta [N] and gamma [N s/m], in the order of ``NEIGHBOURS``
    bias: np.ndarray  # ``(3,)`` [N]
    eps: float = 0.0  # [m^2]; 0 makes ``n`` a unit vector


def net_of(scene: Scene) -> Particles:
    """The scene's particles.

    Raises:
        ValueError: the scene is a sheet, has another grid, or models what a net of particles has not.
    """
    if scene.particles is None:
        raise ValueError(f"{scene.name} is a sheet: choose a preset whose scene has particles, such as 'zhao2024'")
    if scene.grid.periodic or scene.air is not None or any(body.kind != "sphere" for body in scene.colliders):
        raise ValueError("a net of particles is flat and knows no air and no bodies but spheres: change the scene")
    spacings, own = (scene.grid.row_spacing, scene.grid.col_spacing), scene.particles.spacing
    if not np.allclose(spacings, own, rtol=1e-9, atol=0):
        raise ValueError(
            f"the settings of these particles belong to a grid of spacing {own:g} m, this one has {spacings}: "
            'use backend="reference" and no other resolution'
        )
    return scene.particles


def mass_spring_cell(scene: Scene) -> Cell:
    """Springs, dashpots and gravity (eqs 1, 2, 4) as a cell.

    ``F = Y (|d|/L - 1) n + c (w . n) n`` has ``alpha = Y / L``, ``beta = -Y`` and ``gamma = c``.
    """
    net = net_of(scene)
    length = np.hypot(*(NEIGHBOURS * [scene.grid.row_spacing, scene.grid.col_spacing]).T)
    y, c = np.full(len(length), net.stiffness), np.full(len(length), net.dashpot)
    return Cell(np.stack([y / length, -y, c], 1), np.array([0.0, 0.0, -net.node_mass * scene.gravity]))


def steps_a_frame(scene: Scene) -> int:
    """How many steps of ``sim_dt`` a frame has. Raises ValueError: it is no whole number."""
    count = scene.frame_dt / net_of(scene).sim_dt
    if abs(count - round(count)) > 1e-9 * count or round(count) < 1:
        raise ValueError(f"a frame of {scene.frame_dt:g} s has no whole number of steps of {net_of(scene).sim_dt:g} s")
    return round(count)


def make_kernel(
    scene: Scene, cell: Cell, *, in_place: bool, dtype: str = "float32", refine: int = 1
) -> kernels.Particles32 | kernels.Particles64:
    """The compiled steps of ``scene`` with the forces of ``cell``; ``refine`` divides every step.

    A step is ``v = exp(-drag h) (v + h (F + p sum r_a x r_b) / m)``, then balls, then ``x += h v`` (eq. 5). With
    ``in_place`` velocities change one after the other, row by row, as in the author's loop: F sees the new velocities
    (before drag, balls and handles) of the neighbours that come before, else the old ones of all.
    """
    net, steps = net_of(scene), steps_a_frame(scene) * refine
    kernel = kernels.Particles32 if dtype == "float32" else kernels.Particles64
    return kernel(
        kernel_sheet(scene),
        neighbours=NEIGHBOURS,
        coefficients=np.ascontiguousarray(cell.coefficients, np.float64),
        bias=np.ascontiguousarray(cell.bias, np.float64),
        eps=cell.eps,
        node_mass=net.node_mass,
        decay=np.exp(-net.drag * scene.frame_dt / steps),
        keep=net.keep ** (1 / refine),
        substeps=steps,
        in_place=in_place,
    )


class ParticleSolver(Solver):
    """Semi-implicit Euler at the particles' own step, in the author's order; handles and balls move on cubics.

    Args, beside those of ``Solver``:
        refine: divides the step (4 for truth); what a ball leaves of a velocity in the time is the same.

    Raises:
        ValueError: a bad argument, a scene that is a sheet, or a material other than the scene's.
    """

    def __init__(
        self, scene: Scene, *, num_envs: int = 1, threads: int = 1, dtype: str = "float32", refine: int = 1
    ) -> None:
        super().__init__(scene, num_envs=num_envs, threads=threads, dtype=dtype)
        refine = whole_number("refine", refine)
        self.substeps = np.full(num_envs, steps_a_frame(scene) * refine, np.int32)
        law = mass_spring_cell(scene)
        self._kernel = make_kernel(scene, law, in_place=True, dtype=self.dtype.name, refine=refine)

    def check_material(self, material: Material) -> None:
        if material != self.scene.material:
            raise ValueError("a net of particles has no material to change: its settings are scene.particles")

    def set_materials(self, which: Sequence[int], materials: Sequence[Material]) -> None:
        """Nothing to prepare."""

    def step(self, old: State, new: State, controls: Controls) -> None:
        self._kernel.advance(old, new, controls, self.threads)
