"""``minicloth train upscaler``: a published network (``U*FC-V``, or one level of an H-DNN-like one) from a recipe.

The network takes absolute coordinates and gives absolute coordinates, as Lee et al. 2019 have it, and the loss is
theirs (eq. 4): squared distances, summed over the vertices of a patch, meant over patches, in m^2. For the optimiser
alone, features are centred and whitened by their principal components and outputs scaled; both are linear and are
folded into the first and the last layer when the weights are written. With ``start="bilinear"`` the optimised units
learn what bilinear interpolation misses, and the units that pass the corners on are added as the weights are written:
what is shipped is a plain fully connected network of the recipe's width.

Goes on where it was stopped, bit for bit: the batch of a step follows from the seed and the step's number.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cloth_envs.machine import header
from cloth_envs.naming import unknown_name
from surrogates.checkpoint import WEIGHTS, save
from surrogates.upscale.published import Mlp
from training.fit import Kept, cosine, fit
from training.generate import data_folder
from training.recipes.upscaler import RECIPES, SHIPPED, Recipe, weights_name, work_folder
from training.upscaler.data import Pairs, data_hash, read, shards

PROBE = 100_000  # pairs for the statistics, and for the errors of the card
LEAST_VARIANCE = 1e-7  # of a principal component that is whitened, over the largest one's
CARRY = 8.0  # standard deviations that a unit which passes a coordinate on can take before it is cut off


class Scaling:
    """The linear maps around the network: whitening ``(x - mean) @ white``, and ``base`` plus ``spread`` times it."""

    def __init__(self, recipe: Recipe, pairs: Pairs) -> None:
        x, y = (a.astype(np.float64) for a in pairs.draw(np.random.default_rng((recipe.seed, 1)), PROBE))
        self.mean = x.mean(0)
        values, vectors = np.linalg.eigh(np.cov(x.T))
        self.white = vectors / np.sqrt(np.maximum(values, LEAST_VARIANCE * values[-1]))
        corners = 3 * pairs.layout.weights.shape[1]
        self.carried = recipe.start == "bilinear"
        self.linear = np.zeros((len(self.mean), y.shape[1]))
        if self.carried:
            self.linear[-corners:] = np.kron(pairs.layout.weights.T, np.eye(3))
        rest = y - x @ self.linear
        self.offset, self.spread = rest.mean(0), float(rest.std(0).mean())
        self.corners, self.scale = corners, x.std(0)[-corners:]

    def fold(self, weights: list[tuple[np.ndarray, np.ndarray]]) -> dict[str, np.ndarray]:
        """The arrays of the whole network, in absolute coordinates, from the layers ``(out, in)`` inside."""
        layers = [(w.astype(np.float64), b.astype(np.float64)) for w, b in weights]
        w, b = layers[0]
        layers[0] = w @ self.white.T, b - w @ self.white.T @ self.mean
        w, b = layers[-1]
        layers[-1] = self.spread * w, self.spread * b + self.offset
        if self.carried:
            n = self.corners
            pick = np.zeros((n, len(self.mean)))
            pick[:, -n:] = np.diag(1 / self.scale)
            centre = self.mean[-n:]
            w, b = layers[0]
            layers[0] = np.concatenate([w, pick]), np.concatenate([b, CARRY - centre / self.scale])
            for k in range(1, len(layers) - 1):
                w, b = layers[k]
                wide = np.zeros((len(w) + n, w.shape[1] + n))
                wide[: len(w), : w.shape[1]], wide[len(w) :, w.shape[1] :] = w, np.eye(n)
                layers[k] = wide, np.concatenate([b, np.zeros(n)])
            w, b = layers[-1]
            back = self.linear[-n:].T
            layers[-1] = np.concatenate([w, back * self.scale], 1), b + back @ (centre - CARRY * self.scale)
        arrays: dict[str, np.ndarray] = {}
        for k, (w, b) in enumerate(layers):
            arrays |= {f"weight{k}": w.astype(np.float32), f"bias{k}": b.astype(np.float32)}
        return arrays


def errors(arrays: dict[str, np.ndarray], pairs: Pairs, seed: int = 2) -> dict[str, float]:
    """Eq. 4 [m^2] and the mean distance of a vertex [m] on pairs drawn at random, beside linear interpolation's."""
    x, y = pairs.draw(np.random.default_rng(seed), PROBE)
    plain = x[:, -3 * pairs.layout.corners.shape[1] :] @ np.kron(pairs.layout.weights.T, np.eye(3)).astype(np.float32)
    out: dict[str, float] = {}
    for name, found in (("", Mlp(arrays)(x)), ("linear ", plain)):
        gap = (found - y).astype(np.float64)
        out[name + "mse"] = float((gap**2).sum(1).mean())
        out[name + "distance"] = float(np.linalg.norm(gap.reshape(len(gap), -1, 3), axis=2).mean())
    return out


