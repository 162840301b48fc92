"""``minicloth train local``: the upscalers ``"local"`` (a small network) and ``"ridge"`` (linear) of every scene.

Both read ``upscale.local_features`` of real miniature runs and learn the residual of bicubic interpolation to the
truth. Frames after a restart weigh as the inverse of bicubic's error there: an error that grows by the frame is one of
the coarse dynamics and no upscaler's to guess. Ridge regression is closed; the network minimises the mean distance of
the vertices, by Adam, and follows bit for bit from its recipe. A training that was stopped goes on from its last
checkpoint; factors that --out holds already with this recipe are kept.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from tqdm import tqdm

from cloth_envs.machine import header
from cloth_envs.naming import unknown_name
from cloth_envs.registry import SCENES
from cloth_envs.resample import Resampler
from cloth_envs.scene import Scene
from cloth_envs.state import State
from cloth_envs.world import World
from surrogates.checkpoint import WEIGHTS, save, written
from surrogates.miniature.backend import MiniatureBackend
from surrogates.miniature.coarse import coarse_grid
from surrogates.upscale.local import Local, Ridge, weights_name
from surrogates.upscale.local_features import LIMIT, flat_features
from training.bench.truth import cache_folder
from training.local_data import FRAMES, RANGE, STARTS, Pairs, Windows, cached, join, pairs, simulate, small, varied

FACTORS = (2, 3, 4)
FIRST_SEED, HELD_OUT = 1000, (200, 201, 202, 203, 204)
SHOWN = (1, 5)  # frames of the card's errors


@dataclass(frozen=True)
class Recipe:
    """How a pair of upscalers is trained.

    Attributes:
        seeds: of episodes with the scene's own material, and of as many or fewer with a random one.
        hidden: units of the network's one hidden layer at factors 2, 3 and 4; small ones for speed.
        patches: of all windows and frames, drawn at random.
        steps, batch, rate: of Adam; the rate falls along half a cosine.
        ridge: of the regression's diagonal.
        scaling: of the miniature.
    """

    seeds: tuple[int, int] = (24, 16)
    hidden: tuple[int, int, int] = (18, 18, 18)
    patches: int = 400_000
    steps: int = 3000
    batch: int = 4096
    rate: float = 3e-3
    ridge: float = 1e-5
    seed: int = 0
    scaling: str = "calibrated"


def fit_ridge(data: Pairs, recipe: Recipe) -> dict[str, np.ndarray]:
    """Weights that make the weighted squares least."""
    x = data.x.astype(np.float64) * data.weight[:, None]
    square = x.T @ x
    square += recipe.ridge * np.trace(square) / len(square) * np.eye(len(square))
    return {"weight0": np.linalg.solve(square, x.T @ (data.y * data.weight[:, None])).T.astype(np.float32)}


def fit_net(data: Pairs, factor: int, recipe: Recipe, kept: Path, label: str = "") -> dict[str, np.ndarray]:
    """The network's arrays, as ``Local`` takes them. ``kept`` holds the state of a training that was stopped."""
    import torch

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
    net = torch.nn.ModuleList([reads, reads_numbers, last])
    optimiser = torch.optim.Adam(net.parameters(), recipe.rate)
    begin = 0
    if kept.is_file():
        saved = torch.load(kept, weights_only=True)
        net.load_state_dict(saved["net"])
        optimiser.load_state_dict(saved["optimiser"])
        begin = saved["step"]
    for step in tqdm(range(begin, recipe.steps), desc=label, initial=begin, total=recipe.steps, disable=None):
        for group in optimiser.param_groups:
            group["lr"] = recipe.rate * (0.5 * (1 + math.cos(math.pi * step / recipe.steps)) + 1e-3)
        chosen = torch.from_numpy(np.random.default_rng((recipe.seed, step)).integers(len(x), size=recipe.batch))
        of_flat = reads_numbers(numbers[chosen])
        found = last((reads(x[chosen]) + of_flat).relu() - of_flat.relu())
        found = found.reshape(recipe.batch, 3, -1)
        found = found * (1 + found.square().sum(1, keepdim=True) * (scale / LIMIT) ** 2).rsqrt()
        gap = found - y[chosen].reshape(recipe.batch, 3, -1)
        loss = ((gap.square().sum(1) + 1e-12).sqrt() * weight[chosen, None]).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        if step % 500 == 499 and step + 1 < recipe.steps:
            kept.parent.mkdir(parents=True, exist_ok=True)
            torch.save({"net": net.state_dict(), "optimiser": optimiser.state_dict(), "step": step + 1}, kept)
    w, material, b, v = (p.detach().numpy() for p in (reads.weight, *reads_numbers.parameters(), last.weight))
    material = material / width
    arrays = {"weight0": w / spread, "bias0": b - material @ centre, "weight1": v * scale}
    arrays |= {"material": material, "material_low": low, "material_high": high}
    kept.unlink(missing_ok=True)
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
        mean = 100 * np.sqrt((gap**2).sum(1)).mean() / max(grid.height, grid.width)
        out[str(frame)] = float(f"{mean:.4g}")
    return out


