"""``minicloth bench tables``: the papers' own tables, ours beside theirs.

Here those of Lee, Oh & Lee 2019 that need no network: 4 (down-sampling factor), 6 (interpolation) and 8 (time). Errors
are mean distances from the teacher over the first frames of preset "lee2019" with zero actions: agreement, not
accuracy. "Oracle" upscales the teacher's own decimated positions, "real" a real miniature run.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from cloth_envs.presets import solver_of
from cloth_envs.progress import progress
from cloth_envs.resample import Resampler, resample
from surrogates.checkpoint import load
from surrogates.miniature.coarse import coarse_grid
from surrogates.upscale.protocol import INTERPOLATIONS
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.papers import cell, chart, large_step, published
from training.bench.papers.published import TABLE_4, TABLE_8
from training.bench.papers.runs import PRESET, by_frame, cloths, follow, shrunk, solver, teacher
from training.bench.participants import extra
from training.cell.data import STEPS
from training.upscaler.recipes import SCENES, work_folder


@dataclass(frozen=True)
class TableRow:
    """One miniature on one scene: errors [m], and medians of the processor's time for a frame, upscaling included."""

    table: int
    scene: str
    factor: int
    scaling: str
    upscaler: str
    frames: int
    oracle_error: float
    real_error: float
    ms: float
    teacher_ms: float
    paper_error: float
    paper_ms: float
    paper_teacher_ms: float


# The paper's: error, ms on its authors' machine.
TABLE_6 = {"bilinear": (1.826e-3, 17.7), "biquadratic": (1.825e-3, 17.7), "bicubic": (1.825e-3, 17.8)}


def tables(frames: int, scenes: Sequence[str] = SCENES) -> Iterator[TableRow]:
    """Table 4 with both scalings, table 6, table 8."""
    wanted = [(4, "Curtain", f, scaling, "bicubic") for f in TABLE_4 for scaling in ("seed", "similar")]
    wanted += [(6, "Curtain", 2, "similar", upscaler) for upscaler in TABLE_6]
    wanted += [(8, scene, 2, "similar", "bicubic") for scene in TABLE_8]
    runs = {scene: teacher(scene, frames) for scene in scenes}
    todo = [entry for entry in wanted if entry[1] in runs]
    for table, scene, factor, scaling, upscaler in progress(todo, "tables", unit="run"):
        run = runs[scene]
        truth, teacher_seconds = follow(run, solver(run.scene))
        real, seconds = follow(run, shrunk(run.scene, factor, scaling=scaling, upscaler=upscaler))
        fine, coarse = run.scene.grid, coarse_grid(run.scene.grid, factor)
        small = np.ascontiguousarray(resample(cloths(run), fine, coarse), np.float32)
        off = [by_frame(x, truth).mean() for x in (Resampler(coarse, fine, INTERPOLATIONS[upscaler])(small), real)]
        ms = [1e3 * np.median(taken) for taken in (seconds, teacher_seconds)]
        paper = {4: TABLE_4.get(factor), 6: TABLE_6.get(upscaler), 8: (np.nan, TABLE_8[scene][2])}[table]
        assert paper is not None
        measured = map(float, (*off, *ms, *paper, TABLE_8[scene][0]))
        yield TableRow(table, scene, factor, scaling, upscaler, frames, *measured)


def table(rows: Sequence[TableRow]) -> str:
    """A line for each miniature."""
    lines = []
    for number in (4, 6, 8):
        lines += [f"\nTable {number}: error [m] and ms a frame; speed-up over P-ADMM at full resolution"]
        lines += [f"{'':34s}{'oracle':>9s}{'real':>9s}{'paper':>9s}{'ms':>8s}{'paper':>7s}{'x':>6s}{'paper':>7s}"]
        for r in (row for row in rows if row.table == number):
            name = f"{r.scene} s={r.factor} {r.scaling} {r.upscaler}"
            lines.append(
                f"{name:34s}{r.oracle_error:9.1e}{r.real_error:9.1e}{r.paper_error:9.1e}{r.ms:8.3f}{r.paper_ms:7.1f}"
                f"{r.teacher_ms / r.ms:6.1f}{r.paper_teacher_ms / r.paper_ms:7.1f}"
            )
    return "\n".join(lines)


