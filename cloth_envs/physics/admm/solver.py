"""P-ADMM: one implicit step a frame by alternating local springs and a global linear system, compiled."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import _minicloth_kernels as kernels
import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.admm.modes import capacitance, eigenvalues, modes
from cloth_envs.physics.solver import Solver, kernel_material, kernel_sheet, whole_number
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State

# w_i^2 of a spring over its stiffness. Measured on 37 x 25 vertices, 40 ms, 10 iterations, for 0.1 / 0.2 / 0.3 / 1:
# distance to the explicit solver after a fall of 0.5 s 23 / 38 / 56 / 259 mm, largest strain of a cloth hung by two
# corners 0.110 / 0.090 / 0.087 / 0.089 (true: 0.086). With 5 iterations 0.1 makes that cloth tremble, 0.2 does not.
WEIGHT = 0.2
_KERNELS: dict[str, type[kernels.Admm32] | type[kernels.Admm64]] = {
    "float32": kernels.Admm32,
    "float64": kernels.Admm64,
}


class AdmmSolver(Solver):
    """Implicit Euler by P-ADMM (Overby et al. 2017).

    A step minimises ``|x - x~|_M^2 / (2 h^2) + sum U_i(D_i x)``, ``x~ = x + h v + h^2 M^-1 f``, where ``f`` is
    gravity, wind and pressure at the step's start. An iteration takes, for every spring, ``y = D x + u``,
    ``z = argmin U(z) + w^2 |z - y|^2 / 2``, ``u <- y - z``, and then solves
    ``(M / h^2 + D^T W^2 D) x = M x~ / h^2 + D^T W^2 (z - u)`` with handles where the frame's cubic has them.

    - The spring's ``z = (k L y^ + w^2 y) / (k + w^2)`` with ``w^2 = 0.2 k``. The start is ``z = D x_t``, ``u = 0`` and
      for x the prediction ``x~``, as in Overby's program.
    - A dashpot ``c`` adds ``c (|d| - |d_t|)^2 / (2 h)``; bending is linear and lies in the matrix.
    - The global step is solved by fast diagonalisation (``modes``), for the correction of x; held vertices by
      their capacitance matrix, bending at free borders by keeping its residual true.
    - Wind on a facet is weakened to what it can do in a step, ``1 / (1 + a |u| h)``.
    - Bodies act by forces with Coulomb friction, detected again in each iteration; a last projection takes
      every vertex out of them.

    Too few iterations leave a step unconverged: the cloth then moves as if it were heavier. Steps of a whole
    frame damp the motion, and a cloth that slides on a body stops later than it should; substeps help.

    Args:
        scene: what is modelled; terms that it does not list are not evaluated.
        num_envs: members of the batch.
        threads: over members of the batch; results do not depend on it.
        dtype: ``"float32"`` or ``"float64"``, of the state and the computation.
        iterations: in a substep.
        substeps: equal steps in a frame.

    Raises:
        ValueError: a bad argument.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        num_envs: int = 1,
        threads: int = 1,
        dtype: str = "float32",
        iterations: int = 10,
        substeps: int = 1,
    ) -> None:
        super().__init__(scene, num_envs=num_envs, threads=threads, dtype=dtype)
        self.iterations, self.substeps = whole_number("iterations", iterations), whole_number("substeps", substeps)
        grid = scene.grid
        self._kernel = _KERNELS[dtype](
            kernel_sheet(scene),
            substeps=self.substeps,
            iterations=self.iterations,
            weight=WEIGHT,
            row_basis=modes(grid.rows, False)[0],
            col_basis=modes(grid.cols, grid.periodic)[0],
        )
        self._systems: list[Any] = [None] * num_envs  # the kernel's, of its dtype
        self.set_materials(range(num_envs), [scene.material] * num_envs)

    def set_materials(self, which: Sequence[int], materials: Sequence[Material]) -> None:
        scene, h = self.scene, self.scene.frame_dt / self.substeps
        made: dict[Material, Any] = {}
        for i, m in zip(which, materials, strict=True):
            if m not in made:
                material = kernel_material(scene, m)
                made[m] = self._kernel.system(material, *_matrix(scene.grid, m, h, scene.handles))
            self._systems[i] = made[m]

    def step(self, old: State, new: State, controls: Controls) -> None:
        self._kernel.advance(old, new, controls, self._systems, self.threads)


@lru_cache(maxsize=64)
def _matrix(grid: Grid, material: Material, h: float, held: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and capacitance of a global step."""
    values = eigenvalues(grid, material, h, WEIGHT)
    return values, capacitance(grid, values, held)
