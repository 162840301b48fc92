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
    return Mark("line", centre + radius * _around(0, 1), own)


def globe(centre: np.ndarray, radius: float) -> list[Mark]:
    """Where a ball of ``radius`` around ``centre`` ``(3,)`` [m] is that the cloth may hide: three circles on it."""
    return [Mark("line", centre + radius * _around(*axes), own=True) for axes in ((0, 1), (1, 2), (0, 2))]


def _around(first: int, second: int) -> np.ndarray:
    """A closed circle of radius 1 in the plane of two axes, ``(N, 3)``."""
    circle = np.zeros((len(CIRCLE) + 1, 3))
    circle[:-1, first], circle[:-1, second] = np.cos(CIRCLE), np.sin(CIRCLE)
    circle[-1] = circle[0]
    return circle
