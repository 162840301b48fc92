"""``minicloth train local``: the upscalers ``"local"`` (a small network) and ``"ridge"`` (linear) of every scene.

Both read ``upscale.local_features`` of real miniature runs and learn the residual of bicubic interpolation to the
truth. Frames after a restart weigh as the inverse of bicubic's error there: an error that grows by the frame is one of
the coarse dynamics and no upscaler's to guess. What is written already with this recipe is kept.

With ``--published`` the network learns trajectories of ``minicloth generate SCENE`` instead, for fig. 15 of Lee
et al. 2019: these weights stay in the cache, where ``minicloth bench tables`` finds them.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from json import dumps, loads
from pathlib import Path
from time import process_time

import numpy as np
import torch

from cloth_envs.machine import header
from cloth_envs.resample import Resampler
from cloth_envs.scene import Scene
from cloth_envs.state import State
from cloth_envs.world import World
from surrogates.checkpoint import save
from surrogates.miniature.coarse import CoarsePhysics, coarse_grid
from surrogates.upscale.local import Local, Ridge, weights_name
from surrogates.upscale.local_features import LIMIT, flat_features
from training.cache import digest
from training.command import is_done, keep, plan, read
from training.fit import Kept, cosine, fit
from training.generate import data_folder
from training.local.data import (
    FRAMES,
    POLICIES,
    RANGE,
    STARTS,
    Pairs,
    Windows,
    cached,
    join,
    of_teacher,
    pairs,
    simulate,
    small,
    varied,
)  # fmt: skip
from training.upscaler.data import data_hash, shards
from training.upscaler.recipes import work_folder

FACTORS = (2, 3, 4)
FIRST_SEED, HELD_OUT = 1000, range(200, 208)
SHOWN = (1, 5)  # frames of the card's errors
PRESET = "lee2019"


@dataclass(frozen=True)
class Recipe:
    """How a pair of upscalers is trained, the network by Adam with a rate that falls along half a cosine."""

    seeds: tuple[int, int] = (24, 16)  # of episodes with the scene's own material, and with a random one
    hidden: tuple[int, int, int] = (18, 18, 18)  # units of the network at factors 2, 3 and 4; small ones for speed
    patches: int = 400_000  # of all windows and frames, drawn at random
    steps: int = 3000
    batch: int = 4096
    rate: float = 3e-3
    ridge: float = 1e-5  # of the regression's diagonal
    seed: int = 0
    scaling: str = "closure"  # of the miniature


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

    def some(seeds: range, random: bool) -> Windows:
        ranges = varied(described) if random else None
        path = cache / f"{scene}_{digest(described, miniatures, seeds, POLICIES, FRAMES, STARTS, ranges)}.npz"
        make = partial(simulate, scene, seeds, FACTORS, randomize=ranges, scaling=recipe.scaling)
        return cached(described, path, make)

    first, middle, last = FIRST_SEED, FIRST_SEED + recipe.seeds[0], FIRST_SEED + sum(recipe.seeds)
    train = join([some(range(first, middle), False), some(range(middle, last), True)])
    return train, {"held out": some(HELD_OUT, False), "held out, varied material": some(HELD_OUT, True)}


def train(scene: str, factors: Sequence[int], recipe: Recipe, out: Path, cache: Path) -> None:
    """Fit and write both upscalers of a scene; what ``out`` holds of this recipe and data is kept."""
    data, held = episodes(scene, recipe, cache)
    settings = {"recipe": loads(dumps(asdict(recipe))), "data": data.key}
    for factor, kind in product(factors, (Ridge, Local)):
        name, coarse = weights_name(kind.method, scene), small(data.scene, factor)
        if is_done(name, factor, settings, out):
            continue
        chosen, began = pairs(data, factor, recipe.patches, recipe.seed), process_time()
        if kind is Ridge:
            fitted = fit_ridge(chosen, recipe)
        else:
            kept = Kept(cache / f"{name}_{factor}_{digest(settings)}.pt", dumps(settings))
            fitted = centred(fit_net(chosen, factor, recipe, kept, f"{scene} 1/{factor}"), coarse)
        seconds, upscaler = process_time() - began, kind(coarse, data.scene, factor, arrays=fitted)
        shown = {
            f"{which}, {what}": errors(windows, factor, up)
            for which, windows in held.items()
            for what, up in (("bicubic", None), (kind.method, upscaler))
        }
        card = {
            "what": f"upscaler {kind.method!r} of {scene}: residual to bicubic, per patch of 12 coarse vertices",
            "data": f"miniature restarted from truth (float32) at frames {STARTS}, pairs {FRAMES} frames later",
            "actions": f"{', '.join(POLICIES)} in turn",
            "materials": f"areal density and stretch stiffness {RANGE[0]} to {RANGE[1]} times the scene's own",
        }
        keep(name, factor, fitted, settings, seconds, {"error [% of length] after frames": shown}, card, out)


def published(scene: str, recipe: Recipe) -> None:
    """Teach ``"local"`` the teacher's trajectories, down-sampled, at factor 2."""
    work, paths = work_folder(), shards(data_folder(scene, PRESET), held_out=False)
    data, begin, name = of_teacher(scene, PRESET, paths), process_time(), weights_name("local", scene)
    about = {
        "recipe": {"preset": PRESET, "factor": 2, **asdict(recipe)},
        "data": {"hash": data_hash(paths), "inputs": "the teacher's, down-sampled"},
    }
    net = fit_net(pairs(data, 2, recipe.patches, recipe.seed), 2, recipe, Kept(work / f"{name}.pt", dumps(about)), name)
    seconds = round(process_time() - begin, 1)
    card = {**about, "seconds": seconds, "licence": "MIT", **header()}
    save(f"{name}_2", centred(net, small(data.scene, 2)), card, work / "weights")
    print(f"{work / 'weights' / name}_2: {seconds} s")


def main(argv: Sequence[str] | None = None) -> int:
    """Train both upscalers. Returns the exit code."""
    options = {"steps": "of Adam", "scaling": "of the miniature"}
    flag = "--published", f'learn from trajectories of preset "{PRESET}"'
    given, recipe = read("local", __doc__, Recipe, options, argv, factors=FACTORS, flag=flag)
    what = f"{', '.join(given.scenes)} at factors {', '.join(map(str, given.factors))}, {recipe.steps} steps each"
    if given.published:
        what, given.out = f"{', '.join(given.scenes)}, trajectories of preset {PRESET}", work_folder() / "weights"
    plan("local", what, given.out, given.cache)
    for scene in given.scenes:
        if given.published:
            published(scene, recipe)
        else:
            train(scene, given.factors, recipe, given.out, given.cache)
    return 0
