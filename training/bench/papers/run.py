"""``minicloth bench tables``: the tables of Lee, Oh & Lee 2019 (seed 000), ours beside the paper's.

Here the parts that need no network: 4 (down-sampling factor), 6 (interpolation) and 8 (time); ``published`` has those
that do, and the figures. Errors are the mean distance of the particles from those of the teacher, P-ADMM with 10
iterations at full resolution, over the first frames of preset "lee2019" with zero actions. That is agreement with a
teacher, not accuracy. "Oracle" upscales the teacher's own decimated positions, "real" a real miniature run.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from tqdm import tqdm

from cloth_envs.machine import header
from cloth_envs.resample import Resampler, resample
from cloth_envs.world import World
from surrogates.miniature.coarse import coarse_grid
from surrogates.upscale.protocol import INTERPOLATIONS
from training.bench.papers import cell as cnn
from training.bench.papers import published, published_chart, published_pictures
from training.bench.throughput.run import write_rows
from training.recipes.upscaler import work_folder
from training.rows import Store

TEACHER = {"solver": "admm", "iterations": 10}
SCENES = ("Curtain", "Flag", "Collision")
# The paper's figures: error, ms on its authors' machine. Its own method is the miniature with a network.
TABLE_4 = {2: (1.816e-3, 37.5), 3: (2.916e-3, 19.1), 4: (3.901e-3, 16.2)}
TABLE_6 = {"bilinear": (1.826e-3, 17.7), "biquadratic": (1.825e-3, 17.7), "bicubic": (1.825e-3, 17.8)}
TABLE_8 = {"Curtain": (72.8, 37.5), "Flag": (33.2, 18.1), "Collision": (50.2, 33.2)}


@dataclass(frozen=True)
class Row:
    """One miniature on one scene. Errors in metres; ``ms`` are medians of a frame, upscaling included."""

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


def run(scene: str, frames: int, backend: str, options: dict[str, Any]) -> tuple[World, np.ndarray, float]:
    """Positions ``(frames, 3, H, W)`` of a run with zero actions, and the median time of a frame [ms]."""
    world = World(scene, backend=backend, backend_kwargs=options, preset="lee2019")
    world.reset({0: np.random.default_rng(0)})
    assert world.episode is not None
    positions, times = [], []
    for _ in range(frames):
        controls = world.task.controls(world.episode)
        start = perf_counter()
        state = world.backend.advance(controls)
        positions.append(state.positions[0].copy())
        state.velocities  # noqa: B018  a lazy backend infers them now
        times.append(perf_counter() - start)
        world.episode.state = state
    return world, np.array(positions), float(np.median(times)) * 1e3


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Mean distance of the vertices of two runs ``(T, 3, H, W)`` [m]."""
    return float(np.sqrt(((a.astype(np.float64) - b) ** 2).sum(1)).mean())


def oracle(world: World, positions: np.ndarray, factor: int, upscaler: str) -> np.ndarray:
    """``positions`` decimated and upscaled again."""
    fine, coarse = world.scene.grid, coarse_grid(world.scene.grid, factor)
    small = np.ascontiguousarray(resample(positions, fine, coarse), np.float32)
    return Resampler(coarse, fine, INTERPOLATIONS[upscaler])(small)


