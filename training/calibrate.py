"""Fit the calibrated miniature and the closure: ``python -m training.calibrate --scaling calibrated|closure``.

Factors of the material are fitted so that short windows of the coarse cloth, started from decimated truth, end where
that does. A closure starts from the calibrated factors. What the file holds already is kept.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from cloth_envs.files import check_folder, read_json, write_text
from cloth_envs.machine import header
from cloth_envs.parsing import Parser
from cloth_envs.progress import progress
from cloth_envs.registry import SCENES
from cloth_envs.resample import resample
from surrogates.miniature.closure import CLOSURE, FACTORS, load_factors
from surrogates.miniature.coarse import CoarsePhysics
from training.cache import cache_folder
from training.command import add_out, plan
from training.rollouts import Recording, replay, stack_controls, stack_states
from training.rows import read_names
from training.truth import Case, load

HORIZONS = {"calibrated": 5, "closure": 10}  # frames of a window
NAMES = {"calibrated": FACTORS, "closure": CLOSURE}
SPACING = 10  # frames from one window to the next
# A closure takes at most the calibrated cloth's substeps and so many times (--substeps) the similar one's; as many
# beyond cost SUBSTEPS_PRICE of the loss.
MOST_SUBSTEPS, SUBSTEPS_PRICE = 1.3, 2.0
FIT_SEEDS, HELD_OUT_SEEDS = (100, 101, 102, 103), (200, 201, 202)
SETTLE = 0.5  # s of the episode before the first window
WINDOWS = 8  # of every seed
# Decimated folds push a cloth apart by their shortened edges; a fit without bounds escapes to all mass and no spring.
BOUNDS = {
    "areal_density": (0.8, 1.25),
    "stretch_stiffness": (0.5, 2.0),
    "shear_stiffness": (0.1, 2.0),
    "bend_stiffness": (0.1, 10.0),
    "damping": (0.1, 4.0),
    "compression": (0.01, 1.0),
}
CLOSURE_BOUNDS = BOUNDS | {
    "stretch_stiffness": (0.4, 2.5),
    "shear_stiffness": (0.1, 2.5),
    "compression": (0.002, 1.0),
    "buckling_strain": (0.005, 0.3),
    "post_buckling": (0.01, 1.0),
    "compression_damping": (1.0, 100.0),
}
CLOSURE_START = {"damping": 1.0, "buckling_strain": 0.03, "post_buckling": 0.3, "compression_damping": 4.0}


def windows(scene: str, seeds: Sequence[int], horizon: int, folder: Path) -> Recording:
    """Windows of ``horizon`` frames of all ``seeds``, one after the other along the batch."""
    first = round(SETTLE / Case(scene).world().scene.frame_dt)
    starts = [first + SPACING * k for k in range(WINDOWS)]
    keep = [start + frame for start in starts for frame in range(horizon + 1)]
    todo = progress(seeds, f"{scene}, truths", unit="run")
    truths = [load(Case(scene, seed), max(keep), keep, folder) for seed in todo]
    at = [(truth, start) for truth in truths for start in starts]
    states = {k: stack_states([truth.states[start + k] for truth, start in at]) for k in range(horizon + 1)}
    controls = [stack_controls([truth.controls[start + k] for truth, start in at]) for k in range(horizon)]
    return Recording(truths[0].scene, states, controls, [], [])


def errors(data: Recording, factor: int, **options: Any) -> tuple[np.ndarray, int]:
    """Mean vertex error to decimated truth, ``(frames, windows)``, of the cloth's length; and the substeps."""
    coarse, found = CoarsePhysics(data.scene, num_envs=data.states[0].batch, factor=factor, **options), []
    for frame, (state, _) in enumerate(replay(coarse, data.states[0], data.controls), 1):
        gap = state.positions - resample(data.states[frame].positions, data.scene.grid, coarse.scene.grid)
        found.append(np.sqrt((gap**2).sum(1)).mean((1, 2)) / data.scene.grid.length)
    return np.array(found), int(coarse.solver.substeps[0])  # type: ignore[attr-defined]


