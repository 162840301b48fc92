"""One look for all charts: colours, markers, axes."""

from typing import Any

import numpy as np

from cloth_envs.extras import install

# Okabe & Ito (2008), distinct for every kind of colour vision; black and yellow are left out.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
MARKERS = ("o", "s", "D", "^", "v", "P")
INK, GRID = "#2b3640", "#dfe4e8"


def import_figure() -> Any:
    """Matplotlib's ``Figure``, drawing to files only. Raises ImportError: missing; says what to install."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError(f"charts need Matplotlib ({error}): {install('render')}") from error
    return Figure


def spread(places: np.ndarray, gap: float) -> np.ndarray:
    """``places`` moved apart to at least ``gap``, each as little as pushing neighbours allows."""
    order = np.argsort(places)
    moved = places[order].astype(float)
    for _ in range(200):
        short = gap - np.diff(moved)
        if (short <= 1e-6).all():
            break
        push = np.maximum(short, 0) / 2
        moved[1:] += push
        moved[:-1] -= push
    result = np.empty_like(moved)
    result[order] = moved
    return result


def limits(low: float, high: float, room: float = 0.12) -> tuple[float, float]:
    """Ends of a logarithmic axis: at least one decade, with ``room`` of its length at either end."""
    a, b = np.log10(low), np.log10(high)
    extra = max(0.0, 1 - (b - a)) / 2
    a, b = a - extra, b + extra
    return 10 ** (a - room * (b - a)), 10 ** (b + room * (b - a))
