"""Frames of the cell one after another, through which gradients flow."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from torch import Tensor
from torch.utils.checkpoint import checkpoint

from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.cell.frame import frame
from surrogates.cell.sheet import Force, SheetCell


def rollout(
    cell: SheetCell, scene: Scene, sheets: Mapping[str, Tensor], x: Tensor, v: Tensor, start: State,
    drives: Sequence[Controls], substeps: int, hold: int = 1, forces: Sequence[Force] = (), *, recompute: bool = False,
) -> list[tuple[Tensor, Tensor]]:  # fmt: skip
    """Positions and velocities ``(B, 3, H, W)`` after each of the frames that ``drives`` drive.

    Arguments are those of ``frame``. Gradients reach ``cell.numbers``, ``sheets``, ``x``, ``v``, and bodies, handles,
    wind and pressure that are tensors. ``recompute`` keeps what gradients need of one frame only, however many there
    are, and computes each once more on the way back: for large batches (docs/networks.md has what that costs).
    """
    found = list[tuple[Tensor, Tensor]]()
    for controls in drives:
        given = cell, scene, sheets, x, v, start, controls, substeps, hold, forces
        x, v = checkpoint(frame, *given, use_reentrant=False) if recompute else frame(*given)
        found.append((x, v))
        start = replace(start, colliders=controls.colliders, collider_velocities=controls.collider_velocities)
    return found