def fit(data: Recording, factor: int, scaling: str, evaluations: int, most: float) -> dict[str, float]:
    """Factors within bounds that make the windows' mean error over all frames least (Nelder-Mead, logarithms).

    The closure's errors are those over the calibrated one's of the same frame, so that the first frame counts too.
    """
    names = [n for n in NAMES[scaling] if getattr(data.scene.material, n) > 0]
    begin, limits, base, usual, price = {"compression": 0.3}, BOUNDS, np.ones(1), 1.0, 0.0
    if scaling == "closure":
        calibrated = load_factors(data.scene.name, factor)
        begin, limits, price = calibrated | CLOSURE_START, CLOSURE_BOUNDS, SUBSTEPS_PRICE
        found, own = errors(data, factor, scaling=scaling, factors=calibrated)
        base, usual = found.mean(1), min(own, most * errors(data, factor, scaling="similar")[1])
    bounds = np.log([limits[name] for name in names])
    start = np.log([begin.get(name, 1.0) for name in names]).clip(*bounds.T)

    def loss(logs: np.ndarray) -> float:
        factors = dict(zip(names, np.exp(logs).tolist(), strict=True))
        found, substeps = errors(data, factor, scaling=scaling, factors=factors)
        return float((found.mean(1) / base).mean()) + price * max(0.0, substeps / usual - 1)

    simplex = np.concatenate([start[None], start + 0.4 * np.diag(np.where(start >= bounds[:, 1] - 0.4, -1, 1))])
    options = {"maxfev": evaluations, "initial_simplex": simplex.clip(*bounds.T), "xatol": 0.01, "fatol": 1e-7}
    best = minimize(loss, start, method="Nelder-Mead", bounds=bounds, options={**options, "adaptive": True})
    return dict(zip(names, np.exp(best.x).round(4).tolist(), strict=True))


def card(data: Recording, factor: int, scaling: str, factors: dict[str, float]) -> dict[str, Any]:
    """Errors in % of the cloth's length after 1, 5 and (a closure) 10 frames, and substeps, of every scaling."""
    entry = {}
    for kind in ["similar", *(["calibrated"] if scaling == "closure" else []), scaling]:
        found, substeps = errors(data, factor, scaling=kind, factors=factors if kind == scaling else None)
        mean = {str(k): round(100 * float(found[k - 1].mean()), 4) for k in (1, 5, 10) if k <= len(found)}
        entry[kind] = {**mean, "substeps": substeps}
    return entry


def main(argv: Sequence[str] | None = None) -> int:
    """Fit what the file lacks. Returns the exit code."""
    parser = Parser(prog="python -m training.calibrate", description=__doc__)
    parser.add_argument("--scaling", choices=list(HORIZONS), default="calibrated")
    parser.add_argument("--scenes", nargs="*", default=list(SCENES))
    parser.add_argument("--factors", nargs="*", type=int, default=[2, 3, 4])
    parser.add_argument("--evaluations", type=int, default=200, help="of the loss, per fit")
    parser.add_argument("--substeps", type=float, default=MOST_SUBSTEPS, help="of a closure, over the similar cloth's")
    add_out(parser, Path("weights"))
    options = parser.parse_args(argv)
    scaling = options.scaling
    out = check_folder(options.out) / f"{scaling}.json"
    scenes = read_names(",".join(options.scenes), list(SCENES), "scene")
    fits = f"at factors {', '.join(map(str, options.factors))}, {options.evaluations} evaluations a fit"
    plan(scaling, f"{', '.join(scenes)} {fits}", out, cache_folder("truth"))
    known = read_json(out, "scenes", remedy="restore or remove it") if out.is_file() else {"scenes": {}}
    for scene in scenes:
        done = known["scenes"].setdefault(scene, {})
        wanted = [factor for factor in options.factors if str(factor) not in done]
        seeds = {"fitted": FIT_SEEDS, "held out": HELD_OUT_SEEDS} if wanted else {}
        data = {what: windows(scene, some, HORIZONS[scaling], cache_folder("truth")) for what, some in seeds.items()}
        for factor in progress(wanted, scene, unit="factor", name=str):
            factors = fit(data["fitted"], factor, scaling, options.evaluations, options.substeps)
            told = {what: card(part, factor, scaling, factors) for what, part in data.items()}
            done[str(factor)] = {
                "factors": factors,
                **{f"{kind}, {what}": found for what, entry in told.items() for kind, found in entry.items()},
                "fit": {"evaluations": options.evaluations, "substeps": options.substeps},
            }
            known["about"] = {
                "errors": "mean vertex error of the coarse cloth, % of the cloth's length, after so many frames",
                "fit seeds": FIT_SEEDS,
                "held-out seeds": HELD_OUT_SEEDS,
                "windows a seed": WINDOWS,
                "truth": "explicit, float64, a quarter of the stable step",
                **header(),
            }
            write_text(out, json.dumps(known, indent=1) + "\n")
            print("wrote", out, scene, factor, json.dumps(done[str(factor)]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
