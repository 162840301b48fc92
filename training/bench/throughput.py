"""``minicloth bench throughput``: ns per vertex and substep by term, size, threads and batch, and whole frames."""

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter
from timeit import repeat
from typing import Any

import gymnasium as gym
import numpy as np

import cloth_envs
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.laws.step import step
from cloth_envs.scene import Air, Collider, Scene
from cloth_envs.state import Controls, State
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.steps import StepRow, step_rows, step_table

SIZES = {"Flag": Grid(33, 49, 1.0, 1.5), "Curtain": Grid(73, 49, 1.5, 1.0), "4x Curtain": Grid(145, 97, 1.5, 1.0)}
# Gravity and drag are in every row. Operations per vertex as the kernel's source has them (a multiply and
# an add are two): 22 an edge and 12 more with its damper, 38 to collect and integrate, 43 for bending.
TERMS: dict[str, tuple[Material, dict[str, Any], int]] = {
    "springs": (Material(bend_stiffness=0.0, damping=0.0), {}, 126),
    "+ dampers": (Material(bend_stiffness=0.0), {}, 174),
    "+ bending": (Material(), {}, 217),
    "+ wind": (Material(), {"air": Air()}, 217 + 168),
    "+ pressure, no wind": (Material(), {"pressure": True}, 217 + 59),
    "+ sphere, no wind": (Material(), {"colliders": (Collider("sphere", 0.3),)}, 217 + 70),
}
DEFAULT = "+ bending"
SUBSTEPS = 100
BYTES = 4 * (2 * 6 + 2 * 9 + 9)  # a vertex's state, edge forces (written and read) and weights, float32, each once
SGEMM = """
import numpy as np, timeit
a = np.ones((1024, 1024), np.float32)
print(2 * 1024**3 / min(timeit.repeat(lambda: a @ a, number=1, repeat=21)))
"""


@dataclass(frozen=True)
class ThroughputRow:
    """Nanoseconds per vertex and substep of ``batch`` cloths with the terms up to ``term``."""

    size: str
    vertices: int
    term: str
    threads: int
    batch: int
    ns_median: float
    ns_best: float


@dataclass(frozen=True)
class FrameRow:
    """Medians. ``overhead_us`` is a step less its solver call; ``repeated_us`` a step whose solver call does nothing.

    They differ because a solver call leaves little of Python in the processor's caches: ``cold`` is how many times
    longer a fixed piece of plain Python takes right after one than when it is repeated.
    """

    scene: str
    vertices: int
    substeps: int
    frame_ms: float
    solver_ms: float
    overhead_us: float
    repeated_us: float
    cold: float


def table(rows: Sequence[ThroughputRow]) -> str:
    """A line a term, a column a size."""
    lines = [f"{'one thread, one cloth':24s}" + "".join(f"{f'{s} ({SIZES[s].vertices})':>22s}" for s in SIZES)]
    for label, threads, batch in [(t, 1, 1) for t in TERMS] + [(DEFAULT, 1, 32), (DEFAULT, 2, 32)]:
        found = [r for r in rows if (r.term, r.threads, r.batch) == (label, threads, batch)]
        name = label if batch == 1 else f"32 cloths, {threads} thread{'s' * (threads > 1)}"
        lines.append(f"{name:24s}" + "".join(f"{f'{r.ns_median:.2f} ({r.ns_best:.2f})':>22s}" for r in found))
    return "\n".join(lines)


def frame_table(frames: Sequence[FrameRow]) -> str:
    """A line a scene."""
    heads = f"{'scene':10s} {'vertices':>8s} {'frame':>6s} {'substeps':>8s}"
    lines = [f"{heads} {'solver':>9s} {'overhead':>9s} {'repeated':>9s} {'cold':>5s}"]
    lines += [
        f"{f.scene:10s} {f.vertices:8d} {f.frame_ms:3.0f} ms {f.substeps:8d} {f.solver_ms:6.2f} ms "
        f"{f.overhead_us:6.0f} us {f.repeated_us:6.0f} us {f.cold:4.1f}x"
        for f in frames
    ]
    return "\n".join(lines)


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
    taken = repeat(lambda: backend.advance(controls), lambda: backend.reset(state), number=1, repeat=repeats + 1)
    times = np.array(taken[1:]) / (SUBSTEPS * grid.vertices * batch) * 1e9  # the first warmed up
    return ThroughputRow(size, grid.vertices, term, threads, batch, float(np.median(times)), float(times.min()))


