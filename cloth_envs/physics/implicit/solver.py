"""The implicit reference solver: unconditionally stable steps, minimised to a stated residual."""

from collections.abc import Sequence
from typing import Any

import _minicloth_kernels as kernels
import numpy as np

from cloth_envs.arguments import as_number, one_of, whole_number
from cloth_envs.material import Material
from cloth_envs.physics.implicit.step import GAMMA, Drive, ImplicitStep
from cloth_envs.physics.laws.drives import handle_starts
from cloth_envs.physics.solver import Solver, check_condition, kernel_sheet
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State

SLACK = 1e-3  # of the thickness: how near to a body a vertex counts as touching it


class ImplicitSolver(Solver):
    """Each step is the minimum of ``|x - x^|_M^2 / (2 h^2) + springs + bending + h Psi_air``, outside the bodies.

    ``x^ = x + h D v + h^2 phi g`` with the drag's exact ``D`` and ``phi``. A dashpot is a change of its spring's
    stiffness and length, the air a convex dissipation potential ``rho/2 A (C_n |u_n|^3 / 3 + C_l s u_n^2 / 2
    + C_t |u_t|^3 / 3)`` on cells whose normals, areas and, for the lift, sliding speeds ``s = |u_t|`` are those at the
    step's start; so is the pressure's force. The minimum is found by L-BFGS with the
    prefactored projective-dynamics matrix as initial Hessian (Liu, Bouaziz & Kavan 2017) and a line search.

    Contact: every iterate lies outside the bodies. Vertices that a gradient presses against a body move along its
    surface, and stick where the pull along it is less than friction times the load; both are exact at the end, so a
    resting sheet does not creep. A vertex that passed the middle of a body in a step is put back to the side where
    it came in. One body holds a vertex at a time; where two squeeze it, the last one listed wins.

    ``scheme="sdirk2"`` is of order 2, L-stable and costs two minimisations; impacts and the onset of sliding stay of
    order 1. Handles and bodies move on cubics through the frame. One long step of a stiff sheet takes hundreds of
    iterations: this solver is for what would need too many steps of the explicit one.
    Members of the batch are stepped one after the other, in float64; each stops on its own.

    Args, beside those of ``Solver``:
        scheme: ``"euler"`` or ``"sdirk2"``.
        substeps: steps per frame.
        tolerance: a step ends when the unbalanced force on no vertex exceeds this share of its weight at 9.81 m/s^2.
            About 1e-8 can be reached at steps of some milliseconds.
        max_iterations: in one minimisation. When they do not suffice the frame goes on from the last iterate, and
            ``residual`` says so.
        window: secants that L-BFGS keeps.

    Attributes:
        iterations: of the last frame, ``(B,)``, summed over its minimisations.
        residual: of the last frame, ``(B,)``, the largest at the end of a minimisation, in the units of ``tolerance``.

    Raises:
        ValueError: a bad argument.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        num_envs: int = 1,
        dtype: str = "float32",
        scheme: str = "euler",
        substeps: int = 1,
        tolerance: float = 0.1,
        max_iterations: int = 500,
        window: int = 8,
    ) -> None:
        super().__init__(scene, num_envs=num_envs, threads=1, dtype=dtype)
        share = as_number(tolerance)
        if share is None or not 0 < share < np.inf:
            raise ValueError(f"tolerance must be a positive number such as 0.1, got {tolerance!r}")
        self._options: dict[str, Any] = {
            "scheme": one_of("scheme", scheme, GAMMA),
            "substeps": whole_number("substeps", substeps),
            "tolerance": share,
            "max_iterations": whole_number("max_iterations", max_iterations),
            "window": whole_number("window", window),
        }
        sheet = kernel_sheet(scene)
        self._potential, self._contact = kernels.Potential(sheet), kernels.Contact(sheet, SLACK * scene.thickness)
        self._steps: dict[int, ImplicitStep] = {}
        self.iterations, self.residual = np.zeros(num_envs, np.int64), np.zeros(num_envs)

    def check_material(self, material: Material) -> None:
        super().check_material(material)
        check_condition(self.scene, material, self.scene.frame_dt / self._options["substeps"], np.dtype(np.float64))

    def set_materials(self, which: Sequence[int], materials: Sequence[Material]) -> None:
        for i, material in zip(which, materials, strict=True):
            self._steps[i] = ImplicitStep(self.scene, material, self._potential, self._contact, **self._options)

    def step(self, old: State, new: State, controls: Controls) -> None:
        shape, held = self.scene.grid.shape, list(self.scene.handles)
        for i in range(self.num_envs):
            x, v = (array[i].astype(np.float64).reshape(3, -1) for array in (old.positions, old.velocities))
            ends = controls.handle_positions[i], controls.handle_velocities[i]
            starts = handle_starts(self.scene, x[:, held].T, v[:, held].T, ends[0])
            bodies = (old.colliders, old.collider_velocities, controls.colliders, controls.collider_velocities)
            drive = Drive(
                self.scene.frame_dt,
                tuple(a.T for a in (*starts, *ends)),
                tuple(array[i].astype(np.float64) for array in bodies),
                controls.wind[i].astype(np.float64),
                float(controls.pressure[i]) if self.scene.pressure else 0.0,
            )
            x, v = self._steps[i].frame(x, v, drive)
            new.positions[i], new.velocities[i] = x.reshape(3, *shape), v.reshape(3, *shape)
            self.iterations[i], self.residual[i] = self._steps[i].iterations, self._steps[i].residual
