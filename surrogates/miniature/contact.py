"""Contact at the fine level: upscaled vertices never end in a body."""

from __future__ import annotations

import numpy as np
from _minicloth_kernels import Bodies

from cloth_envs.physics.solver import kernel_sheet
from cloth_envs.scene import Scene
from cloth_envs.state import State

REACH = 1e-5  # m, within which a vertex is at the surface


class Projection:
    """Puts vertices that are nearer to a body than the scene's thickness on its surface, along the body's normal.

    Vertices at the surface lose the velocity into the body. Bodies act one after the other; where there are several,
    twice. Handles stay where they are driven, inside or not.

    Attributes:
        pushed, depth: of the last cloth of every member, how many vertices were put outside and by how much the
            deepest [m]; ``(B,)``.
    """

    def __init__(self, scene: Scene) -> None:
        self._bodies = Bodies(kernel_sheet(scene)) if scene.colliders else None
        self.pushed, self.depth = np.zeros(0, np.int32), np.zeros(0, np.float32)

    def positions(self, fine: np.ndarray, state: State) -> None:
        """Change ``fine`` ``(B, 3, H, W)`` float32 in place by the bodies of ``state``."""
        if len(self.pushed) != len(fine):
            self.pushed, self.depth = np.zeros(len(fine), np.int32), np.zeros(len(fine), np.float32)
        if self._bodies:
            self._bodies.push_out(fine, state.colliders, state.collider_velocities, self.pushed, self.depth)

    def velocities(self, fine: np.ndarray, positions: np.ndarray, state: State) -> None:
        """Change velocities of the cloth at ``positions``, which are projected already."""
        if self._bodies:
            self._bodies.stop_at(fine, positions, state.colliders, state.collider_velocities, REACH)
