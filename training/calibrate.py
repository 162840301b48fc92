"""Fit the calibrated miniature: ``python -m training.calibrate``.

A few material factors per scene and grid factor are fitted so that short windows of the coarse cloth, started from
decimated truth, end where the decimated truth does. Resumable: what the file holds already is kept.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize
from tqdm import tqdm

from cloth_envs.machine import header
from cloth_envs.naming import unknown_name
from cloth_envs.registry import SCENES
from cloth_envs.resample import resample
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.coarse import FACTORS, coarse_grid
from surrogates.miniature import MiniatureBackend
from training.bench.truth import Case, cache_folder, length, load

HORIZON = 5  # frames of a window
FIT_SEEDS, HELD_OUT_SEEDS = (100, 101, 102, 103), (200, 201, 202)
SETTLE = 0.5  # s of the episode before the first window
WINDOWS = 8  # of every seed
# Bounds of the factors. A cloth that starts from decimated folds is pushed apart by its shortened edges; left free, a
# fit escapes to cloth that is all mass and no spring, which goes straight on for five frames and sags after that.
BOUNDS = {
    "areal_density": (0.8, 1.25),
    "stretch_stiffness": (0.5, 2.0),
    "shear_stiffness": (0.1, 2.0),
    "bend_stiffness": (0.1, 10.0),
    "damping": (0.1, 4.0),
    "compression": (0.01, 1.0),
}
OUT = Path(__file__).parents[1] / "surrogates" / "weights" / "calibrated.json"


@dataclass(frozen=True)
class Windows:
    """A batch of short windows of truth: ``start``, the ``controls`` of every frame, positions ``ends`` after each."""

    scene: Scene
    start: State
    controls: list[Controls]
    ends: list[np.ndarray]


def windows(scene: str, seeds: Sequence[int], folder: Path) -> Windows:
    """Windows of all ``seeds``, one after the other along the batch."""
    parts: list[tuple[State, list[Controls], list[np.ndarray]]] = []
    for seed in seeds:
        case = Case(scene, seed)
        described = case.world().scene
        first = round(SETTLE / described.frame_dt)
        starts = [first + 2 * HORIZON * k for k in range(WINDOWS)]
        keep = [start + frame for start in starts for frame in range(HORIZON + 1)]
        truth = load(case, max(keep), keep, folder)
        for at in starts:
            ends = [truth.states[at + frame].positions for frame in range(1, HORIZON + 1)]
            parts.append((truth.states[at], truth.controls[at : at + HORIZON], ends))
    start = State(**{n: np.concatenate([part[0].arrays()[n] for part in parts]) for n in parts[0][0].arrays()})
    controls = [
        Controls(**{n: np.concatenate([vars(part[1][frame])[n] for part in parts]) for n in vars(parts[0][1][0])})
        for frame in range(HORIZON)
    ]
    ends = [np.concatenate([part[2][frame] for part in parts]) for frame in range(HORIZON)]
    return Windows(described, start, controls, ends)


def errors(data: Windows, factor: int, **options: Any) -> np.ndarray:
    """Mean vertex error of the coarse cloth against decimated truth, ``(frames, windows)``, of the cloth's length."""
    backend = MiniatureBackend(data.scene, num_envs=data.start.batch, factor=factor, **options)
    backend.reset(data.start)
    grid, found = coarse_grid(data.scene.grid, factor), []
    for controls, end in zip(data.controls, data.ends, strict=True):
        backend.advance(controls)
        gap = backend.coarse.state.positions - resample(end, data.scene.grid, grid)
        found.append(np.sqrt((gap**2).sum(1)).mean((1, 2)) / length(data.scene))
    return np.array(found)


def fit(data: Windows, factor: int, evaluations: int) -> dict[str, float]:
    """Factors within ``BOUNDS`` that make the windows' mean error over all frames least (Nelder-Mead, logarithms)."""
    names = [n for n in FACTORS if getattr(data.scene.material, n) > 0]
    bounds = np.log([BOUNDS[name] for name in names])
    with tqdm(total=evaluations, desc=f"{data.scene.name} 1/{factor}", disable=None) as bar:

        def loss(logs: np.ndarray) -> float:
            bar.update()
            factors = dict(zip(names, np.exp(logs).tolist(), strict=True))
            return float(errors(data, factor, scaling="calibrated", factors=factors).mean())

        start = np.log([0.3 if name == "compression" else 1.0 for name in names])
        simplex = np.concatenate([start[None], start + 0.4 * np.diag(np.where(start == bounds[:, 1], -1, 1))])
        options = {"maxfev": evaluations, "initial_simplex": simplex.clip(*bounds.T), "xatol": 0.01, "fatol": 1e-7}
        best = minimize(loss, start, method="Nelder-Mead", bounds=bounds, options={**options, "adaptive": True})
    return dict(zip(names, np.exp(best.x).round(4).tolist(), strict=True))


def card(fitted: Windows, held_out: Windows, factor: int, factors: dict[str, float]) -> dict[str, Any]:
    """The factors with their errors in % of the cloth's length, after 1 frame and after ``HORIZON``."""
    entry: dict[str, Any] = {"factors": factors}
    for name, data in (("fitted", fitted), ("held out", held_out)):
        for scaling in ("similar", "calibrated"):
            own = {"factors": factors} if scaling == "calibrated" else {}
            mean = 100 * errors(data, factor, scaling=scaling, **own).mean(1)
            entry[f"{scaling}, {name}"] = {"1": round(float(mean[0]), 4), str(HORIZON): round(float(mean[-1]), 4)}
    return entry


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m training.calibrate", description=__doc__)
    parser.add_argument("--scenes", nargs="*", default=list(SCENES))
    parser.add_argument("--factors", nargs="*", type=int, default=[2, 3, 4])
    parser.add_argument("--evaluations", type=int, default=200, help="of the loss, per fit")
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--fresh", action="store_true", help="fit again what the file holds already")
    options = parser.parse_args(argv)
    for scene in options.scenes:
        if scene not in SCENES:
            raise unknown_name("scene", scene, SCENES)
    known = json.loads(options.out.read_text()) if options.out.is_file() else {"scenes": {}}
    for scene in options.scenes:
        wanted = [f for f in options.factors if options.fresh or str(f) not in known["scenes"].get(scene, {})]
        if not wanted:
            continue
        fitted, held_out = (windows(scene, seeds, cache_folder()) for seeds in (FIT_SEEDS, HELD_OUT_SEEDS))
        for factor in wanted:
            entry = card(fitted, held_out, factor, fit(fitted, factor, options.evaluations))
            known["scenes"].setdefault(scene, {})[str(factor)] = entry
            known["about"] = {
                "errors": "mean vertex error of the coarse cloth, % of the cloth's length, after so many frames",
                "fit seeds": FIT_SEEDS,
                "held-out seeds": HELD_OUT_SEEDS,
                "windows a seed": WINDOWS,
                "evaluations": options.evaluations,
                "truth": "explicit, float64, a quarter of the stable step",
                **header(),
            }
            options.out.write_text(json.dumps(known, indent=1) + "\n")
            print(scene, factor, json.dumps(entry))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
