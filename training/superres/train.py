"""``minicloth train mfsr``: the network of ``backend="mfsr"`` and ridge in its features, from synchronised pairs.

Pairs are those of ``minicloth generate SCENE --pairs synchronised``; errors are told of the sequences for testing. A
stopped training goes on, bit for bit. By default those of Chen et al. 2020: Draping, Hitting and Skirt; ``--own``: on
the environments' own grids, from pairs of ``generate --own``.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cloth_envs.registry import PRESETS, SCENES
from surrogates.superres.features import FRAMES, SCALE, spacing
from surrogates.superres.network import weights_name
from training.cache import digest
from training.command import is_done, keep, plan, read
from training.fit import Kept
from training.superres.detail import Detail, Mirrored, Net, Recipe, ridge, train
from training.superres.frames import Aligned, frames_of, score
from training.superres.pairs import pairs_folder, sequences
from training.superres.pairs import read as read_pair

LONGEST = slice(0, 801)  # frames of a sequence that are read: those of Hitting would not fit into memory
OPTIONS = {
    "steps": "of Adam",
    "windows": "of three frames in a batch",
    "width": "channels of hidden layers",
    "layers": "hidden ones",
}


def arrays(net: Net, detail: Detail) -> dict[str, np.ndarray]:
    """What ``SuperResolution`` takes."""
    found = dict(zip(("mean", "width"), (part.flatten() for part in detail.scale), strict=True))
    for k, layer in enumerate(net.layers):
        assert isinstance(layer, Mirrored)
        found |= {f"{name}{k}": part.detach() for name, part in zip(("weight", "bias"), layer.used(), strict=True)}
    return {name: part.cpu().numpy() for name, part in found.items()}


def errors(nets: dict[str, Net | None], detail: Detail, scale: Any) -> dict[str, dict[str, float]]:
    """``frames.score`` of networks, and of interpolation for None."""
    aligned, frames, out = Aligned.of(detail.frames), detail.frames.starts(FRAMES - 1, 0).tolist(), {}
    with torch.no_grad():
        for name, net in nets.items():
            guess = detail.base if net is None else lambda numbers, net=net: detail(net, numbers)
            told = score(aligned, scale, guess, frames)
            out[name] = {key: float(f"{value:.4g}") for key, value in told.items()}
    return out


def train_scene(scene: str, recipe: Recipe, folder: Path, out: Path, cache: Path, *, own: bool = False) -> None:
    """Fit and write the network of a scene; what ``out`` holds of this recipe and these pairs is kept.

    ``own``: the pairs are of the environment's own grid.

    Raises:
        ValueError: there are no pairs.
    """
    learnt, tested = (sequences(folder, split) for split in ("train", "test"))
    settings = {"recipe": json.loads(json.dumps(asdict(recipe))), "pairs": digest(*(p.read_bytes() for p in learnt))}
    name = weights_name(scene, own)
    if is_done(name, SCALE, settings, out):
        return
    pairs = [read_pair(path, LONGEST) for path in learnt]
    frames, around = frames_of(pairs)
    detail = Detail(frames, around)
    kept = Kept(cache / f"{name}_{digest(settings)}.pt", json.dumps(settings))
    net, seconds = train(recipe, detail, kept=kept, label=scene)
    other = Detail(*frames_of([read_pair(path, LONGEST) for path in tested]), detail.scale)
    nets = {"bicubic": None, "ridge": ridge(detail), "mfsr": net}
    told = errors(nets, other, Aligned.of(frames).range())
    few = pairs[0].coarse.scene
    card = {
        "what": f"upscaler 'mfsr' of {scene}: residual to bicubic, from convolutions over the coarse cloth",
        "data": f"synchronised pairs of sequences {', '.join(str(pair.number) for pair in pairs)}, tracking of means",
    }
    about = {
        "errors of unseen sequences": told,
        "fitted on": {"spacing": spacing(few.grid), "material": few.material.as_dict()},
    }
    keep(name, SCALE, arrays(net, detail), settings, seconds, about, card, out)


def main(argv: Sequence[str] | None = None) -> int:
    """Train the network of every scene. Returns the exit code."""
    given, recipe = read("mfsr", __doc__, Recipe, OPTIONS, argv, flag=("--own", "on the environments' own grids"))
    scenes = list(PRESETS["chen2020"]) if given.scenes == list(SCENES) else given.scenes
    plan("mfsr", f"{', '.join(scenes)}, {recipe.steps} steps each", given.out, given.cache)
    for scene in scenes:
        train_scene(scene, recipe, pairs_folder(scene, given.own), given.out, given.cache, own=given.own)
    return 0
