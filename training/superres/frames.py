"""Pairs of a coarse cloth and a fine one that follows it, as tensors, and how a guess of the fine one is scored."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from cloth_envs.grid import Grid
from cloth_envs.scene import Scene
from surrogates.superres.image import Alignment, Range, at_rest, image, normals
from training.superres.pairs import Pair

CHUNK = 32  # frames at a time


class Frames(NamedTuple):
    """N frames. Those of a run follow each other; where ``run`` changes the next one begins.

    Attributes:
        coarse, fine: positions [m], ``(N, 3, h, w)`` and ``(N, 3, H, W)``. run: ``(N,)`` on the host.
        small, large: the grids. frame_dt: [s].
    """

    coarse: Tensor
    fine: Tensor
    run: Tensor
    small: Grid
    large: Grid
    frame_dt: float

    def to(self, device: torch.device) -> "Frames":
        """The same on ``device``."""
        return self._replace(coarse=self.coarse.to(device), fine=self.fine.to(device))

    def starts(self, before: int, after: int) -> Tensor:
        """Frames that have ``before`` frames of their run before and ``after`` behind them, ``(n,)`` on the host."""
        last, number = len(self.run) - after, torch.arange(before, len(self.run) - after)
        return number[self.run[: last - before] == self.run[before + after :]]


class Around(NamedTuple):
    """What is around the coarse cloths of frames.

    Attributes:
        held: 1 where a coarse vertex is driven, else 0, ``(runs, h, w)``.
        bodies: ``(N, C, 2, 3)`` [m] as of ``State.colliders``. radii: with the thickness of contact, ``(runs, C)`` [m].
        planes: which bodies are planes.
    """

    held: Tensor
    bodies: Tensor
    radii: Tensor
    planes: Sequence[bool]

    def to(self, device: torch.device) -> "Around":
        """The same on ``device``."""
        return Around(self.held.to(device), self.bodies.to(device), self.radii.to(device), self.planes)


def frames_of(pairs: Sequence[Pair]) -> tuple[Frames, Around]:
    """All frames of ``pairs`` but the starts, and what is around the coarse cloths."""

    def cloths(name: str) -> Tensor:
        return torch.from_numpy(
            np.concatenate([np.moveaxis(getattr(pair, name).positions[1:], -1, 1) for pair in pairs])
        )

    few, many = pairs[0].coarse.scene, pairs[0].fine.scene
    bodies = np.concatenate([pair.bodies[1:] for pair in pairs]).astype(np.float32)
    run = torch.tensor([pair.number for pair in pairs]).repeat_interleave(len(pairs[0].coarse.positions) - 1)
    frames = Frames(cloths("coarse"), cloths("fine"), run, few.grid, many.grid, few.frame_dt)
    return frames, around([pair.coarse.scene for pair in pairs], bodies)


def around(scenes: Sequence[Scene], bodies: np.ndarray) -> Around:
    """What is around coarse cloths: the scene of every run, and the bodies of every frame ``(N, C, 2, 3)`` [m]."""
    held = np.zeros((len(scenes), *scenes[0].grid.shape), np.float32)
    radii = np.zeros((len(scenes), len(scenes[0].colliders)), np.float32)
    for k, scene in enumerate(scenes):
        held[k].flat[list(scene.handles)] = 1
        radii[k] = [body.radius + scene.thickness for body in scene.colliders]
    planes = [body.kind == "plane" for body in scenes[0].colliders]
    return Around(torch.from_numpy(held), torch.from_numpy(bodies), torch.from_numpy(radii), planes)


class Aligned(NamedTuple):
    """Pairs with what brings every coarse frame onto the sheet at rest."""

    pairs: Frames
    align: Alignment
    rests: tuple[Tensor, Tensor]

    @classmethod
    def of(cls, pairs: Frames) -> "Aligned":
        device = pairs.coarse.device
        rests = at_rest(pairs.small), at_rest(pairs.large)
        align = Alignment.of(pairs.coarse.cpu(), rests[0])
        there = Alignment(*(part.to(device) for part in align))
        return cls(pairs, there, (rests[0].to(device), rests[1].to(device)))

    def at(self, frames: Tensor) -> Alignment:
        """Of some frames."""
        return Alignment(self.align.turn[frames], self.align.centre[frames], self.align.target)

    def images(self, frames: Tensor) -> tuple[Tensor, Tensor]:
        """Geometry images of both cloths at ``frames``, none of which begins a run: velocities are differences."""
        at, (_, _, _, small, large, dt) = self.at(frames), self.pairs
        out = []
        for x, rest, grid in zip((self.pairs.coarse, self.pairs.fine), self.rests, (small, large), strict=True):
            now = x[frames]
            out.append(image(now, (now - x[frames - 1]) / dt, rest, at, grid.periodic))
        return out[0], out[1]

    def range(self) -> Range:
        """Of the fine images of all frames."""
        frames = self.pairs.starts(1, 0)
        ends = [Range.of(self.images(part)[1]) for part in torch.split(frames, CHUNK)]
        low = torch.stack([end.low for end in ends]).amin(0)
        return Range(low, torch.stack([end.low + end.width for end in ends]).amax(0) - low)


def wrinkles(x: Tensor) -> Tensor:
    """A vertex less the mean of its four neighbours, at inner vertices: ``(B, 3, H - 2, W - 2)``."""
    around = x[:, :, :-2, 1:-1] + x[:, :, 2:, 1:-1] + x[:, :, 1:-1, :-2] + x[:, :, 1:-1, 2:]
    return x[:, :, 1:-1, 1:-1] - around / 4


def score(aligned: Aligned, scale: Range, guess: Callable[[Tensor], Tensor], frames: Sequence[int]) -> dict[str, float]:
    """How far ``guess(frames)`` ``(n, 3, H, W)`` is from the fine cloths, over ``frames``, which follow each other.

    Returns:
        ``rms`` [mm]; ``vmse`` [m^2], the mean squared distance; ``psnr`` [dB] of the normalised displacement image;
        ``normal`` [degrees], the mean angle of vertex normals; ``flicker`` [mm/frame^2], the root mean square of the
        error's second difference in time; ``amplitude``, that of the wrinkles over the truth's.
    """
    pairs, numbers = aligned.pairs, torch.as_tensor(frames)
    square = noise = angle = found_waves = true_waves = 0.0
    gaps = []
    for part in torch.split(numbers, CHUNK):
        x, truth = guess(part), pairs.fine[part]
        gap = x - truth
        gaps.append(1000 * gap)
        square += gap.double().square().sum(1).mean((1, 2)).sum().item()
        noise += (aligned.at(part).vectors(gap) / scale.width[:, :3]).double().square().mean((1, 2, 3)).sum().item()
        n, m = (normals(cloth, pairs.large.periodic).double() for cloth in (x, truth))
        halves = torch.atan2((n - m).norm(dim=1), (n + m).norm(dim=1))
        angle += torch.rad2deg(2 * halves).mean((1, 2)).sum().item()
        found_waves += wrinkles(x).double().square().mean((1, 2, 3)).sum().item()
        true_waves += wrinkles(truth).double().square().mean((1, 2, 3)).sum().item()
    error, run, count = torch.cat(gaps), pairs.run[numbers], len(numbers)
    inside = torch.arange(1, count - 1)[run[:-2] == run[2:]]
    jumps = [(error[k + 1] - 2 * error[k] + error[k - 1]).square() for k in inside.tolist()]
    flicker = torch.stack([jump.sum(0).mean() for jump in jumps]).mean().sqrt().item() if jumps else float("nan")
    vmse, noise = square / count, noise / count
    return {
        "rms": 1e3 * vmse**0.5,
        "vmse": vmse,
        "psnr": -10 * torch.tensor(noise).log10().item(),
        "normal": angle / count,
        "flicker": flicker,
        "amplitude": (found_waves / true_waves) ** 0.5,
    }
