"""``minicloth train local``: the upscalers ``"local"`` (a small network) and ``"ridge"`` (linear) of every scene.

Both read ``surrogates.local_features`` of real miniature runs and learn the residual of bicubic interpolation to the
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
from dataclasses import asdict, dataclass, replace
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
from surrogates.calibrated import card
from surrogates.checkpoint import WEIGHTS, load, save
from surrogates.coarse import coarse_grid
from surrogates.local import Local, Ridge, weights_name
from surrogates.local_features import NODES, cells, features, flat_features, spacing, stiffness_numbers
from surrogates.patches import dense_grid
from training.bench.truth import cache_folder
from training.local_data import FRAMES, RANGE, STARTS, Windows, cached, join, simulate, varied

FACTORS = (2, 3, 4)
HELD_OUT = tuple(range(200, 205))
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
    """

    seeds: tuple[int, int] = (24, 16)
    hidden: tuple[int, int, int] = (18, 18, 18)
    patches: int = 400_000
    steps: int = 3000
    batch: int = 4096
    rate: float = 3e-3
    ridge: float = 1e-5
    seed: int = 0


@dataclass(frozen=True)
class Pairs:
    """P patches: features less those of the flat sheet ``(P, 36)``, answers ``(P, 27)`` and weights ``(P,)``."""

    x: np.ndarray
    y: np.ndarray
    weight: np.ndarray
    numbers: np.ndarray  # stiffness numbers (P, 2)


def small(scene: Scene, factor: int) -> Scene:
    """The scene on the coarse grid."""
    return replace(scene, grid=coarse_grid(scene.grid, factor), handles=())


def pairs(data: Windows, factor: int, most: int, seed: int = 0) -> Pairs:
    """At most ``most`` patches, as many of every frame."""
    rng, coarse = np.random.default_rng((seed, factor)), small(data.scene, factor)
    grid, unit = coarse.grid, spacing(coarse.grid)
    double = dense_grid(data.scene.grid, grid, 2)
    decimate, bicubic = Resampler(data.scene.grid, double), Resampler(grid, double)
    numbers, flat = stiffness_numbers(coarse, data.materials), flat_features(grid)
    parts: list[tuple[np.ndarray, ...]] = []
    share = most / (len(FRAMES) * len(data.truth) * grid.cells[0] * grid.cells[1])
    for frame in range(len(FRAMES)):
        size, begin = 0.0, len(parts)
        for window in range(0, len(data.truth), 64):
            part = slice(window, window + 64)
            x = np.ascontiguousarray(data.coarse[factor][part, frame])
            truth = np.ascontiguousarray(data.truth[part, frame])
            gap = decimate(truth) - bicubic(x)
            read, turn = features(x, unit)
            chosen = np.flatnonzero(rng.random(read.shape[0] * read.shape[1]) < share)
            wanted = (turn @ cells(gap) / np.float32(unit)).reshape(-1, 3, NODES)[chosen]
            size += float(np.sqrt((wanted**2).sum(1)).mean(1).sum())
            rows = np.repeat(numbers[part], read.shape[1], 0)[chosen]
            parts.append((read.reshape(-1, read.shape[-1])[chosen] - flat, wanted.reshape(len(chosen), -1), rows))
        count = sum(len(part[0]) for part in parts[begin:])
        parts[begin:] = [(*part, np.full(len(part[0]), count / size)) for part in parts[begin:]]
    x, y, rows, weight = (np.concatenate([part[k] for part in parts]).astype(np.float32) for k in range(4))
    return Pairs(x, y, weight, rows)


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
        gap = (found - y[chosen]).reshape(recipe.batch, 3, -1)
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
    if "bias0" not in arrays:
        return arrays
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


