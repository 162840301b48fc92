"""``minicloth bench throughput``: nanoseconds per vertex and substep, by term, size, threads and batch."""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.machine import header
from cloth_envs.material import Material
from cloth_envs.physics import laws
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.registry import SCENES
from cloth_envs.scene import Collider, Scene, Wind
from cloth_envs.state import Controls, State
from training.bench.throughput import frames
from training.bench.throughput.roofline import peak_flops

SIZES = {"Flag": Grid(33, 49, 1.0, 1.5), "Curtain": Grid(73, 49, 1.5, 1.0), "4x Curtain": Grid(145, 97, 1.5, 1.0)}
SUBSTEPS = 100

# Gravity and drag are in every row. Operations per vertex as the kernel's source has them (a multiply and
# an add are two): 22 an edge and 12 more with its damper, 38 to collect and integrate, 43 for bending.
TERMS: dict[str, tuple[Material, dict[str, Any], int]] = {
    "springs": (Material(bend_stiffness=0.0, damping=0.0), {}, 126),
    "+ dampers": (Material(bend_stiffness=0.0), {}, 174),
    "+ bending": (Material(), {}, 217),
    "+ wind": (Material(), {"wind": Wind()}, 217 + 168),
    "+ pressure, no wind": (Material(), {"pressure": True}, 217 + 59),
    "+ sphere, no wind": (Material(), {"colliders": (Collider("sphere", 0.3),)}, 217 + 70),
}
DEFAULT = "+ bending"
BYTES = 4 * (2 * 6 + 2 * 9 + 9)  # a vertex's state, edge forces (written and read) and weights, float32, each once


@dataclass(frozen=True)
class Row:
    size: str
    vertices: int
    term: str
    threads: int
    batch: int
    ns_median: float
    ns_best: float


def prepare(grid: Grid, term: str, batch: int) -> tuple[Scene, State, Controls]:
    """A gently waved sheet pinned along its first row, in a scene with the terms up to ``term``."""
    material, extra, _ = TERMS[term]
    scene = Scene("Throughput", grid, material, 1e-3, handles=tuple(range(grid.cols)), **extra)
    positions = np.empty((batch, 3, *grid.shape), np.float32)
    positions[:, 0] = np.linspace(0, grid.width, grid.cols)
    positions[:, 1] = np.linspace(0, grid.height, grid.rows)[:, None]
    positions[:, 2] = 0.02 * np.sin(9 * positions[:, 0]) * np.cos(7 * positions[:, 1])
    colliders = np.empty((batch, len(scene.colliders), 2, 3))
    colliders[:] = [grid.width / 2, grid.height / 2, -0.25]
    state = State.still(positions, colliders)
    return scene, state, Controls.hold(state, scene.handles)


def measure(size: str, term: str, threads: int, batch: int, repeats: int) -> Row:
    """Time of one substep over the vertices of all ``batch`` cloths, wall clock."""
    grid = SIZES[size]
    scene, state, controls = prepare(grid, term, batch)
    backend = ExplicitSolver(scene, num_envs=batch, threads=threads, substeps=SUBSTEPS)
    times = []
    for _ in range(repeats + 1):  # the first warms up
        backend.reset(state)
        start = perf_counter()
        backend.advance(controls)
        times.append((perf_counter() - start) / (SUBSTEPS * grid.vertices * batch) * 1e9)
    return Row(size, grid.vertices, term, threads, batch, float(np.median(times[1:])), min(times[1:]))


def numpy_ns(size: str, repeats: int) -> float:
    """The NumPy twin's best time for the default terms, per vertex and substep [ns]."""
    scene, state, controls = prepare(SIZES[size], DEFAULT, 1)
    best = np.inf
    for _ in range(repeats):
        start = perf_counter()
        laws.step(scene, state, controls, 5)
        best = min(best, (perf_counter() - start) / (5 * scene.grid.vertices) * 1e9)
    return float(best)


def table(rows: Sequence[Row]) -> str:
    """The rows as text: a line a term, a column a size."""
    lines = ["ns per vertex and substep, float32: median (best)"]
    lines += [f"{'one thread, one cloth':24s}" + "".join(f"{f'{s} ({SIZES[s].vertices})':>22s}" for s in SIZES)]
    for label, threads, batch in [(t, 1, 1) for t in TERMS] + [(DEFAULT, 1, 32), (DEFAULT, 2, 32)]:
        found = [r for r in rows if (r.term, r.threads, r.batch) == (label, threads, batch)]
        name = label if batch == 1 else f"32 cloths, {threads} thread{'s' * (threads > 1)}"
        lines.append(f"{name:24s}" + "".join(f"{f'{r.ns_median:.2f} ({r.ns_best:.2f})':>22s}" for r in found))
    return "\n".join(lines)


def write_rows(path: Path, rows: Sequence[Any]) -> None:
    """Dataclasses as CSV."""
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(rows[0])])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="minicloth bench throughput", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer repeats; says that it is quick")
    parser.add_argument("--out", type=Path, help="folder for throughput.csv and throughput.json")
    options = parser.parse_args(argv)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
    repeats = 5 if options.quick else 30
    about = {**header(), "quick": options.quick, "repeats": repeats, "substeps": SUBSTEPS, "dtype": "float32"}
    quick = ", quick" if options.quick else ""
    print(f"{about['processor']}, {about['cores']} cores, {about['instruction_set']}{quick}")

    rows = [measure(size, term, 1, 1, repeats) for size in SIZES for term in TERMS]
    rows += [measure(size, DEFAULT, t, 32, max(2, repeats // 6)) for size in SIZES for t in (1, 2)]
    print("\n" + table(rows))

    best = next(r.ns_best for r in rows if (r.size, r.term, r.batch) == ("Curtain", DEFAULT, 1))
    twin = numpy_ns("Curtain", 3 if options.quick else 10)
    about["numpy_ns"], about["numpy_ratio"] = twin, twin / best
    print(f"\nNumPy twin, Curtain: {twin:.0f} ns, {twin / best:.0f} times the kernel's")

    flops, operations = peak_flops(), TERMS[DEFAULT][2]
    about |= {"peak_flops": flops, "flops_per_vertex": operations, "roofline_ns": operations / flops * 1e9}
    print(
        f"Roofline, Curtain: {operations} operations a vertex; one thread reaches {flops / 1e9:.0f} Gflop/s in sgemm, "
        f"so {operations / flops * 1e9:.2f} ns if all were fused pairs; the kernel runs at "
        f"{operations / best / flops * 1e11:.0f} % of that and moves {BYTES / best:.0f} GB/s through the caches"
    )
    whole = [frames.measure(scene, 50 if options.quick else 200) for scene in SCENES]
    print("\nWhole frames, one thread: solver, environment around it, and that with an idle solver")
    print(frames.table(whole))
    if options.out:
        write_rows(options.out / "throughput.csv", rows)
        write_rows(options.out / "frames.csv", whole)
        (options.out / "throughput.json").write_text(json.dumps(about, indent=2))
        print(f"rows in {options.out / 'throughput.csv'}")
    return 0
