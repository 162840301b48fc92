"""How published networks converged: rows of ``minicloth train mfsr-published``, drawn by ``bench super-resolution``."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

FEATURES = ("displacement", "normal", "velocity")
CONVERGENCE = "superres_convergence"  # stem of the rows' file


@dataclass(frozen=True)
class ConvergenceRow:
    """PSNR [dB] of a feature's normalised images of the sequences for testing after ``step`` of a training.

    ``seconds`` is the step's share of those that the training took, of the clock; ``weighed`` tells whether the feature
    is in its loss.
    """

    scene: str
    network: str
    feature: str
    step: int
    seconds: float
    psnr: float
    weighed: int


def convergence(scene: str, told: Mapping[str, Any]) -> list[ConvergenceRow]:
    """Rows of what ``training.superres.published.train`` tells of every network."""
    return [
        ConvergenceRow(scene, name, feature, int(step), round(step * one["seconds"] / one["steps"], 3), round(psnr, 2),
                       int(feature == "displacement" or one["recipe"]["weights"][feature] > 0))
        for name, one in told.items()
        for step, *values in one["curve"]
        for feature, psnr in zip(FEATURES, values, strict=False)
    ]  # fmt: skip
