"""Frames of the cell one after another, through which gradients flow."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from torch import Tensor
from torch.utils.checkpoint import checkpoint

from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.cell.frame import frame
from surrogates.cell.sheet import Force, SheetCell


def rollout(
    cell: SheetCell, scene: Scene, sheets: Mapping[str, Tensor], x: Tensor, v: Tensor, start: State,
    drives: Sequence[Controls], substeps: int, hold: int = 1, forces: Sequence[Force] = (), *, recompute: bool = True,
) -> list[tuple[Tensor, Tensor]]:  # fmt: skip
    """Positions and velocities ``(B, 3, H, W)`` after each of the frames that ``drives`` drive.

    Arguments are those of ``frame``. Gradients reach ``cell.numbers``, ``sheets``, ``x``, ``v``, and bodies, handles,
    wind and pressure that are tensors. On the way back each frame is computed once more, so that what is kept is one
    frame's, however many there are; ``recompute=False`` keeps that of all frames.
    """
    found = list[tuple[Tensor, Tensor]]()
    for controls in drives:
        given = {"start": start, "controls": controls, "substeps": substeps, "hold": hold, "forces": forces}
        one = partial(frame, cell, scene, sheets, **given)
        x, v = checkpoint(one, x, v, use_reentrant=False) if recompute else one(x, v)
        found.append((x, v))
        start = replace(start, colliders=controls.colliders, collider_velocities=controls.collider_velocities)
    return found
