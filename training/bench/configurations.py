"""Which solvers take part in `minicloth bench solvers`, and with which options.

One dictionary a benchmark: solver -> options. A solver that this installation lacks is left out; add one by a line.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cloth_envs.backend import Backend
from cloth_envs.physics.solver import SOLVERS
from cloth_envs.registry import make_backend
from cloth_envs.scene import Scene

Options = Mapping[str, Any]

# Accuracy per cost: each solver swept into a curve.
COST: dict[str, Sequence[Options]] = {
    "explicit": [{}, {"refine": 2}, {"refine": 4}],
    "admm": [
        *({"iterations": n} for n in (1, 3, 10, 30, 100)),
        *({"iterations": 10, "substeps": n} for n in (2, 4, 8, 16)),
    ],
    "implicit": [
        *({"scheme": "euler", "tolerance": t} for t in (10.0, 1.0, 0.1)),
        *({"scheme": "euler", "tolerance": 1.0, "substeps": n} for n in (4, 16)),
        *({"scheme": "sdirk2", "tolerance": 1.0, "substeps": n} for n in (1, 4, 16)),
    ],
}
# Convergence: every way in which a solver is refined, to the same limit.
CONVERGENCE: dict[str, Sequence[Options]] = {
    "explicit": [{"refine": n, "dtype": "float64"} for n in (1, 2, 4)],
    "admm": [
        {"iterations": i, "substeps": n, "dtype": "float64"}
        for n in (1, 4, 16, 64, 256)
        for i in (10, 30, 100, 300, 1000)
        if i * n <= 8000
    ],
    "implicit": [
        *(
            {"scheme": s, "tolerance": 1e-2, "substeps": n, "dtype": "float64"}
            for s in ("euler", "sdirk2")
            for n in (1, 2, 4, 8, 16, 32)
        ),
        *({"scheme": "sdirk2", "tolerance": t, "substeps": 4, "dtype": "float64"} for t in (100.0, 10.0, 1.0, 0.1)),
    ],
}
# The sweep over materials, frames and wind: each solver as it comes.
SWEEP: dict[str, Sequence[Options]] = {"explicit": [{}], "admm": [{}], "implicit": [{}]}


@dataclass(frozen=True)
class Config:
    """A solver and its options."""

    solver: str
    options: Options

    @property
    def text(self) -> str:
        """The options as JSON, for a row."""
        return json.dumps(dict(self.options))

    def build(self, scene: Scene) -> Backend:
        """One cloth on one thread.

        Raises:
            ValueError: the solver refuses the scene, its material or an option.
        """
        return make_backend("reference", scene, backend_kwargs={"solver": self.solver, **self.options})


def label(solver: str, options: str) -> str:
    """``admm iterations=10 substeps=2`` from a row's fields."""
    return " ".join([solver, *(f"{name}={value}" for name, value in json.loads(options).items())])


def choose(table: Mapping[str, Sequence[Options]], solvers: Sequence[str] | None, every: int = 1) -> list[Config]:
    """The configurations of ``table`` for ``solvers`` (default: all that are installed), or ``every`` n-th of each."""
    chosen = [name for name in table if name in SOLVERS and (solvers is None or name in solvers)]
    return [Config(name, options) for name in chosen for options in table[name][::every]]
