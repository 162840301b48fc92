"""Rows of the throughput benchmark and the tables made of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cloth_envs.grid import Grid
from training.bench.throughput.terms import DEFAULT, TERMS

SIZES = {"Flag": Grid(33, 49, 1.0, 1.5), "Curtain": Grid(73, 49, 1.5, 1.0), "4x Curtain": Grid(145, 97, 1.5, 1.0)}
THREADS = (1, 2)  # of batches
BATCH = 32


@dataclass(frozen=True)
class ThroughputRow:
    """Nanoseconds per vertex and substep of ``batch`` cloths with the terms up to ``term``.

    Of the best: ``cycles`` per vector of vertices at the nominal clock; ``of_peak`` is what its operations a second are
    of those of a matrix product with the same instructions, ``of_limit`` the same of its arithmetic instructions, each
    of which takes the place of a fused multiply-add. NaN where not known: the two are counted for float32.
    """

    instruction_set: str
    dtype: str
    size: str
    vertices: int
    term: str
    threads: int
    batch: int
    ns_median: float
    ns_best: float
    cycles: float
    of_peak: float
    of_limit: float


@dataclass(frozen=True)
class FrameRow:
    """Medians. ``overhead_us`` is a step less its solver call; ``repeated_us`` a step whose solver call does nothing.

    They differ because a solver call leaves little of Python in the processor's caches: ``cold`` is how many times
    longer a fixed piece of plain Python takes right after one than when it is repeated. Bending, the air and pressure
    are computed every ``held`` substeps.
    """

    scene: str
    vertices: int
    substeps: int
    held: int
    frame_ms: float
    solver_ms: float
    overhead_us: float
    repeated_us: float
    cold: float


def table(rows: Sequence[ThroughputRow]) -> str:
    """A block an instruction set and dtype: a line a term, a column a size, and what they come to on the Curtain's."""
    lines: list[str] = []
    for level, dtype in dict.fromkeys((r.instruction_set, r.dtype) for r in rows):
        sizes = "".join(f"{f'{s} ({SIZES[s].vertices})':>20s}" for s in SIZES)
        lines.append(f"{f'{level}, {dtype}':26s}{sizes}{'cycles':>9s}{'of peak':>9s}{'of limit':>9s}")
        for label, threads, batch in [(t, 1, 1) for t in TERMS] + [(DEFAULT, t, BATCH) for t in THREADS]:
            found = [r for r in rows if (r.instruction_set, r.dtype) == (level, dtype)]
            found = [r for r in found if (r.term, r.threads, r.batch) == (label, threads, batch)]
            name = label if batch == 1 else f"{batch} cloths, {threads} thread{'s' * (threads > 1)}"
            line = f"{name:26s}" + "".join(f"{f'{r.ns_median:.2f} ({r.ns_best:.2f})':>20s}" for r in found)
            if batch == 1 and found:
                r = next((r for r in found if r.size == "Curtain"), found[0])
                line += f"{r.cycles:9.0f}{_percent(r.of_peak):>9s}{_percent(r.of_limit):>9s}"
            lines.append(line)
    return "\n".join(lines)


def _percent(part: float) -> str:
    return f"{100 * part:.0f} %" if np.isfinite(part) else "-"


def frame_table(frames: Sequence[FrameRow]) -> str:
    """A line a scene."""
    heads = f"{'scene':10s} {'vertices':>8s} {'frame':>6s} {'substeps':>8s} {'held':>4s}"
    lines = [f"{heads} {'solver':>9s} {'overhead':>9s} {'repeated':>9s} {'cold':>5s}"]
    lines += [
        f"{f.scene:10s} {f.vertices:8d} {f.frame_ms:3.0f} ms {f.substeps:8d} {f.held:4d} {f.solver_ms:6.2f} ms "
        f"{f.overhead_us:6.0f} us {f.repeated_us:6.0f} us {f.cold:4.1f}x"
        for f in frames
    ]
    return "\n".join(lines)