def numpy_ns(size: str, repeats: int) -> float:
    """The NumPy twin's best time for the default terms, per vertex and substep [ns]."""
    scene, state, controls = prepare(SIZES[size], DEFAULT, 1)
    taken = repeat(lambda: step(scene, state, controls, 5), number=1, repeat=repeats)
    return min(taken) / (5 * scene.grid.vertices) * 1e9


def peak_flops() -> float:
    """Floating-point operations a second of one thread [1/s], as a float32 matrix product reaches them."""
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    command = [sys.executable, "-c", SGEMM]
    return float(subprocess.run(command, env={**os.environ, **one}, capture_output=True, text=True, check=True).stdout)


class Timed:
    """Stands for a solver's ``step`` and times its last call."""

    def __init__(self, step: Callable[[State, State, Controls], None]) -> None:
        self.step, self.seconds, self.idle = step, 0.0, False
        self.given: tuple[State, State, Controls]

    def __call__(self, old: State, new: State, controls: Controls) -> None:
        start, self.given = perf_counter(), (old, new, controls)
        if self.idle:
            new.positions[:], new.velocities[:] = old.positions, old.velocities
        else:
            self.step(old, new, controls)
        self.seconds = perf_counter() - start


def plain() -> int:
    """Some hundreds of the interpreter's instructions, spread over its types."""
    table, words = {str(k): k for k in range(20)}, [str(k) for k in range(20)]
    return sum(len(f"{table[word]:5.2f}".strip()) + isinstance(word, str) for word in words)


def frames_of(scene: str, steps: int) -> FrameRow:
    """One thread, default material, random actions, observation and reward included."""
    env: Any = gym.make(cloth_envs.env_id(scene)).unwrapped
    env.reset(seed=0)
    env.action_space.seed(0)
    backend = env.world.backend
    timed = backend.step = Timed(backend.step)

    def step(action: np.ndarray) -> tuple[float, float]:
        """Seconds in the solver, and around it."""
        start = perf_counter()
        env.step(action)
        return timed.seconds, perf_counter() - start - timed.seconds

    solver, overhead = np.median([step(env.action_space.sample()) for _ in range(steps)], 0)
    timed.idle, action = True, env.action_space.sample()
    _, repeated = np.median([step(action) for _ in range(20 * steps)], 0)
    warm = repeat(plain, number=1, repeat=steps)
    cold = repeat(plain, lambda: timed.step(*timed.given), number=1, repeat=steps)
    return FrameRow(
        scene, env.scene.grid.vertices, int(backend.substeps[0]), env.scene.frame_dt * 1e3, float(solver) * 1e3,
        float(overhead) * 1e6, float(repeated) * 1e6, float(np.median(cold) / np.median(warm)),
    )  # fmt: skip


def measure(session: Session) -> None:
    """Kernels, their twin in NumPy and the roofline, and whole frames of every scene; all anew."""
    if session.given.backend:
        raise ValueError("bench throughput times the compiled kernels: leave --backend to the other benchmarks")
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
    session.about |= {"repeats": repeats, "substeps": SUBSTEPS, "dtype": "float32"}
    session.about |= {"numpy_ns": twin, "numpy_ratio": twin / best, "peak_flops": flops}
    session.about |= {"flops_per_vertex": operations, "roofline_ns": operations / flops * 1e9}
    session.store("frames").replace([frames_of(scene, 50 if quick else 200) for scene in session.scenes])
    session.store("steps").replace(step_rows(session.scenes, quick))


BENCHMARK = Benchmark(
    name="throughput",
    about="Nanoseconds per vertex and substep, by term, size, threads and batch; and whole frames.",
    files={"throughput": RowFile(ThroughputRow), "frames": RowFile(FrameRow), "steps": RowFile(StepRow)},
    parts=[
        Part("Terms and threads: ns per vertex and substep, float32, median (best)", ("throughput",), table),
        Part(
            "Whole frames, one thread: solver, environment around it, and that with an idle solver", ("frames",),
            frame_table,
        ),
        Part("Steps, one thread, of one environment: whole (outside the backend)", ("steps",), step_table),
    ],
    measure=measure,
)  # fmt: skip
