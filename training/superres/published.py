"""``minicloth train mfsr-published``: MFSR under the losses of table 3, on two trunks, and mesh SR, as published.

From pairs of ``minicloth generate SCENE --pairs synchronised``, on a graphics card if there is one. What ``--out`` has
figures of is kept, and a stopped training goes on. Adam with betas (0.9, 0.9), a rate of 1e-4 that is divided by 10
after every 20 of 120 epochs until the 60th: the 120 epochs stand for all steps of a run, however many the time allows.
A batch is a few windows of consecutive frames, the whole images; the publication's is 16 patches of images that are
larger than ours.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cloth_envs.files import check_folder, read_json, write_text
from cloth_envs.parsing import Parser
from cloth_envs.progress import announce
from cloth_envs.registry import PRESETS
from surrogates.superres.image import Range
from surrogates.superres.published import MeshSr, Mfsr
from training.cache import cache_folder, digest
from training.fit import Kept, Rate, cosine, fit
from training.rows import read_names, write_rows
from training.superres.convergence import CONVERGENCE, convergence
from training.superres.frames import Aligned, frames_of, score
from training.superres.losses import ALL, Weights, feature_psnr, loss, positions
from training.superres.pairs import SPLITS, read, sequences

RATE, EPOCHS, DROP, LAST_DROP = 1e-4, 120, 20, 60
LOOKS = 20  # points of a curve of convergence
PROBE = 20  # steps that are timed
FEWEST = 4  # frames of a sequence: a velocity and the kinematic loss


@dataclass(frozen=True)
class Recipe:
    """A published network and how it is trained.

    Attributes:
        net: ``"mfsr"``, ``"mfsr on srresnet"`` or ``"mesh-sr"``. weights: of its losses.
        size: options of the network, the published ones by default. schedule: ``"published"``, or ``"cosine"`` from
            ``rate`` down. ahead: frames of the kinematic loss. windows: of ``ahead + 1`` frames in a batch.
    """

    net: str = "mfsr"
    weights: Weights = ALL
    size: tuple[tuple[str, int], ...] = ()
    schedule: str = "published"
    rate: float = RATE
    ahead: int = 2
    windows: int = 6
    seed: int = 0

    @property
    def channels(self) -> int:
        return 3 if self.net == "mesh-sr" else 9

    def build(self, periodic: bool) -> torch.nn.Module:
        """The network with its first weights."""
        torch.manual_seed(self.seed)
        kind = Mfsr if self.net == "mfsr" else MeshSr
        return kind(channels=self.channels, periodic=periodic, **dict(self.size))

    def rates(self, steps: int) -> Rate:
        """The rate of every step."""
        return published_rate(self.rate, steps) if self.schedule == "published" else cosine(self.rate, steps)


ONE = Weights()
LONG: dict[str, Any] = {"schedule": "cosine", "rate": 2e-4}
# name -> what is trained: MFSR and mesh SR of table 2 at the published rate, which is made for 25 times more steps than
# ours; then, at one that uses all of them, these again, the other columns of table 3 and the other trunk of fig. 13.
RECIPES = {
    "all-published-rate": Recipe(),
    "mesh-sr-published-rate": Recipe(net="mesh-sr", weights=ONE),
    "all": Recipe(**LONG),
    "mesh-sr": Recipe(net="mesh-sr", weights=ONE, **LONG),
    "d": Recipe(weights=ONE, **LONG),
    "d+n": Recipe(weights=Weights(normal=ALL.normal), **LONG),
    "d+v": Recipe(weights=Weights(velocity=ALL.velocity), **LONG),
    "d+n+v": Recipe(weights=Weights(ALL.normal, ALL.velocity), **LONG),
    "all-srresnet": Recipe(net="mfsr on srresnet", **LONG),
}
KEPT = ("all-published-rate", "mesh-sr-published-rate", "all", "mesh-sr")  # whose weights are written
SMALL = (("base", 32), ("blocks", 4), ("layers", 3), ("growth", 16))  # an MFSR that a processor can train


def published_rate(rate: float, steps: int) -> Rate:
    """Divided by 10 after every ``DROP`` of ``EPOCHS``, no more after ``LAST_DROP``."""
    return lambda step: rate * 0.1 ** (min(step * EPOCHS // steps, LAST_DROP) // DROP)


def train(
    recipe: Recipe, pairs: Aligned, held: Aligned, scale: Range, *, seconds: float = 0.0, steps: int = 0,
    kept: Kept | None = None, label: str = "",
) -> tuple[torch.nn.Module, dict[str, Any]]:  # fmt: skip
    """The network after ``steps``, or as many as take ``seconds``, on the device of ``pairs``; and what is told of it.

    What is told has ``curve``: step and PSNR of the features on ``held`` at ``LOOKS`` times. Where it is ``kept``, a
    stopped training goes on, towards as many steps as were planned.

    Raises:
        ValueError: ``kept`` is of another training.
    """
    device, grid = pairs.pairs.coarse.device, pairs.pairs.small
    net = recipe.build(grid.periodic).to(device)
    net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    starts = pairs.pairs.starts(1, recipe.ahead)
    looked = _spread(held.pairs.starts(1, 0), 32)
    notes = kept.path.with_suffix(".json") if kept is not None else None
    begun: dict[str, Any] = {}
    if kept is not None and notes is not None and kept.read() and notes.is_file():
        begun = read_json(notes, remedy="remove it")
    curve: list[list[float]] = begun.get("curve", [])
    call: Any = net
    if device.type == "cuda":
        torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = True
        torch.backends.cudnn.benchmark = True
        shape = (recipe.windows * (recipe.ahead + 1), recipe.channels, *grid.shape)
        sample = torch.rand(shape, device=device).contiguous(memory_format=torch.channels_last)
        call = torch.cuda.make_graphed_callables(net, (sample,))

    def images(which: Aligned, frames: Tensor) -> tuple[Tensor, Tensor]:
        low, high = (scale(part)[:, : recipe.channels] for part in which.images(frames))
        return low.contiguous(memory_format=torch.channels_last), high

    def batch(step: int) -> Tensor:
        rng = np.random.default_rng((recipe.seed, step))
        chosen = starts[torch.from_numpy(rng.integers(len(starts), size=recipe.windows))]
        frames: Tensor = chosen[:, None] + torch.arange(recipe.ahead + 1)
        low, high = images(pairs, frames.flatten())
        return loss(call(low), high, recipe.weights, scale, pairs, frames)

    def followed(step: int) -> Tensor:
        if step % max(1, total // LOOKS) == 0:
            net.eval()
            with torch.no_grad():
                low, high = images(held, looked)
                curve[:] = [point for point in curve if point[0] < step]
                curve.append([step, *feature_psnr(net(low), high)])
            if notes is not None:
                write_text(notes, json.dumps({"steps": total, "curve": curve}) + "\n")
            net.train()
        return batch(step)

    if not (steps := steps or begun.get("steps", 0)):
        steps = _affordable(batch, seconds)
        net.zero_grad(set_to_none=False)
    total, began = steps, perf_counter()
    spent = fit(net, followed, steps, recipe.rates(steps), label=label, kept=kept, betas=(0.9, 0.9))
    took = max(perf_counter() - began, spent)  # of the clock, or of the processor where it was stopped
    told = {"steps": steps, "seconds": took, "batch": recipe.windows * (recipe.ahead + 1)}
    weights = sum(part.numel() for part in net.parameters())
    return net.eval(), {**told, "weights": weights, "curve": curve, "recipe": asdict(recipe)}


def _affordable(batch: Callable[[int], Tensor], seconds: float) -> int:
    """How many steps take so long."""
    began = 0.0
    for step in range(2 * PROBE):
        if step == PROBE:
            _wait()
            began = perf_counter()
        batch(step).backward()  # type: ignore[no-untyped-call]
    _wait()
    return max(1, int(seconds * PROBE / (perf_counter() - began)))


def _wait() -> None:
    """Until a graphics card has done what it was asked for."""
    if torch.cuda.is_available():
        torch.cuda.synchronize()


def _spread(frames: Tensor, count: int) -> Tensor:
    """``count`` of ``frames``, evenly."""
    return frames[torch.linspace(0, len(frames) - 1, min(count, len(frames))).long()]


def test(recipe: Recipe, net: torch.nn.Module, held: Aligned, scale: Range) -> dict[str, float]:
    """``frames.score`` of the network's displacements in float32 over all frames of ``held`` but a run's first."""
    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = False

    def guess(frames: Tensor) -> Tensor:
        with torch.no_grad():
            low = scale(held.images(frames)[0])[:, : recipe.channels]
            return positions(net(low), scale, held, frames)

    return score(held, scale, guess, held.pairs.starts(1, 0).tolist())


def run(names: Sequence[str], pairs: Aligned, held: Aligned, seconds: float, out: Path, scene: str) -> None:
    """Train each of ``RECIPES`` for so long, score it, write its weights and ``<out>/published.json`` after each.

    The curves are in ``<out>/superres_convergence.csv`` too, for the chart of ``minicloth bench super-resolution``.

    Raises:
        ValueError: ``out`` has figures, or what was half done, of other pairs.
    """
    scale, told = pairs.range(), out / "published.json"
    cloths = (cloth for part in (pairs, held) for cloth in (part.pairs.coarse, part.pairs.fine))
    data = digest(scene, *(cloth.cpu().numpy() for cloth in cloths))
    rows: dict[str, Any] = read_json(told, remedy="remove it") if told.is_file() else {}
    if other := [name for name, row in rows.items() if row.get("pairs") != data]:
        raise ValueError(f"{told} has figures of {other[0]} that are of other pairs: give another folder as --out")
    for name in names:
        if name in rows:
            continue
        kept = Kept(out / f"{name}.part", json.dumps({**asdict(RECIPES[name]), "pairs": data}), every=100)
        net, about = train(RECIPES[name], pairs, held, scale, seconds=seconds, kept=kept, label=name)
        rows[name] = {"pairs": data, **about, **test(RECIPES[name], net, held, scale)}
        if name in KEPT:
            torch.save({key: value.half().cpu() for key, value in net.state_dict().items()}, out / f"{name}.pt")
        write_text(told, json.dumps(rows, indent=1) + "\n")
        for part in (kept.path, kept.path.with_suffix(".json")):
            part.unlink(missing_ok=True)
        write_rows(out / f"{CONVERGENCE}.csv", convergence(scene, rows))
        print(name, {key: value for key, value in rows[name].items() if key not in ("curve", "recipe")}, flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Train the networks. Returns the exit code."""
    parser = Parser(prog="minicloth train mfsr-published", description=__doc__)
    parser.add_argument("--scene", default="Draping")
    parser.add_argument("--networks", default=",".join(RECIPES), help="some of %(default)s")
    parser.add_argument("--seconds", type=float, default=600.0, help="of each (default 600; on a processor hours)")
    parser.add_argument("--frames", type=int, default=200, help="of each sequence (default 200)")
    parser.add_argument("--out", type=Path, default=Path("published"), help="folder of weights and figures")
    given = parser.parse_args(argv)
    read_names(given.scene, list(PRESETS["chen2020"]), "scene")
    if given.seconds <= 0 or given.frames < FEWEST:
        had = f"{given.seconds:g} and {given.frames}"
        raise ValueError(f"--seconds must be over 0 and --frames at least {FEWEST}, got {had}")
    names, device = read_names(given.networks, list(RECIPES), "network"), "cuda" if torch.cuda.is_available() else "cpu"
    check_folder(given.out)
    folder = cache_folder("synchronised") / given.scene.lower()
    announce(f"{len(names)} networks, {given.seconds:g} s each, on {device}; pairs of {folder}, figures in {given.out}")
    part = slice(0, given.frames + 1)
    learnt, tested = (
        Aligned.of(frames_of([read(path, part) for path in sequences(folder, split)])[0].to(torch.device(device)))
        for split in SPLITS
    )
    run(names, learnt, tested, given.seconds, given.out, given.scene)
    return 0
