"""Fine cloths out of coarse ones, compiled: upscaled, put where they are driven, mended, outside all bodies."""

from collections.abc import Sequence

import numpy as np
from _minicloth_kernels import Fine as Kernel

from cloth_envs.physics.solver import kernel_sheet
from cloth_envs.scene import Scene
from cloth_envs.state import Cloth, Controls, State
from surrogates.miniature.handles import ROUNDING, Handles
from surrogates.miniature.mending import Mending
from surrogates.upscale.protocol import NOTHING, Interpolation, Upscaler, is_compiled

GUARD = Upscaler.torn  # strain, of most networks
REACH = 1e-5  # m, within which a vertex is at the surface of a body


class Fine:
    """What ``upscaling`` says of a coarse cloth, and what handles and bodies make of that.

    Handles are put where they are driven, and edges are mended (``mending``). Vertices that are nearer to a body than
    the scene's thickness are put on its surface, along its normal, and lose the velocity into it; bodies act one after
    the other, where there are several, twice. Handles stay where they are driven, inside or not. Where the scene has
    self-contact, vertices of triangles that cross are drawn towards the facets of the coarse cloth until none do.

    Args:
        scene: of the fine cloth. handles: how a coarse one follows its handles.
        mending: of edges; None leaves them as they are.
        guard: interpolate a cloth bicubically where a network would strain an edge by over its ``torn``, mended, and
            mend it more where that still does.
        threads: over members of the batch.

    Attributes:
        pushed, depth: of the last cloth of every member, how many vertices were put outside and by how much the
            deepest [m]; ``(B,)``.
        guarded: the members of which the last cloth was interpolated, ``(B,)``.
    """

    def __init__(
        self,
        scene: Scene,
        handles: Handles,
        upscaling: Upscaler,
        *,
        mending: Mending | None = None,
        guard: bool = False,
        threads: int = 1,
    ) -> None:
        self._shape, self._upscaling, self._threads = scene.grid.shape, upscaling, threads
        firm = handles.firm.astype(np.int32)  # numbers of those that are put in place
        self._kernel = Kernel(
            kernel_sheet(scene), firm, handles.near, handles.guides, handles.pull, rounding=ROUNDING, reach=REACH
        )
        self._mending = mending or (None, None, None, None)
        self._cubic = upscaling.bicubic.kernel if guard and not isinstance(upscaling, Interpolation) else None
        self.begin(0)

    def begin(self, batch: int) -> None:
        """There was no cloth so far of any of ``batch`` members."""
        self.pushed, self.depth = np.zeros(batch, np.int32), np.zeros(batch, np.float32)
        self._guarded = np.zeros(batch, np.int32)

    @property
    def guarded(self) -> np.ndarray:
        return self._guarded.astype(bool)

    def __call__(self, history: Sequence[State], controls: Controls) -> Cloth:
        """The fine cloth at the newest state of ``history``, at the end of a frame under ``controls``."""
        coarse, up = history[-1], self._upscaling
        shape, speeds, (net, bias, grids) = (coarse.batch, 3, *self._shape), None, NOTHING
        if is_compiled(up.positions):
            positions, (net, bias, grids) = np.empty(shape, np.float32), up.recipe
        else:
            positions = up.positions(history)
        if is_compiled(up.velocities):
            velocities, speeds = np.empty(shape, np.float32), up.speeds
        else:
            velocities = up.velocities(history)
        between, last, alone, more = self._mending
        self._kernel.fill(
            coarse.positions, coarse.velocities, net, bias, grids, speeds, between if net and grids else None, last,
            self._cubic, alone, more, up.torn,
            controls.handle_positions, controls.handle_velocities, coarse.colliders, coarse.collider_velocities,
            positions, velocities, self.pushed, self.depth, self._guarded, self._threads,
        )  # fmt: skip
        return Cloth(positions, velocities)
