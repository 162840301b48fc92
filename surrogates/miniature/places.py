"""Some vertices of fine cloths out of coarse ones: upscaled, put where they are driven, outside all bodies.

What interpolates and what handles do is linear, and so becomes one sparse matrix each before anything moves: of the
coarse vertices, of what a network says of the cells, of the handles. ``kernels/gpu/fine.hpp`` applies them.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import _minicloth_kernels as kernels
import numpy as np
import torch
from scipy.sparse import csr_array, diags_array
from torch import Tensor

from cloth_envs.physics.gpu.card import Kernel, most_memory
from cloth_envs.physics.gpu.terms import as_literal, bodies_of
from cloth_envs.scene import Scene
from cloth_envs.state import State
from surrogates.miniature.fine import REACH
from surrogates.miniature.handles import Handles
from surrogates.upscale.local import LAYERS, Local
from surrogates.upscale.local_features import LIMIT, NODES, spacing
from surrogates.upscale.matrices import base, entries, interpolation, nodes, packed
from surrogates.upscale.protocol import Upscaler

FINE = np.dtype(
    [(name, np.int32) for name in ("rows", "cols", "handles", "bodies", "layers")]
    + [("widths", np.int32, (LAYERS + 1,)), ("spare", np.int32)]
    + [(name, np.float64) for name in ("spacing", "limit", "reach")],
    align=True,
)  # ``FineSheet`` of kernels/gpu/fine_terms.hpp
THREADS, CLOTHS = 128, (4, 2, 1)  # of a block; as many cloths as leave memory for SHARED blocks of a multiprocessor
SHARED = 4
Matrix = tuple[np.ndarray, np.ndarray]


class Moment(NamedTuple):
    """Coarse cloths at the end of a frame and what fine ones need beside them.

    Attributes:
        positions, velocities: ``(B, 3, h, w)`` of the coarse cloth.
        driven, driving: ``(B, N, 3)`` float64, positions and velocities of the fine handles.
        bodies, moving: ``(B, C, 2, 3)``, their ends and velocities.
        bias: of all layers of a network, ``(B, n)``.
    """

    positions: Tensor
    velocities: Tensor
    driven: Tensor
    driving: Tensor
    bodies: Tensor
    moving: Tensor
    bias: Tensor

    @classmethod
    def of(cls, coarse: State, handles: Sequence[Tensor], bias: Tensor) -> "Moment":
        """From a state in tensors, and positions and velocities of the fine handles, ``(B, N, 3)``."""
        there: Any = coarse.positions, coarse.velocities, coarse.colliders, coarse.collider_velocities
        x, v, bodies, moving = (field.float().contiguous() for field in there)
        driven, driving = (field.double().contiguous() for field in handles)
        return cls(x, v, driven, driving, bodies, moving, bias)

    def select(self, which: Tensor) -> "Moment":
        """A copy of some members."""
        return Moment(*(field.index_select(0, which) for field in self))


class Places:
    """Vertices ``(K,)`` of fine cloths of ``scene``, as ``fine.Fine`` makes them without mending, guard and folds.

    What firm handles are off by is always shared with the vertices near them, however little it is. On the processor
    the kernel is emulated thread by thread.

    Args:
        scene: of the fine cloth. handles: how the coarse one follows. upscaling: from coarse to fine.
        vertices: their numbers. device: where.
        backwards: emulated threads take turns from the last.
        spare: what a network says waits in memory of its own, as it does where a block's is too little for it.

    Raises:
        ValueError: a coarse cloth that does not fit into the memory that a block's threads share.
        ImportError: CuPy is missing; names the extra.
    """

    def __init__(
        self, scene: Scene, handles: Handles, upscaling: Upscaler, vertices: np.ndarray, device: torch.device,
        *, backwards: bool = False, spare: bool = False,
    ) -> None:  # fmt: skip
        self.scene, self._device, self._backwards = scene, device, backwards
        self.vertices = torch.tensor(vertices, dtype=torch.int64, device=device)
        free, matrices, cells = _matrices(scene, handles, upscaling, vertices)
        layers = upscaling.weights if isinstance(upscaling, Local) else []
        widths = [layer.shape[1] for layer in layers[:1]] + [len(layer) for layer in layers]
        grid = upscaling.coarse.grid
        told = (*grid.shape, len(scene.handles), len(scene.colliders), len(layers))
        widths += [0] * (LAYERS + 1 - len(widths))
        self._sheet = np.array([(*told, widths, spare, spacing(grid), LIMIT, REACH)], FINE)
        counts = np.array([len(vertices), len(cells), *(len(at) for at, _ in matrices)], np.int32)
        self._before = [self._put(array) for array in (counts, bodies_of(scene).view(np.uint8))]
        self._weights = self._put(packed(layers))
        count = len(vertices)
        self._side_by_side = count, self._put(np.arange(count, dtype=np.int32))
        self._among_all = scene.grid.vertices, self._put(vertices.astype(np.int32))
        self._after = [self._put(array) for array in (cells, free, *(part for pair in matrices for part in pair))]
        self._cells, self._cloths = len(cells), CLOTHS[0]
        self._kernel = self._compile() if device.type == "cuda" else None

    def _put(self, array: np.ndarray) -> Tensor:
        return torch.as_tensor(np.ascontiguousarray(array)).to(self._device)

    def _compile(self) -> Kernel:
        def memory(cloths: int) -> int:
            return kernels.fine_memory(self._sheet.tobytes(), self._cells, cloths)

        most = most_memory(self._device)
        self._cloths = next((cloths for cloths in CLOTHS if memory(cloths) <= most // SHARED), 1)
        self._sheet["spare"] |= memory(1) > most
        if memory(1) > most:
            rows, cols = self._sheet["rows"][0], self._sheet["cols"][0]
            raise ValueError(
                f"a coarse cloth of {rows} x {cols} vertices needs {memory(1)} bytes of the memory that a block of "
                f"threads shares, the card has {most}: use a larger factor, or device='cpu'"
            )
        macros: dict[str, object] = {
            "THREADS": THREADS,
            "CLOTHS": self._cloths,
            "WIDEST": int(max(1, *self._sheet["widths"][0])),
        }
        macros["SHEET"] = as_literal(self._sheet)
        return Kernel(
            "minicloth_fine", kernels.fine_text(), macros, self._device, threads=THREADS, memory=memory(self._cloths)
        )

    def __call__(self, now: Moment) -> tuple[Tensor, Tensor]:
        """Positions [m] and velocities [m/s], ``(B, 3, K)``."""
        x, v = (torch.empty(len(now.positions), 3, len(self.vertices), device=self._device) for _ in range(2))
        self._write(now, x, v, *self._side_by_side)
        return x, v

    def put(self, now: Moment, positions: Tensor, velocities: Tensor) -> None:
        """Write the same where it is in whole cloths, ``(B, 3, H, W)`` float32, contiguous."""
        self._write(now, positions, velocities, *self._among_all)

    def _write(self, now: Moment, x: Tensor, v: Tensor, room: int, places: Tensor) -> None:
        batch, device = len(now.positions), self._device
        said = torch.empty(batch if self._sheet["spare"][0] else 0, 3 * NODES * self._cells, device=device)
        *given, bias = now
        tensors = [*self._before, *given, self._weights, bias, *self._after, places, x, v, said]
        fields = [batch, room, *(tensor.data_ptr() for tensor in tensors)]
        if self._kernel is not None:
            self._kernel.run(fields, -(-batch // self._cloths))
        else:
            kernels.emulate_fine(self._sheet.tobytes(), fields, self._backwards)


def _matrices(
    scene: Scene, handles: Handles, upscaling: Upscaler, vertices: np.ndarray
) -> tuple[np.ndarray, list[Matrix], np.ndarray]:
    """Which vertices are free, ``(K,)``; ``entries`` of positions, velocities, what is said, and handles; the cells.

    As the kernel has them: positions of the coarse cloth continued all around, what is said node by node of the cells
    that count, each of which is where its patch begins.
    """
    count, firm = scene.grid.vertices, np.array(scene.handles, np.intp)[handles.firm]
    free = np.ones(count, np.float32)
    free[firm] = 0.0
    # What is left of upscaling where handles are put and pull, and what comes from the handles instead.
    near, guides = handles.near, handles.guides
    pulls = csr_array((handles.pull, (near, firm[guides])), (count, count))
    kept = csr_array((diags_array(free, format="csr") - pulls)[vertices])
    held = csr_array((np.ones(len(firm)), (firm, handles.firm)), (count, len(scene.handles)))
    follows = csr_array((handles.pull, (near, handles.firm[guides])), held.shape)
    said = csr_array(kept @ nodes(upscaling)) if isinstance(upscaling, Local) else csr_array((len(vertices), 0))
    cells, slot = np.unique(said.indices // NODES, return_inverse=True)
    by_node = (said.data, said.indices % NODES * 3 * len(cells) + slot, said.indptr)
    coarse, fine = upscaling.coarse.grid, upscaling.fine.grid
    wide = coarse.cols + 2
    inside = np.add.outer(np.arange(1, coarse.rows + 1) * wide, np.arange(1, coarse.cols + 1)).ravel()
    at, by = entries(csr_array(kept @ base(upscaling)))
    matrices = [
        (inside[at].astype(np.int32), by),
        entries(csr_array(kept @ interpolation(coarse, fine, upscaling.kind))),
        entries(csr_array(by_node, (len(vertices), 3 * NODES * len(cells)))),
        entries(csr_array((held + follows)[vertices])),
    ]
    corner = np.add.outer(np.arange(coarse.rows - 1) * wide, np.arange(coarse.cols - 1)).ravel()
    return free[vertices], matrices, corner[cells].astype(np.int32)
