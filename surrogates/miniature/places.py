"""Some vertices of fine cloths out of coarse ones, in torch: upscaled, put where they are driven, outside all bodies.

What upscales and what handles do is linear but for the network, and so becomes one matrix each before anything moves:
of the coarse vertices, of what a network says of the cells, of the handles.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.sparse import csr_array, diags_array
from torch import Tensor

from cloth_envs.scene import Collider, Scene
from cloth_envs.state import State
from surrogates.miniature.fine import REACH
from surrogates.miniature.handles import Handles
from surrogates.upscale.local import Local
from surrogates.upscale.protocol import Upscaler
from surrogates.upscale.tensors import CellNet, Product, base, interpolation, nodes

TINY = 1e-20


class Moment(NamedTuple):
    """Coarse cloths at the end of a frame and what fine ones need beside them, the batch last.

    Attributes:
        positions, velocities: ``(3, h w, B)`` of the coarse cloth.
        driven, driving: ``(3, N, B)``, positions and velocities of the fine handles.
        bodies, moving: ``(C, 2, 3, B)``, their ends and velocities.
        biases: of each layer of a network, ``(n, B)``.
    """

    positions: Tensor
    velocities: Tensor
    driven: Tensor
    driving: Tensor
    bodies: Tensor
    moving: Tensor
    biases: list[Tensor]

    @classmethod
    def of(cls, coarse: State, handles: Sequence[Tensor], biases: list[Tensor]) -> "Moment":
        """From a state in tensors, and positions and velocities of the fine handles, ``(B, N, 3)``."""
        there: Any = coarse.positions, coarse.velocities, coarse.colliders, coarse.collider_velocities
        x, v = (field.flatten(2).permute(1, 2, 0).contiguous() for field in there[:2])
        driven, driving = (field.float().permute(2, 1, 0).contiguous() for field in handles)
        bodies, moving = (field.permute(1, 2, 3, 0).contiguous() for field in there[2:])
        return cls(x, v, driven, driving, bodies, moving, biases)

    def select(self, which: Tensor) -> "Moment":
        """A copy of some members."""
        x, v, driven, driving, bodies, moving = (field.index_select(-1, which) for field in self[:-1])
        biases = [bias.index_select(-1, which) for bias in self.biases]
        return Moment(x, v, driven, driving, bodies, moving, biases)


class Places:
    """Vertices ``(K,)`` of fine cloths of ``scene``, as ``fine.Fine`` makes them without mending, guard and folds.

    What firm handles are off by is always shared with the vertices near them, however little it is.

    Attributes:
        vertices: as a tensor. scene: of the fine cloth.
    """

    def __init__(
        self, scene: Scene, handles: Handles, upscaling: Upscaler, vertices: np.ndarray, device: torch.device
    ) -> None:
        self.scene, self.vertices = scene, torch.tensor(vertices, dtype=torch.int64, device=device)
        count, firm = scene.grid.vertices, np.array(scene.handles, np.intp)[handles.firm]
        free = np.ones(count, np.float32)
        free[firm] = 0.0
        # What is left of upscaling where handles are put and pull, and what comes from the handles instead.
        near, guides = handles.near, handles.guides
        pulls = csr_array((handles.pull, (near, firm[guides])), (count, count))
        kept = csr_array((diags_array(free, format="csr") - pulls)[vertices])
        held = csr_array((np.ones(len(firm)), (firm, handles.firm)), (count, len(scene.handles)))
        follows = csr_array((handles.pull, (near, handles.firm[guides])), held.shape)
        self._driven = Product(csr_array((held + follows)[vertices]), device)
        coarse, fine = upscaling.coarse.grid, upscaling.fine.grid
        self._base = Product(csr_array(kept @ base(upscaling)), device)
        self._speeds = Product(csr_array(kept @ interpolation(coarse, fine, upscaling.kind)), device)
        self._free = torch.tensor(free[vertices, None], device=device)
        self._net: CellNet | None = None
        if isinstance(upscaling, Local):
            said = csr_array(kept @ nodes(upscaling))
            wanted = np.unique(said.indices)
            self._nodes = Product(csr_array(said[:, wanted]), device)
            self._net = CellNet(upscaling, wanted, device) if len(wanted) else None

    def __call__(self, now: Moment) -> tuple[Tensor, Tensor]:
        """Positions [m] and velocities [m/s], ``(B, 3, K)``."""
        x = self._base(now.positions).add_(self._driven(now.driven))
        v = self._speeds(now.velocities).add_(self._driven(now.driving))
        if self._net is not None:
            x.add_(self._nodes(self._net(now.positions, now.biases)))
        bodies = list(enumerate(self.scene.colliders))
        for number, body in bodies * min(2, len(bodies)):
            normal, gap, _ = self._meet(body, now.bodies[number], now.moving[number], x)
            x.addcmul_(normal, gap.neg_().clamp_(min=0.0).mul_(self._free))
        for number, body in bodies:
            normal, gap, carried = self._meet(body, now.bodies[number], now.moving[number], x)
            into = ((v - carried) * normal).sum(0).clamp_(max=0.0).mul_(self._free).mul_(gap < REACH)
            v.addcmul_(normal, into, value=-1.0)
        return x.permute(2, 0, 1).contiguous(), v.permute(2, 0, 1).contiguous()

    def _meet(self, body: Collider, ends: Tensor, moving: Tensor, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Outward normals, gaps to the surface ``(K, B)`` and velocities of a body at ``x`` ``(3, K, B)``."""
        first, second = ends[:, :, None]
        radius = body.radius + self.scene.thickness
        if body.kind == "plane":
            return second, ((x - first) * second).sum(0) - radius, moving[0][:, None]
        axis = second - first
        place = (((x - first) * axis).sum(0) / (axis.square().sum(0) + TINY)).clamp_(0.0, 1.0)
        away = x - torch.addcmul(first, place, axis)
        distance = torch.linalg.vector_norm(away, dim=0)
        up = (distance == 0).to(x.dtype)  # from the axis itself
        normal = away / (distance + up)
        normal[2].add_(up)
        return normal, distance - radius, moving[0][:, None] + place * (moving[1] - moving[0])[:, None]
