"""The chart of ``minicloth bench long-runs``: power over the reference's, by fineness of folds and by frequency."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.style import COLORS, INK
from training.bench.charts import SHADE, dress, grid, legend, save
from training.bench.long_runs.rows import FINE, SpectrumRow
from training.bench.participants import NUDGED
from training.metrics.spectra import BANDS

STEM, SPECTRA, REFERENCE = "long_runs", "long_runs_spectra", "reference"
KINDS = {"space": "fineness of folds [part of the Nyquist limit]", "time": "frequency of motion [Hz]"}
LINES = ("-", "--", "-.", ":")  # of one method on grids of different factors
LEAST, MOST = -30.0, 10.0  # dB; smoother and rougher folds are not drawn
NOTE = (
    "Power of the curvature along rows (left) and of the vertices' velocities (right) over the reference's, 0 dB where "
    "both are equal, mean of the kinds of action. Grey: the reference from nudged starts. Dotted: an eighth of the "
    "Nyquist limit."
)


def ratios(rows: Sequence[SpectrumRow], scene: str, kind: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Of every backend where the bands are and its power over the reference's [dB], mean over kinds of action."""
    mine = [r for r in rows if (r.scene, r.kind) == (scene, kind)]
    true = {(r.actions, r.at): r.power for r in mine if r.backend == REFERENCE}
    found: dict[str, dict[float, list[float]]] = {}
    for r in mine:
        if r.backend != REFERENCE and (r.actions, r.at) in true:
            found.setdefault(r.backend, {}).setdefault(r.at, []).append(10 * np.log10(r.power / true[r.actions, r.at]))
    return {
        name: (np.array(list(bands)), np.array([np.mean(values) for values in bands.values()]))
        for name, bands in found.items()
    }


def styles(backends: Sequence[str]) -> dict[str, dict[str, Any]]:
    """A colour for every method, and a line for each of its grid factors, which the label tells behind a cross."""
    members: dict[str, list[str]] = {}
    for name in backends:
        members.setdefault(name.split(" \u00d7")[0], []).append(name)
    return {
        name: {"color": COLORS[method % len(COLORS)], "ls": LINES[number % len(LINES)]}
        for method, names in enumerate(members.values())
        for number, name in enumerate(names)
    }


def draw(rows: Mapping[str, Sequence[Any]], folder: Path, setup: str) -> None:
    """One figure: a line of panels a scene, space and time."""
    found: Sequence[SpectrumRow] = rows.get(SPECTRA, [])
    scenes = list(dict.fromkeys(r.scene for r in found))
    if not scenes:
        return
    looks = styles([name for name in dict.fromkeys(r.backend for r in found) if name not in (REFERENCE, NUDGED)])
    figure, panels = grid(2 * len(scenes), "", panel=1.5)
    handles: dict[str, Any] = {}
    for axes, (scene, kind) in zip(panels, ((scene, kind) for scene in scenes for kind in KINDS), strict=True):
        axes.axhline(0, color=INK, lw=0.9, zorder=2)
        for name, (at, power) in ratios(found, scene, kind).items():
            if name == NUDGED:
                handles[name] = axes.fill_between(at, -abs(power), abs(power), color=SHADE, alpha=0.6, lw=0, zorder=1)
            else:
                handles[name] = axes.plot(at, power, zorder=3, lw=1.3, **looks[name])[0]
        if kind == "space":
            axes.axvline(FINE / BANDS, color=INK, ls=(0, (1, 2)), lw=0.9, zorder=2)
            axes.set_ylim(LEAST, MOST)
        axes.set_xlim(0)
        dress(axes, scene if kind == "space" else "")
        if scene == scenes[-1]:
            axes.set_xlabel(KINDS[kind], fontsize=7.5, color=INK)
    figure.supylabel("power over the reference's [dB]", fontsize=8.5, color=INK)
    legend(figure, handles, list(looks), "outside upper center", 4)
    save(figure, f"{setup}. {NOTE}", folder, STEM)
