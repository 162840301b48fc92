"""Fit the coarse sheet's material: ``python -m training.calibrate --scaling rule|calibrated|closure``.

Its properties are multiplied so that short windows of the coarse cloth, started from decimated truth under smooth,
random and bang-bang actions, end where that does and move as much: two numbers for all scenes (``rule``), or many for
each scene and grid factor. What the file holds already is kept.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from cloth_envs.files import check_folder, read_json, write_text
from cloth_envs.machine import header
from cloth_envs.parsing import Parser
from cloth_envs.physics.laws.sheet import kinetic_energy
from cloth_envs.progress import progress
from cloth_envs.registry import SCENES
from cloth_envs.resample import resample
from surrogates.miniature.closure import CLOSURE, FACTORS, RULE
from surrogates.miniature.coarse import CoarsePhysics
from training.cache import cache_folder
from training.command import add_out, plan
from training.rollouts import Recording, replay, stack_controls, stack_states
from training.rows import read_names
from training.truth import Case, load

NAMES = {"rule": RULE, "calibrated": FACTORS, "closure": CLOSURE}
SHOWN = (1, 5, 10)  # frames of the errors that cards tell; the last ends what is fitted
FRAMES = 25  # of a window; the motion is compared from the last of SHOWN on
SETTLE, WINDOWS, SPACING = 0.5, 3, 30  # s of an episode before the first of so many windows, and frames between two
FIT_SEEDS = {"smooth": (100, 101, 102, 103), "random": (104, 105), "bang-bang": (106, 107)}
HELD_OUT_SEEDS = {"smooth": (200, 201, 202), "random": (203, 204), "bang-bang": (205, 206)}
# Of the loss, beside the mean logarithm of the error: that of the kinetic energy, its size averaged over the policies.
MOTION = 0.5
# The cloth takes at most so many times (--substeps) the similar one's substeps; as many beyond cost SUBSTEPS_PRICE.
MOST_SUBSTEPS, SUBSTEPS_PRICE = 1.3, 2.0
# Decimated folds push a cloth apart by their shortened edges; a fit without bounds escapes to all mass and no spring.
BOUNDS = {
    "areal_density": (0.8, 1.25),
    "stretch_stiffness": (0.4, 2.5),
    "shear_stiffness": (0.1, 2.5),
    "bend_stiffness": (0.1, 10.0),
    "damping": (0.1, 4.0),
    "compression": (0.002, 1.0),
    "buckling_strain": (0.005, 0.3),
    "post_buckling": (0.01, 1.0),
    "compression_damping": (1.0, 100.0),
}
START = {"compression": 0.02, "buckling_strain": 0.03, "post_buckling": 0.3, "compression_damping": 4.0}


@dataclass(frozen=True)
class Sample:
    """Windows of a scene one after the other along the batch, and the policy that each is of."""

    run: Recording
    policies: np.ndarray


def windows(scene: str, seeds: Mapping[str, Sequence[int]], folder: Path) -> Sample:
    """Windows of ``FRAMES`` frames of all ``seeds`` of every policy."""
    first = round(SETTLE / Case(scene).world().scene.frame_dt)
    starts = [first + SPACING * k for k in range(WINDOWS)]
    keep = [start + frame for start in starts for frame in range(FRAMES + 1)]
    cases = [Case(scene, seed, actions=policy) for policy, some in seeds.items() for seed in some]
    truths = [load(case, max(keep), keep, folder) for case in progress(cases, f"{scene}, truths", unit="run")]
    at = [(truth, start) for truth in truths for start in starts]
    states = {k: stack_states([truth.states[start + k] for truth, start in at]) for k in range(FRAMES + 1)}
    controls = [stack_controls([truth.controls[start + k] for truth, start in at]) for k in range(FRAMES)]
    policies = np.repeat([case.actions for case in cases], WINDOWS)
    return Sample(Recording(truths[0].scene, states, controls, [], []), policies)


@dataclass(frozen=True)
class Found:
    """Of a coarse cloth: mean vertex distances from decimated truth, kinetic energy over the truth's, and substeps.

    Errors are of the cloth's length ``(frames, windows)``, ``motion`` is of every policy.
    """

    errors: np.ndarray
    motion: dict[str, float]
    substeps: int


def follow(sample: Sample, factor: int, **options: Any) -> Found:
    """Run the windows; ``options`` are those of ``CoarsePhysics``."""
    run, first = sample.run, SHOWN[-1]
    scene, sheets = run.scene, [run.scene.material] * len(sample.policies)
    coarse, errors, energy = CoarsePhysics(scene, num_envs=len(sheets), factor=factor, **options), [], []
    for frame, (state, _) in enumerate(replay(coarse, run.states[0], run.controls), 1):
        true = run.states[frame]
        gap = state.positions - resample(true.positions, scene.grid, coarse.scene.grid)
        errors.append(np.sqrt((gap**2).sum(1)).mean((1, 2)) / scene.grid.length)
        if frame > first:
            both = (kinetic_energy(coarse.scene.grid, sheets, state.velocities), true.velocities)
            energy.append((both[0], kinetic_energy(scene.grid, sheets, both[1])))
    sums = np.sum(energy, 0)
    of = {policy: sums[:, sample.policies == policy].sum(1) for policy in dict.fromkeys(sample.policies.tolist())}
    motion = {policy: float(mine / true) for policy, (mine, true) in of.items()}
    return Found(np.array(errors[:first]), motion, int(coarse.solver.substeps[0]))  # type: ignore[attr-defined]


def score(found: Found, similar: Found, most: float) -> float:
    """The loss: logarithms of the error over the similar cloth's and of the motion over the truth's, and substeps."""
    error = np.log(found.errors.mean(1) / similar.errors.mean(1)).mean()
    motion = np.abs(np.log(list(found.motion.values()))).mean()
    dear = max(0.0, found.substeps / (most * similar.substeps) - 1)
    return float(error + MOTION * motion + SUBSTEPS_PRICE * dear)


def fit(
    samples: Mapping[str, Sample], factors: Sequence[int], scaling: str, evaluations: int, most: float
) -> dict[str, float]:
    """Multipliers within bounds that make the mean loss of all scenes and factors least (Nelder-Mead, logarithms)."""
    materials = [sample.run.scene.material for sample in samples.values()]
    names = [n for n in NAMES[scaling] if any(getattr(material, n) > 0 for material in materials)]
    bounds = np.log([BOUNDS[name] for name in names])
    start = np.log([START.get(name, 1.0) for name in names]).clip(*bounds.T)
    usual = {(name, k): follow(sample, k) for name, sample in samples.items() for k in factors}

    def loss(logs: np.ndarray) -> float:
        tried = dict(zip(names, np.exp(logs).tolist(), strict=True))
        found = {(n, k): follow(samples[n], k, scaling="calibrated", factors=tried) for n, k in usual}
        return float(np.mean([score(found[key], usual[key], most) for key in usual]))

    simplex = np.concatenate([start[None], start + 0.4 * np.diag(np.where(start >= bounds[:, 1] - 0.4, -1, 1))])
    options = {"maxfev": evaluations, "initial_simplex": simplex.clip(*bounds.T), "xatol": 0.01, "fatol": 1e-5}
    best = minimize(loss, start, method="Nelder-Mead", bounds=bounds, options={**options, "adaptive": True})
    return dict(zip(names, np.exp(best.x).round(4).tolist(), strict=True))


def told(sample: Sample, factor: int, factors: Mapping[str, float] | None) -> dict[str, Any]:
    """For the card: errors [% of the cloth's length] after the frames SHOWN, motion by policy, substeps."""
    options = {} if factors is None else {"scaling": "calibrated", "factors": factors}
    found = follow(sample, factor, **options)
    errors = {str(k): round(100 * float(found.errors[k - 1].mean()), 4) for k in SHOWN}
    motion = {policy: round(value, 3) for policy, value in found.motion.items()}
    return {**errors, "kinetic energy": motion, "substeps": found.substeps}


def entry(samples: Mapping[str, Sample], factor: int, scaling: str, factors: dict[str, float]) -> dict[str, Any]:
    """What the card says of a scene at a grid factor; ``samples`` by what they were for."""
    scene = samples["fitted"].run.scene
    return {
        "factors": factors,
        **{f"{scaling}, {what}": told(sample, factor, factors) for what, sample in samples.items()},
        **{f"similar, {what}": told(sample, factor, None) for what, sample in samples.items()},
        "fitted on": {"resolution": scene.grid.shape, "material": scene.material.as_dict()},
    }


def about(evaluations: int, most: float) -> dict[str, Any]:
    """What holds for all fits of a file."""
    return {
        "errors": "mean vertex error of the coarse cloth, % of the cloth's length, after so many frames",
        "kinetic energy": f"over the truth's, frames {SHOWN[-1] + 1} to {FRAMES}",
        "fit seeds": FIT_SEEDS,
        "held-out seeds": HELD_OUT_SEEDS,
        "windows a seed": WINDOWS,
        "truth": "explicit, float64, a quarter of the stable step",
        "fit": {"evaluations": evaluations, "substeps": most},
        **header(),
    }


def add(out: Path, what: Mapping[str, Any], scene: str, factor: int, found: dict[str, Any]) -> None:
    """Write one fit into the file, which others may have written to."""
    known = read_json(out, "scenes", remedy="restore or remove it") if out.is_file() else {"scenes": {}}
    known["scenes"].setdefault(scene, {})[str(factor)] = found
    known["scenes"] = {name: known["scenes"][name] for name in SCENES if name in known["scenes"]}
    write_text(out, json.dumps({**known, "about": what}, indent=1) + "\n")
    print("wrote", out, scene, factor, json.dumps(found), flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Fit what the file lacks. Returns the exit code."""
    parser = Parser(prog="python -m training.calibrate", description=__doc__)
    parser.add_argument("--scaling", choices=list(NAMES), default="calibrated")
    parser.add_argument("--scenes", nargs="*", default=list(SCENES))
    parser.add_argument("--factors", nargs="*", type=int, default=[2, 3, 4])
    parser.add_argument("--evaluations", type=int, default=200, help="of the loss, per fit")
    parser.add_argument("--substeps", type=float, default=MOST_SUBSTEPS, help="of the cloth, over the similar one's")
    add_out(parser, Path("weights"))
    options = parser.parse_args(argv)
    scaling, evaluations, most = options.scaling, options.evaluations, options.substeps
    out = check_folder(options.out) / f"{scaling}.json"
    scenes = read_names(",".join(options.scenes), list(SCENES), "scene")
    fits = f"at factors {', '.join(map(str, options.factors))}, {evaluations} evaluations a fit"
    plan(scaling, f"{', '.join(scenes)} {fits}", out, cache_folder("truth"))
    done = read_json(out, "scenes", remedy="restore or remove it")["scenes"] if out.is_file() else {}
    todo = {scene: [k for k in options.factors if str(k) not in done.get(scene, {})] for scene in scenes}
    seeds, folder = {"fitted": FIT_SEEDS, "held out": HELD_OUT_SEEDS}, cache_folder("truth")
    get = partial(windows, folder=folder)
    samples = {scene: {what: get(scene, some) for what, some in seeds.items()} for scene in scenes if todo[scene]}
    one = scaling == "rule" and any(todo.values())
    shared = (
        fit({s: samples[s]["fitted"] for s in samples}, options.factors, scaling, evaluations, most) if one else None
    )
    for scene, factor in progress([(s, k) for s in scenes for k in todo[s]], scaling, unit="fit"):
        fitted = {scene: samples[scene]["fitted"]}
        factors = shared or fit(fitted, [factor], scaling, evaluations, most)
        add(out, about(evaluations, most), scene, factor, entry(samples[scene], factor, scaling, factors))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
