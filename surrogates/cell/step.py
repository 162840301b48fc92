"""A frame of the cell on a sheet and a step of that on a net, in torch, with all that is plugged in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from cloth_envs.physics.laws.step import hermite
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.cell.air import air_forces, pressure_force
from surrogates.cell.bodies import Ball, contact, hit_ball
from surrogates.cell.planes import TINY, Force
from surrogates.cell.sheet import SheetCell, Sheets


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


class Held(NamedTuple):
    """Driven particles: flat ``vertices`` ``(N,)``, their ``places`` and ``rates`` ``(B, 3, N)`` after the step."""

    vertices: Tensor
    places: Tensor
    rates: Tensor


def step(
    cell: Force,
    positions: Tensor,
    velocities: Tensor,
    *,
    dt: float,
    mass: float = 1.0,
    decay: float = 1.0,
    pressure: Tensor | None = None,
    forces: Sequence[Force] = (),
    balls: Sequence[Ball] = (),
    held: Held | None = None,
) -> tuple[Tensor, Tensor]:
    """One semi-implicit step of fig. 2: the cell, what is plugged in, constraints, then ``x += dt v`` (eq. 5).

    Args:
        dt: [s]. mass: of a particle [kg]. decay: what air drag leaves of a velocity in a step.
        pressure: ``(B,)`` [Pa] of eq. 3.
        forces: more of them, from a simulator or from sub-networks [N].
        balls: contact with friction.
        held: boundary conditions, encoded hard: these particles go where they are driven.
    """
    force = cell(positions, velocities)
    if pressure is not None:
        force = force + pressure_force(positions, pressure)
    for extra in forces:
        force = force + extra(positions, velocities)
    velocities = (velocities + dt / mass * force) * decay
    for ball in balls:
        velocities = hit_ball(positions, velocities, ball)
    positions = positions + dt * velocities
    if held is not None:
        shape = positions.shape
        positions = positions.flatten(2).index_copy(2, held.vertices, held.places).reshape(shape)
        velocities = velocities.flatten(2).index_copy(2, held.vertices, held.rates).reshape(shape)
    return positions, velocities
