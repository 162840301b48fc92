"""Every metric on any two trajectories: states in memory, or two recorded rollouts.

The functions themselves are in ``errors``, ``detail`` and ``contact``; here they are put
together. Speed is measured in ``training.bench``.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from cloth_envs.recording import Rollout
from cloth_envs.scene import Scene
from cloth_envs.state import State
from training.metrics import contact, detail, errors


def at_frame(
    scene: Scene, state: State, truth: State, *, span: np.ndarray | float, factor: float = 2
) -> dict[str, np.ndarray]:
    """What one frame tells, each ``(B,)``.

    Args:
        span: of the truth's displacements [m], for PSNR (``errors.displacement_span``).
        factor: of the coarse grid whose Nyquist wave bounds ``detail_ratio``.
    """
    grid, x, y = scene.grid, state.positions, truth.positions
    vertex = errors.vertex_error(x, y, max(grid.height, grid.width))
    depth = contact.inside(scene, state)
    return {
        "error_mean": vertex.mean,
        "error_p95": vertex.p95,
        "error_max": vertex.max,
        "relative_l2": errors.relative_l2(x, y),
        "psnr": errors.psnr(x, y, span),
        "vmse": errors.vmse(x, y),
        "max_dx": errors.largest(x, y),
        "normal_deg": detail.normal_angle(grid, x, y),
        "curvature": detail.curvature_distance(grid, x, y),
        "bending_ratio": detail.bending_ratio(grid, x, y),
        "detail_ratio": detail.detail_ratio(grid, x, y, factor),
        "depth_mean": depth.mean,
        "depth_max": depth.max,
        "inside": depth.count,
    }


def over_frames(scene: Scene, run: Sequence[State], truth: Sequence[State]) -> dict[str, np.ndarray]:
    """What a trajectory of three frames or more tells, each ``(B,)``: flicker (mean over time) and tunnelling."""
    x, y = (np.stack([s.positions for s in states]) for states in (run, truth))
    return {
        "flicker": errors.flicker(x, y, scene.frame_dt).mean(0),
        "tunnelled": contact.tunnelled(scene, run),
    }


def compare_files(
    run: str | os.PathLike[str],
    truth: str | os.PathLike[str],
    *,
    trajectory: int = 0,
    factor: float = 2,
    crossings: bool = False,
) -> dict[str, np.ndarray]:
    """All metrics of one trajectory of two HDF5 rollouts: ``(T,)`` a frame, one number for flicker and tunnelling.

    PSNR takes the truth's own displacements from its first frame. ``crossings`` counts crossing triangles too (slow).

    Raises:
        ValueError: rollouts of different grids or lengths, or files that are no rollouts.
        ImportError: ``crossings`` without ipctk.
    """
    with Rollout.open(run) as a, Rollout.open(truth) as b:
        if a.scene.grid != b.scene.grid or a.length(trajectory) != b.length(trajectory):
            raise ValueError(
                f"{run} has {a.length(trajectory)} frames of {a.scene.grid.shape}, {truth} {b.length(trajectory)} of "
                f"{b.scene.grid.shape}: compare rollouts of one grid and length"
            )
        scene = b.scene
        found, true = (list(rollout.states(trajectory)) for rollout in (a, b))
    y = np.concatenate([s.positions for s in true])
    span = errors.displacement_span(y, y[0])
    span = np.where(span > 0, span, 1.0)  # an axis along which the truth never moves has no range of its own
    rows = [at_frame(scene, s, t, span=span, factor=factor) for s, t in zip(found, true, strict=True)]
    out = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
    if crossings:
        out["crossings"] = np.concatenate([contact.crossing_triangles(scene.grid, s.positions) for s in found])
    return out | {name: value[0] for name, value in over_frames(scene, found, true).items()}
