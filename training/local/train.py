"""``minicloth train local``: the upscalers ``"local"`` (a small network) and ``"ridge"`` (linear) of every scene.

Both read ``upscale.local_features`` of real miniature runs and learn the residual of bicubic interpolation to the
truth. Frames after a restart weigh as the inverse of bicubic's error there: an error that grows by the frame is one of
the coarse dynamics and no upscaler's to guess. Ridge regression is closed; the network minimises the mean distance of
the vertices, by Adam, and follows bit for bit from its recipe. A training that was stopped goes on from its last
checkpoint; factors that --out holds already with this recipe are kept.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from itertools import product
from json import dumps, loads
from pathlib import Path
from time import process_time

import numpy as np
import torch

from cloth_envs.machine import header
from cloth_envs.naming import unknown_name
from cloth_envs.registry import SCENES
from cloth_envs.resample import Resampler
from cloth_envs.scene import Scene
from cloth_envs.state import State
from cloth_envs.world import World
from surrogates.checkpoint import WEIGHTS, add_factor, written
from surrogates.miniature.coarse import CoarsePhysics, coarse_grid
from surrogates.upscale.local import Local, Ridge, weights_name
from surrogates.upscale.local_features import LIMIT, flat_features
from training.cache import cache_folder, digest
from training.fit import Kept, cosine, fit
from training.local.data import FRAMES, RANGE, STARTS, Pairs, Windows, cached, join, pairs, simulate, small, varied
from training.recipes.local import FACTORS, FIRST_SEED, HELD_OUT, Recipe

SHOWN = (1, 5)  # frames of the card's errors


def fit_ridge(data: Pairs, recipe: Recipe) -> dict[str, np.ndarray]:
    """Weights that make the weighted squares least."""
    x = data.x.astype(np.float64) * data.weight[:, None]
    square = x.T @ x
    square += recipe.ridge * np.trace(square) / len(square) * np.eye(len(square))
    return {"weight0": np.linalg.solve(square, x.T @ (data.y * data.weight[:, None])).T.astype(np.float32)}


def fit_net(data: Pairs, factor: int, recipe: Recipe, kept: Kept, label: str = "") -> dict[str, np.ndarray]:
    """The network's arrays, as ``Local`` takes them. ``kept`` is there only while it is trained."""
    torch.manual_seed(recipe.seed)
    spread = data.x.std(0) + 1e-3
    low, high = data.numbers.min(0), data.numbers.max(0)
    centre, width = (low + high) / 2, np.maximum((high - low) / 2, 1e-3)
    scale = float((np.abs(data.y) * data.weight[:, None]).mean() / data.weight.mean())
    x, y, weight = (torch.from_numpy(a) for a in (data.x / spread, data.y / scale, data.weight * scale))
    numbers = torch.from_numpy(((data.numbers - centre) / width).astype(np.float32))
    hidden = recipe.hidden[FACTORS.index(factor)]
    reads, reads_numbers = torch.nn.Linear(x.shape[1], hidden, bias=False), torch.nn.Linear(2, hidden)
    last = torch.nn.Linear(hidden, y.shape[1], bias=False)

    def loss(step: int) -> torch.Tensor:
        chosen = torch.from_numpy(np.random.default_rng((recipe.seed, step)).integers(len(x), size=recipe.batch))
        of_flat = reads_numbers(numbers[chosen])
        found = last((reads(x[chosen]) + of_flat).relu() - of_flat.relu())
        found = found.reshape(recipe.batch, 3, -1)
        found = found * (1 + found.square().sum(1, keepdim=True) * (scale / LIMIT) ** 2).rsqrt()
        gap = found - y[chosen].reshape(recipe.batch, 3, -1)
        return ((gap.square().sum(1) + 1e-12).sqrt() * weight[chosen, None]).mean()

    net = torch.nn.ModuleList([reads, reads_numbers, last])
    fit(net, loss, recipe.steps, cosine(recipe.rate, recipe.steps, least=1e-3), label=label, kept=kept)
    kept.path.unlink(missing_ok=True)
    w, material, b, v = (p.detach().numpy() for p in (reads.weight, *reads_numbers.parameters(), last.weight))
    material = material / width
    arrays = {"weight0": w / spread, "bias0": b - material @ centre, "weight1": v * scale}
    arrays |= {"material": material, "material_low": low, "material_high": high}
    return {name: value.astype(np.float32) for name, value in arrays.items()}


def centred(arrays: dict[str, np.ndarray], coarse: Scene) -> dict[str, np.ndarray]:
    """``fit_net`` reads features less the flat sheet's, the upscaler all of them: the bias makes up for it."""
    return arrays | {"bias0": (arrays["bias0"] - arrays["weight0"] @ flat_features(coarse.grid)).astype(np.float32)}


