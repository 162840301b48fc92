"""``minicloth train physics-cnn``: the weights of ``backend="cnn"``, with their cards.

Particles (Zhao 2024): differential evolution and three stages of Adam on "fall", "blow" and both, beside least squares
in closed form. Sheets: the cell of every scene, identified by least squares. What was stopped goes on.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import torch

from cloth_envs.machine import header
from cloth_envs.physics.particles.solver import NEIGHBOURS
from surrogates.cell.backend import PARTICLES
from surrogates.cell.compiled import CLASSES, SHEET, dimensionless
from surrogates.cell.stencil import StencilCell
from surrogates.checkpoint import save
from training.cache import digest
from training.cell.data import CASES, case, sums
from training.cell.score import Run, errors
from training.cell.sheets import identify, sheet_errors
from training.cell.solve import (
    DATA,
    Fit,
    Loss,
    Recipe,
    as_cell,
    branch_scales,
    least_squares,
    numbers_of,
    rows,
    train,
)  # fmt: skip
from training.command import plan, read
from training.fit import Kept

CLOSED_FORM = "least_squares"


def adam(recipe: Recipe, folder: Path) -> tuple[Fit, dict[str, Any]]:
    """The cell that the recipe trains, and what its card says."""
    grid = case("fall").scene.grid
    lengths = (
        None if recipe.published else torch.tensor(np.hypot(*(NEIGHBOURS * [grid.row_spacing, grid.col_spacing]).T))
    )
    found = {name: sums(name, recipe.states, recipe.vertices, folder) for name in DATA[recipe.data]}
    loss = Loss(np.concatenate([Loss.of(part, name, recipe.physics).forms for name, part in found.items()]))
    scales, second = branch_scales(loss, lengths, recipe.seed)
    cell = StencilCell(scales=scales, dtype=torch.float64, lengths=lengths, pairs=not recipe.published)
    generator = torch.Generator().manual_seed(recipe.seed)
    for parameter in cell.parameters():
        parameter.data = torch.rand(parameter.shape, generator=generator, dtype=parameter.dtype)
    data = digest(*(array for part in found.values() for array in part))
    mark, batch = repr((recipe, data)), min(recipe.batch, len(loss.forms))
    losses, seconds = [], [second]
    for number, stage in enumerate(recipe.stages, 1):
        kept = Kept(folder / f"{digest(mark)}_{number}.pt", mark)
        value, second = train(cell, loss, stage, batch=batch, seed=recipe.seed + number, kept=kept)
        losses.append(value)
        seconds.append(second)
    numbers = numbers_of(cell).detach().numpy()
    about = {
        "differential evolution": {"scales": [float(f"{s:.6g}") for s in scales]},
        "loss after each stage": losses,
        "loss of no cell": loss(np.zeros_like(numbers)),
        "seconds of differential evolution and of the stages": [round(s, 1) for s in seconds],
        "data sha256": data,
    }
    return Fit(numbers, sum(seconds)), about


def identified(found: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Largest deviations [%] of a cell of particles (a checkpoint's arrays) from the simulator's law."""
    off = 100 * abs(found["coefficients"] - 1).max(0)
    down = 100 * abs(found["bias"][2] + 1)
    side = 100 * abs(found["bias"][:2]).max()
    names = ("stiffness, linear", "stiffness, nonlinear", "damping", "gravity", "sideways bias over gravity")
    return {name: float(f"{value:.2g}") for name, value in zip(names, (*off, down, side), strict=True)}


def particles(recipe: Recipe, out: Path, cache: Path) -> None:
    """All cells of particles, each tested on the four animations, and saved."""
    start = process_time()
    block = rows(DATA["both"], 10, 1000)
    about = {"seconds of the simulator's run": round(process_time() - start, 1), "data sha256": digest(block[0])}
    fits = {CLOSED_FORM: (least_squares(block), about)}
    fits |= {data: adam(replace(recipe, data=data), cache) for data in DATA}
    found = {name: dimensionless(case("fall").scene, as_cell(fit.numbers)) for name, (fit, _) in fits.items()}
    scores = {scene: errors(scene, {name: Run(arrays) for name, arrays in found.items()}) for scene in CASES}
    for name, (fit, about) in fits.items():
        closed = "least squares on 10 states of each of fall and blow, 1000 free particles each"
        card = {
            "what": "the cell of Zhao 2024 for nets of particles, dimensionless",
            "recipe": closed if name == CLOSED_FORM else asdict(recipe),
            "trained on": DATA.get(name, DATA["both"]),
            **about,
            "seconds of the fit": round(fit.seconds, 1),
            "off the simulator's law [%]": identified(found[name]),
            "largest |dx| until 0.2 s, 0.5 s, the end; mean distance at the end [% of 1 m]": {
                scene: {key: float(f"{e:.3g}") for key, e in scores[scene][name]._asdict().items() if np.isfinite(e)}
                for scene in scores
            },
            "valid": "nets of particles of any stiffness, dashpot and mass that its step holds; springs at rest "
            "lengths of the grid; strains of the animations up to 1",
            "licence": "MIT",
            **header(),
        }
        target = PARTICLES + ("" if name == "both" else f"_{name}")
        path = save(target, found[name], card, out)
        print("wrote", path, json.dumps(card["off the simulator's law [%]"]), flush=True)


def sheet(name: str, out: Path) -> None:
    """The cell of a scene's sheet."""
    start = process_time()
    found = identify(name)
    seconds = process_time() - start
    factors = dict(zip(SHEET, found.factors.tolist(), strict=True))
    card = {
        "what": f"the cell of {name}'s sheet: {', '.join(SHEET)} over the material's",
        "recipe": "least squares on 10 states of the reference under smooth actions (seed 100), all vertices",
        "data sha256": found.data_hash,
        "seconds, the reference's run included": round(seconds, 1),
        "by class": dict(zip(CLASSES, found.by_class.tolist(), strict=True)),
        "sideways bias over gravity": found.sideways.tolist(),
        "relative error of forces, held out (seed 200)": found.error,
        "mean vertex error to the reference after 1, 5, 10 frames, float32 [% of length]": sheet_errors(name, factors),
        "valid": "every material that the explicit reference steps, but yielding springs were not in the data",
        "licence": "MIT",
        **header(),
    }
    target = f"cnn_{name.lower()}"
    path = save(target, {"factors": found.factors, "by_class": found.by_class}, card, out)
    print("wrote", path, *(f"{branch} {value - 1:.1e}" for branch, value in factors.items()), flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Train the cells. Returns the exit code."""
    options, flag = {"epochs": "of the first stage"}, ("--no-particles", "sheets only")
    given, recipe = read("physics-cnn", __doc__, Recipe, options, argv, flag=flag)
    particles_too = "" if given.no_particles else f"cells of particles, {recipe.epochs} epochs in the first stage; "
    plan("physics-cnn", f"{particles_too}sheets of {', '.join(given.scenes)}", given.out, given.cache)
    torch.set_num_threads(1)
    if not given.no_particles:
        particles(recipe, given.out, given.cache)
    for name in given.scenes:
        sheet(name, given.out)
    return 0
