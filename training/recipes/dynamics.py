"""How the correction of the coarse dynamics is trained."""

from __future__ import annotations

from dataclasses import dataclass

FIRST_SEED, HELD_OUT = 1000, (200, 201, 202, 203, 204)
POLICIES = ("smooth", "random", "smooth", "bang-bang")  # of training; the first is scored


@dataclass(frozen=True)
class Recipe:
    """How a correction is trained.

    Attributes:
        seeds: of episodes.
        hidden: units of both hidden layers.
        warm: steps on single frames; steps: on whole windows of ``horizon`` frames, ``batch`` of them at a time.
        rate: of Adam on single frames, half of it on windows; it falls along half a cosine.
        memory: what share of a gradient reaches the frame before. 1 diverges where frames are long and wind drives.
        velocities: weight of their errors beside those of positions.
        scaling: of the miniature.
    """

    seeds: int = 64
    hidden: int = 48
    warm: int = 600
    steps: int = 400
    horizon: int = 10
    batch: int = 12
    rate: float = 3e-3
    memory: float = 1.0
    velocities: float = 0.3
    seed: int = 0
    scaling: str = "closure"