def rows(frames: int) -> Iterator[Row]:
    """Table 4 with both scalings, table 6, table 8."""
    wanted = [(4, "Curtain", f, scaling, "bicubic") for f in TABLE_4 for scaling in ("seed", "similar")]
    wanted += [(6, "Curtain", 2, "similar", upscaler) for upscaler in TABLE_6]
    wanted += [(8, scene, 2, "similar", "bicubic") for scene in SCENES]
    for table, scene, factor, scaling, upscaler in tqdm(wanted, desc="tables", disable=None):
        world, teacher, teacher_ms = run(scene, frames, "reference", TEACHER)
        inner = {"solver": "admm", "solver_kwargs": {"iterations": TEACHER["iterations"]}}
        options = {"factor": factor, "scaling": scaling, "upscaler": upscaler, **inner}
        _, real, ms = run(scene, frames, "miniature", options)
        paper = {4: TABLE_4.get(factor), 6: TABLE_6.get(upscaler), 8: (np.nan, TABLE_8[scene][1])}[table]
        assert paper is not None
        yield Row(
            table=table,
            scene=scene,
            factor=factor,
            scaling=scaling,
            upscaler=upscaler,
            frames=frames,
            oracle_error=distance(oracle(world, teacher, factor, upscaler), teacher),
            real_error=distance(real, teacher),
            ms=ms,
            teacher_ms=teacher_ms,
            paper_error=paper[0],
            paper_ms=paper[1],
            paper_teacher_ms=TABLE_8[scene][0],
        )


def text(found: list[Row]) -> str:
    """The tables for people."""
    lines = []
    for table in (4, 6, 8):
        lines += [f"\nTable {table}: error [m] and ms a frame; speed-up over P-ADMM at full resolution"]
        lines += [f"{'':34s}{'oracle':>9s}{'real':>9s}{'paper':>9s}{'ms':>8s}{'paper':>7s}{'x':>6s}{'paper':>7s}"]
        for r in (row for row in found if row.table == table):
            name = f"{r.scene} s={r.factor} {r.scaling} {r.upscaler}"
            lines.append(
                f"{name:34s}{r.oracle_error:9.1e}{r.real_error:9.1e}{r.paper_error:9.1e}{r.ms:8.3f}{r.paper_ms:7.1f}"
                f"{r.teacher_ms / r.ms:6.1f}{r.paper_teacher_ms / r.paper_ms:7.1f}"
            )
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="minicloth bench tables", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="10 frames instead of 100; says that it is quick")
    parser.add_argument("--out", type=Path, help="folder of tables.csv, published.csv (kept and completed) and .json")
    parser.add_argument("--images", type=Path, help="folder for the charts")
    parser.add_argument("--networks", action="store_true", help="only what needs networks")
    parser.add_argument("--cell", action="store_true", help="only table 2 of Zhao 2024, the physics-embedded CNN")
    options = parser.parse_args(argv)
    if options.cell:
        return cnn.main([*(["--quick"] * options.quick), *(["--out", str(options.out)] if options.out else [])])
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
    networks(options)
    if options.networks:
        return 0
    found = list(rows(10 if options.quick else 100))
    print(text(found) + ("\n(quick)" if options.quick else ""))
    if options.out:
        write_rows(options.out / "tables.csv", found)
        about = {**header(), "quick": options.quick, "teacher": TEACHER, "threads": 1}
        (options.out / "tables.json").write_text(json.dumps(about, indent=2) + "\n")
    return 0


def networks(options: argparse.Namespace) -> None:
    """The part with networks: rows, tables for people, charts."""
    out = options.out
    store = Store(out and out / "published.csv", published.Row, published.KEY)
    points = Store(out and out / "published_frames.csv", published.Point, published.POINT_KEY)
    extra = work_folder() / "weights"
    frames, count = (10, 0) if options.quick else (100, published.HELD_OUT)
    published.measure(store, points, frames=frames, count=count, extra=extra if extra.is_dir() else None)
    print(published.text(store.rows))
    if out:
        about = {**header(), "quick": options.quick, "teacher": TEACHER, "threads": 1}
        (out / "published.json").write_text(json.dumps(about, indent=2) + "\n")
    if options.images:
        published_pictures.draw(options.images / "published_pictures.png")
        charts: Any = {"frames": (published_chart.frames, points), "variants": (published_chart.variants, store)}
        for name, (draw, what) in charts.items():
            draw(what.rows, [options.images / f"published_{name}.{kind}" for kind in ("png", "svg")])
