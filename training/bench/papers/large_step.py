"""``python -m training.bench.papers.large_step``: can K unrolled cells take one step R times the explicit one?

**A bound.** Around any state, K cells are a polynomial of degree K in the stiffness ``A``: positions obey
``x_{n+1} - 2 B(H^2 A) x_n + C x_{n-1} = 0``, and a step that is stable has ``|B| <= 1`` on the whole spectrum
``[0, 4 R^2]`` (the explicit step's is ``[0, 4]``). A step that is right for slow motion has ``B(0) = 1, B'(0) = -1/2``.
By Markov's inequality a polynomial bounded by 1 has ``|B'(0)| <= K^2 / (2 R^2)``: R is at most K, whatever is learned.
K explicit steps reach that. What K cells can do beyond is to soften: slow motion with the stiffness times ``(K/R)^2``.

**What softening costs** is measured here: the explicit solver on a sheet whose springs are softer by ``(K/R)^2`` takes
steps ``R/K`` as long. Errors are those of ``bench speed-accuracy``: mean distance from truth in % of the cloth's
length after restarts from truth on held-out seeds; times are of the processor.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linprog

from cloth_envs.backend import Backend
from cloth_envs.machine import header
from cloth_envs.physics.solver import reference
from cloth_envs.registry import make_backend
from cloth_envs.scene import Scene
from training.bench.throughput.run import write_rows
from training.bench.truth import Case, cache_folder, load, replay, vertex_error
from training.rows import read_names

SCENES = ("Hanging", "Flag", "Curtain")
SEEDS, START, HORIZON = (200, 201, 202), 25, 10
SOFTER = (4, 16)  # (R / K)^2


@dataclass(frozen=True)
class Growth:
    """The least growth of the worst mode in one step ``ratio`` times the explicit one by ``cells`` cells."""

    ratio: float
    cells: int
    growth: float


@dataclass(frozen=True)
class Row:
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
    ends = np.polynomial.chebyshev.chebvander([1.0], cells)[0]
    slopes = np.arange(cells + 1) ** 2 * (-2 / top)  # T_n'(1) = n^2
    bound = np.concatenate([np.hstack([s * powers, -np.ones((len(at), 1))]) for s in (1, -1)])
    equal = np.array([[*ends, 0.0], [*slopes, 0.0]])
    cost = np.zeros(cells + 2)
    cost[-1] = 1.0
    solved = linprog(cost, bound, np.zeros(len(bound)), equal, [1.0, -0.5], bounds=(None, None))
    largest = max(1.0, float(solved.fun))
    return largest + np.sqrt(max(0.0, largest**2 - 1 - 1e-9))


def soft(scene: Scene, times: float) -> Backend:
    """The explicit solver with springs ``times`` softer."""
    m = scene.material
    changed = m.with_changes(
        stretch_stiffness=m.stretch_stiffness / times,
        shear_stiffness=m.shear_stiffness / times,
        damping=m.damping * times,
    )
    return reference(scene.with_material(changed))


def methods(scene: Scene) -> dict[str, Backend]:
    """All that take part."""
    return {
        "explicit": reference(scene),
        **{f"steps x{np.sqrt(s):g} by softening": soft(scene, s) for s in SOFTER},
        "P-ADMM, 10 iterations": reference(scene, solver="admm", iterations=10),
        "implicit": reference(scene, solver="implicit"),
        "miniature, calibrated 1/2": make_backend("miniature", scene, backend_kwargs={"scaling": "calibrated"}),
    }


def measure(name: str, seeds: Sequence[int]) -> list[Row]:
    """Every method on the scene ``name``."""
    found: dict[str, list[list[float]]] = {}
    keep = [START + k for k in range(HORIZON + 1)]
    for seed in seeds:
        truth = load(Case(name, seed), START + HORIZON, keep, cache_folder())
        controls = truth.controls[START : START + HORIZON]
        for method, backend in methods(truth.scene).items():
            list(replay(backend, truth.states[START], controls[:2]))  # warms up
            steps = list(replay(backend, truth.states[START], controls))
            off = [100 * vertex_error(truth.scene, steps[k - 1][0], truth.states[START + k]) for k in (1, 5, 10)]
            found.setdefault(method, []).append([1e3 * float(np.median([s.cpu for _, s in steps])), *off])
    return [Row(name, method, *np.median(values, 0).tolist()) for method, values in found.items()]


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m training.bench.papers.large_step", description=__doc__)
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--quick", action="store_true", help="one seed; says that it is quick")
    parser.add_argument("--out", type=Path, help="folder for cnn_large_step*.csv and .json")
    options = parser.parse_args(argv)
    names = read_names(options.scenes, SCENES, "scene")
    bound = [Growth(ratio, cells, growth(ratio, cells)) for ratio in (1.0, 2.0, 4.0, 8.0) for cells in (1, 2, 3, 4, 8)]
    print(
        "least growth of the worst mode a step\n" + f"{'R':>4s}" + "".join(f"{f'K={k}':>9s}" for k in (1, 2, 3, 4, 8))
    )
    for ratio in (1.0, 2.0, 4.0, 8.0):
        print(f"{ratio:4g}" + "".join(f"{g.growth:9.3g}" for g in bound if g.ratio == ratio))
    found = [row for name in names for row in measure(name, SEEDS[:1] if options.quick else SEEDS)]
    print(f"\n{'':40s}{'ms':>8s}" + "".join(f"{f'{k} frames':>10s}" for k in (1, 5, 10)))
    for r in found:
        print(f"{r.scene:8s} {r.method:31s}{r.ms:8.2f}{r.error_1:10.4f}{r.error_5:10.4f}{r.error_10:10.4f}")
    if options.quick:
        print("(quick)")
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        write_rows(options.out / "cnn_large_step.csv", found)
        write_rows(options.out / "cnn_large_step_bound.csv", bound)
        about: dict[str, Any] = {**header(), "quick": options.quick, "threads": 1, "seeds": SEEDS, "start": START}
        (options.out / "cnn_large_step.json").write_text(json.dumps(about, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
