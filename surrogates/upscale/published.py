"""Upscalers as published: ``"fc"`` after Lee, Oh & Lee 2019 and ``"hdnn"``, like Oh, Lee & Lee 2018; no torch."""

from collections.abc import Mapping, Sequence

import numpy as np

from cloth_envs.presets import load_preset
from cloth_envs.resample import Resampler
from cloth_envs.scene import Scene
from cloth_envs.state import State
from surrogates.checkpoint import WEIGHTS, Checkpoint, load
from surrogates.upscale.patches import FEATURES, combine, dense_grid, squares, triangles
from surrogates.upscale.protocol import Upscaler


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
        before = len(self._layers[0][0])
        for weight, bias in self._layers:
            if weight.shape[0] != before or bias.shape != (weight.shape[1],):
                raise ValueError(f"a layer of {weight.shape} with bias {bias.shape} cannot follow {before} numbers")
            before = len(bias)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Outputs ``(N, outputs)`` of ``x`` ``(N, inputs)``."""
        for k, (weight, bias) in enumerate(self._layers):
            x = (np.maximum(x, 0, out=x) if k else x) @ weight
            x += bias
        return x


def find(kind: str, scene: Scene, factor: int) -> Checkpoint:
    """The shipped weights of ``kind`` for a scene; coordinates are absolute, so it must be the one they learnt.

    Raises:
        ValueError: there are none, or they are of another grid, other handles or other springs.
    """
    name = f"{kind}_{scene.name.lower()}_{factor}"
    if not (WEIGHTS / f"{name}.safetensors").is_file():
        there = ", ".join(path.stem for path in sorted(WEIGHTS.glob(f"{kind}_*_*.safetensors")))
        raise ValueError(
            f"upscaler={kind!r} has no weights for {scene.name} at factor {factor}; there are {there}. Train them "
            f'with `minicloth train upscaler --recipe {name.replace("_", "-")}`, or use upscaler="bicubic"'
        )
    found = load(name)
    recipe = found.card["recipe"]
    task = load_preset(recipe["scene"], recipe["preset"])
    known = task.make_scene(resolution=task.resolution, material=task.material)
    low, high = found.card["valid"]["spring constant [N/m]"]
    spring = scene.material.stretch_stiffness
    if (known.grid, known.handles) != (scene.grid, scene.handles) or not 0.99 * low <= spring <= 1.01 * high:
        raise ValueError(
            f"the weights {recipe['name']} know {recipe['scene']} with preset={recipe['preset']!r} only, at its own "
            f"resolution and springs of {low} to {high} N/m: their coordinates are absolute. Use that preset, "
            'or upscaler="bicubic"'
        )
    return found


class FullyConnected(Upscaler):
    """``U*FC-V`` on 2 x 2 patches in absolute coordinates, one network per scene and factor.

    Args:
        coarse, fine, factor: the scenes. weights: others than the shipped ones.

    Raises:
        ValueError: no weights for this scene and factor; says which there are.
    """

    def __init__(self, coarse: Scene, fine: Scene, factor: int, *, weights: Checkpoint | None = None) -> None:
        super().__init__(coarse, fine, factor)
        found = weights or find("fc", fine, factor)
        self._kind = found.card["recipe"]["features"]
        self.frames = FEATURES[self._kind][0]
        self._net, self._layout = Mlp(found.arrays), squares(*coarse.grid.shape, factor)
        self._dense = dense_grid(fine.grid, coarse.grid, factor)
        self._onto = None if self._dense.shape == fine.grid.shape else Resampler(self._dense, fine.grid)

    def patches(self, history: Sequence[State]) -> np.ndarray:
        """What the network says of every patch, ``(B P, 3 (factor+1)^2)`` [m], before neighbours are averaged."""
        past = [self._layout.cut(state.positions) for state in history[-self.frames :]]
        return self._net(combine(past, self._kind, self.fine.frame_dt))

    def seam(self, history: Sequence[State]) -> float:
        """Mean distance [m] of neighbouring patches from their average, at the vertices that they share."""
        return self._layout.seam(self.patches(history))

    def positions(self, history: Sequence[State]) -> np.ndarray:
        dense = self._layout.merge(self.patches(history)).reshape(-1, 3, *self._dense.shape)
        return dense if self._onto is None else self._onto(dense)


class HierarchicalDnn(Upscaler):
    """Like H-DNN: every triangle's network gives the midpoints of its edges, level by level; one frame.

    Coarse vertices stay where they are, an edge's two midpoints are averaged. The paper runs it on a coarse cloth
    that is not scaled: on this package's miniature that is ``scaling="calibrated", factors={"areal_density":
    1 / factor**2}``, particles of the fine cloth's mass that are farther apart.

    Args:
        coarse, fine, factor: the scenes; ``factor`` 2 or 4. weights: of each level, the coarsest first.

    Raises:
        ValueError: another factor, a grid that it does not divide, or no weights for this scene.
    """

    def __init__(self, coarse: Scene, fine: Scene, factor: int, *, weights: Sequence[Checkpoint] | None = None) -> None:
        super().__init__(coarse, fine, factor)
        whole = tuple(factor * cells for cells in coarse.grid.cells) == fine.grid.cells
        if factor not in (2, 4) or not whole:
            raise ValueError(f'upscaler="hdnn" halves edges: use factor 2 or 4 that divides the grid, got {factor}')
        levels = [level for level in (4, 2) if level <= factor]
        found = weights or [find("hdnn", fine, level) for level in levels]
        self._nets = [Mlp(each.arrays) for each in found]
        shapes = [tuple(cells // level + 1 for cells in fine.grid.cells) for level in levels]
        self._layouts = [triangles(*shape) for shape in shapes]

    def positions(self, history: Sequence[State]) -> np.ndarray:
        field = history[-1].positions
        for net, layout in zip(self._nets, self._layouts, strict=True):
            rows, cols = field.shape[2:]
            finer = layout.merge(net(layout.cut(field))).reshape(len(field), 3, 2 * rows - 1, 2 * cols - 1)
            finer[:, :, ::2, ::2] = field
            field = finer
        return field
