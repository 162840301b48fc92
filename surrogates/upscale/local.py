"""Learned upscalers that add detail to bicubic interpolation: ``"local"``, a small network, and ``"ridge"``, linear.

For every coarse cell they read the vertices around it in the cell's own axes (``local_features``) and answer with
the residual to bicubic interpolation at half the coarse spacing; where cells meet, their answers are averaged. Finer
vertices are bicubic again, from these. Inference is compiled. A flat sheet at rest gets no residual.
"""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
from _minicloth_kernels import PatchNet

from cloth_envs.material import Material
from cloth_envs.resample import Resampler
from cloth_envs.scene import Scene
from cloth_envs.state import State
from surrogates.checkpoint import of_factor
from surrogates.upscale.local_features import LIMIT, NODES, answer, features, flat_features, spacing, stiffness_numbers
from surrogates.upscale.patches import dense_grid, squares
from surrogates.upscale.protocol import Recipe, Upscaler, compiled

LAYERS = 4  # at most


class Local(Upscaler):
    """A network of patches, shipped per scene and factor.

    Args:
        coarse, fine: the scene on both grids.
        factor: 2, 3 or 4.
        arrays: weights to use instead of the shipped ones: ``weight0`` ``(out, 36)``, ``bias0``, ``weight1``, ... (the
            last layer has no bias: it follows from the flat sheet), and, if the material counts, ``material``
            ``(out, 2)``, ``material_low`` and ``material_high`` ``(2,)``.

    Attributes:
        weights: of all layers.

    Raises:
        ValueError: a tube, or a scene without weights; says how to train them.
    """

    method: ClassVar[str] = "local"

    def __init__(
        self, coarse: Scene, fine: Scene, factor: int, *, arrays: Mapping[str, np.ndarray] | None = None
    ) -> None:
        super().__init__(coarse, fine, factor)
        if fine.grid.periodic:
            raise ValueError(f'upscaler="{self.method}" has no tubes: use upscaler="bicubic"')
        if arrays is None:
            arrays = of_factor(weights_name(self.method, fine.name), factor)
        if not arrays:
            raise ValueError(
                f'upscaler="{self.method}" has no weights for {fine.name} at factor {factor}: use upscaler="bicubic", '
                f"or train it with `minicloth train local --scenes {fine.name} --factors {factor}`"
            )
        self._flat = flat_features(coarse.grid)
        self.weights = [arrays[f"weight{k}"] for k in range(LAYERS) if f"weight{k}" in arrays]
        self._offsets = [arrays[f"bias{k}"] for k in range(len(self.weights) - 1)]
        self._material = [arrays[n] for n in ("material", "material_low", "material_high") if n in arrays]
        self._net = PatchNet(spacing(coarse.grid), LIMIT, [np.ascontiguousarray(w, np.float32) for w in self.weights])
        self._bias = np.zeros((0, sum(len(w) for w in self.weights)), np.float32)
        double = dense_grid(fine.grid, coarse.grid, 2)
        self.half = None if double.shape == fine.grid.shape else double
        self._finer = Resampler(self.half, fine.grid).kernel if self.half else None

    def set_materials(self, which: Sequence[int], materials: Sequence[Material]) -> None:
        """Materials outside the range of training count as its nearest end."""
        more = max(0, max(which) + 1 - len(self._bias))
        self._bias = np.pad(self._bias, ((0, more), (0, 0)))
        self._bias[list(which)] = self.biases(materials)
        self.recipe = Recipe(self._net, self._bias, self._finer)

    def biases(self, materials: Sequence[Material]) -> np.ndarray:
        """Biases of all layers, one after the other, ``(B, n)``."""
        x, out = np.tile(self._flat, (len(materials), 1)), []
        for k, weight in enumerate(self.weights[:-1]):
            bias = np.tile(self._offsets[k].astype(np.float64), (len(materials), 1))
            if k == 0 and self._material:
                effect, low, high = self._material
                bias += np.clip(stiffness_numbers(self.coarse, materials), low, high) @ effect.T
            out.append(bias)
            x = np.maximum(x @ weight.T + bias, 0)
        return np.concatenate([*out, -(x @ self.weights[-1].T)], 1).astype(np.float32)

    @compiled
    def positions(self, history: Sequence[State]) -> np.ndarray:
        x = history[-1].positions
        out = np.empty((len(x), 3, *self.fine.grid.shape), np.float32)
        self._net.upscale(x, self._bias[: len(x)], self._finer, out)
        return out

    def seam(self, history: Sequence[State]) -> float:
        """Mean distance [m] of what cells say of a vertex that they share from the average of it."""
        x = history[-1].positions
        unit = spacing(self.coarse.grid)
        numbers, turn = features(x, unit)
        ends = np.cumsum([len(weight) for weight in self.weights])
        biases = np.split(self._bias[: len(x), None], ends[:-1], 2)
        for k, (weight, bias) in enumerate(zip(self.weights, biases, strict=True)):
            numbers = (np.maximum(numbers, 0) if k else numbers) @ weight.T + bias
        return squares(*self.coarse.grid.shape, 2).seam(answer(numbers, turn, unit).reshape(-1, 3 * NODES))


class Ridge(Local):
    """The same residual as a linear function of the same numbers."""

    method = "ridge"


def weights_name(method: str, scene: str) -> str:
    """The checkpoint of a scene."""
    return f"{method}_{scene.lower()}"
