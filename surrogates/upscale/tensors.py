"""Fine cloths at some of their vertices, in torch: interpolation and the local network for thousands of cloths at once.

Tensors have the batch last, so that a vertex of all cloths is one row: interpolation is a product of matrices, and what
a network sees of a coarse cell are numbers beside each other for all cloths. ``local_features`` is its twin in NumPy.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from scipy.sparse import csr_array, kron
from torch import Tensor
from torch.nn import functional

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.resample import weights
from surrogates.upscale.local import Local
from surrogates.upscale.local_features import LIMIT, NODES, PLACES, spacing
from surrogates.upscale.patches import squares

BLOCK = 256  # rows of a matrix that are multiplied at once, by the columns that they have in common
# From a patch's axes to the sum and the difference of the first two, along which the mean edges lie, and the third.
TURN = np.array([[0.5**0.5, 0.5**0.5, 0.0], [0.5**0.5, -(0.5**0.5), 0.0], [0.0, 0.0, 1.0]])


def interpolation(source: Grid, target: Grid, kind: str = "cubic") -> csr_array:
    """Weights of the vertices of ``source`` at those of ``target``, ``(H W, h w)``."""
    return csr_array(kron(*(csr_array(matrix) for matrix in weights(source, target, kind)), format="csr"))


class Product:
    """A sparse ``matrix`` ``(K, n)`` times fields ``(3, n, B)`` on ``device``: ``(3, K, B)``."""

    def __init__(self, matrix: csr_array, device: torch.device) -> None:
        self._parts: list[tuple[Tensor | None, Tensor]] = []
        for first in range(0, matrix.shape[0], BLOCK):
            part = csr_array(matrix[first : first + BLOCK])
            used = np.unique(part.indices)
            dense = torch.tensor(part[:, used].toarray(), dtype=torch.float32, device=device)
            every = len(used) == matrix.shape[1]
            self._parts.append((None if every else torch.tensor(used, dtype=torch.int64, device=device), dense))

    def __call__(self, field: Tensor) -> Tensor:
        parts = [dense @ (field if used is None else field.index_select(1, used)) for used, dense in self._parts]
        return parts[0] if len(parts) == 1 else torch.cat(parts, 1)


def nodes(upscaling: Local) -> csr_array:
    """Weights of what all cells say of their nodes in the fine cloth, ``(H W, cells 9)``; shared vertices average."""
    grid = upscaling.coarse.grid
    points = squares(*grid.shape, 2).points.ravel()
    last = interpolation(upscaling.half or upscaling.fine.grid, upscaling.fine.grid)
    shares = 1.0 / np.bincount(points)[points]
    return csr_array(last @ csr_array((shares, (points, np.arange(points.size))), (last.shape[1], points.size)))


def base(upscaling: Any) -> csr_array:
    """Weights of the coarse vertices in the fine cloth, without a network's part, ``(H W, h w)``."""
    coarse, fine = upscaling.coarse.grid, upscaling.fine.grid
    if not isinstance(upscaling, Local):
        return interpolation(coarse, fine, upscaling.kind)
    half = upscaling.half or fine
    return csr_array(interpolation(half, fine) @ interpolation(coarse, half))


