"""``minicloth train mfsr``: the network of ``backend="mfsr"`` and ridge in its features.

By default of the scenes of Chen et al. 2020, Draping, Hitting and Skirt, from their synchronised pairs, those of
``minicloth generate SCENE --pairs synchronised``; ``--own``: on the environments' own grids, from pairs of
``generate --own``. Of other scenes, whose coarse cloths have a closure, from runs of these (``restarts``). Errors are
told of sequences that are not learnt from. A stopped training goes on, bit for bit.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cloth_envs.registry import PRESETS, SCENES
from cloth_envs.scene import Scene
from cloth_envs.world import World
from surrogates.superres.features import FRAMES, SCALE, spacing
from surrogates.superres.network import weights_name
from training.cache import digest
from training.command import is_done, keep, plan, read
from training.fit import Kept
from training.superres import restarts
from training.superres.detail import Detail, Mirrored, Net, Recipe, ridge, train
from training.superres.frames import Aligned, Around, Frames, frames_of, score
from training.superres.generate import PRESET
from training.superres.pairs import SPLITS, pairs_folder, sequences
from training.superres.pairs import read as read_pair

LONGEST = slice(0, 801)  # frames of a sequence that are read: those of Hitting would not fit into memory
OPTIONS = {
    "steps": "of Adam",
    "windows": "of three frames in a batch",
    "width": "channels of hidden layers",
    "layers": "hidden ones",
    "strain": "weight of edges that are too long",
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


@dataclass(frozen=True)
class Data:
    """What is learnt from, by its ``key``, and tested on; ``load`` reads either once it is known to be needed.

    ``scaling`` is that of the coarse cloth, ``about`` the words of the card.
    """

    load: Callable[[str], tuple[Frames, Around]]
    fine: Scene
    scaling: str
    key: str
    about: str


def tracked(folder: Path) -> Data:
    """Synchronised pairs. Raises ValueError: there are none."""
    paths = {split: sequences(folder, split) for split in SPLITS}
    learnt = paths[SPLITS[0]]

    def load(split: str) -> tuple[Frames, Around]:
        return frames_of([read_pair(path, LONGEST) for path in paths[split]])

    numbers = ", ".join(str(int(path.stem)) for path in learnt)
    about = f"synchronised pairs of sequences {numbers}, tracking of means"
    fine = read_pair(learnt[0], slice(1)).fine.scene
    return Data(load, fine, "similar", digest(*(path.read_bytes() for path in learnt)), about)


def restarted(scene: str, cache: Path) -> Data:
    """Runs of a closure's coarse cloth from the truth."""
    fine = World(scene).scene
    found = {split: restarts.restarts(scene, seeds, cache) for split, seeds in zip(SPLITS, restarts.SEEDS, strict=True)}
    learnt, unseen = (f"{seeds[0]} to {seeds[-1]}" for seeds in restarts.SEEDS)
    about = (
        f"miniature restarted from truth at frames {restarts.STARTS}, {restarts.AFTER} frames each; seeds {learnt}, "
        f"unseen {unseen}; actions {', '.join(restarts.POLICIES)} in turn"
    )
    key = digest(*(found[SPLITS[0]][name] for name in sorted(found[SPLITS[0]])))
    return Data(lambda split: restarts.frames_of(fine, found[split]), fine, restarts.SCALING, key, about)


def train_scene(name: str, recipe: Recipe, data: Data, out: Path, cache: Path) -> None:
    """Fit and write the network ``name``; what ``out`` holds of this recipe and data is kept."""
    settings = {"recipe": json.loads(json.dumps(asdict(recipe))), "pairs": data.key}
    if is_done(name, SCALE, settings, out):
        return
    scene, detail = data.fine.name, Detail(*data.load(SPLITS[0]))
    kept = Kept(cache / f"{name}_{digest(settings)}.pt", json.dumps(settings))
    net, seconds = train(recipe, detail, kept=kept, label=scene)
    other = Detail(*data.load(SPLITS[1]), detail.scale)
    nets = {"bicubic": None, "ridge": ridge(detail), "mfsr": net}
    told = errors(nets, other, Aligned.of(detail.frames).range())
    card = {
        "what": f"upscaler 'mfsr' of {scene}: residual to bicubic, from convolutions over the coarse cloth",
        "data": data.about,
    }
    fitted = {
        "spacing": spacing(detail.frames.small),
        "material": data.fine.material.as_dict(),
        "scaling": data.scaling,
        "self_contact": data.fine.self_contact is not None,
    }
    about = {"errors of unseen sequences": told, "fitted on": fitted}
    keep(name, SCALE, arrays(net, detail), settings, seconds, about, card, out)


def main(argv: Sequence[str] | None = None) -> int:
    """Train the network of every scene. Returns the exit code."""
    given, recipe = read("mfsr", __doc__, Recipe, OPTIONS, argv, flag=("--own", "on the environments' own grids"))
    scenes = list(PRESETS[PRESET]) if given.scenes == list(SCENES) else given.scenes
    plan("mfsr", f"{', '.join(scenes)}, {recipe.steps} steps each", given.out, given.cache)
    for scene in scenes:
        own = given.own and scene in PRESETS[PRESET]
        data = tracked(pairs_folder(scene, own)) if scene in PRESETS[PRESET] else restarted(scene, given.cache)
        train_scene(weights_name(scene, own), recipe, data, given.out, given.cache)
    return 0
