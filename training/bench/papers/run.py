"""``minicloth bench tables``: the papers' own tables, ours beside theirs.

Lee, Oh & Lee 2019: here the parts that need no network: 4 (down-sampling factor), 6 (interpolation) and 8 (time);
``published`` has those that do, and the figures. Errors are the mean distance of the particles from those of the
teacher, P-ADMM with 10 iterations at full resolution, over the first frames of preset "lee2019" with zero actions. That
is agreement with a teacher, not accuracy. "Oracle" upscales the teacher's own decimated positions, "real" a real
miniature run. ``--cell`` is table 2 of Zhao 2024 (``cell``), ``--large-step`` what a larger step would cost.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence

import numpy as np
from tqdm import tqdm

from cloth_envs.presets import solver_of
from cloth_envs.resample import Resampler, resample
from surrogates.checkpoint import load
from surrogates.miniature.coarse import coarse_grid
from surrogates.upscale.protocol import INTERPOLATIONS
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.papers import cell, large_step, pictures, published, rows
from training.bench.papers.chart import draw
from training.bench.papers.published import TABLE_4, TABLE_8
from training.bench.papers.runs import PRESET, by_frame, cloths, follow, shrunk, solver, teacher
from training.bench.participants import extra
from training.cell.data import STEPS
from training.rollouts import Recording
from training.upscaler.recipes import SCENES, work_folder

# The paper's: error, ms on its authors' machine.
TABLE_6 = {"bilinear": (1.826e-3, 17.7), "biquadratic": (1.825e-3, 17.7), "bicubic": (1.825e-3, 17.8)}


def oracle(run: Recording, factor: int, upscaler: str) -> np.ndarray:
    """The teacher's positions decimated and upscaled again, ``(T, 3, H, W)`` [m]."""
    fine, coarse = run.scene.grid, coarse_grid(run.scene.grid, factor)
    small = np.ascontiguousarray(resample(cloths(run), fine, coarse), np.float32)
    return Resampler(coarse, fine, INTERPOLATIONS[upscaler])(small)


def tables(frames: int, scenes: Sequence[str] = SCENES) -> Iterator[rows.TableRow]:
    """Table 4 with both scalings, table 6, table 8."""
    wanted = [(4, "Curtain", f, scaling, "bicubic") for f in TABLE_4 for scaling in ("seed", "similar")]
    wanted += [(6, "Curtain", 2, "similar", upscaler) for upscaler in TABLE_6]
    wanted += [(8, scene, 2, "similar", "bicubic") for scene in TABLE_8]
    runs = {scene: teacher(scene, frames) for scene in scenes}
    todo = [entry for entry in wanted if entry[1] in runs]
    for table, scene, factor, scaling, upscaler in tqdm(todo, desc="tables", disable=None):
        run = runs[scene]
        truth, teacher_seconds = follow(run, solver(run.scene))
        real, seconds = follow(run, shrunk(run.scene, factor, scaling=scaling, upscaler=upscaler))
        paper = {4: TABLE_4.get(factor), 6: TABLE_6.get(upscaler), 8: (np.nan, TABLE_8[scene][2])}[table]
        assert paper is not None
        yield rows.TableRow(
            table=table,
            scene=scene,
            factor=factor,
            scaling=scaling,
            upscaler=upscaler,
            frames=frames,
            oracle_error=float(by_frame(oracle(run, factor, upscaler), truth).mean()),
            real_error=float(by_frame(real, truth).mean()),
            ms=1e3 * float(np.median(seconds)),
            teacher_ms=1e3 * float(np.median(teacher_seconds)),
            paper_error=paper[0],
            paper_ms=paper[1],
            paper_teacher_ms=TABLE_8[scene][0],
        )


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
        session.store("cnn_large_step_bound").replace(large_step.bounds())
        session.store("cnn_large_step").replace(
            [row for scene in scenes for row in large_step.compare(scene, seeds, session.cache("truth"))]
        )
        return
    frames, count = (10, 0) if quick else (100, published.HELD_OUT)
    scenes, folder = [s for s in SCENES if s in session.scenes], work_folder() / "weights"
    published.fill(
        session.store("published"), session.store("published_frames"), scenes, extra(given.backend),
        frames=frames, count=count, folder=folder if folder.is_dir() else None,
    )  # fmt: skip
    if given.images:
        pictures.draw(given.images / "published_pictures.png")
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
        "tables": RowFile(rows.TableRow),
        "published": RowFile(rows.PublishedRow, rows.PUBLISHED_KEY),
        "published_frames": RowFile(rows.FrameErrorRow, rows.FRAME_KEY),
        "cnn": RowFile(rows.CellRow, rows.CELL_KEY),
        "cnn_speed": RowFile(rows.CellSpeedRow),
        "cnn_checks": RowFile(rows.CellCheckRow),
        "cnn_large_step": RowFile(rows.LargeStepRow),
        "cnn_large_step_bound": RowFile(rows.GrowthRow),
    },
    parts=[
        Part("Lee 2019, tables 4, 6 and 8", ("tables",), rows.table_text),
        Part("Lee 2019 with networks", ("published",), rows.published_text, "--networks"),
        Part("Zhao 2024, table 2", ("cnn", "cnn_speed", "cnn_checks"), rows.cell_text, "--cell"),
        Part(
            "Zhao 2024, a larger step by several cells",
            ("cnn_large_step", "cnn_large_step_bound"),
            rows.large_step_text,
            "--large-step",
        ),
    ],
    measure=measure,
    scenes=SCENES,
    known=tuple(dict.fromkeys((*SCENES, *large_step.SCENES))),
    charts={
        "published_frames": "Errors by frame: interpolation and networks beside the teacher (figures 9-12)",
        "published_variants": "Errors for other masses, springs and winds (figures 13-15)",
        "published_pictures": "The teacher's cloth beside those that it is compared with (figures 10-12, 15)",
    },
    draw=draw,
    options=_options,
)
