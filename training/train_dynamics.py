"""``minicloth train dynamics``: the correction of the coarse dynamics, ``correction="learned"`` of the miniature.

First the network learns what single frames from the truth leave to correct. Then it runs with the coarse solver for
``horizon`` frames and learns from the errors of all of them. Their gradients pass through a frame as if every vertex
flew freely, ``dx' = dx + frame_dt dv``, ``dv' = dv``: exact ones through the substeps of torch cost 100 times as much
and blow up, and the slow waves that make up the error nearly do fly freely for a few frames.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from tqdm import tqdm

from cloth_envs.machine import header
from cloth_envs.naming import unknown_name
from cloth_envs.registry import SCENES
from surrogates.checkpoint import WEIGHTS, save, written
from surrogates.miniature.backend import MiniatureBackend
from surrogates.miniature.closure import load_factors
from surrogates.miniature.correction import ARRAYS, LAYERS, Correction, weights_name
from training.bench.truth import cache_folder
from training.dynamics_data import FRAMES, SETTLE, Course, Episodes, episodes

FIRST_SEED, HELD_OUT = 1000, (200, 201, 202, 203, 204)
POLICIES = ("smooth", "random", "smooth", "bang-bang")  # of training; the first is scored
SHOWN = (1, 5, 10)  # frames of the card's errors
CHECKED, LOOK = 32, 50
CLIP, LIMIT = 6.0, 10.0  # standard deviations of features, and of answers


@dataclass(frozen=True)
class Recipe:
    """How a correction is trained.

    Attributes:
        seeds: of episodes.
        hidden: units of both hidden layers.
        warm: steps on single frames; steps: on whole windows of ``horizon`` frames, ``batch`` of them at a time.
        rate: of Adam on single frames, half of it on windows; it falls along half a cosine.
        memory: what share of a gradient reaches the frame before. 1 diverges where frames are long and wind drives.
        velocities: weight of their errors beside those of positions.
        scaling: of the miniature.
    """

    seeds: int = 64
    hidden: int = 48
    warm: int = 600
    steps: int = 400
    horizon: int = 10
    batch: int = 12
    rate: float = 3e-3
    memory: float = 1.0
    velocities: float = 0.3
    seed: int = 0
    scaling: str = "closure"


class Trainer:
    """A network, its arrays as ``Correction`` takes them, and what its windows say of it."""

    def __init__(self, data: Episodes, factor: int, recipe: Recipe) -> None:
        import torch

        self.torch, self.recipe, self.factor, self.data = torch, recipe, factor, data
        torch.manual_seed(recipe.seed)
        self._rng = np.random.default_rng(recipe.seed)
        coarse = MiniatureBackend(data.scene, factor=factor, scaling=recipe.scaling).coarse.scene
        self.unit, self.dt = np.float32(coarse.grid.row_spacing), np.float32(coarse.frame_dt)
        self.correction = Correction(coarse, {})
        self.share = self.correction.share[:, None]
        self._measure()

    def windows(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        last = FRAMES - self.recipe.horizon
        return self._rng.integers(SETTLE, last, count), self._rng.integers(
            len(self.data.controls["wind"][0]), size=count
        )

    def _measure(self) -> None:
        """Single frames from the truth, for the first steps and the scales."""
        torch, data = self.torch, self.data
        frame, member = self.windows(256)
        start = data.state(self.factor, frame, member)
        after = Course(data, self.factor, self.recipe.scaling).run(start, frame, member, 1)[0][0]
        x, turn = self.correction.features(start, after)
        truth = data.state(self.factor, frame + 1, member)
        gaps = (truth.positions - after.positions, (truth.velocities - after.velocities) * self.dt)
        y = np.stack([_rows(gap) / self.unit for gap in gaps], 2) @ np.swapaxes(turn, -1, -2)
        centre, spread = x.mean((0, 1)), x.std((0, 1)) + 1e-3
        scale = y.std((0, 1, 3)).repeat(3).astype(np.float32)
        widths = [x.shape[-1], *[self.recipe.hidden] * (LAYERS - 1), 6]
        self.layers = torch.nn.ModuleList(torch.nn.Linear(a, b) for a, b in pairwise(widths))
        with torch.no_grad():
            self.layers[-1].weight.zero_(), self.layers[-1].bias.zero_()
        self.centre, self.spread, self.scale = (torch.from_numpy(a.astype(np.float32)) for a in (centre, spread, scale))
        self._single = self.read(x), torch.from_numpy(y.reshape(*y.shape[:2], 6)) / self.scale
        self.expose()

    def read(self, features: np.ndarray) -> Any:
        return ((self.torch.from_numpy(features) - self.centre) / self.spread).clamp(-CLIP, CLIP)

    def forward(self, x: Any) -> Any:
        """Answers over their scale."""
        for k, layer in enumerate(self.layers):
            x = layer(x.relu() if k else x)
        return x * (1 + (x / LIMIT) ** 2).rsqrt() * self.torch.from_numpy(self.share)

    def expose(self) -> None:
        """Put the network as it is into the correction, in the features' own units."""
        weights = [[p.detach().clone() for p in layer.parameters()] for layer in self.layers]
        weights[0][0] /= self.spread
        weights[0][1] -= weights[0][0] @ self.centre
        weights[-1] = [p * (self.scale[:, None] if p.ndim == 2 else self.scale) for p in weights[-1]]
        values = [p for pair in weights for p in pair]
        values += [self.centre - CLIP * self.spread, self.centre + CLIP * self.spread, LIMIT * self.scale]
        self.correction.arrays = {n: v.numpy() for n, v in zip(ARRAYS, values, strict=True)}

    def fit(self, label: str = "") -> dict[str, np.ndarray]:
        """The arrays that were best on ``CHECKED`` windows of the training data, looked at every ``LOOK`` steps."""
        recipe = self.recipe
        for _ in self._descend(recipe.warm, recipe.rate, self.single, f"{label}, frames"):
            pass
        course = Course(self.data, self.factor, recipe.scaling, self.correction)
        checked = self.windows(CHECKED)
        usual = Course(self.data, self.factor, recipe.scaling).gaps(*checked, recipe.horizon)
        best, arrays = math.inf, {}
        for step in self._descend(
            recipe.steps, recipe.rate / 2, lambda: self.window(course, usual), f"{label}, windows"
        ):
            if step % LOOK == 0 or step == recipe.steps:
                self.expose()
                found = float((course.gaps(*checked, recipe.horizon)[0] / usual[0]).mean())
                if found < best:
                    best, arrays = found, self.correction.arrays
        self.correction.arrays = arrays
        return arrays

    def _descend(self, steps: int, rate: float, loss: Callable[[], Any], label: str) -> Iterator[int]:
        """Steps of Adam; yields how many were done, 0 first."""
        optimiser = self.torch.optim.Adam(self.layers.parameters(), rate)
        yield 0
        for step in tqdm(range(1, steps + 1), desc=label, disable=None):
            for group in optimiser.param_groups:
                group["lr"] = rate * min(1.0, step / 30) * (0.5 * (1 + math.cos(math.pi * step / steps)) + 1e-3)
            optimiser.zero_grad()
            loss().backward()
            self.torch.nn.utils.clip_grad_norm_(self.layers.parameters(), 0.1)
            optimiser.step()
            yield step

    def single(self) -> Any:
        """Smooth absolute error of the answers to a few single frames."""
        x, y = self._single
        chosen = self._rng.integers(len(x), size=6)
        share = self.torch.from_numpy(self.share)
        return self.torch.nn.functional.smooth_l1_loss(self.forward(x[chosen]), (y[chosen] * share).clamp(-8, 8))

    def window(self, course: Course, usual: np.ndarray) -> Any:
        """A number whose gradient is about that of the errors over ``usual`` ones, summed over a batch of windows."""
        self.expose()
        recipe, data = self.recipe, self.data
        frame, member = self.windows(recipe.batch)
        start = data.state(self.factor, frame, member)
        states, seen = course.run(start, frame, member, recipe.horizon)
        total, of_x = 0.0, np.zeros_like(_rows(start.positions))  # gradients by positions and by velocities
        of_v = of_x.copy()
        for k in range(recipe.horizon - 1, -1, -1):
            now = data.state(self.factor, frame + k + 1, member)
            of_v = recipe.memory * (of_v + self.dt * of_x) + recipe.velocities * _pull(
                states[k].velocities - now.velocities, usual[1, k]
            )
            of_x = recipe.memory * of_x + _pull(states[k].positions - now.positions, usual[0, k])
            x, turn = seen[k]
            gradient = np.stack([of_x, of_v / self.dt], 2) @ np.swapaxes(turn, -1, -2) * self.unit
            weight = self.torch.from_numpy(gradient.reshape(*x.shape[:2], 6)) * self.scale
            total = total + (self.forward(self.read(x)) * weight).mean()
        return total


