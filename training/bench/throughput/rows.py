"""Rows of the throughput benchmark, their tables, and the sheets and terms that they are of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.scene import Collider, Wind

SIZES = {"Flag": Grid(33, 49, 1.0, 1.5), "Curtain": Grid(73, 49, 1.5, 1.0), "4x Curtain": Grid(145, 97, 1.5, 1.0)}
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


THROUGHPUT_KEY = ("size", "term", "threads", "batch")


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


FRAME_KEY = ("scene",)


def table(rows: Sequence[ThroughputRow]) -> str:
    """The rows as text: a line a term, a column a size."""
    lines = [f"{'one thread, one cloth':24s}" + "".join(f"{f'{s} ({SIZES[s].vertices})':>22s}" for s in SIZES)]
    for label, threads, batch in [(t, 1, 1) for t in TERMS] + [(DEFAULT, 1, 32), (DEFAULT, 2, 32)]:
        found = [r for r in rows if (r.term, r.threads, r.batch) == (label, threads, batch)]
        name = label if batch == 1 else f"32 cloths, {threads} thread{'s' * (threads > 1)}"
        lines.append(f"{name:24s}" + "".join(f"{f'{r.ns_median:.2f} ({r.ns_best:.2f})':>22s}" for r in found))
    return "\n".join(lines)


def frame_table(frames: Sequence[FrameRow]) -> str:
    """The frames as text."""
    heads = f"{'scene':10s} {'vertices':>8s} {'frame':>6s} {'substeps':>8s}"
    lines = [f"{heads} {'solver':>9s} {'overhead':>9s} {'repeated':>9s} {'cold':>5s}"]
    lines += [
        f"{f.scene:10s} {f.vertices:8d} {f.frame_ms:3.0f} ms {f.substeps:8d} {f.solver_ms:6.2f} ms "
        f"{f.overhead_us:6.0f} us {f.repeated_us:6.0f} us {f.cold:4.1f}x"
        for f in frames
    ]
    return "\n".join(lines)
