"""The learner of ``examples/train_ppo.py``, as ``bench agents`` drives it."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import torch

from cloth_envs.evaluation import Policy

EXAMPLE = Path(__file__).parents[3] / "examples" / "train_ppo.py"


def example() -> Any:
    """The module of the example. Raises ValueError: it is not there, as outside of a checkout."""
    spec = spec_from_file_location("train_ppo", EXAMPLE)
    if not EXAMPLE.is_file() or spec is None or spec.loader is None:
        raise ValueError(f"{EXAMPLE} is missing: bench agents runs in a checkout")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Ppo:
    """A training, from physics to physics: ``begin`` one, ``go_on`` for a while, ``end`` it."""

    what = "policy of examples/train_ppo.py, 64 x 64"

    def __init__(self) -> None:
        self.ppo = example()
        self.agent: Any = None

    def begin(self, scene: str, backend: str, options: dict[str, Any], seed: int) -> None:
        self.players = self.ppo.Players(scene, backend, options, seed)
        if self.agent is None:
            self.agent = self.ppo.Agent(self.players.task, self.players.seen.shape[1])
            self.optimizer = torch.optim.Adam(self.agent.parameters(), eps=1e-5)

    def go_on(self, done: float) -> int:
        data = self.players.play(self.agent, done)
        self.players.learn(self.agent, self.optimizer, data, done)
        return len(data[0])

    def end(self) -> int:
        self.players.env.close()
        failed: int = self.players.failed
        return failed

    def weights(self) -> dict[str, torch.Tensor]:
        found: dict[str, torch.Tensor] = self.agent.weights()
        return found

    def policy(self) -> Policy:
        def act(seen: Any) -> Any:
            with torch.no_grad():
                return self.agent.actor(self.agent.scaled(seen)).numpy()

        return act
