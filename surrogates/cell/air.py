"""What air does to a cell, in torch: wind and pressure on a sheet's facets, pressure on a net's neighbours."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from cloth_envs.scene import Scene
from surrogates.cell.planes import TINY, cut, place


def air_forces(scene: Scene, x: Tensor, v: Tensor, wind: Tensor, pressure: Tensor) -> Tensor:
    """Wind ``(B, 3)`` (Wejchert & Haumann 1991) and ``pressure`` ``(B,)`` on the four facets of every cell [N].

    See ``laws.air.wind_forces``; facets of both diagonals count half.
    """
    shape = scene.grid.shape
    size = scene.grid.cells
    places = (0, 0), (0, 1), (1, 1), (1, 0)  # upper left, upper right, lower right, lower left
    corners, speeds = ([cut(a, *at, size) for at in places] for a in (x, v))
    total = torch.zeros_like(x)
    for one, two, three in ((0, 3, 2), (0, 2, 1), (0, 3, 1), (3, 2, 1)):
        normal = torch.linalg.cross(corners[two] - corners[one], corners[three] - corners[one], dim=1)
        force = torch.zeros_like(normal)
        if scene.pressure:
            force = force + pressure[:, None, None, None] * normal / 2
        if scene.wind is not None:
            twice_area = ((normal * normal).sum(1, keepdim=True) + TINY).sqrt()
            n = normal / twice_area
            relative = (speeds[one] + speeds[two] + speeds[three]) / 3 - wind[:, :, None, None]
            across = (n * relative).sum(1, keepdim=True)
            slide = relative - across * n
            speed = ((slide * slide).sum(1, keepdim=True) + TINY).sqrt()
            stress = scene.wind.normal * across.abs() * across * n + scene.wind.tangential * speed * slide
            force = force - scene.wind.air_density / 4 * twice_area * stress
        for corner in (one, two, three):
            total = total + place(force / 6, *places[corner], shape)
    return total


def pressure_force(positions: Tensor, pressure: Tensor) -> Tensor:
    """Eq. 3, ``p sum r_a x r_b`` over four pairs of nearest neighbours, for ``pressure`` ``(B,)`` [Pa].

    It is ``p (right - left) x (up - down)``, where a missing neighbour counts as lying on the particle.
    """
    spread = functional.pad(positions, (1, 1, 1, 1), mode="replicate")
    across = spread[..., 1:-1, 2:] - spread[..., 1:-1, :-2]
    up = spread[..., :-2, 1:-1] - spread[..., 2:, 1:-1]
    return pressure[:, None, None, None] * torch.linalg.cross(across, up, dim=1)
