"""Gradients through ten frames of the cell of Zhao 2024, on a sheet: ``python examples/cnn_gradient.py``.

A sheet of rubber is stretched by a tenth between two level bars and let go. How stiff is it, by where its vertices are
in the next 0.2 s? How must the first bar move for a vertex to be at a target then?
"""

import numpy as np
import torch
from torch.autograd.functional import jacobian

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.explicit.bounds import stable_step
from cloth_envs.registry import make_backend
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.cell.rollout import rollout
from surrogates.cell.sheet import SheetCell, properties

FRAMES, STIFFNESS = 10, 20.0  # N/m
SCENE = Scene("Bars", Grid(6, 6, 0.5, 0.5), Material(0.2, STIFFNESS, 5.0), 0.02, handles=(*range(6), *range(30, 36)))
STIFFEST = SCENE.material.with_changes(stretch_stiffness=3 * STIFFNESS)
SUBSTEPS = int(SCENE.frame_dt / stable_step(SCENE, STIFFEST)) + 1  # stable for all that is tried
ROWS, COLS = np.indices(SCENE.grid.shape) * SCENE.grid.row_spacing
START = State.still(np.stack([COLS, -1.1 * ROWS, 0 * ROWS])[None])
HOLD = Controls.hold(START, SCENE.handles)
CELL = SheetCell(SCENE, dtype=torch.float64)
X, V = torch.from_numpy(START.positions), torch.from_numpy(START.velocities)


def swing(stiffness: torch.Tensor, velocity: torch.Tensor) -> torch.Tensor:
    """Positions ``(10, 3, 6, 6)`` [m] after each frame, if the first bar has a ``velocity`` ``(3,)`` [m/s]."""
    sheets = properties([SCENE.material], X) | {"stretch_stiffness": stiffness.reshape(1, 1, 1, 1)}
    drives, velocities = [], torch.cat([velocity.expand(6, 3), X.new_zeros(6, 3)])[None]
    for frame in range(1, FRAMES + 1):
        places = X.flatten(2)[..., SCENE.handles].mT + frame * SCENE.frame_dt * velocities
        drives.append(Controls(**vars(HOLD) | {"handle_positions": places, "handle_velocities": velocities}))
    return torch.cat([x for x, _ in rollout(CELL, SCENE, sheets, X, V, START, drives, SUBSTEPS)])


def identify(factor: float = 2.0, steps: int = 8) -> float:
    """The stretch stiffness [N/m] of what the compiled solver shows, found from ``factor`` times it on."""
    solver = make_backend("reference", SCENE, backend_kwargs={"dtype": "float64"})
    solver.reset(START)
    seen = torch.from_numpy(np.concatenate([solver.advance(HOLD).positions for _ in range(FRAMES)]))
    unknown = torch.tensor(np.log(factor * STIFFNESS), requires_grad=True)
    optimizer = torch.optim.LBFGS([unknown], max_iter=steps, line_search_fn="strong_wolfe")

    def closure() -> torch.Tensor:
        optimizer.zero_grad()
        loss = 1e4 * ((swing(unknown.exp(), X.new_zeros(3)) - seen) ** 2).sum()  # in cm^2
        loss.backward()
        return loss

    optimizer.step(closure)
    return unknown.exp().item()


def shoot(target: torch.Tensor, steps: int = 3) -> tuple[torch.Tensor, float]:
    """The first bar's velocity [m/s] for vertex 2, 2 to end at ``target``, by Newton's method; what it misses [m]."""
    velocity, stiffness = X.new_zeros(3), X.new_tensor(STIFFNESS)

    def miss(velocity: torch.Tensor) -> torch.Tensor:
        return swing(stiffness, velocity)[-1, :, 2, 2] - target

    for _ in range(steps):
        velocity = velocity - torch.linalg.solve(jacobian(miss, velocity), miss(velocity))
    return velocity.detach(), miss(velocity).norm().item()


if __name__ == "__main__":
    print(f"stiffness, from twice as much on: {identify():.3f} N/m; it is {STIFFNESS:.0f} N/m")
    velocity, missed = shoot(X.new_tensor([0.23, -0.2, 0.05]))
    print(f"the bar at {velocity.numpy().round(3)} m/s: the vertex misses its target by {1e3 * missed:.4f} mm")
