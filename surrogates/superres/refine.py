"""Smoothing of a synthesised cloth by the normals told with it (Chen et al. 2020, section 6), in torch."""

import torch
from torch import Tensor
from torch.nn import functional

PASSES = 3  # the publication has 1 to 5


def smoothed(x: Tensor, normals: Tensor, periodic: bool = False, passes: int = PASSES) -> Tensor:
    """Vertices moved along the normals of the cells around them, into the cells' planes through their middles.

    ``v_i += mean_k n_k (n_k . (c_k - v_i))`` over the cells ``k`` around vertex ``i``, whose normals ``n_k`` are the
    means of those at their corners: folds stay, noise goes. Cells stand for the publication's triangles.

    Args:
        x: positions [m], ``(B, 3, H, W)``. normals: unit vertex normals. passes: how many times.
    """
    faces = functional.normalize(_cells(normals, periodic), dim=1)
    for _ in range(passes):
        off = (faces * _cells(x, periodic)).sum(1, keepdim=True)
        # mean_k n_k (n_k . c_k) - mean_k n_k (n_k . v_i), in six numbers of the cells' outer products.
        target = _around(faces * off, periodic)
        outer = [_around(faces[:, k : k + 1] * faces, periodic) for k in range(3)]
        x = x + target - sum(outer[k] * x[:, k : k + 1] for k in range(3))
    return x


def _cells(field: Tensor, periodic: bool) -> Tensor:
    """Mean of the corners of every cell, ``(B, C, H - 1, cells)``."""
    whole = functional.pad(field, (0, 1, 0, 0), mode="circular") if periodic else field
    return functional.avg_pool2d(whole, 2, 1)


def _around(cells: Tensor, periodic: bool) -> Tensor:
    """Mean over the cells around every vertex, of which there are one to four."""

    def total(part: Tensor) -> Tensor:
        ends = functional.pad(part, (1, 0, 0, 0), mode="circular") if periodic else functional.pad(part, (1, 1))
        return functional.avg_pool2d(functional.pad(ends, (0, 0, 1, 1)), 2, 1, divisor_override=1)

    return total(cells) / total(torch.ones_like(cells[:1, :1]))
