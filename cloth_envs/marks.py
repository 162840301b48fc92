"""What pictures show of a goal: marks, which tasks place and renderers draw."""

from dataclasses import dataclass

import numpy as np

CIRCLE = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)


@dataclass(frozen=True)
class Mark:
    """A shape of one of these kinds.

    ``"dot"``: a small ball, seen through everything. ``"ghost"``: a ball of ``radius`` [m], seen through
    everything and transparent.
    ``"line"``: through its points, seen through everything. ``"onlooker"``: a figure on the ground under the first
    point, who looks at the second.

    Attributes:
        kind: see above. points: ``(N, 3)`` [m], one of a dot or ghost.
        own: it shows what the cloth does, and is drawn in ink; others show what it should do, and turn green as it
            does. radius: of a ghost [m].
    """

    kind: str
    points: np.ndarray
    own: bool = False
    radius: float = 0.0


def dot(at: np.ndarray) -> Mark:
    """Where the cloth's measured point ``(3,)`` [m] is."""
    return Mark("dot", np.asarray(at, float)[None], own=True)


def ghost(at: np.ndarray, radius: float) -> Mark:
    """A ball of ``radius`` [m] around a wanted place ``(3,)`` [m]."""
    return Mark("ghost", np.asarray(at, float)[None], radius=radius)


def line(*points: np.ndarray | tuple[float, ...], own: bool = False) -> Mark:
    """A line through points ``(3,)`` [m]."""
    return Mark("line", np.array(points, float), own)


def ring(centre: np.ndarray, radius: float, *, own: bool = False) -> Mark:
    """A level circle of ``radius`` around ``centre`` ``(3,)`` [m]."""
    around = np.stack([np.cos(CIRCLE), np.sin(CIRCLE), np.zeros_like(CIRCLE)], 1)
    circle = centre + radius * np.append(around, around[:1], 0)
    return Mark("line", circle, own)
