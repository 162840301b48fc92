"""The losses of Chen et al. 2020 (eqs 2 to 6)."""

from dataclasses import dataclass

import torch
from torch import Tensor

from surrogates.superres.image import Range
from training.superres.frames import Aligned


@dataclass(frozen=True)
class Weights:
    """Of the losses of normals, velocities and kinematics beside that of displacements, which is 1."""

    normal: float = 0.0
    velocity: float = 0.0
    kinematic: float = 0.0


ALL = Weights(0.1, 0.1, 0.01)  # the published ones are not legible in our copy


def kinematic(x: Tensor, v: Tensor, frame_dt: float) -> Tensor:
    """Eq. 5: the mean square of ``x_{t+n} - x_t - dt (v_{t+1} + ... + v_{t+n})`` [m^2].

    ``x`` and ``v`` are ``(windows, n + 1, 3, H, W)`` in the world's axes [m, m/s], for frames have alignments of their
    own, which would break the identity.
    """
    return (x[:, -1] - x[:, 0] - frame_dt * v[:, 1:].sum(1)).square().sum(1).mean()


def loss(found: Tensor, truth: Tensor, weights: Weights, scale: Range, aligned: Aligned, frames: Tensor) -> Tensor:
    """Eq. 6 of normalised images ``(windows (n + 1), C, H, W)`` at ``frames`` ``(windows, n + 1)``."""
    gap = (found - truth).square()
    total = gap[:, :3].mean()
    if weights.normal:
        total = total + weights.normal * gap[:, 3:6].mean()
    if weights.velocity:
        total = total + weights.velocity * gap[:, 6:].mean()
    if weights.kinematic:
        x, v = in_world(found, scale, aligned, frames.flatten())
        shape = (*frames.shape, *x.shape[1:])
        total = total + weights.kinematic * kinematic(x.view(shape), v.view(shape), aligned.pairs.frame_dt)
    return total


def in_world(found: Tensor, scale: Range, aligned: Aligned, frames: Tensor) -> tuple[Tensor, Tensor]:
    """Positions [m] and velocities [m/s] that normalised images of nine channels tell, ``(n, 3, H, W)`` each."""
    image, align = scale.back(found), aligned.at(frames)
    return align.back(image[:, :3] + aligned.rests[1]), align._replace(turn=align.turn.mT).vectors(image[:, 6:])


def positions(found: Tensor, scale: Range, aligned: Aligned, frames: Tensor) -> Tensor:
    """Positions [m] of the displacements in normalised images of three channels or more, ``(n, 3, H, W)``."""
    image = found[:, :3] * scale.width[:, :3] + scale.low[:, :3]
    moved: Tensor = aligned.at(frames).back(image + aligned.rests[1])
    return moved


def feature_psnr(found: Tensor, truth: Tensor) -> list[float]:
    """PSNR [dB] of displacement, normal and velocity in normalised images."""
    parts = torch.split((found - truth).square(), 3, 1)
    return [-10 * torch.log10(part.double().mean()).item() for part in parts]
