"""The cell on a sheet in torch: a reference that can be differentiated and trained.

Forces are those of ``cloth_envs.physics.laws.sheet`` with a learned number for every class of edges and branch. Every
edge is evaluated once and acts on both ends, so momentum is kept exactly whatever was learned.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cloth_envs.material import Material
from cloth_envs.physics.laws.stencil import edges, triples
from cloth_envs.scene import Scene
from surrogates.cell.numbers import CLASSES
from surrogates.cell.planes import TINY, cut, place


class Sheets(NamedTuple):
    """The materials of a batch, each ``(B, 1, 1, 1)``; ``drag`` is 0 where a scene has none."""

    areal_density: Tensor
    stretch_stiffness: Tensor
    shear_stiffness: Tensor
    bend_stiffness: Tensor
    damping: Tensor
    drag: Tensor
    compression: Tensor
    buckling_strain: Tensor
    post_buckling: Tensor
    compression_damping: Tensor

    @classmethod
    def of(cls, scene: Scene, materials: Sequence[Material], like: Tensor) -> Sheets:
        """``materials`` in the type and on the device of ``like``."""
        rows = [[getattr(m, name) * (scene.drag if name == "drag" else 1) for name in cls._fields] for m in materials]
        return cls(*torch.as_tensor(np.array(rows).T, dtype=like.dtype, device=like.device)[..., None, None, None])


class SheetCell(nn.Module):
    """Forces of stretch, shear, damping and bending, and the weight, times ``numbers`` ``(17,)`` (of ``CLASSES``).

    On an edge ``f = k alpha d - k L beta n + c k gamma (w . n) n``, with ``n = d / |d|``; all numbers are 1 (the
    sideways biases 0) on the reference. Where the material yields, a shortened edge has less of the first two and more
    of the last (``laws.sheet.spring_forces``): with the factors of ``scaling="closure"`` it is the cell of a coarse
    sheet. Materials come with the call, so weights belong to none.

    Args:
        scene: for its grid and gravity.
        numbers: where to start; default the reference's own.
        dtype: of parameters and geometry.

    Raises:
        ValueError: a periodic grid.
    """

    areas: Tensor

    def __init__(self, scene: Scene, numbers: np.ndarray | None = None, *, dtype: torch.dtype = torch.float32) -> None:
        super().__init__()
        grid = scene.grid
        if grid.periodic:
            raise ValueError("this cell steps flat sheets, the grid is a tube: use the compiled engine")
        self.shape, self.gravity = grid.shape, scene.gravity
        start = np.array([name not in ("bias_x", "bias_y") for name in CLASSES], float) if numbers is None else numbers
        self.numbers = nn.Parameter(torch.as_tensor(start, dtype=dtype))
        rows, cols = grid.shape
        sizes = (rows, cols - 1), (rows - 1, cols), (rows - 1, cols - 1), (rows - 1, cols - 1)
        ends = ((0, 0), (0, 1)), ((0, 0), (1, 0)), ((0, 0), (1, 1)), ((0, 1), (1, 0))
        self.edges = list(zip(edges(grid), sizes, ends, strict=True))
        for k, (edge, size, _) in enumerate(self.edges):
            self.register_buffer(f"share{k}", torch.as_tensor(edge.weight.reshape(size), dtype=dtype), persistent=False)
        bends = ((rows, cols - 2), (0, 1)), ((rows - 2, cols), (1, 0))
        self.bends = list(zip(triples(grid), bends, strict=True))
        for k, (triple, (size, _)) in enumerate(self.bends):
            self.register_buffer(
                f"bend{k}", torch.as_tensor(triple.weight.reshape(size), dtype=dtype), persistent=False
            )
        self.register_buffer("areas", torch.as_tensor(grid.areas, dtype=dtype), persistent=False)

    def forward(self, x: Tensor, v: Tensor, sheets: Sheets) -> Tensor:
        """Forces ``(B, 3, H, W)`` [N]."""
        total = torch.zeros_like(x)
        for k, (edge, size, (first, second)) in enumerate(self.edges):
            alpha, beta, gamma = self.numbers[k], self.numbers[4 + k], self.numbers[8 + k]
            d, w = (cut(a, *second, size) - cut(a, *first, size) for a in (x, v))
            inverse = torch.rsqrt((d * d).sum(1, keepdim=True) + TINY)
            ratio = edge.rest * beta * inverse
            strain = alpha - ratio
            short = strain.clamp_max(0)
            before = torch.maximum(short, -sheets.buckling_strain * ratio)
            pull = strain.clamp_min(0) + sheets.compression * (before + sheets.post_buckling * (short - before))
            damping = sheets.damping * gamma * torch.where(strain < 0, sheets.compression_damping, 1)
            rate = damping * (w * d).sum(1, keepdim=True) * inverse * inverse
            force = getattr(sheets, edge.modulus) * getattr(self, f"share{k}") * (pull + rate) * d
            total = total + place(force, *first, self.shape) - place(force, *second, self.shape)
        for k, (_, (size, (down, right))) in enumerate(self.bends):
            before, middle, after = (cut(x, n * down, n * right, size) for n in range(3))
            force = (
                self.numbers[12 + k] * sheets.bend_stiffness * getattr(self, f"bend{k}") * (before - 2 * middle + after)
            )
            placed = [place(force, n * down, n * right, self.shape) for n in range(3)]
            total = total - placed[0] + 2 * placed[1] - placed[2]
        signs = self.numbers.new_tensor([1.0, 1.0, -1.0])
        weight = self.gravity * self.mass(sheets) * (signs * self.numbers[14:])[:, None, None]
        return total + weight

    def mass(self, sheets: Sheets) -> Tensor:
        """Lumped masses ``(B, 1, H, W)`` [kg]."""
        return sheets.areal_density * self.areas
