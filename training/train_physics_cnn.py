"""``minicloth train physics-cnn``: the weights of ``backend="cnn"``, with their cards.

Particles (Zhao 2024): differential evolution for the scales, Adam with step decay, cosine fine-tuning, then the
derivative branch alone with the others frozen; on "fall", on "blow" and on both, beside least squares in closed
form. Sheets: the cell of every scene, identified by least squares. A stage that was done is not done again.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import torch

from cloth_envs.machine import header
from cloth_envs.naming import unknown_name
from cloth_envs.physics.particles.solver import NEIGHBOURS
from cloth_envs.registry import SCENES
from surrogates.cell.backend import PARTICLES
from surrogates.cell.compiled import dimensionless
from surrogates.cell.numbers import CLASSES, SHEET
from surrogates.cell.stencil import StencilCell
from surrogates.checkpoint import WEIGHTS, save
from training.bench.truth import cache_folder
from training.physics_cnn_data import CASES, Sums, case, sums
from training.physics_cnn_fit import Fit, Loss, Stage, as_cell, branch_scales, least_squares, numbers_of, rows, train
from training.physics_cnn_score import Run, errors
from training.physics_cnn_sheets import identify, sheet_errors
from training.rows import read_names

DATA = {"fall": ("fall",), "blow": ("blow",), "both": ("fall", "blow")}
CLOSED_FORM = "least_squares"
STATES, VERTICES = 2500, 2048  # a scene; drawn particles a state
LAMBDA, BATCH = 0.5, 256  # of eq. 8; states
BASES = {
    "shared": "basis (d / L - n, n), opposite neighbours share weights",
    "free": "basis (d / L - n, n), 12 weights a branch",
    "published": "alpha and beta themselves, 12 weights a branch",
}


def stages(epochs: int) -> list[Stage]:
    """The paper's: 1e-2 with step decay, then cosine annealing from 1e-3; then one branch with the others frozen."""
    return [
        Stage(1e-2, epochs, "step"),
        Stage(1e-3, max(1, epochs // 4), "cosine"),
        Stage(1e-3, max(1, epochs // 8), "cosine", ("derivative",)),
    ]


def options_of(basis: str) -> dict[str, Any]:
    """Options of ``StencilCell`` for a name in ``BASES``."""
    if basis == "published":
        return {}
    grid = case("fall").scene.grid
    lengths = torch.tensor(np.hypot(*(NEIGHBOURS * [grid.row_spacing, grid.col_spacing]).T))
    return {"lengths": lengths, "pairs": basis == "shared"}


def adam(
    data: str, epochs: int, basis: str, *, seed: int = 0, folder: Path | None = None
) -> tuple[Fit, dict[str, Any]]:
    """The cell trained on ``data`` (of ``DATA``), and what its card says; goes on after the last stage on disk."""
    options = options_of(basis)
    found = {name: sums(name, STATES, VERTICES, folder) for name in DATA[data]}
    loss = Loss(np.concatenate([Loss.of(part, name, LAMBDA).forms for name, part in found.items()]))
    text = repr((data, epochs, seed, LAMBDA, basis, data_hash(found)))
    path = cache_folder(folder).parent / "physics_cnn" / f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.pt"
    if path.is_file():
        past = torch.load(path, weights_only=True)
    else:
        scales, seconds = branch_scales(loss, options.get("lengths"), seed)
        past = {"scales": scales, "done": 0, "seconds": [seconds], "losses": []}
    cell = StencilCell(scales=past["scales"], dtype=torch.float64, **options)
    generator = torch.Generator().manual_seed(seed)
    for parameter in cell.parameters():
        parameter.data = torch.rand(parameter.shape, generator=generator, dtype=parameter.dtype)
    if past["done"]:
        cell.load_state_dict(past["cell"])
    path.parent.mkdir(parents=True, exist_ok=True)
    for number, stage in enumerate(stages(epochs)[past["done"] :], past["done"] + 1):
        value, seconds = train(cell, loss, stage, batch=min(BATCH, len(loss.forms)), seed=seed + number)
        past |= {"losses": [*past["losses"], value], "seconds": [*past["seconds"], seconds], "done": number}
        torch.save(past | {"cell": cell.state_dict()}, path)
    numbers = numbers_of(cell).detach().numpy()
    about = {
        "differential evolution": {"scales": [float(f"{s:.6g}") for s in past["scales"]]},
        "loss after each stage": past["losses"],
        "loss of no cell": loss(np.zeros_like(numbers)),
        "seconds of differential evolution and of the stages": [round(s, 1) for s in past["seconds"]],
        "data sha256": data_hash(found),
    }
    return Fit(numbers, sum(past["seconds"])), about


def data_hash(found: dict[str, Sums]) -> str:
    """Of the sums that a cell was fitted to."""
    return hashlib.sha256(b"".join(part.tobytes() for item in found.values() for part in item)).hexdigest()


def identified(found: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Largest deviations [%] of a cell of particles (a checkpoint's arrays) from the simulator's law."""
    off = 100 * abs(found["coefficients"] - 1).max(0)
    down = 100 * abs(found["bias"][2] + 1)
    side = 100 * abs(found["bias"][:2]).max()
    names = ("stiffness, linear", "stiffness, nonlinear", "damping", "gravity", "sideways bias over gravity")
    return {name: float(f"{value:.2g}") for name, value in zip(names, (*off, down, side), strict=True)}


def particles(epochs: int, out: Path, basis: str) -> None:
    """All cells of particles, each tested on the four animations, and saved."""
    start = process_time()
    block = rows(DATA["both"], 10, 1000)
    data_seconds = process_time() - start
    fits: dict[str, tuple[Fit, dict[str, Any]]] = {}
    fits[CLOSED_FORM] = (
        least_squares(block),
        {"seconds of the simulator's run": round(data_seconds, 1),
         "data sha256": hashlib.sha256(block[0].tobytes()).hexdigest()},
    )  # fmt: skip
    for data in DATA:
        fits[data] = adam(data, epochs, basis)
    found = {name: dimensionless(case("fall").scene, as_cell(fit.numbers)) for name, (fit, _) in fits.items()}
    scores = {scene: errors(scene, {name: Run(arrays) for name, arrays in found.items()}) for scene in CASES}
    for name, (fit, about) in fits.items():
        recipe = (
            "least squares on 10 states of each of fall and blow, 1000 free particles each"
            if name == CLOSED_FORM
            else f"differential evolution, then Adam: {'; '.join(map(str, stages(epochs)))}; batches of {BATCH} "
            f"of {STATES} states a scene, {VERTICES} free particles a state, lambda {LAMBDA}; {BASES[basis]}"
        )
        card = {
            "what": "the cell of Zhao 2024 for nets of particles, dimensionless",
            "recipe": recipe,
            "trained on": DATA.get(name, DATA["both"]),
            **about,
            "seconds of the fit": round(fit.seconds, 1),
            "off the simulator's law [%]": identified(found[name]),
            "largest |dx| until 0.25 s, 0.5 s, the end; mean distance at the end [% of 1 m]": {
                scene: [float(f"{e:.3g}") for e in scores[scene][name]] for scene in scores
            },
            "valid": "nets of particles of any stiffness, dashpot and mass that its step holds; springs at rest "
            "lengths of the grid; strains of the animations up to 1",
            "licence": "MIT",
            **header(),
        }
        target = PARTICLES + ("" if name == "both" else f"_{name}") + ("" if basis == "shared" else f"_{basis}")
        save(target, found[name], card, out)
        print(target, json.dumps(card["off the simulator's law [%]"]), flush=True)


def sheets(names: Sequence[str], out: Path) -> None:
    """The cells of sheets."""
    for name in names:
        start = process_time()
        found = identify(name)
        seconds = process_time() - start
        arrays = {"factors": found.factors, "by_class": found.by_class}
        target = f"cnn_{name.lower()}"
        card = {
            "what": f"the cell of {name}'s sheet: {', '.join(SHEET)} over the material's",
            "recipe": "least squares on 10 states of the reference under smooth actions (seed 100), all vertices",
            "data sha256": found.data_hash,
            "seconds, the reference's run included": round(seconds, 1),
            "by class": dict(zip(CLASSES, found.by_class.tolist(), strict=True)),
            "sideways bias over gravity": found.sideways.tolist(),
            "relative error of forces, held out (seed 200)": found.error,
            "mean vertex error to the reference after 1, 5, 10 frames, float32 [% of length]": sheet_errors(
                name, dict(zip(SHEET, found.factors.tolist(), strict=True))
            ),
            "valid": "every material that the explicit reference steps, but yielding springs were not in the data",
            "licence": "MIT",
            **header(),
        }
        save(target, arrays, card, out)
        print(
            target, *(f"{name} {value:.1e}" for name, value in zip(SHEET, found.factors - 1, strict=True)), flush=True
        )


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="minicloth train physics-cnn", description=__doc__)
    parser.add_argument("--epochs", type=int, default=2000, help="of the first stage (default 2000)")
    parser.add_argument(
        "--basis", default="shared", help="of the particles' weights: shared (default), free, published"
    )
    parser.add_argument("--scenes", default=",".join(SCENES), help="sheets to identify")
    parser.add_argument("--no-particles", action="store_true", help="sheets only")
    parser.add_argument("--out", type=Path, default=WEIGHTS, help="folder for weights and cards")
    options = parser.parse_args(argv)
    names = read_names(options.scenes, list(SCENES), "scene")
    if options.basis not in BASES:
        raise unknown_name("basis", options.basis, BASES)
    torch.set_num_threads(1)
    if not options.no_particles:
        particles(options.epochs, options.out, options.basis)
    sheets(names, options.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
