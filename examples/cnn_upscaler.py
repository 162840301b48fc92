"""Wrinkles on top of the cell of Zhao 2024: ``python examples/cnn_upscaler.py [upscaler]``."""

import sys

import numpy as np

from cloth_envs.registry import make_backend
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from surrogates.miniature.coarse import coarse_scene
from surrogates.upscale.protocol import make_upscaler


def main(upscaler: str) -> None:
    """The cell on a curtain of half the resolution, what is finer from an upscaler."""
    world = World("Curtain")
    world.reset({0: np.random.default_rng(0)})
    coarse, handles = coarse_scene(world.scene, 2, world.scene.material)
    cell, up = make_backend("cnn", coarse), make_upscaler(upscaler, coarse, world.scene, 2)
    cell.reset(State.still(world.state.positions[..., ::2, ::2]))
    cell.state.velocities[:] = world.state.velocities[..., ::2, ::2]
    start = Controls.hold(world.state, world.scene.handles)
    offsets = handles.offsets(cell.state.positions, start.handle_positions)
    for _ in range(5):
        small = cell.advance(handles.controls(world.task.controls(world.episode), offsets))
        world.step(np.zeros((1, len(world.task.actions))))
    gap = up.positions([small] * up.frames) - world.state.positions
    print(f"curtain after 5 frames: {1e3 * np.sqrt((gap**2).sum(1)).mean():.1f} mm off the fine reference")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "bicubic")
