"""``python -m training.local.published SCENE``: the local network, taught the trajectories of the published ones.

For fig. 15 of Lee et al. 2019, the wind turned round: the same teacher's positions, down-sampled, but read in a cell's
own axes and answered with what bicubic interpolation misses. Shipped ``"local"`` weights are of the scenes' own sheets
and know no sheet of preset "lee2019". These stay in the cache, where ``minicloth bench tables`` finds them.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from time import process_time

import numpy as np

from cloth_envs.machine import header
from cloth_envs.presets import load_preset
from surrogates.checkpoint import save
from surrogates.upscale.local import weights_name
from training.fit import Kept
from training.generate import data_folder
from training.local.data import FRAMES, Windows, pairs, small
from training.local.train import centred, fit_net
from training.recipes.local import Recipe
from training.recipes.upscaler import work_folder
from training.upscaler.data import data_hash, read, shards

PRESET, FACTOR = "lee2019", 2


def windows(scene: str, paths: Sequence[Path]) -> Windows:
    """Runs of as many frames as ``FRAMES`` has, the coarse cloth being the teacher's, down-sampled."""
    coarse, fine, materials, length = [], [], [], len(FRAMES)
    for path in paths:
        one = read(path, FACTOR)
        task = load_preset(scene, {"name": PRESET, "mass": one.mass, "spring": one.spring})
        truth = one.fine[1 : 1 + (len(one.fine) - 1) // length * length].reshape(-1, length, *one.fine.shape[1:])
        fine.append(truth)
        coarse.append(truth[..., ::FACTOR, ::FACTOR])
        materials += [task.material] * len(truth)
    task = load_preset(scene, PRESET)
    described = task.make_scene(resolution=task.resolution, material=task.material)
    return Windows(described, {FACTOR: np.concatenate(coarse)}, np.concatenate(fine), materials)


def main(argv: Sequence[str] | None = None) -> int:
    """Train the network. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m training.local.published", description=__doc__)
    parser.add_argument("scene", metavar="SCENE", help="Curtain, Flag or Collision, after `minicloth generate SCENE`")
    parser.add_argument("--out", type=Path, help="folder of the weights (default: in the user's cache)")
    options = parser.parse_args(argv)
    paths, recipe = shards(data_folder(options.scene, PRESET), held_out=False), Recipe()
    data, begin = windows(options.scene, paths), process_time()
    name = weights_name("local", options.scene)
    about = {"recipe": {"preset": PRESET, "factor": FACTOR, **asdict(recipe)}, "data": data_hash(paths)}
    kept = Kept(work_folder() / f"{name}.pt", json.dumps(about))
    net = fit_net(pairs(data, FACTOR, recipe.patches, recipe.seed), FACTOR, recipe, kept, name)
    card = {
        "recipe": about["recipe"],
        "data": {"hash": about["data"], "inputs": "the teacher's positions, down-sampled"},
        "seconds": round(process_time() - begin, 1),
        "licence": "MIT",
        **header(),
    }
    out = options.out or work_folder() / "weights"
    save(f"{name}_{FACTOR}", centred(net, small(data.scene, FACTOR)), card, out)
    print(f"{out / name}_{FACTOR}: {card['seconds']} s")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
