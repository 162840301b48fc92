"""Every metric of ``errors``, ``detail`` and ``contact`` on two trajectories."""

from collections.abc import Sequence

import numpy as np

from cloth_envs.scene import Scene
from cloth_envs.state import State
from training.metrics import contact, detail, errors


def at_frame(
    scene: Scene, state: State, truth: State, *, span: np.ndarray | float, factor: float = 2
) -> dict[str, np.ndarray]:
    """What one frame tells, each ``(B,)``: PSNR with ``span`` [m], ``detail_ratio`` for a grid ``factor`` coarser."""
    grid, x, y = scene.grid, state.positions, truth.positions
    vertex, depth = errors.vertex_error(x, y, grid.length), contact.inside(scene, state)
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
    return {"flicker": errors.flicker(x, y, scene.frame_dt).mean(0), "tunnelled": contact.tunnelled(scene, run)}
