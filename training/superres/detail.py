"""Training of the network that adds detail to interpolation (``surrogates.superres``), and of ridge in its features.

The loss is of the squared distance, of normals, of the error's second difference in time, which flickers, of how
wrinkled windows of the cloth are, and of how much there is in them of what the coarse grid can't have: the mean of all
fine cloths that a coarse one may have is smoother than any of them. Each is in parts of what bicubic interpolation has.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from cloth_envs.grid import Grid
from cloth_envs.resample import weights as interpolation
from surrogates.superres.features import CHANNELS, FRAMES, MIRROR, SCALE, Bodies, features, residual
from surrogates.superres.image import normals
from surrogates.superres.published import Conv, enlarged, tiled
from training.fit import Kept, cosine, fit
from training.superres.frames import CHUNK, Around, Frames, wrinkles

WINDOW = 8  # fine vertices along a side, over which wrinkles are compared
WIDTHS = range(4, 257, 4)  # of hidden layers that the compiled network has
LONG = 0.5  # strain of an edge over which it counts as too long


@dataclass(frozen=True)
class Recipe:
    """A network of ``layers`` hidden ones of ``width`` and its training.

    Attributes:
        normal, flicker, wrinkle, fine: weights of the losses beside that of distances, which is 1.
        strain: that of ``overlong`` edges, for cloths that the guard would interpolate.
        windows: of three frames in a batch. rate: falls along half a cosine.

    Raises:
        ValueError: a width that the compiled network does not have; none of what there must be; a bad ``strain``.
    """

    width: int = 32
    layers: int = 6
    normal: float = 0.3
    flicker: float = 0.1
    wrinkle: float = 0.1
    fine: float = 0.2
    strain: float = 0.0
    steps: int = 6000
    windows: int = 4
    rate: float = 2e-3
    seed: int = 0

    def __post_init__(self) -> None:
        if self.width not in WIDTHS:
            raise ValueError(f"width must be 4, 8, ... {WIDTHS[-1]}, got {self.width}")
        for name in ("layers", "steps", "windows"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if not 0 <= self.strain < float("inf"):
            raise ValueError(f"strain must be a number of at least 0, got {self.strain}")


class Mirrored(Conv):
    """A convolution of 3 x 3 that makes of what is mirrored what it makes of the original, mirrored.

    A mirrored image has ``signs`` times its channels, or, of hidden layers, that have none, its two halves of channels
    for each other (the regular representation of the group). The weights that are used are the mean of those that
    are learnt and of their mirror images.
    """

    def __init__(self, signs: tuple[Tensor | None, Tensor | None], inputs: int, outputs: int, periodic: bool) -> None:
        super().__init__(inputs, outputs, 3, periodic=periodic)
        self.signs = signs  # of inputs and outputs
        with torch.no_grad():
            self.weight *= 2**0.5  # as widely spread after the mean

    def used(self) -> tuple[Tensor, Tensor]:
        """The weights ``(outputs, inputs, 3, 3)`` and biases ``(outputs,)``."""
        inputs, outputs = self.signs
        assert self.bias is not None
        other = _mirrored(_mirrored(self.weight, outputs, 0), inputs, 1)
        return (self.weight + other) / 2, (self.bias + _mirrored(self.bias, outputs, 0)) / 2

    def forward(self, x: Tensor) -> Tensor:
        weight, bias = self.used()
        return functional.conv2d(self.around(x), weight, bias, padding=self.open)


def _mirrored(x: Tensor, signs: Tensor | None, axis: int) -> Tensor:
    """Channels of a mirrored image, which lie along ``axis``."""
    if signs is None:
        return x.roll(x.shape[axis] // 2, axis)
    return x * signs.to(x.device).view(-1, *[1] * (x.ndim - 1 - axis))


class Net(nn.Module):
    """From normalised features ``(B, CHANNELS, h, w)`` to numbers at the fine vertices, ``(B, 3, H, W)``.

    Of a mirrored cloth it tells the mirrored detail, exactly.
    """

    def __init__(self, width: int, layers: int, periodic: bool) -> None:
        super().__init__()
        sizes = [CHANNELS, *[width] * layers, 3 * SCALE**2]
        ends = torch.from_numpy(MIRROR), torch.tensor([1.0, 1.0, -1.0]).repeat_interleave(SCALE**2)
        signs = pairwise([ends[0], *[None] * layers, ends[1]])
        self.layers = nn.ModuleList(
            [Mirrored(sign, a, b, periodic) for sign, (a, b) in zip(signs, pairwise(sizes), strict=True)]
        )
        self.periodic = periodic
        last: Any = self.layers[-1]
        nn.init.zeros_(last.weight), nn.init.zeros_(last.bias)

    def forward(self, x: Tensor) -> Tensor:
        for layer in self.layers[:-1]:
            x = layer(x).relu()
        return tiled(functional.pixel_shuffle(self.layers[-1](x), SCALE), self.periodic)


class Detail:
    """What makes fine cloths of the coarse ones of ``frames``: interpolation, and a network's residual to it.

    Args:
        around: what is around the coarse ones, on the device of the frames.
        scale: mean and width of every feature, ``(1, CHANNELS, 1, 1)`` each; those of these frames if not given.
    """

    def __init__(self, frames: Frames, around: Around, scale: tuple[Tensor, Tensor] | None = None) -> None:
        self.frames, self.around, device = frames, around, frames.coarse.device
        both = interpolation(frames.small, frames.large)
        self._rows, self._cols = (torch.tensor(part, dtype=torch.float32, device=device) for part in both)
        cells = zip(frames.small.cells, frames.large.cells, (False, frames.small.periodic), strict=True)
        modes = (torch.tensor(coarse_modes(*side), dtype=torch.float32, device=device) for side in cells)
        self._down, self._along = modes
        self._run = torch.unique_consecutive(frames.run, return_inverse=True)[1]
        self.scale = scale or self._measured()

    def base(self, numbers: Tensor) -> Tensor:
        """Bicubic interpolation, ``(n, 3, H, W)`` [m]."""
        found: Tensor = self._rows @ self.frames.coarse[numbers] @ self._cols.T
        return found

    def finer(self, x: Tensor) -> Tensor:
        """What of fine cloths ``(n, 3, H, W)`` is shorter than the waves that the coarse grid has."""
        found: Tensor = x - self._down @ x @ self._along
        return found

    def read(self, numbers: Tensor) -> tuple[Tensor, Tensor]:
        """Features ``(n, CHANNELS, h, w)`` and axes of frames that have two of their run before them."""
        past = [self.frames.coarse[numbers - back] for back in reversed(range(FRAMES))]
        held, ends, radii, planes = self.around
        run = self._run[numbers]
        bodies = Bodies(ends[numbers], ends[numbers - 1], radii[run], planes)
        read, turn = features(past, bodies, held[run][:, None], self.frames.small)
        return read, turn

    def _measured(self) -> tuple[Tensor, Tensor]:
        numbers = self.frames.starts(FRAMES - 1, 0)[::7]
        read = torch.cat([self.read(part)[0] for part in torch.split(numbers, CHUNK)])
        mean = read.mean((0, 2, 3), keepdim=True)
        mean *= torch.from_numpy(MIRROR).to(mean.device).view(1, -1, 1, 1) > 0  # that of the cloth and its mirror image
        return mean, (read - mean).square().mean((0, 2, 3), keepdim=True).sqrt() + 1e-3

    def turns(self, turn: Tensor) -> Tensor:
        """The coarse vertices' axes at the fine ones, ``(n, 3, 3, H, W)``."""
        grid = self.frames.small
        fine = enlarged(turn.flatten(1, 2), grid.periodic)
        return fine.view(-1, 3, 3, *fine.shape[2:])

    def __call__(self, net: nn.Module, numbers: Tensor) -> Tensor:
        """The fine cloths at frames ``numbers``, ``(n, 3, H, W)`` [m]."""
        read, turn = self.read(numbers)
        found = net((read - self.scale[0]) / self.scale[1])
        return self.base(numbers) + residual(found, self.turns(turn), self.frames.small)


