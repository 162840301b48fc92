"""The cell on a sheet in torch: a reference that can be differentiated and trained.

Forces are those of ``cloth_envs.physics.laws.sheet`` with a learned number for every class of edges and branch. Every
edge is evaluated once and acts on both ends, so momentum is kept exactly whatever was learned.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ParamSpec

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from cloth_envs.material import Material
from cloth_envs.physics.laws.stencil import edges, quads, triples
from cloth_envs.scene import Scene
from surrogates.cell.compiled import CLASSES

TINY = 1e-30  # m^2 and m^2/s^2, under roots that would have no slope at 0
P = ParamSpec("P")
Force = Callable[[Tensor, Tensor], Tensor]  # positions, velocities -> forces, all (B, 3, H, W)
# Of each class of edges, then of bending: rows and columns from the corner of a cell to its vertices.
ENDS = ((0, 0), (0, 1)), ((0, 0), (1, 0)), ((0, 0), (1, 1)), ((0, 1), (1, 0))
BENDS = ((0, 0), (0, 1), (0, 2)), ((0, 0), (1, 0), (2, 0)), ((0, 0), (0, 1), (1, 0), (1, 1))
DIFFERENCES = (1, -2, 1), (1, -2, 1), (1, -1, -1, 1)  # second differences along rows and columns, the mixed one


def place(plane: Tensor, at: tuple[int, int], shape: tuple[int, int]) -> Tensor:
    """``plane`` placed with its first vertex ``at`` a row and a column among zeros of ``shape``."""
    down, right = shape[0] - at[0] - plane.shape[-2], shape[1] - at[1] - plane.shape[-1]
    return functional.pad(plane, (at[1], right, at[0], down))


def cut(field: Tensor, at: tuple[int, int], size: Sequence[int]) -> Tensor:
    """The part of ``size`` from a row and a column ``at`` on."""
    return field[..., at[0] : at[0] + size[0], at[1] : at[1] + size[1]]


def properties(materials: Sequence[Material], like: Tensor) -> dict[str, Tensor]:
    """Each of the ``materials``' properties and ``simple``, ``(B, 1, 1, 1)``, of the type and device of ``like``."""
    rows = [m.as_dict() | {"simple": float(m.simple)} for m in materials]
    columns = {name: np.array([row[name] for row in rows])[:, None, None, None] for name in rows[0]}
    return {name: torch.as_tensor(a, dtype=like.dtype, device=like.device) for name, a in columns.items()}


class SheetCell(nn.Module):
    """Forces of stretch, shear, damping and bending, and the weight, times ``numbers`` ``(17,)`` (of ``CLASSES``).

    On an edge ``f = k (alpha - L beta / |d + gamma c w|) d``, ``c`` the damping; all numbers are 1 (the
    sideways biases 0) on the reference. Where the material is not simple, dashpots are ``gamma c k (w . n) n``, and a
    shortened edge pulls less and is damped more (``laws.sheet.damped_spring_forces``): with the factors of
    ``scaling="closure"`` it is the cell of a coarse sheet. Materials (``properties``) come with the call, so weights
    belong to none.

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
        self.shape, self.gravity, self.edges = grid.shape, scene.gravity, list(edges(grid))
        start = np.array([name not in ("bias_x", "bias_y") for name in CLASSES], float) if numbers is None else numbers
        self.numbers = nn.Parameter(torch.as_tensor(start, dtype=dtype))
        weights = [part.weight for parts in (self.edges, triples(grid)) for part in parts]
        weights.append(np.full(grid.cells, quads(grid).weight))
        for k, (weight, places) in enumerate(zip(weights, (*ENDS, *BENDS), strict=True)):
            share = torch.as_tensor(weight.reshape(np.subtract(grid.shape, np.max(places, 0))), dtype=dtype)
            self.register_buffer(f"share{k}", share, persistent=False)
        self.register_buffer("areas", torch.as_tensor(grid.areas, dtype=dtype), persistent=False)
        self._fusing: dict[str, Any] | None = None

    def fuse(self, **options: Any) -> None:
        """From now on ``frame`` fuses what each law computes, by ``torch.compile`` with ``options``.

        A law is compiled as it is first called, in tens of seconds, and then takes a fraction of its time
        (docs/networks.md); results differ by rounding.
        """
        self._fusing = options

    def fused(self, law: Callable[P, Tensor]) -> Callable[P, Tensor]:
        """``law`` as ``fuse`` has it; as it is where that was not called."""
        return law if self._fusing is None else torch.compile(law, **self._fusing)

    def forward(self, x: Tensor, v: Tensor, sheets: Mapping[str, Tensor]) -> Tensor:
        """Forces ``(B, 3, H, W)`` [N]."""
        return self.springs(x, v, sheets) + self.bending(x, sheets)

    def springs(self, x: Tensor, v: Tensor, sheets: Mapping[str, Tensor]) -> Tensor:
        """Those of springs with their dashpots, and the weight."""
        total = torch.zeros_like(x)
        for k, (edge, (first, second)) in enumerate(zip(self.edges, ENDS, strict=True)):
            alpha, beta, gamma, share = *self.numbers[k:12:4], getattr(self, f"share{k}")
            d, w = (cut(a, second, share.shape) - cut(a, first, share.shape) for a in (x, v))
            inverse = torch.rsqrt((d * d).sum(1, keepdim=True) + TINY)
            ratio = edge.rest * beta * inverse
            strain = alpha - ratio
            short = strain.clamp_max(0)
            before = torch.maximum(short, -sheets["buckling_strain"] * ratio)
            pull = strain.clamp_min(0) + sheets["compression"] * (before + sheets["post_buckling"] * (short - before))
            e = d + gamma * sheets["damping"] * w
            length = ratio - edge.rest * beta * torch.rsqrt((e * e).sum(1, keepdim=True) + TINY)
            dashpot = gamma * sheets["damping"] * (w * d).sum(1, keepdim=True) * inverse * inverse
            dashpot = dashpot * torch.where(strain < 0, sheets["compression_damping"], 1)
            damped = torch.where(sheets["simple"] > 0, length, dashpot)
            force = sheets[edge.modulus] * share * (pull + damped) * d
            total = total + place(force, first, self.shape) - place(force, second, self.shape)
        signs = self.numbers.new_tensor([1.0, 1.0, -1.0])
        return total + self.gravity * self.mass(sheets) * (signs * self.numbers[14:])[:, None, None]

    def bending(self, x: Tensor, sheets: Mapping[str, Tensor]) -> Tensor:
        """Those of bending."""
        total = torch.zeros_like(x)
        along, down = self.numbers[12:14]
        bends = along, down, (along + down) / 2 * sheets["twist"]
        for k, (places, times, bend) in enumerate(zip(BENDS, DIFFERENCES, bends, strict=True), len(ENDS)):
            share = getattr(self, f"share{k}")
            difference = sum(n * cut(x, at, share.shape) for n, at in zip(times, places, strict=True))
            force = bend * sheets["bend_stiffness"] * share * difference
            for n, at in zip(times, places, strict=True):
                total = total - n * place(force, at, self.shape)
        return total

    def mass(self, sheets: Mapping[str, Tensor]) -> Tensor:
        """Lumped masses ``(B, 1, H, W)`` [kg]."""
        return sheets["areal_density"] * self.areas
