"""Model predictive path integral control (Williams et al. 2017): what a task's ceiling is, by trying futures.

Before every frame of an episode a model of it, the reference itself or a miniature, is set to the present state in many
members. Each plays another plan for some frames; the next plan is the mean of all, better ones counting more.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cloth_envs.policies import CONTROLLERS
from cloth_envs.world import World


@dataclass(frozen=True)
class Budget:
    """How a planner tries.

    Attributes:
        members: plans that are tried before every frame. horizon: frames of each.
        every: frames between the knots that plans are straight lines between. spread: deviation of the noise at knots.
        sharpness: differences of reward count in units of their deviation over this.
    """

    members: int = 24
    horizon: int = 24
    every: int = 4
    spread: float = 0.5
    sharpness: float = 4.0


@dataclass
class Planner:
    """A policy that sees whole states of one ``World``, of ``scene``.

    One of the plans is what the scene's controller does in the model, and one is the last plan without noise. Equal
    seeds give equal actions.

    Args:
        backend, options: the model.
    """

    scene: str
    backend: str = "miniature"
    options: Mapping[str, Any] = field(default_factory=lambda: {"factor": 4})
    budget: Budget = Budget()
    seed: int = 0

    def __post_init__(self) -> None:
        self.model = World(self.scene, num_envs=self.budget.members, backend=self.backend, backend_kwargs=self.options)
        self.rng = np.random.default_rng(self.seed)
        self.plan = np.zeros((self.budget.horizon, len(self.model.task.actions)))
        knots = np.arange(-(-self.budget.horizon // self.budget.every) + 1) * self.budget.every
        frames = np.arange(self.budget.horizon)[:, None]
        self.hats = np.maximum(1.0 - abs(frames - knots) / self.budget.every, 0.0)  # (frames, knots)

    def __call__(self, world: World) -> np.ndarray:
        """The action ``(1, A)`` for the present state of a ``world`` of one member."""
        self.model.set_state(repeated(world.get_state(), self.budget.members))
        plans, earned = self._tried()
        better = (earned - earned.max()) / max(float(earned.std()), 1e-9)
        weights = np.exp(self.budget.sharpness * better)
        chosen = np.tensordot(weights / weights.sum(), plans, 1)
        self.plan = np.append(chosen[1:], chosen[-1:], 0)
        return chosen[:1]

    def _tried(self) -> tuple[np.ndarray, np.ndarray]:
        """Plans ``(members, horizon, A)``, and the mean reward of each, where a failed one earns nothing more."""
        budget, model = self.budget, self.model
        noise = self.rng.normal(size=(budget.members, self.hats.shape[1], self.plan.shape[1]))
        plans = np.clip(self.plan + budget.spread * self.hats @ noise, -1.0, 1.0)
        plans[0] = self.plan
        earned, alive = np.zeros(budget.members), np.ones(budget.members)
        for t in range(budget.horizon):
            plans[1, t] = np.clip(CONTROLLERS[self.scene](model.observer(model.episode)[1]), -1.0, 1.0)
            rewards, reasons = model.advance(plans[:, t])
            alive[list(reasons)] = 0.0
            earned += rewards * alive / budget.horizon
        return plans, earned


def repeated(state: Mapping[str, np.ndarray], members: int) -> dict[str, np.ndarray]:
    """What ``World.get_state`` gave of one member, for so many of them."""
    whole = ("scene", "backend")
    return {name: value if name in whole else np.repeat(value, members, 0) for name, value in state.items()}
