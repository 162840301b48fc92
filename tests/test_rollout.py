"""Gradients through frames of the torch cell."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest
import torch

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.explicit.bounds import stable_step
from cloth_envs.scene import Air, Collider, Scene
from cloth_envs.state import Controls, State
from surrogates.cell.rollout import rollout
from surrogates.cell.sheet import SheetCell, properties

EPS = np.finfo(float).eps
SCENE = Scene(
    "sheet", Grid(5, 5, 0.4, 0.4), Material(0.2, 40.0, 10.0, 1e-3), 0.01, (0, 4),
    air=Air(max_wind=4.0), pressure=True, colliders=(Collider("sphere", 0.15),),
)  # fmt: skip
FRAMES = 10
BALL = torch.tensor([0.2, -0.22, -0.16], dtype=torch.float64)  # its top is 5 mm from the sheet, as contact has it
USUAL = {
    "stretch_stiffness": [40.0], "bend_stiffness": [1e-3], "velocity": [0.3, -0.2, 0.4], "ball": [0.1, 0.2, 1.5],
    "wind": [2.0, 1.0, 3.0], "pressure": [2.0],
}  # fmt: skip


def usual(batch: int) -> dict[str, torch.Tensor]:
    """What ``end`` takes, ``(B, 1)`` or ``(B, 3)``."""
    return {name: torch.tensor(value, dtype=torch.float64).repeat(batch, 1) for name, value in USUAL.items()}


def end(given: Mapping[str, torch.Tensor], *, cell: SheetCell | None = None, recompute: bool = False) -> torch.Tensor:
    """Positions of sheets that a ball hits from below, in the wind, two corners on their way, after ten frames."""
    batch = len(given["ball"])
    c, r = np.meshgrid(np.arange(5) * 0.1, np.arange(5) * 0.1)
    flat = np.stack([c, -r, 0.02 * np.sin(9 * c + 5 * r)])
    start = State.still(np.tile(flat, (batch, 1, 1, 1)), BALL.expand(batch, 1, 2, 3).numpy())
    x, v = torch.from_numpy(start.positions), torch.from_numpy(start.velocities)
    own = {name: given[name][..., None, None] for name in ("stretch_stiffness", "bend_stiffness")}
    sheets = properties([SCENE.material] * batch, x) | own
    corners, ball = given["velocity"][:, None].expand(-1, 2, -1), given["ball"][:, None, None].expand(-1, -1, 2, -1)
    drives = []
    for time in (SCENE.frame_dt * np.arange(1, FRAMES + 1)).tolist():
        places = x.flatten(2)[..., SCENE.handles].mT + time * corners, BALL + time * ball
        drives.append(Controls(places[0], corners, places[1], ball, given["wind"], given["pressure"][:, 0]))
    steps = int(SCENE.frame_dt / stable_step(SCENE, SCENE.material)) + 1
    cell = cell or SheetCell(SCENE, dtype=torch.float64)
    return rollout(cell, SCENE, sheets, x, v, start, drives, steps, 2, recompute=recompute)[-1][0]


def losses(x: torch.Tensor) -> torch.Tensor:
    return (x[..., -1, :] ** 2).sum((1, 2))


def test_ten_frames_have_the_slopes_that_differences_have() -> None:
    leaves = {name: value.requires_grad_() for name, value in usual(1).items()}
    losses(end(leaves)).sum().backward()
    steps, ways = (1e-3, -1e-3, 2e-3, -2e-3), torch.tensor([1.0, 0.6, -0.8], dtype=torch.float64)
    shifted = usual(len(steps) * len(USUAL))  # each along its own way, everything else as usual
    for k, value in enumerate(shifted.values()):
        part = value[len(steps) * k : len(steps) * (k + 1)]
        part *= 1 + torch.tensor(steps, dtype=torch.float64)[:, None] * ways[: value.shape[1]]
    with torch.no_grad():
        values = losses(end(shifted)).reshape(-1, len(steps)).numpy()
    for (name, leaf), (up, down, far_up, far_down) in zip(leaves.items(), values, strict=True):
        assert leaf.grad is not None, name
        slope = float((leaf.grad * leaf.detach() * ways[: leaf.shape[1]]).sum())
        near, far = (up - down) / 2e-3, (far_up - far_down) / 4e-3
        # A central difference errs by its step squared: the gap of the two is three times the nearer one's error. The
        # loss has the rounding of hundreds of substeps.
        rounding = 1e3 * EPS * up / 1e-3
        assert slope == pytest.approx(near, abs=abs(near - far) / 2 + rounding), name
        assert abs(near - far) < 1e-2 * abs(near), name  # the differences tell, and are not 0


def test_recomputed_frames_have_the_same_gradient_and_keep_less() -> None:
    found = []
    for recompute in (True, False):
        leaves, kept = {name: value.requires_grad_() for name, value in usual(1).items()}, 0

        def count(tensor: torch.Tensor) -> torch.Tensor:
            nonlocal kept
            kept += tensor.nbytes
            return tensor

        with torch.autograd.graph.saved_tensors_hooks(count, lambda tensor: tensor):
            loss = losses(end(leaves, recompute=recompute)).sum()
        loss.backward()
        found.append((kept, *(leaf.grad for leaf in leaves.values())))
    (less, *again), (more, *whole) = found
    assert less < more / 50
    assert all(a is not None and torch.equal(a, b) for a, b in zip(again, whole, strict=True))


def test_fused_laws_are_whole_graphs_of_the_same_result() -> None:
    cell, sizes = SheetCell(SCENE, dtype=torch.float64), list[int]()

    def backend(graph: torch.fx.GraphModule, inputs: list[torch.Tensor]) -> Callable[..., object]:
        sizes.append(sum(node.op.startswith("call") for node in graph.graph.nodes))
        return graph.forward

    cell.fuse(backend=backend, fullgraph=True)
    with torch.no_grad():
        gap = (end(usual(1), cell=cell) - end(usual(1))).abs().max()
    assert len(sizes) == 3  # springs, bending, air: each once, whatever the substep
    assert min(sizes) > 20
    assert gap == 0
