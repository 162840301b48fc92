"""The upscaler ``"mfsr"``: bicubic interpolation and detail from a small network of convolutions, compiled.

It has what made multi-feature super-resolution (Chen et al. 2020) work, displacements, normals and velocities as images
and pairs of a coarse cloth and a fine one that follows it, in a form that pays on a processor: the convolutions run at
coarse resolution, see the cloth in every vertex's own axes (``features``) and tell the residual to interpolation, 4 x 4
fine vertices at a time. The published network takes twice as long as the fine cloth that it is to save.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from _minicloth_kernels import DetailNet

from cloth_envs.grid import Grid
from cloth_envs.resample import Resampler
from cloth_envs.scene import Scene
from cloth_envs.state import State
from surrogates.checkpoint import WEIGHTS, Checkpoint, load
from surrogates.superres.features import FRAMES, LIMIT, REACH, SCALE, Bodies, features, residual, spacing
from surrogates.upscale.protocol import Upscaler

OWN = "_own"  # after the names of what was made on an environment's own grid


class SuperResolution(Upscaler):
    """A network of 3 x 3 convolutions, shipped per scene.

    Args:
        coarse, fine: the scene on both grids, the fine one with exactly four times as many cells along each side.
        factor: 4.
        arrays: weights to use instead of the shipped ones: ``mean`` and ``width`` of the features ``(CHANNELS,)``,
            and of layer k ``weight<k>`` ``(out, in, 3, 3)`` and ``bias<k>`` ``(out,)``; the last has 48 outputs.

    Raises:
        ValueError: other grids, or a scene without weights; says how to train them.
    """

    frames = FRAMES
    torn = 1.0  # in pleats interpolation strains hundreds of edges by 0.3, the network some of these by 0.5

    def __init__(
        self, coarse: Scene, fine: Scene, factor: float, *, arrays: Mapping[str, np.ndarray] | None = None
    ) -> None:
        super().__init__(coarse, fine, factor)
        if not divides(coarse.grid, fine.grid):
            raise ValueError(
                f'upscaler="mfsr" needs {SCALE} fine cells along each side of a coarse one, got {fine.grid} from '
                f'{coarse.grid}: ask for another resolution, or use upscaler="bicubic"'
            )
        if arrays is None and (found := shipped(fine.name, coarse.grid)):
            arrays = found.of_factor(SCALE)
        if not arrays:
            raise ValueError(
                f'upscaler="mfsr" has no weights for {fine.name}: use upscaler="bicubic", or train it with '
                f"`minicloth train mfsr --scenes {fine.name}`"
            )
        self.mean, self.width = (arrays[name].astype(np.float32) for name in ("mean", "width"))
        count = sum(name.startswith("weight") for name in arrays)
        self.layers = [(arrays[f"weight{k}"], arrays[f"bias{k}"]) for k in range(count)]
        self.held = np.zeros(coarse.grid.shape, np.float32)
        self.held.flat[list(coarse.handles)] = 1
        self.radii = np.array([body.radius + coarse.thickness for body in coarse.colliders], np.float32)
        self.planes = [body.kind == "plane" for body in coarse.colliders]
        self.linear = Resampler(coarse.grid, fine.grid, "linear")
        self._net = DetailNet(
            *coarse.grid.shape, coarse.grid.periodic, spacing(coarse.grid), LIMIT, REACH, self.mean, 1 / self.width,
            self.held, self.radii, self.planes,
            [np.ascontiguousarray(weight.reshape(len(weight), -1), np.float32) for weight, _ in self.layers],
            [np.ascontiguousarray(bias, np.float32) for _, bias in self.layers], self.linear.kernel,
        )  # fmt: skip

    def positions(self, history: Sequence[State]) -> np.ndarray:
        earlier, before, now = (np.ascontiguousarray(state.positions, np.float32) for state in history)
        after, start = self.bodies(history)[:2]
        out = self.bicubic(now)
        self._net.add(now, before, earlier, after, start, out, self.threads)
        return out

    def bodies(self, history: Sequence[State]) -> Bodies:
        """At the last two frames."""
        now, before = (np.ascontiguousarray(history[k].colliders, np.float32) for k in (-1, -2))
        return Bodies(now, before, self.radii[None], self.planes)

    def twin(self, history: Sequence[State]) -> np.ndarray:
        """``positions`` in NumPy."""
        past, grid = [state.positions.astype(np.float32) for state in history], self.coarse.grid
        x, turn = features(past, self.bodies(history), self.held, grid)
        x = (x - self.mean[:, None, None]) / self.width[:, None, None]
        for k, (weight, bias) in enumerate(self.layers):
            x = convolved(np.maximum(x, 0) if k else x, weight, grid.periodic) + bias[:, None, None]
        said = untiled(x, grid.periodic)
        turns = self.linear(np.ascontiguousarray(turn.reshape(-1, 9, *grid.shape), np.float32))
        return self.bicubic(past[-1]) + residual(said, turns.reshape(-1, 3, 3, *said.shape[2:]), grid)


def weights_name(scene: str, own: bool = False) -> str:
    """The checkpoint of a scene on the grid of Chen et al. 2020 if that has one for it, or on its ``own``."""
    return f"mfsr_{scene.lower()}{OWN * own}"


def shipped(scene: str, coarse: Grid) -> Checkpoint | None:
    """What is shipped for a scene and was trained on the cells most like those of ``coarse``; None if nothing is."""
    names = [weights_name(scene, own) for own in (False, True)]
    found = [load(name) for name in names if (WEIGHTS / f"{name}.safetensors").is_file()]
    return min(found, key=lambda one: abs(np.log(spacing(coarse) / fitted_on(one)["spacing"])), default=None)


def fitted_on(weights: Checkpoint) -> dict[str, Any]:
    """The spacing [m] of the coarse cloth that weights were trained on, its ``scaling``, and the fine one's material.

    And whether cloths kept out of themselves.
    """
    told: dict[str, Any] = weights.card["factors"][str(SCALE)]["fitted on"]
    return {"scaling": "similar", "self_contact": True} | told  # as all were before cards told of it


def divides(coarse: Grid, fine: Grid) -> bool:
    """Whether a cell of ``coarse`` is ``SCALE`` cells of ``fine`` along each side."""
    return all(SCALE * few == many for few, many in zip(coarse.cells, fine.cells, strict=True))


def convolved(x: np.ndarray, weight: np.ndarray, periodic: bool) -> np.ndarray:
    """``x`` ``(B, in, h, w)`` under ``weight`` ``(out, in, 3, 3)``: 0 beyond borders, a tube goes on at its seam."""
    x = np.pad(x, ((0, 0), (0, 0), (1, 1), (0, 0)))
    x = np.pad(x, ((0, 0), (0, 0), (0, 0), (1, 1)), mode="wrap" if periodic else "constant")
    around = np.lib.stride_tricks.sliding_window_view(x, (3, 3), (-2, -1))
    return np.einsum("bihwrc,oirc->bohw", around, weight, optimize=True)


def untiled(x: np.ndarray, periodic: bool) -> np.ndarray:
    """Fine vertices ``(B, 3, H, W)`` of what ``SCALE x SCALE`` around every coarse one are told, ``(B, 48, h, w)``."""
    batch, _, rows, cols = x.shape
    tiles = x.reshape(batch, 3, SCALE, SCALE, rows, cols).transpose(0, 1, 4, 2, 5, 3)
    fine = tiles.reshape(batch, 3, SCALE * rows, SCALE * cols)[:, :, 1 : SCALE * (rows - 1) + 2]
    return np.roll(fine, -1, 3) if periodic else fine[..., 1 : SCALE * (cols - 1) + 2]
