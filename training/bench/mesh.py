"""``minicloth bench mesh``: how far the reference is from the same sheet on twice the mesh (truth G2).

The fine sheet has the scene's own size, material, start and actions on a grid with half the spacing. Its states, at
the vertices that both grids have, are the truth of short windows on the scene's own grid, driven as the fine sheet
was. What the reference misses is what its mesh costs; other methods are beside it. A window that restarts from a folded
sheet also pays for folds that the grid can't hold and that pop open; one from an episode's smooth start does not.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from cloth_envs.machine import header
from cloth_envs.registry import SCENES, load_task, make_backend
from cloth_envs.resample import resample
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.miniature.coarse import coarse_scene
from training.bench.measure import HORIZONS, score
from training.bench.participants import Job, Method, label
from training.bench.throughput.run import write_rows
from training.bench.truth import Case, cache_folder, load
from training.bench.windows import Windows
from training.rows import read_names

SEEDS, STARTS = (200, 201), (25, 50, 100)  # frames at which windows begin
REFINE = 2  # of the fine sheet's step, which is half as long as the scene's already


@dataclass(frozen=True)
class Changed(Method):
    """The reference on the scene's own grid with another material, the ``options``."""

    def build(self, job: Job) -> Any:
        scene = job.scene.with_material(job.scene.material.with_changes(**self.options))
        return make_backend("reference", scene, num_envs=job.num_envs)


METHODS = (
    Method("explicit", {"dtype": "float64", "refine": 4}),  # truth G1: of its error only the mesh is left
    Changed("changed material", {"compression": 0.1}),  # stands for wrinkles that the mesh can't hold
    Method("miniature similar", {"factor": 2}),
    Method("closure local", {"factor": 2}),
    Method("closure local", {"factor": 4}),
)


@dataclass(frozen=True)
class Row:
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


def decimated(state: State, fine: Scene, scene: Scene) -> State:
    """``state`` of ``fine`` at the vertices of ``scene``."""
    cloth = {
        n: np.ascontiguousarray(resample(getattr(state, n), fine.grid, scene.grid)) for n in ("positions", "velocities")
    }
    return State(**(state.arrays() | cloth))


def gather(cases: Sequence[Case], starts: Sequence[int], frames: int, cache: Path) -> Windows:
    """Windows on the grid of the scene, twice as coarse as that of ``cases``, whose truth is theirs."""
    keep = sorted({start + frame for start in starts for frame in range(frames + 1)})
    truths = [load(case, max(keep), keep, cache) for case in cases]
    fine = truths[0].scene
    scene, handles = coarse_scene(fine, 2, fine.material)
    own = load_task(fine.name).make_scene(resolution=scene.grid.shape, material=fine.material)
    if sorted(scene.handles) != sorted(own.handles):
        raise ValueError(f"{fine.name} has other handles on twice the mesh: its truth does not drive the same cloth")
    still = np.zeros((1, len(handles.follows), 3))
    members = [(truth, case.seed, start) for start in starts for truth, case in zip(truths, cases, strict=True)]

    def at(frame: int) -> State:
        states = [decimated(truth.states[start + frame], fine, scene).arrays() for truth, _, start in members]
        return State(**{name: np.concatenate([s[name] for s in states]) for name in states[0]})

    def driven(frame: int) -> Controls:
        parts = [vars(handles.controls(truth.controls[start + frame], still)) for truth, _, start in members]
        return Controls(**{name: np.concatenate([p[name] for p in parts]) for name in parts[0]})

    return Windows(
        scene,
        tuple(seed for _, seed, _ in members),
        tuple(start for *_, start in members),
        [driven(frame) for frame in range(frames)],
        [at(frame) for frame in range(frames + 1)],
        hashlib.sha256("".join(truth.key for truth in truths).encode()).hexdigest()[:12],
    )


def measure(windows: Windows, methods: Sequence[Method] = METHODS, horizons: Sequence[int] = HORIZONS) -> list[Row]:
    """Every method after every horizon."""
    scene, out = windows.scene, []
    for method in methods:
        scores = score(method, windows, horizons=horizons)
        for frames in horizons:
            mine = [s for s in scores if s.frames == frames]
            errors = [s.error_mean for s in mine if not np.isnan(s.error_mean)] or [float("nan")]
            out.append(
                Row(
                    scene.name,
                    "restart" if min(windows.starts) else "beginning",
                    method.family,
                    method.text,
                    frames,
                    sum(s.windows for s in mine),
                    *scene.grid.shape,
                    float(f"{scene.grid.row_spacing:.5g}"),
                    float(f"{np.mean(errors):.5g}"),
                    min(errors),
                    max(errors),
                    "; ".join(s.failure for s in mine if s.failure),
                )
            )
    return out


def table(rows: Sequence[Row]) -> str:
    """Errors in % of the length, one line a method."""
    horizons = sorted({r.frames for r in rows})
    heads = "".join(f"{f'{h} fr.':>25s}" for h in horizons)
    lines = [f"Error against twice the mesh [% of length], mean (range over seeds)\n{'':55s}{heads}"]
    at = {(r.scene, r.start, r.family, r.options, r.frames): r for r in rows}
    for scene, start, family, options in dict.fromkeys(key[:4] for key in at):
        found = [at[scene, start, family, options, h] for h in horizons]
        cells = "".join(f"{f'{r.error:.3g} ({r.error_low:.2g}-{r.error_high:.2g})':>25s}" for r in found)
        name = "reference's mesh" if family == "explicit" else label(family, options)
        lines.append(f"{scene:10s}{start:11s}{name:34s}{cells}  {found[-1].failure}".rstrip())
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="minicloth bench mesh", description=__doc__)
    parser.add_argument("--scenes", default=",".join(SCENES), help="default: all")
    parser.add_argument("--quick", action="store_true", help="coarse grids and one seed; says so")
    parser.add_argument("--out", type=Path, help="folder for mesh_error.csv and mesh_error.json")
    parser.add_argument("--cache", type=Path, help="folder of the truths (default: in the user's caches)")
    given = parser.parse_args(argv)
    scenes = read_names(given.scenes, list(SCENES), "scene")
    seeds, coarse = (SEEDS[:1], 2.0) if given.quick else (SEEDS, 0.5)
    about = {
        **header(),
        "quick": given.quick,
        "seeds": seeds,
        "starts": STARTS,
        "truth": f"explicit, float64, half the spacing, 1/{REFINE} of its stable step",
    }
    print(f"{about['processor']}{', quick: coarse grids, one seed' if given.quick else ''}")
    rows: list[Row] = []
    for scene in tqdm(scenes, desc="mesh", disable=None):
        cases = [Case(scene, seed, coarse, REFINE) for seed in seeds]
        for starts in (STARTS, (0,)):
            rows += measure(gather(cases, starts, max(HORIZONS), cache_folder(given.cache)))
    print(table(rows))
    if given.out:
        given.out.mkdir(parents=True, exist_ok=True)
        write_rows(given.out / "mesh_error.csv", rows)
        (given.out / "mesh_error.json").write_text(json.dumps(about, indent=2))
        print(f"rows in {given.out / 'mesh_error.csv'}")
    return 0
