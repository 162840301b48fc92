"""``minicloth bench mesh``: how far the reference is from the same sheet on twice the mesh (truth G2).

The fine sheet has the scene's own size, material, start and actions on a grid with half the spacing. Its states, at
the vertices that both grids have, are the truth of short windows on the scene's own grid, driven as the fine sheet
was. What the reference misses is what its mesh costs; other methods are beside it. A window that restarts from a folded
sheet also pays for folds that the grid can't hold and that pop open; one from an episode's smooth start does not.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cloth_envs.progress import progress
from cloth_envs.registry import load_task
from cloth_envs.resample import on_grid
from surrogates.miniature.coarse import coarse_scene
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.measure import HORIZONS, Windows, errors, gather, mean
from training.bench.participants import MESH, Participant, extra, label, truth
from training.rows import rounded
from training.truth import Case

SEEDS, STARTS = (200, 201), (25, 50, 100)  # frames at which windows begin
TRUTH, STEM = "g2", "mesh_error"


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


def fine_windows(cases: Sequence[Case], starts: Sequence[int], frames: int, cache: Path) -> Windows:
    """Windows on the grid of the scene, twice as coarse as that of ``cases``, whose truth is theirs.

    Raises:
        ValueError: the fine sheet is held by other handles.
    """
    keep = sorted({start + frame for start in starts for frame in range(frames + 1)})
    windows = gather(cases, starts, frames, keep, cache)
    fine = windows.scene
    scene, handles = coarse_scene(fine, 2, fine.material)
    own = load_task(fine.name).make_scene(resolution=scene.grid.shape, material=fine.material)
    if sorted(scene.handles) != sorted(own.handles):
        raise ValueError(f"{fine.name} has other handles on twice the mesh: its truth does not drive the same cloth")
    truth = [on_grid(state, fine.grid, scene.grid) for state in windows.truth]
    start = windows.truth[0].positions.reshape(len(windows.seeds), 3, -1)[:, :, list(fine.handles)].transpose(0, 2, 1)
    offsets = handles.offsets(truth[0].positions, start)
    controls = [handles.controls(controls, offsets) for controls in windows.controls]
    return replace(windows, scene=scene, controls=controls, truth=truth)


def beginning(starts: Sequence[int]) -> str:
    """What a row calls windows that begin at these frames."""
    return "restart" if min(starts) else "beginning"


def compare(windows: Windows, participants: Sequence[Participant], horizons: Sequence[int] = HORIZONS) -> list[MeshRow]:
    """Every participant after every horizon."""
    out, start, grid = [], beginning(windows.starts), windows.scene.grid
    for participant in participants:
        found = errors(participant, windows, horizons=horizons)
        for frames in horizons:
            seeds = [row for row in found if row.frames == frames]
            error = [row.error_mean for row in seeds if not np.isnan(row.error_mean)] or [float("nan")]
            row = MeshRow(
                windows.scene.name, start, participant.family, participant.text, frames,
                sum(row.windows for row in seeds), *grid.shape, grid.row_spacing, mean(error), min(error),
                max(error), "; ".join(row.failure for row in seeds if row.failure),
            )  # fmt: skip
            out.append(rounded(row))
    return out


def measure(session: Session) -> None:
    """Every scene, from states of its episodes and from their beginnings; rows that are there are kept."""
    store = session.store(STEM)
    seeds, coarse = (SEEDS[:1], 2.0) if session.quick else (SEEDS, 0.5)
    participants = [*MESH, *extra(session.given.backend)]
    session.about |= {"seeds": seeds, "starts": STARTS, "truth": f"explicit, half the spacing: {truth(TRUTH).fixed}"}
    for scene in progress(session.scenes, "mesh", unit="scene", name=str):
        cases = [Case(scene, seed, coarse, TRUTH) for seed in seeds]
        for starts in (STARTS, (0,)):
            windows = fine_windows(cases, starts, max(HORIZONS), session.cache("truth"))
            start, shape = beginning(starts), windows.scene.grid.shape
            there = [(scene, start, p.family, p.text, max(HORIZONS), *shape) in store for p in participants]
            store.add(*compare(windows, [p for p, known in zip(participants, there, strict=True) if not known]))


BENCHMARK = Benchmark(
    name="mesh",
    about="How far the reference is from the same sheet on twice the mesh.",
    files={STEM: RowFile(MeshRow, ("scene", "start", "family", "options", "frames", "rows", "cols"))},
    parts=[Part("Error against twice the mesh [% of length], mean (range over seeds)", (STEM,), table)],
    measure=measure,
)
