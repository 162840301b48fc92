"""Rows of the mesh benchmark and their table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from training.bench.participants import label


@dataclass(frozen=True)
class MeshRow:
    """Mean vertex error against the fine sheet [% of the cloth's length] after ``frames``: mean, least and largest of
    the seeds. ``spacing`` [m] is the scene's own, ``start`` is ``restart`` or ``beginning`` of the episode.
    """

    scene: str
    start: str
    family: str
    options: str
    frames: int
    windows: int
    rows: int
    cols: int
    spacing: float
    error: float
    error_low: float
    error_high: float
    failure: str


KEY = ("scene", "start", "family", "options", "frames", "rows", "cols")


def table(rows: Sequence[MeshRow]) -> str:
    """Errors in % of the length, one line a method."""
    horizons = sorted({r.frames for r in rows})
    lines = [f"{'':55s}" + "".join(f"{f'{h} fr.':>25s}" for h in horizons)]
    at = {(r.scene, r.start, r.family, r.options, r.frames): r for r in rows}
    for scene, start, family, options in dict.fromkeys(key[:4] for key in at):
        found = [at[scene, start, family, options, h] for h in horizons]
        cells = "".join(f"{f'{r.error:.3g} ({r.error_low:.2g}-{r.error_high:.2g})':>25s}" for r in found)
        name = "reference's mesh" if family == "explicit" else label(family, options)
        lines.append(f"{scene:10s}{start:11s}{name:34s}{cells}  {found[-1].failure}".rstrip())
    return "\n".join(lines)
