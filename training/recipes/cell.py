"""How the cell of Zhao 2024 is trained on nets of particles."""

from __future__ import annotations

from dataclasses import dataclass

from surrogates.cell.stencil import BRANCHES

DATA = {"fall": ("fall",), "blow": ("blow",), "both": ("fall", "blow")}  # animations that a cell is fitted to


@dataclass(frozen=True)
class Stage:
    """A stretch of training: Adam from ``rate``, over ``epochs``, by ``schedule`` (``"step"`` or ``"cosine"``).

    ``branches`` are trained, the others stay frozen.
    """

    rate: float
    epochs: int
    schedule: str
    branches: tuple[str, ...] = BRANCHES


@dataclass(frozen=True)
class Recipe:
    """How a cell is trained.

    Attributes:
        data: one of ``DATA``.
        epochs: of the first stage.
        states: of every animation. vertices: free particles drawn of each.
        physics: lambda of eq. 8, the weight of the physics loss.
        batch: states.
    """

    data: str = "both"
    epochs: int = 2000
    states: int = 2500
    vertices: int = 2048
    physics: float = 0.5
    batch: int = 256
    seed: int = 0

    @property
    def stages(self) -> list[Stage]:
        """The paper's: 1e-2 with step decay, then cosine annealing from 1e-3; then one branch, the others frozen."""
        return [
            Stage(1e-2, self.epochs, "step"),
            Stage(1e-3, max(1, self.epochs // 4), "cosine"),
            Stage(1e-3, max(1, self.epochs // 8), "cosine", ("derivative",)),
        ]
