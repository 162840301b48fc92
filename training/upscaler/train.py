"""``minicloth train upscaler``: a published network (``U*FC-V``, or one level of an H-DNN-like one) from a recipe.

It takes and gives absolute coordinates; the loss is eq. 4 of Lee et al. 2019. For the optimiser alone, features are
whitened and outputs scaled; both are linear and folded into the first and the last layer. With ``start="bilinear"`` the
optimised units learn what bilinear interpolation misses; units that pass the corners on are added at the end. A stopped
training goes on, bit for bit.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.linalg import block_diag

from cloth_envs.machine import header
from cloth_envs.naming import unknown_name
from cloth_envs.parsing import Parser
from surrogates.checkpoint import save
from surrogates.upscale.published import Mlp
from training.command import add_out, plan
from training.fit import Kept, cosine, fit
from training.generate import data_folder
from training.upscaler.data import Pairs, data_hash, read, shards
from training.upscaler.recipes import RECIPES, Recipe, work_folder

PROBE = 100_000  # pairs for the statistics, and for the errors of the card
LEAST_VARIANCE = 1e-7  # of a principal component that is whitened, over the largest one's
NAMES = "weight", "bias"
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
        (first, bias), *middle, (last, offset) = [(w.astype(np.float64), b.astype(np.float64)) for w, b in weights]
        first, bias = first @ self.white.T, bias - first @ self.white.T @ self.mean
        last, offset = self.spread * last, self.spread * offset + self.offset
        if self.carried:
            n = self.corners
            centre, back = self.mean[-n:], self.linear[-n:].T
            pick = np.eye(n, len(self.mean), len(self.mean) - n) / self.scale[:, None]
            first, bias = np.concatenate([first, pick]), np.concatenate([bias, CARRY - centre / self.scale])
            middle = [(block_diag(w, np.eye(n)), np.pad(b, (0, n))) for w, b in middle]
            last = np.concatenate([last, back * self.scale], 1)
            offset = offset + back @ (centre - CARRY * self.scale)
        pairs = enumerate([(first, bias), *middle, (last, offset)])
        return {f"{n}{k}": a.astype(np.float32) for k, pair in pairs for n, a in zip(NAMES, pair, strict=True)}


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


def main(argv: Sequence[str] | None = None) -> int:
    """Train the network, write its weights and their card. Returns the exit code."""
    parser = Parser(prog="minicloth train upscaler", description=__doc__)
    parser.add_argument("--recipe", required=True, help="one of " + ", ".join(RECIPES))
    parser.add_argument("--data", type=Path, help="folder of `minicloth generate` (default: in the user's cache)")
    add_out(parser, work_folder() / "weights")
    options = parser.parse_args(argv)
    name = options.recipe
    if name not in RECIPES:
        raise unknown_name("recipe", name, RECIPES)
    recipe, work = RECIPES[name], work_folder()
    folder = options.data or data_folder(recipe.scene, recipe.preset)
    plan(f"upscaler {name}", f"{recipe.steps} steps on the trajectories in {folder}", options.out, work)
    paths = [shards(folder, held_out=held) for held in (False, True)]
    learnt, held = (
        Pairs([read(path, recipe.factor) for path in part], recipe.scene, recipe.factor,
              inputs=recipe.inputs, features=recipe.features)
        for part in paths
    )  # fmt: skip
    known, about = data_hash([*paths[0], *paths[1]]), {"name": name, **asdict(recipe)}
    kept = Kept(work / f"{name}-{known[:8]}.pt", json.dumps(about | {"data": known}))
    arrays, seconds = train(recipe, learnt, kept)
    card: dict[str, Any] = {
        "recipe": about,
        "data": {
            "hash": known,
            "teacher": "P-ADMM, 10 iterations, full resolution",
            "trajectories": {"learnt from": len(paths[0]), "held out": len(paths[1])},
            "pairs": len(learnt),
        },
        "errors": {
            "units": "mse: eq. 4 of Lee et al. 2019 [m^2]; distance: mean of a vertex [m]; linear: interpolation",
            "learnt from": errors(arrays, learnt),
            "held out": errors(arrays, held),
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
    print(f"wrote {save(name.replace('-', '_'), arrays, card, options.out)}")
    print(json.dumps({"seconds": card["seconds"], **card["errors"]["held out"]}))
    return 0
