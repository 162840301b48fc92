"""``minicloth train dynamics``: the correction of the coarse dynamics, ``correction="learned"`` of the miniature.

First the network learns what single frames from the truth leave to correct, then from the errors of all ``horizon``
frames that it runs with the coarse solver. Their gradients pass through a frame as if every vertex flew freely,
``dx' = dx + frame_dt dv``, ``dv' = dv``: exact ones through the substeps cost 100 times as much and blow up.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from json import dumps
from pathlib import Path
from time import process_time

import numpy as np
import torch

from surrogates.miniature.closure import load_factors
from surrogates.miniature.coarse import CoarsePhysics
from surrogates.miniature.correction import ARRAYS, LAYERS, Correction, weights_name
from training.cache import digest, spelled
from training.command import is_done, keep, plan, read
from training.dynamics.data import FRAMES, SETTLE, Course, Episodes, episodes
from training.fit import Best, Kept, cosine, fit

FIRST_SEED, HELD_OUT = 1000, (200, 201, 202, 203, 204)
POLICIES = ("smooth", "random", "smooth", "bang-bang")  # of training; the first is scored
SHOWN = (1, 5, 10)  # frames of the card's errors
CHECKED, LOOK = 32, 50
RISE, NORM = 30, 0.1  # steps over which the rate rises, and the largest norm of a gradient
CLIP, LIMIT = 6.0, 10.0  # standard deviations of features, and of answers


@dataclass(frozen=True)
class Recipe:
    """How a correction is trained: ``warm`` steps on single frames, then ``steps`` on windows of ``horizon`` frames."""

    seeds: int = 64  # of episodes
    hidden: int = 48  # units of both hidden layers
    warm: int = 600
    steps: int = 400
    horizon: int = 10
    batch: int = 12  # windows
    rate: float = 3e-3  # of Adam on single frames, half of it on windows; it falls along half a cosine
    # What share of a gradient reaches the frame before. 1 diverges where frames are long and wind drives.
    memory: float = 1.0
    velocities: float = 0.3  # weight of their errors beside those of positions
    seed: int = 0
    scaling: str = "closure"  # of the miniature


class Trainer:
    """A network, its arrays as ``Correction`` takes them, and what its windows say of it."""

    def __init__(self, data: Episodes, recipe: Recipe) -> None:
        self.recipe, self.data = recipe, data
        torch.manual_seed(recipe.seed)
        self._rng = np.random.default_rng(recipe.seed)
        coarse = CoarsePhysics(data.scene, factor=data.factor, scaling=recipe.scaling).scene
        self.unit, self.dt = np.float32(coarse.grid.row_spacing), np.float32(coarse.frame_dt)
        self.correction = Correction(coarse, {})
        self.share = torch.from_numpy(self.correction.share[:, None])
        # Single frames from the truth, for the first steps and the scales.
        frame, member = self.windows(256)
        after = Course(data, recipe.scaling).run(frame, member, 1)[0][0]
        x, turn = self.correction.features(data.state(frame, member), after)
        truth = data.state(frame + 1, member)
        gaps = (truth.positions - after.positions, (truth.velocities - after.velocities) * self.dt)
        y = np.stack([_rows(gap) / self.unit for gap in gaps], 2) @ np.swapaxes(turn, -1, -2)
        scales = x.mean((0, 1)), x.std((0, 1)) + 1e-3, y.std((0, 1, 3)).repeat(3)
        self.centre, self.spread, self.scale = (torch.from_numpy(a.astype(np.float32)) for a in scales)
        widths = [x.shape[-1], *[recipe.hidden] * (LAYERS - 1), 6]
        self.layers = torch.nn.ModuleList(torch.nn.Linear(a, b) for a, b in pairwise(widths))
        for parameter in self.layers[-1].parameters():
            torch.nn.init.zeros_(parameter)
        self.frames = self.read(x), torch.from_numpy(y.reshape(*y.shape[:2], 6)) / self.scale
        self.expose()

    def windows(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Frames and members of random windows."""
        first = self._rng.integers(SETTLE, FRAMES - self.recipe.horizon, count)
        return first, self._rng.integers(self.data.positions.shape[1], size=count)

    def read(self, features: np.ndarray) -> torch.Tensor:
        """What the network reads of ``features``: centred, over their spread, and clipped."""
        return ((torch.from_numpy(features) - self.centre) / self.spread).clamp(-CLIP, CLIP)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Answers over their scale."""
        for k, layer in enumerate(self.layers):
            x = layer(x.relu() if k else x)
        return x * (1 + (x / LIMIT) ** 2).rsqrt() * self.share

    def expose(self) -> None:
        """Put the network as it is into the correction, in the features' own units."""
        weights = [[p.detach().clone() for p in layer.parameters()] for layer in self.layers]
        weights[0][0] /= self.spread
        weights[0][1] -= weights[0][0] @ self.centre
        weights[-1] = [p * (self.scale[:, None] if p.ndim == 2 else self.scale) for p in weights[-1]]
        values = [p for pair in weights for p in pair]
        values += [self.centre - CLIP * self.spread, self.centre + CLIP * self.spread, LIMIT * self.scale]
        self.correction.arrays = {n: v.numpy() for n, v in zip(ARRAYS, values, strict=True)}

    def fit(self, kept: Path, mark: str, label: str = "") -> dict[str, np.ndarray]:
        """The arrays that were best on ``CHECKED`` windows; ``<kept>.0.pt`` and ``.1.pt`` hold what was stopped."""
        recipe, stages = self.recipe, [Kept(kept.with_name(f"{kept.name}.{k}.pt"), mark, every=LOOK) for k in range(2)]

        def run(kept: Kept, loss: Callable[[], torch.Tensor], steps: int, rate: float, best: Best | None) -> None:
            schedule = cosine(rate, steps, least=1e-3, warm=RISE)
            fit(
                self.layers, lambda _: loss(), steps, schedule,
                label=f"{label}, {'windows' if best else 'frames'}", clip=NORM, kept=kept, rng=self._rng, best=best,
            )  # fmt: skip

        run(stages[0], self.single, recipe.warm, recipe.rate, None)
        course = Course(self.data, recipe.scaling, self.correction)
        checked = self.windows(CHECKED)
        usual = Course(self.data, recipe.scaling).gaps(*checked, recipe.horizon)

        def check() -> float:
            self.expose()
            return float((course.gaps(*checked, recipe.horizon)[0] / usual[0]).mean())

        run(stages[1], lambda: self.window(course, usual), recipe.steps, recipe.rate / 2, Best(check, LOOK))
        for stage in stages:
            stage.path.unlink(missing_ok=True)
        self.expose()
        return self.correction.arrays

    def single(self) -> torch.Tensor:
        """Smooth absolute error of the answers to a few single frames."""
        chosen = self._rng.integers(len(self.frames[0]), size=6)
        x, wanted = (part[chosen] for part in self.frames)
        return torch.nn.functional.smooth_l1_loss(self.forward(x), (wanted * self.share).clamp(-8, 8))

    def window(self, course: Course, usual: np.ndarray) -> torch.Tensor:
        """A number whose gradient is about that of the errors over ``usual`` ones, summed over a batch of windows."""
        self.expose()
        recipe, data = self.recipe, self.data
        frame, member = self.windows(recipe.batch)
        states, seen = course.run(frame, member, recipe.horizon)
        total = torch.zeros(())
        of_x, of_v = (np.zeros_like(_rows(states[0].positions)) for _ in range(2))  # gradients by both
        for k in range(recipe.horizon - 1, -1, -1):
            now = data.state(frame + k + 1, member)
            gaps = states[k].positions - now.positions, states[k].velocities - now.velocities
            pull_x, pull_v = (_pull(gap, size[k]) for gap, size in zip(gaps, usual, strict=True))
            of_v = recipe.memory * (of_v + self.dt * of_x) + recipe.velocities * pull_v
            of_x = recipe.memory * of_x + pull_x
            x, turn = seen[k]
            gradient = np.stack([of_x, of_v / self.dt], 2) @ np.swapaxes(turn, -1, -2) * self.unit
            weight = torch.from_numpy(gradient.reshape(*x.shape[:2], 6)) * self.scale
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
    name, seeds = weights_name(scene), range(FIRST_SEED, FIRST_SEED + recipe.seeds)
    for factor in factors:
        settings = asdict(recipe) | {"factors": load_factors(scene, factor, recipe.scaling)}
        if is_done(name, factor, settings, out):
            continue
        data = episodes(scene, seeds, factor, POLICIES, cache)
        held, began = episodes(scene, HELD_OUT, factor, POLICIES[:1], cache), process_time()
        trainer = Trainer(data, recipe)
        mark = dumps(settings | {"scene": spelled(data.scene)})
        fitted = trainer.fit(cache / f"{name}_{factor}_{digest(mark)}", mark, f"{scene} 1/{factor}")
        seconds, shown = process_time() - began, {}
        runs = {"calibrated": ("calibrated", None), recipe.scaling: (recipe.scaling, None)}
        for which, run in (runs | {"learned": (recipe.scaling, trainer.correction)}).items():
            found = Course(held, *run).errors(max(SHOWN))
            shown[which] = {str(k): float(f"{found[k - 1]:.4g}") for k in SHOWN}
        card = {
            "what": f"correction of the coarse dynamics of {scene}, once a frame",
            "data": f"decimated truth (float32), actions {', '.join(POLICIES)} in turn, {FRAMES} frames an episode",
            "valid": "the scene's own material; trained and scored on restarts from decimated truth, 10 frames",
        }
        errors = {"held-out error [% of length] after frames": shown}
        keep(name, factor, fitted, settings, seconds, errors, card, out)


def main(argv: Sequence[str] | None = None) -> int:
    """Train the corrections. Returns the exit code."""
    options = {"seeds": "of episodes", "warm": "steps on frames", "steps": "on windows", "hidden": "units a layer"}
    options |= {"memory": "of gradients from frame to frame"}
    given, recipe = read("dynamics", __doc__, Recipe, options, argv, factors=(2, 4))
    scenes, factors = ", ".join(given.scenes), ", ".join(map(str, given.factors))
    steps = f"{recipe.warm} steps on frames, {recipe.steps} on windows"
    plan("dynamics", f"{scenes} at factors {factors}, {steps}", given.out, given.cache)
    for scene in given.scenes:
        train(scene, given.factors, recipe, given.out, given.cache)
    return 0