def train(recipe: Recipe, pairs: Pairs, kept: Kept) -> tuple[dict[str, np.ndarray], float]:
    """The weights after all steps, and the processor's seconds."""
    torch.manual_seed(recipe.seed)
    scaling = Scaling(recipe, pairs)
    parts = scaling.mean, scaling.white, scaling.linear, scaling.offset
    (mean, white, linear, offset), spread = (torch.from_numpy(a.astype(np.float32)) for a in parts), scaling.spread
    width = recipe.width - (scaling.corners if scaling.carried else 0)
    layers = [torch.nn.Linear(a, b) for a, b in pairwise([len(mean), *[width] * recipe.layers, len(offset)])]
    net = torch.nn.Sequential(*[part for layer in layers for part in (layer, torch.nn.ReLU())][:-1])

    def loss(step: int) -> torch.Tensor:
        x, y = (torch.from_numpy(a) for a in pairs.draw(np.random.default_rng((recipe.seed, 3, step)), recipe.batch))
        found = x @ linear + offset + spread * net((x - mean) @ white)
        return ((found - y) ** 2).sum(1).mean() / spread**2

    seconds = fit(net, loss, recipe.steps, cosine(recipe.rate, recipe.steps), label="steps", kept=kept)
    return scaling.fold([(layer.weight.detach().numpy(), layer.bias.detach().numpy()) for layer in layers]), seconds


def run(name: str, data: Path | None, out: Path, *, fresh: bool = False) -> dict[str, Any]:
    """Train recipe ``name`` and write its weights and card to ``out``. Returns the card."""
    recipe = RECIPES[name]
    folder = data or data_folder(recipe.scene, recipe.preset)
    split = {held: shards(folder, held_out=held) for held in (False, True)}
    options = {"inputs": recipe.inputs, "features": recipe.features}
    pairs = {
        held: Pairs([read(p, recipe.factor) for p in paths], recipe.scene, recipe.factor, **options)
        for held, paths in split.items()
    }
    known = data_hash([*split[False], *split[True]])
    about = {"name": name, **asdict(recipe)}
    kept = Kept(work_folder() / f"{name}-{known[:8]}.pt", json.dumps(about | {"data": known}))
    if fresh:
        kept.path.unlink(missing_ok=True)
    arrays, seconds = train(recipe, pairs[False], kept)
    card = {
        "recipe": about,
        "data": {
            "hash": known,
            "teacher": "P-ADMM, 10 iterations, full resolution",
            "trajectories": {"learnt from": len(split[False]), "held out": len(split[True])},
            "pairs": len(pairs[False]),
        },
        "errors": {
            "units": "mse: eq. 4 of Lee et al. 2019 [m^2]; distance: mean of a vertex [m]; linear: interpolation",
            "learnt from": errors(arrays, pairs[False]),
            "held out": errors(arrays, pairs[True]),
        },
        "valid": {
            "scene": f'{recipe.scene} with preset="{recipe.preset}" at its own resolution',
            "mass of the cloth [kg]": [1.5, 4.5],
            "spring constant [N/m]": [40, 150],
            "not": "other winds, other ways to hang: coordinates are absolute",
        },
        "seconds": round(seconds, 1),
        "licence": "MIT",
        **header(),
    }
    save(weights_name(name), arrays, card, out)
    return card


def main(argv: Sequence[str] | None = None) -> int:
    """Train the network. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="minicloth train upscaler", description=__doc__)
    parser.add_argument("--recipe", required=True, help="one of " + ", ".join(RECIPES))
    parser.add_argument("--data", type=Path, help="folder of `minicloth generate` (default: in the user's cache)")
    parser.add_argument("--out", type=Path, help="folder of the weights (default: the package's, or a cache)")
    parser.add_argument("--fresh", action="store_true", help="start again instead of going on")
    options = parser.parse_args(argv)
    if options.recipe not in RECIPES:
        raise unknown_name("recipe", options.recipe, RECIPES)
    out = options.out or (WEIGHTS if options.recipe in SHIPPED else work_folder() / "weights")
    card = run(options.recipe, options.data, out, fresh=options.fresh)
    print(json.dumps({"seconds": card["seconds"], **card["errors"]["held out"]}))
    return 0
