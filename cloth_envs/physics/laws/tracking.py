"""What pulls a cloth along with a coarser one, the twin of the kernel's ``Tracking``; forces are in newtons."""

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.physics.laws.sheet import Forces, Materials, bend_forces, damper_forces, masses, spring_forces
from cloth_envs.resample import means, weights


def mean_forces(
    fine: Grid, coarse: Grid, materials: Materials, x: np.ndarray, v: np.ndarray,
    aim: tuple[np.ndarray, np.ndarray], rate: float, damping: float,
) -> Forces:  # fmt: skip
    """``m U (w^2 (q - W x) + 2 z w (q' - W v))`` of ``aim`` ``(q, q')`` ``(B, 3, h, w)``, ``w`` being the ``rate``."""
    rows, columns = means(fine, coarse)
    at, speed = (np.einsum("rh,...hw,cw->...rc", rows, field, columns) for field in (x, v))
    pull = rate**2 * (aim[0] - at) + 2 * damping * rate * (aim[1] - speed)
    rows, columns = weights(coarse, fine, "linear")
    return masses(fine, materials) * np.einsum("rh,...hw,cw->...rc", rows, pull, columns)


def shared_forces(
    fine: Grid, coarse: Grid, materials: Materials, x: np.ndarray, v: np.ndarray,
    aim: tuple[np.ndarray, np.ndarray], rate: float, damping: float, levels: float,
) -> Forces:  # fmt: skip
    """``m (w^2 (q - x) + 2 z w (q' - v))`` at shared vertices, and ``levels`` times a coarse sheet between them."""
    shared = np.s_[..., :: fine.cells[0] // coarse.cells[0], :: fine.cells[1] // coarse.cells[1]]
    at, speed, out = x[shared], v[shared], np.zeros(x.shape)
    pull = rate**2 * (aim[0] - at) + 2 * damping * rate * (aim[1] - speed)
    sheet = spring_forces(coarse, materials, at) + damper_forces(coarse, materials, at, speed)
    out[shared] = masses(fine, materials)[shared] * pull + levels * (sheet + bend_forces(coarse, materials, at))
    return out