def train(scene: str, factors: Sequence[int], recipe: Recipe, out: Path, cache: Path) -> None:
    """Fit and write both upscalers of a scene; what ``out`` holds of this recipe and data is kept."""
    described = World(scene).scene

    def episodes(name: str, first: int, count: int, random: bool) -> Windows:
        seeds, ranges = range(first, first + count), varied(described) if random else None
        mark = hashlib.sha256(repr((described, first, FRAMES, STARTS, ranges, card()["scenes"][scene])).encode())
        kept = f"{scene}_{name}_{count}_{mark.hexdigest()[:12]}"
        return cached(kept, cache, lambda: simulate(scene, seeds, FACTORS, randomize=ranges))

    own, other = recipe.seeds
    data = join([episodes("own", 1000, own, False), episodes("varied", 1000 + own, other, True)])
    held, held_varied = (episodes(f"held_{n}", HELD_OUT[0], len(HELD_OUT), n == "varied") for n in ("own", "varied"))
    key = data.key
    for factor in factors:
        coarse = small(described, factor)
        chosen: Pairs | None = None
        for kind in (Ridge, Local):
            name = weights_name(kind.method, scene)
            arrays: dict[str, np.ndarray] = {}
            old: dict[str, Any] = {}
            if (out / f"{name}.safetensors").is_file():
                load.cache_clear()
                arrays, old = (dict(part) for part in load(name, out))
            settings = {"recipe": json.loads(json.dumps(asdict(recipe))), "data": key}
            if old.get("factors", {}).get(str(factor), {}).get("trained with") == settings:
                continue
            chosen = chosen or pairs(data, factor, recipe.patches, recipe.seed)
            began = process_time()
            if kind is Ridge:
                fitted = fit_ridge(chosen, recipe)
            else:
                fitted = centred(
                    fit_net(chosen, factor, recipe, cache / f"{name}_{factor}.pt", f"{scene} 1/{factor}"), coarse
                )
            seconds = process_time() - began
            upscaler = kind(coarse, described, factor, arrays=fitted)
            shown = {
                f"{which}, {what}": errors(windows, factor, up)
                for which, windows in (("held out", held), ("held out, varied material", held_varied))
                for what, up in (("bicubic", None), (kind.method, upscaler))
            }
            arrays = {n: a for n, a in arrays.items() if not n.startswith(f"{factor}.")}
            arrays |= {f"{factor}.{n}": a for n, a in fitted.items()}
            about = {"error [% of length] after frames": shown, "trained with": settings, "seconds": round(seconds, 1)}
            save(
                name,
                arrays,
                _card(scene, kind.method) | {"factors": {**old.get("factors", {}), str(factor): about}},
                out,
            )
            print(f"{scene} 1/{factor} {kind.method}: {shown}", flush=True)


def _card(scene: str, method: str) -> dict[str, Any]:
    return {
        "what": f"upscaler {method!r} of {scene}: residual to bicubic, per patch of 12 coarse vertices",
        "data": f"calibrated miniature restarted from truth (float32) at frames {STARTS}, pairs after {FRAMES} frames",
        "materials": f"areal density and stretch stiffness {RANGE[0]} to {RANGE[1]} times the scene's own",
        "licence": "MIT",
        "machine": header(),
    }


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="minicloth train local", description=__doc__)
    parser.add_argument("--scenes", nargs="*", default=list(SCENES))
    parser.add_argument("--factors", nargs="*", type=int, default=list(FACTORS), choices=FACTORS)
    parser.add_argument("--steps", type=int, default=Recipe.steps, help=f"of Adam (default {Recipe.steps})")
    parser.add_argument("--out", type=Path, default=WEIGHTS, help="folder of the weights")
    parser.add_argument("--cache", type=Path, help="folder of the data (default: in the user's caches)")
    given = parser.parse_args(argv)
    for scene in given.scenes:
        if scene not in SCENES:
            raise unknown_name("scene", scene, SCENES)
        train(
            scene, given.factors, Recipe(steps=given.steps), given.out, given.cache or cache_folder().parent / "local"
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