def measure(session: Session) -> None:
    """What is asked for: all of Lee 2019, or its part with networks, or Zhao 2024, or the larger step."""
    given, quick, asked = session.given, session.quick, session.given.scenes is not None
    session.about |= {
        "threads": 1,
        "teacher": solver_of(PRESET),
        "large_step": {"seeds": large_step.SEEDS, "start": large_step.START},
        "cells": {name: load(name).card["sha256"] for name in cell.CELLS},
    }
    if given.cell:
        cell.score(session.store("cnn"), STEPS // 10 if quick else STEPS)
        session.store("cnn_speed").replace(cell.speeds(5 if quick else 20))
        session.store("cnn_checks").replace(cell.checks(3 if quick else 10))
        return
    if given.large_step:
        scenes = [s for s in large_step.SCENES if s in session.scenes or not asked]
        seeds = large_step.SEEDS[:1] if quick else large_step.SEEDS
        steps = product(large_step.RATIOS, large_step.CELLS)
        bound = [large_step.GrowthRow(ratio, cells, large_step.growth(ratio, cells)) for ratio, cells in steps]
        found = [row for scene in scenes for row in large_step.compare(scene, seeds, session.cache("truth"))]
        session.store("cnn_large_step_bound").replace(bound)
        session.store("cnn_large_step").replace(found)
        return
    frames, count = (10, 0) if quick else (100, published.HELD_OUT)
    scenes, folder = [s for s in SCENES if s in session.scenes], work_folder() / "weights"
    published.fill(
        session.store("published"), session.store("published_frames"), scenes, extra(given.backend),
        frames=frames, count=count, folder=folder if folder.is_dir() else None,
    )  # fmt: skip
    if given.images:
        chart.pictures(given.images / "published_pictures.png")
    if not given.networks:
        session.store("tables").replace(list(tables(frames, scenes)))


def _options(parser: argparse.ArgumentParser) -> None:
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--networks", action="store_true", help="of Lee 2019 only what needs networks")
    which.add_argument("--cell", action="store_true", help="only table 2 of Zhao 2024, the physics-embedded CNN")
    which.add_argument("--large-step", action="store_true", help="only what a step of several cells would cost")


BENCHMARK = Benchmark(
    name="tables",
    about="The tables of Lee 2019 and Zhao 2024, ours beside theirs.",
    files={
        "tables": RowFile(TableRow),
        "published": RowFile(published.PublishedRow, published.PUBLISHED_KEY),
        "published_frames": RowFile(published.FrameErrorRow, published.FRAME_KEY),
        "cnn": RowFile(cell.CellRow, cell.CELL_KEY),
        "cnn_speed": RowFile(cell.CellSpeedRow),
        "cnn_checks": RowFile(cell.CellCheckRow),
        "cnn_large_step": RowFile(large_step.LargeStepRow),
        "cnn_large_step_bound": RowFile(large_step.GrowthRow),
    },
    parts=[
        Part("Lee 2019, tables 4, 6 and 8", ("tables",), table),
        Part("Lee 2019 with networks", ("published",), published.table, "--networks"),
        Part("Zhao 2024, table 2", ("cnn", "cnn_speed", "cnn_checks"), cell.table, "--cell"),
        Part("Zhao 2024, a larger step", ("cnn_large_step", "cnn_large_step_bound"), large_step.table, "--large-step"),
    ],
    measure=measure,
    scenes=SCENES,
    known=tuple(dict.fromkeys((*SCENES, *large_step.SCENES))),
    charts={
        "published_frames": "Errors by frame: interpolation and networks beside the teacher (figures 9-12)",
        "published_variants": "Errors for other masses, springs and winds (figures 13-15)",
        "published_pictures": "The teacher's cloth beside those that it is compared with (figures 10-12, 15)",
    },
    draw=chart.draw,
    options=_options,
)
