"""Can K unrolled cells take one step R times the explicit one?

**A bound.** Around any state, K cells are a polynomial of degree K in the stiffness ``A``: positions obey
``x_{n+1} - 2 B(H^2 A) x_n + C x_{n-1} = 0``, and a step that is stable has ``|B| <= 1`` on the whole spectrum
``[0, 4 R^2]`` (the explicit step's is ``[0, 4]``). A step that is right for slow motion has ``B(0) = 1, B'(0) = -1/2``.
By Markov's inequality a polynomial bounded by 1 has ``|B'(0)| <= K^2 / (2 R^2)``: R is at most K, whatever is learned.
K explicit steps reach that. What K cells can do beyond is to soften: slow motion with the stiffness times ``(K/R)^2``.

**What softening costs** is measured: the explicit solver on a sheet whose springs are softer by ``(K/R)^2`` takes steps
``R/K`` as long. Errors are those of ``bench speed-accuracy``; times are of the processor.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import linprog

from cloth_envs.backend import Backend
from cloth_envs.physics.solver import reference
from cloth_envs.registry import make_backend
from cloth_envs.scene import Scene
from training.bench.measure import run, vertex_error
from training.truth import Case, load

SCENES = ("Hanging", "Flag", "Curtain")
SEEDS, START, HORIZON = (200, 201, 202), 25, 10
SOFTER = (4, 16)  # (R / K)^2
RATIOS, CELLS = (1.0, 2.0, 4.0, 8.0), (1, 2, 3, 4, 8)


@dataclass(frozen=True)
class GrowthRow:
    """The least growth of the worst mode in one step ``ratio`` times the explicit one by ``cells`` cells."""

    ratio: float
    cells: int
    growth: float


@dataclass(frozen=True)
class LargeStepRow:
    """A method on a scene: medians over seeds of errors [%] and of the time of a frame [ms]."""

    scene: str
    method: str
    ms: float
    error_1: float
    error_5: float
    error_10: float


def growth(ratio: float, cells: int) -> float:
    """``|mu|`` of the worst mode, least over all polynomials B that are right for slow motion (a linear programme).

    ``mu`` is the larger root of ``mu^2 - 2 B mu + 1`` for the least possible ``max |B|``: 1 where that is 1.
    """
    top = 4 * ratio**2
    at = np.cos(np.linspace(0, np.pi, 800))  # z = top (1 - at) / 2
    powers = np.polynomial.chebyshev.chebvander(at, cells)
    bound = np.concatenate([np.hstack([s * powers, -np.ones((len(at), 1))]) for s in (1, -1)])
    order = np.arange(cells + 1)  # T_n(1) = 1, T_n'(1) = n^2
    equal = np.array([[*order**0, 0], [*order**2 * (-2 / top), 0]])
    cost = np.arange(cells + 2) == cells + 1
    solved = linprog(cost, bound, np.zeros(len(bound)), equal, [1.0, -0.5], bounds=(None, None))
    largest = max(1.0, float(solved.fun))
    return largest + np.sqrt(max(0.0, largest**2 - 1 - 1e-9))


def methods(scene: Scene) -> dict[str, Backend]:
    """All that take part; softening is the explicit solver with springs so many times softer."""
    found = {"explicit": reference(scene)}
    for times in SOFTER:
        m = scene.material
        softer = {name: getattr(m, name) / times for name in ("stretch_stiffness", "shear_stiffness")}
        soft = scene.with_material(m.with_changes(**softer, damping=m.damping * times))
        found[f"steps x{np.sqrt(times):g} by softening"] = reference(soft)
    return found | {
        "P-ADMM, 10 iterations": reference(scene, solver="admm", iterations=10),
        "implicit": reference(scene, solver="implicit"),
        "miniature, calibrated 1/2": make_backend("miniature", scene, backend_kwargs={"scaling": "calibrated"}),
    }


def compare(scene: str, seeds: Sequence[int], cache: Path) -> list[LargeStepRow]:
    """Every method on ``scene``; truths are kept in ``cache``."""
    found: dict[str, list[list[float]]] = {}
    for seed in seeds:
        truth = load(Case(scene, seed, self_contact=False), START + HORIZON, range(START, START + HORIZON + 1), cache)
        start, controls = truth.states[START], truth.controls[START : START + HORIZON]
        for method, backend in methods(truth.scene).items():
            run(backend, truth.scene, start, controls[:2])  # warms up
            timed = run(backend, truth.scene, start, controls)
            off = [100 * vertex_error(truth.scene, timed.states[k], truth.states[START + k]) for k in (1, 5, HORIZON)]
            found.setdefault(method, []).append([timed.ms, *off])
    return [LargeStepRow(scene, method, *np.median(values, 0).tolist()) for method, values in found.items()]


def table(rows: Sequence[LargeStepRow], bound: Sequence[GrowthRow]) -> str:
    """The bound, and what softening costs."""
    cells, ratios = (list(dict.fromkeys(getattr(g, name) for g in bound)) for name in ("cells", "ratio"))
    lines = ["least growth of the worst mode a step", f"{'R':>4s}" + "".join(f"{f'K={k}':>9s}" for k in cells)]
    lines += [f"{x:4g}" + "".join(f"{g.growth:9.3g}" for g in bound if g.ratio == x) for x in ratios]
    lines.append(f"\n{'':40s}{'ms':>8s}" + "".join(f"{f'{k} frames':>10s}" for k in (1, 5, 10)))
    for r in rows:
        lines.append(f"{r.scene:8s} {r.method:31s}{r.ms:8.2f}{r.error_1:10.4f}{r.error_5:10.4f}{r.error_10:10.4f}")
    return "\n".join(lines)
