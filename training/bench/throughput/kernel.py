"""Times the kernel on a bare sheet, a term after the other."""

from collections.abc import Sequence
from time import perf_counter, thread_time
from timeit import repeat
from typing import NamedTuple

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.machine import nominal_hz
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.laws.step import step
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from training.bench.levels import peak_flops, process
from training.bench.throughput.rows import BATCH, SIZES, THREADS, ThroughputRow
from training.bench.throughput.terms import DEFAULT, TERMS

SUBSTEPS = 100
BITS = {"baseline": 128, "avx2": 256, "avx512": 512}  # of a vector


class Job(NamedTuple):
    """What is timed."""

    dtype: str
    size: str
    term: str
    threads: int
    batch: int
    repeats: int


def prepare(grid: Grid, term: str, batch: int) -> tuple[Scene, State, Controls]:
    """A gently waved sheet pinned along its first row, in a scene with the terms up to ``term``."""
    what = TERMS[term]
    scene = Scene("Throughput", grid, what.material, 1e-3, handles=tuple(range(grid.cols)), **what.extra)
    positions = np.empty((batch, 3, *grid.shape), np.float32)
    positions[:, 0] = np.linspace(0, grid.width, grid.cols)
    positions[:, 1] = np.linspace(0, grid.height, grid.rows)[:, None]
    positions[:, 2] = 0.02 * np.sin(9 * positions[:, 0]) * np.cos(7 * positions[:, 1])
    colliders = np.zeros((batch, len(scene.colliders), 2, 3))
    if what.body:
        colliders[:] = what.body
    state = State.still(positions, colliders)
    return scene, state, Controls.hold(state, scene.handles)


def nanoseconds(job: Job) -> tuple[float, float, int]:
    """Of one substep and vertex, median and best; and for how many substeps slow forces are held.

    Processor time of one thread, so that other jobs count less; the wall clock of several.
    """
    grid = SIZES[job.size]
    scene, state, controls = prepare(grid, job.term, job.batch)
    solver = ExplicitSolver(scene, num_envs=job.batch, threads=job.threads, dtype=job.dtype, substeps=SUBSTEPS)
    timer = thread_time if job.threads == 1 else perf_counter
    taken = repeat(lambda: solver.advance(controls), lambda: solver.reset(state), timer, job.repeats + 1, number=1)
    times = np.array(taken[1:]) / (SUBSTEPS * grid.vertices * job.batch) * 1e9  # the first warmed up
    return float(np.median(times)), float(times.min()), int(solver.cuts[0, 1])


def numpy_ns(size: str, repeats: int) -> float:
    """The NumPy twin's best time for the default terms, per vertex and substep [ns]."""
    scene, state, controls = prepare(SIZES[size], DEFAULT, 1)
    taken = repeat(lambda: step(scene, state, controls, 5), number=1, repeat=repeats)
    return min(taken) / (5 * scene.grid.vertices) * 1e9


def jobs(repeats: int) -> list[Job]:
    """All terms and sizes, and the default terms in batches, in both precisions."""
    few = max(2, repeats // 6)
    return [
        job
        for dtype in ("float32", "float64")
        for job in (
            *(Job(dtype, size, term, 1, 1, repeats) for size in SIZES for term in TERMS),
            *(Job(dtype, size, DEFAULT, threads, BATCH, few) for size in SIZES for threads in THREADS),
        )
    ]


def measure_level(level: str, chosen: Sequence[Job]) -> tuple[list[ThroughputRow], float]:
    """All of ``chosen`` with one instruction set; and what one thread reaches in a matrix product with it [1/s]."""
    before, clock = peak_flops(level), nominal_hz()
    with process(level) as pool:
        found = list(pool.map(nanoseconds, chosen))
    peak = max(before, peak_flops(level))  # others may have used the processor meanwhile
    rows = []
    for job, (median, best, held) in zip(chosen, found, strict=True):
        work, counted = TERMS[job.term].work(held), job.dtype == "float32" and job.threads == 1
        rate = 1e9 / (best * peak) if counted else float("nan")
        lanes = BITS[level] / (32 if job.dtype == "float32" else 64)
        slots = work.operations if level == "baseline" else 2 * work.instructions  # which has no fused multiply-add
        values = [median, best, best * 1e-9 * clock * lanes, work.operations * rate, slots * rate]
        about = (job.dtype, job.size, SIZES[job.size].vertices, job.term, job.threads, job.batch)
        rows.append(ThroughputRow(level, *about, *values))
    return rows, peak
