"""What the air does to the sheet: its resistance and pressure on facets. Arrays are those of ``laws.sheet``."""

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.physics.laws.sheet import Forces, flat
from cloth_envs.scene import Scene


def _corners(grid: Grid, x: np.ndarray) -> np.ndarray:
    """The three corners of every facet, ``(3 corners, B, T, 3 axes)``."""
    return flat(x)[:, :, grid.facets.T].transpose(2, 0, 3, 1)


def _to_vertices(grid: Grid, force: np.ndarray, shape: tuple[int, ...]) -> Forces:
    """A third of half of every facet's force ``(B, T, 3)`` to each of its corners."""
    out = np.zeros((grid.vertices, len(force), 3))
    for corner in grid.facets.T:
        np.add.at(out, corner, force.transpose(1, 0, 2) / 6)
    return out.transpose(1, 2, 0).reshape(shape)


def air_forces(scene: Scene, x: np.ndarray, v: np.ndarray, wind: np.ndarray) -> Forces:
    """``f = -rho/2 A ((C_n |u_n| + C_l |u_t|) u_n n + C_t |u_t| u_t)`` on a facet.

    ``u`` is the facet's mean velocity less ``wind`` ``(B, 3)``, ``u_n = n.u`` and ``u_t`` its part in the plane: over
    ``rho/2 A |u|^2`` the normal force is ``C_n sin^2 a + C_l sin a cos a`` at an angle of attack ``a`` (Polhamus 1966;
    with ``C_l = 0`` it is the law of Wejchert & Haumann 1991).
    """
    air = scene.air
    if air is None:
        return np.zeros(x.shape)
    x0, x1, x2 = _corners(scene.grid, x)
    normal = np.cross(x1 - x0, x2 - x0)
    twice_area = np.linalg.norm(normal, axis=2, keepdims=True)
    n = normal / twice_area
    relative = _corners(scene.grid, v).mean(0) - wind[:, None, :]
    across = (n * relative).sum(2, keepdims=True)
    tangential = relative - across * n
    speed = np.linalg.norm(tangential, axis=2, keepdims=True)
    stress = (air.normal * abs(across) + air.lift * speed) * across * n + air.tangential * speed * tangential
    return _to_vertices(scene.grid, -0.5 * air.density * (twice_area / 2) * stress, x.shape)


def pressure_forces(grid: Grid, x: np.ndarray, pressure: np.ndarray) -> Forces:
    """``p (x1 - x0) x (x2 - x0) / 2`` on a facet: ``pressure`` ``(B,)`` [Pa] along its normal."""
    x0, x1, x2 = _corners(grid, x)
    return _to_vertices(grid, pressure[:, None, None] * np.cross(x1 - x0, x2 - x0) / 2, x.shape)


def pressure_energy(grid: Grid, x: np.ndarray, pressure: np.ndarray) -> np.ndarray:
    """``-p V``, ``V = sum x0 . (x1 x x2) / 12`` over facets. Its gradient is the force at vertices off the border."""
    x0, x1, x2 = _corners(grid, x)
    return -pressure * (x0 * np.cross(x1, x2)).sum((1, 2)) / 12
