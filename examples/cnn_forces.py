"""Forces plugged in to the cell of Zhao 2024 (its fig. 2): ``python examples/cnn_forces.py``.

One by the solver (wind), one by a sub-network (a drag learned from samples).
"""

from dataclasses import replace

import numpy as np
import torch

from cloth_envs.grid import Grid
from cloth_envs.particles import Particles
from cloth_envs.physics.laws.air import air_forces
from cloth_envs.registry import make_backend
from cloth_envs.scene import Air, Scene
from cloth_envs.state import Controls, State
from cloth_envs.world import World

NET = replace(Particles(), node_mass=1e-5, stiffness=0.1, dashpot=1e-4, drag=0.0)  # a sheet of 0.16 kg/m^2
GRID = Grid(24, 24, 23 * NET.spacing, 23 * NET.spacing)


def run(forces: list, handles: tuple = (), frames: int = 3) -> State:
    """A flat net at rest, after some frames of 20 ms, with ``forces`` plugged in."""
    scene = Scene("Net", GRID, NET.sheet(), 0.02, handles=handles, particles=NET)
    columns, rows = np.meshgrid(np.arange(24), np.arange(24))
    backend = make_backend("cnn", scene, backend_kwargs={"engine": "torch", "forces": forces})
    backend.reset(State.still(np.stack([columns, -rows, 0.0 * rows])[None] * NET.spacing))
    for _ in range(frames):
        backend.advance(Controls.hold(backend.state, handles))
    return backend.state


def wind() -> None:
    """The reference's own wind law, up through a net that is pinned along its first row."""
    blowing = replace(World("Flag", self_contact=False).scene, grid=GRID, air=Air(max_wind=12.0))

    def force(x: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        up = air_forces(blowing, x.numpy(), v.numpy(), np.array([[0.0, 0.0, 2.0]]))
        return torch.as_tensor(up, dtype=x.dtype)

    heights = [run(plugged, tuple(range(24))).positions[0, 2, -1].mean() for plugged in ([], [force])]
    print(f"free edge after 0.06 s: {1e3 * heights[0]:.0f} mm without wind, {1e3 * heights[1]:.0f} mm with it")


def learned_drag() -> None:
    """A network learns ``-|v| v`` from samples and, times 4e-5 kg/m, slows the net's fall."""
    torch.manual_seed(0)
    net = torch.nn.Sequential(torch.nn.Linear(3, 32), torch.nn.Tanh(), torch.nn.Linear(32, 3))
    optimizer = torch.optim.Adam(net.parameters(), 1e-2)
    for _ in range(600):
        v = torch.randn(256, 3)
        loss = ((net(v) + v.norm(dim=1, keepdim=True) * v) ** 2).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    def force(x: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        return 4e-5 * net(v.movedim(1, -1)).movedim(-1, 1)

    speeds = [-run(plugged, frames=10).velocities[0, 2].mean() for plugged in ([], [force])]
    print(f"falling after 0.2 s: {speeds[0]:.2f} m/s without drag, {speeds[1]:.2f} m/s with a learned one")


if __name__ == "__main__":
    wind()
    learned_drag()
