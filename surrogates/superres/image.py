"""Geometry images (Chen et al. 2020, section 4), in torch: the grid is the image, its nine channels are features.

Channels are the displacement from the sheet at rest [m], the area-weighted vertex normal and the velocity [m/s], of a
cloth that was turned and moved onto the sheet at rest (Kabsch 1976). Images are ``(B, channels, H, W)``.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from cloth_envs.grid import Grid


def at_rest(grid: Grid) -> Tensor:
    """The sheet at rest, flat, ``(3, H, W)`` [m]: columns along x, rows downwards along -y; of a tube, a cylinder."""
    down = -torch.arange(grid.rows) * grid.row_spacing
    along = torch.arange(grid.cols) * grid.col_spacing
    v, u = torch.meshgrid(down, along, indexing="ij")
    if not grid.periodic:
        return torch.stack([u, v, torch.zeros_like(u)]).float()
    radius = grid.width / (2 * torch.pi)
    return torch.stack([radius * torch.cos(u / radius), v, -radius * torch.sin(u / radius)]).float()


class Alignment(NamedTuple):
    """``x -> turn (x - centre) + target``; ``turn`` ``(B, 3, 3)``, ``centre`` and ``target`` ``(B or 1, 3, 1, 1)``."""

    turn: Tensor
    centre: Tensor
    target: Tensor

    @classmethod
    def of(cls, x: Tensor, rest: Tensor) -> "Alignment":
        """The rigid motion that brings cloths ``x`` ``(B, 3, h, w)`` nearest to ``rest`` ``(3, h, w)``."""
        centre, target = x.mean((2, 3), keepdim=True), rest.mean((1, 2))[None, :, None, None]
        spread = (x - centre).flatten(2) @ (rest - target[0]).flatten(1).T
        u, _, vh = torch.linalg.svd(spread.double())
        sign = torch.ones(len(x), 3, dtype=torch.float64, device=x.device)
        sign[:, 2] = torch.det(vh.mT @ u.mT)
        return cls((vh.mT @ (sign[:, :, None] * u.mT)).to(x.dtype), centre, target)

    def points(self, x: Tensor) -> Tensor:
        """Positions ``(B, 3, H, W)``, aligned."""
        return self.vectors(x - self.centre) + self.target

    def vectors(self, a: Tensor) -> Tensor:
        """Vectors ``(B, 3, H, W)``, turned alike."""
        return (self.turn @ a.flatten(2)).view_as(a)

    def back(self, x: Tensor) -> Tensor:
        """The inverse of ``points``."""
        return (self.turn.mT @ (x - self.target).flatten(2)).view_as(x) + self.centre


def _step(x: Tensor, axis: int, periodic: bool) -> Tensor:
    """Next vertex less the one before; at open ends the vertex itself stands for the missing one."""
    if periodic:
        return x.roll(-1, axis) - x.roll(1, axis)
    size = x.shape[axis]
    first, last = x.narrow(axis, 1, 1) - x.narrow(axis, 0, 1), x.narrow(axis, -1, 1) - x.narrow(axis, -2, 1)
    return torch.cat([first, x.narrow(axis, 2, size - 2) - x.narrow(axis, 0, size - 2), last], axis)


def normals(x: Tensor, periodic: bool = False) -> Tensor:
    """Unit vertex normals of ``x`` ``(B, 3, H, W)``, weighted by the area of the triangles around."""
    (a, b, c), (d, e, f) = (part.unbind(1) for part in (_step(x, 2, False), _step(x, 3, periodic)))
    n = torch.stack([b * f - c * e, c * d - a * f, a * e - b * d], 1)  # twice as fast as torch's cross and normalize
    return n / (n.square().sum(1, keepdim=True) + 1e-24).sqrt()


def image(x: Tensor, v: Tensor, rest: Tensor, align: Alignment, periodic: bool = False) -> Tensor:
    """The nine channels of cloths at ``x`` [m] with velocities ``v`` [m/s], ``(B, 3, H, W)``: ``(B, 9, H, W)``."""
    flat = align.points(x)
    return torch.cat([flat - rest, normals(flat, periodic), align.vectors(v)], 1)


class Range(NamedTuple):
    """Least value and width of every channel, ``(1, C, 1, 1)``, over the training data: images become 0 to 1."""

    low: Tensor
    width: Tensor

    @classmethod
    def of(cls, images: Tensor) -> "Range":
        low, high = images.amin((0, 2, 3), keepdim=True), images.amax((0, 2, 3), keepdim=True)
        return cls(low, (high - low).clamp_min(1e-6))

    def __call__(self, images: Tensor) -> Tensor:
        return (images - self.low) / self.width

    def back(self, numbers: Tensor) -> Tensor:
        return numbers * self.width + self.low
