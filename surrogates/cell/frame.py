"""A frame of the cell on a sheet in torch, with all that is plugged in: air, bodies, handles, forces of one's own."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from cloth_envs.physics.laws.air import OWN
from cloth_envs.physics.laws.bodies import DEEP, SWEEPS, TURN_LEAST
from cloth_envs.physics.laws.drives import handle_starts, hermite
from cloth_envs.physics.laws.step import foresight, kicks
from cloth_envs.scene import Collider, Scene
from cloth_envs.state import Controls, State
from surrogates.cell.sheet import TINY, Force, SheetCell, cut, place


def air_forces(scene: Scene, x: Tensor, v: Tensor, wind: Tensor, pressure: Tensor) -> Tensor:
    """The scene's air, moved by ``wind`` ``(B, 3)``, and ``pressure`` ``(B,)`` on cells [N]: see ``laws.air``."""
    air = scene.air
    places = (0, 0), (0, 1), (1, 1), (1, 0)  # upper left, upper right, lower right, lower left
    corners = [cut(x, at, scene.grid.cells) for at in places]
    area = torch.linalg.cross(corners[2] - corners[0], corners[1] - corners[3], dim=1) / 2
    force = rate = mean = torch.zeros_like(area)
    speeds = [cut(v, at, scene.grid.cells) for at in places]
    if air is not None:
        size = (_dot(area, area) + TINY).sqrt()
        n = area / size
        mean = (speeds[0] + speeds[1] + speeds[2] + speeds[3]) / 4
        relative = mean - wind[:, :, None, None]
        across = _dot(n, relative)
        slide = relative - across * n
        speed = (_dot(slide, slide) + TINY).sqrt()
        rate = air.density / 8 * size * (air.normal * across.abs() + air.lift * speed)
        force = -rate * across * n - air.density / 8 * size * air.tangential * speed * slide
    total = torch.zeros_like(x)
    for k, at in enumerate(places):
        share = force - OWN * rate * (speeds[k] - mean)
        if scene.pressure:  # a third of half of each triangle but the one without this corner
            before, after = corners[k - 1], corners[(k + 1) % 4]
            missing = torch.linalg.cross(before - after, corners[k - 2] - after, dim=1) / 2
            share = share + pressure[:, None, None, None] * (2 * area - missing) / 6
        total = total + place(share, at, scene.grid.shape)
    return total


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(1, keepdim=True)


def _nearest(ends: Tensor, x: Tensor) -> tuple[Tensor, Tensor]:
    """Places in [0, 1] on the axes ``ends`` ``(B, 2, 3)`` nearest to ``x`` ``(B, 3, N)``, and the points there."""
    axis = (ends[:, 1] - ends[:, 0])[:, :, None]
    s = (_dot(x - ends[:, 0][:, :, None], axis) / _dot(axis, axis).clamp_min(TINY)).clamp(0, 1)
    return s, (1 - s) * ends[:, 0][:, :, None] + s * ends[:, 1][:, :, None]


def spin(body: Collider, start: Tensor, end: Tensor, number: int) -> Tensor | None:
    """By how much a capsule turns about its axis, ``(B, 3)`` [rad], or None: see ``laws.bodies.spin``."""
    if body.turns_with is None:
        return None
    first, was, axis, is_ = (at[:, i, 1] - at[:, i, 0] for at in (start, end) for i in (number, body.turns_with))
    across = [b - _dot(b, a) / _dot(a, a).clamp_min(TINY) * a for a, b in ((first, was), (axis, is_))]
    square = torch.maximum(_dot(across[1], across[1]), TURN_LEAST * _dot(is_, is_)) * _dot(axis, axis)
    return _dot(axis, torch.linalg.cross(*across, dim=1)) / square.clamp_min(TINY) * axis


def leave(body: Collider, x: Tensor, end: Tensor, thickness: float) -> Tensor:
    """Positions ``(B, 3, N)`` of which those deep inside a body are put onto its surface: see ``laws.bodies.leave``."""
    radius = body.radius + thickness
    if body.kind == "plane":
        n = end[:, 1][:, :, None]
        gap = _dot(n, x - end[:, 0][:, :, None]) - radius
        return x + torch.where(gap < -DEEP, -gap, 0) * n
    p = x - _nearest(end, x)[1]
    size = (_dot(p, p) + TINY).sqrt()
    return x + torch.where(size < radius - DEEP, radius / size - 1, 0) * p


def contact(
    body: Collider, x0: Tensor, x1: Tensor, v: Tensor, start: Tensor, end: Tensor, thickness: float, dt: float,
    turn: Tensor | None = None,
) -> tuple[Tensor, Tensor]:  # fmt: skip
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
    if turn is not None:
        carried = carried + radius / dt * torch.linalg.cross(turn[:, :, None].expand_as(n), n, dim=1)
    relative = v - carried
    speed = _dot(n, relative)
    stop = torch.where(touching, (-speed).clamp_min(0), 0)
    sliding = relative - speed * n
    hold = (body.friction * stop / (_dot(sliding, sliding) + TINY).sqrt()).clamp_max(1)
    x1 = x1 + torch.where(touching, -gap, 0) * n - dt * hold * sliding
    if body.kind == "capsule":
        p = x1 - _nearest(end, x1)[1]
        size = (_dot(p, p) + TINY).sqrt()
        x1 = x1 + torch.where(size < radius, radius / size - 1, 0) * p
    return x1, v + stop * n - hold * sliding


