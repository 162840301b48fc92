"""P-ADMM: one implicit step a frame by alternating local springs and a global linear system, compiled.

The global system is solved in the modes of the grid. With borders' masses and stiffnesses halved, springs along rows,
columns and both diagonals act on a grid as on one mirrored about its borders, so products of cosines along rows and
columns are eigenvectors, and solving takes four small matrix products (Lynch, Rice & Thomas 1964). On a tube cosines
and sines go round.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import _minicloth_kernels as kernels
import numpy as np

from cloth_envs.arguments import whole_number
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.solver import Solver, check_condition, kernel_material, kernel_sheet
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State

# w_i^2 of a spring over its stiffness; docs/solvers.md tells how it was measured.
WEIGHT = 0.2


def modes(count: int, periodic: bool) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvectors of a row of ``count`` vertices as columns ``(count, count)``, and the cosine of each one's step.

    Vectors that are even about the middle come first. With the weights ``w`` of the vertices (1, on borders 1/2)
    ``(q * w[:, None]).T @ q`` is the identity; one step changes mode k as ``2 cos_k`` times itself minus its past.
    """
    place, order, weight = np.arange(count)[:, None], np.arange(count), np.ones((count, 1))
    if periodic:
        even, odd = np.arange((count + 1) // 2), np.arange(1, count // 2 + 1)
        angle = 2 * np.pi / count * np.concatenate([even, odd])
        phase = (place + 0.5) * angle
        q = np.concatenate([np.cos(phase[:, : len(even)]), np.sin(phase[:, len(even) :])], 1)
    else:
        angle = np.pi / (count - 1) * np.concatenate([order[0::2], order[1::2]])
        q = np.cos(place * angle)
        weight[[0, -1]] = 0.5
    return q / np.sqrt((weight * q * q).sum(0)), np.cos(angle)


def eigenvalues(grid: Grid, material: Material, h: float) -> np.ndarray:
    """Of ``M / h^2 + K`` relative to the vertices' weights, ``(H, W)`` [N/m], in the order of ``modes``.

    ``K`` holds ``WEIGHT`` times the springs, their dashpots ``c`` as ``c / h``, and bending. At free borders
    its second differences have a term less than on a mirrored grid: the matrix is then an upper bound of the true one.
    """
    a, b, d = grid.row_spacing, grid.col_spacing, grid.diagonal
    row, col = modes(grid.rows, False)[1][:, None], modes(grid.cols, grid.periodic)[1][None, :]
    springs = WEIGHT * (1 + material.damping / h)
    stretch = springs * material.stretch_stiffness * (a / b * (2 - 2 * col) + b / a * (2 - 2 * row))
    shear = springs * material.shear_stiffness * d * d / (2 * a * b) * (4 - 4 * row * col)
    bend = a / b**3 * (2 - 2 * col) ** 2 + b / a**3 * (2 - 2 * row) ** 2
    bend = material.bend_stiffness * (bend + material.twist * 2 / (a * b) * (2 - 2 * col) * (2 - 2 * row))
    return material.areal_density * a * b / h**2 + stretch + shear + bend


def capacitance(
    grid: Grid, values: np.ndarray, held: tuple[int, ...], stiffness: np.ndarray | None = None
) -> np.ndarray:
    """Inverse ``(3, N, N)`` [N/m] along each axis of how the ``held`` vertices give way, for eigenvalues ``values``.

    ``stiffness`` ``(N, 3)`` [N/m] is that of the springs which hold soft ones, infinite for firm ones (all by default);
    they give way by ``1 / stiffness`` themselves (Woodbury's identity), and one of 0 is not held.
    """
    stiffness = np.full((len(held), 3), np.inf) if stiffness is None else stiffness
    rows, cols = np.divmod(np.array(held, int), grid.cols)
    along, across = modes(grid.rows, False)[0][rows], modes(grid.cols, grid.periodic)[0][cols]
    give = np.zeros((len(held), len(held)))
    for mode, value in zip(along.T, values, strict=True):
        e = mode[:, None] * across / np.sqrt(value)
        give += e @ e.T
    inverse = np.zeros((3, len(held), len(held)))
    for axis, k in enumerate(stiffness.T):
        on = np.flatnonzero(k)
        inverse[axis][np.ix_(on, on)] = np.linalg.inv(give[np.ix_(on, on)] + np.diag(1 / k[on]))
    return inverse


class AdmmSolver(Solver):
    """Implicit Euler by P-ADMM (Overby et al. 2017).

    A step minimises ``|x - x~|_M^2 / (2 h^2) + sum U_i(D_i x)``, ``x~ = x + h v + h^2 M^-1 f``, where ``f`` is
    gravity, air and pressure with the step's first facets. An iteration takes, for every spring, ``y = D x + u``,
    ``z = argmin U(z) + w^2 |z - y|^2 / 2``, ``u <- y - z``, and then solves
    ``(M / h^2 + D^T W^2 D) x = M x~ / h^2 + D^T W^2 (z - u)`` with firm handles where the frame's cubic has them; the
    springs of soft ones lie in the matrix.

    - The spring's ``z = (k L y^ + w^2 y) / (k + w^2)`` with ``w^2 = 0.2 k``. The start is ``z = D x_t``, ``u = 0``,
      and for x the prediction ``x~``. A dashpot ``c`` adds ``c (|d| - |d_t|)^2 / (2 h)``; bending lies in the matrix.
    - The air's force on a cell is that at the end of an implicit step of the cell alone, from the velocity that it
      would have without; what springs do to that is looked at once more after half of the iterations.
    - Bodies act by forces with Coulomb friction, detected again in each iteration; a last projection takes
      every vertex out of them.

    Too few iterations leave a step unconverged: the cloth then moves as if it were heavier. Steps of a whole
    frame damp the motion, and a cloth that slides on a body stops later than it should; substeps help.

    Args, beside those of ``Solver`` (the computation has the state's ``dtype`` too):
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
        kernel = kernels.Admm32 if self.dtype == np.float32 else kernels.Admm64
        self._kernel = kernel(
            kernel_sheet(scene),
            substeps=self.substeps,
            iterations=self.iterations,
            weight=WEIGHT,
            row_basis=modes(grid.rows, False)[0],
            col_basis=modes(grid.cols, grid.periodic)[0],
        )
        self._systems: list[Any] = [None] * num_envs  # the kernel's, of its dtype
        self.check_material(scene.material)
        self.set_materials(range(num_envs), [scene.material] * num_envs)

    def check_material(self, material: Material) -> None:
        super().check_material(material)
        check_condition(self.scene, material, self.scene.frame_dt / self.substeps, self.dtype)

    def set_materials(self, which: Sequence[int], materials: Sequence[Material]) -> None:
        scene, h = self.scene, self.scene.frame_dt / self.substeps
        made: dict[Material, Any] = {}
        for i, m in zip(which, materials, strict=True):
            if m not in made:
                made[m] = self._kernel.system(kernel_material(m), *_matrix(scene, m, h))
            self._systems[i] = made[m]

    def step(self, old: State, new: State, controls: Controls) -> None:
        self._kernel.advance(old, new, controls, self._systems, self.threads)


@lru_cache(maxsize=64)
def _matrix(scene: Scene, material: Material, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and capacitance of a global step."""
    values = eigenvalues(scene.grid, material, h)
    return values, capacitance(scene.grid, values, scene.handles, scene.grip_stiffness(material))