def parts(x: Tensor, truth: Tensor, periodic: bool, finer: Callable[[Tensor], Tensor]) -> list[Tensor]:
    """The losses of cloths ``(windows, 3, 3, H, W)`` [m]: distance, normals, flicker, wrinkles, what is ``finer``."""
    gap = x - truth
    one, other = (cloth.flatten(0, 1) for cloth in (x, truth))

    def rough(part: Callable[[Tensor], Tensor]) -> Tensor:
        square = (part(cloth).square().sum(1, keepdim=True) for cloth in (one, other))
        a, b = ((functional.avg_pool2d(one, WINDOW) + 1e-11).sqrt() for one in square)
        return (a - b).square().mean()

    return [
        gap.square().sum(2).mean(),
        (1 - (normals(one, periodic) * normals(other, periodic)).sum(1)).mean(),
        (gap[:, 2] - 2 * gap[:, 1] + gap[:, 0]).square().sum(1).mean(),
        rough(wrinkles),
        rough(finer),
    ]


def overlong(x: Tensor, grid: Grid) -> Tensor:
    """The mean square of how far strains of edges of cloths ``x`` ``(B, 3, H, W)`` [m] are over ``LONG``."""
    ahead = x.roll(-1, 3) if grid.periodic else x[..., 1:]
    along = (ahead - x[..., : ahead.shape[3]]) / grid.col_spacing
    down = (x[:, :, 1:] - x[:, :, :-1]) / grid.row_spacing
    over = [((edge.square().sum(1) + 1e-12).sqrt() - 1 - LONG).relu().flatten() for edge in (along, down)]
    return torch.cat(over).square().mean()


