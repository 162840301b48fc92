"""How the local upscalers are trained."""

from __future__ import annotations

from dataclasses import dataclass

FACTORS = (2, 3, 4)
FIRST_SEED, HELD_OUT = 1000, (200, 201, 202, 203, 204)


@dataclass(frozen=True)
class Recipe:
    """How a pair of upscalers is trained.

    Attributes:
        seeds: of episodes with the scene's own material, and of as many or fewer with a random one.
        hidden: units of the network's one hidden layer at factors 2, 3 and 4; small ones for speed.
        patches: of all windows and frames, drawn at random.
        steps, batch, rate: of Adam; the rate falls along half a cosine.
        ridge: of the regression's diagonal.
        scaling: of the miniature.
    """

    seeds: tuple[int, int] = (24, 16)
    hidden: tuple[int, int, int] = (18, 18, 18)
    patches: int = 400_000
    steps: int = 3000
    batch: int = 4096
    rate: float = 3e-3
    ridge: float = 1e-5
    seed: int = 0
    scaling: str = "calibrated"
