"""What the air does to the sheet: its resistance on cells, pressure on facets. Arrays are those of ``laws.sheet``."""

from collections.abc import Iterable

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.physics.laws.sheet import Forces, flat
from cloth_envs.physics.laws.stencil import quads
from cloth_envs.scene import Scene

OWN = 1 / 9  # of waves of two cells along both axes a bilinear velocity has this mean square


def _corners(grid: Grid, x: np.ndarray) -> np.ndarray:
    """The three corners of every facet, ``(3 corners, B, T, 3 axes)``."""
    return flat(x)[:, :, grid.facets.T].transpose(2, 0, 3, 1)


def _to_vertices(corners: Iterable[np.ndarray], forces: Iterable[np.ndarray], shape: tuple[int, ...]) -> Forces:
    """``forces`` ``(B, N, 3)`` at each of the ``corners``, arrays of ``N`` vertex numbers."""
    out = np.zeros((shape[2] * shape[3], shape[0], 3))
    for corner, force in zip(corners, forces, strict=True):
        np.add.at(out, corner, force.transpose(1, 0, 2))
    return out.transpose(1, 2, 0).reshape(shape)


def air_forces(scene: Scene, x: np.ndarray, v: np.ndarray, wind: np.ndarray) -> Forces:
    """``f = -rho/2 A ((C_n |u_n| + C_l |u_t|) u_n n + C_t |u_t| u_t)`` on a cell, a quarter at each corner.

    A corner also feels ``-OWN rho/8 A (C_n |u_n| + C_l |u_t|)`` times what its velocity is over the cell's, which has
    no sum: without it the air would not damp waves of two cells. ``A n = (x_lr - x_ul) x (x_ur - x_ll) / 2`` is the
    mean area vector of the cell's two triangulations, ``u`` the mean velocity of its corners less ``wind`` ``(B, 3)``,
    ``u_n = n.u`` and ``u_t`` its part in the plane: over
    ``rho/2 A |u|^2`` the normal force is ``C_n sin^2 a + C_l sin a cos a`` at an angle of attack ``a`` (Polhamus 1966;
    with ``C_l = 0`` it is the law of Wejchert & Haumann 1991).
    """
    air = scene.air
    if air is None:
        return np.zeros(x.shape)
    corners = quads(scene.grid)[:4]
    ul, ur, ll, lr = (flat(x)[..., corner].transpose(0, 2, 1) for corner in corners)
    normal = np.cross(lr - ul, ur - ll)
    twice_area = np.linalg.norm(normal, axis=2, keepdims=True)
    n = normal / twice_area
    speeds = np.stack([flat(v)[..., corner].transpose(0, 2, 1) for corner in corners])
    mean = speeds.mean(0)
    relative = mean - wind[:, None, :]
    across = (n * relative).sum(2, keepdims=True)
    tangential = relative - across * n
    speed = np.linalg.norm(tangential, axis=2, keepdims=True)
    rate = air.normal * abs(across) + air.lift * speed
    stress = rate * across * n + air.tangential * speed * tangential
    quarter = -0.5 * air.density * (twice_area / 2) / 4
    return _to_vertices(corners, [quarter * (stress + OWN * rate * (own - mean)) for own in speeds], x.shape)


def pressure_forces(grid: Grid, x: np.ndarray, pressure: np.ndarray) -> Forces:
    """``p (x1 - x0) x (x2 - x0) / 2`` on a facet, half of it: ``pressure`` ``(B,)`` [Pa] along its normal."""
    x0, x1, x2 = _corners(grid, x)
    force = pressure[:, None, None] * np.cross(x1 - x0, x2 - x0) / 12
    return _to_vertices(grid.facets.T, [force] * 3, x.shape)


def pressure_energy(grid: Grid, x: np.ndarray, pressure: np.ndarray) -> np.ndarray:
    """``-p V``, ``V = sum x0 . (x1 x x2) / 12`` over facets. Its gradient is the force at vertices off the border."""
    x0, x1, x2 = _corners(grid, x)
    return -pressure * (x0 * np.cross(x1, x2)).sum((1, 2)) / 12
