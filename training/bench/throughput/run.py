"""``minicloth bench throughput``: nanoseconds per vertex and substep, by term, size, threads and batch."""

from __future__ import annotations

import os
import subprocess
import sys
from time import perf_counter

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.laws.step import step
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.throughput.frames import frames_of
from training.bench.throughput.rows import (
    DEFAULT,
    FRAME_KEY,
    SIZES,
    TERMS,
    THROUGHPUT_KEY,
    FrameRow,
    ThroughputRow,
    frame_table,
    table,
)

SUBSTEPS = 100
BYTES = 4 * (2 * 6 + 2 * 9 + 9)  # a vertex's state, edge forces (written and read) and weights, float32, each once
SGEMM = """
import time, numpy as np
a = np.ones((1024, 1024), np.float32)
a @ a
best = 1e9
for _ in range(20):
    start = time.perf_counter()
    a @ a
    best = min(best, time.perf_counter() - start)
print(2 * 1024**3 / best)
"""


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


def kernel(size: str, term: str, threads: int, batch: int, repeats: int) -> ThroughputRow:
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
    return ThroughputRow(size, grid.vertices, term, threads, batch, float(np.median(times[1:])), min(times[1:]))


def numpy_ns(size: str, repeats: int) -> float:
    """The NumPy twin's best time for the default terms, per vertex and substep [ns]."""
    scene, state, controls = prepare(SIZES[size], DEFAULT, 1)
    best = np.inf
    for _ in range(repeats):
        start = perf_counter()
        step(scene, state, controls, 5)
        best = min(best, (perf_counter() - start) / (5 * scene.grid.vertices) * 1e9)
    return float(best)


def peak_flops() -> float:
    """Floating-point operations a second of one thread [1/s], as a float32 matrix product reaches them."""
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    done = subprocess.run(
        [sys.executable, "-c", SGEMM], env={**os.environ, **one}, capture_output=True, text=True, check=True
    )
    return float(done.stdout)


def measure(session: Session) -> None:
    """Kernels, their twin in NumPy and the roofline, and whole frames of every scene; all anew."""
    quick = session.quick
    repeats = 5 if quick else 30
    rows = [kernel(size, term, 1, 1, repeats) for size in SIZES for term in TERMS]
    rows += [kernel(size, DEFAULT, t, 32, max(2, repeats // 6)) for size in SIZES for t in (1, 2)]
    session.store("throughput").replace(rows)
    best = next(r.ns_best for r in rows if (r.size, r.term, r.batch) == ("Curtain", DEFAULT, 1))
    twin, flops, operations = numpy_ns("Curtain", 3 if quick else 10), peak_flops(), TERMS[DEFAULT][2]
    print(f"NumPy twin, Curtain: {twin:.0f} ns, {twin / best:.0f} times the kernel's")
    print(
        f"Roofline, Curtain: {operations} operations a vertex; one thread reaches {flops / 1e9:.0f} Gflop/s in sgemm, "
        f"so {operations / flops * 1e9:.2f} ns if all were fused pairs; the kernel runs at "
        f"{operations / best / flops * 1e11:.0f} % of that and moves {BYTES / best:.0f} GB/s through the caches"
    )
    session.about |= {
        "repeats": repeats,
        "substeps": SUBSTEPS,
        "dtype": "float32",
        "numpy_ns": twin,
        "numpy_ratio": twin / best,
        "peak_flops": flops,
        "flops_per_vertex": operations,
        "roofline_ns": operations / flops * 1e9,
    }
    session.store("frames").replace([frames_of(scene, 50 if quick else 200) for scene in session.scenes])


BENCHMARK = Benchmark(
    name="throughput",
    about="Nanoseconds per vertex and substep, by term, size, threads and batch; and whole frames.",
    files={"throughput": RowFile(ThroughputRow, THROUGHPUT_KEY), "frames": RowFile(FrameRow, FRAME_KEY)},
    parts=[
        Part("Terms and threads: ns per vertex and substep, float32, median (best)", ("throughput",), table),
        Part(
            "Whole frames, one thread: solver, environment around it, and that with an idle solver", ("frames",),
            frame_table,
        ),
    ],
    measure=measure,
)  # fmt: skip