def all_contact(
    scene: Scene, x: Tensor, after: Tensor, v: Tensor, bodies: Tensor, moved: Tensor, dt: float
) -> tuple[Tensor, Tensor]:
    """Positions ``after`` a step from ``x`` and velocities, flat, out of all bodies: see ``laws.bodies``."""
    before, now, v = (a.flatten(2) for a in (x, after, v))
    for i, body in enumerate(scene.colliders):
        turn = spin(body, bodies, moved, i)
        now, v = contact(body, before, now, v, bodies[:, i], moved[:, i], scene.thickness, dt, turn)
    for _ in range(SWEEPS if len(scene.colliders) > 1 else 0):
        last = now
        for i, body in enumerate(scene.colliders):
            now = leave(body, now, moved[:, i], scene.thickness)
        if now.device.type == "cpu" and torch.equal(now, last):  # a device would have to be waited for
            break
    return now, v


def frame(
    cell: SheetCell, scene: Scene, sheets: Mapping[str, Tensor], x: Tensor, v: Tensor, start: State, controls: Controls,
    substeps: int, hold: int = 1, forces: Sequence[Force] = (),
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """``x`` and ``v`` after a frame of ``substeps``, as ``laws.step``: slow forces are held for ``hold`` of them.

    ``start`` is for its bodies, ``forces`` are plugged in [N] in every substep. Fields of ``start`` and ``controls``
    may be tensors, to which gradients then flow.
    """

    def tensor(a: np.ndarray | Tensor) -> Tensor:
        return torch.as_tensor(a, dtype=x.dtype, device=x.device)

    dt, held, shape = scene.frame_dt, list(scene.handles), x.shape
    h = dt / substeps
    drag, part, past, slow = sheets["drag"], kicks(substeps).tolist(), v, torch.zeros_like(x)
    wind, pressure = tensor(controls.wind), tensor(controls.pressure)
    index = torch.tensor(held, dtype=torch.int64, device=x.device)
    ends = [tensor(a).mT for a in (controls.handle_positions, controls.handle_velocities)]
    now = [a.flatten(2)[..., held].transpose(1, 2) for a in (x, v)]
    starts: list[Tensor] = handle_starts(scene, *now, ends[0].transpose(1, 2))  # type: ignore[arg-type, assignment, call-arg]
    handles = [*(a.transpose(1, 2) for a in starts), *ends]
    firm = torch.as_tensor(scene.holding.firm, device=x.device)
    soft = tensor(np.where(scene.holding.firm[:, None], 0.0, scene.holding.hold).T)
    rate = soft * (sheets["stretch_stiffness"] / sheets["areal_density"])[..., 0]
    bodies, *rest = (tensor(a) for part in (start, controls) for a in (part.colliders, part.collider_velocities))
    cubic = [bodies, *rest]
    springs, bending, air = cell.fused(cell.springs), cell.fused(cell.bending), cell.fused(air_forces)

    def pulled(x: Tensor, v: Tensor, path: Tensor, time: float) -> Tensor:  # as laws.drives.pull_handles
        pull = time * rate * (path - x.flatten(2)[..., held])
        return v.flatten(2).index_add(2, index, pull).reshape(shape)

    for k in range(substeps + 1):
        if k % hold == 0:
            later, trend = foresight(k, hold, substeps)
            then, seen = x + later * h * v, v + trend * (v - past)
            past, slow = v, bending(then, sheets)
            if scene.air is not None or scene.pressure:
                slow = slow + air(scene, then, seen, wind, pressure)
        force = springs(x, v, sheets) + slow
        for extra in forces:
            force = force + extra(x, v)
        time = h * part[k]
        if k == 0:
            v = pulled(x, v, handles[0], -h / 2)
        lag = torch.where(drag > 0, -torch.expm1(-drag * time) / drag.clamp_min(TINY), time)
        v = torch.exp(-drag * time) * v + lag / cell.mass(sheets) * force
        end, step = (k + 1) / substeps, h
        if k == substeps:  # what contact leaves of velocities that go on for half a substep
            end, step = (k + 0.5) / substeps, h / 2
        after = x + step * v
        moved: Tensor = hermite(end, dt, *cubic)[0]  # type: ignore[arg-type, assignment]
        after, v = (a.reshape(shape) for a in all_contact(scene, x, after, v, bodies, moved, step))
        bodies = moved
        if k < substeps:
            x = after
        if held:
            cubics: tuple[Tensor, Tensor] = hermite(min(end, 1.0), dt, *handles)  # type: ignore[arg-type, assignment]
            path, speed = cubics
            drawn = h * rate / (1 + h * h * rate) * (path - x.flatten(2)[..., held])  # as laws.drives.put_handles
            drawn = drawn if k < substeps else torch.zeros_like(drawn)
            driven = [
                torch.where(firm, a, b.flatten(2)[..., held] + c)
                for a, b, c in ((path, x, h * drawn), (speed, v, drawn))
            ]
            x, v = (a.flatten(2).index_copy(2, index, b).reshape(shape) for a, b in zip((x, v), driven, strict=True))
    return x, pulled(x, v, handles[2], h / 2)