def _pull(gap: np.ndarray, usual: float) -> np.ndarray:
    """The gradient of vertices' distances over ``usual`` ones, ``(B, V, 3)``."""
    gap = _rows(gap)
    return gap / np.sqrt((gap**2).sum(-1, keepdims=True) + np.float32((0.02 * usual) ** 2)) / np.float32(usual)


def _rows(field: np.ndarray) -> np.ndarray:
    """``(B, 3, h, w)`` as ``(B, V, 3)``."""
    return np.ascontiguousarray(field.reshape(len(field), 3, -1).swapaxes(1, 2))


def train(scene: str, factors: Sequence[int], recipe: Recipe, out: Path, cache: Path) -> None:
    """Fit and write the corrections of a scene; what ``out`` holds of this recipe and these factors is kept."""
    name = weights_name(scene)
    arrays, done = written(name, out)
    for factor in factors:
        settings = asdict(recipe) | {"factors": load_factors(scene, factor, recipe.scaling)}
        if done.get(str(factor), {}).get("trained with") == settings:
            continue
        data = episodes(scene, range(FIRST_SEED, FIRST_SEED + recipe.seeds), [factor], POLICIES, cache)
        held, began = episodes(scene, HELD_OUT, [factor], POLICIES[:1], cache), process_time()
        trainer = Trainer(data, factor, recipe)
        fitted = trainer.fit(f"{scene} 1/{factor}")
        seconds = round(process_time() - began)
        courses = {
            "calibrated": Course(held, factor, "calibrated"),
            recipe.scaling: Course(held, factor, recipe.scaling),
            "learned": Course(held, factor, recipe.scaling, trainer.correction),
        }
        shown = {}
        for which, course in courses.items():
            found = course.errors(max(SHOWN))
            shown[which] = {str(k): float(f"{found[k - 1]:.4g}") for k in SHOWN}
        arrays = {n: a for n, a in arrays.items() if not n.startswith(f"{factor}.")}
        arrays |= {f"{factor}.{n}": a for n, a in fitted.items()}
        done[str(factor)] = {
            "held-out error [% of length] after frames": shown,
            "trained with": settings,
            "seconds": seconds,
            "machine": header(),
        }
        save(name, arrays, _card(scene) | {"factors": done}, out)
        print(f"{scene} 1/{factor} {seconds} s: {shown}", flush=True)


