"""Planes of vertices in torch: what the parts of the cell share."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor
from torch.nn import functional

TINY = 1e-30  # m^2 and m^2/s^2, under roots that would have no slope at 0
Force = Callable[[Tensor, Tensor], Tensor]  # positions, velocities -> forces, all (B, 3, H, W)


def place(plane: Tensor, top: int, left: int, shape: tuple[int, int]) -> Tensor:
    """``plane`` placed at row ``top`` and column ``left`` among zeros of ``shape``."""
    down, right = shape[0] - top - plane.shape[-2], shape[1] - left - plane.shape[-1]
    return functional.pad(plane, (left, right, top, down))


def cut(field: Tensor, top: int, left: int, size: tuple[int, int]) -> Tensor:
    """The part of ``size`` from row ``top`` and column ``left`` on."""
    return field[..., top : top + size[0], left : left + size[1]]
