"""The explicit solver with tensors outside, as a backend on a device has them: what tests of such environments step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from cloth_envs.failure import find
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from cloth_envs.tensors import to_device, to_host

SMALL = ("wind", "pressure", "time")


class Explicit:
    """Of the device ``"cpu"``; states with their ``health``, unless ``told`` is false."""

    def __init__(self, scene: Scene, *, num_envs: int = 1, told: bool = True, **options: Any) -> None:
        self.scene, self.solver, self.told = scene, ExplicitSolver(scene, num_envs=num_envs, **options), told
        self.self_contact, self.device = True, torch.device("cpu")
        self.check_material = self.solver.check_material
        self.memory: dict[str, np.ndarray] = {}

    def reset(self, state: State, materials: Any = None, which: Sequence[int] | None = None) -> None:
        arrays = {name: to_host(value) for name, value in state.arrays().items()}
        if which is not None:
            self.solver.state.time[:] = to_host(self.state.time)
        self.solver.reset(State(**arrays), materials, which)
        self._keep()

    def advance(self, controls: Controls) -> State:
        for name, value in vars(controls).items():
            assert value.dtype == torch.float64, name
            assert value.is_contiguous(), name
        self.solver.state.time[:] = to_host(self.state.time)
        self.solver.advance(Controls(**{name: to_host(value) for name, value in vars(controls).items()}))
        self._keep()
        return self.state

    def _keep(self) -> None:
        there = {name: to_device(value, self.device) for name, value in self.solver.state.arrays().items()}
        self.state = State(**there)
        if self.told:
            self.state.health = torch.tensor(find(self.scene.grid, self.solver.state), dtype=torch.float32)


class Still:
    """A cloth that stays where it is, whatever is done to it; in tensors only."""

    def __init__(self, scene: Scene, *, num_envs: int = 1) -> None:
        self.scene, self.device = scene, torch.device("cpu")
        self.memory: dict[str, np.ndarray] = {}

    def reset(self, state: State, materials: Any = None, which: Any = None) -> None:
        there: dict[str, Any] = {name: torch.as_tensor(value).clone() for name, value in state.arrays().items()}
        if which is not None:
            there = {name: getattr(self.state, name).index_put((torch.tensor(which),), a) for name, a in there.items()}
        self._keep(State(**there))

    def advance(self, controls: Controls) -> State:
        old: Any = self.state
        wanted: Any = controls
        bodies = wanted.colliders.float(), wanted.collider_velocities.float()
        there: Any = old.positions, old.velocities, *bodies, wanted.wind, wanted.pressure, old.time.clone()
        self._keep(State(*there))
        return self.state

    def _keep(self, state: State) -> None:
        self.state = state
        self.state.health = torch.eye(3)[:1].expand(len(state.time), 3)  # finite, as long as at rest, and at rest
