"""A comparison as rows: CSV for machines, Markdown for people."""

import csv
import os
from pathlib import Path

import numpy as np

from cloth_envs.commands.measure import REPEATS, Comparison
from cloth_envs.files import replacing
from cloth_envs.machine import processor


def machine() -> str:
    """The processor and that one thread of it was used."""
    return f"{processor()}, 1 thread of {os.cpu_count()}"


def percent(values: np.ndarray) -> list[float]:
    """Means over the windows [%], NaN where any window failed."""
    return [float(100 * v) for v in values.mean(0)]


def write_csv(comparison: Comparison, path: Path) -> None:
    """Header and one row an entry, numbers unrounded."""
    header = ["entry", "backend", "rows", "cols", "backend_kwargs", "ms_median", "ms_q1", "ms_q3", "times_real_time"]
    header += [f"error_{h}_frames_percent" for h in comparison.horizons]
    header += [f"mean_height_{h}_frames_percent" for h in comparison.horizons]
    header += ["free_run_percent", "crossing_pairs_mean", "crossing_pairs_max", "failure"]
    body: list[list[object]] = [[*header]]
    for result in comparison.results:
        entry, (low, middle, high) = result.entry, result.ms
        row: list[object] = [entry.label, entry.backend, *entry.resolution, dict(entry.backend_kwargs)]
        row += [middle, low, high, comparison.scene.frame_dt * 1e3 / middle]
        row += [*percent(result.errors), *percent(result.heights), 100 * result.divergence]
        row += [result.crossings.mean(), result.crossings.max(), result.failure or ""]
        body.append(row)
    with replacing(path) as part, part.open("w", newline="") as file:
        csv.writer(file).writerows(body)


CNN = (
    "cnn: the cell of Zhao 2024 has found the reference's law, so on sheets its frames are the reference's to the bit. "
    "Take it for gradients and forces of your own in torch (engine torch), or to check the paper; not for speed.\n"
)


def notes(comparison: Comparison, setup: str) -> str:
    """What the numbers mean."""
    scene, truth = comparison.scene, comparison.truth
    rows_, cols = truth.resolution
    starts = ", ".join(map(str, comparison.starts))
    return (
        f"{setup}. {machine()}.\n"
        f"Time: physics only, median and quartiles over all frames of {REPEATS} runs. "
        f"Error: mean distance of the vertices from the truth, in % of the cloth's longer side "
        f"({max(scene.grid.height, scene.grid.width):g} m), after restarts from the truth at frames {starts} (mean); "
        "coarse cloths are interpolated to the full grid. Height: the same for the mean height. A coarse grid can't "
        "hold folds finer than its cells: restarted from a folded truth its edges begin compressed and spring out, "
        "which counts as error.\n"
        f"Truth: {truth.backend} at {rows_}x{cols} in float64 at a quarter of the step.\n"
        "Free run: mean over the whole run from the common start. Cloth is chaotic: this and the longer horizons "
        "measure how fast runs part, not how good either is.\n"
        "Crossing pairs: of the cloth's own triangles that pass through each other, mean and most over the frames of "
        "the free run.\n"
        + "".join(f"{one} has the errors of {other}, to the bit.\n" for one, other in comparison.twins.items())
        + (CNN if any(result.entry.backend == "cnn" for result in comparison.results) else "")
    )


def short(value: float) -> str:
    """Two digits, or a dash for what a failure left out."""
    return f"{value:.2g}" if np.isfinite(value) else "-"


def markdown(comparison: Comparison) -> str:
    """The table, its columns aligned as text, numbers to the right."""
    horizons = comparison.horizons
    header = ["entry", "ms/frame (quartiles)", "x real time", *(f"error {h} fr. %" for h in horizons)]
    header += [f"height {horizons[-1]} fr. %", "free run %", "crossing pairs (max)"]
    failed = any(result.failure for result in comparison.results)
    lines = [header + (["failure"] if failed else [])]
    for result in comparison.results:
        low, middle, high = result.ms
        line = [result.entry.label, f"{middle:.3g} ({low:.3g}-{high:.3g})"]
        line += [f"{comparison.scene.frame_dt * 1e3 / middle:.0f}", *map(short, percent(result.errors))]
        line += [short(percent(result.heights)[-1]), short(100 * result.divergence)]
        line += [f"{result.crossings.mean():.3g} ({result.crossings.max()})"]
        lines.append(line + ([result.failure or ""] if failed else []))
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    rows = [[c.rjust(w) for c, w in zip(line, widths, strict=True)] for line in (lines[0], rule, *lines[1:])]
    return "\n".join(f"| {' | '.join([row[0].strip().ljust(widths[0]), *row[1:]])} |" for row in rows)
