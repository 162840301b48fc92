"""The sparse system of an implicit step, factored once and shared: ``(M + h^2 K) x = b``."""

from functools import lru_cache

import numpy as np
from scipy import sparse

from cloth_envs.extras import install
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.laws.stencil import edges, quads, triples
from cloth_envs.scene import Scene


def _gram(grid: Grid, vertices: tuple[np.ndarray, ...], signs: list[float], weight: np.ndarray) -> sparse.csr_array:
    """``D^T W D`` ``(n, n)`` of differences that take ``signs`` times the values at ``vertices``, one array a sign."""
    count = len(weight)
    where = (np.tile(np.arange(count), len(signs)), np.concatenate(vertices))
    d = sparse.csr_array((np.repeat(signs, count), where), (count, grid.vertices))
    return d.T @ sparse.diags_array(weight) @ d


def spring_laplacian(grid: Grid, material: Material) -> sparse.csr_array:
    """The Hessian per axis of springs of rest length 0, ``(n, n)`` [N/m]."""
    total = sparse.csr_array((grid.vertices, grid.vertices))
    for edge in edges(grid):
        weight = getattr(material, edge.modulus) * edge.weight
        total = total + _gram(grid, (edge.first, edge.second), [-1.0, 1.0], weight)
    return total.tocsr()


def bending_matrix(grid: Grid, material: Material) -> sparse.csr_array:
    """Hessian per axis of the quadratic bending energy, ``(n, n)`` [N/m]; the same in every configuration."""
    total = sparse.csr_array((grid.vertices, grid.vertices))
    for t in triples(grid):
        weight = material.bend_stiffness * t.weight
        total = total + _gram(grid, (t.before, t.middle, t.after), [1.0, -2.0, 1.0], weight)
    q = quads(grid)
    weight = np.full(len(q.upper_left), material.bend_stiffness * material.twist * q.weight)
    total = total + _gram(grid, q[:4], [1.0, -1.0, -1.0, 1.0], weight)
    return total.tocsr()


class Prefactored:
    """A symmetric positive definite matrix ``(n, n)`` with some vertices held, and its Cholesky factor.

    Held rows and columns are replaced by the identity; what they did to the others is kept apart and
    moved to the right-hand side.

    Raises:
        ImportError: cholespy is missing; says what to install.
    """

    def __init__(self, matrix: sparse.csr_array, held: tuple[int, ...]) -> None:
        try:
            from cholespy import CholeskySolverD, MatrixType
        except ImportError as error:
            raise ImportError(f"solver='implicit' needs cholespy ({error}): {install('implicit')}") from error
        n = matrix.shape[0]
        self.held = np.array(held, np.int32)
        free = np.ones(n)
        free[self.held] = 0.0
        keep = sparse.diags_array(free)
        self.coupling = (keep @ matrix.tocsc()[:, self.held]).tocsr()
        reduced = (keep @ matrix @ keep + sparse.diags_array(1.0 - free)).tocoo()
        rows, cols = (index.astype(np.int32) for index in reduced.coords)
        self._factor = CholeskySolverD(n, rows, cols, reduced.data.astype(np.float64), MatrixType.COO)

    def solve(self, right: np.ndarray, at_held: np.ndarray, out: np.ndarray) -> np.ndarray:
        """Solve for ``out`` ``(n, k)`` with ``out[held] = at_held`` ``(held, k)``; ``right`` ``(n, k)`` is overwritten.

        float64, contiguous.
        """
        if len(self.held):
            right -= self.coupling @ at_held
            right[self.held] = at_held
        self._factor.solve(right, out)
        return out


@lru_cache(maxsize=64)
def implicit_system(scene: Scene, material: Material, h: float) -> Prefactored:
    """``M / h^2 + K`` with ``K`` the springs at full stiffness, grips' too, plus bending [N/m]; firm handles are held.

    One for all equal arguments. A grip that holds along some axes only counts as if it did along all.
    """
    grid, handles, firm = scene.grid, np.array(scene.handles, int), scene.holding.firm
    diagonal = grid.areas.ravel() * material.areal_density / h**2
    diagonal[handles[~firm]] += scene.grip_stiffness(material)[~firm].max(1)
    matrix = sparse.diags_array(diagonal) + spring_laplacian(grid, material) + bending_matrix(grid, material)
    return Prefactored(matrix, tuple(handles[firm].tolist()))