def episodes(scene: str, recipe: Recipe, cache: Path) -> tuple[Windows, dict[str, Windows]]:
    """Windows to train on, and held-out ones by name."""
    described = World(scene).scene
    miniatures = [MiniatureBackend(described, factor=f, scaling=recipe.scaling).coarse.scene for f in FACTORS]

    def some(first: int, count: int, random: bool) -> Windows:
        ranges = varied(described) if random else None
        mark = hashlib.sha256(repr((described, miniatures, first, FRAMES, STARTS, ranges)).encode()).hexdigest()[:12]
        seeds = range(first, first + count)

        def make() -> Windows:
            return simulate(scene, seeds, FACTORS, randomize=ranges, scaling=recipe.scaling)

        return cached(f"{scene}_{count}_{mark}", cache, make)

    own, other = recipe.seeds
    train = join([some(FIRST_SEED, own, False), some(FIRST_SEED + own, other, True)])
    first, count = HELD_OUT[0], len(HELD_OUT)
    return train, {"held out": some(first, count, False), "held out, varied material": some(first, count, True)}


def train(scene: str, factors: Sequence[int], recipe: Recipe, out: Path, cache: Path) -> None:
    """Fit and write both upscalers of a scene; what ``out`` holds of this recipe and data is kept."""
    data, held = episodes(scene, recipe, cache)
    settings = {"recipe": json.loads(json.dumps(asdict(recipe))), "data": data.key}
    mark = hashlib.sha256(json.dumps(settings).encode()).hexdigest()[:12]
    for factor, kind in product(factors, (Ridge, Local)):
        name, coarse = weights_name(kind.method, scene), small(data.scene, factor)
        arrays, done = written(name, out)
        if done.get(str(factor), {}).get("trained with") == settings:
            continue
        chosen, began = pairs(data, factor, recipe.patches, recipe.seed), process_time()
        if kind is Ridge:
            fitted = fit_ridge(chosen, recipe)
        else:
            net = fit_net(chosen, factor, recipe, cache / f"{name}_{factor}_{mark}.pt", f"{scene} 1/{factor}")
            fitted = centred(net, coarse)
        seconds = round(process_time() - began, 1)
        upscaler = kind(coarse, data.scene, factor, arrays=fitted)
        shown = {
            f"{which}, {what}": errors(windows, factor, up)
            for which, windows in held.items()
            for what, up in (("bicubic", None), (kind.method, upscaler))
        }
        arrays = {n: a for n, a in arrays.items() if not n.startswith(f"{factor}.")}
        arrays |= {f"{factor}.{n}": a for n, a in fitted.items()}
        done[str(factor)] = {
            "error [% of length] after frames": shown,
            "trained with": settings,
            "seconds": seconds,
            "machine": header(),
        }
        save(name, arrays, _card(scene, kind.method) | {"factors": done}, out)
        print(f"{scene} 1/{factor} {kind.method}: {shown}", flush=True)


def _card(scene: str, method: str) -> dict[str, Any]:
    return {
        "what": f"upscaler {method!r} of {scene}: residual to bicubic, per patch of 12 coarse vertices",
        "data": f"miniature restarted from truth (float32) at frames {STARTS}, pairs {FRAMES} frames later",
        "materials": f"areal density and stretch stiffness {RANGE[0]} to {RANGE[1]} times the scene's own",
        "licence": "MIT",
    }


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="minicloth train local", description=__doc__)
    parser.add_argument("--scenes", nargs="*", default=list(SCENES))
    parser.add_argument("--factors", nargs="*", type=int, default=list(FACTORS), choices=FACTORS)
    parser.add_argument("--steps", type=int, default=Recipe.steps, help=f"of Adam (default {Recipe.steps})")
    parser.add_argument("--scaling", default=Recipe.scaling, help="of the miniature (default calibrated)")
    parser.add_argument("--out", type=Path, default=WEIGHTS, help="folder of the weights")
    parser.add_argument("--cache", type=Path, help="folder of the data (default: in the user's caches)")
    given = parser.parse_args(argv)
    cache = given.cache or cache_folder().parent / "local"
    for scene in given.scenes:
        if scene not in SCENES:
            raise unknown_name("scene", scene, SCENES)
        train(scene, given.factors, Recipe(steps=given.steps, scaling=given.scaling), given.out, cache)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
