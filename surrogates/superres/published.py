"""The published networks, in torch: MFSR (Chen et al. 2020), on residual dense blocks, and mesh SR (Chen et al. 2018).

Both take images at coarse resolution, normalised, ``(B, channels, h, w)``, to images four times as fine, whose
vertices include the coarse ones: ``(B, channels, 4 h - 3, 4 w - 3)``, of a tube ``(B, channels, 4 h - 3, 4 w)``.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

SCALE = 4


class Conv(nn.Conv2d):
    """A convolution that keeps an image's size, padded by 0 and, of a tube, by what is on the seam's other side."""

    def __init__(self, inputs: int, outputs: int, size: int, *, periodic: bool = False) -> None:
        super().__init__(inputs, outputs, size)
        self.side, self.periodic = size // 2, periodic
        self.open = (self.side, 0 if periodic else self.side)  # padding by 0

    def forward(self, x: Tensor) -> Tensor:
        return functional.conv2d(self.around(x), self.weight, self.bias, padding=self.open)

    def windows(self, x: Tensor) -> Tensor:
        """What every pixel's outputs are sums of, in the order of the weights: ``(B, inputs * size^2, pixels)``."""
        return functional.unfold(self.around(x), self.kernel_size, padding=self.open)

    def around(self, x: Tensor) -> Tensor:
        """``x`` with what is on the other side of a tube's seam."""
        return functional.pad(x, (self.side, self.side, 0, 0), mode="circular") if self.periodic and self.side else x


class DenseBlock(nn.Module):
    """A residual dense block: every layer sees all before it, a 1 x 1 convolution fuses them."""

    def __init__(self, base: int, growth: int, layers: int, *, periodic: bool = False) -> None:
        super().__init__()
        self.layers = nn.ModuleList([Conv(base + k * growth, growth, 3, periodic=periodic) for k in range(layers)])
        self.fuse = Conv(base + layers * growth, base, 1)

    def forward(self, x: Tensor) -> Tensor:
        known = x
        for layer in self.layers:
            known = torch.cat([known, layer(known).relu()], 1)
        return x + self.fuse(known)


class Mfsr(nn.Module):
    """Multi-feature super-resolution (section 5.1): a shared trunk, a bilinear enlargement, a head a feature.

    The defaults are the published ones (the width of the trunk those of Zhang et al. 2018): 4.4 million weights. The
    heads are one convolution each, so that one with the outputs of all is the same.

    Args:
        base: channels of the trunk. blocks, layers, growth: of its residual dense blocks.
        channels: of the images. periodic: for tubes.
    """

    def __init__(
        self, *, base: int = 64, blocks: int = 16, layers: int = 6, growth: int = 32, channels: int = 9,
        periodic: bool = False,
    ) -> None:  # fmt: skip
        super().__init__()
        self.first, self.second = (Conv(n, base, 3, periodic=periodic) for n in (channels, base))
        self.blocks = nn.ModuleList([DenseBlock(base, growth, layers, periodic=periodic) for _ in range(blocks)])
        self.fuse = nn.Sequential(Conv(base * blocks, base, 1), Conv(base, base, 3, periodic=periodic))
        self.heads = Conv(base, channels, 3, periodic=periodic)
        self.periodic = periodic

    def forward(self, x: Tensor) -> Tensor:
        shallow = self.first(x)
        deep, found = self.second(shallow), []
        for block in self.blocks:
            deep = block(deep)
            found.append(deep)
        return self.heads(enlarged(shallow + self.fuse(torch.cat(found, 1)), self.periodic))


def enlarged(x: Tensor, periodic: bool) -> Tensor:
    """Bilinear interpolation to ``SCALE`` times as many cells along each side."""
    rows, cols = (SCALE * (n - 1) + 1 for n in x.shape[2:])
    if not periodic:
        return functional.interpolate(x, size=(rows, cols), mode="bilinear", align_corners=True)
    whole = torch.cat([x, x[..., :1]], -1)
    return functional.interpolate(whole, size=(rows, cols + SCALE), mode="bilinear", align_corners=True)[..., :-1]


class ResidualBlock(nn.Module):
    """Two convolutions, each with batch normalisation, added to what they were given."""

    def __init__(self, base: int, *, periodic: bool = False) -> None:
        super().__init__()
        conv = (Conv(base, base, 3, periodic=periodic) for _ in range(2))
        self.body = nn.Sequential(next(conv), nn.BatchNorm2d(base), nn.PReLU(), next(conv), nn.BatchNorm2d(base))

    def forward(self, x: Tensor) -> Tensor:
        found: Tensor = x + self.body(x)
        return found


class MeshSr(nn.Module):
    """Mesh SR, the SRResNet of Ledig et al. 2017 on displacements, enlarged by two pixel shuffles.

    Args:
        base: channels of the trunk. blocks: of two convolutions. channels: of the images; 3 in mesh SR, 9 where the
            trunk is compared with that of MFSR. periodic: for tubes.
    """

    def __init__(self, *, base: int = 64, blocks: int = 16, channels: int = 3, periodic: bool = False) -> None:
        super().__init__()
        self.periodic = periodic
        self.first = nn.Sequential(Conv(channels, base, 9, periodic=periodic), nn.PReLU())
        self.trunk = nn.Sequential(
            *(ResidualBlock(base, periodic=periodic) for _ in range(blocks)),
            Conv(base, base, 3, periodic=periodic),
            nn.BatchNorm2d(base),
        )
        double = [(Conv(base, 4 * base, 3, periodic=periodic), nn.PixelShuffle(2), nn.PReLU()) for _ in range(2)]
        self.enlarge = nn.Sequential(*(part for parts in double for part in parts))
        self.last = Conv(base, channels, 9, periodic=periodic)

    def forward(self, x: Tensor) -> Tensor:
        shallow = self.first(x)
        fine = self.last(self.enlarge(shallow + self.trunk(shallow)))
        return tiled(fine, self.periodic)


def tiled(fine: Tensor, periodic: bool) -> Tensor:
    """Of a tile of ``SCALE x SCALE`` pixels around every coarse vertex, those that are vertices of the fine grid."""
    rows, cols = (SCALE * (n // SCALE - 1) + 1 for n in fine.shape[2:])
    if periodic:
        return fine.roll(-1, 3)[:, :, 1 : 1 + rows]
    return fine[:, :, 1 : 1 + rows, 1 : 1 + cols]
