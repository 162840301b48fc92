"""``minicloth bench throughput``: ns per vertex and substep by term, size, threads and batch, and whole frames.

Kernels are timed with every instruction set that the processor has, in float32 and float64. Shares are of what one
thread reaches in a matrix product with the same instructions, where all operations are fused pairs.
"""

from cloth_envs.machine import nominal_hz
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.levels import levels
from training.bench.steps import StepRow, step_rows, step_table
from training.bench.throughput.frames import frames_of
from training.bench.throughput.kernel import SUBSTEPS, jobs, measure_level, numpy_ns
from training.bench.throughput.rows import FrameRow, ThroughputRow, frame_table, table
from training.bench.throughput.terms import DEFAULT


def measure(session: Session) -> None:
    """Kernels, their twin in NumPy and the roofline, and whole frames of every scene; all anew."""
    if session.given.backend:
        raise ValueError("bench throughput times the compiled kernels: leave --backend to the other benchmarks")
    quick = session.quick
    repeats = 5 if quick else 30
    rows: list[ThroughputRow] = []
    for level in levels():
        found, peak = measure_level(level, jobs(repeats))
        rows += found
        session.about[f"peak_flops_{level}"] = peak
    session.store("throughput").replace(rows)
    best = next(r for r in rows[::-1] if (r.dtype, r.size, r.term, r.batch) == ("float32", "Curtain", DEFAULT, 1))
    twin = numpy_ns("Curtain", 3 if quick else 10)
    print(f"NumPy twin, Curtain: {twin:.0f} ns, {twin / best.ns_best:.0f} times the kernel's on {best.instruction_set}")
    session.about |= {"repeats": repeats, "substeps": SUBSTEPS, "nominal_hz": nominal_hz(), "numpy_ns": twin}
    session.store("frames").replace([frames_of(scene, 50 if quick else 200) for scene in session.scenes])
    session.store("steps").replace(step_rows(session.scenes, quick))


BENCHMARK = Benchmark(
    name="throughput",
    about="Nanoseconds per vertex and substep, by term, size, threads and batch; and whole frames.",
    files={"throughput": RowFile(ThroughputRow), "frames": RowFile(FrameRow), "steps": RowFile(StepRow)},
    parts=[
        Part(
            "Terms and threads: ns per vertex and substep, median (best); on the Curtain's grid the best in cycles of "
            "the nominal clock a vector, and its operations and instructions beside a matrix product's",
            ("throughput",), table,
        ),
        Part(
            "Whole frames, one thread: solver, environment around it, and that with an idle solver", ("frames",),
            frame_table,
        ),
        Part("Steps, one thread, of one environment: whole (outside the backend)", ("steps",), step_table),
    ],
    measure=measure,
)  # fmt: skip