class CellNet:
    """Residuals of ``upscaling`` where they are wanted: nodes by number, of ``cells * NODES``.

    Three things save passes over what is large. The mean of a patch is left out in the first layer's weights instead of
    being subtracted. Axes are the sum and the difference of a cell's edges, of which the network's are half-way turned:
    its first and last layer are turned as well. And as ``relu(u + b) = max(u, -b) + b``, a bias goes on into the next
    layer's (``layer_biases``).
    """

    def __init__(self, upscaling: Local, wanted: np.ndarray, device: torch.device) -> None:
        grid = upscaling.coarse.grid
        rows, cols = grid.shape
        self._shape, self._unit = grid.shape, spacing(grid)
        cells, where = np.unique(wanted // NODES, return_inverse=True)
        corner = np.add.outer(np.arange(rows - 1) * (cols + 2), np.arange(cols - 1)).ravel()[cells]
        places = PLACES // 4 * (cols + 2) + PLACES % 4
        indices = np.add.outer(places, corner).ravel(), where, wanted % NODES, wanted % NODES * len(cells) + where
        self._patches, self._cells, self._nodes, self._said = (torch.tensor(i, device=device) for i in indices)
        self._layers = [torch.tensor(w, dtype=torch.float32, device=device) for w in turned(upscaling)]
        self._border = [torch.tensor(_continued(n), dtype=torch.float32, device=device) for n in grid.shape]

    def __call__(self, x: Tensor, biases: Sequence[Tensor]) -> Tensor:
        """Residuals [m] in cloths ``x`` ``(3, h w, B)``, ``(3, wanted, B)``; ``biases`` ``(n, B)`` of each layer."""
        batch, (*hidden, last) = x.shape[-1], self._layers
        centred = (x - x.mean(1, keepdim=True)).view(3, *self._shape, batch)
        padded = self._border[1] @ (self._border[0] @ centred.flatten(2)).view(3, -1, self._shape[1], batch)
        p = padded.flatten(1, 2).index_select(1, self._patches).view(3, len(PLACES), -1, batch)
        one, other = p[:, 8] - p[:, 3], p[:, 4] - p[:, 7]  # diagonals of the cell
        edges = functional.normalize(torch.stack([one + other, one - other]), dim=1)
        axes = functional.normalize(torch.stack([edges[0] + edges[1], edges[0] - edges[1]]), dim=1)
        axes = torch.cat([axes, torch.linalg.cross(axes[1], axes[0], dim=0)[None]])  # (3 axes, 3, cells, B)
        y = axes[:, 0, None] * p[0]
        y.addcmul_(axes[:, 1, None], p[1]).addcmul_(axes[:, 2, None], p[2])
        for layer, bias in zip(hidden, biases, strict=False):
            y = (layer @ y.view(layer.shape[1], -1)).view(len(layer), -1, batch)
            y = torch.maximum(y, -bias[:, None], out=y)
        said = (last @ y.view(last.shape[1], -1)).view(3, -1, batch).index_select(1, self._said)
        said.add_(biases[-1].view(3, NODES, batch).index_select(1, self._nodes))
        # In units of the spacing said / sqrt(1 + |said|^2 / LIMIT^2).
        over = torch.linalg.vector_norm(said, dim=0).div_(LIMIT).square_().add_(1.0).rsqrt_().mul_(self._unit)
        axes = axes.index_select(2, self._cells)
        said.mul_(over)
        return (axes[0] * said[0]).addcmul_(axes[1], said[1]).addcmul_(axes[2], said[2])


def turned(upscaling: Local) -> list[np.ndarray]:
    """The layers' weights as ``CellNet`` has them."""
    first, *others = (np.asarray(weight, np.float64) for weight in upscaling.weights)
    inner = np.einsum("oap,ab->obp", first.reshape(len(first), 3, -1), TURN) / spacing(upscaling.coarse.grid)
    layers = [(inner - inner.mean(-1, keepdims=True)).reshape(first.shape), *others]
    return [*layers[:-1], turn_outputs(layers[-1])]


def turn_outputs(outputs: np.ndarray) -> np.ndarray:
    """Weights or biases ``(27, ...)`` of a network's outputs, for the turned axes of ``CellNet``."""
    return np.einsum("ab,bn...->an...", TURN, outputs.reshape(3, NODES, *outputs.shape[1:])).reshape(outputs.shape)


def layer_biases(
    upscaling: Local, materials: Sequence[Material], which: Sequence[int], device: torch.device
) -> list[Tensor]:
    """Biases of ``CellNet``, ``(n, B)`` of each layer; ``which`` says by number of which material each cloth is."""
    ends = np.cumsum([len(weight) for weight in upscaling.weights])
    layers = np.split(upscaling.biases(materials).T.astype(np.float64), ends[:-1])
    for k, weight in enumerate(upscaling.weights[1:]):
        layers[k + 1] = layers[k + 1] + weight @ layers[k]
    layers[-1] = turn_outputs(layers[-1])
    return [torch.tensor(layer[:, which], dtype=torch.float32, device=device) for layer in layers]


def _continued(count: int) -> np.ndarray:
    """Weights ``(count + 2, count)`` of samples and, at both ends, of the parabola that continues them."""
    whole = np.eye(count + 2, count, -1)
    whole[0, :3], whole[-1, -3:] = (3, -3, 1), (1, -3, 3)
    return whole
