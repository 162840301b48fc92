"""From the coarse cloth to the fine one: what an upscaler is, and interpolation."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Any, Protocol

import numpy as np

from cloth_envs.material import Material
from cloth_envs.naming import unknown_name
from cloth_envs.resample import Resampler
from cloth_envs.scene import Scene
from cloth_envs.state import State

INTERPOLATIONS = {"bilinear": "linear", "biquadratic": "quadratic", "bicubic": "cubic"}
# name -> "module:class", resolved on use; built as ``Class(coarse scene, fine scene, factor)``.
LEARNED: dict[str, str] = {
    "fc": "surrogates.upscale.published:FullyConnected",
    "hdnn": "surrogates.upscale.published:HierarchicalDnn",
    "local": "surrogates.upscale.local:Local",
    "ridge": "surrogates.upscale.local:Ridge",
}


class Upscaler(Protocol):
    """Fine fields ``(B, 3, H, W)`` float32 from ``history``: the last ``frames`` coarse states, the newest last."""

    frames: int

    def set_materials(self, which: Sequence[int], materials: Sequence[Material]) -> None:
        """Members ``which`` of the batch are of these (fine) materials from now on."""
        ...

    def positions(self, history: Sequence[State]) -> np.ndarray:
        """Positions [m] at the newest state."""
        ...

    def velocities(self, history: Sequence[State]) -> np.ndarray:
        """Velocities [m/s] at the newest state."""
        ...


class Interpolation:
    """Separable interpolation; learned upscalers take their velocities from the bicubic one."""

    frames = 1

    def __init__(self, coarse: Scene, fine: Scene, factor: int, *, kind: str = "cubic") -> None:
        self._resample = Resampler(coarse.grid, fine.grid, kind)

    def set_materials(self, which: Sequence[int], materials: Sequence[Material]) -> None:
        """Interpolation is the same for every material."""

    def positions(self, history: Sequence[State]) -> np.ndarray:
        return self._resample(history[-1].positions)

    def velocities(self, history: Sequence[State]) -> np.ndarray:
        return self._resample(history[-1].velocities)


def make_upscaler(name: str, coarse: Scene, fine: Scene, factor: int) -> Upscaler:
    """The upscaler ``name`` of a pair of scenes.

    Raises:
        ValueError: an unknown name (the nearest match is named), or one that has no weights for this scene.
    """
    if name in INTERPOLATIONS:
        return Interpolation(coarse, fine, factor, kind=INTERPOLATIONS[name])
    if name not in LEARNED:
        raise unknown_name("upscaler", name, (*INTERPOLATIONS, *LEARNED))
    module, attribute = LEARNED[name].split(":")
    learned: Any = getattr(import_module(module), attribute)
    return learned(coarse, fine, factor)
