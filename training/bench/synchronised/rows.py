"""Rows of tracked cloths and of what is chance in them, and the tables made of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from training.rows import read_rows

FREE = "free"
TRACKED, FLOOR = "tracking", "tracking_floor"
DATA = Path(__file__).parents[3] / "docs" / "data" / f"{FLOOR}.csv"


@dataclass(frozen=True)
class TrackingRow:
    """A fine cloth over the frames of a sequence: ``free``, pulled by ``mean`` or ``seed``, or by ``springs`` alone.

    ``error`` [mm]: mean distance of the vertices that both cloths share, nan where it is free. ``spikes``: how far
    these lie from the mean of their neighbours over how far others do, ``roughness`` [mm], root mean squares of both.
    ``bending`` [J]; ``ms`` of the processor a frame, the coarse cloth's with it; ``crossings`` of triangles, the most.
    """

    scene: str
    tracking: str
    sequence: int
    rows: int
    cols: int
    frames: int
    error: float
    spikes: float
    roughness: float
    bending: float
    ms: float
    crossings: int


@dataclass(frozen=True)
class FloorRow:
    """What is chance of a tracked cloth: root mean square distance of twins over the square root of two.

    ``rms`` [mm], of ``detail`` [mm] that the fine cloth has beyond bicubic interpolation of the coarse one;
    ``normals`` [degrees], the mean angle over the same.
    """

    scene: str
    sequence: int
    rows: int
    cols: int
    frames: int
    rms: float
    detail: float
    normals: float


def floor(scene: str) -> dict[str, float]:
    """Means over the stored sequences: ``rms`` and ``detail`` [mm], ``normals`` [degrees].

    Raises:
        ValueError: not measured for this scene.
        FileNotFoundError: no data; `minicloth bench synchronised` makes them.
    """
    if not DATA.is_file():
        raise FileNotFoundError(f"no floor in {DATA}: run `minicloth bench synchronised --out FOLDER`")
    rows = read_rows(DATA, FloorRow)
    mine = [row for row in rows if row.scene == scene]
    if not mine:
        raise ValueError(f"the floor is known of {', '.join(dict.fromkeys(r.scene for r in rows))}, not of {scene!r}")
    return {name: float(np.mean([getattr(row, name) for row in mine])) for name in ("rms", "detail", "normals")}


def tracking_table(rows: Sequence[TrackingRow]) -> str:
    """A line a tracking: means over the sequences."""
    lines = [
        f"{'':10s}{'tracking':10s}{'error [mm]':>20s}{'spikes':>20s}{'roughness [mm]':>16s}{'bending over free':>19s}"
        f"{'ms/frame':>10s}{'crossings':>11s}"
    ]
    for scene, name in dict.fromkeys((r.scene, r.tracking) for r in rows):
        mine = [r for r in rows if (r.scene, r.tracking) == (scene, name)]
        free = {r.sequence: r.bending for r in rows if (r.scene, r.tracking) == (scene, FREE)}
        bending = np.mean([r.bending / free.get(r.sequence, np.nan) for r in mine])
        error = "-" if name == FREE else _span([r.error for r in mine])
        rough, ms = (float(np.mean([getattr(r, k) for r in mine])) for k in ("roughness", "ms"))
        lines.append(
            f"{scene:10s}{name:10s}{error:>20s}{_span([r.spikes for r in mine]):>20s}{rough:16.3g}{bending:19.2f}"
            f"{ms:10.0f}{max(r.crossings for r in mine):11d}"
        )
    return "\n".join(lines)


def _span(values: Sequence[float]) -> str:
    """Mean, least and largest."""
    return f"{np.mean(values):.3g} ({min(values):.3g}-{max(values):.3g})"


def floor_table(rows: Sequence[FloorRow]) -> str:
    """A line a scene: means over the sequences (least and largest)."""
    lines = [f"{'':10s}{'rms [mm]':>22s}{'of detail [mm]':>22s}{'normals [degrees]':>22s}"]
    for scene in dict.fromkeys(r.scene for r in rows):
        line = f"{scene:10s}"
        for name in ("rms", "detail", "normals"):
            found = [getattr(r, name) for r in rows if r.scene == scene]
            line += f"{_span(found):>22s}"
        lines.append(line)
    return "\n".join(lines)
