"""The cell on a sheet, and what is plugged in to it, in torch: a reference that can be differentiated and trained.

Forces are those of ``cloth_envs.physics.laws.sheet`` with a learned number for every class of edges and branch. Every
edge is evaluated once and acts on both ends, so momentum is kept exactly whatever was learned.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from cloth_envs.material import Material
from cloth_envs.physics.laws.drives import hermite
from cloth_envs.physics.laws.stencil import edges, triples
from cloth_envs.scene import Collider, Scene
from cloth_envs.state import Controls, State
from surrogates.cell.numbers import CLASSES
from surrogates.cell.stencil import Force

TINY = 1e-30  # m^2 and m^2/s^2, under roots that would have no slope at 0


class Sheets(NamedTuple):
    """The materials of a batch, each ``(B, 1, 1, 1)``; ``drag`` is 0 where a scene has none."""

    areal_density: Tensor
    stretch_stiffness: Tensor
    shear_stiffness: Tensor
    bend_stiffness: Tensor
    damping: Tensor
    drag: Tensor
    compression: Tensor
    buckling_strain: Tensor
    post_buckling: Tensor
    compression_damping: Tensor

    @classmethod
    def of(cls, scene: Scene, materials: Sequence[Material], like: Tensor) -> Sheets:
        """``materials`` in the type and on the device of ``like``."""
        rows = [[getattr(m, name) * (scene.drag if name == "drag" else 1) for name in cls._fields] for m in materials]
        return cls(*torch.as_tensor(np.array(rows).T, dtype=like.dtype, device=like.device)[..., None, None, None])


def _shift(plane: Tensor, top: int, left: int, shape: tuple[int, int]) -> Tensor:
    """``plane`` placed at row ``top`` and column ``left`` among zeros of ``shape``."""
    down, right = shape[0] - top - plane.shape[-2], shape[1] - left - plane.shape[-1]
    return functional.pad(plane, (left, right, top, down))


def _cut(field: Tensor, top: int, left: int, size: tuple[int, int]) -> Tensor:
    return field[..., top : top + size[0], left : left + size[1]]


class SheetCell(nn.Module):
    """Forces of stretch, shear, damping and bending, and the weight, times ``numbers`` ``(17,)`` (of ``CLASSES``).

    On an edge ``f = k alpha d - k L beta n + c k gamma (w . n) n``, with ``n = d / |d|``; all numbers are 1 (the
    sideways biases 0) on the reference. Where the material yields, a shortened edge has less of the first two and more
    of the last (``laws.sheet.spring_forces``): with the factors of ``scaling="closure"`` it is the cell of a coarse
    sheet. Materials come with the call, so weights belong to none.

    Args:
        scene: for its grid and gravity.
        numbers: where to start; default the reference's own.
        dtype: of parameters and geometry.

    Raises:
        ValueError: a periodic grid.
    """

    areas: Tensor

    def __init__(self, scene: Scene, numbers: np.ndarray | None = None, *, dtype: torch.dtype = torch.float32) -> None:
        super().__init__()
        grid = scene.grid
        if grid.periodic:
            raise ValueError("this cell steps flat sheets, the grid is a tube: use the compiled engine")
        self.shape, self.gravity = grid.shape, scene.gravity
        start = np.array([name not in ("bias_x", "bias_y") for name in CLASSES], float) if numbers is None else numbers
        self.numbers = nn.Parameter(torch.as_tensor(start, dtype=dtype))
        rows, cols = grid.shape
        sizes = (rows, cols - 1), (rows - 1, cols), (rows - 1, cols - 1), (rows - 1, cols - 1)
        ends = ((0, 0), (0, 1)), ((0, 0), (1, 0)), ((0, 0), (1, 1)), ((0, 1), (1, 0))
        self.edges = list(zip(edges(grid), sizes, ends, strict=True))
        for k, (edge, size, _) in enumerate(self.edges):
            self.register_buffer(f"share{k}", torch.as_tensor(edge.weight.reshape(size), dtype=dtype), persistent=False)
        bends = ((rows, cols - 2), (0, 1)), ((rows - 2, cols), (1, 0))
        self.bends = list(zip(triples(grid), bends, strict=True))
        for k, (triple, (size, _)) in enumerate(self.bends):
            self.register_buffer(
                f"bend{k}", torch.as_tensor(triple.weight.reshape(size), dtype=dtype), persistent=False
            )
        self.register_buffer("areas", torch.as_tensor(grid.areas, dtype=dtype), persistent=False)

    def forward(self, x: Tensor, v: Tensor, sheets: Sheets) -> Tensor:
        """Forces ``(B, 3, H, W)`` [N]."""
        total = torch.zeros_like(x)
        for k, (edge, size, (first, second)) in enumerate(self.edges):
            alpha, beta, gamma = self.numbers[k], self.numbers[4 + k], self.numbers[8 + k]
            d, w = (_cut(a, *second, size) - _cut(a, *first, size) for a in (x, v))
            inverse = torch.rsqrt((d * d).sum(1, keepdim=True) + TINY)
            ratio = edge.rest * beta * inverse
            strain = alpha - ratio
            short = strain.clamp_max(0)
            before = torch.maximum(short, -sheets.buckling_strain * ratio)
            pull = strain.clamp_min(0) + sheets.compression * (before + sheets.post_buckling * (short - before))
            damping = sheets.damping * gamma * torch.where(strain < 0, sheets.compression_damping, 1)
            rate = damping * (w * d).sum(1, keepdim=True) * inverse * inverse
            force = getattr(sheets, edge.modulus) * getattr(self, f"share{k}") * (pull + rate) * d
            total = total + _shift(force, *first, self.shape) - _shift(force, *second, self.shape)
        for k, (_, (size, (down, right))) in enumerate(self.bends):
            before, middle, after = (_cut(x, n * down, n * right, size) for n in range(3))
            force = (
                self.numbers[12 + k] * sheets.bend_stiffness * getattr(self, f"bend{k}") * (before - 2 * middle + after)
            )
            placed = [_shift(force, n * down, n * right, self.shape) for n in range(3)]
            total = total - placed[0] + 2 * placed[1] - placed[2]
        signs = self.numbers.new_tensor([1.0, 1.0, -1.0])
        weight = self.gravity * self.mass(sheets) * (signs * self.numbers[14:])[:, None, None]
        return total + weight

    def mass(self, sheets: Sheets) -> Tensor:
        """Lumped masses ``(B, 1, H, W)`` [kg]."""
        return sheets.areal_density * self.areas


def air_forces(scene: Scene, x: Tensor, v: Tensor, wind: Tensor, pressure: Tensor) -> Tensor:
    """Wind ``(B, 3)`` (Wejchert & Haumann 1991) and ``pressure`` ``(B,)`` on the four facets of every cell [N].

    See ``laws.air.wind_forces``; facets of both diagonals count half.
    """
    shape = scene.grid.shape
    size = scene.grid.cells
    places = (0, 0), (0, 1), (1, 1), (1, 0)  # upper left, upper right, lower right, lower left
    corners, speeds = ([_cut(a, *at, size) for at in places] for a in (x, v))
    total = torch.zeros_like(x)
    for one, two, three in ((0, 3, 2), (0, 2, 1), (0, 3, 1), (3, 2, 1)):
        normal = torch.linalg.cross(corners[two] - corners[one], corners[three] - corners[one], dim=1)
        force = torch.zeros_like(normal)
        if scene.pressure:
            force = force + pressure[:, None, None, None] * normal / 2
        if scene.wind is not None:
            twice_area = ((normal * normal).sum(1, keepdim=True) + TINY).sqrt()
            n = normal / twice_area
            relative = (speeds[one] + speeds[two] + speeds[three]) / 3 - wind[:, :, None, None]
            across = (n * relative).sum(1, keepdim=True)
            slide = relative - across * n
            speed = ((slide * slide).sum(1, keepdim=True) + TINY).sqrt()
            stress = scene.wind.normal * across.abs() * across * n + scene.wind.tangential * speed * slide
            force = force - scene.wind.air_density / 4 * twice_area * stress
        for corner in (one, two, three):
            total = total + _shift(force / 6, *places[corner], shape)
    return total


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


class Moves(NamedTuple):
    """What is driven in a frame: bodies ``(B, C, 2, 3)`` from, to; handles ``(B, 3, N)`` to; wind; pressure."""

    bodies: Tensor
    bodies_rate: Tensor
    bodies_end: Tensor
    bodies_end_rate: Tensor
    handles_end: Tensor
    handles_end_rate: Tensor
    wind: Tensor
    pressure: Tensor

    @classmethod
    def of(cls, state: State, controls: Controls, like: Tensor) -> Moves:
        """From the state at the frame's start and its controls, in the type and on the device of ``like``."""
        arrays = (
            state.colliders, state.collider_velocities, controls.colliders, controls.collider_velocities,
            controls.handle_positions.transpose(0, 2, 1), controls.handle_velocities.transpose(0, 2, 1),
            controls.wind, controls.pressure,
        )  # fmt: skip
        return cls(*(torch.as_tensor(np.ascontiguousarray(a), dtype=like.dtype, device=like.device) for a in arrays))