def _card(scene: str) -> dict[str, Any]:
    return {
        "what": f"correction of the coarse dynamics of {scene}, once a frame",
        "data": f"decimated truth (float32), actions {', '.join(POLICIES)} in turn, {FRAMES} frames an episode",
        "valid": "the scene's own material; trained and scored on restarts from decimated truth, 10 frames",
        "licence": "MIT",
    }


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="minicloth train dynamics", description=__doc__)
    parser.add_argument("--scenes", nargs="*", default=list(SCENES))
    parser.add_argument("--factors", nargs="*", type=int, default=[2, 4], choices=[2, 3, 4])
    parser.add_argument("--seeds", type=int, default=Recipe.seeds, help=f"of episodes (default {Recipe.seeds})")
    parser.add_argument("--warm", type=int, default=Recipe.warm, help=f"steps on frames (default {Recipe.warm})")
    parser.add_argument("--steps", type=int, default=Recipe.steps, help=f"on windows (default {Recipe.steps})")
    parser.add_argument("--hidden", type=int, default=Recipe.hidden, help=f"units a layer (default {Recipe.hidden})")
    parser.add_argument("--memory", type=float, default=Recipe.memory, help="of gradients from frame to frame")
    parser.add_argument("--out", type=Path, default=WEIGHTS, help="folder of the weights")
    parser.add_argument("--cache", type=Path, help="folder of the data (default: in the user's caches)")
    given = parser.parse_args(argv)
    cache = given.cache or cache_folder().parent / "dynamics"
    for scene in given.scenes:
        if scene not in SCENES:
            raise unknown_name("scene", scene, SCENES)
        recipe = Recipe(seeds=given.seeds, warm=given.warm, steps=given.steps, hidden=given.hidden, memory=given.memory)
        train(scene, given.factors, recipe, given.out, cache)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