def coarse_modes(few: int, many: int, periodic: bool) -> np.ndarray:
    """Projection ``(n, n)`` of the vertices of ``many`` cells onto the waves that ``few`` can have.

    The shortest is as long as two of these: half waves of cosines between open ends, waves around a tube.
    """
    if periodic:
        phase = 2 * np.pi * np.outer(np.arange(many), np.arange(few // 2 + 1)) / many
        waves = np.concatenate([np.cos(phase), np.sin(phase[:, 1:])], 1)
    else:
        waves = np.cos(np.pi * np.outer(np.arange(many + 1) + 0.5, np.arange(few + 1)) / (many + 1))
    base = np.linalg.qr(waves)[0]
    found: np.ndarray = base @ base.T
    return found


def train(
    recipe: Recipe, detail: Detail, *, kept: Kept | None = None, label: str = "", graph: bool = False
) -> tuple[Net, float]:
    """The network and the processor's seconds. ``graph``: run it as a CUDA graph.

    Raises:
        ValueError: ``kept`` is of another training.
    """
    torch.manual_seed(recipe.seed)
    grid, device = detail.frames.small, detail.frames.coarse.device
    net = Net(recipe.width, recipe.layers, grid.periodic).to(device)
    call: Any = net
    if graph:
        call = torch.cuda.make_graphed_callables(
            net, (torch.rand(recipe.windows * 3, CHANNELS, *grid.shape, device=device),)
        )
    starts = detail.frames.starts(FRAMES - 1, 2)

    def compared(find: Callable[[Tensor], Tensor], rng: np.random.Generator) -> tuple[list[Tensor], Tensor]:
        chosen = starts[torch.from_numpy(rng.integers(len(starts), size=recipe.windows))]
        numbers = (chosen[:, None] + torch.arange(3)).flatten()
        shape = (recipe.windows, 3, 3, *detail.frames.large.shape)
        x = find(numbers)
        told = parts(x.view(shape), detail.frames.fine[numbers].view(shape), grid.periodic, detail.finer)
        return told, overlong(x, detail.frames.large) if recipe.strain else x.new_zeros(())

    with torch.no_grad():
        drawn = [compared(detail.base, np.random.default_rng((recipe.seed, 1, k)))[0] for k in range(10)]
    plain = [sum(map(float, part)) / len(part) for part in zip(*drawn, strict=True)]
    weights = [1.0, recipe.normal, recipe.flicker, recipe.wrinkle, recipe.fine]

    def loss(step: int) -> Tensor:
        found, long = compared(lambda numbers: detail(call, numbers), np.random.default_rng((recipe.seed, 0, step)))
        whole = torch.stack([w * part / own for w, part, own in zip(weights, found, plain, strict=True)]).sum()
        return whole + recipe.strain * long

    rate = cosine(recipe.rate, recipe.steps, least=1e-3, warm=50)
    seconds = fit(net, loss, recipe.steps, rate, clip=1.0, label=label, kept=kept)
    return net.eval(), seconds


def ridge(detail: Detail, share: float = 1e-4) -> Net:
    """The linear network whose squared distance from the fine cloths is least: one layer, solved.

    ``share`` of the mean square of the features is added to each one's. Least over the mirrored cloths as well.
    """
    grid, device = detail.frames.small, detail.frames.coarse.device
    net = Net(0, 0, grid.periodic).to(device)
    layer: Any = net.layers[0]
    square: Any = 0
    product: Any = 0
    for numbers in torch.split(detail.frames.starts(FRAMES - 1, 0)[::3], CHUNK):
        read, turn = detail.read(numbers)
        seen = layer.windows((read - detail.scale[0]) / detail.scale[1])
        seen = torch.cat([seen, torch.ones_like(seen[:, :1])], 1).transpose(1, 2).flatten(0, 1).double()
        gap = (detail.frames.fine[numbers] - detail.base(numbers)).unsqueeze(1)
        wanted = (detail.turns(turn) * gap).sum(2) / float(np.sqrt(grid.row_spacing * grid.col_spacing))
        cells = tiles(wanted, grid.periodic).flatten(2).transpose(1, 2).flatten(0, 1).double()
        square, product = square + seen.T @ seen, product + seen.T @ cells
    inputs, outputs = (sign.to(device).double() for sign in layer.signs)
    inputs = torch.cat([inputs.repeat_interleave(9), inputs.new_ones(1)])
    square, product = square * (1 + torch.outer(inputs, inputs)), product * (1 + torch.outer(inputs, outputs))
    square += share * square.diagonal().mean() * torch.eye(len(square), device=device, dtype=torch.float64)
    solved = torch.linalg.solve(square, product).T.float()
    with torch.no_grad():
        layer.weight.copy_(solved[:, :-1].view_as(layer.weight))
        layer.bias.copy_(solved[:, -1])
    return net


def tiles(fine: Tensor, periodic: bool) -> Tensor:
    """The tiles of which ``published.tiled`` makes ``fine`` ``(n, 3, H, W)``; what lies beyond it is its border."""
    if periodic:
        whole = functional.pad(fine.roll(1, 3), (0, 0, 1, 2), mode="replicate")
    else:
        whole = functional.pad(fine, (1, 2, 1, 2), mode="replicate")
    return functional.pixel_unshuffle(whole, SCALE)
