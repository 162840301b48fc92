"""The physics-embedded CNN cell of Zhao 2024 in torch (figs 1-2): for training, for GPUs, and to be differentiated.

The same cell runs on CPUs through the compiled kernel of particles; see ``surrogates.cell.backend``.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from cloth_envs.physics.particles.solver import NEIGHBOURS, Cell

BRANCHES = ("linear", "nonlinear", "derivative", "bias")
NEAR = 8  # of the neighbours; the others are at distance two


class StencilCell(nn.Module):
    """``F = sum_c [alpha_c d_c + beta_c n_c + gamma_c (w_c . n_c) n_c] + bias`` (Zhao 2024, eqs 6-7).

    ``d_c`` and ``w_c`` are convolutions of positions and velocities with 12 fixed difference kernels, +1 at the
    neighbour and -1 at the centre, shared by x, y and z (the last four, which reach distance two, are dilated);
    ``n = d / sqrt(|d|^2 + eps)`` is the inverse square root unit (ISRU) of the whole vector: by component it could not
    tell a spring's length. Parameters are over ``scales``, so that one learning rate serves all branches.

    With rest ``lengths`` L the same forces are trained as ``linear (d / L - n) + nonlinear n``, so that
    ``alpha = linear / L`` and ``beta = nonlinear - linear``: what stretches a spring and what pulls it at rest. As
    strains are small, ``d / L`` and ``n`` are nearly the same, and gradient descent cannot tell them apart; this
    change of basis and ``pairs`` each bring down the condition number of the loss a thousandfold.

    Args:
        scales: of the branches linear, nonlinear, derivative, bias, with their signs.
        lengths: ``(12,)`` [m], of the neighbours at rest; None trains alpha and beta themselves, as published.
        pairs: opposite neighbours share their weights (6 a branch): forces are then equal and opposite, and momentum
            is kept exactly whatever was learned.
        eps: [m^2], positive.
        dtype: of the parameters, which start at 0.
    """

    near: Tensor
    far: Tensor
    lengths: Tensor | None

    def __init__(
        self,
        *,
        scales: Sequence[float] = (1.0, 1.0, 1.0, 1.0),
        lengths: Tensor | None = None,
        pairs: bool = False,
        eps: float = 1e-12,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        if not eps > 0:
            raise ValueError(f"eps must be positive, got {eps!r}: masked neighbours have no direction")
        self.scales, self.pairs, self.eps = tuple(scales), pairs, eps
        count = len(NEIGHBOURS) // (2 if pairs else 1)
        for name in BRANCHES:
            self.register_parameter(name, nn.Parameter(torch.zeros(3 if name == "bias" else count, dtype=dtype)))
        kernels = torch.zeros(len(NEIGHBOURS), 1, 3, 3, dtype=dtype)
        for kernel, away in zip(kernels, NEIGHBOURS, strict=True):
            row, col = 1 + away // abs(away).max()
            kernel[0, row, col], kernel[0, 1, 1] = 1.0, -1.0
        self.register_buffer("near", kernels[:NEAR], persistent=False)
        self.register_buffer("far", kernels[NEAR:], persistent=False)
        self.register_buffer("lengths", None if lengths is None else lengths.to(dtype))

    @classmethod
    def of(cls, cell: Cell, *, dtype: torch.dtype = torch.float32) -> "StencilCell":
        """The torch twin of a cell of the compiled kernel, whose ``eps`` may be 0."""
        own = cls(eps=cell.eps or 1e-12, dtype=dtype)
        for name, values in zip(BRANCHES, (*cell.coefficients.T, cell.bias), strict=True):
            getattr(own, name).data = torch.tensor(values, dtype=dtype)
        return own

    def branches(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """alpha [N/m], beta [N], gamma [N s/m] ``(12,)`` in the order of ``NEIGHBOURS``, and bias ``(3,)`` [N]."""
        linear, nonlinear, derivative, bias = (getattr(self, n) * s for n, s in zip(BRANCHES, self.scales, strict=True))
        if self.pairs:
            linear, nonlinear, derivative = (a.repeat_interleave(2) for a in (linear, nonlinear, derivative))
        if self.lengths is not None:
            linear, nonlinear = linear / self.lengths, nonlinear - linear
        return linear, nonlinear, derivative, bias

    def differences(self, field: Tensor) -> Tensor:
        """``(B, 3, H, W)`` at the neighbours less at the vertex, ``(B, 3, 12, H, W)``, 0 where there is none."""
        batch, axes, rows, cols = field.shape
        planes = torch.cat([field.reshape(batch * axes, 1, rows, cols), field.new_ones(1, 1, rows, cols)])
        near = functional.conv2d(planes, self.near, padding=1)
        far = functional.conv2d(planes, self.far, padding=2, dilation=2)
        found = torch.cat([near, far], 1)
        there = 1 + found[-1]  # of ones the difference is -1 beyond the border
        return found[:-1].reshape(batch, axes, -1, rows, cols) * there

    def forward(self, positions: Tensor, velocities: Tensor) -> Tensor:
        """Forces ``(B, 3, H, W)`` [N]."""
        alpha, beta, gamma, bias = self.branches()
        d, w = self.differences(positions), self.differences(velocities)
        n = d * torch.rsqrt((d * d).sum(1, keepdim=True) + self.eps)
        channels = (alpha, d), (beta, n), (gamma, (w * n).sum(1, keepdim=True) * n)
        total = sum(torch.einsum("c,bkcij->bkij", weight, feature) for weight, feature in channels)
        return total + bias[:, None, None]
