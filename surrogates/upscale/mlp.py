"""Fully connected networks from the arrays of a checkpoint, in NumPy: inference needs no torch."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


class Mlp:
    """``U*FC-V``: hidden layers with ReLU and a linear output, float32.

    Args:
        arrays: ``weight0``, ``bias0``, ``weight1``, ... as torch has them, ``(out, in)`` and ``(out,)``; others
            are left alone.

    Raises:
        ValueError: no layers, or layers that do not fit together.
    """

    def __init__(self, arrays: Mapping[str, np.ndarray]) -> None:
        count = sum(name.startswith("weight") for name in arrays)
        names = [(f"weight{k}", f"bias{k}") for k in range(count)]
        if not count or any(name not in arrays for pair in names for name in pair):
            raise ValueError(f"a network needs weight0, bias0, weight1, ...; these arrays are {', '.join(arrays)}")
        self._layers = [(np.ascontiguousarray(arrays[w].T, np.float32), arrays[b].astype(np.float32)) for w, b in names]
        sizes = [self._layers[0][0].shape[0], *(w.shape[1] for w, _ in self._layers)]
        for (weight, bias), before in zip(self._layers, sizes, strict=False):
            if weight.shape[0] != before or bias.shape != (weight.shape[1],):
                raise ValueError(f"a layer of {weight.shape} with bias {bias.shape} cannot follow {before} numbers")
        self.inputs, self.outputs = sizes[0], sizes[-1]

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Outputs ``(N, outputs)`` of ``x`` ``(N, inputs)``."""
        last = len(self._layers) - 1
        for k, (weight, bias) in enumerate(self._layers):
            x = x @ weight
            x += bias
            if k < last:
                np.maximum(x, 0, out=x)
        return x