def errors(data: Windows, factor: int, upscaler: Local | None) -> dict[str, float]:
    """Mean vertex error after the frames ``SHOWN``, % of the cloth's length; of bicubic interpolation for None."""
    out, grid = {}, data.scene.grid
    for frame in SHOWN:
        x = np.ascontiguousarray(data.coarse[factor][:, FRAMES.index(frame)])
        if upscaler is None:
            found = Resampler(coarse_grid(grid, factor), grid)(x)
        else:
            upscaler.set_materials(range(len(x)), data.materials)
            found = upscaler.positions([State.still(x)])
        gap = found - data.truth[:, FRAMES.index(frame)]
        mean = 100 * np.sqrt((gap**2).sum(1)).mean() / grid.length
        out[str(frame)] = float(f"{mean:.4g}")
    return out


def episodes(scene: str, recipe: Recipe, cache: Path) -> tuple[Windows, dict[str, Windows]]:
    """Windows to train on, and held-out ones by name."""
    described = World(scene).scene
    miniatures = [CoarsePhysics(described, factor=f, scaling=recipe.scaling).scene for f in FACTORS]

    def some(first: int, count: int, random: bool) -> Windows:
        ranges = varied(described) if random else None
        seeds = range(first, first + count)
        path = cache / f"{scene}_{digest(described, miniatures, seeds, FRAMES, STARTS, ranges)}.npz"
        make = partial(simulate, scene, seeds, FACTORS, randomize=ranges, scaling=recipe.scaling)
        return cached(described, path, make)

    own, other = recipe.seeds
    train = join([some(FIRST_SEED, own, False), some(FIRST_SEED + own, other, True)])
    first, count = HELD_OUT[0], len(HELD_OUT)
    return train, {"held out": some(first, count, False), "held out, varied material": some(first, count, True)}


def train(scene: str, factors: Sequence[int], recipe: Recipe, out: Path, cache: Path) -> None:
    """Fit and write both upscalers of a scene; what ``out`` holds of this recipe and data is kept."""
    data, held = episodes(scene, recipe, cache)
    settings = {"recipe": loads(dumps(asdict(recipe))), "data": data.key}
    for factor, kind in product(factors, (Ridge, Local)):
        name, coarse = weights_name(kind.method, scene), small(data.scene, factor)
        if written(name, out).card.get(str(factor), {}).get("trained with") == settings:
            continue
        chosen, began = pairs(data, factor, recipe.patches, recipe.seed), process_time()
        if kind is Ridge:
            fitted = fit_ridge(chosen, recipe)
        else:
            kept = Kept(cache / f"{name}_{factor}_{digest(settings)}.pt", dumps(settings))
            fitted = centred(fit_net(chosen, factor, recipe, kept, f"{scene} 1/{factor}"), coarse)
        seconds = round(process_time() - began, 1)
        upscaler = kind(coarse, data.scene, factor, arrays=fitted)
        shown = {
            f"{which}, {what}": errors(windows, factor, up)
            for which, windows in held.items()
            for what, up in (("bicubic", None), (kind.method, upscaler))
        }
        about = {
            "error [% of length] after frames": shown,
            "trained with": settings,
            "seconds": seconds,
            "machine": header(),
        }
        card = {
            "what": f"upscaler {kind.method!r} of {scene}: residual to bicubic, per patch of 12 coarse vertices",
            "data": f"miniature restarted from truth (float32) at frames {STARTS}, pairs {FRAMES} frames later",
            "materials": f"areal density and stretch stiffness {RANGE[0]} to {RANGE[1]} times the scene's own",
            "licence": "MIT",
        }
        add_factor(name, factor, fitted, about, card, out)
        print(f"{scene} 1/{factor} {kind.method}: {shown}", flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Train both upscalers. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="minicloth train local", description=__doc__)
    parser.add_argument("--scenes", nargs="*", default=list(SCENES))
    parser.add_argument("--factors", nargs="*", type=int, default=list(FACTORS), choices=FACTORS)
    parser.add_argument("--steps", type=int, default=Recipe.steps, help=f"of Adam (default {Recipe.steps})")
    parser.add_argument("--scaling", default=Recipe.scaling, help="of the miniature (default calibrated)")
    parser.add_argument("--out", type=Path, default=WEIGHTS, help="folder of the weights")
    parser.add_argument("--cache", type=Path, help="folder of the data (default: in the user's caches)")
    given = parser.parse_args(argv)
    cache = cache_folder("local", given.cache)
    for scene in given.scenes:
        if scene not in SCENES:
            raise unknown_name("scene", scene, SCENES)
        train(scene, given.factors, Recipe(steps=given.steps, scaling=given.scaling), given.out, cache)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
