"""Contact of a cell with bodies, in torch: a sheet's by geometry and friction, a net's by velocities inside a ball."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from cloth_envs.scene import Collider
from surrogates.cell.planes import TINY


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(1, keepdim=True)


def _nearest(ends: Tensor, x: Tensor) -> tuple[Tensor, Tensor]:
    """Places in [0, 1] on the axes ``ends`` ``(B, 2, 3)`` nearest to ``x`` ``(B, 3, N)``, and the points there."""
    axis = (ends[:, 1] - ends[:, 0])[:, :, None]
    s = (_dot(x - ends[:, 0][:, :, None], axis) / _dot(axis, axis).clamp_min(TINY)).clamp(0, 1)
    return s, (1 - s) * ends[:, 0][:, :, None] + s * ends[:, 1][:, :, None]


def contact(
    body: Collider, x0: Tensor, x1: Tensor, v: Tensor, start: Tensor, end: Tensor, thickness: float, dt: float
) -> tuple[Tensor, Tensor]:
    """Corrected ``x1`` and ``v`` ``(B, 3, N)``: see ``laws.bodies.resolve_body``."""
    radius = body.radius + thickness
    if body.kind == "plane":
        n = end[:, 1][:, :, None].expand_as(x1)
        gap = _dot(n, x1 - end[:, 0][:, :, None]) - radius
        carried = ((end[:, 0] - start[:, 0]) / dt)[:, :, None]
        touching = gap < 0
    else:
        p0 = x0 - _nearest(start, x0)[1]
        s, point = _nearest(end, x1)
        p1, carried = x1 - point, ((1 - s) * (end - start)[:, 0, :, None] + s * (end - start)[:, 1, :, None]) / dt
        d = p1 - p0
        outside, along = _dot(p0, p0) - radius * radius, _dot(p0, d)
        root = along * along - _dot(d, d) * outside
        first = outside / torch.where(along < 0, root.clamp_min(TINY).sqrt() - along, 1)
        enters = (outside >= 0) & (along < 0) & (root > 0) & (first <= 1)
        at = torch.where(enters, p0 + first * d, p0)
        n = at / (_dot(at, at) + TINY).sqrt()
        gap = _dot(n, p1) - radius
        touching = (gap < 0) & (enters | (outside < 0)) & (_dot(p0, p0) > 0)
    relative = v - carried
    speed = _dot(n, relative)
    stop = torch.where(touching, (-speed).clamp_min(0), 0)
    sliding = relative - speed * n
    hold = (body.friction * stop / (_dot(sliding, sliding) + TINY).sqrt()).clamp_max(1)
    return x1 + torch.where(touching, -gap, 0) * n - dt * hold * sliding, v + stop * n - hold * sliding


class Ball(NamedTuple):
    """``centre`` and ``velocity`` ``(B, 3)``, ``radius`` [m]; ``keep`` is what a step inside leaves of a velocity."""

    centre: Tensor
    velocity: Tensor
    radius: float
    keep: float


def hit_ball(positions: Tensor, velocities: Tensor, ball: Ball) -> Tensor:
    """Velocities after a step inside a ball: no inward part, then ``keep`` of the rest, relative to the ball."""
    moving = ball.velocity[:, :, None, None]
    d, u = positions - ball.centre[:, :, None, None], velocities - moving
    away = d.norm(dim=1, keepdim=True)
    n = d / away.clamp_min(torch.finfo(d.dtype).tiny)
    left = ball.keep * (u - (u * n).sum(1, keepdim=True).clamp_max(0) * n)
    return torch.where(away < ball.radius, left + moving, velocities)
