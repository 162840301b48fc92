"""Three ways to the parameters of the cell: least squares, and what the paper does, differential evolution and Adam."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import process_time
from typing import NamedTuple

import numpy as np
import torch
from scipy.optimize import differential_evolution

from cloth_envs.physics.particles.solver import NEIGHBOURS, Cell, net_of
from surrogates.cell.stencil import BRANCHES, StencilCell
from training.cell.data import EPS, STEPS, Sums, case, design, links, samples
from training.cell.sheets import solve
from training.fit import Kept, Rate, cosine, fit, halved

COUNT = len(NEIGHBOURS)
SCHEDULES: dict[str, Callable[[float, int], Rate]] = {"step": halved, "cosine": cosine}
DATA = {"fall": ("fall",), "blow": ("blow",), "both": ("fall", "blow")}  # animations that a cell is fitted to
DECADES = 8.0  # of the scales that differential evolution looks through, 1e-1 to 1e7 per kg


@dataclass(frozen=True)
class Stage:
    """Adam on ``branches``, the others frozen, over ``epochs`` from ``rate`` by a schedule of ``SCHEDULES``."""

    rate: float
    epochs: int
    schedule: str
    branches: tuple[str, ...] = BRANCHES


@dataclass(frozen=True)
class Recipe:
    """How a cell is trained."""

    data: str = "both"  # one of DATA
    epochs: int = 2000  # of the first stage
    states: int = 2500  # of every animation
    vertices: int = 2048  # free particles drawn of each state
    physics: float = 0.5  # lambda of eq. 8, the weight of the physics loss
    batch: int = 256  # states
    published: bool = False  # alpha and beta themselves, 12 weights a branch, as the paper has it
    seed: int = 0

    @property
    def stages(self) -> list[Stage]:
        """The paper's: 1e-2 with step decay, then cosine annealing from 1e-3; then one branch, the others frozen."""
        return [
            Stage(1e-2, self.epochs, "step"),
            Stage(1e-3, max(1, self.epochs // 4), "cosine"),
            Stage(1e-3, max(1, self.epochs // 8), "cosine", ("derivative",)),
        ]


def as_cell(numbers: np.ndarray, mass: float = 1.0) -> Cell:
    """Parameters in the order of ``design`` [per kg] as a cell."""
    return Cell(mass * numbers[: 3 * COUNT].reshape(3, COUNT).T.copy(), mass * numbers[3 * COUNT :], EPS)


class Fit(NamedTuple):
    """``numbers`` in the order of ``design`` [per kg], and the seconds of the processor that it took."""

    numbers: np.ndarray
    seconds: float


def rows(
    names: Sequence[str], states: int, vertices: int, *, vector: bool = True, steps: int = STEPS
) -> tuple[np.ndarray, np.ndarray]:
    """Design ``(39, R)`` and accelerations ``(R,)`` on random free particles of states spread over animations."""
    rng, found = np.random.default_rng(1), []
    for name in names:
        given = case(name)
        chosen = np.linspace(steps // (2 * states), steps - 1, states).round().astype(int).tolist()
        for x, v, a, drawn in samples(given, steps, chosen, vertices, rng):
            found.append((design(x, v, links(*given.scene.grid.shape, drawn), vector=vector), a[:, drawn].ravel()))
    return np.concatenate([a for a, _ in found], 1), np.concatenate([b for _, b in found])


def least_squares(given: tuple[np.ndarray, np.ndarray]) -> Fit:
    """The closed form: columns scaled to one size, then a singular value decomposition."""
    start = process_time()
    return Fit(solve(*given), process_time() - start)


@dataclass(frozen=True)
class Loss:
    """Eq. 8 over states: ``lambda MSE(impulses) + (1 - lambda) MSE(positions and velocities after the step)``.

    Without contact the new velocity errs by ``decay h`` times the acceleration's error and the position by ``h`` times
    that: both are quadratic forms of it, of all particles and of those that move. States are the simulator's, the step
    from them is the law's on their velocities (see ``data.accelerations``). ``forms`` is ``(T, 40, 40)``.
    """

    forms: np.ndarray

    @classmethod
    def of(cls, sums: Sums, name: str, weight: float) -> "Loss":
        """``weight`` is lambda; in (m/s)^2 and m^2 summed as they are, over the step's own impulse size."""
        net, count = net_of(case(name).scene), case(name).scene.grid.vertices
        h, decay = net.sim_dt, np.exp(-net.drag * net.sim_dt)
        data = (1 - weight) * decay**2 * (1 + h**2)
        return cls(((weight + data) * sums.free + weight * sums.pinned) / (3 * count))

    def __call__(self, numbers: np.ndarray) -> float:
        """Mean over the states [m^2/s^4]; what rounding makes negative (1e-10 of no cell's) is 0."""
        full = np.append(numbers, -1.0)
        return max(0.0, float(full @ self.forms.mean(0) @ full))


def branch_scales(
    loss: Loss, lengths: torch.Tensor | None = None, seed: int = 0
) -> tuple[tuple[float, float, float, float], float]:
    """Scales and signs of the branches by differential evolution, each branch a single number; and the seconds.

    The bias is searched along z. A gene ``g`` in [-1, 1] stands for ``sign(g) 10^(8 |g| - 1)``.
    """
    start, form = process_time(), loss.forms.mean(0)
    spread = np.zeros((len(form), 5))
    for gene in range(4):
        probe = StencilCell(lengths=lengths, dtype=torch.float64)
        getattr(probe, BRANCHES[gene]).data[-1 if gene == 3 else slice(None)] = 1.0
        spread[:-1, gene] = numbers_of(probe).detach().numpy()
    spread[-1, 4] = -1.0
    small = spread.T @ form @ spread

    def value(genes: np.ndarray) -> np.ndarray:
        return np.concatenate([np.sign(genes) * 10 ** (DECADES * np.abs(genes) - 1), np.ones_like(genes[:1])])

    def logarithm(genes: np.ndarray) -> np.ndarray:
        values = value(genes)
        return np.log(((small @ values) * values).sum(0))

    options = {"tol": 1e-10, "maxiter": 1000, "popsize": 25, "updating": "deferred", "polish": False}
    best = differential_evolution(logarithm, [(-1.0, 1.0)] * 4, seed=seed, vectorized=True, **options)
    return tuple(value(best.x)[:4].tolist()), process_time() - start


def numbers_of(cell: StencilCell) -> torch.Tensor:
    """All parameters in the order of ``design``."""
    return torch.cat(cell.branches())


def train(
    cell: StencilCell, loss: Loss, stage: Stage, *, batch: int, seed: int = 0, kept: Kept | None = None
) -> tuple[float, float]:
    """Adam on batches of whole states, ``cell`` (of float64) changed in place; the loss after it and the seconds."""
    rng, upper = np.random.default_rng(seed), np.triu_indices(loss.forms.shape[1])
    flat = loss.forms[:, upper[0], upper[1]]
    for name, parameter in cell.named_parameters():
        parameter.requires_grad_(name in stage.branches)
    parts = len(flat) // batch
    epoch = torch.zeros((parts, *loss.forms.shape[1:]), dtype=torch.float64)

    def value(step: int) -> torch.Tensor:
        if step % parts == 0:
            pick = np.zeros((parts, len(flat)))
            order = rng.permutation(len(flat))[: parts * batch].reshape(parts, batch)
            np.put_along_axis(pick, order, 1.0 / batch, 1)
            epoch[:, upper[0], upper[1]] = torch.from_numpy(pick @ flat)
        form = epoch[step % parts]
        full = torch.cat([numbers_of(cell), -torch.ones(1, dtype=form.dtype)])
        # The lower triangle is left out: a form's value from its upper one.
        return 2 * full @ form @ full - (full * full * form.diagonal()).sum()

    rate = SCHEDULES[stage.schedule](stage.rate, stage.epochs)
    steps = stage.epochs * parts
    if kept is not None:  # only between epochs, whose batches are drawn at once
        kept = replace(kept, every=parts * -(-kept.every // parts))
    seconds = fit(
        cell,
        value,
        steps,
        lambda step: rate(step // parts),
        label=f"{stage.schedule} from {stage.rate:g}",
        kept=kept,
        rng=rng,
    )
    return loss(numbers_of(cell).detach().numpy()), seconds
