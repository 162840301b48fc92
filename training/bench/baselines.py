"""Participants that are measured for comparison only: no physics, the truth on a coarse grid, parts of a method."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cloth_envs.backend import Backend
from cloth_envs.material import Material
from cloth_envs.registry import make_backend
from cloth_envs.resample import resample, weights
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.miniature.coarse import CLOTH, CoarsePhysics, coarse_grid
from surrogates.miniature.upscaled import Upscaled
from surrogates.upscale.protocol import INTERPOLATIONS, Interpolation


def _moved(state: State, controls: Controls, cloth: Mapping[str, np.ndarray]) -> State:
    """``cloth`` with the bodies, wind and pressure of ``controls``."""
    driven = {name: getattr(controls, name) for name in ("colliders", "collider_velocities", "wind", "pressure")}
    return State(**{**state.arrays(), **driven, **cloth})


class Extrapolation:
    """No physics: the last known frame again, or on at its velocity with ``moving``."""

    def __init__(self, scene: Scene, *, num_envs: int = 1, moving: bool = False) -> None:
        self.scene, self._moving = scene, moving

    def reset(self, state: State, materials: Sequence[Material] | None = None) -> None:
        self.state = state.astype(np.float32)
        self.state.velocities *= self._moving

    def advance(self, controls: Controls) -> State:
        x = self.state.positions + np.float32(self.scene.frame_dt) * self.state.velocities
        self.state = _moved(self.state, controls, {"positions": x})
        return self.state


class Oracle:
    """The exact coarse cloth, bicubic: what interpolation alone loses. ``truth`` is that of every frame."""

    def __init__(self, scene: Scene, *, num_envs: int = 1, truth: Sequence[State] = (), factor: float = 2) -> None:
        self._truth, self._grids = truth, (scene.grid, coarse_grid(scene.grid, factor))
        self._up = weights(self._grids[1], scene.grid, INTERPOLATIONS["bicubic"])

    def reset(self, state: State, materials: Sequence[Material] | None = None) -> None:
        self._frame = 0

    def advance(self, controls: Controls) -> State:
        self._frame += 1
        now, (rows, cols) = self._truth[self._frame], self._up
        cloth = {name: rows @ resample(getattr(now, name), *self._grids) @ cols.T for name in CLOTH}
        return _moved(now, controls, cloth)


def fractional(
    scene: Scene, *, num_envs: int = 1, factor: float = 1.5, upscaler: str = "bicubic", scaling: str = "similar"
) -> Upscaled:
    """A miniature of any ``factor`` above 1, of a ``scaling`` that knows it."""
    coarse = CoarsePhysics(scene, num_envs=num_envs, factor=factor, scaling=scaling)
    return Upscaled(coarse, Interpolation(coarse.scene, scene, factor, kind=INTERPOLATIONS[upscaler]))


def changed(scene: Scene, *, num_envs: int = 1, **material: Any) -> Backend:
    """The reference with properties of its ``material`` changed."""
    return make_backend("reference", scene.with_material(scene.material.with_changes(**material)), num_envs=num_envs)
