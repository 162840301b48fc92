"""What tests of environments on a device step: backends with tensors outside, on the processor or a GPU."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

import cloth_envs
from cloth_envs.failure import Failures, find
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from cloth_envs.tensors import to_device, to_host

DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU"))]
N = 3  # members
SMALL = {"num_envs": N, "resolution": (13, 9), "randomize": {"areal_density": [0.15, 0.3]}}
THERE = {"backend": "on_tensors:Explicit"}
# The strain at which some members fail within a few frames, and others do not.
FRAIL = {
    "Curtain": 0.025, "Flag": 0.05, "Collision": 0.03, "Pressure": 0.03, "Hanging": 0.14, "BallDrop": 0.002,
    "Draping": 0.06, "Hitting": 0.0105, "Skirt": 0.019, "Pressure-v1": 0.06, "BallDrop-v1": 0.0007,
}  # fmt: skip
CLOSE = {"rtol": 1e-5, "atol": 1e-5}


def made(scene: str, **options: Any) -> Any:
    return gym.make_vec(cloth_envs.env_id(scene), **SMALL | options)


def frail(env: Any) -> Any:
    """``env``, whose members fail early."""
    env.world.failures = Failures(env.scene, FRAIL.get(type(env.world.task).__name__) or FRAIL[env.scene.name])
    return env


def assert_same(there: Any, here: Any) -> None:
    """Equal to rounding, tensors or arrays, whatever they are in."""
    there, here = to_host(there), to_host(here)
    if isinstance(here, dict):
        assert there.keys() == here.keys()
        for name, value in here.items():
            assert_same(there[name], value)
    elif isinstance(here, tuple) or (isinstance(here, np.ndarray) and here.dtype == object):
        for a, b in zip(there, here, strict=True):
            assert_same(a, b)
    elif isinstance(here, (np.ndarray, float)):
        assert np.asarray(there).dtype == np.asarray(here).dtype
        np.testing.assert_allclose(there, here, **CLOSE)
    else:
        assert there == here


def actions_of(env: Any, rng: np.random.Generator) -> np.ndarray:
    return rng.choice([-1.0, 1.0], env.action_space.shape).astype(np.float32)


class Explicit:
    """The explicit solver; states with their ``health``, unless ``told`` is false."""

    def __init__(self, scene: Scene, *, num_envs: int = 1, told: bool = True, device: str = "cpu") -> None:
        self.scene, self.solver, self.told = scene, ExplicitSolver(scene, num_envs=num_envs), told
        self.self_contact, self.device = True, torch.device(device)
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
            health = find(self.scene.grid, self.solver.state)
            self.state.health = torch.tensor(health, dtype=torch.float32, device=self.device)


class Still:
    """A cloth that stays where it is, whatever is done to it; in tensors only."""

    def __init__(self, scene: Scene, *, num_envs: int = 1, device: str = "cpu") -> None:
        self.scene, self.device = scene, torch.device(device)
        self.health = torch.tensor([[1.0, 0.0, 0.0]], device=device).repeat(num_envs, 1)  # finite, unstretched, at rest
        self.memory: dict[str, np.ndarray] = {}

    def reset(self, state: State, materials: Any = None, which: Any = None) -> None:
        there: dict[str, Any] = {name: torch.as_tensor(a, device=self.device) for name, a in state.arrays().items()}
        if which is not None:
            members = torch.tensor(which, device=self.device)
            there = {name: getattr(self.state, name).index_put((members,), a) for name, a in there.items()}
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
        self.state.health = self.health