def frame(
    cell: SheetCell, scene: Scene, sheets: Sheets, x: Tensor, v: Tensor, moves: Moves, substeps: int,
    forces: Sequence[Force] = (),
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """One frame of ``substeps`` symplectic Euler steps, as ``laws.step``; ``forces`` are plugged in [N]."""
    h, held = scene.frame_dt / substeps, list(scene.handles)
    decay = torch.exp(-sheets.drag * h)
    lag = torch.where(sheets.drag > 0, -torch.expm1(-sheets.drag * h) / sheets.drag.clamp_min(TINY), h)
    from_x, from_v = (a.flatten(2)[..., held] for a in (x, v))
    shape, flat = x.shape, x.flatten(2).shape
    index = torch.tensor(held, dtype=torch.long, device=x.device)
    cubic = moves.bodies, moves.bodies_rate, moves.bodies_end, moves.bodies_end_rate
    bodies, dt = moves.bodies, scene.frame_dt
    for k in range(1, substeps + 1):
        force = cell(x, v, sheets)
        if scene.wind is not None or scene.pressure:
            force = force + air_forces(scene, x, v, moves.wind, moves.pressure)
        for extra in forces:
            force = force + extra(x, v)
        v = decay * v + lag / cell.mass(sheets) * force
        before, x = x, x + h * v
        moved: Tensor = hermite(k / substeps, dt, *cubic)[0]  # type: ignore[arg-type, assignment]
        for i, body in enumerate(scene.colliders):
            touched = contact(
                body, before.reshape(flat), x.reshape(flat), v.reshape(flat), bodies[:, i], moved[:, i],
                scene.thickness, h,
            )  # fmt: skip
            x, v = (a.reshape(shape) for a in touched)
        bodies = moved
        if held:
            ends = moves.handles_end, moves.handles_end_rate
            place, rate = hermite(k / substeps, dt, from_x, from_v, *ends)  # type: ignore[arg-type]
            x, v = (a.flatten(2).index_copy(2, index, b).reshape(shape) for a, b in ((x, place), (v, rate)))  # type: ignore[arg-type]
    return x, v
